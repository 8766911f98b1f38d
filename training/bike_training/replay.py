"""Replay of recorded rides: their reading without ROS, and their riding again with comparison of the states.

The simulator is deterministic, so on the same machine the ride must be the same bit for bit, however it was recorded:
in lockstep, free-running or in training. A state carries the command that led to it, so nothing depends on when
commands came. With another engine or time step the rides diverge, and the comparison shows how fast.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.read.container import Block, Container, RecordingError, find_files
from bike_analysis.read.reading import Recording, read_recording
from bike_analysis.read.rides import Ride, find_rides
from bike_policy.contract.observation import Rows, rows_of
from bike_policy.riders.rider import Rider
from bike_sim.course.course import Course
from bike_sim.course.random_courses import PathRanges
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances, read_disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.rollout.rollout import rollout
from bike_training.tasks.base import Task, TaskState, sum_of
from bike_training.tasks.path import PathTask
from bike_training.tasks.race import RaceTask

Integers = NDArray[np.int64]
Columns = dict[str, NDArray[Any]]

COMMANDS: Final = ("steering_command", "throttle_command")
FLAGS: Final = ("fallen", "off_course", "finished")
EXACT: Final = (*st.FIELDS, *lk.FIELDS, *COMMANDS, "steer_torque", *FLAGS)
"""Fields of a recorded state that are replayed: all but preview and history, which follow from them."""

_LINE_START: Final = ("speed_share", "start_offset", "start_heading")


@dataclass(frozen=True)
class Start:
    """Beginning of a ride (``bike_msgs/EpisodeStart``).

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
                # Relative to the line of a circuit; recordings before these fields have none.
                **{name: float(getattr(message, name, 0.0)) for name in _LINE_START},
            ),
        )


@dataclass(frozen=True)
class Learned:
    """Steps of learning of a ride (``bike_msgs/LearningStep``).

    Attributes:
        task: that was learned.
        step: control step whose state was observed, shape (n,).
        observation: of the policy, shape (n, layout size), float32.
        action: its answer, shape (n, columns of the action).
        reward: for the control periods that followed, shape (n,).
    """

    task: Task
    step: Integers
    observation: NDArray[np.float32]
    action: NDArray[np.float64]
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
    """Return the disturbances of the simulator that a ride was recorded from: those published nearest to its begin."""
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
        task = (RaceTask if card.get("task") == "race" else PathTask).from_card(card)
    except (AttributeError, KeyError, TypeError) as error:
        raise RecordingError(f"{recording.path}: the task in its notes is of another version ({error})") from error
    action = np.array([np.ravel(message.action) for message in steps], dtype=np.float64)
    if action.shape[1] != task.action.size:
        return None  # an older version recorded the first number of the action alone
    return Learned(
        task=task,
        step=np.array([message.step for message in steps], dtype=np.int64),
        observation=np.array([message.observation for message in steps], dtype=np.float32),
        action=action,
        reward=np.array([message.reward for message in steps], dtype=np.float64),
    )


class _Raw:
    """States in full, starts and steps of learning of one vehicle.

    Attributes:
        order: index of each state in the recording, ascending.
        columns: fields of EXACT of all states.
        starts: messages of how episodes began, each with its index.
        learned: steps of learning, each with its index.
        disturbed: disturbances that simulators published, each with its index.
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


APART_AT: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
"""Times at which the difference of diverging rides is reported, s; the end is added."""


class Difference(NamedTuple):
    """First difference of two rides.

    Attributes:
        step: control step of the state.
        time_s: since the reset.
        field: first field of the state that differs, as it is called in BikeState, ``observation`` or ``reward``.
        recorded: its value in the recording.
        ridden: its value in the replay.
    """

    step: int
    time_s: float
    field: str
    recorded: float
    ridden: float


class Apart(NamedTuple):
    """Distance of two rides at a time.

    Attributes:
        time_s: since the reset.
        position_m: distance between the rear contact points.
        roll_deg: difference of the roll angles.
        steer_deg: difference of the steering angles.
    """

    time_s: float
    position_m: float
    roll_deg: float
    steer_deg: float


@dataclass(frozen=True)
class Replay:
    """Result of a replay.

    Attributes:
        config: the simulator that it was ridden in.
        states: states that were compared.
        recorded_states: states that the recording holds.
        missing: steps without a recorded state before the last one that could be ridden.
        stopped: why not all recorded states could be compared; empty if they were.
        difference: where the rides first differ, or None.
        apart: difference over time; empty where they are the same.
        learned: steps of learning that were compared.
        learned_difference: where observation or reward first differ from the replayed ones, or None.
    """

    config: SimulatorConfig
    states: int
    recorded_states: int
    missing: int
    stopped: str
    difference: Difference | None
    apart: tuple[Apart, ...]
    learned: int
    learned_difference: Difference | None

    @property
    def same(self) -> bool:
        """Whether all that was recorded came out again, bit for bit."""
        return not self.stopped and self.difference is None and self.learned_difference is None


def ride_again(
    recorded: RideSource,
    engine: str | None = None,
    time_step: float | None = None,
    report: Callable[[int, int], None] | None = None,
) -> Replay:
    """Replay a recorded ride and compare.

    Args:
        recorded: the ride.
        engine: another engine than the recorded one.
        time_step: another integration step, s.
        report: called with steps ridden and steps in all, to show progress.

    Raises:
        ValueError: the recording does not say how the ride began, its vehicle is another one now, or engine and step do
            not fit. FileNotFoundError: its vehicle or course is not here.
    """
    start = _start_of(recorded)
    config = start.config if engine is None else replace(start.config, engine=engine)
    config = config if time_step is None else replace(config, time_step=time_step)
    steering, throttle, stopped = _commands(recorded)
    simulator = Simulator(config, recorded.disturbances)
    ridden = _Ridden(recorded.learned, simulator, start.request)
    try:
        for snapshot in rollout(simulator, RecordedCommands(steering, throttle), start.request):
            ridden.note(snapshot)
            if report is not None:
                report(snapshot.step, len(steering))
            if snapshot.fallen and snapshot.step < len(steering):
                stopped = f"it falls after {snapshot.time:.2f} s now, where the recorded ride goes on"
    finally:
        simulator.close()
    return _compare(recorded, config, ridden, stopped)


def ride_with(
    recorded: RideSource, rider: Callable[[RecordedCommands], Rider], report: Callable[[int, int], None] | None = None
) -> None:
    """Ride a recorded ride again, with a rider that looks on.

    Args:
        recorded: the ride.
        rider: makes the rider of the recorded commands.
        report: called with steps ridden and steps in all, to show progress.

    Raises:
        ValueError: the ride cannot be ridden again to its end. FileNotFoundError: its vehicle or course is not here.
    """
    start = _start_of(recorded)
    steering, throttle, stopped = _commands(recorded)
    if stopped:
        raise ValueError(stopped)
    simulator = Simulator(start.config, recorded.disturbances)
    try:
        for snapshot in rollout(simulator, rider(RecordedCommands(steering, throttle)), start.request):
            if report is not None:
                report(snapshot.step, len(steering))
    finally:
        simulator.close()


class RecordedCommands:
    """The commands of a recorded ride as a rider; it has no answer after the last of them."""

    name = "recorded"
    preview: Preview | None = None

    def __init__(self, steering: NDArray[np.float64], throttle: NDArray[np.float64]) -> None:
        """Take the commands of each step, in [-1, 1]."""
        self._commands = list(zip(steering.tolist(), throttle.tolist(), strict=True))

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Need nothing; see `bike_policy.riders.rider.Rider`."""

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the recorded command of the step."""
        return self._commands[snapshot.step] if snapshot.step < len(self._commands) else None


def _start_of(recorded: RideSource) -> Start:
    """Return how the ride began, if it can begin so again.

    Raises:
        ValueError: that was not recorded, or its vehicle is another now. FileNotFoundError: the vehicle is not here.
    """
    start = recorded.start
    if start is None:
        raise ValueError(
            f"ride {recorded.ride.index}: the recording has no message on /episode for it, so it does not say how the "
            "ride began; record that topic, too"
        )
    name = load_vehicle(start.config.vehicle).name
    if name != recorded.vehicle:
        vehicle = start.config.vehicle
        raise ValueError(f"the recorded ride is one of {recorded.vehicle!r}, but {vehicle!r} is {name!r} now")
    return start


def _commands(recorded: RideSource) -> tuple[NDArray[np.float64], NDArray[np.float64], str]:
    """Return steering and throttle of each control period from the reset, as far as they are known without a gap.

    A state that was lost is bridged by the recorded command that answers the state before it. Whether that was the one
    that was applied shows at the next state.

    Returns:
        Both commands, and why they end before the last recorded state (empty if they do not).
    """
    steps = recorded.ride.states.step
    given = recorded.ride.commands
    applied: dict[int, tuple[float, float]] = {}
    for step, steering, throttle in zip(given.step.tolist(), given.steering, given.throttle, strict=True):
        applied.setdefault(step, (float(np.clip(steering, -1.0, 1.0)), float(np.clip(throttle, -1.0, 1.0))))
    for step, steering, throttle in zip(steps.tolist(), *(recorded.columns[name] for name in COMMANDS), strict=True):
        applied[step - 1] = (float(steering), float(throttle))
    last = int(steps[-1])
    known = next((step for step in range(last) if step not in applied), last)
    stopped = ""
    if known < last:
        after = int(steps[steps > known + 1][0]) if (steps > known + 1).any() else last
        stopped = (
            f"the states of steps {known + 1} to {after - 1} are missing in the recording, and so is the command of "
            f"step {known}: it can be ridden again up to there only"
        )
    pairs = np.array([applied[step] for step in range(known)]).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1], stopped


class _Ridden:
    """Collects the replayed ride in the columns of the recording, and what its task shows and rewards.

    Attributes:
        observations: by the control step of the state.
        rewards: by the control step of the state that was observed before the decision.
    """

    def __init__(self, learned: Learned | None, simulator: Simulator, request: ResetRequest) -> None:
        self._rows: list[NDArray[np.float64]] = []
        self._simulator, self._request = simulator, request
        self._task: TaskState | None = None
        self._actions: dict[int, NDArray[np.float64]] = {}
        if learned is not None:
            self._task, self._repeat = learned.task.make_state(1, simulator.vehicle), learned.task.repeat
            self._actions = dict(zip(learned.step.tolist(), learned.action, strict=True))
        self._decided = -1
        self.observations: dict[int, NDArray[np.float32]] = {}
        self.rewards: dict[int, float] = {}

    def note(self, snapshot: Snapshot) -> None:
        flags = [getattr(snapshot, name) for name in FLAGS]
        others = [snapshot.steering, snapshot.throttle, snapshot.steer_torque, *flags]
        self._rows.append(np.concatenate([snapshot.state, snapshot.look, others]))
        if self._task is not None:
            self._learn(self._task, snapshot, rows_of(snapshot))

    def _learn(self, task: TaskState, snapshot: Snapshot, rows: Rows) -> None:
        """Evaluate the decision that a snapshot ends, and observe where the next one begins."""
        if snapshot.step == 0:
            assert self._simulator.course is not None
            task.begin(0, rows, self._request, self._simulator.course)
        elif self._decided >= 0:
            task.advance(rows)
            if snapshot.step - self._decided == self._repeat or snapshot.fallen:
                self.rewards[self._decided] = float(sum_of(task.evaluate(rows).terms)[0])
                self._decided = -1
        if snapshot.step in self._actions and self._decided < 0:
            self.observations[snapshot.step] = task.observe(rows)[0]
            task.act(rows, self._actions[snapshot.step][None])
            self._decided = snapshot.step
        if self._decided >= 0:
            task.commands(rows)  # a guide remembers them

    def columns(self) -> Columns:
        return dict(zip(EXACT, np.stack(self._rows, axis=1), strict=True))


def _compare(recorded: RideSource, config: SimulatorConfig, ridden: _Ridden, stopped: str) -> Replay:
    now = ridden.columns()
    steps = recorded.ride.states.step
    mine = np.flatnonzero(steps < len(now["x"]))
    known = steps[mine]
    period = config.control_period
    before = {name: recorded.columns[name][mine].astype(np.float64) for name in EXACT}
    after = {name: now[name][known] for name in EXACT}
    difference = _first_difference(before, after, known, period)
    count, learned_difference = 0, None
    if recorded.learned is not None:
        count, learned_difference = _compare_learned(recorded.learned, ridden, period)
    return Replay(
        config=config,
        states=len(mine),
        recorded_states=len(steps),
        missing=int(known[-1]) + 1 - len(mine) if len(mine) else 0,
        stopped=stopped,
        difference=difference,
        apart=_apart(before, after, np.asarray(known * period, dtype=np.float64)) if difference is not None else (),
        learned=count,
        learned_difference=learned_difference,
    )


def _first_difference(before: Columns, after: Columns, steps: NDArray[np.int64], period: float) -> Difference | None:
    """Return the first row in which columns differ in any bit, and the first column that does."""
    differs = {name: before[name].view(np.int64) != after[name].view(np.int64) for name in before}
    rows = {name: int(np.argmax(mask)) for name, mask in differs.items() if mask.any()}
    if not rows:
        return None
    name = min(rows, key=lambda name: rows[name])
    row = rows[name]
    return Difference(
        int(steps[row]), float(steps[row] * period), name, float(before[name][row]), float(after[name][row])
    )


def _compare_learned(learned: Learned, ridden: _Ridden, period: float) -> tuple[int, Difference | None]:
    """Compare recorded with replayed learning data: the observation, and the reward of the next state."""
    mine = np.array([row for row, step in enumerate(learned.step.tolist()) if step in ridden.rewards], dtype=np.intp)
    steps = learned.step[mine]
    observations = np.array([ridden.observations[step] for step in steps.tolist()], dtype=np.float64)
    width = learned.observation.shape[1]
    before = {f"observation[{k}]": learned.observation[mine, k].astype(np.float64) for k in range(width)}
    after = {f"observation[{k}]": observations[:, k] for k in range(width)} if len(mine) else before
    before["reward"] = learned.reward[mine]
    after["reward"] = np.array([ridden.rewards[step] for step in steps.tolist()])
    return len(mine), _first_difference(before, after, steps, period)


def _apart(before: Columns, after: Columns, time: NDArray[np.float64]) -> tuple[Apart, ...]:
    moments = [int(np.searchsorted(time, moment - 1e-9)) for moment in APART_AT if moment < time[-1]]
    found = []
    for row in [*moments, len(time) - 1]:
        by = {name: float(after[name][row] - before[name][row]) for name in ("x", "y", "roll", "steer")}
        angles = math.degrees(by["roll"]), math.degrees(by["steer"])
        found.append(Apart(float(time[row]), float(np.hypot(by["x"], by["y"])), *angles))
    return tuple(found)
