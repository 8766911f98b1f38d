"""The topics of a bicycle's sensors: inertial unit, encoders, position by satellite."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from bike_sim.ros import standard_messages
from bike_sim.ros.node_tools import NANOSECONDS
from bike_sim.ros.topics import publisher
from bike_sim.sim.disturbances import Disturbances, RawSensors
from bike_sim.sim.sensors import BicycleSensors
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class SensorTopics:
    """Publishers of what sensors measure, where someone listens."""

    def __init__(
        self, node: Node, vehicle: Vehicle, disturbances: Disturbances, period: int, datum: tuple[float, float],
        prefix: str,
    ) -> None:  # fmt: skip
        """Open the topics.

        Args:
            node: that publishes.
            vehicle: a bicycle.
            disturbances: how the sensors err.
            period: control period, ns.
            datum: latitude and longitude of the map's origin, deg.
            prefix: before their frames.

        Raises:
            ValueError: times that are not whole numbers of control periods.
        """
        self._period, self._datum, self._prefix = period, datum, prefix
        self._known = disturbances.raw_sensors or RawSensors()
        self._sensors = BicycleSensors(vehicle, disturbances, period / NANOSECONDS)
        self._fix, self._encoders, self._imu = (publisher(node, name) for name in ("fix", "encoders", "imu"))
        self._messages: list[tuple[Any, Any]] = []

    def begin(self, snapshot: Snapshot, stamp: int) -> None:
        """Begin an episode with its first state and that one's simulated time, ns."""
        self._sensors.begin(snapshot)
        self._begun = stamp

    def take(self, snapshot: Snapshot, stamp: int) -> None:
        """Take a state that is to be measured, with its simulated time, ns."""
        self._snapshot, self._stamp, self._messages = snapshot, stamp, []

    def publish(self) -> None:
        """Publish what is measured of the state that was taken; the same again where it was published before."""
        if not self._messages and any(
            topic.get_subscription_count() for topic in (self._fix, self._encoders, self._imu)
        ):
            self._messages = self._measured()
        for topic, message in self._messages:
            topic.publish(message)

    def _measured(self) -> list[tuple[Any, Any]]:
        measured = self._sensors.measure(self._snapshot)
        messages = [
            (self._encoders, standard_messages.encoders(measured, self._stamp)),
            (self._imu, standard_messages.imu(measured, self._known, self._stamp)),
        ]
        if measured.fix is not None:
            then = self._begun + measured.fix.step * self._period
            fix = standard_messages.nav_sat_fix(measured, self._known, then, self._datum)
            messages.insert(0, (self._fix, fix))
        if self._prefix:
            messages = [(topic, standard_messages.set_prefix(message, self._prefix)) for topic, message in messages]
        return messages
