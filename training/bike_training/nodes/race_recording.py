"""A race in one recording: the states of every machine in a namespace of its own, and what happened between them.

`bike analyze --namespace /NAME` reads a machine of it as any ride. The race itself, as settings and riders, stands in
the notes, or of a race of nodes in a topic, so that it can be raced again from the recorded commands (`RecordedRace`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from bike_analysis.read.columns import ColumnReader, MessageSchema
from bike_analysis.read.container import Container, RecordingError, find_files
from bike_analysis.read.reading import read_recording
from bike_sim.physics import state as st
from bike_sim.recording.definitions import message_type
from bike_sim.recording.metadata import LATCHED, Qos
from bike_sim.recording.recorder import RideRecorder
from bike_sim.ros import messages, node_tools
from bike_sim.sim.race import Race, RaceEvent, RaceSettings, check_names
from bike_sim.sim.simulator import RowSnapshots
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

TOPICS: Final = {
    "episode": ("bike_msgs/msg/EpisodeStart", LATCHED),
    "course": ("bike_msgs/msg/Course", LATCHED),
    "state": ("bike_msgs/msg/BikeState", Qos()),
    "telemetry": ("bike_msgs/msg/Telemetry", Qos()),
    "events": ("bike_msgs/msg/RideEvent", Qos()),
}
"""Topics of each machine in its namespace; telemetry is of superbikes."""
RACE_EVENTS: Final = "/race/events"
"""What happened between machines, as JSON in ``std_msgs/String``."""
RACE_RESULT: Final = "/race/result"
"""Classification and gaps at the end, as JSON in ``std_msgs/String``."""
RACE_SETTINGS: Final = "/race/settings"
"""Settings of a race of nodes, as JSON in ``std_msgs/String``; those of a race of one process are a note."""
NOTE: Final = "race"
COMMANDS: Final = ("steering_command", "throttle_command")
FIELDS: Final = (*st.FIELDS, "speed", *COMMANDS, "step")


class RaceRecorder(AbstractContextManager["RaceRecorder"]):
    """Writes a race down, step by step."""

    def __init__(self, path: Path, race: Race, overwrite: bool = False) -> None:
        """Begin with the machines on the grid.

        Raises:
            FileExistsError: the recording exists and is not to be replaced.
            ValueError: a machine whose name is no namespace.
            OSError: the disk refuses it.
        """
        self._race, self._names = race, [entry.name for entry in race.settings.entries]
        check_names(self._names)
        notes = {NOTE: json.dumps(race.settings.to_card())}
        self._recorder = RideRecorder(path, overwrite=overwrite, notes=notes, metadata_file=False)
        self._schemas: dict[str, MessageSchema] = {}
        self._views = [RowSnapshots(race.batch, row) for row in range(race.count)]
        self._facts: list[messages.Episode] = []
        try:
            self._begin()
        except BaseException:
            self._recorder.close()
            raise

    def _begin(self) -> None:
        batch, period = self._race.batch, self._race.batch.config.control_period
        stamp = self._stamp(0)
        for topic in (RACE_EVENTS, RACE_RESULT):
            self._add(topic, "std_msgs/msg/String", Qos())
        for row, name in enumerate(self._names):
            vehicle, course, request = batch.vehicles[row], batch.course(row), batch.request(row)
            assert request is not None, "the machine is on the grid"
            for topic, (kind, qos) in TOPICS.items():
                if topic != "telemetry" or isinstance(vehicle, Superbike):
                    self._add(f"/{name}/{topic}", kind, qos)
            self._facts.append(messages.Episode.of(vehicle, course, batch.preview, period))
            names, number = batch.plant(row).signal_names, batch.episodes[row]
            config = replace(batch.config, vehicle=vehicle.name)
            start = messages.episode_start_to_message(request, config, names, number, stamp)
            self._write(f"/{name}/episode", start, stamp)
            self._write(f"/{name}/course", messages.course_to_message(course, number, stamp), stamp)
            self._write_row(row, self._views[row].begin(), stamp)

    def step(self, commands: FloatArray, events: Sequence[RaceEvent]) -> None:
        """Write the states after a step, with its commands and what happened in it."""
        step = self._race.step_number
        stamp = self._stamp(step)
        for row, (steering, throttle) in enumerate(commands.tolist()):
            self._write_row(row, self._views[row].take(step, steering, throttle), stamp)
        for event in events:
            self._write(RACE_EVENTS, String(data=json.dumps(event._asdict())), stamp)

    def finish(self) -> None:
        """Write the result of the race."""
        race = self._race
        result = {"classification": [line._asdict() for line in race.classification()], "gaps": race.gaps()}
        self._write(RACE_RESULT, String(data=json.dumps(result)), self._stamp(race.step_number))

    def close(self) -> None:
        """Finish the file."""
        self._recorder.close()

    def __exit__(self, *_: object) -> None:
        """Finish the file, also after an error."""
        self.close()

    def _write_row(self, row: int, snapshot: Any, stamp: int) -> None:
        name, vehicle = self._names[row], self._race.batch.vehicles[row]
        self._recorder.write(f"/{name}/state", messages.encode_state(snapshot, self._facts[row], stamp), stamp)
        if isinstance(vehicle, Superbike):
            self._write(f"/{name}/telemetry", messages.telemetry_to_message(snapshot, vehicle, stamp), stamp)
        for event in snapshot.events:
            self._write(f"/{name}/events", messages.event_to_message(event, snapshot, stamp), stamp)

    def _add(self, topic: str, kind: str, qos: Qos) -> None:
        described = message_type(kind)
        self._recorder.add_topic(topic, described, qos)
        self._schemas[topic] = MessageSchema(described.name, described.definition)

    def _write(self, topic: str, message: Any, stamp: int) -> None:
        # rclpy leaves excess bytes behind messages with empty arrays, which strict readers refuse.
        self._recorder.write(topic, self._schemas[topic].trim(serialize_message(message)), stamp)

    def _stamp(self, step: int) -> int:
        """Simulated time of a state, ns; races begin after one period, as the rides of nodes do."""
        return round((step + 1) * self._race.batch.config.control_period * node_tools.NANOSECONDS)


@dataclass(frozen=True)
class RecordedRace:
    """A race as it was recorded.

    Attributes:
        settings: of the race.
        states: minimal states of each machine, shape (steps + 1, n, 10).
        speeds: of each machine, m/s, shape (steps + 1, n).
        commands: of each step, shape (steps, n, 2).
        events: what happened, in order.
        result: classification and gaps; empty where the recording ends before the race.
    """

    settings: RaceSettings
    states: FloatArray
    speeds: FloatArray
    commands: FloatArray
    events: tuple[RaceEvent, ...]
    result: dict[str, Any]

    @classmethod
    def read(cls, path: Path) -> RecordedRace:
        """Read a recording.

        Raises:
            FileNotFoundError: there is no such recording.
            RecordingError: it is no recording of a race, or not a whole one.
        """
        names = _namespaces(path)
        readers, events, texts = _read(path, names)
        card = texts.get(RACE_SETTINGS) or (read_recording(path, names[0]).notes.get(NOTE) if names else None)
        if not card:
            raise RecordingError(f"{path} is no recording of a race; `bike race` writes one")
        settings = RaceSettings.from_card(json.loads(card))
        columns = _tables(path, readers, [entry.name for entry in settings.entries])
        result = json.loads(texts.get(RACE_RESULT, "{}"))
        steps = min(len(table[0]) for table in columns)
        states = np.stack([np.stack(table[:10], axis=1)[:steps] for table in columns], axis=1)
        speeds = np.stack([table[10][:steps] for table in columns], axis=1)
        commands = np.stack([np.stack(table[11:13], axis=1)[1:steps] for table in columns], axis=1)
        return cls(settings, states, speeds, commands, tuple(events), result)

    def replay(self) -> tuple[int, str]:
        """Race again with the recorded commands; return compared steps, and where a machine first differed or nothing.

        Raises:
            ValueError: a machine or circuit is another one now. FileNotFoundError: it is not here.
        """
        race = Race(self.settings)
        try:
            for step in range(len(self.states)):
                if step:
                    race.step(self.commands[step - 1])
                same = (race.batch.state == self.states[step]).all(axis=1)
                if not same.all():
                    name = self.settings.entries[int(np.argmin(same))].name
                    return step, f"machine {name!r} differs at {race.time:.2f} s"
            if [event.text for event in race.log] != [event.text for event in self.events]:
                return len(self.states), "what happened differs"
        finally:
            race.close()
        return len(self.states), ""


def _namespaces(path: Path) -> list[str]:
    """Return the namespaces of the machines of a recording."""
    topics: set[str] = set()
    for file in find_files(path):
        box = Container(file)
        for _ in box.blocks():  # channels are met on the way
            pass
        topics |= {channel.topic for channel in box.channels.values()}
    return sorted(topic.removesuffix("/state") for topic in topics if topic.endswith("/state"))


def _read(path: Path, names: Sequence[str]) -> tuple[dict[str, ColumnReader], list[RaceEvent], dict[str, str]]:
    """Return states by namespace, what happened, and the last text on the other topics of the race."""
    readers: dict[str, ColumnReader] = {}
    events: list[RaceEvent] = []
    texts: dict[str, str] = {}
    for file in find_files(path):
        box = Container(file)
        for block in box.blocks():
            for number in np.unique(block.channel).tolist():
                channel = box.channels.get(number)
                if channel is None or channel.schema_id not in box.schemas:
                    continue
                stored = box.schemas[channel.schema_id]
                schema = MessageSchema(stored.name, stored.data.decode("utf-8", errors="replace"))
                rows = np.flatnonzero(block.channel == number)
                if channel.topic == RACE_EVENTS:
                    for row in rows.tolist():
                        entry = json.loads(schema.decode(block.data(row)).data)
                        events.append(RaceEvent(**{**entry, "names": tuple(entry["names"])}))
                elif channel.topic in (RACE_RESULT, RACE_SETTINGS):
                    texts[channel.topic] = schema.decode(block.data(int(rows[-1]))).data
                elif channel.topic.removesuffix("/state") in names and channel.topic.endswith("/state"):
                    reader = readers.setdefault(channel.topic, ColumnReader(schema, FIELDS))
                    reader.add_block(block.contents, block.begin[rows], block.end[rows])
    return readers, events, texts


def _tables(path: Path, readers: dict[str, ColumnReader], names: Sequence[str]) -> list[list[FloatArray]]:
    """Return states, speed and commands of each machine, field by field, each step once: nodes repeat the last state.

    Raises:
        RecordingError: states of a machine are missing.
    """
    tables = []
    for name in names:
        if f"/{name}/state" not in readers:
            raise RecordingError(f"{path} holds no states of machine {name!r}")
        table = readers[f"/{name}/state"].finish()
        steps, first = np.unique(np.asarray(table["step"]), return_index=True)
        if len(steps) != steps[-1] + 1:
            raise RecordingError(f"{path} lacks {int(steps[-1]) + 1 - len(steps)} states of machine {name!r}")
        tables.append([np.asarray(table[field], dtype=np.float64)[first] for field in FIELDS])
    return tables
