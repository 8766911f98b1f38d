"""Racing a superbike on a circuit: reward, penalty timers, failure and the error of a validation ride.

The terms are those of the published superbike reward (its Eq. 2, after Fuchs et al. 2021 and Vasco et al. 2024 where it
cites them), and some of our own. It gives no weights, constants or formulas for most of them: what stands here without
a source is ours, and docs/reference/training.md says why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.contract.action import DRIVE, LEAN_REQUEST, LINE_OFFSET, PACE, ActionColumn, ActionLayout
from bike_policy.contract.observation import RACE_LAYOUTS, ObservationLayout, VehicleRows
from bike_policy.planning.lap_plan import Planner
from bike_policy.planning.reference import OPEN
from bike_policy.riders.racing import RaceInterface
from bike_sim.course.course import Course
from bike_sim.physics.state import ROLL, ROLL_RATE, STEER
from bike_sim.schema import SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim.request import COURSE_POINTS, Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.settings import AT_LEAST_0, AT_LEAST_1, POSITIVE, check_choice
from bike_training.tasks.base import FloatArray, StepResult, Task, TaskState

HISTORY_PERIOD: Final = 0.06
"""Time over which a change of an angle is taken, s: about half a period of wobble (9 Hz), a quarter of one of weave."""
PUBLISHED_PERIOD: Final = 0.1
"""Time between two steps of the source of the history penalty, s."""
_PERIODS: Final = HISTORY_PERIOD / PUBLISHED_PERIOD
HISTORY_LEAST: Final = 0.014 * _PERIODS
HISTORY_SLOPE: Final = 182.883569 / _PERIODS
HISTORY_OFFSET: Final = 0.034 * _PERIODS
"""Constants c_d (rad), c_s (1/rad) and c_o (rad) of the history penalty (Vasco et al. 2024), made for a car's steering
at 10 Hz, for the same rates over HISTORY_PERIOD; for lean, which turns ten times as far, c_d and c_o are ten times as
large and c_s a tenth."""
LEAN_FACTOR: Final = 10.0
STALLED: Final = 3.0
"""Speed below which a machine counts as stalled, m/s."""

MAX_STEPS: Final = 500
"""Decisions of an episode, 30 s at 60 ms."""

_REAR_SLIP, _FRONT_SLIP = map(SIGNALS.index, ("rear_slip", "front_slip"))
_REAR_SLIP_ANGLE, _FRONT_SLIP_ANGLE = map(SIGNALS.index, ("rear_slip_angle", "front_slip_angle"))
_REAR_USE, _FRONT_USE = map(SIGNALS.index, ("rear_use", "front_use"))
_SPEED, _VERTICAL_VELOCITY, _FALL = map(SIGNALS.index, ("speed", "vertical_velocity", "fall"))


REWARD_TERMS: Final[Mapping[str, Callable[[FloatArray], FloatArray]]] = {
    **{name: np.positive for name in ("progress", "gain", "place")},
    **{name: np.negative for name in (
        "off_track", "wall", "steer_change", "lean_change", "rate_change", "steer_history", "lean_history", "max_lean",
        "slip_ratio", "slip_angle", "motion", "tyre_use", "line", "overspeed", "effort", "fall", "failure", "contact",
        "avoidable",
    )},
    **{name: lambda change: -(change**2) for name in ("steering_change", "throttle_change")},
}  # fmt: skip
"""Terms of the reward by name, as functions of a signal of the decision; rates are integrated over its periods.

- ``progress``: distance along the followed line, m; negative where the machine heads the wrong way
- ``gain``: time gained on the planned lap, s
- ``off_track``: speed times time with a contact point outside, m
- ``wall``: kinetic energy per mass in each control period with a wall touched, m^2/s^2 (Fuchs et al. 2021)
- ``steer_change``, ``lean_change``, ``rate_change``: of the angles (rad) and of the angular velocity (rad/s)
- ``steer_history``, ``lean_history``: `history_penalty` times time, in steps of the source, 0.1 s
- ``max_lean``: lean beyond the largest one, times time, rad s
- ``slip_ratio``, ``slip_angle``: of the tyres times time, s and rad s
- ``motion``: vertical and sideways speed of the machine, times time, m
- ``tyre_use``: use of the tyres beyond their linear saturation, times time, s
- ``line``: distance to the line times time, m s
- ``overspeed``: speed beyond the one asked, times time, m
- ``steering_change``, ``throttle_change``: of the columns of the action
- ``effort``: sum of the squares of the action
- ``fall``: 1 where the ride is over
- ``failure``: 1 where the episode fails for any reason
- ``place``: places gained in a race, counted evenly while another is passed, see `places`
- ``contact``, ``avoidable``: incidents with others, and those that the stewards punish

All but progress, gain and place are at most 0."""

_SIGNALS: Final = np.dtype([(name, np.float64) for name in REWARD_TERMS])
"""The signals of a decision of a machine."""

PLACE_DISTANCE: Final = 20.0
"""Distance ahead or behind over which a place counts as gained for the most part, m."""


def places(ahead: FloatArray) -> FloatArray:
    """Return how many others are behind; who is near counts as a part, so that closing up is worth something.

    Args:
        ahead: distance to each other along the circuit, m, positive where it is behind, NaN for none; shape
            (n, others).
    """
    return np.nansum(0.5 * (1.0 + np.tanh(ahead / PLACE_DISTANCE)), axis=1)


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


@dataclass(frozen=True, kw_only=True)
class RaceTask(Task):
    """Settings of the task; a ride's error is its time over that of the planned lap, as a part of it.

    Attributes:
        task: ``race``.
        observation: name in `bike_policy.contract.observation.RACE_LAYOUTS`.
        weights: terms of the reward by name, with their weights; empty for RACE_WEIGHTS.
        repeat: control periods that a decision is held.
        max_steps: decisions of an episode.
        largest_lean: of the term ``max_lean``, rad; machines can lean farther.
        lean_scale: part of the virtual rider's largest lean that action 1 asks for.
        guided: whether actions are targets of a guide.
        offset: farthest from the followed line with a guide, m.
        offset_rate: largest rate at which that target moves, m/s; 0 for no limit.
        pace: largest change of the planned speed with a guide, as a part of it.
        any_tyre: whether one contact point outside the limits is off the track, as published; else both.
        masked: whether progress counts on the track only (Wurman et al. 2022).
        off_track_time: penalty timer, s: time with both contact points outside that ends an episode.
        wrong_way_time: the same for heading the wrong way, s.
        stalled_time: the same for hardly moving, s.
        validation_duration: of a validation ride, s.
        disturbances: names or files of what is ridden in place of the machine that is known; rows take them in turn.
    """

    error_name = "excess"
    largest_error = 1.0
    limits: ClassVar = {
        **dict.fromkeys(("repeat", "max_steps"), AT_LEAST_1),
        **dict.fromkeys(("largest_lean", "lean_scale", "offset", "pace", "validation_duration"), POSITIVE),
        **dict.fromkeys(("offset_rate", "off_track_time", "wrong_way_time", "stalled_time"), AT_LEAST_0),
    }

    task: str = "race"
    observation: str = "compact"
    weights: Mapping[str, float] = field(default_factory=dict)
    repeat: int = 3
    max_steps: int = MAX_STEPS
    largest_lean: float = math.radians(54.0)
    lean_scale: float = 0.95
    guided: bool = False
    offset: float = 0.6
    offset_rate: float = 0.0
    pace: float = 0.05
    any_tyre: bool = True
    masked: bool = True
    off_track_time: float = 1.0
    wrong_way_time: float = 1.0
    stalled_time: float = 2.0
    validation_duration: float = 120.0
    disturbances: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        check_choice("task", self.task, ("race",))
        check_choice("observation", self.observation, RACE_LAYOUTS)
        self.set_weights(RACE_WEIGHTS, REWARD_TERMS)

    @property
    def layout(self) -> ObservationLayout:
        """Layout of the observation."""
        return replace(RACE_LAYOUTS[self.observation], repeat=self.repeat)

    def check_vehicle(self, vehicle: Vehicle) -> None:
        """Refuse bicycles: they have no engine and no tyres to race with."""
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"task {self.task!r} is for superbikes on circuits, and {vehicle.name!r} is none")

    @property
    def preview(self) -> Preview:
        """The stations of the course points, which superbikes always show."""
        return COURSE_POINTS

    @property
    def action(self) -> ActionLayout:
        """Lean request, and throttle or brake; or line and pace of a guide."""
        if self.guided:
            offset = ActionColumn(LINE_OFFSET, self.offset, rate=self.offset_rate)
            return ActionLayout((offset, ActionColumn(PACE, self.pace)))
        return ActionLayout((ActionColumn(LEAN_REQUEST, self.lean_scale), ActionColumn(DRIVE)))

    def make_state(self, count: int, vehicle: Vehicle, plan: Planner | None = None) -> RaceState:
        """Return the state of the task for a number of machines, whose guide rides verified plans or others."""
        return RaceState(self, count, vehicle, plan)

    def strict(self) -> RaceTask:
        """Return the task as validations ride it: the first moment with both contact points outside fails."""
        return replace(self, off_track_time=0.0)

    def validation_error(self, errors: FloatArray, succeeded: bool) -> float:
        """Return how much longer a ride took than planned for its distance, as a part of it.

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


class RaceContext(NamedTuple):
    """Context of an episode (V), as `ResetRequest.context` carries it.

    Attributes:
        d_median: distance from the median of the followed line, as a part of that of the ideal line.
        d_ideal: distance from the ideal line, the same.
        v_max: speed limit, m/s; OPEN for none.
        share: part of the planned speed that is asked.
        number: of the distribution that it was drawn from.
        rivals: part of their speed that the others of a race ride, where they all ride the same.
    """

    d_median: float = 1.0
    d_ideal: float = 0.0
    v_max: float = OPEN
    share: float = 1.0
    number: float = 0.0
    rivals: float = 1.0

    @classmethod
    def of(cls, request: ResetRequest) -> RaceContext | None:
        """Return that of a request, or None where it holds none."""
        return cls(*request.context) if len(request.context) == len(cls._fields) else None


class RaceState(TaskState):
    """State of a race for machines side by side.

    Attributes:
        interface: observations and commands.
    """

    def __init__(self, task: RaceTask, count: int, vehicle: Vehicle, plan: Planner | None = None) -> None:
        """Plan a task for a number of machines, whose guide rides verified plans or those of `plan`.

        Raises:
            ValueError: it is no superbike.
        """
        self._task, self._count, self._period = task, count, vehicle.control_period
        self.interface = RaceInterface(task.layout, task.action, vehicle, self._period, count, plan)
        self._signals = np.zeros(count, dtype=_SIGNALS)
        self._progress = np.zeros(count)
        self._rate = np.ones(count)
        self._angles = np.zeros((count, 2))
        self._omega = np.zeros((count, 2))
        self._punishes_swings = not task.weights.keys().isdisjoint(("steer_history", "lean_history"))
        lag = max(1, round(HISTORY_PERIOD / self._period))
        self._past = np.zeros((count, 2 * lag + 1, 2))
        self._walls = np.zeros(count)
        self._timers = np.zeros((count, 3))
        limits = float(task.off_track_time), float(task.wrong_way_time), float(task.stalled_time)
        self._kept = limits, float(task.largest_lean), bool(task.any_tyre), bool(task.masked)
        self._over = np.zeros(count, dtype=np.bool_)
        self._expired = np.zeros(count, dtype=np.bool_)

    def begin(
        self, row: int, rows: VehicleRows, request: ResetRequest, course: Course, shown: VehicleRows | None = None
    ) -> None:
        """Begin the ride of one machine."""
        context = RaceContext.of(request)
        share, cap = (None, OPEN) if context is None else (context.share, context.v_max)
        self.interface.begin(row, rows if shown is None else shown, course, share, cap)
        self._progress[row] = rows.look[row, lk.PROGRESS]
        self._rate[row] = 1.0
        self._angles[row], self._omega[row] = rows.state[row, [STEER, ROLL]], _omega(rows)[row]
        self._past[row], self._timers[row] = self._angles[row], 0.0
        self._walls[row] = rows.circuit[row, lk.WALL_ENERGY]
        self._over[row] = self._expired[row] = False

    def observe(self, rows: VehicleRows) -> NDArray[np.float32]:
        """Return the observations."""
        return self.interface.observe(rows)

    def act(self, rows: VehicleRows, actions: NDArray[np.floating]) -> None:
        """Begin a decision."""
        self.interface.act(rows, actions)
        self._signals = signals = np.zeros(self._count, dtype=_SIGNALS)
        now, before = self.interface.memory.actions[:, 0], self.interface.memory.actions[:, 1]
        change = np.abs(now - before)
        signals["steering_change"], signals["throttle_change"] = change[:, 0], change[:, 1]
        signals["effort"] = np.sum(now**2, axis=1)

    def commands(self, rows: VehicleRows) -> FloatArray:
        """Return the commands of a control period."""
        return self.interface.commands(rows)

    def advance(self, rows: VehicleRows) -> None:
        """Add a control period."""
        progress, references = rows.look[:, lk.PROGRESS], self.interface.references
        _, asked = references.at(progress)
        if self._punishes_swings:
            self._count_swings(rows, ~self._over * self._period / PUBLISHED_PERIOD)
        seen = rows.look, rows.state, rows.signals, rows.circuit, rows.fallen, asked, references.share
        memory = self._progress, self._rate, self._walls, self._timers, self._over, self._expired
        _add_period(*seen, *memory, self._signals, self._period, *self._kept)

    def _count_swings(self, rows: VehicleRows, part: NDArray[np.floating]) -> None:
        """Add a control period to both histories: `part` of a step of their source, shape (n,)."""
        self._past = np.concatenate((rows.state[:, None, [STEER, ROLL]], self._past[:, :-1]), axis=1)
        lag = self._past.shape[1] // 2
        changes = self._past[:, :-1:lag] - self._past[:, lag::lag]
        self._signals["steer_history"] += part * history_penalty(changes[:, :, 0])
        self._signals["lean_history"] += part * history_penalty(changes[:, :, 1] / LEAN_FACTOR)

    def note(self, **signals: FloatArray) -> None:
        """Add signals that whoever runs the race knows, by the names of their terms, shape (n,) each."""
        for name, values in signals.items():
            self._signals[name] += values

    def evaluate(self, rows: VehicleRows) -> StepResult:
        """Return the outcome of the decision."""
        signals = self._signals
        angles, omega = rows.state[:, [STEER, ROLL]], _omega(rows)
        change = angles - self._angles
        signals["steer_change"], signals["lean_change"] = np.abs(change[:, 0]), np.abs(change[:, 1])
        signals["rate_change"] = np.sqrt(np.sum((omega - self._omega) ** 2, axis=1))
        self._angles, self._omega = angles, omega
        failed = rows.fallen | self._expired
        signals["failure"] = failed
        terms = {name: weight * REWARD_TERMS[name](signals[name]) for name, weight in self._task.weights.items()}
        return StepResult(terms, failed)

    def error(self, rows: VehicleRows) -> FloatArray:
        """Return what is missing of the planned speed in the last control period, as a part of it."""
        return 1.0 - self._rate

    def state_dict(self) -> dict[str, Any]:
        """Return the memory."""
        own = {name: getattr(self, f"_{name}").copy() for name in _MEMORY}
        return {"interface": self.interface.state_dict(), **own}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Continue from a stored memory."""
        self.interface.restore(stored["interface"])
        for name in _MEMORY:
            getattr(self, f"_{name}")[...] = stored[name]


_MEMORY: Final = ("progress", "rate", "angles", "omega", "past", "walls", "timers", "over", "expired")


@njit(cache=True)
def off_track(circuit: FloatArray) -> tuple[bool, bool]:
    """Return whether one contact point at least, and whether both are outside the limits of a row's circuit."""
    rear_off, front_off = circuit[:2].min() < 0.0, circuit[2 : lk.OUTSIDE].min() < 0.0
    return rear_off or front_off, rear_off and front_off


@njit(cache=True)
def _add_period(
    look: FloatArray, state: FloatArray, telemetry: FloatArray, circuit: FloatArray, fallen: NDArray[np.bool_],
    asked: FloatArray, share: FloatArray, progress: FloatArray, rate: FloatArray, walls: FloatArray,
    timers: FloatArray, over: NDArray[np.bool_], expired: NDArray[np.bool_], signals: Any, dt: float,
    limits: tuple[float, float, float], largest_lean: float, any_tyre: bool, masked: bool,
) -> None:  # fmt: skip
    """Add a control period to the signals and timers of all rows; arguments as `RaceState` names them."""
    for i in range(len(look)):
        # What is not running counts 0 times, so that a NaN stays one.
        running, out = 0.0 if over[i] else 1.0, signals[i]
        speed, error = look[i, lk.SPEED], abs(look[i, lk.LATERAL_ERROR])
        wrong = abs(look[i, lk.HEADING_ERROR]) > 0.5 * math.pi
        any_off, both_off = off_track(circuit[i])
        off = any_off if any_tyre else both_off
        distance = 0.0 if fallen[i] else look[i, lk.PROGRESS] - progress[i]
        progress[i] = look[i, lk.PROGRESS]
        rate[i] = distance / (dt * asked[i] / share[i])
        counted = -abs(distance) if wrong else distance
        gained = (-1.0 if wrong else rate[i] - 1.0) * dt
        if masked and both_off:
            counted, gained = np.minimum(counted, 0.0), np.minimum(gained, 0.0)
        rear_angle, front_angle = abs(telemetry[i, _REAR_SLIP_ANGLE]), abs(telemetry[i, _FRONT_SLIP_ANGLE])
        slip = np.minimum(abs(telemetry[i, _REAR_SLIP]), 1.0) + np.minimum(abs(telemetry[i, _FRONT_SLIP]), 1.0)
        angle = np.minimum(rear_angle, math.pi) + np.minimum(front_angle, math.pi)
        use = np.maximum(telemetry[i, _REAR_USE], telemetry[i, _FRONT_USE])
        sideways = speed * np.minimum(rear_angle, 1.0)
        out.progress += running * counted
        out.gain += running * gained
        out.off_track += running * off * speed * dt
        out.line += running * error * dt
        out.overspeed += running * np.maximum(0.0, speed - asked[i]) * dt
        out.max_lean += running * np.maximum(0.0, abs(state[i, ROLL]) - largest_lean) * dt
        out.slip_ratio += running * slip * dt
        out.slip_angle += running * angle * dt
        out.tyre_use += running * np.maximum(0.0, use - 1.0) * dt
        out.motion += running * (abs(telemetry[i, _VERTICAL_VELOCITY]) + sideways) * dt
        hit = fallen[i] and telemetry[i, _FALL] == 0.0
        touched = not over[i] and (hit or circuit[i, lk.WALL_ENERGY] > walls[i])
        walls[i] = circuit[i, lk.WALL_ENERGY]
        out.wall += touched * 0.5 * telemetry[i, _SPEED] ** 2
        out.fall += running * fallen[i]
        for timer, ticking in enumerate((both_off, wrong, speed < STALLED)):
            timers[i, timer] = timers[i, timer] + dt if ticking else 0.0
            expired[i] |= timers[i, timer] > limits[timer] + 1e-9
        over[i] |= fallen[i]


def history_penalty(changes: FloatArray) -> FloatArray:
    """Return the penalty for turning to and fro, 0 to 1 (Vasco et al. 2024).

    It counts where the last two changes have opposite signs and both exceed HISTORY_LEAST.

    Args:
        changes: over the last HISTORY_PERIOD and the one before, rad, shape (n, 2).
    """
    size = np.abs(changes)
    swings = (changes[:, 0] * changes[:, 1] < 0.0) & np.all(size > HISTORY_LEAST, axis=1)
    return swings / (1.0 + np.exp(-HISTORY_SLOPE * (np.sum(size, axis=1) - HISTORY_OFFSET)))


def _omega(rows: VehicleRows) -> FloatArray:
    return np.stack((rows.state[:, ROLL_RATE], rows.look[:, lk.YAW_RATE]), axis=1)
