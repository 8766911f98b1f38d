"""Replay of a recorded ride with the same start and commands, and comparison of the states.

The simulator is deterministic, so on the same machine the ride must be the same bit for bit, however it was recorded:
in lockstep, free-running or in training. A state carries the command that led to it, so nothing depends on when
commands came. With another engine or time step the rides diverge, and the comparison shows how fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import rows_of
from bike_policy.riders.rider import Rider
from bike_sim.course.course import Course
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.replay.recorded_rides import COMMANDS, EXACT, FLAGS, Columns, Learned, RideSource, Start
from bike_training.rollout.rollout import rollout
from bike_training.tasks.base import sum_of

APART_AT: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
"""Times at which the difference of diverging rides is reported, s; the end is added."""


@dataclass(frozen=True)
class Difference:
    """Where two rides first differ.

    Attributes:
        step: control step of the state. time: s since the reset.
        field: first field of the state that differs, as it is called in BikeState, ``observation`` or ``reward``.
        recorded: its value in the recording. ridden: its value now.
    """

    step: int
    time: float
    field: str
    recorded: float
    ridden: float


@dataclass(frozen=True)
class Apart:
    """How far two rides are apart at a time.

    Attributes:
        time: s since the reset.
        position: distance between the rear contact points, m.
        roll: difference of the roll angles, rad. steer: of the steering angles, rad.
    """

    time: float
    position: float
    roll: float
    steer: float


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
    tell: Callable[[int, int], None] | None = None,
) -> Replay:
    """Replay a recorded ride and compare.

    Args:
        recorded: the ride.
        engine: another engine than the recorded one.
        time_step: another integration step, s.
        tell: called with steps ridden and steps in all, to show progress.

    Raises:
        ValueError: the recording does not say how the ride began, its vehicle is another one now, or engine and step do
            not fit. FileNotFoundError: its vehicle or course is not here.
    """
    start = _start_of(recorded)
    config = start.config if engine is None else replace(start.config, engine=engine)
    config = config if time_step is None else replace(config, time_step=time_step)
    steering, throttle, stopped = _commands(recorded)
    ridden = _Ridden(recorded.learned)
    simulator = Simulator(config, recorded.disturbances)
    try:
        for snapshot in rollout(simulator, RecordedCommands(steering, throttle), start.request):
            ridden.note(snapshot)
            if tell is not None:
                tell(snapshot.step, len(steering))
            if snapshot.fallen and snapshot.step < len(steering):
                stopped = f"it falls after {snapshot.time:.2f} s now, where the recorded ride goes on"
    finally:
        simulator.close()
    return _compare(recorded, config, ridden, stopped)


def ride_with(
    recorded: RideSource, rider: Callable[[RecordedCommands], Rider], tell: Callable[[int, int], None] | None = None
) -> None:
    """Ride a recorded ride again, with a rider that looks on.

    Args:
        recorded: the ride.
        rider: makes the rider of the recorded commands.
        tell: called with steps ridden and steps in all, to show progress.

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
            if tell is not None:
                tell(snapshot.step, len(steering))
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
    """Collects the replayed ride in the columns of the recording."""

    def __init__(self, learned: Learned | None) -> None:
        self._rows: list[NDArray[np.float64]] = []
        self._task = learned.task if learned is not None else None
        self.observations: list[NDArray[np.float32]] = []
        self.rewards: list[float] = []

    def note(self, snapshot: Snapshot) -> None:
        flags = [getattr(snapshot, name) for name in FLAGS]
        others = [snapshot.steering, snapshot.throttle, snapshot.steer_torque, *flags]
        self._rows.append(np.concatenate([snapshot.state, snapshot.look, others]))
        if self._task is not None:
            rows = rows_of(snapshot)
            self.observations.append(self._task.layout.observe(rows)[0])
            self.rewards.append(float(sum_of(self._task.reward_terms(rows))[0]))

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
    mine = np.flatnonzero(learned.step + 1 < len(ridden.rewards))
    steps = learned.step[mine]
    observations = np.array(ridden.observations)[steps]
    width = learned.observation.shape[1]
    before = {f"observation[{k}]": learned.observation[mine, k].astype(np.float64) for k in range(width)}
    after = {f"observation[{k}]": observations[:, k].astype(np.float64) for k in range(width)}
    before["reward"], after["reward"] = learned.reward[mine], np.array(ridden.rewards)[steps + 1]
    return len(mine), _first_difference(before, after, steps, period)


def _apart(before: Columns, after: Columns, time: NDArray[np.float64]) -> tuple[Apart, ...]:
    moments = [int(np.searchsorted(time, moment - 1e-9)) for moment in APART_AT if moment < time[-1]]
    found = []
    for row in [*moments, len(time) - 1]:
        by = {name: float(after[name][row] - before[name][row]) for name in ("x", "y", "roll", "steer")}
        found.append(Apart(float(time[row]), float(np.hypot(by["x"], by["y"])), by["roll"], by["steer"]))
    return tuple(found)
