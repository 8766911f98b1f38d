"""The topics of one machine's ride: its state, what belongs to it, and what is only made where someone listens."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

from rclpy.node import Node
from std_msgs.msg import String

from bike_sim.course.course import Course
from bike_sim.ros import node_tools, standard_messages
from bike_sim.ros.messages import (
    FOOTPRINT_FRAME,
    Episode,
    course_points_to_message,
    course_to_message,
    encode_opponents,
    encode_state,
    episode_start_to_message,
    event_to_message,
    lean_history_to_message,
    telemetry_to_message,
)
from bike_sim.ros.topics import TFMessage, publisher
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.superbike import Superbike

SCREEN_PERIOD: Final = 1.0 / 60.0
"""Least wall-clock time between two states for screens, s."""


class RideTopics:
    """Publishers of a ride.

    Attributes:
        state: bytes of the last state.
        state_topic: full name of the topic of states.
        published_at: wall-clock time of its last publication, s.
    """

    def __init__(
        self,
        node: Node,
        plant: Plant,
        period: int,
        namespace: str = "",
        prefix: str = "",
        disturbances: Disturbances | None = None,
        races: bool = False,
    ) -> None:
        """Open the topics and publish what never changes.

        Args:
            node: that publishes.
            plant: the machine.
            period: control period, ns.
            namespace: of the topics, absolute; none for the node's own.
            prefix: before all frames but map.
            disturbances: of the ride, or None.
            races: whether its snapshots show others.
        """
        self._node, self._plant, self._period, self._prefix = node, plant, period, prefix
        vehicle = plant.vehicle

        def topic(name: str) -> Any:
            return publisher(node, name, namespace)

        # Before the states: who hears these knows that there are others.
        self._opponents_topic = topic("opponents") if races else None
        self._state_topic, self._screen_topic = topic("state"), topic(node_tools.SCREEN_STATE)
        self.state_topic: str = self._state_topic.topic_name
        self._screened_at = 0.0
        self._start_topic, self._course_topic, self._course_marker_topic, self._event_topic = (
            topic(name) for name in ("episode", "course", "course_marker", "events")
        )
        topic("robot_description").publish(String(data=standard_messages.robot_description(vehicle)))
        if disturbances is not None:
            topic("disturbances").publish(String(data=disturbances.to_text()))
        frames = standard_messages.TRANSFORMS
        # Messages that are only made where someone listens: they cost more than the state itself.
        extras: dict[str, Callable[[Snapshot, int], Any]] = {
            "course_points": lambda s, stamp: course_points_to_message(s, self._course, stamp),
            "lean_history": lambda s, stamp: lean_history_to_message(s, stamp, period),
            "odom": lambda s, stamp: standard_messages.odometry(s, vehicle, stamp),
            "joint_states": lambda s, stamp: standard_messages.joint_state(s, vehicle, stamp),
            "markers": lambda s, stamp: standard_messages.vehicle_markers(s, vehicle, stamp),
        }
        if isinstance(vehicle, Superbike):
            extras["telemetry"] = lambda s, stamp: telemetry_to_message(s, vehicle, stamp)
        if TFMessage is not None:
            extras["/tf"] = lambda s, stamp: TFMessage(transforms=[make(s, stamp) for make in frames])
        self._extras = [(topic(name), make) for name, make in extras.items()]
        # The same as on /tf, for viewers of recordings made where tf2_msgs is missing.
        transforms = topic("transform")
        self._extras += [(transforms, make) for make in frames]

    def begin(
        self, snapshot: Snapshot, request: ResetRequest, config: SimulatorConfig, course: Course, preview: Preview,
        stamp: int,
    ) -> None:  # fmt: skip
        """Publish how an episode began.

        Args:
            snapshot: the first.
            request: that was met.
            config: of the simulator.
            course: that is followed.
            preview: points of it that are seen.
            stamp: simulated time, ns.
        """
        self._course, vehicle = course, self._plant.vehicle
        self._episode = Episode.of(vehicle, course, preview, config.control_period)
        start = episode_start_to_message(request, config, self._plant.signal_names, snapshot.episode, stamp)
        self._start_topic.publish(start)
        self._course_topic.publish(course_to_message(course, snapshot.episode, stamp))
        self._course_marker_topic.publish(self._prefixed(standard_messages.course_marker(course, stamp)))
        self.publish_events(snapshot, stamp)

    def take(self, snapshot: Snapshot, stamp: int) -> None:
        """Take a state that is to be published, with its simulated time, ns."""
        self._snapshot, self._stamp = snapshot, stamp
        self.state = encode_state(snapshot, self._episode, stamp)
        if self._opponents_topic is not None:
            self._opponents = encode_opponents(snapshot, stamp, f"{self._prefix}{FOOTPRINT_FRAME}")

    def publish_state(self) -> None:
        """Publish the state that was taken, once more where it was published before."""
        if self._opponents_topic is not None:
            self._opponents_topic.publish(self._opponents)
        self._state_topic.publish(self.state)
        self.published_at = time.monotonic()
        if self.published_at - self._screened_at > SCREEN_PERIOD:
            self._screened_at = self.published_at
            if self._screen_topic.get_subscription_count():
                self._screen_topic.publish(self.state)

    def publish_extras(self) -> None:
        """Publish what belongs to the state that was taken, where someone listens."""
        for topic, make in self._extras:
            if topic.get_subscription_count():
                topic.publish(self._prefixed(make(self._snapshot, self._stamp)))

    def publish_events(self, snapshot: Snapshot, stamp: int) -> None:
        """Publish the events of a snapshot."""
        for event in snapshot.events:
            self._event_topic.publish(event_to_message(event, snapshot, stamp))

    def _prefixed(self, message: Any) -> Any:
        return standard_messages.set_prefix(message, self._prefix) if self._prefix else message
