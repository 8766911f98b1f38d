"""A recording as typed columns: states, commands, courses, events and latencies. Needs no ROS.

What a message means is said in ``bike_msgs``; here its fields keep their names and units. A recording may lack topics
and fields: what is not there becomes NaN or an empty list, and a warning says so. Only a recording without states is
refused.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_analysis.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.container import Container, RawMessage, RecordingError, find_file

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
_T = TypeVar("_T")

STATE_TYPE: Final = "bike_msgs/msg/BikeState"
COMMAND_TYPE: Final = "bike_msgs/msg/BikeCommand"
DEFAULT_NAMESPACE: Final = "/bike"
EVENT_KINDS: Final = ("reset", "fall", "off_course", "wall", "lap", "finish", "sector", "back_on_course")
"""Names of ``RideEvent.kind``, by number."""

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")
_REQUIRED: Final = {
    STATE_TYPE: (*_STAMP, "episode", "step", "x", "y", "lateral_error"),
    COMMAND_TYPE: (*_STAMP, "episode", "step", "steering"),
}
_DECODED_BY_MESSAGE: Final = ("bike_msgs/msg/Course", "bike_msgs/msg/RideEvent", "diagnostic_msgs/msg/DiagnosticArray")
_LATENCY_KEY: Final = re.compile(r"^(?:\w+_)?latency_(median|p50|p99)_(s|ms|us)$")
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
        steering_limit: Set value of the steering angle that a steering command of 1 asks for, rad.
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
        time_s: Stamp of the report, s.
        median_s: Median, s; NaN where it was not reported.
        p99_s: 99th percentile, s; NaN where it was not reported.
    """

    order: int
    time_s: float
    median_s: float
    p99_s: float


@dataclass(frozen=True)
class Recording:
    """All that was read.

    Attributes:
        path: The file.
        namespace: Namespace of the vehicle's topics.
        vehicle: Name of the vehicle; empty where it was not recorded.
        states: Never empty.
        commands: Commands given.
        courses: Courses, in order.
        events: Events, in order.
        latencies: Reports of the policy's latency, in order.
        notes: What the recorder noted about the ride.
        truncated: Whether the file ended before its end (recorder killed, disk full, damage).
        warnings: What was missing or wrong, a sentence each.
        message_count: Messages read, of all topics.
    """

    path: Path
    namespace: str
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


def read_recording(path: str | os.PathLike[str], namespace: str | None = None) -> Recording:
    """Read a recording, whole or torn.

    Args:
        path: An MCAP file or a rosbag2 directory with one.
        namespace: Namespace of the vehicle's topics; by default that of the only recorded vehicle, or ``/bike``.

    Returns:
        What could be read, up to the last whole chunk.

    Raises:
        FileNotFoundError: If the file does not exist.
        RecordingError: If it is not a recording of a ride, or nothing of it can be read.
        OSError: If the file cannot be read.
    """
    file = find_file(path)
    collector = _Collector(Container(file))
    try:
        return collector.read(namespace)
    except SchemaError as error:
        raise RecordingError(f"{file}: {error}") from error


@dataclass
class _TableReader:
    """Columns of one topic while they are being collected."""

    kind: type[Table]
    columns: ColumnReader
    missing: tuple[str, ...]
    order: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, kind: type[Table], schema: MessageSchema, required: Sequence[str]) -> _TableReader:
        available = schema.fields()
        absent = [name for name in required if name not in available]
        if absent:
            raise SchemaError(
                f"{schema.name} as recorded has no {', '.join(absent)}; is it another version of bike_msgs?"
            )
        own = [f.name for f in fields(kind) if f.name not in ("order", "time_s")]
        wanted = [name for name in own if name in available]
        missing = tuple(name for name in own if name not in available)
        return cls(kind, ColumnReader(schema, (*_STAMP, *wanted)), missing)

    def add(self, order: int, data: bytes) -> None:
        self.order.append(order)
        self.columns.add(data)

    def finish(self) -> Table:
        columns = self.columns.finish()
        seconds, nanoseconds = (columns.pop(name) for name in _STAMP)
        count = len(self.order)
        values: dict[str, NDArray[Any]] = {
            "order": np.array(self.order, dtype=np.int64),
            "time_s": seconds.astype(np.float64) + 1e-9 * nanoseconds,
        }
        for f in fields(self.kind):
            if f.name not in values:
                dtype, absent = _column_kind(str(f.type))
                values[f.name] = columns[f.name].astype(dtype) if f.name in columns else np.full(count, absent, dtype)
        return self.kind(**values)


def _column_kind(annotation: str) -> tuple[type, float | bool | int]:
    """Element type of a column and the value that stands for an absent one."""
    return {"Floats": (np.float64, np.nan), "Integers": (np.int64, 0), "Flags": (np.bool_, False)}[annotation]


class _Collector:
    """Sorts the messages of a container into tables and lists."""

    def __init__(self, container: Container) -> None:
        self._container = container
        self._warnings: list[str] = []
        self._schemas: dict[int, MessageSchema | None] = {}
        self._tables: dict[str, _TableReader] = {}
        self._others: dict[str, list[tuple[int, Any]]] = {}
        self._vehicles: dict[str, str] = {}
        self._count = 0

    def read(self, namespace: str | None) -> Recording:
        for message in self._container.messages():
            self._count += 1
            self._add(message)
        box = self._container
        if box.truncated:
            self._warnings.insert(0, f"the recording is torn: {box.reason}; read up to its last whole chunk")
        chosen = self._choose(namespace)
        states, commands = self._table(chosen, "state", States), self._table(chosen, "command", Commands)
        return Recording(
            path=box.path,
            namespace=chosen,
            vehicle=self._vehicles.get(f"{chosen}/state", ""),
            states=states,
            commands=commands,
            courses=tuple(self._converted(f"{chosen}/course", _course)),
            events=tuple(self._converted(f"{chosen}/events", _event)),
            latencies=tuple(x for x in self._converted("/diagnostics", _latency) if x is not None),
            notes=dict(box.metadata.get("ride_notes", {})),
            truncated=box.truncated,
            warnings=tuple(self._warnings),
            message_count=self._count,
        )

    def _add(self, message: RawMessage) -> None:
        channel = self._container.channels.get(message.channel)
        schema = self._schema(message.channel)
        if channel is None or schema is None:
            return
        if schema.name in _REQUIRED:
            if channel.topic not in self._tables:
                kind = States if schema.name == STATE_TYPE else Commands
                self._tables[channel.topic] = _TableReader.of(kind, schema, _REQUIRED[schema.name])
                self._vehicles[channel.topic] = str(getattr(schema.decode(message.data), "vehicle", ""))
            self._tables[channel.topic].add(self._count, message.data)
            return
        try:
            self._others.setdefault(channel.topic, []).append((self._count, schema.decode(message.data)))
        except SchemaError as error:
            self._warn(f"topic {channel.topic}: {error}")

    def _converted(self, topic: str, convert: Callable[[int, Any], _T]) -> Iterator[_T]:
        """Messages of a topic, converted; those of another version of the type are left out with a warning."""
        for order, message in self._others.get(topic, []):
            try:
                yield convert(order, message)
            except AttributeError as error:
                self._warn(f"topic {topic} is skipped: its type is of another version ({error})")

    def _schema(self, channel_id: int) -> MessageSchema | None:
        """Schema of a channel that is worth decoding, else None."""
        if channel_id not in self._schemas:
            self._schemas[channel_id] = self._make_schema(channel_id)
        return self._schemas[channel_id]

    def _make_schema(self, channel_id: int) -> MessageSchema | None:
        channel = self._container.channels.get(channel_id)
        schema = self._container.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None:
            return None
        if schema.name not in _REQUIRED and schema.name not in _DECODED_BY_MESSAGE:
            return None
        if channel.message_encoding != "cdr" or schema.encoding != "ros2msg":
            self._warn(f"topic {channel.topic} is skipped: it is {channel.message_encoding} by {schema.encoding}")
            return None
        return MessageSchema(schema.name, schema.data.decode("utf-8", errors="replace"))

    def _warn(self, text: str) -> None:
        if text not in self._warnings:
            self._warnings.append(text)

    def _choose(self, namespace: str | None) -> str:
        """Namespace of the vehicle to be read."""
        found = sorted(topic.removesuffix("/state") for topic, table in self._tables.items() if table.kind is States)
        if namespace is not None:
            chosen = "/" + namespace.strip("/")
            if chosen not in found:
                raise RecordingError(f"{self._container.path} has no states of {chosen}; it has {found or 'none'}")
            return chosen
        if not found:
            raise RecordingError(self._no_states())
        if len(found) > 1 and DEFAULT_NAMESPACE not in found:
            raise RecordingError(f"{self._container.path} has several vehicles, {', '.join(found)}: name one of them")
        return found[0] if len(found) == 1 else DEFAULT_NAMESPACE

    def _no_states(self) -> str:
        box = self._container
        if box.truncated:
            return f"{box.path} is torn before its first whole chunk of states; nothing of the ride can be read"
        topics = box.topics()
        if STATE_TYPE in topics.values():
            return f"{box.path} holds no state: nothing was ridden while it was recorded"
        listed = ", ".join(f"{t} ({k})" for t, k in sorted(topics.items())[:5]) or "no topics at all"
        return f"{box.path} is not a recording of a ride: no topic has the type {STATE_TYPE}; it has {listed}"

    def _table(self, namespace: str, name: str, kind: type[Any]) -> Any:
        reader = self._tables.get(f"{namespace}/{name}")
        if reader is None or reader.kind is not kind:
            self._warn(f"topic {namespace}/{name} was not recorded")
            columns: dict[str, NDArray[Any]] = {f.name: np.empty(0, _column_kind(str(f.type))[0]) for f in fields(kind)}
            return kind(**columns)
        if reader.missing:
            self._warn(f"{namespace}/{name} has no {', '.join(reader.missing)}; what needs them is left out")
        return reader.finish()


def _floats(values: Any) -> Floats:
    return np.array(values, dtype=np.float64)


def _course(order: int, message: Any) -> Course:
    return Course(
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


def _latency(order: int, message: Any) -> Latency | None:
    """Latency in a DiagnosticArray: values named ``latency_median_ms`` and ``latency_p99_ms`` (or in s or us)."""
    found: dict[str, float] = {}
    for status in message.status:
        for pair in status.values:
            match = _LATENCY_KEY.match(pair.key)
            if match is None:
                continue
            try:
                value = float(pair.value) * _SECONDS[match[2]]
            except ValueError:
                continue
            found["p99" if match[1] == "p99" else "median"] = value
    if not found:
        return None
    stamp = message.header.stamp
    time_s = stamp.sec + 1e-9 * stamp.nanosec
    return Latency(order, time_s, found.get("median", np.nan), found.get("p99", np.nan))
