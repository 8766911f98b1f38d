"""Racing a superbike on a circuit: reward, penalty timers, failure and the error of a validation ride.

The terms are those of the published superbike reward (its Eq. 2, after Fuchs et al. 2021 and Vasco et al. 2024 where it
cites them), and some of our own. It gives no weights, constants or formulas for most of them: what stands here without
a source is ours, and docs/training.md says why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import DRIVE, LEAN_REQUEST, LINE_OFFSET, PACE, ActionColumn, ActionLayout
from bike_policy.contract.race import COMPACT, ObservationBuilder, RaceLayout
from bike_policy.contract.reference import OPEN
from bike_policy.contract.rows import RowBlocks
from bike_policy.riders.race_guide import RaceGuide, commands_of
from bike_policy.riders.race_reference import References
from bike_policy.riders.vehicle_descriptor import vehicle_descriptor
from bike_sim.course.course import Course
from bike_sim.physics import superbike_forces as sf
from bike_sim.physics.state import ROLL, ROLL_RATE, STEER
from bike_sim.sim import look as lk
from bike_sim.sim.request import COURSE_POINTS, Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.tasks.base import FloatArray, StepResult, check_positive_settings, check_weights

HISTORY_LEAST: Final = 0.014
HISTORY_SLOPE: Final = 182.883569
HISTORY_OFFSET: Final = 0.034
"""Constants c_d (rad), c_s (1/rad) and c_o (rad) of the history penalty (Vasco et al. 2024), made for a car's steering
at 10 Hz; for lean, which turns ten times as far, c_d and c_o are ten times as large and c_s a tenth."""
LEAN_FACTOR: Final = 10.0
STALLED: Final = 3.0
"""Speed below which a machine counts as stalled, m/s."""

MAX_STEPS: Final = 500
"""Decisions of an episode, 30 s at 60 ms."""


@dataclass
class RewardSignals:
    """What passed during a decision, row by row; rates are integrated over its control periods.

    Attributes:
        way: along the followed line, m; negative where the machine heads the wrong way.
        gain: time gained on the planned lap, s.
        off_track: speed times time with a contact point outside, m. fully_off: s with both outside.
        energy: kinetic energy per mass in a collision with a wall, m^2/s^2.
        line: distance to the line times time, m s. overspeed: beyond the speed asked, times time, m.
        lean_excess: beyond the largest lean, times time, rad s.
        slip: ratios, times time, s. drift: slip angles times time, rad s. use: of the tyres beyond their linear
            saturation, times time, s.
        motion: vertical and sideways speed of the machine, times time, m.
        steer_change: rad. lean_change: rad. rate_change: of the angular velocity, rad/s.
        steering_change: of the action. throttle_change: of the action. effort: sum of the squares of the action.
        steer_history: 0 to 1. lean_history: 0 to 1.
        fell: 1 where the ride is over. ended: 1 where the episode fails for any reason.
    """

    way: FloatArray
    gain: FloatArray
    off_track: FloatArray
    fully_off: FloatArray
    energy: FloatArray
    line: FloatArray
    overspeed: FloatArray
    lean_excess: FloatArray
    slip: FloatArray
    drift: FloatArray
    use: FloatArray
    motion: FloatArray
    steer_change: FloatArray
    lean_change: FloatArray
    rate_change: FloatArray
    steering_change: FloatArray
    throttle_change: FloatArray
    effort: FloatArray
    steer_history: FloatArray
    lean_history: FloatArray
    fell: FloatArray
    ended: FloatArray

    @classmethod
    def nothing(cls, count: int) -> RewardSignals:
        """Return what has passed before anything has."""
        return cls(**{spec.name: np.zeros(count) for spec in fields(cls)})


REWARD_TERMS: Final[Mapping[str, Callable[[RewardSignals], FloatArray]]] = {
    "progress": lambda passed: passed.way,
    "gain": lambda passed: passed.gain,
    "off_track": lambda passed: -passed.off_track,
    "wall": lambda passed: -passed.energy,
    "steer_change": lambda passed: -passed.steer_change,
    "lean_change": lambda passed: -passed.lean_change,
    "rate_change": lambda passed: -passed.rate_change,
    "steer_history": lambda passed: -passed.steer_history,
    "lean_history": lambda passed: -passed.lean_history,
    "max_lean": lambda passed: -passed.lean_excess,
    "slip_ratio": lambda passed: -passed.slip,
    "slip_angle": lambda passed: -passed.drift,
    "motion": lambda passed: -passed.motion,
    "tyre_use": lambda passed: -passed.use,
    "line": lambda passed: -passed.line,
    "overspeed": lambda passed: -passed.overspeed,
    "steering_change": lambda passed: -(passed.steering_change**2),
    "throttle_change": lambda passed: -(passed.throttle_change**2),
    "effort": lambda passed: -passed.effort,
    "fall": lambda passed: -passed.fell,
    "failure": lambda passed: -passed.ended,
}
"""Terms of the reward by name; all but progress and gain are at most 0."""

PAPER_WEIGHTS: Final[Mapping[str, float]] = {
    "progress": 1.0,
    "off_track": 1.0,
    "wall": 5e-4,
    "steer_change": 3.0,
    "lean_change": 1.0,
    "rate_change": 0.1,
    "steer_history": 0.5,
    "lean_history": 0.5,
    "max_lean": 20.0,
    "slip_ratio": 1.0,
    "slip_angle": 1.0,
    "motion": 0.05,
    "overspeed": 1.0,
    "fall": 10.0,
}
"""All terms of Eq. (2). Its weights are not published; these are ours."""

RACE_WEIGHTS: Final[Mapping[str, float]] = {
    "progress": 0.6,
    "off_track": 0.5,
    "line": 2.0,
    "overspeed": 1.7,
    "tyre_use": 1.7,
    "steering_change": 0.5,
    "throttle_change": 0.1,
    "failure": 5.0,
}
"""Those of policies that command the machine themselves: fewer terms, a reference for speed and line, calm commands."""

GUIDED_WEIGHTS: Final[Mapping[str, float]] = {
    "gain": 30.0,
    "off_track": 0.5,
    "tyre_use": 0.5,
    "effort": 0.05,
    "steering_change": 0.02,
    "throttle_change": 0.02,
    "failure": 60.0,
}
"""Those of policies with a guide: lap time, against what a failure costs, two seconds.

What the plan needs anyhow is left out of ``gain``, so that the critics have to tell hundredths of a second from
nothing, and not from the speed of a straight. Effort keeps the policy at the guide's own pace where another gains
nothing.
"""


@dataclass(frozen=True)
class RaceTask:
    """Settings of the task; implements `bike_training.tasks.base.Task`.

    Attributes:
        layout: of the observation.
        weights: terms of the reward by name, with their weights.
        max_steps: decisions of an episode.
        largest_lean: of the term ``max_lean``, rad.
        lean_scale: part of the virtual rider's largest lean that action 1 asks for.
        guided: whether actions are targets of a guide, as far as these: offset from the followed line, m.
        pace: change of the planned speed as a part of it.
        any_tyre: whether one contact point outside the limits is off the track, as published; else both.
        masked: whether progress counts on the track only (Wurman et al. 2022).
        off_track_time: penalty timer, s: time with both contact points outside that ends an episode.
        wrong_way_time: the same for heading the wrong way, s. stalled_time: for hardly moving, s.
        limiter: whether a speed limit cuts the throttle instead of being penalised alone.
        validation_duration: s.
    """

    layout: RaceLayout = COMPACT
    weights: Mapping[str, float] = field(default_factory=lambda: RACE_WEIGHTS)
    max_steps: int = MAX_STEPS
    largest_lean: float = math.radians(58.0)
    lean_scale: float = 0.95
    guided: bool = False
    offset: float = 0.6
    pace: float = 0.05
    any_tyre: bool = True
    masked: bool = True
    off_track_time: float = 1.0
    wrong_way_time: float = 1.0
    stalled_time: float = 2.0
    limiter: bool = False
    validation_duration: float = 120.0

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the value.
        """
        check_weights(self.weights, REWARD_TERMS)
        check_positive_settings(
            self, ("max_steps", "largest_lean", "lean_scale", "offset", "pace", "validation_duration")
        )
        for name in ("off_track_time", "wrong_way_time", "stalled_time"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)!r}")

    @property
    def preview(self) -> Preview:
        """The stations of the course points, which superbikes always show."""
        return COURSE_POINTS

    @property
    def action(self) -> ActionLayout:
        """Lean request, and throttle or brake; or line and pace of a guide."""
        if self.guided:
            return ActionLayout((ActionColumn(LINE_OFFSET, self.offset), ActionColumn(PACE, self.pace)))
        return ActionLayout((ActionColumn(LEAN_REQUEST, self.lean_scale), ActionColumn(DRIVE)))

    @property
    def repeat(self) -> int:
        """Control periods that a decision is held."""
        return self.layout.repeat

    def rides(self, count: int, vehicle: Vehicle) -> RaceRides:
        """Return what it shows and judges of a number of machines; see `Task`."""
        return RaceRides(self, count, vehicle)

    def strict(self) -> RaceTask:
        """Return the task as validations ride it: the first moment with both contact points outside fails."""
        return RaceTask(**{**self.__dict__, "off_track_time": 0.0})

    @property
    def error_name(self) -> str:
        """What the error of a ride is: its time over that of the planned lap, as a part of it."""
        return "excess"

    @property
    def largest_error(self) -> float:
        """The error that a failed ride counts as."""
        return 1.0

    def validation_error(self, errors: FloatArray, succeeded: bool) -> float:
        """Return how much longer a ride took than planned for its way, as a part of it.

        Args:
            errors: what is missing of the planned speed at each control period, as a part of it.
            succeeded: whether it did not fail.
        """
        rate = 1.0 - float(np.mean(errors)) if succeeded else 0.0
        return 1.0 / rate - 1.0 if rate > 0.5 else self.largest_error

    def selection_error(self, track: FloatArray, whole: NDArray[np.bool_]) -> float:
        """Return the mean excess of the rides; one that fails counts as much as all others being twice as slow."""
        errors = [self.validation_error(track[:, i], bool(whole[i])) for i in range(len(whole))]
        return float(np.mean(errors) + np.sum(~whole))

    def to_card(self) -> dict[str, Any]:
        """Return plain values for recordings."""
        return {**asdict(self), "weights": dict(self.weights), "layout": self.layout.to_card()}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> RaceTask:
        """Read what :meth:`to_card` wrote.

        Raises:
            ValueError: an entry is missing, unknown or wrong.
        """
        unknown = sorted(set(card) - {spec.name for spec in fields(cls)})
        if unknown or "layout" not in card:
            raise ValueError(f"the task has unknown entries {unknown}, or no layout; another version wrote it")
        return cls(**{**card, "layout": RaceLayout.from_card(card["layout"])})


@dataclass(frozen=True)
class RaceContext:
    """Context of an episode (V), as `ResetRequest.context` carries it.

    Attributes:
        d_median: distance from the median of the followed line, as a part of that of the ideal line.
        d_ideal: distance from the ideal line, the same.
        v_max: speed limit, m/s; OPEN for none.
        share: part of the planned speed that is asked.
        number: of the distribution that it was drawn from.
    """

    d_median: float = 1.0
    d_ideal: float = 0.0
    v_max: float = OPEN
    share: float = 1.0
    number: float = 0.0

    def to_request(self) -> tuple[float, ...]:
        """Return it as numbers."""
        return (self.d_median, self.d_ideal, self.v_max, self.share, self.number)

    @classmethod
    def of(cls, request: ResetRequest) -> RaceContext | None:
        """Return that of a request, or None where it holds none."""
        return cls(*request.context) if len(request.context) == len(fields(cls)) else None


class RaceRides:
    """What a race shows and judges of machines side by side; implements `bike_training.tasks.base.TaskState`.

    Attributes:
        eyes: make the observations.
    """

    def __init__(self, task: RaceTask, count: int, vehicle: Vehicle, action: ActionLayout | None = None) -> None:
        """Plan for a machine.

        Args:
            task: to be ridden.
            count: number of machines.
            vehicle: the machine.
            action: what actions mean; None for the task's.

        Raises:
            ValueError: it is no superbike.
        """
        self._task = task
        self._references = References(vehicle)
        self._period, self._max_steer = vehicle.control_period, vehicle.max_steer
        self._action = task.action if action is None else action
        self._guide = RaceGuide(vehicle, vehicle.control_period, count) if self._action.guided else None
        self.eyes = ObservationBuilder(task.layout, count, sf.TELEMETRY_NAMES, self._guide, vehicle_descriptor(vehicle))
        self._passed = RewardSignals.nothing(count)
        self._count = count
        self._progress = np.zeros(count)
        self._rate = np.ones(count)
        self._angles = np.zeros((count, 2))
        self._omega = np.zeros((count, 2))
        self._changes = np.zeros((count, 2, 2))
        self._timers = np.zeros((count, 3))
        self._limits = (task.off_track_time, task.wrong_way_time, task.stalled_time)
        self._over = np.zeros(count, dtype=np.bool_)
        self._expired = np.zeros(count, dtype=np.bool_)

    def begin(self, row: int, blocks: RowBlocks, request: ResetRequest, course: Course) -> None:
        """Begin the ride of one machine; see `TaskState`."""
        context = RaceContext.of(request)
        share, cap = (None, OPEN) if context is None else (context.share, context.v_max)
        self.eyes.begin(row, blocks, self._references.of(course), share, cap)
        if self._guide is not None:
            self._guide.begin(row, course)
        self._progress[row] = blocks.look[row, lk.PROGRESS]
        self._rate[row] = 1.0
        self._angles[row], self._omega[row] = blocks.state[row, [STEER, ROLL]], _omega(blocks)[row]
        self._changes[row], self._timers[row] = 0.0, 0.0
        self._over[row] = self._expired[row] = False

    def observe(self, blocks: RowBlocks) -> NDArray[np.float32]:
        """Return the observations; see `TaskState`."""
        return self.eyes.observe(blocks)

    def act(self, blocks: RowBlocks, actions: NDArray[np.floating]) -> None:
        """Begin a decision; see `TaskState`."""
        before = self.eyes.actions[:, 0].copy()
        self.eyes.act(blocks, actions)
        self._passed = RewardSignals.nothing(self._count)
        change = np.abs(self.eyes.actions[:, 0] - before)
        self._passed.steering_change, self._passed.throttle_change = change[:, 0], change[:, 1]
        self._passed.effort = np.sum(self.eyes.actions[:, 0] ** 2, axis=1)

    def commands(self, blocks: RowBlocks) -> FloatArray:
        """Return commands, with the throttle closed beyond the speed asked where the task has a limiter."""
        commands = commands_of(self._action, self._guide, self.eyes, blocks, self._max_steer)
        if self._task.limiter:
            _, asked = self.eyes.references.at(blocks.look[:, lk.PROGRESS])
            closed = np.minimum(commands[:, 1], 0.0)
            commands[:, 1] = np.where(blocks.look[:, lk.SPEED] > asked, closed, commands[:, 1])
        return commands

    def advance(self, blocks: RowBlocks) -> None:
        """Add a control period; see `TaskState`."""
        passed, dt, task = self._passed, self._period, self._task
        look, signals = blocks.look, blocks.signals
        running = ~self._over
        speed, error = look[:, lk.SPEED], np.abs(look[:, lk.LATERAL_ERROR])
        wrong = np.abs(look[:, lk.HEADING_ERROR]) > 0.5 * math.pi
        any_off, both_off = off_track(blocks)
        off = any_off if task.any_tyre else both_off
        way = np.where(blocks.fallen, 0.0, look[:, lk.PROGRESS] - self._progress)
        self._progress = look[:, lk.PROGRESS].copy()
        _, asked = self.eyes.references.at(self._progress)
        self._rate = way / (dt * asked / self.eyes.references.share)
        counted = np.where(wrong, -np.abs(way), way)
        gained = np.where(wrong, -1.0, self._rate - 1.0) * dt
        if task.masked:
            counted, gained = (np.where(both_off, np.minimum(part, 0.0), part) for part in (counted, gained))
        passed.way += running * counted
        passed.gain += running * gained
        passed.off_track += running * off * speed * dt
        passed.line += running * error * dt
        passed.overspeed += running * np.maximum(0.0, speed - asked) * dt
        passed.lean_excess += running * np.maximum(0.0, np.abs(blocks.state[:, ROLL]) - task.largest_lean) * dt
        passed.slip += running * _both(signals, sf.T_REAR_SLIP, sf.T_FRONT_SLIP, 1.0) * dt
        passed.drift += running * _both(signals, sf.T_REAR_DRIFT, sf.T_FRONT_DRIFT, math.pi) * dt
        passed.use += (
            running * np.maximum(0.0, np.maximum(signals[:, sf.T_REAR_USE], signals[:, sf.T_FRONT_USE]) - 1.0) * dt
        )
        passed.motion += running * speed * np.minimum(np.abs(signals[:, sf.T_REAR_DRIFT]), 1.0) * dt
        hit = running & blocks.fallen & (signals[:, sf.T_FALL] == 0.0)
        passed.energy += hit * 0.5 * signals[:, sf.T_SPEED] ** 2
        passed.fell += running & blocks.fallen
        for timer, ticking in enumerate((both_off, wrong, speed < STALLED)):
            self._timers[:, timer] = np.where(ticking, self._timers[:, timer] + dt, 0.0)
            self._expired |= self._timers[:, timer] > self._limits[timer] + 1e-9
        self._over |= blocks.fallen

    def evaluate(self, blocks: RowBlocks) -> StepResult:
        """Return what has come of the decision; see `TaskState`."""
        passed, task = self._passed, self._task
        angles, omega = blocks.state[:, [STEER, ROLL]], _omega(blocks)
        change = angles - self._angles
        passed.steer_change, passed.lean_change = np.abs(change[:, 0]), np.abs(change[:, 1])
        passed.rate_change = np.sqrt(np.sum((omega - self._omega) ** 2, axis=1))
        self._changes = np.stack((change, self._changes[:, 0]), axis=1)
        passed.steer_history = history_penalty(self._changes[:, :, 0])
        passed.lean_history = history_penalty(self._changes[:, :, 1] / LEAN_FACTOR)
        self._angles, self._omega = angles, omega
        failed = blocks.fallen | self._expired
        passed.ended = failed.astype(np.float64)
        return StepResult({name: weight * REWARD_TERMS[name](passed) for name, weight in task.weights.items()}, failed)

    def error(self, blocks: RowBlocks) -> FloatArray:
        """Return what is missing of the planned speed in the last control period, as a part of it."""
        return 1.0 - self._rate

    def state_dict(self) -> dict[str, Any]:
        """Return the memory; see `TaskState`."""
        guide = {} if self._guide is None else self._guide.state_dict()
        own = {name: getattr(self, f"_{name}").copy() for name in _MEMORY}
        return {"eyes": self.eyes.state_dict(), "guide": guide, **own}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Take up the memory; see `TaskState`."""
        self.eyes.restore(stored["eyes"])
        if self._guide is not None:
            self._guide.restore(stored["guide"])
        for name in _MEMORY:
            getattr(self, f"_{name}")[...] = stored[name]


_MEMORY: Final = ("progress", "rate", "angles", "omega", "changes", "timers", "over", "expired")


def off_track(blocks: RowBlocks) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where one contact point at least, and where both are outside the limits, shape (n,) each."""
    margins = blocks.circuit[:, : lk.OUTSIDE]
    rear_off, front_off = np.min(margins[:, :2], axis=1) < 0.0, np.min(margins[:, 2:], axis=1) < 0.0
    return rear_off | front_off, rear_off & front_off


def history_penalty(changes: FloatArray) -> FloatArray:
    """Return the penalty for turning to and fro, 0 to 1 (Vasco et al. 2024).

    It counts where the last two changes have opposite signs and both exceed HISTORY_LEAST.

    Args:
        changes: the last one and the one before, rad, shape (n, 2).
    """
    size = np.abs(changes)
    swings = (changes[:, 0] * changes[:, 1] < 0.0) & np.all(size > HISTORY_LEAST, axis=1)
    return swings / (1.0 + np.exp(-HISTORY_SLOPE * (np.sum(size, axis=1) - HISTORY_OFFSET)))


def _omega(blocks: RowBlocks) -> FloatArray:
    return np.stack((blocks.state[:, ROLL_RATE], blocks.look[:, lk.YAW_RATE]), axis=1)


def _both(signals: FloatArray, rear: int, front: int, most: float) -> FloatArray:
    return np.minimum(np.abs(signals[:, rear]), most) + np.minimum(np.abs(signals[:, front]), most)
