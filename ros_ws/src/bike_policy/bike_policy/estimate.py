"""The estimator as a ROS 2 node: what a bicycle's sensors measure comes, its state goes, for `drive` to answer.

With a simulator, its `episode` and `course` say what is ridden. On a bicycle nobody sends those: then the parameter
`course` names the path, and the node begins an episode of its own with the first measurement and publishes the course.
"""

from __future__ import annotations

import time
from collections import Counter
from typing import Any, Final, NoReturn

import numpy as np
import rclpy.node
from bike_msgs.msg import Course as CourseMessage
from bike_msgs.msg import EpisodeStart
from sensor_msgs.msg import Imu, JointState, NavSatFix

from bike_policy.riders.estimator import Estimator
from bike_sim.course.course import Course
from bike_sim.course.files import load_course
from bike_sim.ros import node_tools
from bike_sim.ros.messages import Episode, course_from_message, course_to_message, encode_state, time_from_message
from bike_sim.ros.node_tools import NANOSECONDS, CannotGoOn, ParameterSpec
from bike_sim.ros.standard_messages import ENCODERS
from bike_sim.ros.subscriptions import subscribe
from bike_sim.ros.topics import publisher
from bike_sim.sim.request import Preview
from bike_sim.sim.sensors import DATUM, Fix, Measurement, from_geodetic
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.files import load_vehicle

_PREVIEW = Preview()
SPECS: Final = (
    ParameterSpec("vehicle", "", "Shipped bicycle or YAML file; none: that of the simulator.", fixed=True),
    ParameterSpec(
        "sensors",
        "raw_sensors",
        "Shipped disturbances or a YAML file; its raw_sensors say where sensors sit and how noisy they are. Biases are "
        "found and not read.",
        fixed=True,
    ),
    ParameterSpec(
        "course", "", "Path that is ridden, a shipped one or a file; none: that of the simulator.", fixed=True
    ),
    ParameterSpec("latitude", DATUM[0], "Of the map's origin, deg.", fixed=True),
    ParameterSpec("longitude", DATUM[1], "Of the map's origin, deg.", fixed=True),
    ParameterSpec("stale_after_s", 0.5, "Wall-clock time without a measurement after which a warning is given, s."),
)

REPORT_PERIOD: Final = 1.0
COUNTED: Final = ("estimated", "fixes", "refused")
"""Kinds of messages: measurements that became a state; positions; those that are not finite or have no steering."""


class Estimate(rclpy.node.Node):
    """Publishes estimated states."""

    def __init__(self) -> None:
        """Read the parameters.

        Raises:
            ValueError: an invalid parameter. FileNotFoundError: no such file.
        """
        super().__init__("estimate", namespace=node_tools.NAMESPACE)
        values = node_tools.declare(self, SPECS)
        sensors = load_disturbances(values["sensors"]).raw_sensors
        if sensors is None:
            raise ValueError(f"parameter sensors: {values['sensors']!r} has no raw_sensors")
        self._raw_sensors = sensors
        self._datum = values["latitude"], values["longitude"]
        self._given_vehicle = load_vehicle(values["vehicle"]) if values["vehicle"] else None
        self._given_course = load_course(values["course"]) if values["course"] else None
        if self._given_course is not None and self._given_vehicle is None:
            raise ValueError("parameter course needs parameter vehicle: without a simulator nobody else names it")
        self._accept(values)
        self._start: EpisodeStart | None = None
        self._course: tuple[int, Course] | None = None
        self._estimator: Estimator | None = None
        self._encoders: JointState | None = None
        self._imu: Imu | None = None
        self._fix: tuple[int, float, float] | None = None
        self._fix_used: tuple[int, float, float] | None = None
        self._forces: list[Any] = []
        self._step = -1
        self._state: bytes | None = None
        self._heard_at = time.monotonic()
        self._counts = Counter(dict.fromkeys(COUNTED, 0))
        self._reported = self._counts.copy()
        self._stamp = 0
        self._states = publisher(self, "estimated_state")
        self._courses = publisher(self, "course") if self._given_course is not None else None
        self._diagnostics = node_tools.Diagnostics(self)
        if self._given_course is None:
            subscribe(self, EpisodeStart, "episode", self._on_episode, node_tools.LATCHED_QOS)
            subscribe(self, CourseMessage, "course", self._on_course, node_tools.LATCHED_QOS)
        subscribe(self, NavSatFix, "fix", self._on_fix, node_tools.STREAM_QOS)
        subscribe(self, JointState, "encoders", self._on_encoders, node_tools.STREAM_QOS)
        subscribe(self, Imu, "imu", self._on_imu, node_tools.STREAM_QOS)
        node_tools.on_change(self, SPECS, self._accept)
        node_tools.wall_timer(self, REPORT_PERIOD, self._report)
        self.get_logger().info("waiting for imu, encoders and fix")

    def finish(self) -> None:
        """Report a last time."""
        self._report()

    def _accept(self, values: dict[str, Any]) -> None:
        if not values["stale_after_s"] > 0.0:
            raise ValueError(f"parameter stale_after_s must be positive, got {values['stale_after_s']!r}")
        self._stale_after: float = values["stale_after_s"]

    # ------------------------------------------------------------------------------------------------------ messages

    def _on_episode(self, message: EpisodeStart) -> None:
        self._start, self._estimator = message, None

    def _on_course(self, message: CourseMessage) -> None:
        self._course = message.episode, course_from_message(message)

    def _on_fix(self, message: NavSatFix) -> None:
        stamp = time_from_message(message.header.stamp)
        if message.status.status < 0 or (self._fix is not None and stamp <= self._fix[0]):
            return
        place = from_geodetic(message.latitude, message.longitude, self._datum)
        if np.isfinite(place).all():
            self._fix = stamp, *place
            self._counts["fixes"] += 1
            self._try()  # the first one may be what all wait for

    def _on_encoders(self, message: JointState) -> None:
        if not set(ENCODERS) <= set(message.name):
            self._counts["refused"] += 1
            self.get_logger().error(f"encoders must name {', '.join(ENCODERS)}, got {message.name}", once=True)
            return
        self._encoders = message
        self._try()

    def _on_imu(self, message: Imu) -> None:
        stamp = time_from_message(message.header.stamp)
        if self._state is not None and stamp == self._stamp:  # shown again: the state was lost, or its answer
            self._states.publish(self._state)
            return
        force = message.linear_acceleration
        self._forces.append((force.x, force.y, force.z))
        self._imu = message
        self._try()

    # ----------------------------------------------------------------------------------------------------- estimates

    def _try(self) -> None:
        """Estimate the state of an instant once inertial unit and encoders have shown it."""
        if self._imu is None or self._encoders is None:
            return
        stamp = time_from_message(self._imu.header.stamp)
        if self._given_course is not None and self._start is None:
            self._begin_alone(stamp)
        if self._estimator is None and not self._begin():
            return
        assert self._estimator is not None, "it has begun"
        step = round((stamp - self._began) / self._period)
        if stamp < self._began or abs(stamp - time_from_message(self._encoders.header.stamp)) > self._period // 2:
            return
        self._heard_at = time.monotonic()
        if step <= self._step:
            return
        fix, self._fix_used = self._fix_of(), self._fix
        measured = self._measurement(step, fix)
        state = self._estimator.measure(measured)
        self._forces = []
        if state is None:
            self._counts["refused"] += 0 if fix is None else 1
            return
        self._step, self._stamp = step, stamp
        snapshot = self._estimator.snapshot(state, self._number, step)
        self._state = encode_state(snapshot, self._episode, stamp)
        self._states.publish(self._state)
        self._counts["estimated"] += 1

    def _fix_of(self) -> Fix | None:
        """Return the newest position, unless it was taken before."""
        if self._fix is None or self._fix == self._fix_used:
            return None
        stamp, x, y = self._fix
        return Fix(round((stamp - self._began) / self._period), x, y)

    def _measurement(self, step: int, fix: Fix | None) -> Measurement:
        imu, encoders = self._imu, self._encoders
        assert imu is not None, "asked for"
        assert encoders is not None, "asked for"
        turned = imu.angular_velocity
        steer, wheel = (encoders.name.index(name) for name in ENCODERS)
        force = np.mean(self._forces, axis=0) if self._forces else np.full(3, np.nan)
        return Measurement(
            step,
            np.array((turned.x, turned.y, turned.z)),
            force,
            encoders.position[steer],
            encoders.velocity[steer],
            encoders.velocity[wheel],
            fix,
        )

    # ------------------------------------------------------------------------------------------------------ episodes

    def _begin_alone(self, stamp: int) -> None:
        """Begin an episode without a simulator."""
        assert self._given_vehicle is not None, "the parameters are checked"
        assert self._given_course is not None, "asked for"
        start = EpisodeStart()
        start.header.stamp = node_tools.time_to_message(stamp)
        start.episode, start.vehicle = 1, self._given_vehicle.name
        start.control_period = self._given_vehicle.control_period
        start.preview_by_time, start.preview_interval, start.preview_count = (
            _PREVIEW.by_time, _PREVIEW.interval, _PREVIEW.count,
        )  # fmt: skip
        self._start, self._course = start, (1, self._given_course)
        assert self._courses is not None, "made with the course"
        self._courses.publish(course_to_message(self._given_course, 1, stamp))

    def _begin(self) -> bool:
        """Prepare for an episode; false while something of it is missing.

        Raises:
            CannotGoOn: a vehicle or a course that cannot be estimated.
        """
        start = self._start
        if start is None or self._course is None or self._course[0] != start.episode:
            return False
        course = self._course[1]
        preview = Preview(start.preview_by_time, start.preview_interval, start.preview_count)
        try:
            vehicle = self._given_vehicle or load_vehicle(start.vehicle)
            self._estimator = Estimator(vehicle, course, start.control_period, preview, self._raw_sensors)
        except (ValueError, FileNotFoundError) as error:
            raise CannotGoOn(f"cannot estimate this ride: {error}") from error
        self._began = time_from_message(start.header.stamp)
        self._period = round(start.control_period * NANOSECONDS)
        self._number, self._step, self._state = start.episode, -1, None
        self._fix_used = None
        if self._fix is not None and self._fix[0] < self._began:
            self._fix = None
        self._episode = Episode.of(vehicle, course, preview, start.control_period)
        self.get_logger().info(f"estimating episode {start.episode} of {vehicle.name!r} on {course.name!r}")
        return True

    # --------------------------------------------------------------------------------------------------- diagnostics

    def _report(self) -> None:
        """Report the last second on diagnostics, and in the log where something is wrong."""
        silence = time.monotonic() - self._heard_at
        new = self._counts - self._reported
        level, text = self._diagnostics.OK, "estimating"
        if new["refused"]:
            level, text = self._diagnostics.WARN, f"{new['refused']} measurements refused in the last second"
        elif self._state is None:
            text = "waiting for " + " ".join(self._missing())
        elif silence > self._stale_after:
            level, text = self._diagnostics.WARN, f"no measurement for {silence:.1f} s"
        if level == self._diagnostics.WARN:
            self.get_logger().warning(text)
        figures: dict[str, object] = {f"measurements_{name}": value for name, value in self._counts.items()}
        if self._estimator is not None and self._state is not None:
            figures |= self._estimator.figures()
        self._diagnostics.report(level, text, figures, self._stamp)
        self._reported = self._counts.copy()

    def _missing(self) -> list[str]:
        parts = {"imu": self._imu, "encoders": self._encoders, "fix": self._fix, "episode": self._start}
        return [name for name, part in (parts | {"course": self._course}).items() if part is None] or ["a measurement"]


def main() -> NoReturn:
    """Run the node until a signal; the exit code is 2 if the ride cannot be estimated."""
    node_tools.leave(node_tools.run_node("estimate", Estimate))


if __name__ == "__main__":
    main()
