"""Recorded messages as columns and records: states, commands and telemetry, motion of other bicycles, courses, events.

States, commands and telemetry become tables with one row per message, by `bike_sim.schema`. Pose, velocity, inertial
and satellite data of other bicycles are converted to columns of states; all else of those stays unknown (NaN). Their
signs are those of REP-103 (x forward, y left, z up), in which a roll about x leans right where it is positive, as in
``bike_msgs``. Beginnings, courses, events and diagnostics are decoded one by one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.lap_timing import EventKind
from bike_sim.schema import BIKE_STATE, FLAG, LIMITS, SUSPENSION, TELEMETRY, Quantity

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

ODOMETRY: Final = "nav_msgs/msg/Odometry"
SATELLITE: Final = "sensor_msgs/msg/NavSatFix"
INERTIAL: Final = "sensor_msgs/msg/Imu"

_MOTION: Final[dict[str, dict[str, str]]] = {
    ODOMETRY: {
        **{axis: f"pose.pose.position.{axis}" for axis in "xy"},
        **{f"q{axis}": f"pose.pose.orientation.{axis}" for axis in "xyzw"},
        **{"forward": "twist.twist.linear.x", "left": "twist.twist.linear.y"},
        **{"roll_rate": "twist.twist.angular.x", "yaw_rate": "twist.twist.angular.z"},
    },
    SATELLITE: {"latitude": "latitude", "longitude": "longitude", "status": "status.status"},
    INERTIAL: {
        **{f"q{axis}": f"orientation.{axis}" for axis in "xyzw"},
        **{"roll_rate": "angular_velocity.x", "yaw_rate": "angular_velocity.z"},
    },
}
"""Fields that are read of messages with motion, by type, the most informative first, and by name."""
MOTION_FIELDS: Final = {kind: tuple(fields.values()) for kind, fields in _MOTION.items()}
MOTION_TYPES: Final = tuple(_MOTION)

NEW_RIDE_AFTER: Final = 10.0
"""Silence after which another ride begins, s."""
EARTH_RADIUS: Final = 6_371_008.8
"""Mean radius of the Earth, m (IUGG)."""


class Motion(NamedTuple):
    """One recorded topic of motion.

    Attributes:
        topic: Its name.
        type_name: One of `MOTION_TYPES`.
        order: Place of each message in the recording.
        time_s: Time of each message, s.
        columns: Values by field; absent ones are missing.
    """

    topic: str
    type_name: str
    order: Integers
    time_s: Floats
    columns: dict[str, NDArray[Any]]


def states_of_motion(motions: Sequence[Motion]) -> tuple[dict[str, NDArray[Any]], str]:
    """Compute the columns of states.

    Args:
        motions: Recorded topics. Of each type the one with the most messages counts; odometry gives the rows, or else
            satellite fixes, or else inertial data; the others are interpolated in time.

    Returns:
        Columns by field of `QUANTITIES`, with ``order`` and ``time_s``; and a sentence that says
        what they were computed from.
    """
    states: dict[str, NDArray[Any]] = {}
    used = []
    for kind in MOTION_TYPES:
        usable = [(motion, np.unique(motion.time_s, return_index=True)[1]) for motion in motions]
        usable = [(motion, rows) for motion, rows in usable if motion.type_name == kind and len(rows)]
        if not usable:
            continue
        motion, rows = max(usable, key=lambda one: len(one[1]))  # in the order of time, each time once
        time = motion.time_s[rows]
        states = states or {"order": motion.order[rows], "time_s": time}
        used.append(f"{motion.topic} ({kind})")
        nothing = np.full(len(time), np.nan)
        recorded = {name: np.asarray(c[rows], dtype=np.float64) for name, c in motion.columns.items()}
        fields = {name: recorded.get(field, nothing) for name, field in _MOTION[kind].items()}
        for name, values in _quantities(fields).items():
            there = np.isfinite(values)
            if name not in states and there.sum() > 1:
                outside = {"left": np.nan, "right": np.nan}
                states[name] = np.interp(states["time_s"], time[there], values[there], **outside)
    if not states:
        return {"time_s": np.empty(0), "order": np.empty(0)}, "no message of its topics can be decoded"
    _complete(states)
    words = f"the motion is that of {' and '.join(used)}, without course, steering and command"
    return states, f"no states of ours were recorded: {words}"


def _quantities(fields: dict[str, Floats]) -> dict[str, Floats]:
    """Quantities of states from the fields of one type of messages.

    Satellite fixes become metres east and north of the first one, on a plane that touches the Earth there; a message
    without a fix (status below 0) has no position.
    """
    found = {name: values for name, values in fields.items() if name in ("x", "y", "roll_rate", "yaw_rate")}
    if "forward" in fields:
        found["speed"] = np.hypot(fields["forward"], fields["left"])
    if "qw" in fields:
        found["roll"], found["pitch"], found["yaw"] = _angles(*(fields[f"q{axis}"] for axis in "xyzw"))
    if "status" in fields:
        fixed = np.where(fields["status"] < 0.0, np.nan, 1.0)
        latitude, longitude = (fixed * np.radians(fields[name]) for name in ("latitude", "longitude"))
        known = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
        if len(known):
            first = known[0]
            found["x"] = EARTH_RADIUS * np.cos(latitude[first]) * (longitude - longitude[first])
            found["y"] = EARTH_RADIUS * (latitude - latitude[first])
    return found


def _angles(x: Floats, y: Floats, z: Floats, w: Floats) -> tuple[Floats, Floats, Floats]:
    """Roll, pitch and yaw (not wrapped) of unit quaternions, rad; NaN for an invalid quaternion.

    Rotations about z, then y, then x, as REP-103 has them.
    """
    norm = np.sqrt(x * x + y * y + z * z + w * w)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y, z, w = (np.where(norm > 0.5, part / norm, np.nan) for part in (x, y, z, w))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, _unwrapped(yaw)


def _unwrapped(angle: Floats) -> Floats:
    """An unwrapped angle, rad; NaN is kept."""
    known = np.isfinite(angle)
    angle[known] = np.unwrap(angle[known])
    return angle


def _complete(states: dict[str, NDArray[Any]]) -> None:
    """Add derived columns: speed and heading from positions, rides and period from times."""
    time = states["time_s"]
    if len(time) > 1 and "x" in states and "y" in states:
        across, along = np.gradient(states["x"], time), np.gradient(states["y"], time)
        if not np.nan_to_num(states.get("speed", np.zeros(1))).any():
            states["speed"] = np.hypot(across, along)
        if "yaw" not in states:
            states["yaw"] = _unwrapped(np.arctan2(along, across))
    steps = np.diff(time)
    silences = steps > NEW_RIDE_AFTER
    states["episode"] = np.concatenate([[1], 1 + np.cumsum(silences)])
    begins = np.flatnonzero(np.append(True, silences))
    states["step"] = np.arange(len(time)) - begins[states["episode"] - 1]  # each ride begins with its step 0
    usual = float(np.median(steps)) if len(steps) else np.nan
    states["control_period"] = np.full(len(time), usual)


STATE_TYPE: Final = "bike_msgs/msg/BikeState"
COMMAND_TYPE: Final = "bike_msgs/msg/BikeCommand"
GRIP_TYPE: Final = "bike_msgs/msg/GripEstimate"
TELEMETRY_TYPE: Final = "bike_msgs/msg/Telemetry"

LARGEST: Final = 1e9
"""No place, angle, rate or torque of a ride is larger, in SI units; damaged numbers mostly are."""
STATE_QUANTITIES: Final = tuple(q for q in BIKE_STATE if q.name not in ("preview_spacing", *LIMITS.names))
"""Numbers of a state that are read."""
QUANTITIES: Final[dict[str, tuple[Quantity, ...]]] = {
    STATE_TYPE: STATE_QUANTITIES,
    COMMAND_TYPE: (
        Quantity("steering", "1", -1, "in [-1, 1], positive to the left"),
        Quantity("throttle", "1", 1, "in [-1, 1], positive accelerates"),
    ),
    TELEMETRY_TYPE: TELEMETRY.quantities,
    GRIP_TYPE: (
        Quantity("grip", "1", 1, "factor on the friction of the known tyres that the rider infers"),
        Quantity("expected", "1", 1, "factor that the rider plans for, here and shortly ahead"),
        Quantity("deviation", "1", 1, "standard deviation of the error of `grip`"),
    ),
}
"""Numbers that are read, by type of the message."""
COLUMNS: Final[dict[str, tuple[str, ...]]] = {
    **{kind: ("episode", "step", *(q.name for q in quantities)) for kind, quantities in QUANTITIES.items()},
    **MOTION_FIELDS,
}
"""Fields that are read as columns, by type of the message."""


@dataclass(frozen=True)
class Table:
    """Columns of equal length, one row per message, in the order of recording.

    A column of `values` is an attribute, too: ``states.roll``. Of states and commands there are all of `QUANTITIES`,
    those that were not recorded NaN or False. Of telemetry there are the recorded ones. States of a machine with
    suspension also have those of `bike_sim.schema.SUSPENSION`.

    Attributes:
        order: Place of each message in the recording, counted over all topics.
        time_s: Simulated time from the message's stamp, s.
        episode: Number of the episode.
        step: Control steps since the episode's reset; of commands and telemetry those of the state they belong to.
        values: Numbers and flags by name of the message's field, in the units and signs of `bike_sim.schema`.
    """

    order: Integers
    time_s: Floats
    episode: Integers
    step: Integers
    values: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.order)

    def __getattr__(self, name: str) -> NDArray[Any]:
        values: dict[str, NDArray[Any]] = self.__dict__.get("values", {})
        if name not in values:
            raise AttributeError(f"no column {name!r}; there are {', '.join(values)}")
        return values[name]

    def take(self, rows: NDArray[Any] | slice) -> Table:
        """Select rows by mask, indices or slice."""
        values = {name: column[rows] for name, column in self.values.items()}
        return Table(self.order[rows], self.time_s[rows], self.episode[rows], self.step[rows], values)

    def with_columns(self, **columns: NDArray[Any]) -> Table:
        """The same with other values in some columns."""
        return replace(self, values=self.values | columns)


def make_table(type_name: str, order: Integers, time_s: Floats, columns: dict[str, NDArray[Any]]) -> Table:
    """A table of the columns of a type's messages, where impossible numbers become NaN; telemetry is kept as it is."""
    count = len(order)
    episode = columns.get("episode", np.ones(count)).astype(np.int64, copy=False)
    step = columns.get("step", np.arange(count)).astype(np.int64, copy=False)
    values: dict[str, NDArray[Any]] = {}
    for quantity in QUANTITIES[type_name]:
        column = columns.get(quantity.name)
        if column is None and type_name == TELEMETRY_TYPE:
            continue
        if quantity.unit == FLAG and type_name != TELEMETRY_TYPE:
            values[quantity.name] = np.zeros(count, np.bool_) if column is None else column.astype(np.bool_, copy=False)
            continue
        numbers = np.full(count, np.nan) if column is None else column.astype(np.float64, copy=False)
        if type_name != TELEMETRY_TYPE:
            numbers[~(np.abs(numbers) <= LARGEST)] = np.nan
        values[quantity.name] = numbers
    return Table(order, time_s, episode, step, values)


def suspension_of(signals: Floats, names: Sequence[str]) -> dict[str, Floats]:
    """Columns of what gives way, of those that ever did.

    Args:
        signals: Of each state, shape (states, signals).
        names: Of the signals, as `EpisodeStart` has them; empty where it was not recorded.
    """
    if len(names) != signals.shape[1]:
        return {}
    places = {q.name: names.index(q.column) for q in SUSPENSION if q.column in names}
    return {name: signals[:, place] for name, place in places.items() if np.any(signals[:, place])}


EVENT_KINDS: Final = tuple(kind.name.lower() for kind in EventKind)
"""Names of ``RideEvent.kind``, by number."""
MAX_COURSE: Final = 1e7
"""m."""
DECODED_BY_MESSAGE: Final = (
    *("bike_msgs/msg/EpisodeStart", "bike_msgs/msg/Course", "bike_msgs/msg/RideEvent"),
    "diagnostic_msgs/msg/DiagnosticArray",
    "std_msgs/msg/String",
)
"""Types of these messages."""

_COURSE_ARRAYS: Final = ("s", "x", "y", "curvature", "width_left", "width_right", "section_starts")
_LATENCY_KEY: Final = re.compile(r"^(?:\w+_)?latency_(median|p50|p99)_(s|ms|us)$")
_COUNT: Final = re.compile(r"[0-9]{1,18}")
_SECONDS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


@dataclass(frozen=True)
class Simulation:
    """Engine and step by which the motion was computed (``bike_msgs/EpisodeStart``).

    Attributes:
        engine: Physics engine; empty where it was not recorded.
        time_step: Integration step, s; 0 where it was not recorded.
    """

    engine: str
    time_step: float


@dataclass(frozen=True)
class RecordedCourse:
    """A followed line (``bike_msgs/Course``).

    Attributes:
        order: Place of the message in the recording.
        episode: Episode in which it is followed.
        name: Its name.
        closed: Whether it ends where it begins.
        length: Its length, m.
        s: Arc length of each sample, m.
        x: Samples in map, m.
        y: Samples in map, m.
        curvature: 1/m, positive turning left.
        width_left: From the line to the left limit, m; empty without limits.
        width_right: From the line to the right limit, m; empty without limits.
        section_names: Names of its sections, in order.
        section_starts: Arc length at which each section begins, m.
    """

    order: int
    episode: int
    name: str
    closed: bool
    length: float
    s: Floats
    x: Floats
    y: Floats
    curvature: Floats
    width_left: Floats
    width_right: Floats
    section_names: tuple[str, ...]
    section_starts: Floats

    @property
    def heading(self) -> Floats:
        """Direction at the samples, rad, not wrapped."""
        return np.asarray(np.unwrap(np.arctan2(np.gradient(self.y), np.gradient(self.x))), dtype=np.float64)


@dataclass(frozen=True)
class RecordedEvent:
    """Something that happened in a ride (``bike_msgs/RideEvent``).

    Attributes:
        order: Place of the message in the recording.
        episode: Episode.
        step: Step that reported it.
        kind: One of `EVENT_KINDS`, or ``kind_<number>`` if it is newer than this program.
        time_s: Time since the reset, s.
        progress_m: Where, as arc length, m.
        value: See ``RideEvent.msg``; depends on the kind.
        text: One sentence for people.
    """

    order: int
    episode: int
    step: int
    kind: str
    time_s: float
    progress_m: float
    value: float
    text: str


@dataclass(frozen=True)
class Latency:
    """Wall-clock time that the policy took to answer, as it reported it on diagnostics.

    Attributes:
        order: Place of the message in the recording.
        median_s: Median, s; NaN where it was not reported.
        p99_s: 99th percentile, s; NaN where it was not reported.
    """

    order: int
    median_s: float
    p99_s: float


def simulation_of(_: int, message: Any) -> Simulation:
    """Engine and step of an episode; empty and 0 where it does not state them.

    Raises:
        ValueError: If its step is no time.
    """
    time_step = float(getattr(message, "time_step", 0.0))
    if not 0.0 <= time_step <= LARGEST:
        raise ValueError(f"a time step of {time_step:.3g} s")
    return Simulation(str(getattr(message, "engine", "")), time_step)


def signal_names_of(_: int, message: Any) -> tuple[str, ...]:
    """Names of the signals of an episode's states; none where it does not state them."""
    return tuple(map(str, getattr(message, "signal_names", ())))


def course_of(order: int, message: Any) -> RecordedCourse:
    """A course.

    Raises:
        ValueError: If its columns do not describe one.
    """
    arrays: dict[str, Any] = {name: np.array(getattr(message, name), dtype=np.float64) for name in _COURSE_ARRAYS}
    course = RecordedCourse(
        order,
        *(int(message.episode), str(message.name), bool(message.closed), float(message.length)),
        section_names=tuple(map(str, message.section_names)),
        **arrays,
    )
    if not 0.0 < course.length <= MAX_COURSE:
        raise ValueError(f"a course of {course.length:.3g} m")
    if not len(course.s) == len(course.x) == len(course.y):
        raise ValueError("columns of unequal length")
    if len(course.section_names) != len(course.section_starts):
        raise ValueError(f"{len(course.section_names)} names for {len(course.section_starts)} sections")
    for name in _COURSE_ARRAYS:
        if not (np.abs(getattr(course, name)) <= LARGEST).all():
            raise ValueError(f"{name} has values that cannot be")
    return course


def event_of(order: int, message: Any) -> RecordedEvent:
    """An event."""
    kind = int(message.kind)
    name = EVENT_KINDS[kind] if kind < len(EVENT_KINDS) else f"kind_{kind}"
    numbers = (float(message.time), float(message.progress), float(message.value))
    return RecordedEvent(order, int(message.episode), int(message.step), name, *numbers, str(message.text))


@dataclass(frozen=True)
class Report:
    """One status of a DiagnosticArray: place in the recording, name of who reports, values by key."""

    order: int
    name: str
    values: dict[str, str]


def reports_of(order: int, message: Any) -> list[Report]:
    """The statuses of a DiagnosticArray."""
    return [
        Report(order, str(status.name), {str(pair.key): str(pair.value) for pair in status.values})
        for status in message.status
    ]


def own_reports(reports: Sequence[Report], namespace: str) -> Sequence[Report]:
    """Reports of the nodes in a namespace; all reports if there are none."""
    prefix = f"{namespace.strip('/')}/".lstrip("/")
    names = [report.name.lstrip("/") for report in reports]
    inside = [name.startswith(prefix) if prefix else "/" not in name for name in names]
    return [report for report, mine in zip(reports, inside, strict=True) if mine] or reports


def latency_of(report: Report) -> Latency | None:
    """Latency in a report: values named ``latency_median_ms`` and ``latency_p99_ms`` (or in s or us)."""
    found: dict[str, float] = {}
    for key, text in report.values.items():
        match = _LATENCY_KEY.match(key)
        with suppress(ValueError):
            if match is not None:
                found["p99" if match[1] == "p99" else "median"] = float(text) * _SECONDS[match[2]]
    return Latency(report.order, found.get("median", np.nan), found.get("p99", np.nan)) if found else None


def dropped_messages(reports: Sequence[Report], namespace: str) -> int | None:
    """Messages that the recorder dropped, from its reports: that of the vehicle, where several report."""
    counted = [report for report in reports if _COUNT.fullmatch(report.values.get("messages_dropped", ""))]
    return max((int(report.values["messages_dropped"]) for report in own_reports(counted, namespace)), default=None)
