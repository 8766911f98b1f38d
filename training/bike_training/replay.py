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

from bike_analysis.figures.rides import Ride, find_rides
from bike_analysis.read.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.read.container import Container, RecordingError, find_files
from bike_analysis.read.reading import Recording, read_recording
from bike_policy.contract.observation import rows_of
from bike_policy.riders.base import Rider
from bike_sim.course.course import Course
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
_LISTED: Final = ("episode", "learning/step", "disturbances")
"""Other topics of a ride."""


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
        config = SimulatorConfig(**{spec.name: getattr(message, spec.name) for spec in fields(SimulatorConfig)})
        return cls(config, ResetRequest.from_message(message))


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
        order, columns, messages = _read_all(find_files(path), recording.namespace)
    except SchemaError as error:
        raise RecordingError(f"{path}: {error}") from error

    def nearest(found: list[tuple[int, Any]], first: int) -> Any | None:
        return min(found, key=lambda pair: abs(pair[0] - first))[1] if found else None

    rides = []
    for ride in find_rides(recording):
        rows, first = np.searchsorted(order, ride.states.order), int(ride.states.order[0])
        # A simulator that was restarted counts its episodes from 1 again: the nearest message is this ride's.
        start = nearest([pair for pair in messages["episode"] if pair[1].episode == ride.episode], first)
        disturbed = nearest(messages["disturbances"], first)
        steps = [message for _, message in messages["learning/step"] if message.episode == ride.episode]
        rides.append(
            RideSource(
                ride=ride,
                vehicle=recording.vehicle,
                start=Start.from_message(start) if start is not None else None,
                columns={name: values[rows] for name, values in columns.items()},
                learned=_learned(steps, recording),
                disturbances=None if disturbed is None else read_disturbances(str(disturbed.data), "recorded"),
            )
        )
    return recording, tuple(rides)


def _learned(steps: list[Any], recording: Recording) -> Learned | None:
    if not steps or "task" not in recording.notes:
        return None
    card = json.loads(recording.notes["task"])
    try:
        task = (RaceTask if card.get("task") == "race" else PathTask).from_card(card)
    except (AttributeError, ValueError) as error:
        raise RecordingError(f"{recording.path}: the task in its notes is of another version ({error})") from error
    return Learned(
        task=task,
        step=np.array([message.step for message in steps], dtype=np.int64),
        observation=np.array([message.observation for message in steps], dtype=np.float32),
        action=np.array([np.ravel(message.action) for message in steps], dtype=np.float64),
        reward=np.array([message.reward for message in steps], dtype=np.float64),
    )


def _read_all(files: tuple[Path, ...], namespace: str) -> tuple[Integers, Columns, dict[str, list[tuple[int, Any]]]]:
    """Read states in full, and the messages of other topics of one vehicle.

    Args:
        files: of a recording, in order.
        namespace: of the vehicle.

    Returns:
        Index of each state in the recording, ascending; fields of EXACT of all states; decoded messages of _LISTED by
        topic, each with its index.
    """
    states: ColumnReader | None = None
    orders: list[Integers] = []
    lists: dict[str, list[tuple[int, Any]]] = {name: [] for name in _LISTED}
    before = 0
    for file in files:
        box, count = Container(file), 0
        for block in box.blocks():
            count += len(block)
            for number in np.unique(block.channel).tolist():
                channel = box.channels.get(number)
                topic = "" if channel is None else channel.topic.removeprefix(f"{namespace}/")
                if channel is None or topic not in ("state", *lists) or channel.schema_id not in box.schemas:
                    continue
                stored = box.schemas[channel.schema_id]
                schema = MessageSchema(stored.name, stored.data.decode("utf-8", errors="replace"))
                rows = np.flatnonzero(block.channel == number)
                if topic in lists:
                    lists[topic] += [
                        (before + block.first + row, schema.decode(block.data(row))) for row in rows.tolist()
                    ]
                    continue
                states = states or _state_reader(schema)
                good = states.add_block(block.contents, block.begin[rows], block.end[rows])
                orders.append(before + block.first + rows[good])
        before += count
    assert states is not None, "there are states, or the recording would have been refused"
    return np.concatenate(orders), states.finish(), lists


def _state_reader(schema: MessageSchema) -> ColumnReader:
    missing = sorted(set(EXACT) - schema.fields())
    if missing:
        raise SchemaError(f"its states have no {', '.join(missing)}; were they recorded by another version?")
    return ColumnReader(schema, EXACT)


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
    changes: dict[str, Any] = {"engine": engine, "time_step": time_step}
    config = replace(start.config, **{name: value for name, value in changes.items() if value is not None})
    ridden = _Ridden(recorded.learned, start.request)
    steering, throttle, stopped = _commands(recorded)
    simulator = Simulator(config, recorded.disturbances)
    try:
        for snapshot in rollout(simulator, RecordedCommands(steering, throttle), start.request):
            ridden.note(snapshot, simulator)
            if report is not None:
                report(snapshot.step, len(steering))
            if snapshot.fallen and snapshot.step < len(steering):
                stopped = f"it falls after {snapshot.time:.2f} s now, where the recorded ride goes on"
    finally:
        simulator.close()
    now = dict(zip(EXACT, np.stack(ridden.rows, axis=1), strict=True))
    steps, period = recorded.ride.states.step, config.control_period
    mine = np.flatnonzero(steps < len(ridden.rows))
    known = steps[mine]
    before = {name: recorded.columns[name][mine].astype(np.float64) for name in EXACT}
    after = {name: now[name][known] for name in EXACT}
    difference = _first_difference(before, after, known, period)
    learned = (0, None) if recorded.learned is None else _compare_learned(recorded.learned, ridden, period)
    return Replay(
        config=config,
        states=len(mine),
        recorded_states=len(steps),
        missing=int(known[-1]) + 1 - len(mine) if len(mine) else 0,
        stopped=stopped,
        difference=difference,
        apart=_apart(before, after, np.asarray(known * period, dtype=np.float64)) if difference is not None else (),
        learned=learned[0],
        learned_difference=learned[1],
    )


def ride_with(
    recorded: RideSource, rider: Callable[[RecordedCommands], Rider], report: Callable[[int, int], None] | None = None
) -> None:
    """Ride a recorded ride again, with a rider that looks on.

    Args:
        recorded: the ride.
        rider: makes the rider of the recorded commands.
        report: called with steps ridden and steps in all, to show progress.

    Raises:
        ValueError: the ride cannot be ridden again to its end.
        FileNotFoundError: its vehicle or course is not here.
    """
    for snapshot, _ in replayed(recorded, rider):
        if report is not None:
            report(snapshot.step, int(recorded.ride.states.step[-1]))


def replayed(
    recorded: RideSource, rider: Callable[[RecordedCommands], Rider] = lambda commands: commands
) -> Iterator[tuple[Snapshot, Preview]]:
    """Ride a recorded ride again and yield its snapshots, each with the form of its preview; see `ride_with`."""
    start = _start_of(recorded)
    steering, throttle, stopped = _commands(recorded)
    if stopped:
        raise ValueError(stopped)
    simulator = Simulator(start.config, recorded.disturbances)
    try:
        for snapshot in rollout(simulator, rider(RecordedCommands(steering, throttle)), start.request):
            yield snapshot, simulator.preview
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
        """Need nothing; see `bike_policy.riders.base.Rider`."""

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
        rows: of EXACT, one a state.
        observations: by the control step of the state.
        rewards: by the control step of the state that was observed before the decision.
    """

    def __init__(self, learned: Learned | None, request: ResetRequest) -> None:
        self.rows: list[NDArray[np.float64]] = []
        self.observations: dict[int, NDArray[np.float32]] = {}
        self.rewards: dict[int, float] = {}
        self._learned, self._request, self._decided = learned, request, -1
        self._task: TaskState | None = None
        self._actions = {} if learned is None else dict(zip(learned.step.tolist(), learned.action, strict=True))

    def note(self, snapshot: Snapshot, simulator: Simulator) -> None:
        flags = [getattr(snapshot, name) for name in FLAGS]
        others = [snapshot.steering, snapshot.throttle, snapshot.steer_torque, *flags]
        self.rows.append(np.concatenate([snapshot.state, snapshot.look, others]))
        if self._learned is None:
            return
        rows, step = rows_of(snapshot), snapshot.step
        if self._task is None:
            assert simulator.course is not None
            self._task = self._learned.task.make_state(1, simulator.vehicle)
            self._task.begin(0, rows, self._request, simulator.course)
        elif self._decided >= 0:
            self._task.advance(rows)
            if step - self._decided == self._learned.task.repeat or snapshot.fallen:
                self.rewards[self._decided] = float(sum_of(self._task.evaluate(rows).terms)[0])
                self._decided = -1
        if step in self._actions and self._decided < 0:
            self.observations[step] = self._task.observe(rows)[0]
            self._task.act(rows, self._actions[step][None])
            self._decided = step
        if self._decided >= 0:
            self._task.commands(rows)  # a guide remembers them


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
