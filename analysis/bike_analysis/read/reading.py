"""A recording as typed columns: states, commands, courses, events and latencies. Needs no ROS.

A recording may lack topics and fields: missing ones become NaN or an empty list, with a warning. Where
`BikeState` was not recorded, the motion is computed from standard messages (`bike_analysis.read.motion`). Only a
recording without any motion is refused.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from bike_analysis.read.clock import forward_time
from bike_analysis.read.columns import SchemaError
from bike_analysis.read.container import RecordingError
from bike_analysis.read.files import RecordingFiles, examine_files
from bike_analysis.read.messages import (
    Latency,
    RecordedCourse,
    RecordedEvent,
    Report,
    Simulation,
    course_of,
    dropped_messages,
    event_of,
    latency_of,
    own_reports,
    reports_of,
    simulation_of,
)
from bike_analysis.read.motion import MOTION_TYPES, Motion, states_of_motion
from bike_analysis.read.sorting import MessageSorter
from bike_analysis.read.tables import (
    STATE_TYPE,
    TABLE_OF_TYPE,
    TELEMETRY_TYPE,
    Commands,
    States,
    TableT,
    Telemetry,
    empty_table,
    make_table,
)

DEFAULT_NAMESPACE: Final = "/bike"

_T = TypeVar("_T")
_NOTES: Final = "ride_notes"


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
        warnings: What was missing or wrong, one sentence each.
        message_count: Messages read, of all topics.
        telemetry: What tyres and engine did, or None where it was not recorded.
        topics: Number of messages read by topic.
        simulations: How motion was computed, each way once; one way for most recordings, none without beginnings.
        dropped_messages: Messages that the recorder had to give up, as it reported them; None without a report.
    """

    path: Path
    namespace: str | None
    vehicle: str
    states: States
    commands: Commands
    courses: tuple[RecordedCourse, ...]
    events: tuple[RecordedEvent, ...]
    latencies: tuple[Latency, ...]
    notes: dict[str, str]
    truncated: bool
    warnings: tuple[str, ...]
    message_count: int
    telemetry: Telemetry | None = None
    topics: dict[str, int] = field(default_factory=dict)
    simulations: tuple[Simulation, ...] = ()
    dropped_messages: int | None = None


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
    found = examine_files(path)
    try:
        return _Reader(found).read(namespace)
    except SchemaError as error:
        raise RecordingError(f"{found.files[0]}: {error}") from error


class _Reader:
    """Chooses the vehicle among the sorted messages and puts its recording together."""

    def __init__(self, found: RecordingFiles) -> None:
        self._path = found.files[0]
        self._incomplete = bool(found.warnings)
        self._sorted = MessageSorter(found)

    def read(self, namespace: str | None) -> Recording:
        """Put a recording together for the vehicle of a namespace."""
        found, boxes = self._sorted, self._sorted.containers
        chosen = self._choose(namespace)
        states = self._states(f"{chosen}/state") if chosen is not None else self._foreign()
        name = chosen or ""
        reports = list(self._reports())
        return Recording(
            path=self._path,
            namespace=chosen,
            vehicle=found.vehicles.get(f"{name}/state", ""),
            states=states,
            commands=self._table(f"{name}/command", Commands, expected=chosen is not None),
            courses=tuple(self._converted(f"{name}/course", course_of)),
            events=tuple(self._converted(f"{name}/events", event_of)),
            latencies=tuple(x for x in map(latency_of, own_reports(reports, name)) if x is not None),
            notes={key: text for box in boxes for key, text in box.metadata.get(_NOTES, {}).items()},
            truncated=self._incomplete or any(box.truncated or box.damaged_chunks for box in boxes),
            warnings=tuple(found.warnings),
            message_count=found.message_count,
            telemetry=self._telemetry(f"{name}/telemetry"),
            simulations=tuple(dict.fromkeys(self._converted(f"{name}/episode", simulation_of))),
            topics=dict(sorted(found.counts.items())),
            dropped_messages=dropped_messages(reports, name),
        )

    def _converted(self, topic: str, convert: Callable[[int, Any], _T]) -> Iterator[_T]:
        """Messages of a topic, converted; those of another version of the type are left out with a warning."""
        for order, message in self._sorted.others.get(topic, []):
            try:
                yield convert(order, message)
            except (AttributeError, TypeError, ValueError) as error:
                self._sorted.warn(f"a message of {topic} is left out: damaged, or of another version ({error})")

    def _choose(self, namespace: str | None) -> str | None:
        """Namespace of the vehicle to be read; None if there is no `BikeState`, but other messages with motion."""
        topics = sorted(topic for topic, reader in self._sorted.topics.items() if reader.type_name == STATE_TYPE)
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
        if any(reader.type_name in MOTION_TYPES for reader in self._sorted.topics.values()):
            if topics:
                self._sorted.warn(elsewhere)
            return None
        raise RecordingError(f"{self._path}: {elsewhere}" if topics else self._no_states())

    def _one_of(self, found: Sequence[str], names: str) -> str:
        """The only vehicle, or the usual one, with a warning that names the others."""
        if len(found) == 1:
            return found[0]
        if DEFAULT_NAMESPACE not in found:
            raise RecordingError(f"{self._path} has several vehicles, {names}: name one of them with --vehicle")
        self._sorted.warn(
            f"several vehicles were recorded, {names}: {DEFAULT_NAMESPACE} is read, --vehicle chooses another"
        )
        return DEFAULT_NAMESPACE

    def _no_states(self) -> str:
        if any(box.truncated for box in self._sorted.containers):
            return f"{self._path} is torn before its first whole chunk of states; nothing of the ride can be read"
        topics = {topic: kind for box in self._sorted.containers for topic, kind in box.topics().items()}
        skipped = next((text for text in self._sorted.warnings if "skipped" in text or "damaged" in text), "")
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
            self._sorted.warn(text)
        return replace(states, time_s=time_s)

    def _reports(self) -> Iterator[Report]:
        """What nodes reported on diagnostics, one status each."""
        for statuses in self._converted("/diagnostics", reports_of):
            yield from statuses

    def _table(self, topic: str, kind: type[TableT], expected: bool = True) -> TableT:
        reader = self._sorted.topics.pop(topic, None)
        if reader is None or TABLE_OF_TYPE.get(reader.type_name) is not kind:
            if expected:
                self._sorted.warn(f"topic {topic} was not recorded")
            return empty_table(kind)
        if reader.missing:
            self._sorted.warn(f"{topic} has no {', '.join(reader.missing)}; what needs them is left out")
        order, time_s, columns = reader.finish()
        if not len(order) and kind is States:
            raise RecordingError(f"{self._path} holds no state that can be read: {reader.columns.damage}")
        return make_table(kind, order, time_s, columns, len(order))

    def _telemetry(self, topic: str) -> Telemetry | None:
        reader = self._sorted.topics.pop(topic, None)
        if reader is None or reader.type_name != TELEMETRY_TYPE:
            return None
        order, time_s, columns = reader.finish()
        episode, step = (columns.pop(n, np.zeros(len(order))).astype(np.int64) for n in ("episode", "step"))
        return Telemetry(
            order, time_s, episode, step, {n: c.astype(np.float64, copy=False) for n, c in columns.items()}
        )

    def _foreign(self) -> States:
        """States computed from standard messages, with a sentence that says of which."""
        motions = []
        for topic, reader in self._sorted.topics.items():
            if reader.type_name in MOTION_TYPES:
                motions.append(Motion(topic, reader.type_name, *reader.finish()))
        states, told = states_of_motion(motions)
        if not len(states["time_s"]):
            raise RecordingError(f"{self._path} holds no motion that can be read: {told}")
        self._sorted.warn(told)
        order = states.pop("order").astype(np.int64)
        return make_table(States, order, states.pop("time_s"), states, len(order))
