"""Recorded rides with all that is needed to ride them again, read without ROS."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.read.container import Block, Container, RecordingError, find_files
from bike_analysis.read.reading import Recording, read_recording
from bike_analysis.read.rides import Ride, find_rides
from bike_sim.course.random_paths import PathRanges
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances, read_disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_training.tasks.path import PathTask

Integers = NDArray[np.int64]
Columns = dict[str, NDArray[Any]]

COMMANDS: Final = ("steering_command", "throttle_command")
FLAGS: Final = ("fallen", "off_course", "finished")
EXACT: Final = (*st.FIELDS, *lk.FIELDS, *COMMANDS, "steer_torque", *FLAGS)
"""Fields of a recorded state that are replayed: all but preview and history, which follow from them."""


@dataclass(frozen=True)
class Start:
    """How a ride began (``bike_msgs/EpisodeStart``).

    Attributes:
        config: the simulator.
        request: of the episode, complete.
    """

    config: SimulatorConfig
    request: ResetRequest

    @classmethod
    def from_message(cls, message: Any) -> Start:
        """Read a decoded message.

        Raises:
            ValueError: it holds an invalid value.
        """
        ranges = {spec.name: float(getattr(message, spec.name)) for spec in fields(PathRanges)}
        return cls(
            SimulatorConfig(**{spec.name: getattr(message, spec.name) for spec in fields(SimulatorConfig)}),
            ResetRequest(
                seed=int(message.seed),
                course=str(message.course),
                speed_range=(float(message.speed_min), float(message.speed_max)),
                perturb=bool(message.perturb),
                initial_state=tuple(map(float, message.initial_state)) or None,
                path_ranges=PathRanges(**ranges),
                path_length=float(message.path_length) or None,
                preview=Preview(
                    bool(message.preview_by_time), float(message.preview_interval), int(message.preview_count)
                ),
                context=tuple(map(float, message.context)),
                line=float(message.line),
                progress=float(message.progress),
                **_start_of(message),
            ),
        )


def _start_of(message: Any) -> dict[str, float]:
    """Return how a ride on a circuit began relative to its line; recordings before these fields have none."""
    return {name: float(getattr(message, name, 0.0)) for name in ("speed_share", "start_offset", "start_heading")}


@dataclass(frozen=True)
class Learned:
    """Steps of learning of a ride (``bike_msgs/LearningStep``).

    Attributes:
        task: that was learned.
        step: control step whose state was observed, shape (n,).
        observation: of the policy, shape (n, layout size), float32.
        reward: for the control period that followed, shape (n,).
    """

    task: PathTask
    step: Integers
    observation: NDArray[np.float32]
    reward: NDArray[np.float64]


@dataclass(frozen=True)
class RideSource:
    """One ride of a recording.

    Attributes:
        ride: what analysis knows of it.
        vehicle: name of the vehicle in the states.
        start: how it began, or None where that was not recorded.
        columns: fields of EXACT, one row per state of ``ride.states``.
        disturbances: of what was ridden, or None.
        learned: steps of learning, or None where it is no ride of training.
    """

    ride: Ride
    vehicle: str
    start: Start | None
    columns: Columns
    learned: Learned | None
    disturbances: Disturbances | None = None


def read_rides(path: Path, namespace: str | None = None) -> tuple[Recording, tuple[RideSource, ...]]:
    """Read a recording for riding it again.

    Args:
        path: an MCAP file or a rosbag2 directory.
        namespace: namespace of the vehicle's topics, ``/`` for the root, where several were recorded.

    Raises:
        FileNotFoundError: there is no such recording.
        RecordingError: it is no recording of a ride of the simulator.
        ValueError: it describes an invalid simulator or task.
    """
    recording = read_recording(path, namespace)
    if recording.namespace is None:
        raise RecordingError(f"{path} holds no states of a simulator; only its rides can be ridden again")
    try:
        raw = _Raw(find_files(path), recording.namespace)
    except SchemaError as error:
        raise RecordingError(f"{path}: {error}") from error
    return recording, tuple(_recorded(ride, recording, raw) for ride in find_rides(recording))


def _recorded(ride: Ride, recording: Recording, raw: _Raw) -> RideSource:
    rows = np.searchsorted(raw.order, ride.states.order)
    first = int(ride.states.order[0])
    starts = [(abs(order - first), message) for order, message in raw.starts if message.episode == ride.episode]
    # A simulator that was restarted counts its episodes from 1 again: the nearest message is this ride's.
    start = min(starts, key=lambda pair: pair[0])[1] if starts else None
    return RideSource(
        ride=ride,
        vehicle=recording.vehicle,
        start=Start.from_message(start) if start is not None else None,
        columns={name: values[rows] for name, values in raw.columns.items()},
        learned=_learned(ride, recording, raw),
        disturbances=_disturbances(raw, first),
    )


def _disturbances(raw: _Raw, first: int) -> Disturbances | None:
    """Return the disturbances of the simulator that a ride was recorded from: those told nearest to its begin."""
    if not raw.disturbed:
        return None
    message = min(raw.disturbed, key=lambda pair: abs(pair[0] - first))[1]
    return read_disturbances(str(message.data), "recorded")


def _learned(ride: Ride, recording: Recording, raw: _Raw) -> Learned | None:
    steps = [message for _, message in raw.learned if message.episode == ride.episode]
    if not steps or "task" not in recording.notes:
        return None
    card = json.loads(recording.notes["task"])
    try:
        task = PathTask.from_card(card)
    except (KeyError, TypeError) as error:
        raise RecordingError(f"{recording.path}: the task in its notes is of another version ({error})") from error
    return Learned(
        task=task,
        step=np.array([message.step for message in steps], dtype=np.int64),
        observation=np.array([message.observation for message in steps], dtype=np.float32),
        reward=np.array([message.reward for message in steps], dtype=np.float64),
    )


class _Raw:
    """States in full, starts and steps of learning of one vehicle.

    Attributes:
        order: index of each state in the recording, ascending.
        columns: fields of EXACT of all states.
        starts: messages of how episodes began, each with its index.
        learned: steps of learning, each with its index.
        disturbed: what simulators told of their disturbances, each with its index.
    """

    def __init__(self, files: tuple[Path, ...], namespace: str) -> None:
        states: ColumnReader | None = None
        orders: list[Integers] = []
        self.starts: list[tuple[int, Any]] = []
        self.learned: list[tuple[int, Any]] = []
        self.disturbed: list[tuple[int, Any]] = []
        lists = {
            f"{namespace}/episode": self.starts,
            f"{namespace}/learning/step": self.learned,
            f"{namespace}/disturbances": self.disturbed,
        }
        for topic, schema, block, rows, before in blocks_of(files, {f"{namespace}/state", *lists}):
            if topic in lists:
                for row in rows.tolist():
                    lists[topic].append((before + block.first + row, schema.decode(block.data(row))))
                continue
            states = states or _state_reader(schema)
            good = states.add_block(block.contents, block.begin[rows], block.end[rows])
            orders.append(before + block.first + rows[good])
        assert states is not None, "there are states, or the recording would have been refused"
        self.order = np.concatenate(orders)
        self.columns: Columns = states.finish()


def _state_reader(schema: MessageSchema) -> ColumnReader:
    missing = sorted(set(EXACT) - schema.fields())
    if missing:
        raise SchemaError(f"its states have no {', '.join(missing)}; were they recorded by another version?")
    return ColumnReader(schema, EXACT)


def blocks_of(files: tuple[Path, ...], topics: set[str]) -> Iterator[tuple[str, MessageSchema, Block, Integers, int]]:
    """Read the messages of some topics.

    Args:
        files: of a recording, in order.
        topics: names of the topics.

    Yields:
        Topic, type, block, rows of its messages in the block, and the number of messages in the files before.
    """
    before = 0
    for file in files:
        box, count = Container(file), 0
        for block in box.blocks():
            count += len(block)
            for number in np.unique(block.channel).tolist():
                channel = box.channels.get(number)
                if channel is None or channel.topic not in topics or channel.schema_id not in box.schemas:
                    continue
                schema = box.schemas[channel.schema_id]
                kind = MessageSchema(schema.name, schema.data.decode("utf-8", errors="replace"))
                yield channel.topic, kind, block, np.flatnonzero(block.channel == number), before
        before += count
