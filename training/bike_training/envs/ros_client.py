"""The simulator over ROS 2, with the same methods as the one in process.

A `RosClient` starts its own simulator node in its own ROS domain, or joins one that runs. Each step is one command
and one state in lockstep, so the rides are bit for bit those of :class:`bike_sim.sim.simulator.Simulator`.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import Final

from bike_msgs.msg import BikeCommand, BikeState
from bike_msgs.msg import Course as CourseMessage
from bike_msgs.srv import Reset

from bike_sim.course.course import Course
from bike_sim.ros import messages, node_tools
from bike_sim.ros.command_gate import Command
from bike_sim.ros.isolation import DomainLease
from bike_sim.ros.subscriptions import RawSubscription, subscribe
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.envs.node_process import InactivityTimeout, NodeLost, NodeProcess

START_TIMEOUT: Final = 60.0
"""Longest wait for a simulator that is not at work either, s. Its first start on a machine compiles the physics."""

RESEND_AFTER: Final = 0.5
"""Time without an answer after which a command is sent again, s."""

SILENCE: Final = 10.0
"""Silence after which the simulator counts as lost, s."""


class RosClient(AbstractContextManager["RosClient"]):
    """Rides one simulator node in lockstep.

    Attributes:
        config: of the simulator.
        vehicle: the vehicle of that name or file.
        domain_id: ROS domain that is used.
        preview: the preview of the present episode.
    """

    preview = Preview()

    def __init__(self, config: SimulatorConfig | None = None, join: int | None = None) -> None:
        """Start or find the simulator.

        Args:
            config: of the simulator; of one that runs what it was started with.
            join: ROS domain of a simulator that runs, in lockstep; None starts one in a free domain.

        Raises:
            NodeLost: it ended or did not appear in time; with its last output if this client started it.
            FileNotFoundError: an unknown vehicle. ValueError: an invalid vehicle.
        """
        self.config = config or SimulatorConfig()
        self.vehicle: Vehicle = load_vehicle(self.config.vehicle)
        self._close = contextlib.ExitStack()
        self._own: list[NodeProcess] = []
        try:
            self.domain_id = self._start() if join is None else join
            self._open()
        except BaseException:
            self.close()
            raise

    def _start(self) -> int:
        """Start a simulator, and return its domain."""
        domain_id = self._close.enter_context(DomainLease()).domain_id
        parameters = asdict(self.config) | {"mode": "lockstep", "auto_reset": "never", "course": "line"}
        process = NodeProcess("bike_sim.ros.sim_node", parameters, domain_id)
        self._own.append(self._close.enter_context(process))
        return domain_id

    def _open(self) -> None:
        self._node = node_tools.GuestNode(f"ride_client_{os.getpid()}_{id(self) & 0xFFFF:x}", self.domain_id)
        self._close.callback(self._node.close)
        self._commands = self._node.create_publisher(BikeCommand, "command", node_tools.COMMAND_QOS)
        # Before the subscriptions: a matched simulator knows where to send its answers; earlier ones are dropped.
        self._reset_service = self._node.create_client(Reset, "reset")
        self._course: tuple[int, Course] | None = None
        subscribe(self._node, CourseMessage, "course", self._on_course, node_tools.LATCHED_QOS)
        self._states = RawSubscription(self._node, BikeState, "state", node_tools.SENDER_QOS)
        self._close.callback(self._states.close)
        self._last: Snapshot | None = None
        self._wait_until(self._connected, START_TIMEOUT, "did not appear")

    # ---------------------------------------------------------------------------------------------- simulator's methods

    @property
    def course(self) -> Course | None:
        """The course of the present episode, or None before the first."""
        if self._last is None:
            return None
        episode = self._last.episode
        self._wait_until(
            lambda: self._course is not None and self._course[0] == episode,
            SILENCE,
            f"has not sent the course of episode {episode}",
        )
        assert self._course is not None
        return self._course[1]

    def reset(self, request: ResetRequest) -> Snapshot:
        """Begin an episode.

        Raises:
            ValueError: the simulator refused the request, in its words.
            NodeLost: it does not answer.
        """
        future = self._reset_service.call_async(messages.reset_to_message(request))
        try:
            self._wait_until(future.done, SILENCE, "has not answered a reset")
        finally:
            self._reset_service.remove_pending_request(future)
        response = future.result()
        assert response is not None
        if not response.success:
            raise ValueError(response.message)
        state = response.state
        self.preview = Preview(state.preview_by_time, state.preview_interval, len(state.preview_y))
        self._last = messages.snapshot_from_message(state)
        return self._last

    def step(self, steering: float, throttle: float = 0.0) -> Snapshot:
        """Hold a command for one control period.

        Args:
            steering: in [-1, 1], positive to the left.
            throttle: in [-1, 1]; bicycles have no drive and ignore it.

        Raises:
            ValueError: a command that is not finite or out of range.
            RuntimeError: no episode was begun, or the vehicle has fallen, where the node ends the episode.
            NodeLost: the simulator does not answer.
        """
        last = self._last
        if last is None:
            raise RuntimeError("call reset before step")
        if last.fallen:
            raise RuntimeError(f"episode {last.episode} ended with a fall in step {last.step}; call reset")
        if not -1.0 <= steering <= 1.0 or not -1.0 <= throttle <= 1.0:
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        command = messages.encode_command(Command(last.episode, last.step, steering, throttle))
        self._last = self._exchange(command, last.episode, last.step + 1)
        return self._last

    def close(self) -> None:
        """End the simulator if this client started it, and leave the domain. A second call does nothing."""
        self._close.close()

    def __exit__(self, *_: object) -> None:
        """Close the client."""
        self.close()

    # --------------------------------------------------------------------------------------------------------- waiting

    def _exchange(self, command: bytes, episode: int, step: int) -> Snapshot:
        """Send a command, again and again if need be, until the state of the given step comes."""
        patience = InactivityTimeout(SILENCE, self._own)
        while True:
            self._commands.publish(command)
            resend_at = time.monotonic() + RESEND_AFTER
            while (now := time.monotonic()) < resend_at:
                state = self._receive(resend_at - now)
                if state is not None and state.episode == episode and state.step == step:
                    return state
            self._check()
            if patience.is_out():
                raise self._lost(f"has not answered step {step} of episode {episode} within {SILENCE:g} s")

    def _receive(self, timeout: float) -> Snapshot | None:
        """Return the next state, or None after the time-out."""
        data = self._states.wait(timeout)
        try:
            return None if data is None else messages.decode_state(data).snapshot
        except ValueError as error:
            self._node.get_logger().error(f"a state cannot be read: {error}", once=True)
            return None

    def _on_course(self, message: CourseMessage) -> None:
        self._course = (message.episode, messages.course_from_message(message))

    def _connected(self) -> bool:
        # Both directions: a command that is sent before the simulator's reader is known would be lost until resent.
        seen = self._node.count_publishers("state") and self._commands.get_subscription_count()
        return bool(seen) and self._reset_service.service_is_ready()

    def _wait_until(self, condition: Callable[[], bool], timeout: float, complaint: str) -> None:
        patience = InactivityTimeout(timeout, self._own)
        while not condition():
            self._node.spin_once(0.02)
            self._check()
            if patience.is_out():
                raise self._lost(f"{complaint} within {timeout:g} s")

    def _check(self) -> None:
        for process in self._own:
            process.check()

    def _lost(self, complaint: str) -> NodeLost:
        where = f"/{node_tools.NAMESPACE} in ROS domain {self.domain_id}"
        return NodeLost(f"the simulator {where} {complaint}; is it running, in lockstep, and not paused?")
