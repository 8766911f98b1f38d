"""A recording as typed columns: states, commands, courses, events and latencies. Needs no ROS.

What a message means is said in ``bike_msgs``; here its fields keep their names and units. A recording may lack topics
and fields: what is not there becomes NaN or an empty list, and a warning says so. Where nobody recorded our states, the
motion is worked out from standard messages (`bike_analysis.read.motion`). Only a recording without any motion is
refused.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.clock import forward_time
from bike_analysis.read.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.read.container import Block, Container, RecordingError, RecordingFiles, examine_files
from bike_analysis.read.motion import MOTION_FIELDS, MOTION_TYPES, Motion, states_of_motion

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
_T = TypeVar("_T")
_TableT = TypeVar("_TableT", bound="Table")

STATE_TYPE: Final = "bike_msgs/msg/BikeState"
COMMAND_TYPE: Final = "bike_msgs/msg/BikeCommand"
TELEMETRY_TYPE: Final = "bike_msgs/msg/Telemetry"
DEFAULT_NAMESPACE: Final = "/bike"
EVENT_KINDS: Final = ("reset", "fall", "off_course", "wall", "lap", "finish", "sector", "back_on_course")
"""Names of ``RideEvent.kind``, by number."""

LARGEST: Final = 1e9
"""No place, angle, rate or torque of a ride is larger, in SI units; damaged numbers mostly are."""
LONGEST_COURSE: Final = 1e7
"""m."""

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")
_NOTES: Final = "ride_notes"
_DECODED_BY_MESSAGE: Final = ("bike_msgs/msg/Course", "bike_msgs/msg/RideEvent", "diagnostic_msgs/msg/DiagnosticArray")
_LATENCY_KEY: Final = re.compile(r"^(?:\w+_)?latency_(median|p50|p99)_(s|ms|us)$")
_COUNT: Final = re.compile(r"[0-9]{1,18}")
_SECONDS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


@dataclass(frozen=True)
class Table:
    """Columns of equal length, one row a message, in the order of recording.

    Attributes:
        order: Place of each message in the recording, counted over all topics.
        time_s: Simulated time from the message's stamp, s.
        episode: Number of the episode.
        step: Control steps since the episode's reset.
    """

    order: Integers
    time_s: Floats
    episode: Integers
    step: Integers

    def __len__(self) -> int:
        return len(self.order)

    def take(self, rows: NDArray[Any] | slice) -> Self:
        """Select rows.

        Args:
            rows: Mask, indices or slice.

        Returns:
            A table of the same kind with these rows.
        """
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(frozen=True)
class States(Table):
    """States of the vehicle (``bike_msgs/BikeState``), without preview and history.

    Signs: x forward, y left, z up; roll positive leaning right; yaw and steer positive to the left.

    Attributes:
        control_period: Time between two steps, s.
        steering_limit: Set value of the steering angle that a steering command of 1 asks for, rad. Of a superbike,
            whose command asks for a lean, the steering stop.
        x: Rear contact point in map, m.
        y: Rear contact point in map, m.
        yaw: rad, not wrapped.
        roll: rad, positive leaning right.
        steer: rad, positive to the left.
        rear_wheel_angle: rad, not wrapped, positive rolling forward.
        front_wheel_angle: The same for the front wheel, rad.
        roll_rate: rad/s.
        steer_rate: rad/s.
        front_wheel_rate: rad/s.
        pitch: Of the rear frame, rad, positive nose down.
        yaw_rate: rad/s, positive to the left.
        speed: Forward speed of the rear contact point, m/s.
        front_x: Front contact point in map, m.
        front_y: Front contact point in map, m.
        steering_command: Command applied during the step that led here, in [-1, 1].
        throttle_command: The same for throttle and brake.
        steer_torque: Torque of the steering drive, Nm.
        progress: Arc length of the nearest point of the course, m.
        course_length: Length of the course, m.
        course_closed: Whether the course ends where it begins.
        lateral_error: Signed distance of the rear contact to the course, m, positive left of it.
        front_progress: Arc length of the point of the course nearest to the front contact, m.
        front_lateral_error: Signed distance of the front contact to the course, m.
        heading_error: rad, positive left.
        curvature: Of the course at progress, 1/m, positive turning left.
        fallen: Whether the vehicle lies.
        off_course: Whether it left the course.
        finished: Whether it reached the end of the course.
    """

    control_period: Floats
    steering_limit: Floats
    x: Floats
    y: Floats
    yaw: Floats
    roll: Floats
    steer: Floats
    rear_wheel_angle: Floats
    front_wheel_angle: Floats
    roll_rate: Floats
    steer_rate: Floats
    front_wheel_rate: Floats
    pitch: Floats
    yaw_rate: Floats
    speed: Floats
    front_x: Floats
    front_y: Floats
    steering_command: Floats
    throttle_command: Floats
    steer_torque: Floats
    progress: Floats
    course_length: Floats
    course_closed: Flags
    lateral_error: Floats
    front_progress: Floats
    front_lateral_error: Floats
    heading_error: Floats
    curvature: Floats
    fallen: Flags
    off_course: Flags
    finished: Flags


@dataclass(frozen=True)
class Commands(Table):
    """Commands (``bike_msgs/BikeCommand``). Stamp, episode and step are those of the state that a command answers.

    Attributes:
        steering: In [-1, 1], positive to the left.
        throttle: In [-1, 1], positive accelerates.
    """

    steering: Floats
    throttle: Floats


@dataclass(frozen=True)
class Telemetry:
    """What tyres, engine, brakes and rider aids of a superbike did (``bike_msgs/Telemetry``), one row a message.

    Attributes:
        order: Place of each message in the recording.
        time_s: Simulated time, s.
        episode: Episode of the state that it belongs to.
        step: Step of that state.
        values: Numbers and flags by name of the message's field, in its units.
    """

    order: Integers
    time_s: Floats
    episode: Integers
    step: Integers
    values: dict[str, Floats]

    def take(self, rows: NDArray[Any] | slice) -> Telemetry:
        """Select rows by mask, indices or slice."""
        values = {name: column[rows] for name, column in self.values.items()}
        return Telemetry(self.order[rows], self.time_s[rows], self.episode[rows], self.step[rows], values)


TELEMETRY_COLUMNS: Final = {
    "acceleration_longitudinal": "tyre_acceleration_longitudinal_m_s2",
    "acceleration_lateral": "tyre_acceleration_lateral_m_s2",
    **{
        f"{wheel}_{name}": f"{wheel}_{name}{unit}"
        for wheel in ("rear", "front")
        for name, unit in (
            ("slip_angle", "_rad"),
            ("slip", ""),
            ("camber", "_rad"),
            ("load", "_n"),
            ("force_longitudinal", "_n"),
            ("force_lateral", "_n"),
            ("slip_use", ""),
            ("brake_force", "_n"),
            ("contact_lost", ""),
        )
    },
    "engine_power": "engine_power_w",
    "engine_force": "engine_force_n",
    "drag_force": "drag_force_n",
    "rider_offset": "rider_offset_m",
    "lean_reference": "lean_reference_rad",
    "traction_control": "traction_control",
    "anti_wheelie": "anti_wheelie",
    "brake_control": "brake_control",
    "anti_stoppie": "anti_stoppie",
}
"""Fields of ``bike_msgs/Telemetry`` that are read, with the names of their columns in tables."""

_TABLES: Final[dict[str, type[Table]]] = {STATE_TYPE: States, COMMAND_TYPE: Commands}
COLUMNS: Final[dict[str, tuple[str, ...]]] = {
    **{
        name: tuple(f.name for f in fields(kind) if f.name not in ("order", "time_s")) for name, kind in _TABLES.items()
    },
    TELEMETRY_TYPE: ("episode", "step", *TELEMETRY_COLUMNS),
    **MOTION_FIELDS,
}
"""Fields that are read as columns, by type of the message."""


@dataclass(frozen=True)
class Course:
    """A followed line (``bike_msgs/Course``).

    Attributes:
        order: Place of the message in the recording.
        episode: Episode in which it is followed.
        name: Its name.
        closed: Whether it ends where it begins.
        length: Its length, m.
        off_course_limit: Lateral error beyond which a ride counts as off course, m.
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
    off_course_limit: float
    s: Floats
    x: Floats
    y: Floats
    curvature: Floats
    width_left: Floats
    width_right: Floats
    section_names: tuple[str, ...]
    section_starts: Floats


@dataclass(frozen=True)
class Event:
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


@dataclass(frozen=True)
class Recording:
    """All that was read.

    Attributes:
        path: The file.
        namespace: Namespace of the vehicle's topics, empty for the root; None where no states of ours were recorded.
        vehicle: Name of the vehicle; empty where it was not recorded.
        states: Never empty.
        commands: Commands given.
        courses: Courses, in order.
        events: Events, in order.
        latencies: Reports of the policy's latency, in order.
        notes: What the recorder noted about the ride.
        truncated: Whether the file ended before its end (recorder killed, disk full, damage), or one of several is
            missing.
        warnings: What was missing or wrong, a sentence each.
        message_count: Messages read, of all topics.
        telemetry: What tyres and engine did, or None where it was not recorded.
        topics: Number of messages read by topic.
        dropped_messages: Messages that the recorder had to give up, as it reported them; None without a report.
    """

    path: Path
    namespace: str | None
    vehicle: str
    states: States
    commands: Commands
    courses: tuple[Course, ...]
    events: tuple[Event, ...]
    latencies: tuple[Latency, ...]
    notes: dict[str, str]
    truncated: bool
    warnings: tuple[str, ...]
    message_count: int
    telemetry: Telemetry | None = None
    topics: dict[str, int] = field(default_factory=dict)
    dropped_messages: int | None = None


def read_recording(path: str | os.PathLike[str], namespace: str | None = None) -> Recording:
    """Read a recording, whole or torn.

    Args:
        path: An MCAP file or a rosbag2 directory with one.
        namespace: Namespace of the vehicle's topics, ``/`` for the root; by default that of the only recorded vehicle,
            or ``/bike``.

    Returns:
        What could be read, up to the last whole chunk.

    Raises:
        FileNotFoundError: If the file does not exist.
        RecordingError: If it is not a recording of a ride, or nothing of it can be read.
        OSError: If the file cannot be read.
    """
    found = examine_files(path)
    try:
        return _Collector(found).read(namespace)
    except SchemaError as error:
        raise RecordingError(f"{found.files[0]}: {error}") from error


@dataclass
class _TopicReader:
    """Columns of one topic while they are being collected."""

    type_name: str
    columns: ColumnReader
    missing: tuple[str, ...]
    orders: list[Integers] = field(default_factory=list)
    log_times: list[Integers] = field(default_factory=list)

    @classmethod
    def of(cls, schema: MessageSchema) -> _TopicReader:
        """A reader of the columns that are wanted and recorded.

        Raises:
            SchemaError: If the type has none of them, or its definition cannot be understood.
        """
        wanted, available = COLUMNS[schema.name], schema.scalars()
        found = [name for name in (*_STAMP, *wanted) if name in available]
        if not set(found) & set(wanted):
            raise SchemaError(f"{schema.name} as recorded has none of the known fields; is it another version?")
        missing = tuple(name for name in wanted if name not in available)
        return cls(schema.name, ColumnReader(schema, found), missing)

    def add(self, block: Block, rows: Integers) -> None:
        good = rows[self.columns.add_block(block.contents, block.begin[rows], block.end[rows])]
        self.orders.append(good + block.first)
        self.log_times.append(block.log_time_ns[good])

    def finish(self) -> tuple[Integers, Floats, dict[str, NDArray[Any]]]:
        """Places in the recording, times in s and the columns by field."""
        columns = self.columns.finish()
        order, log_time = np.concatenate(self.orders), np.concatenate(self.log_times)
        stamp = [columns.pop(name, None) for name in _STAMP]
        log_time_s: Floats = np.asarray(1e-9 * log_time, dtype=np.float64)
        if stamp[0] is None or stamp[1] is None:
            return order, log_time_s, columns
        time_s: Floats = np.asarray(stamp[0] + 1e-9 * stamp[1], dtype=np.float64)
        if self.type_name in MOTION_TYPES:
            time_s = _with_unknown_times(time_s, log_time_s)
        return order, time_s, columns


def _with_unknown_times(time_s: Floats, log_time_s: Floats) -> Floats:
    """Stamps where those that are 0, which is what nodes write that do not know the time, come from the log times.

    The log time may be of another clock. So only its distance from the next message with a stamp counts, where there is
    one.
    """
    unknown, known = np.flatnonzero(time_s == 0.0), np.flatnonzero(time_s)
    if not len(known):
        return log_time_s
    near = known[np.minimum(np.searchsorted(known, unknown), len(known) - 1)]
    times = time_s.copy()
    times[unknown] = time_s[near] + (log_time_s[unknown] - log_time_s[near])
    return times


def _table_of(
    kind: type[_TableT], order: Integers, time_s: Floats, columns: dict[str, NDArray[Any]], count: int
) -> _TableT:
    """A table of columns; those that are absent are filled, and numbers that cannot be become NaN."""
    values: dict[str, NDArray[Any]] = {"order": order, "time_s": time_s}
    for f in fields(kind):
        if f.name in values:
            continue
        dtype, absent = _column_kind(str(f.type))
        column = columns.pop(f.name, None)
        if column is not None:
            values[f.name] = column.astype(dtype, copy=False)
            if dtype is np.float64:
                values[f.name][~(np.abs(values[f.name]) <= LARGEST)] = np.nan
        elif f.name == "step":
            values[f.name] = np.arange(count, dtype=np.int64)
        else:
            values[f.name] = np.full(count, 1 if f.name == "episode" else absent, dtype)
    return kind(**values)


def empty_table(kind: type[_TableT]) -> _TableT:
    """A table without rows."""
    nothing = np.empty(0, np.int64)
    return _table_of(kind, nothing, np.empty(0), {}, 0)


def _column_kind(annotation: str) -> tuple[type, float | bool | int]:
    """Element type of a column and the value that stands for an absent one."""
    return {"Floats": (np.float64, np.nan), "Integers": (np.int64, 0), "Flags": (np.bool_, False)}[annotation]


class _Collector:
    """Sorts the messages of a recording into tables and lists."""

    def __init__(self, found: RecordingFiles) -> None:
        self._path = found.files[0]
        self._containers = [Container(file) for file in found.files]
        self._incomplete = bool(found.warnings)
        self._warnings: list[str] = list(found.warnings)
        self._topics: dict[str, _TopicReader] = {}
        self._others: dict[str, list[tuple[int, Any]]] = {}
        self._vehicles: dict[str, str] = {}
        self._counts: dict[str, int] = {}
        self._count = 0

    def read(self, namespace: str | None) -> Recording:
        for box in self._containers:
            self._read_file(box)
        chosen = self._choose(namespace)
        states = self._states(f"{chosen}/state") if chosen is not None else self._foreign()
        name = chosen or ""
        reports = list(self._reports())
        return Recording(
            path=self._path,
            namespace=chosen,
            vehicle=self._vehicles.get(f"{name}/state", ""),
            states=states,
            commands=self._table(f"{name}/command", Commands, expected=chosen is not None),
            courses=tuple(self._converted(f"{name}/course", _course)),
            events=tuple(self._converted(f"{name}/events", _event)),
            latencies=tuple(x for x in map(_latency, _own(reports, name)) if x is not None),
            notes=self._notes(),
            truncated=self._incomplete or any(box.truncated or box.damaged_chunks for box in self._containers),
            warnings=tuple(self._warnings),
            message_count=self._count,
            telemetry=self._telemetry(f"{name}/telemetry"),
            topics=dict(sorted(self._counts.items())),
            dropped_messages=_dropped(reports, name),
        )

    def _notes(self) -> dict[str, str]:
        return {name: text for box in self._containers for name, text in box.metadata.get(_NOTES, {}).items()}

    # ------------------------------------------------------------------------------------------------ one file

    def _read_file(self, box: Container) -> None:
        schemas: dict[int, MessageSchema | None] = {}
        before = self._count
        for block in box.blocks():
            block = replace(block, first=block.first + before)
            for channel_id in np.unique(block.channel).tolist():
                if channel_id not in schemas:
                    schemas[channel_id] = self._make_schema(box, channel_id)
                schema = schemas[channel_id]
                if schema is not None:
                    rows = np.flatnonzero(block.channel == channel_id)
                    self._add(box.channels[channel_id].topic, schema, block, rows)
            self._count += len(block)
        for channel_id, count in box.counts.items():
            if channel_id in box.channels:
                topic = box.channels[channel_id].topic
                self._counts[topic] = self._counts.get(topic, 0) + count
            else:
                self._warn(f"{count} messages are skipped: the file does not say what channel {channel_id} is")
        of = f" of {box.path.name}" if len(self._containers) > 1 else ""
        if box.damaged_chunks:
            many = "part is" if box.damaged_chunks == 1 else "parts are"
            self._warn(f"{box.damaged_chunks} {many}{of} damaged and left out: {box.damage}", first=True)
        if box.truncated:
            torn = box.path.name if of else "the recording"
            self._warn(f"{torn} is torn: {box.reason}; read up to its last whole chunk", first=True)

    def _add(self, topic: str, schema: MessageSchema, block: Block, rows: Integers) -> None:
        """Sort messages of one topic in; those that do not fit their type are left out with a warning."""
        if schema.name in COLUMNS:
            reader = self._topics.get(topic)
            if reader is None:
                try:
                    reader = self._topics[topic] = _TopicReader.of(schema)
                except SchemaError as error:
                    self._warn(f"topic {topic} is skipped: {error}")
                    return
                self._vehicles[topic] = self._vehicle(schema, block.data(int(rows[0])))
            if reader.type_name == schema.name:
                reader.add(block, rows)
                if reader.columns.damage:
                    self._warn(f"topic {topic}: messages are left out: {reader.columns.damage}")
            return
        for row in rows.tolist():
            try:
                self._others.setdefault(topic, []).append((block.first + row, schema.decode(block.data(row))))
            except SchemaError as error:
                self._warn(f"topic {topic}: messages are left out: {error}")

    @staticmethod
    def _vehicle(schema: MessageSchema, data: bytes) -> str:
        if schema.name != STATE_TYPE:
            return ""
        try:
            return str(getattr(schema.decode(data), "vehicle", ""))
        except SchemaError:
            return ""

    def _make_schema(self, box: Container, channel_id: int) -> MessageSchema | None:
        """Schema of a channel that is worth decoding, else None."""
        channel = box.channels.get(channel_id)
        schema = box.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None:
            return None
        if schema.name not in COLUMNS and schema.name not in _DECODED_BY_MESSAGE:
            return None
        if channel.message_encoding != "cdr" or schema.encoding != "ros2msg":
            self._warn(f"topic {channel.topic} is skipped: it is {channel.message_encoding} by {schema.encoding}")
            return None
        try:
            return MessageSchema(schema.name, schema.data.decode("utf-8", errors="replace"))
        except SchemaError as error:
            self._warn(f"topic {channel.topic} is skipped: {error}")
            return None

    def _warn(self, text: str, first: bool = False) -> None:
        one_line = " ".join(text.split())
        if one_line not in self._warnings:
            self._warnings.insert(0 if first else len(self._warnings), one_line)

    # ---------------------------------------------------------------------------------------------- all of them

    def _converted(self, topic: str, convert: Callable[[int, Any], _T]) -> Iterator[_T]:
        """Messages of a topic, converted; those of another version of the type are left out with a warning."""
        for order, message in self._others.get(topic, []):
            try:
                yield convert(order, message)
            except (AttributeError, TypeError, ValueError) as error:
                self._warn(f"a message of {topic} is left out: damaged, or of another version ({error})")

    def _choose(self, namespace: str | None) -> str | None:
        """Namespace of the vehicle to be read; None where there are no states of ours, but motion of somebody's."""
        topics = sorted(topic for topic, reader in self._topics.items() if reader.type_name == STATE_TYPE)
        found = sorted(topic.removesuffix("/state") for topic in topics if topic.endswith("/state"))
        names = ", ".join(name or "/" for name in found)
        if namespace is not None:
            chosen = f"/{namespace.strip('/')}".rstrip("/")
            if chosen not in found:
                raise RecordingError(f"{self._path} has no states of {chosen or '/'}; it has {names or 'none'}")
            return chosen
        if found:
            return self._one_of(found, names)
        elsewhere = f"states are read from a topic named state, here they are on {', '.join(topics)}"
        if any(reader.type_name in MOTION_TYPES for reader in self._topics.values()):
            if topics:
                self._warn(elsewhere)
            return None
        raise RecordingError(f"{self._path}: {elsewhere}" if topics else self._no_states())

    def _one_of(self, found: Sequence[str], names: str) -> str:
        """The only vehicle, or the usual one, with a warning that names the others."""
        if len(found) == 1:
            return found[0]
        if DEFAULT_NAMESPACE not in found:
            raise RecordingError(f"{self._path} has several vehicles, {names}: name one of them with --vehicle")
        self._warn(f"several vehicles were recorded, {names}: {DEFAULT_NAMESPACE} is read, --vehicle chooses another")
        return DEFAULT_NAMESPACE

    def _no_states(self) -> str:
        if any(box.truncated for box in self._containers):
            return f"{self._path} is torn before its first whole chunk of states; nothing of the ride can be read"
        topics = {topic: kind for box in self._containers for topic, kind in box.topics().items()}
        skipped = next((text for text in self._warnings if "skipped" in text or "damaged" in text), "")
        if skipped:
            return f"{self._path} holds no state that can be read: {skipped}"
        if STATE_TYPE in topics.values():
            return f"{self._path} holds no state: nothing was ridden while it was recorded"
        listed = ", ".join(f"{t} ({k})" for t, k in sorted(topics.items())[:5]) or "no topics at all"
        wanted = ", ".join((STATE_TYPE, *MOTION_TYPES))
        return f"{self._path} is not a recording of a ride: no topic has one of the types {wanted}; it has {listed}"

    def _states(self, topic: str) -> States:
        """States, whose time runs forward within each ride."""
        states = self._table(topic, States)
        time_s, told = forward_time(states.time_s, states.episode, states.step, states.control_period)
        for text in told:
            self._warn(text)
        return replace(states, time_s=time_s)

    def _reports(self) -> Iterator[_Report]:
        """What nodes reported on diagnostics, one status each."""
        for statuses in self._converted("/diagnostics", _statuses):
            yield from statuses

    def _table(self, topic: str, kind: type[_TableT], expected: bool = True) -> _TableT:
        reader = self._topics.pop(topic, None)
        if reader is None or _TABLES.get(reader.type_name) is not kind:
            if expected:
                self._warn(f"topic {topic} was not recorded")
            return empty_table(kind)
        if reader.missing:
            self._warn(f"{topic} has no {', '.join(reader.missing)}; what needs them is left out")
        order, time_s, columns = reader.finish()
        if not len(order) and kind is States:
            raise RecordingError(f"{self._path} holds no state that can be read: {reader.columns.damage}")
        return _table_of(kind, order, time_s, columns, len(order))

    def _telemetry(self, topic: str) -> Telemetry | None:
        reader = self._topics.pop(topic, None)
        if reader is None or reader.type_name != TELEMETRY_TYPE:
            return None
        order, time_s, columns = reader.finish()
        episode, step = (columns.pop(n, np.zeros(len(order))).astype(np.int64) for n in ("episode", "step"))
        return Telemetry(
            order, time_s, episode, step, {n: c.astype(np.float64, copy=False) for n, c in columns.items()}
        )

    def _foreign(self) -> States:
        """States worked out from standard messages, with a sentence that says of which."""
        motions = []
        for topic, reader in self._topics.items():
            if reader.type_name in MOTION_TYPES:
                motions.append(Motion(topic, reader.type_name, *reader.finish()))
        states, told = states_of_motion(motions)
        if not len(states["time_s"]):
            raise RecordingError(f"{self._path} holds no motion that can be read: {told}")
        self._warn(told)
        order = states.pop("order").astype(np.int64)
        return _table_of(States, order, states.pop("time_s"), states, len(order))


def _floats(values: Any) -> Floats:
    return np.array(values, dtype=np.float64)


def _course(order: int, message: Any) -> Course:
    """A course.

    Raises:
        ValueError: If its columns do not describe one.
    """
    course = Course(
        order=order,
        episode=int(message.episode),
        name=str(message.name),
        closed=bool(message.closed),
        length=float(message.length),
        off_course_limit=float(message.off_course_limit),
        s=_floats(message.s),
        x=_floats(message.x),
        y=_floats(message.y),
        curvature=_floats(message.curvature),
        width_left=_floats(message.width_left),
        width_right=_floats(message.width_right),
        section_names=tuple(str(name) for name in message.section_names),
        section_starts=_floats(message.section_starts),
    )
    if not 0.0 < course.length <= LONGEST_COURSE:
        raise ValueError(f"a course of {course.length:.3g} m")
    if not len(course.s) == len(course.x) == len(course.y):
        raise ValueError("columns of unequal length")
    if len(course.section_names) != len(course.section_starts):
        raise ValueError(f"{len(course.section_names)} names for {len(course.section_starts)} sections")
    for name in ("s", "x", "y", "curvature", "width_left", "width_right", "section_starts"):
        if not (np.abs(getattr(course, name)) <= LARGEST).all():
            raise ValueError(f"{name} has values that cannot be")
    return course


def _event(order: int, message: Any) -> Event:
    kind = int(message.kind)
    return Event(
        order=order,
        episode=int(message.episode),
        step=int(message.step),
        kind=EVENT_KINDS[kind] if kind < len(EVENT_KINDS) else f"kind_{kind}",
        time_s=float(message.time),
        progress_m=float(message.progress),
        value=float(message.value),
        text=str(message.text),
    )


@dataclass(frozen=True)
class _Report:
    """One status of a DiagnosticArray: place in the recording, name of who reports, values by key."""

    order: int
    name: str
    values: dict[str, str]


def _statuses(order: int, message: Any) -> list[_Report]:
    return [
        _Report(order, str(status.name), {str(pair.key): str(pair.value) for pair in status.values})
        for status in message.status
    ]


def _own(reports: Sequence[_Report], namespace: str) -> Sequence[_Report]:
    """Reports of nodes of a namespace, which their names begin with; all of them where there are none such."""
    prefix = f"{namespace.strip('/')}/".lstrip("/")
    names = [report.name.lstrip("/") for report in reports]
    inside = [name.startswith(prefix) if prefix else "/" not in name for name in names]
    return [report for report, mine in zip(reports, inside, strict=True) if mine] or reports


def _latency(report: _Report) -> Latency | None:
    """Latency in a report: values named ``latency_median_ms`` and ``latency_p99_ms`` (or in s or us)."""
    found: dict[str, float] = {}
    for key, text in report.values.items():
        match = _LATENCY_KEY.match(key)
        if match is None:
            continue
        try:
            value = float(text) * _SECONDS[match[2]]
        except ValueError:
            continue
        found["p99" if match[1] == "p99" else "median"] = value
    if not found:
        return None
    return Latency(report.order, found.get("median", np.nan), found.get("p99", np.nan))


def _dropped(reports: Sequence[_Report], namespace: str) -> int | None:
    """Messages that the recorder dropped, from its reports: that of the vehicle, where several report."""
    counted = [report for report in reports if _COUNT.fullmatch(report.values.get("messages_dropped", ""))]
    return max((int(report.values["messages_dropped"]) for report in _own(counted, namespace)), default=None)
