"""A recording as typed columns: states, commands, courses, events and latencies. Needs no ROS.

A recording may lack topics and fields: missing ones become NaN or an empty list, with a warning. Where
`BikeState` was not recorded, the motion is computed from standard messages (`bike_analysis.read.messages`). Only a
recording without any motion is refused.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.read.container import Block, Container, RecordingError, examine_files
from bike_analysis.read.messages import (
    COLUMNS,
    COMMAND_TYPE,
    DECODED_BY_MESSAGE,
    GRIP_TYPE,
    MOTION_TYPES,
    STATE_TYPE,
    TELEMETRY_TYPE,
    Floats,
    Integers,
    Latency,
    Motion,
    RecordedCourse,
    RecordedEvent,
    Simulation,
    Table,
    course_of,
    dropped_messages,
    event_of,
    latency_of,
    make_table,
    own_reports,
    reports_of,
    signal_names_of,
    simulation_of,
    states_of_motion,
    suspension_of,
)
from bike_sim.schema import PLACE, SIGNALS

LARGEST_DEFINITION: Final = 256 * 1024
"""Longer definitions of a type are not parsed, bytes. That of our states has six thousand."""

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")


class _TopicReader:
    """Collects the columns of one topic.

    Attributes:
        type_name: Type of its messages.
        columns: Reader of the wanted fields that were recorded.
        missing: Wanted fields that were not.
        vehicle: Name of the vehicle in the first state; empty without one.
    """

    def __init__(self, schema: MessageSchema, first: bytes) -> None:
        """Prepare to read the columns that are wanted and recorded.

        Args:
            schema: Type of the messages.
            first: The first one.

        Raises:
            SchemaError: If the type has none of them, or its definition cannot be understood.
        """
        wanted, available = COLUMNS[schema.name], schema.scalars()
        if not available & set(wanted):
            raise SchemaError(f"{schema.name} as recorded has none of the known fields; is it another version?")
        self.type_name, self.missing = schema.name, tuple(name for name in wanted if name not in available)
        self.vehicle = ""
        arrays: tuple[str, ...] = ()
        if schema.name == STATE_TYPE:
            with suppress(SchemaError):
                state = schema.decode(first)
                self.vehicle = str(getattr(state, "vehicle", ""))
                # fewer are of a version without suspension
                arrays = ("signals",) if len(getattr(state, "signals", ())) >= len(SIGNALS) else ()
                arrays += ("centre_place",) if len(getattr(state, "centre_place", ())) == len(PLACE) else ()
        self.columns = ColumnReader(schema, [*(name for name in (*_STAMP, *wanted) if name in available), *arrays])
        self._orders: list[Integers] = []
        self._log_times: list[Integers] = []

    def add(self, block: Block, rows: Integers) -> None:
        """Take messages of a block; those that do not fit their type are left out."""
        good = rows[self.columns.add_block(block.contents, block.begin[rows], block.end[rows])]
        self._orders.append(good + block.first)
        self._log_times.append(block.log_time_ns[good])

    def finish(self) -> tuple[Integers, Floats, dict[str, NDArray[Any]]]:
        """Places in the recording, times in s and the columns by field."""
        columns = self.columns.finish()
        order, log_time = np.concatenate(self._orders), np.concatenate(self._log_times)
        stamp = [columns.pop(name, None) for name in _STAMP]
        log_time_s: Floats = np.asarray(1e-9 * log_time, dtype=np.float64)
        if stamp[0] is None or stamp[1] is None:
            return order, log_time_s, columns
        time_s: Floats = np.asarray(stamp[0] + 1e-9 * stamp[1], dtype=np.float64)
        unknown, known = np.flatnonzero(time_s == 0.0), np.flatnonzero(time_s)
        if self.type_name not in MOTION_TYPES or not len(unknown):
            return order, time_s, columns
        if not len(known):  # nodes that do not know the time write 0
            return order, log_time_s, columns
        # The log time may be of another clock: only its distance from the next message with a stamp counts.
        near = known[np.minimum(np.searchsorted(known, unknown), len(known) - 1)]
        time_s[unknown] = time_s[near] + (log_time_s[unknown] - log_time_s[near])
        return order, time_s, columns


DEFAULT_NAMESPACE: Final = "/bike"

_T = TypeVar("_T")
_NOTES: Final = "ride_notes"


@dataclass(frozen=True, eq=False)
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
        warnings: What was missing or wrong, one sentence each.
        message_count: Messages read, of all topics.
        telemetry: What tyres and engine did; empty where it was not recorded.
        grip: What the rider inferred of the road's grip; empty where it was not recorded.
        disturbances: Document of what disturbed the rides; empty where nothing did, or what did is no document.
        topics: Number of messages read by topic.
        simulations: Engines and steps by which motion was computed, each once; none without beginnings.
        dropped_messages: Messages that the recorder had to give up, as it reported them; None without a report.
    """

    path: Path
    namespace: str | None
    vehicle: str
    states: Table
    commands: Table
    courses: tuple[RecordedCourse, ...]
    events: tuple[RecordedEvent, ...]
    latencies: tuple[Latency, ...]
    notes: dict[str, str]
    truncated: bool
    warnings: tuple[str, ...]
    message_count: int
    telemetry: Table
    grip: Table
    disturbances: dict[str, Any] = field(default_factory=dict)
    topics: dict[str, int] = field(default_factory=dict)
    simulations: tuple[Simulation, ...] = ()
    dropped_messages: int | None = None

    def __repr__(self) -> str:
        return f"<Recording {self.path.name}: {len(self.states)} states>"

    @property
    def policy(self) -> str:
        """Rider, from the recorder's note ``policy``; empty where unknown."""
        return self.notes.get("policy", "")


def read_recording(path: str | os.PathLike[str], namespace: str | None = None) -> Recording:
    """Read a recording, complete or truncated.

    Args:
        path: An MCAP file or a rosbag2 directory with one.
        namespace: Namespace of the vehicle's topics, ``/`` for the root; by default that of the only recorded vehicle,
            or ``/bike``.

    Returns:
        What could be read, up to the last complete chunk.

    Raises:
        FileNotFoundError: If the file does not exist.
        RecordingError: If it is not a recording of a ride, or nothing of it can be read.
        OSError: If the file cannot be read.
    """
    files, faults = examine_files(path)
    try:
        return _Reader(files, faults).read(namespace)
    except SchemaError as error:
        raise RecordingError(f"{files[0]}: {error}") from error


class _Reader:
    """Sorts the messages of a recording's files by topic, chooses the vehicle, and puts its recording together."""

    def __init__(self, files: Sequence[Path], faults: Sequence[str]) -> None:
        self._path = files[0]
        self._incomplete = bool(faults)
        self._containers = [Container(file) for file in files]
        self._topics: dict[str, _TopicReader] = {}
        self._others: dict[str, list[tuple[int, Any]]] = {}
        self._counts: dict[str, int] = {}
        self._message_count = 0
        self._warnings: list[str] = list(faults)
        for box in self._containers:
            self._read_file(box)

    def _read_file(self, box: Container) -> None:
        schemas: dict[int, MessageSchema | None] = {}
        before = self._message_count
        for block in box.blocks():
            block = replace(block, first=block.first + before)
            for channel_id in np.unique(block.channel).tolist():
                if channel_id not in schemas:
                    schemas[channel_id] = self._make_schema(box, channel_id)
                schema = schemas[channel_id]
                if schema is not None:
                    rows = np.flatnonzero(block.channel == channel_id)
                    self._add(box.channels[channel_id].topic, schema, block, rows)
            self._message_count += len(block)
        self._note_faults(box)

    def _note_faults(self, box: Container) -> None:
        """Count the messages of a file, and warn of its faults."""
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
                    reader = self._topics[topic] = _TopicReader(schema, block.data(int(rows[0])))
                except SchemaError as error:
                    self._warn(f"topic {topic} is skipped: {error}")
                    return
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

    def _make_schema(self, box: Container, channel_id: int) -> MessageSchema | None:
        """Schema of a channel that is worth decoding, else None."""
        channel = box.channels.get(channel_id)
        schema = box.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None:
            return None
        if schema.name not in COLUMNS and schema.name not in DECODED_BY_MESSAGE:
            return None
        if channel.message_encoding != "cdr" or schema.encoding != "ros2msg":
            self._warn(f"topic {channel.topic} is skipped: it is {channel.message_encoding} by {schema.encoding}")
            return None
        if len(schema.data) > LARGEST_DEFINITION:
            self._warn(f"topic {channel.topic} is skipped: the definition of its type has {len(schema.data)} bytes")
            return None
        try:
            return MessageSchema(schema.name, schema.data.decode("utf-8", errors="replace"))
        except SchemaError as error:
            self._warn(f"topic {channel.topic} is skipped: {error}")
            return None

    def _warn(self, text: str, first: bool = False) -> None:
        """Note a sentence, once."""
        one_line = " ".join(text.split())
        if one_line not in self._warnings:
            self._warnings.insert(0 if first else len(self._warnings), one_line)

    def read(self, namespace: str | None) -> Recording:
        """Put a recording together for the vehicle of a namespace."""
        chosen = self._choose(namespace)
        reader = self._topics.get(f"{chosen or ''}/state")
        vehicle = reader.vehicle if reader is not None else ""
        name = chosen or ""
        states = self._table(f"{name}/state", STATE_TYPE) if chosen is not None else self._foreign()
        if chosen is not None:
            time_s, faults = forward_time(states.time_s, states.episode, states.step, states.control_period)
            states = replace(states, time_s=time_s)
            for text in faults:
                self._warn(text)
        reports = [report for statuses in self._converted("/diagnostics", reports_of) for report in statuses]
        return Recording(
            path=self._path,
            namespace=chosen,
            vehicle=vehicle,
            states=states,
            commands=self._table(f"{name}/command", COMMAND_TYPE, expected=chosen is not None),
            courses=tuple(self._converted(f"{name}/course", course_of)),
            events=tuple(self._converted(f"{name}/events", event_of)),
            latencies=tuple(x for x in map(latency_of, own_reports(reports, name)) if x is not None),
            notes={key: text for box in self._containers for key, text in box.metadata.get(_NOTES, {}).items()},
            truncated=self._incomplete or any(box.truncated or box.damaged_chunks for box in self._containers),
            warnings=tuple(self._warnings),
            message_count=self._message_count,
            telemetry=self._table(f"{name}/telemetry", TELEMETRY_TYPE, expected=False),
            grip=self._table(f"{name}/grip", GRIP_TYPE, expected=False),
            disturbances=next(self._converted(f"{name}/disturbances", lambda _, message: _document(message.data)), {}),
            simulations=tuple(dict.fromkeys(self._converted(f"{name}/episode", simulation_of))),
            topics=dict(sorted(self._counts.items())),
            dropped_messages=dropped_messages(reports, name),
        )

    def _converted(self, topic: str, convert: Callable[[int, Any], _T]) -> Iterator[_T]:
        """Messages of a topic, converted; those of another version of the type are left out with a warning."""
        for order, message in self._others.get(topic, []):
            try:
                yield convert(order, message)
            except (AttributeError, TypeError, ValueError) as error:
                self._warn(f"a message of {topic} is left out: damaged, or of another version ({error})")

    def _choose(self, namespace: str | None) -> str | None:
        """Namespace of the vehicle to be read; None if there is no `BikeState`, but other messages with motion."""
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

    def _table(self, topic: str, kind: str, expected: bool = True) -> Table:
        reader = self._topics.pop(topic, None)
        if reader is None or reader.type_name != kind:
            if expected:
                self._warn(f"topic {topic} was not recorded")
            return make_table(kind, np.empty(0, np.int64), np.empty(0), {})
        if reader.missing and kind != TELEMETRY_TYPE:
            self._warn(f"{topic} has no {', '.join(reader.missing)}; what needs them is left out")
        order, time_s, columns = reader.finish()
        if not len(order) and kind == STATE_TYPE:
            raise RecordingError(f"{self._path} holds no state that can be read: {reader.columns.damage}")
        table = make_table(kind, order, time_s, columns)
        if "centre_place" in columns:
            table = table.with_columns(centre_progress=columns["centre_place"][:, PLACE.index("centre_progress")])
        if "signals" not in columns:
            return table
        names = next(self._converted(f"{topic.removesuffix('/state')}/episode", signal_names_of), ())
        return table.with_columns(**suspension_of(columns["signals"], names))

    def _foreign(self) -> Table:
        """States computed from standard messages, with a sentence that says of which."""
        motions = []
        for topic, reader in self._topics.items():
            if reader.type_name in MOTION_TYPES:
                motions.append(Motion(topic, reader.type_name, *reader.finish()))
        states, sources = states_of_motion(motions)
        if not len(states["time_s"]):
            raise RecordingError(f"{self._path} holds no motion that can be read: {sources}")
        self._warn(sources)
        order = states.pop("order").astype(np.int64)
        return make_table(STATE_TYPE, order, states.pop("time_s"), states)


def _document(text: object) -> dict[str, Any]:
    """Return a recorded document; an empty one where it is none of ours."""
    with suppress(ValueError):
        found = json.loads(str(text))
        return found if isinstance(found, dict) else {}
    return {}


# ---- time ----------------------------------------------------------------------------------------------------------


def ride_bounds(episode: Integers, step: Integers) -> list[int]:
    """Find where rides begin.

    Args:
        episode: Number of the episode of each state.
        step: Control steps since its reset.

    Returns:
        First row of each ride, and at last the number of states. A ride begins where the episode changes or the step
        goes back (a simulator that was restarted counts its episodes from 1 again).
    """
    begins = np.flatnonzero((np.diff(episode) != 0) | (np.diff(step) < 0)) + 1
    return [0, *begins.tolist(), len(step)]


def forward_time(time_s: Floats, episode: Integers, step: Integers, period: Floats) -> tuple[Floats, list[str]]:
    """Make time run forward within each ride.

    A clock that was set back, or damage, would make laps shorter than they were. The steps are the simulator's own
    clock, so the time of such a ride is counted from them.

    Args:
        time_s: Stamps of states, s.
        episode: Number of the episode of each state.
        step: Control steps since its reset.
        period: Control period, s; NaN where it is not known.

    Returns:
        The time of each state, s, and a sentence for each ride whose stamps went back.
    """
    faults: list[str] = []
    for ride, (first, last) in enumerate(pairwise(ride_bounds(episode, step)), start=1):
        stamps, steps = time_s[first:last], step[first:last]
        falls = np.flatnonzero(np.diff(stamps) < 0.0)
        if not len(falls):
            continue
        if not faults:
            time_s = time_s.copy()
        known = period[first:last][np.nan_to_num(period[first:last]) > 0.0]
        if not len(known):  # the usual one between stamps that go forward
            across, along = np.diff(stamps), np.diff(steps)
            forward = (across > 0.0) & (along > 0)
            known = across[forward] / along[forward]
        time_s[first:last] = stamps[0] + (steps - steps[0]) * (float(np.median(known)) if len(known) else 0.0)
        times = "once" if len(falls) == 1 else f"{len(falls)} times"
        faults.append(
            f"the stamps of ride {ride} go back in time {times}, first after step {steps[falls[0]]}: "
            "its time is counted from its steps"
        )
    return time_s, faults
