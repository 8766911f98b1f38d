"""The policy as a ROS 2 node: a state comes, its command goes.

Each state is answered once. A repeated state means that it or its answer was lost, and is answered again; but
not more often than REANSWER_AFTER, so that two copies of a state cannot breed two copies of the next. The node may be
killed and started again at any time, and so may the simulator: what it keeps from one state to the next is what its
observer has found of delays and sensors, which a new one finds again.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NoReturn

import numpy as np
import rclpy.node
from bike_msgs.msg import BikeState, Opponents
from bike_msgs.msg import Course as CourseMessage
from numpy.typing import NDArray

from bike_policy.contract.bundle import shipped_policies
from bike_policy.riders.base import Rider, bundle_of, grip_of, infers_grip
from bike_policy.riders.rider import DEFAULT, RIDERS, check_race, make_rider
from bike_sim.course.course import Course
from bike_sim.ros import node_tools
from bike_sim.ros.command_gate import ANY_EPISODE, Command
from bike_sim.ros.messages import (
    StateMessage,
    course_from_message,
    decode_opponents,
    decode_state,
    encode_command,
    grip_to_message,
)
from bike_sim.ros.node_tools import CannotGoOn, ParameterSpec
from bike_sim.ros.subscriptions import subscribe
from bike_sim.ros.topics import publisher
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle

VEHICLE: Final = ParameterSpec("vehicle", "", "YAML file of the vehicle, where it is not a shipped one.", fixed=True)
SPECS: Final = (
    ParameterSpec(
        "policy",
        DEFAULT,
        f"{', '.join([*shipped_policies(), *RIDERS])}, the folder of a bundle, or default (or nothing), which chooses "
        "by the vehicle that is simulated. In a race classical and overtaker see the others; solo: in front of any "
        "name rides it as if it were alone.",
        fixed=True,
    ),
    VEHICLE,
    ParameterSpec(
        "disturbances",
        "",
        "Shipped disturbances or a YAML file; errors of sensors and delays act here.",
        fixed=True,
    ),
    ParameterSpec("stale_after_s", 1.0, "Wall-clock time without a state after which a warning is given, s."),
    ParameterSpec(
        "rate_hz",
        0.0,
        "0: each state is answered as it comes. Else answers go at this rate, that of the control period, and the last "
        "one again where no new state has come.",
        fixed=True,
    ),
    ParameterSpec(
        "watchdog_s",
        0.25,
        "With rate_hz: wall-clock time without a new state after which steering and throttle are set to 0, s.",
        fixed=True,
    ),
)

REANSWER_AFTER: Final = 0.2
"""Wall-clock time after which a repeated state is answered again, s."""

SETTLING_TIME: Final = 0.5
"""Wall-clock time after the start in which nothing is answered, s: a recorder needs a moment to find the commands, and
would miss the first ones. The simulator repeats its state meanwhile."""
MAX_SETTLING: Final = 3.0
"""The same where a listener is known that the commands do not reach, as one with another QoS, s."""

REPORT_PERIOD: Final = 1.0
LATENCY_WINDOW: Final = 100_000
"""Latencies kept for the figures since the start."""

COUNTED: Final = ("answered", "repeated", "stale", "refused", "over", "late")
"""Kinds of states: answered with a command; that came again; older than one that had come before; unreadable or not
finite, so that no action exists; of a vehicle that has fallen; that had not come when an answer at a fixed rate was
due."""


class Drive(rclpy.node.Node):
    """Answers states with the commands of a policy."""

    def __init__(self, name: str = "drive", specs: Sequence[ParameterSpec] = SPECS) -> None:
        """Load the policy.

        Args:
            name: of the node.
            specs: its parameters.

        Raises:
            ValueError: an invalid parameter or bundle.
            FileNotFoundError: no such bundle.
        """
        super().__init__(name, namespace=node_tools.NAMESPACE)
        values = node_tools.declare(self, specs)
        self._rider = self._rider_of(values)
        self._given_vehicle = load_vehicle(values["vehicle"]) if values["vehicle"] else None
        self._course: tuple[int, Course] | None = None
        self._accept(values)
        self._last: StateMessage | None = None
        self._answered_at = self._heard_at = time.monotonic()
        self._counts = Counter(dict.fromkeys(COUNTED, 0))
        self._reported = self._counts.copy()
        self._latencies: deque[float] = deque(maxlen=LATENCY_WINDOW)
        self._commands = publisher(self, "command")
        self._grips = publisher(self, "grip") if infers_grip(self._rider) else None
        self._started_at = time.monotonic()
        self._diagnostics = node_tools.Diagnostics(self)
        subscribe(self, CourseMessage, "course", self._on_course, node_tools.LATCHED_QOS)
        self._opponents: tuple[int, int, NDArray[np.float64]] | None = None
        self._races, self._waiting = False, b""
        opponents = self.create_subscription(
            Opponents, "opponents", self._on_opponents, node_tools.STREAM_QOS, raw=True
        )
        self._rate: float = values.get("rate_hz", 0.0)
        self._watchdog: float = values.get("watchdog_s", 0.0)
        self._newest: bytes | None = None
        self._sent: Command | None = None
        self._new_at = self._started_at
        for name, value in (("rate_hz", self._rate), ("watchdog_s", self._watchdog)):
            if not 0.0 <= value < math.inf:
                raise ValueError(f"parameter {name} must be finite and not negative, got {value!r}")
        taken = self._on_state
        if self._rate > 0.0:
            taken = self._keep
            node_tools.wall_timer(self, 1.0 / self._rate, self._tick)
        states = self.create_subscription(BikeState, "state", taken, node_tools.STREAM_QOS, raw=True)
        self.streams = (opponents, states)
        node_tools.on_change(self, specs, self._accept)
        node_tools.wall_timer(self, REPORT_PERIOD, self._report)
        self.get_logger().info(f"policy {self._rider.name!r} is waiting for states")

    def _rider_of(self, values: dict[str, Any]) -> Rider:
        """Make the rider that answers."""
        rider = make_rider(values["policy"] or DEFAULT)
        if not values["disturbances"]:
            return rider
        from bike_policy.riders.disturbed import DisturbedRider  # late: a ride is seldom disturbed

        return DisturbedRider(rider, load_disturbances(values["disturbances"]))

    def finish(self) -> None:
        """Report a last time, also in the log."""
        self._report()
        latency = "no latency measured"
        if self._latencies:
            median, p99 = np.percentile(self._latencies, [50.0, 99.0]) * 1e3
            latency = f"latency median {median:.3f} ms, 99th percentile {p99:.3f} ms"
        self.get_logger().info(f"{self._counts['answered']} states answered, {latency}")

    def _accept(self, values: dict[str, Any]) -> None:
        if not values["stale_after_s"] > 0.0:
            raise ValueError(f"parameter stale_after_s must be positive, got {values['stale_after_s']!r}")
        self._stale_after: float = values["stale_after_s"]

    # ---------------------------------------------------------------------------------------------------------- states

    def _keep(self, data: bytes) -> None:
        """Keep the newest state until the next answer is due."""
        self._newest = data

    def _tick(self) -> None:
        """Answer at a fixed rate: the newest state, or without one what was answered last, for a short time."""
        data, self._newest = self._newest, None
        answered = self._counts["answered"]
        if data is not None:
            self._on_state(data)
        if self._counts["answered"] > answered:
            self._new_at = time.monotonic()
            return
        if self._sent is None or (self._last is not None and self._last.snapshot.fallen):
            return
        self._counts["late"] += 1
        command = self._sent
        if time.monotonic() - self._new_at > self._watchdog:
            command = Command(ANY_EPISODE, 0, 0.0, 0.0)
        self._commands.publish(encode_command(command, 0 if self._last is None else self._last.stamp))

    def _on_state(self, data: bytes) -> None:
        began = time.monotonic()
        try:
            message = decode_state(data)
        except ValueError as error:
            self._counts["refused"] += 1
            self.get_logger().error(f"a state cannot be read: {error}", once=True)
            return
        snapshot = message.snapshot
        if self._is_stale(message, began):
            self._counts["stale"] += 1
            return
        self._heard_at = began
        if self._is_settling(began):
            return
        repeated = self._last is not None and _same(message, self._last)
        if repeated:
            self._counts["repeated"] += 1
            if began - self._answered_at < REANSWER_AFTER:
                return
        if self._is_new_ride(message):
            if not self._fits(message):
                return
        elif self._last is not None and _shape(message) != _shape(self._last):
            self._counts["refused"] += 1
            self.get_logger().error("a state has another shape than those of its episode before", once=True)
            return
        if self._races and not snapshot.fallen:
            seen = self._opponents
            if seen is None or seen[:2] != (snapshot.episode, snapshot.step):
                self._waiting = data  # what it shows of the others is on the way
                return
            snapshot = replace(snapshot, opponents=seen[2])
        self._last, self._waiting = message, b""
        if snapshot.fallen:
            self._counts["over"] += 1
            return
        answer = self._rider.command(snapshot)
        if answer is None:
            self._counts["refused"] += 1
            return
        self._sent = Command(snapshot.episode, snapshot.step, *answer)
        self._commands.publish(encode_command(self._sent, message.stamp))
        if self._grips is not None and (grip := grip_of(self._rider)) is not None:
            self._grips.publish(grip_to_message(grip, snapshot, message.stamp))
        self._answered_at = time.monotonic()
        if not repeated:
            self._counts["answered"] += 1
            self._latencies.append(self._answered_at - began)

    def _on_opponents(self, data: bytes) -> None:
        try:
            self._opponents = decode_opponents(data)
        except ValueError as error:
            self.get_logger().error(f"opponents cannot be read: {error}", once=True)
            return
        if self._waiting:
            self._on_state(self._waiting)

    def _is_settling(self, now: float) -> bool:
        """Whether a subscriber to commands may not have discovered this node yet."""
        if self._last is not None:
            return False
        age = now - self._started_at
        missing = self._commands.get_subscription_count() < self.count_subscribers("command")
        return age < SETTLING_TIME or (missing and age < MAX_SETTLING)

    def _is_stale(self, message: StateMessage, now: float) -> bool:
        """Whether a state is older than one that has come.

        Time runs backwards also where a simulator was restarted. A new one begins with step 0, or after a silence.
        """
        last = self._last
        if last is None or message.snapshot.step == 0 or now - self._heard_at > self._stale_after:
            return False
        return message.stamp < last.stamp

    def _is_new_ride(self, message: StateMessage) -> bool:
        """Whether the episode, or the simulator itself, is another one than before."""
        if self._last is None:
            return True
        now, last = message.snapshot, self._last.snapshot
        return now.episode != last.episode or now.step < last.step

    def _fits(self, message: StateMessage) -> bool:
        """Prepare the rider for an episode; false while it still waits for the course.

        Raises:
            CannotGoOn: naming the difference.
        """
        if self._course is None or self._course[0] != message.snapshot.episode:
            return False
        episode = message.episode
        try:
            if self._rate > 0.0 and abs(self._rate * episode.control_period - 1.0) > 1e-6:
                raise ValueError(
                    f"rate_hz of {self._rate!r} is not that of its control period of {episode.control_period!r} s, "
                    f"{1.0 / episode.control_period:g}"
                )
            vehicle = self._vehicle(episode.vehicle)
            self._races = self.count_publishers("opponents") > 0
            if self._races:
                check_race(self._rider, vehicle)
            self._rider.begin(vehicle, self._course[1], episode.control_period, episode.preview)
        except (ValueError, FileNotFoundError) as error:
            self.get_logger().error(f"the policy does not fit the simulator: {error}")
            raise CannotGoOn(f"the policy does not fit the simulator: {error}") from error
        if self._grips is None and infers_grip(self._rider):  # the default rider is chosen by the vehicle
            self._grips = publisher(self, "grip")
        bundle = bundle_of(self._rider)
        warning = None if bundle is None else bundle.speed_warning(message.snapshot.speed)
        if warning is not None:
            self.get_logger().warning(warning)
        self.get_logger().info(
            f"{self._rider.name!r} is driving episode {message.snapshot.episode} from step {message.snapshot.step}"
        )
        return True

    def _on_course(self, message: CourseMessage) -> None:
        self._course = (message.episode, course_from_message(message))

    def _vehicle(self, name: str) -> Vehicle:
        """Return the vehicle that the simulator rides: the one given as parameter, or the shipped one of its name.

        Raises:
            ValueError: another one was given.
            FileNotFoundError: it is neither given nor shipped.
        """
        if self._given_vehicle is not None and self._given_vehicle.name != name:
            raise ValueError(f"the simulator rides {name!r}, parameter vehicle is {self._given_vehicle.name!r}")
        return self._given_vehicle or load_vehicle(name)

    # ---------------------------------------------------------------------------------------------------- diagnostics

    def _report(self) -> None:
        """Tell on diagnostics, and in the log where something is wrong."""
        silence = time.monotonic() - self._heard_at
        level, text = self._diagnostics.OK, "driving"
        new = self._counts - self._reported
        if new["stale"] or new["refused"]:
            text = f"states in the last second: {new['stale']} stale, {new['refused']} not finite"
            level = self._diagnostics.WARN
        elif self._last is None:
            text = "waiting for the first state and its course"
        elif silence > self._stale_after:
            level, text = self._diagnostics.WARN, f"no state for {silence:.1f} s, waiting for the simulator"
            if self._rate > 0.0 and self._sent is not None:
                text += "; the watchdog steers straight"
        elif self._last.snapshot.fallen:
            text = "the vehicle has fallen, waiting for a reset"
        elif new["late"]:
            level, text = self._diagnostics.WARN, f"{new['late']} states came late in the last second"
            if time.monotonic() - self._new_at > self._watchdog:
                text += f", the watchdog steers straight: no new one for {time.monotonic() - self._new_at:.2f} s"
        if level == self._diagnostics.WARN:
            self.get_logger().warning(text)
        figures: dict[str, object] = {f"states_{name}": value for name, value in self._counts.items()}
        if self._latencies:
            median, p99 = np.percentile(self._latencies, [50.0, 99.0])
            figures |= {"latency_median_ms": median * 1e3, "latency_p99_ms": p99 * 1e3}
        figures["policy"] = self._rider.name
        stamp = 0 if self._last is None else self._last.stamp
        self._diagnostics.report(level, text, figures, stamp)
        self._reported = self._counts.copy()


def _same(a: StateMessage, b: StateMessage) -> bool:
    """Whether two messages are copies of one state; a simulator that was restarted counts the same numbers again."""
    same_place = (a.snapshot.episode, a.snapshot.step, a.stamp) == (b.snapshot.episode, b.snapshot.step, b.stamp)
    return same_place and np.array_equal(a.snapshot.state, b.snapshot.state)


def _shape(message: StateMessage) -> tuple[object, ...]:
    """Return what no state of an episode changes: its constants, and which numbers it has."""
    snapshot = message.snapshot
    points = None if snapshot.circuit is None else snapshot.circuit.points.shape
    return (message.episode, len(snapshot.signals), points)


def main() -> NoReturn:
    """Run the node until a signal; the exit code is 2 if the policy cannot be used."""
    node_tools.leave(node_tools.run_node("drive", Drive))


if __name__ == "__main__":
    main()
