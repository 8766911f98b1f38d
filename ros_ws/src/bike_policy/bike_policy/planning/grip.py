"""The grip of the road, inferred from what the tyres of a known machine do, and a rider whose plan follows it.

A tyre that slips more than its law says for the force that it gives stands on less grip; an extended Kalman filter
finds how much. At little slip the force hardly depends on the grip, so little is learned there; near the limit a tenth
of a second is enough. The grip may change with the distance ridden.

The rider changes between plans of the same line: the verified one of the known road, and slower ones for less grip.
Where the lap before had less grip, it is ridden more slowly from a little ahead on. A careful rider also expects less
grip where it has not been yet: what a patch takes at full lean, no answer gives back. It leans into the wind and keeps
grip in reserve for it. And it does not drive while the handlebars shake.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.contract.observation import PROGRESS, SPEED, VehicleRows
from bike_policy.planning.lap_plan import (
    P_CURVATURE,
    P_FASTER,
    LinePlan,
    Planner,
    RiderSettings,
    SteadyLeans,
    on_grip,
    plan_line,
)
from bike_policy.planning.line_law import SEEN, LineLaw, seen_of
from bike_policy.planning.plan_verification import verified_plan
from bike_policy.planning.reference import GRIPS, KEPT, LineTable
from bike_policy.planning.ride_observer import RideObserver
from bike_policy.planning.wind_observer import WindObserver
from bike_sim.course.course import Course
from bike_sim.physics.superbike import tyres
from bike_sim.planning.envelope import envelope
from bike_sim.schema import SIGNALS, STATE
from bike_sim.vehicles.superbike import Record, Superbike

FloatArray = NDArray[np.float64]

WANDERING: Final = 0.02**2
"""Variance by which the grip may change in 100 m."""
LEAST_FORCE: Final = 0.3
"""Force by weight below which nothing is inferred."""
FIRST_ERROR: Final = 0.1
"""Standard deviation of the grip at the beginning of a ride."""
LEAST_GRIP: Final = 0.5
MOST_GRIP: Final = 1.2
"""Bounds of the inferred grip."""
RESERVE: Final = 0.02
"""Grip that plans for less than the known one keep in reserve: they have not been ridden to verify them."""
HELD: Final = 0.95
"""Part of the lateral acceleration that the grip allows which a rider leans for where there is less than known."""
SHAKING: Final = 0.4
"""Mean magnitude of the steer rate at which handlebars shake, rad/s."""
SHAKING_MEMORY: Final = 0.2
"""Time constant of that mean, s."""
SHAKING_SPEED: Final = 20.0
"""Speed below which quick steering is no shaking: slow machines are balanced by it, m/s."""
_STEP: Final = 1e-3

LEVEL: Final = 0.01
"""Difference of two plans in grip."""
BIN: Final = 25.0
"""Length of the parts of a lap of which the grip is remembered, m."""
AHEAD: Final = 4
"""Parts ahead whose grip in the lap before counts."""
CAREFUL_AHEAD: Final = 8
"""The same of careful riders, who come from a road of more grip: at full lean 100 m are too short to brake."""

_STORED: Final = ("grip", "variance", "expected", "_part", "_lap", "_state")
_NAMES: Final = (
    "rear_force_long", "rear_force_lat", "rear_slip", "rear_slip_angle", "rear_camber", "rear_load",
    "front_force_long", "front_force_lat", "front_slip", "front_slip_angle", "front_camber", "front_load",
)  # fmt: skip
_COLUMNS: Final = np.array([SIGNALS.index(name) for name in _NAMES])


class GripMemory:
    """Grip that machines side by side may expect: the inferred one, and less where the lap before had less.

    Attributes:
        grip: inferred factor on the friction of the known tyres, shape (n,).
        variance: of its error, shape (n,).
        expected: grip here and shortly ahead, shape (n,).
        wind: of careful riders, which keep grip in reserve for it; None for others.
    """

    def __init__(self, vehicle: Superbike, period: float, count: int = 1, unseen: float = 0.0) -> None:
        """Prepare for a number of machines.

        Args:
            vehicle: the machine as its rider knows it.
            period: control period, s.
            count: number of machines.
            unseen: grip by which less is expected where no lap has been.
        """
        self._unseen, self._ahead = unseen, np.arange(1, (CAREFUL_AHEAD if unseen else AHEAD) + 1)
        self._tyres = vehicle.machine["rear_tyre"], vehicle.machine["front_tyre"]
        self._weight, self._period = vehicle.mass * vehicle.g, period
        self.grip, self.variance, self.expected = np.ones(count), np.full(count, FIRST_ERROR**2), np.ones(count)
        self._part, self._parts = np.full(count, -1), np.ones(count, dtype=np.int64)
        self._lap: FloatArray = np.full((count, 1), np.inf)
        self._state: FloatArray = np.full((count, len(STATE)), np.nan)
        self.wind = WindObserver(vehicle, period, count) if unseen > 0.0 else None

    @property
    def held(self) -> FloatArray:
        """Grip that holds a lean, shape (n,): of careful riders no more than is expected."""
        return self.grip if self.wind is None else np.minimum(self.grip, self.expected)

    @property
    def planned(self) -> FloatArray:
        """Grip that is planned for, shape (n,): the expected one less what is kept for the wind."""
        return self.expected if self.wind is None else self.expected - self.wind.lost

    @property
    def push(self) -> FloatArray | None:
        """Lateral acceleration by the wind, m/s^2 to the left, shape (n,); None where nobody infers it."""
        return None if self.wind is None else self.wind.push

    def begin(self, row: int, line: Course, ridden: FloatArray | None = None) -> None:
        """Begin a ride of a closed line.

        Args:
            row: of the machine.
            line: closed line.
            ridden: grip that a lap before found, at even distances along the line; None where nothing is known.
        """
        parts = max(1, round(line.length / BIN))
        if parts > self._lap.shape[1]:
            more = np.full((len(self._lap), parts - self._lap.shape[1]), np.inf)
            self._lap = np.concatenate((self._lap, more), axis=1)
        grip, unseen = 1.0, self._unseen
        self._lap[row], self._part[row], self._parts[row], self._state[row] = np.inf, -1, parts, np.nan
        if ridden is not None:
            grip, unseen = float(np.clip(np.median(ridden), LEAST_GRIP, MOST_GRIP)), 0.0
            firsts = np.arange(parts) * len(ridden) // parts
            self._lap[row, :parts] = np.minimum.reduceat(ridden, firsts)
        self.grip[row], self.variance[row], self.expected[row] = grip, FIRST_ERROR**2, grip - unseen
        if self.wind is not None:
            self.wind.begin(row, line)

    def update(self, measured: VehicleRows, observer: RideObserver) -> VehicleRows:
        """Take in a control period; the same rows again change nothing.

        Args:
            measured: all machines, as they are measured.
            observer: of what is measured.

        Returns:
            What the observer shows of them.
        """
        rows, errors = observer.observe(measured), observer.force_errors
        if self.wind is not None:
            self.wind.update(measured)
        seen = np.nan_to_num(rows.look[:, [PROGRESS, SPEED]])
        fresh = (rows.state != self._state).any(axis=1)
        self._state = rows.state.copy()
        wander = np.where(fresh, WANDERING * np.abs(seen[:, 1]) * self._period / 100.0, 0.0)
        np.minimum(self.variance + wander, FIRST_ERROR**2, out=self.variance)
        signals = np.nan_to_num(rows.signals)[:, _COLUMNS]
        _update(signals, fresh, self.grip, self.variance, errors, self._weight, *self._tyres)
        self.expected = self.ahead(seen[:, 0])
        return rows

    def ahead(self, progress: FloatArray) -> FloatArray:
        """Return the grip here and shortly ahead, shape (n,), and remember it for the next lap.

        Args:
            progress: along the lines, m, shape (n,).
        """
        grip, every = self.grip, np.arange(len(progress))
        part = np.asarray(progress / BIN).astype(np.int64) % self._parts
        entered = part != self._part
        self._lap[every, part] = np.where(entered, grip, np.minimum(grip, self._lap[every, part]))
        self._part = part
        ahead = (part[:, None] + self._ahead) % self._parts[:, None]
        found = self._lap[every[:, None], ahead]
        # Plans are made for no less than the last of GRIPS, and a lean for less than its plan asks runs wide.
        blind = np.maximum(np.minimum(grip, 1.0) - self._unseen, np.minimum(grip, GRIPS[-1])) if self._unseen else grip
        return np.minimum(grip, np.where(np.isfinite(found), found, blind[:, None]).min(axis=1))

    def state_dict(self) -> dict[str, FloatArray]:
        """Return all of it, as arrays."""
        wind = {} if self.wind is None else self.wind.state_dict()
        return {name: getattr(self, name).copy() for name in _STORED} | wind

    def restore(self, stored: Mapping[str, FloatArray]) -> None:
        """Continue from what :meth:`state_dict` returned, after each row has begun again."""
        for name in _STORED:
            setattr(self, name, stored[name].copy())
        if self.wind is not None:
            self.wind.restore(stored)


class ShakeReflex:
    """No drive while the handlebars shake: drive unloads the front wheel, and a light one wobbles to a fall on bumps.

    It stands behind a careful rider's commands, planned or learned; behind those of others it does nothing.
    """

    def __init__(self, careful: bool, period: float, count: int = 1) -> None:
        """Prepare for a number of machines of a careful rider or another, and their control period, s."""
        self._keeps, self._most = math.exp(-period / SHAKING_MEMORY), SHAKING if careful else math.inf
        self._mean, self._rate = np.zeros(count), np.full(count, np.nan)

    def begin(self, row: int) -> None:
        """Begin the ride of a machine."""
        self._mean[row], self._rate[row] = 0.0, np.nan

    def commands(self, rows: VehicleRows, commands: FloatArray) -> FloatArray:
        """Return steering and throttle in [-1, 1] without drive where handlebars shake, shape (n, 2).

        Args:
            rows: as the rider sees them; the same rows give the same again.
            commands: of the rider, shape (n, 2).
        """
        if math.isinf(self._most):
            return commands
        rate = np.nan_to_num(rows.state[:, STATE.index("steer_rate")])
        mean = self._keeps * self._mean + (1.0 - self._keeps) * np.abs(rate)
        self._mean, self._rate = np.where(rate != self._rate, mean, self._mean), rate
        shakes = (self._mean > self._most) & (np.nan_to_num(rows.look[:, SPEED]) > SHAKING_SPEED)
        throttle = np.where(shakes, np.minimum(commands[:, 1], 0.0), commands[:, 1])
        return np.stack((commands[:, 0], throttle), axis=1)

    def state_dict(self) -> dict[str, FloatArray]:
        """Return all of it, as arrays."""
        return {"shaking": self._mean.copy(), "steer_rate": self._rate.copy()}

    def restore(self, stored: Mapping[str, FloatArray]) -> None:
        """Continue from what :meth:`state_dict` returned, after each row has begun again."""
        self._mean, self._rate = stored["shaking"].copy(), stored["steer_rate"].copy()


class GripPlans:
    """Plans of a closed line for roads of different grip."""

    def __init__(self, vehicle: Superbike, line: Course, settings: RiderSettings, known: LinePlan) -> None:
        """Take the plan for the known road.

        Args:
            vehicle: the machine.
            line: closed line to follow.
            settings: how to ride.
            known: verified plan for the known road.
        """
        self._vehicle, self._line, self._settings = vehicle, line, settings
        self._plans = {1.0: known}
        self._share: FloatArray | None = None

    @cached_property
    def reference(self) -> LineTable:
        """Reference of a rider that follows the inferred grip: curvature, and the speed on each of GRIPS."""
        plans = [self._solved(grip) for grip in GRIPS]
        columns = (plans[0].table[:, P_CURVATURE], *(plan.profile.speed for plan in plans))
        return LineTable(plans[0].spacing, np.stack(columns, axis=1))

    def solve(self) -> None:
        """Plan for all grips at once, so that a rider in real time need not wait for it, a matter of seconds."""
        for grip in GRIPS:
            self._solved(grip)

    def on(self, grip: float) -> LinePlan:
        """Return the plan for a grip that is a multiple of LEVEL, or the nearest to it that there is."""
        grip = min(max(round(grip, 2), GRIPS[-1]), 1.0)
        if grip not in self._plans:
            above = min(known for known in GRIPS if known > grip)
            below = max(known for known in GRIPS if known <= grip)
            high, low = self._solved(above), self._solved(below)
            if grip != below:
                part = (grip - below) / (above - below)
                self._plans[grip] = low._replace(table=low.table + part * (high.table - low.table))
        return self._plans[grip]

    def _verified(self) -> FloatArray:
        """Return the speed of the verified plan by that of the one before verification."""
        if self._share is None:
            first = plan_line(self._vehicle, self._line, self._settings)
            self._share = self._plans[1.0].profile.speed / first.profile.speed
        return self._share

    def _solved(self, grip: float) -> LinePlan:
        """Return the plan for tyres of so much less friction, nowhere faster than on the known road."""
        if grip not in self._plans:
            known = self._plans[1.0]
            less = on_grip(self._vehicle, grip)
            cap, share = known.profile.speed, self._verified()
            if share.min() < 1.0:
                # where a verification made the known plan slower, those for less grip are slower in proportion
                cap = np.minimum(cap, share * plan_line(less, self._line, self._settings).profile.speed)
            plan = plan_line(less, self._line, self._settings, cap[:-1])
            self._plans[grip] = plan.with_room_above(known.table[:-1, P_FASTER])
        return self._plans[grip]


def plans_of(
    vehicle: Superbike, period: float, settings: RiderSettings, plan: Planner | None = None
) -> Callable[[Course], GripPlans]:
    """Return plans for roads of different grip by line, each made once.

    Args:
        vehicle: the machine.
        period: control period, s.
        settings: how to ride.
        plan: plans a lap of a line on the known road; None for a verified plan.
    """
    known = replace(settings, unseen=0.0)  # of it the memory makes less grip, and plans are those of any rider
    plan = plan or (lambda line: verified_plan(vehicle, line, known, period))
    return lru_cache(maxsize=KEPT)(lambda line: GripPlans(vehicle, line, known, plan(line)))


class HeldLeans:
    """Largest leans that a rider may request: those that the grip holds."""

    def __init__(self, vehicle: Superbike, settings: RiderSettings, leans: SteadyLeans) -> None:
        """Take a machine as its rider knows it.

        Args:
            vehicle: the machine.
            settings: with the largest lean on the known road.
            leans: of its steady turns.
        """
        limits = envelope(vehicle)
        self._largest, self._leans = settings.largest_lean, leans
        self._speeds, self._lateral = limits.speeds.copy(), limits.lateral_max

    def at(self, speed: FloatArray, grip: FloatArray) -> FloatArray:
        """Return the largest lean of each machine, rad, shape (n,).

        Args:
            speed: of the machines, m/s, shape (n,).
            grip: by that of the known road, shape (n,).
        """
        leans, table = np.full(len(speed), self._largest), self._leans
        _held_leans(speed, grip, leans, self._speeds, self._lateral, table.speeds, table.table, table.leans)
        return leans


class AdaptiveLaw:
    """The classical law on plans that follow the inferred grip; implements `plan_verification.BatchRider`.

    Attributes:
        law: that it rides by.
        memory: of the grip.
        observer: of what is measured.
    """

    def __init__(
        self, vehicle: Superbike, period: float, settings: RiderSettings, count: int = 1, plan: Planner | None = None
    ) -> None:
        """Prepare for a number of rides.

        Args:
            vehicle: the machine as its rider knows it.
            period: control period, s.
            settings: how to ride.
            count: number of rides.
            plan: plans a lap of a line on the known road; None for a verified plan.
        """
        self.memory = GripMemory(vehicle, period, count, settings.unseen)
        self.law = LineLaw(vehicle, period, settings, count)
        self.observer = RideObserver(vehicle, period, count)
        self._leans = HeldLeans(vehicle, settings, self.law.leans)
        self._planned = plans_of(vehicle, period, settings, plan)
        self._plans: dict[int, GripPlans] = {}
        self._level = np.ones(count)
        self._reflex = ShakeReflex(settings.unseen > 0.0, period, count)

    def plans(self, line: Course) -> GripPlans:
        """Return the plans of a line, made once for the same object.

        Raises:
            ValueError: the line is open.
        """
        return self._planned(line)

    def begin(self, row: int, rows: VehicleRows | None, line: Course) -> None:
        """Begin a ride of a line, knowing nothing of its grip; see `BatchRider`.

        Raises:
            ValueError: the line is open.
        """
        plans = self._plans[row] = self._planned(line)
        self.law.begin(row, plans.on(1.0))
        self.memory.begin(row, line)
        self.observer.begin(row, line)
        self._level[row] = 1.0
        self._reflex.begin(row)

    def commands(self, rows: VehicleRows, step: int = 0, targets: FloatArray | None = None) -> FloatArray:
        """Return steering and throttle in [-1, 1], shape (n, 2); the same ones again for the same rows.

        Args:
            rows: of all machines.
            step: control periods since they began.
            targets: see `LineLaw.commands`.
        """
        rows = self.memory.update(rows, self.observer)
        # The delay that the observer finds is left out: looking so much farther ahead loses rides that are not lost so.
        commands = self.follow(
            rows, self.memory.held, self.memory.planned, targets, self.observer.rates, pushes=self.memory.push
        )
        self.observer.answered(commands)
        return commands

    def follow(
        self,
        rows: VehicleRows,
        grip: FloatArray,
        expected: FloatArray,
        targets: FloatArray | None = None,
        rates: FloatArray | None = None,
        delays: FloatArray | None = None,
        pushes: FloatArray | None = None,
    ) -> FloatArray:
        """Return steering and throttle in [-1, 1] on a grip that is known, shape (n, 2).

        Args:
            rows: of all machines.
            grip: of the road under each, shape (n,).
            expected: the same here and shortly ahead, shape (n,).
            targets: see `LineLaw.commands`.
            rates: see there.
            delays: see there.
            pushes: see there.
        """
        seen = np.nan_to_num(seen_of(rows.state, rows.look))
        expected = np.where(expected < 1.0 - 0.5 * LEVEL, expected - RESERVE, expected)
        level = np.clip(np.round(expected / LEVEL) * LEVEL, GRIPS[-1], 1.0)
        for row in np.flatnonzero(level != self._level).tolist():
            self.law.change(row, self._plans[row].on(float(level[row])), seen[row])
        self._level = level
        leans = self._leans.at(np.nan_to_num(rows.look[:, SPEED]), grip)
        return self._reflex.commands(rows, self.law.commands(seen, targets, leans, rates, delays, pushes))

    def state_dict(self) -> dict[str, Any]:
        """Return what is remembered of the rides, as arrays."""
        law = {"law": self.law.memory.copy(), "level": self._level.copy(), "observer": self.observer.state_dict()}
        return law | self._reflex.state_dict() | self.memory.state_dict()

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Continue from what :meth:`state_dict` returned, after each row has begun again."""
        self.memory.restore(stored)
        self.observer.restore(stored["observer"])
        self._level = stored["level"].copy()
        self._reflex.restore(stored)
        for row in np.flatnonzero(self._level != 1.0).tolist():
            self.law.change(row, self._plans[row].on(float(self._level[row])), stored["law"][row, :SEEN])
        self.law.memory[...] = stored["law"]


@njit(cache=True)
def _held_leans(
    speed: FloatArray, grip: FloatArray, leans: FloatArray, speeds: FloatArray, lateral: FloatArray, rows: FloatArray,
    table: FloatArray, columns: FloatArray,
) -> None:  # fmt: skip
    """Lower largest leans to those with which a machine turns as hard as less grip holds.

    Args:
        speed: of the machines, m/s.
        grip: inferred.
        leans: largest ones, rad; changed in place.
        speeds: of `lateral`, m/s.
        lateral: largest lateral acceleration of the known road, m/s^2.
        rows: speeds of the steady turns, m/s, evenly spaced.
        table: their lateral accelerations, m/s^2.
        columns: their leans, rad.
    """
    for row in np.flatnonzero(grip < 1.0 - 0.5 * LEVEL):
        most = HELD * grip[row] * np.interp(speed[row], speeds, lateral)
        u = (min(max(speed[row], rows[0]), rows[-1]) - rows[0]) / (rows[1] - rows[0])
        i = min(int(u), len(rows) - 2)
        turning = table[i] + (u - i) * (table[i + 1] - table[i])
        leans[row] = min(leans[row], np.interp(most, turning, columns))


@njit(cache=True)
def _update(
    signals: FloatArray, fresh: NDArray[np.bool_], grip: FloatArray, variance: FloatArray, errors: FloatArray,
    weight: float, rear: Record, front: Record,
) -> None:  # fmt: skip
    for row in np.flatnonzero(fresh):
        rear_signals, front_signals = signals[row, :6], signals[row, 6:]
        along, across = rear_signals[0] + front_signals[0], rear_signals[1] + front_signals[1]
        force = math.hypot(along, across)
        if not force > LEAST_FORCE * weight:
            continue
        cos, sin = along / force, across / force
        here = _force(grip[row], rear_signals, cos, sin, rear) + _force(grip[row], front_signals, cos, sin, front)
        more = _force(grip[row] + _STEP, rear_signals, cos, sin, rear)
        more += _force(grip[row] + _STEP, front_signals, cos, sin, front)
        slope = (more - here) / (_STEP * weight)
        gain = variance[row] * slope / (slope * slope * variance[row] + errors[row] * errors[row])
        inferred = grip[row] + gain * (force - here) / weight
        if math.isfinite(inferred):
            grip[row] = min(max(inferred, LEAST_GRIP), MOST_GRIP)
            variance[row] *= 1.0 - gain * slope


@njit(cache=True)
def _force(grip: float, signals: FloatArray, cos: float, sin: float, tyre: Record) -> float:
    """Return the force of a tyre in a direction, N, on a grip."""
    along, across, _, _ = tyres.forces(signals[2], math.tan(signals[3]), signals[4], signals[5], grip, tyre)
    return along * cos + across * sin
