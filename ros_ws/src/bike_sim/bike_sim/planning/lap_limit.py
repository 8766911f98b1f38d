"""The theoretical lap: the fastest that a machine's limits allow on a line.

Quasi-steady state: at every point of the line the machine is in the equilibrium of its speed, lateral and longitudinal
acceleration. From the speeds that cornering allows, one pass forward applies what drives, one pass backward what
brakes (the classical lap-time simulation, as in Brayshaw & Harrison 2005, A quasi steady state approach to race car
lap simulation, Proc. IMechE D 219). The limits are those of the mass, which does not run on the line of the contacts
(:class:`MassPath`); so line and profile are computed in turn until they fit.

No rider rides it: it is the bar that riders are measured by, and meant as a lower bound of every lap on this line.
What may still be faster than it for a moment, because it is not quasi-steady, is repaid in the next.

The path of the mass. The machine is a pendulum upside down on the line of its contacts. To stay on a line whose lateral
acceleration at the contacts is ``a_c`` it needs a lean that solves

    A(lean) - L / cos(lean) d2(lean)/dt2 = a_c

with the lateral acceleration A of the steady turn at this lean and the length L of the pendulum. The bounded solution
looks ahead: the machine must begin to roll before the curve begins, by some sqrt(L / g) = 0.27 s, and what the line
asks within shorter times hardly moves the mass. The mass is inside of the contacts by some 0.5 m in a curve; its path
is that much shorter and tighter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.planning.envelope import Envelope, Limits, lateral_by_lean, most_brake, most_drive, most_lateral
from bike_sim.schema import GRAVITY

FloatArray = NDArray[np.float64]

STEP = 1.0
"""Distance of the profile's points, m."""

ROUNDS = 16
CONVERGED = 1e-5
"""The rounds end when the lap time changes by less than this part of it."""
LEAN_SPAN = 0.4
"""Time over which a lean rate counts against its limit, s: for less the contacts leave the line by centimetres."""
_EASED = 0.4
_CORNER_ROUNDS = 50
_CORNER_TOLERANCE = 1e-8
_STANDSTILL = 1e-6
_LARGEST_LEAN = math.radians(80.0)
_LEANS = 81
_NEWTON = 4
_LEAST_LOAD = 0.1
_SMALL = 0.01
_RENEWED = 0.6


class MassPath(NamedTuple):
    """Motion of the mass while the contacts follow a line; values at its points, none repeated.

    Attributes:
        bend: lateral acceleration of the mass by its squared speed, 1/m, positive to the left.
        distance: of the mass from this point to the next, m.
        stretch: speed of the mass by that of the contacts.
        slope: rise of the mass (its energy of rolling included) by its distance, the road's slope included.
        lean: rad, positive to the left.
        roll_rate: rad/s.
    """

    bend: FloatArray
    distance: FloatArray
    stretch: FloatArray
    slope: FloatArray
    lean: FloatArray
    roll_rate: FloatArray


def mass_path(
    envelope: Envelope,
    bend: FloatArray,
    speed: FloatArray,
    step: float,
    slope: FloatArray,
    dip: FloatArray,
    before: MassPath,
) -> MassPath:
    """Return the path of the mass of a machine, which is a pendulum on the line of its contacts.

    Args:
        envelope: the machine's.
        bend: curvature of the line of the contacts, 1/m.
        speed: of the contacts, m/s.
        step: distance of the points, m.
        slope: of the road.
        dip: vertical curvature of the road, 1/m.
        before: the path of the round before, from which lean and roll rate are renewed in part.
    """
    speeds = np.linspace(envelope.speeds[0], envelope.speeds[-1], 24)
    table = _steady_turns(envelope.limits, speeds, np.linspace(0.0, _LARGEST_LEAN, _LEANS))
    spent = 2.0 * step / (speed + np.roll(speed, -1))
    # What presses on the road presses on the pendulum.
    load = np.maximum(1.0 + dip * speed**2 / GRAVITY, _LEAST_LOAD)
    lean, lateral = _sway(bend * speed**2 / load, speed, spent, before.lean, envelope.sway, speeds, table)
    rate = (np.roll(lean, -1) - np.roll(lean, 1)) / (spent + np.roll(spent, 1))
    if before.lean.any():
        rate = before.roll_rate + _RENEWED * (rate - before.roll_rate)
    places = np.linspace(0.0, 0.5 * math.pi, len(envelope.inside))
    inside = np.copysign(np.interp(np.abs(lean), places, envelope.inside), lean)
    height = np.interp(np.abs(lean), places, envelope.height)
    sideways = (np.roll(inside, -1) - np.roll(inside, 1)) / (2.0 * step)
    stretch = np.hypot(1.0 - bend * inside, sideways)
    distance = 0.5 * step * (stretch + np.roll(stretch, -1))
    # Energy of rolling by weight: 1/2 L h rate^2 / g.
    risen = height + 0.5 * envelope.sway * envelope.height[0] * rate**2 / GRAVITY
    rise = 0.5 * (np.roll(risen, -1) - np.roll(risen, 1)) / distance
    return MassPath(load * lateral / (speed * stretch) ** 2, distance, stretch, slope + rise, lean, rate)


@njit(cache=True)
def _steady_turns(limits: Limits, speeds: np.ndarray, leans: np.ndarray) -> np.ndarray:
    table = np.empty((len(speeds), len(leans)))
    for i in range(len(speeds)):
        for k in range(len(leans)):
            table[i, k] = lateral_by_lean(limits, speeds[i], leans[k])
    return table


@njit(cache=True)
def _steady(table: np.ndarray, speeds: np.ndarray, speed: float, lean: float) -> float:
    """Return the lateral acceleration of the steady turn at a lean (rad, >= 0), m/s^2."""
    at = min(max((speed - speeds[0]) / (speeds[1] - speeds[0]), 0.0), len(speeds) - 1.001)
    along = min(lean / _LARGEST_LEAN, 0.9999) * (_LEANS - 1)
    i, k = int(at), int(along)
    low = table[i, k] + (along - k) * (table[i, k + 1] - table[i, k])
    high = table[i + 1, k] + (along - k) * (table[i + 1, k + 1] - table[i + 1, k])
    return low + (at - i) * (high - low)


@njit(cache=True)
def _sway(
    turn: np.ndarray, speed: np.ndarray, spent: np.ndarray, start: np.ndarray, length: float, speeds: np.ndarray,
    table: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return leans (rad) and lateral accelerations of the mass (m/s^2) over a lap, by Newton's iteration.

    Args:
        turn: lateral acceleration of the contacts, m/s^2.
        speed: m/s.
        spent: time from each point to the next, s.
        start: leans to begin with, rad.
        length: of the pendulum, m.
        speeds: of the table, m/s.
        table: steady lateral acceleration over speed and lean.
    """
    n = len(turn)
    lean = start.copy()
    below, middle, above, right = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for _ in range(_NEWTON):
        for i in range(n):
            size = abs(lean[i])
            before, after = spent[i - 1], spent[i]
            reach = length / math.cos(size)
            here = _steady(table, speeds, speed[i], size)
            slope = (_steady(table, speeds, speed[i], size + _SMALL) - here) / _SMALL
            below[i] = -2.0 * reach / (before * (before + after))
            above[i] = -2.0 * reach / (after * (before + after))
            middle[i] = slope - below[i] - above[i]
            right[i] = turn[i] - math.copysign(1.0, lean[i]) * (here - slope * size)
        lean = _solve_around(below, middle, above, right)
        for i in range(n):
            lean[i] = min(max(lean[i], -1.3), 1.3)
    lateral = np.empty(n)
    for i in range(n):
        lateral[i] = math.copysign(_steady(table, speeds, speed[i], abs(lean[i])), lean[i])
    return lean, lateral


@njit(cache=True)
def _solve_around(below: np.ndarray, middle: np.ndarray, above: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution of a tridiagonal system that is closed around (Sherman and Morrison's formula)."""
    n = len(middle)
    gamma = -middle[0]
    diagonal = middle.copy()
    diagonal[0] -= gamma
    diagonal[-1] -= above[-1] * below[0] / gamma
    corner = np.zeros(n)
    corner[0], corner[-1] = gamma, above[-1]
    x, z = _solve_open(below, diagonal, above, right), _solve_open(below, diagonal, above, corner)
    share = (x[0] + below[0] * x[-1] / gamma) / (1.0 + z[0] + below[0] * z[-1] / gamma)
    return x - share * z


@njit(cache=True)
def _solve_open(below: np.ndarray, middle: np.ndarray, above: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution of a tridiagonal system (Thomas's algorithm)."""
    n = len(middle)
    ratio, x = np.empty(n), np.empty(n)
    ratio[0], x[0] = above[0] / middle[0], right[0] / middle[0]
    for i in range(1, n):
        pivot = middle[i] - below[i] * ratio[i - 1]
        ratio[i] = above[i] / pivot
        x[i] = (right[i] - below[i] * x[i - 1]) / pivot
    for i in range(n - 2, -1, -1):
        x[i] -= ratio[i] * x[i + 1]
    return x


@dataclass(frozen=True)
class LapLimit:
    """A theoretical lap. Arrays are over the points of the line, the last repeating the first.

    Attributes:
        machine: its name.
        line: name of the line.
        s: arc length of the line, m.
        time: since the start, s.
        speed: m/s.
        lateral: lateral acceleration of the line at this speed, m/s^2, positive to the left.
        longitudinal: m/s^2, positive forward.
        lean: that the machine needs to stay on the line, rad, positive to the left.
        roll_rate: rad/s, positive to the left.
        sector_times: s, as the line's sections divide it; empty without.
    """

    machine: str
    line: str
    s: FloatArray
    time: FloatArray
    speed: FloatArray
    lateral: FloatArray
    longitudinal: FloatArray
    lean: FloatArray
    roll_rate: FloatArray
    sector_times: tuple[float, ...]

    @property
    def lap_time(self) -> float:
        """Time of a flying lap, s."""
        return float(self.time[-1])

    def speed_at(self, s: FloatArray | float) -> FloatArray:
        """Return the speed at an arc length of any lap, m/s."""
        return np.asarray(np.interp(np.mod(s, self.s[-1]), self.s, self.speed))


def lap_limit(
    envelope: Envelope,
    line: Course,
    step: float = STEP,
    crest: FloatArray | None = None,
    cap: FloatArray | None = None,
    roll_freedom: float = 0.0,
) -> LapLimit:
    """Return the theoretical lap of a machine on a closed line.

    Args:
        envelope: the machine's limits.
        line: closed line of the contacts.
        step: distance of the profile's points, m.
        crest: vertical curvature of the road at the line's samples, 1/m, positive in a dip; None for the line's.
        cap: largest speed that somebody wants at each point of the profile but the last, m/s, or None.
        roll_freedom: time by which a roll may come sooner or later than the line asks for, s. The electronics then
            answer the smallest roll rate within it, before and after.

    Raises:
        ValueError: the line is open, the step is not positive, the crest or the cap does not fit, or the machine
            cannot move.
    """
    if not line.closed:
        raise ValueError(f"course {line.name!r} is open; a lap needs a closed line")
    crest = line.crest if crest is None else crest
    if not step > 0.0:
        raise ValueError(f"step of the profile must be positive, got {step!r} m")
    if len(crest) != len(line.s):
        raise ValueError(f"crest has {len(crest)} samples, the line {len(line.s)}")
    if float(envelope.drive(envelope.speeds[0])) <= 0.0:
        raise ValueError(f"machine {envelope.name!r} has no drive at {envelope.speeds[0]:.1f} m/s")
    count = max(16, round(line.length / step))
    s = np.linspace(0.0, line.length, count + 1)
    cap = np.full(count, np.inf) if cap is None else cap
    if np.shape(cap) != (count,):
        raise ValueError(f"cap has shape {np.shape(cap)}, the profile {count} points")
    road = tuple(np.interp(s[:-1], line.s, values) for values in (line.grade, crest, line.slope_across))
    bend = _mean_curvature(line, s)
    path, speed = _solve(envelope, bend, line.length / count, road, cap, roll_freedom)
    distance, moved = path.distance, speed * path.stretch
    closed = np.append(speed, speed[0])
    ahead = np.roll(moved, -1)
    time = np.concatenate(([0.0], np.cumsum(2.0 * distance / (moved + ahead))))
    longitudinal = (ahead**2 - moved**2) / (2.0 * distance)
    sectors = [begin for _, begin in line.sections] + [line.length]
    at = np.interp(sectors, s, time)

    def around(values: FloatArray) -> FloatArray:
        return np.append(values, values[0])

    return LapLimit(
        envelope.name,
        line.name,
        s,
        time,
        closed,
        closed**2 * around(bend),
        around(longitudinal),
        around(path.lean),
        around(path.roll_rate),
        tuple(float(t) for t in np.diff(at)) if line.sections else (),
    )


def _solve(
    envelope: Envelope,
    bend: FloatArray,
    step: float,
    road: tuple[FloatArray, ...],
    cap: FloatArray,
    roll_freedom: float,
) -> tuple[MassPath, FloatArray]:
    """Return the path of the mass and the speeds of the contact, m/s.

    Args:
        envelope: the machine's.
        bend: curvature of the line at the points, 1/m.
        step: distance of the points, m.
        road: slope along (rise per m), vertical curvature (1/m) and slope across (rise per m) at the points.
        cap: of the speed, m/s.
        roll_freedom: see :func:`lap_limit`, s.
    """
    limits, count = envelope.limits, len(bend)
    slope, dip, bank = road
    path = MassPath(bend, np.full(count, step), np.ones(count), slope, np.zeros(count), np.zeros(count))
    eased, before = np.full(count, np.inf), np.inf
    speed = np.ones(count)  # of the round before, in whose first nothing rolls
    for number in range(ROUNDS):
        most = np.minimum(cap, eased) * path.stretch
        corner = np.minimum(corner_speeds(path.bend, dip, bank, limits), most)
        rate = least_rate(path.roll_rate, speed, step, roll_freedom) if roll_freedom > 0.0 else path.roll_rate
        moved = solve_profile(corner, path.bend, path.distance, path.slope, dip, bank, rate, limits)
        speed = moved / path.stretch
        spent = profile_time(moved, path.distance)
        if envelope.sway == 0.0 or (abs(spent - before) < CONVERGED * spent and number > 2):
            break
        before = spent
        path = mass_path(envelope, bend, speed, step, slope, dip, path)
        allowed = np.interp(speed, envelope.speeds, envelope.lean_rate)
        asked = np.abs(mean_rate(path.lean, speed, step, LEAN_SPAN)) / allowed
        # Slower means both less lean and more time for it; where the limit binds already it may also give way.
        bound = (asked > 1.0) | (speed >= eased * (1.0 - 1e-9))
        eased = np.where(bound, speed * np.maximum(asked, 0.5) ** -_EASED, np.inf)
    return path, speed


def mean_rate(values: FloatArray, speed: FloatArray, step: float, span: float) -> FloatArray:
    """Return the rate of values around the lap, averaged over a time (s).

    Args:
        values: at the points of the lap.
        speed: there, m/s.
        step: distance of the points, m.
        span: s.
    """
    time = np.concatenate(([0.0], np.cumsum(2.0 * step / (speed + np.roll(speed, -1)))))
    lap = np.append(values, values[0])
    behind, ahead = (np.interp(time[:-1] + shift, time, lap, period=time[-1]) for shift in (-0.5 * span, 0.5 * span))
    return (ahead - behind) / span


def _mean_curvature(line: Course, s: FloatArray) -> FloatArray:
    """Return the line's curvature at points, averaged over the step, so that no short peak is missed."""
    turned = np.concatenate(([0.0], np.cumsum(0.5 * (line.curvature[1:] + line.curvature[:-1])) * line.spacing))
    half = 0.5 * (s[1] - s[0])

    def total(at: FloatArray) -> FloatArray:
        laps = np.floor(at / line.length)
        return laps * turned[-1] + np.interp(at - laps * line.length, line.s, turned)

    return (total(s[:-1] + half) - total(s[:-1] - half)) / (2.0 * half)


@njit(cache=True)
def _owed(square: float, bend: float, dip: float, bank: float) -> tuple[float, float]:
    """Return what the tyres owe at a squared speed: the load across the road, 1 on level ground, and that along it.

    The latter is a lateral acceleration, m/s^2, positive left. Where the side that the machine turns to is the higher
    one (off-camber), gravity adds to the curve.
    """
    cosine = 1.0 / math.sqrt(1.0 + bank * bank)
    load = cosine * (1.0 + square * dip / GRAVITY) - bank * cosine * (square * bend) / GRAVITY
    return load, cosine * (square * bend) + bank * cosine * (GRAVITY + square * dip)


@njit(cache=True)
def corner_speed_of(limits: Limits, bend: float, dip: float, bank: float) -> float:
    """Return the largest speed at which the machine holds a curve, m/s."""
    highest = limits.first + limits.spacing * (limits.lateral.shape[1] - 1)
    low, high = 0.0, highest * highest
    below, above = _spare(limits, low, bend, dip, bank), _spare(limits, high, bend, dip, bank)
    if above >= 0.0:
        return highest
    # Illinois: false position that halves the value of an end which stays, so that both ends come together. Over a
    # crest the load falls with the speed, and taking the speed from the load before swings to and fro.
    for _ in range(_CORNER_ROUNDS):
        square = high - above * (high - low) / (above - below)
        spare = _spare(limits, square, bend, dip, bank)
        if abs(spare) < _CORNER_TOLERANCE:
            return square**0.5
        if spare > 0.0:
            low, below, above = square, spare, 0.5 * above
        else:
            high, above, below = square, spare, 0.5 * below
    return low**0.5


@njit(cache=True)
def _spare(limits: Limits, square: float, bend: float, dip: float, bank: float) -> float:
    """Return the lateral acceleration that a curve at a squared speed leaves of the largest one, m/s^2."""
    load, side = _owed(square, bend, dip, bank)
    return most_lateral(limits, square**0.5, load) - abs(side)


@njit(cache=True)
def _drive(limits: Limits, square: float, bend: float, dip: float, bank: float, roll_rate: float) -> float:
    load, side = _owed(square, bend, dip, bank)
    return most_drive(limits, square**0.5, side, load, roll_rate)


@njit(cache=True)
def _brake(limits: Limits, square: float, bend: float, dip: float, bank: float) -> float:
    load, side = _owed(square, bend, dip, bank)
    return most_brake(limits, square**0.5, side, load)


class Patch(NamedTuple):
    """Road and motion between two points of a profile.

    Attributes:
        hill: deceleration by the slope of the road, m/s^2.
        dip: vertical curvature of the road, 1/m.
        bank: slope of the road across, positive rising to the left.
        roll_rate: rad/s.
    """

    hill: float
    dip: float
    bank: float
    roll_rate: float


@njit(cache=True)
def driven(limits: Limits, square: float, bend: float, bend_ahead: float, distance: float, patch: Patch) -> float:
    """Return the squared speed that full drive reaches at the next point, by the midpoint rule in squared speed.

    Args:
        limits: of the machine.
        square: squared speed at this point, m^2/s^2.
        bend: curvature here, 1/m.
        bend_ahead: curvature at the next point, 1/m.
        distance: to the next point, m.
        patch: between both.
    """
    hill, dip, bank, roll_rate = patch
    push = _drive(limits, square, bend, dip, bank, roll_rate) - hill
    half = max(square + push * distance, _STANDSTILL)
    push = _drive(limits, half, 0.5 * (bend + bend_ahead), dip, bank, roll_rate) - hill
    return max(square + 2.0 * push * distance, _STANDSTILL)


@njit(cache=True)
def braked(limits: Limits, square: float, bend: float, bend_behind: float, distance: float, patch: Patch) -> float:
    """Return the squared speed at the point before from which full braking reaches this one; see :func:`driven`."""
    hill, dip, bank, _ = patch
    pull = _brake(limits, square, bend, dip, bank) + hill
    half = max(square + pull * distance, _STANDSTILL)
    pull = _brake(limits, half, 0.5 * (bend + bend_behind), dip, bank) + hill
    return max(square + 2.0 * pull * distance, _STANDSTILL)


@njit(cache=True)
def corner_speeds(bend: np.ndarray, dip: np.ndarray, bank: np.ndarray, limits: Limits) -> np.ndarray:
    """Return the speeds that cornering alone allows at curvatures (1/m) of a road, m/s."""
    corner = np.empty(len(bend))
    for i in range(len(bend)):
        corner[i] = corner_speed_of(limits, bend[i], dip[i], bank[i])
    return corner


@njit(cache=True)
def _between(slope: np.ndarray, dip: np.ndarray, bank: np.ndarray, roll_rate: np.ndarray, i: int, j: int) -> Patch:
    """Return the means of two points of a profile."""
    return Patch(
        GRAVITY * 0.5 * (slope[i] + slope[j]), 0.5 * (dip[i] + dip[j]), 0.5 * (bank[i] + bank[j]),
        0.5 * (roll_rate[i] + roll_rate[j]),
    )  # fmt: skip


@njit(cache=True)
def solve_profile(
    corner: np.ndarray, bend: np.ndarray, distance: np.ndarray, slope: np.ndarray, dip: np.ndarray,
    bank: np.ndarray, roll_rate: np.ndarray, limits: Limits,
) -> np.ndarray:  # fmt: skip
    """Return the largest speeds over a closed line, m/s.

    Args:
        corner: speeds that cornering alone allows at n points, m/s.
        bend: curvature there, 1/m.
        distance: from each point to the next, m.
        slope: of the road at the points, positive uphill.
        dip: vertical curvature of the road, 1/m, positive in a dip.
        bank: slope of the road across, positive rising to the left.
        roll_rate: that the electronics answer, rad/s.
        limits: of the machine.
    """
    n = len(bend)
    slowest = np.argmin(corner)
    square = corner**2
    # Twice around in each direction: slip angles may slow the machine even at the slowest point.
    for k in range(slowest, slowest + 2 * n):
        i, j = k % n, (k + 1) % n
        patch = _between(slope, dip, bank, roll_rate, i, j)
        square[j] = min(square[j], driven(limits, square[i], bend[i], bend[j], distance[i], patch))
    for k in range(slowest + 2 * n, slowest, -1):
        i, j = k % n, (k - 1) % n
        patch = _between(slope, dip, bank, roll_rate, i, j)
        square[j] = min(square[j], braked(limits, square[i], bend[i], bend[j], distance[j], patch))
    return np.sqrt(square)


@njit(cache=True)
def least_rate(rate: np.ndarray, speed: np.ndarray, step: float, freedom: float) -> np.ndarray:
    """Return the smallest size of a roll rate (rad/s) within a time (s) before and after each point of a lap.

    Args:
        rate: at the points, rad/s.
        speed: there, m/s.
        step: distance of the points, m.
        freedom: s.
    """
    n = len(rate)
    least = np.abs(rate)
    for i in range(n):
        for way in (-1, 1):
            left, j = freedom, i
            while True:
                left -= step / speed[j]
                j = (j + way) % n
                if left < 0.0 or j == i:
                    break
                least[i] = min(least[i], abs(rate[j]))
    return least


@njit(cache=True)
def profile_time(speed: np.ndarray, distance: np.ndarray) -> float:
    """Return the time of a lap at given speeds (m/s) and distances (m), s."""
    n = len(speed)
    total = 0.0
    for i in range(n):
        total += 2.0 * distance[i] / (speed[i] + speed[(i + 1) % n])
    return total
