"""The theoretical lap: the speed profile that a machine's limits allow on a line, and its braking points.

Quasi-steady state: at every point of the line the machine is in the equilibrium of its speed, lateral and longitudinal
acceleration. From the speeds that cornering allows, one pass forward applies what drives, one pass backward what
brakes (the classical lap-time simulation, as in Brayshaw & Harrison 2005, A quasi steady state approach to race car
lap simulation, Proc. IMechE D 219). No rider rides it: it is the bar that riders are measured by.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.theory.envelope import Envelope

FloatArray = NDArray[np.float64]

STEP = 1.0
"""Distance of the profile's points, m."""

GRAVITY = 9.81

_TABLE_STEP = 0.25
_BRAKING = 0.5
_LEAST_BRAKING = 3.0
_STANDSTILL = 1e-6


@dataclass(frozen=True)
class BrakingPoint:
    """Where braking begins and what it achieves.

    Attributes:
        begin: arc length of the line, m. end: m, beyond the lap if it runs over the start.
        speed_before: m/s. speed_after: m/s.
    """

    begin: float
    end: float
    speed_before: float
    speed_after: float

    @property
    def deceleration(self) -> float:
        """Mean deceleration over the distance, m/s^2."""
        return (self.speed_before**2 - self.speed_after**2) / (2.0 * (self.end - self.begin))


@dataclass(frozen=True)
class LapLimit:
    """A theoretical lap. Arrays are over the points of the line, the last repeating the first.

    Attributes:
        machine: its name. line: name of the line.
        s: arc length of the line, m.
        time: since the start, s.
        speed: m/s.
        lateral: lateral acceleration, m/s^2, positive to the left.
        longitudinal: m/s^2, positive forward.
        corner_speed: what cornering alone would allow, m/s.
        braking_points: in the order of riding.
        sector_times: s, as the line's sections divide it; empty without.
    """

    machine: str
    line: str
    s: FloatArray
    time: FloatArray
    speed: FloatArray
    lateral: FloatArray
    longitudinal: FloatArray
    corner_speed: FloatArray
    braking_points: tuple[BrakingPoint, ...]
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
    grade: FloatArray | None = None,
    cap: FloatArray | None = None,
    push: FloatArray | None = None,
) -> LapLimit:
    """Return the theoretical lap of a machine on a closed line.

    Args:
        envelope: the machine's limits.
        line: closed line.
        step: distance of the profile's points, m.
        grade: slope of the road at the line's samples, positive uphill, or None for a flat road.
        cap: largest speed that somebody wants at each point of the profile but the last, m/s, or None.
        push: largest acceleration that somebody wants there, m/s^2, may be negative, or None.

    Raises:
        ValueError: the line is open, the step is not positive, the grade, the cap or the push does not fit, or the
            machine cannot move.
    """
    if not line.closed:
        raise ValueError(f"course {line.name!r} is open; a lap needs a closed line")
    if not step > 0.0:
        raise ValueError(f"step of the profile must be positive, got {step!r} m")
    if grade is not None and len(grade) != len(line.s):
        raise ValueError(f"grade has {len(grade)} samples, the line {len(line.s)}")
    if float(envelope.drive(envelope.speeds[0])) <= 0.0:
        raise ValueError(f"machine {envelope.name!r} has no drive at {envelope.speeds[0]:.1f} m/s")
    count = max(16, round(line.length / step))
    s = np.linspace(0.0, line.length, count + 1)
    bend = _mean_curvature(line, s)
    slope = np.zeros(count) if grade is None else np.interp(s[:-1], line.s, grade)
    distance = np.full(count, line.length / count)
    limits = limit_tables(envelope)
    cap, push = (np.full(count, np.inf) if most is None else most for most in (cap, push))
    for name, most in (("cap", cap), ("push", push)):
        if np.shape(most) != (count,):
            raise ValueError(f"{name} has shape {np.shape(most)}, the profile {count} points")
    corner_speed = np.minimum(corner_speeds(bend, limits), cap)
    speed = solve_profile(corner_speed, bend, distance, slope, limits, envelope.exponent, push)
    closed = np.append(speed, speed[0])
    time = np.concatenate(([0.0], np.cumsum(2.0 * distance / (closed[1:] + closed[:-1]))))
    longitudinal = np.diff(closed**2) / (2.0 * distance)
    sectors = [begin for _, begin in line.sections] + [line.length]
    at = np.interp(sectors, s, time)
    return LapLimit(
        envelope.name,
        line.name,
        s,
        time,
        closed,
        closed**2 * np.append(bend, bend[0]),
        np.append(longitudinal, longitudinal[0]),
        np.append(corner_speed, corner_speed[0]),
        _braking_points(s, closed, longitudinal, np.interp(speed, envelope.speeds, envelope.drag)),
        tuple(float(t) for t in np.diff(at)) if line.sections else (),
    )


def _mean_curvature(line: Course, s: FloatArray) -> FloatArray:
    """Return the line's curvature at points, averaged over the step, so that no short peak is missed."""
    turned = np.concatenate(([0.0], np.cumsum(0.5 * (line.curvature[1:] + line.curvature[:-1])) * line.spacing))
    half = 0.5 * (s[1] - s[0])

    def total(at: FloatArray) -> FloatArray:
        laps = np.floor(at / line.length)
        return laps * turned[-1] + np.interp(at - laps * line.length, line.s, turned)

    return (total(s[:-1] + half) - total(s[:-1] - half)) / (2.0 * half)


def limit_tables(envelope: Envelope) -> FloatArray:
    """Return the envelope on a uniform grid of speeds for compiled look-up.

    Returns:
        Rows lateral, drive, brake by the tyres alone, drive by the tyres alone, drag; 0.25 m/s apart from standstill
        to the top speed (where drag takes all drive), which no profile exceeds. The last row is no function of speed:
        the part of the drive that is left over the used part of the lateral limit, from 0 to 1. Shape (6, m).
    """
    pulling = envelope.drive_max > 0.0
    stop = len(pulling) if pulling[-1] else len(pulling) - int(np.argmax(pulling[::-1])) + 1
    highest = float(envelope.speeds[stop - 1])
    speeds = np.arange(0.0, highest + _TABLE_STEP, _TABLE_STEP)

    def on_grid(values: FloatArray) -> FloatArray:
        return np.interp(speeds, envelope.speeds, values)

    drag = on_grid(envelope.drag)
    return np.stack(
        [
            on_grid(envelope.lateral_max),
            on_grid(envelope.drive_max),
            np.maximum(on_grid(envelope.brake_max) - drag, 0.0),
            on_grid(envelope.grip_drive_max),
            drag,
            envelope.left_for_drive(np.linspace(0.0, 1.0, len(speeds))),
        ]
    )


@njit(cache=True)
def _look_up(table: np.ndarray, speed: float) -> float:
    place = speed / _TABLE_STEP
    i = int(place)
    if i >= len(table) - 1:
        return table[-1]
    return table[i] + (place - i) * (table[i + 1] - table[i])


@njit(cache=True)
def _left_for_tyres(limits: np.ndarray, speed: float, bend: float, exponent: float) -> float:
    """Return the fraction of the longitudinal tyre limit that cornering leaves."""
    used = speed * speed * abs(bend) / _look_up(limits[0], speed)
    if used >= 1.0:
        return 0.0
    if exponent == 2.0:
        return math.sqrt(1.0 - used * used)
    return (1.0 - used**exponent) ** (1.0 / exponent)


@njit(cache=True)
def _drive(limits: np.ndarray, speed: float, bend: float, exponent: float) -> float:
    used = speed * speed * abs(bend) / _look_up(limits[0], speed)
    # An infinite slope at the very limit would be lost in a table, hence both.
    left = min(
        _left_for_tyres(limits, speed, bend, exponent), _look_up(limits[5], used * (limits.shape[1] - 1) * _TABLE_STEP)
    )
    grip = _look_up(limits[3], speed) * left
    return min(_look_up(limits[1], speed), grip - _look_up(limits[4], speed))


@njit(cache=True)
def _brake(limits: np.ndarray, speed: float, bend: float, exponent: float) -> float:
    return _look_up(limits[2], speed) * _left_for_tyres(limits, speed, bend, exponent) + _look_up(limits[4], speed)


@njit(cache=True)
def corner_speed_of(limits: np.ndarray, bend: float) -> float:
    """Return the largest speed at which the machine holds a curve, m/s."""
    highest = (limits.shape[1] - 1) * _TABLE_STEP
    if highest * highest * abs(bend) <= _look_up(limits[0], highest):
        return highest
    low, high = 0.0, highest
    for _ in range(40):
        middle = 0.5 * (low + high)
        if middle * middle * abs(bend) <= _look_up(limits[0], middle):
            low = middle
        else:
            high = middle
    return low


@njit(cache=True)
def driven(
    limits: np.ndarray, square: float, bend: float, bend_ahead: float, distance: float, hill: float, exponent: float
) -> float:
    """Return the squared speed that full drive reaches at the next point, by the midpoint rule in squared speed.

    Args:
        limits: see :func:`limit_tables`.
        square: squared speed at this point, m^2/s^2.
        bend: curvature here, 1/m.
        bend_ahead: curvature at the next point, 1/m.
        distance: to the next point, m.
        hill: deceleration by the slope of the road, m/s^2.
        exponent: of the combination of accelerations.
    """
    push = _drive(limits, math.sqrt(square), bend, exponent) - hill
    half = math.sqrt(max(square + push * distance, _STANDSTILL))
    push = _drive(limits, half, 0.5 * (bend + bend_ahead), exponent) - hill
    return max(square + 2.0 * push * distance, _STANDSTILL)


@njit(cache=True)
def braked(
    limits: np.ndarray, square: float, bend: float, bend_behind: float, distance: float, hill: float, exponent: float
) -> float:
    """Return the squared speed at the point before from which full braking reaches this one; see :func:`driven`."""
    pull = _brake(limits, math.sqrt(square), bend, exponent) + hill
    half = math.sqrt(max(square + pull * distance, _STANDSTILL))
    pull = _brake(limits, half, 0.5 * (bend + bend_behind), exponent) + hill
    return max(square + 2.0 * pull * distance, _STANDSTILL)


@njit(cache=True)
def corner_speeds(bend: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the speeds that cornering alone allows at curvatures (1/m), m/s."""
    corner = np.empty(len(bend))
    for i in range(len(bend)):
        corner[i] = corner_speed_of(limits, bend[i])
    return corner


@njit(cache=True)
def solve_profile(
    corner: np.ndarray,
    bend: np.ndarray,
    distance: np.ndarray,
    slope: np.ndarray,
    limits: np.ndarray,
    exponent: float,
    push: np.ndarray,
) -> np.ndarray:
    """Return the largest speeds over a closed line, m/s.

    Args:
        corner: speeds that cornering alone allows at n points, m/s.
        bend: curvature there, 1/m.
        distance: from each point to the next, m.
        slope: of the road at the points, positive uphill.
        limits: see :func:`limit_tables`.
        exponent: of the combination of lateral and longitudinal acceleration.
        push: largest acceleration wanted at the points, m/s^2.
    """
    n = len(bend)
    slowest = np.argmin(corner)
    square = corner**2
    # From the slowest point once around in each direction. No other point limits the slowest one, unless no curve
    # limits any: then the first lap only gathers speed, hence two.
    laps = 1 if corner[slowest] < (limits.shape[1] - 1) * _TABLE_STEP else 2
    for k in range(slowest, slowest + laps * n):
        i, j = k % n, (k + 1) % n
        hill = GRAVITY * 0.5 * (slope[i] + slope[j])
        reached = driven(limits, square[i], bend[i], bend[j], distance[i], hill, exponent)
        square[j] = min(square[j], reached, max(square[i] + 2.0 * push[i] * distance[i], _STANDSTILL))
    for k in range(slowest + laps * n, slowest, -1):
        i, j = k % n, (k - 1) % n
        hill = GRAVITY * 0.5 * (slope[i] + slope[j])
        square[j] = min(square[j], braked(limits, square[i], bend[i], bend[j], distance[j], hill, exponent))
    return np.sqrt(square)


@njit(cache=True)
def profile_time(speed: np.ndarray, distance: np.ndarray) -> float:
    """Return the time of a lap at given speeds (m/s) and distances (m), s."""
    n = len(speed)
    total = 0.0
    for i in range(n):
        total += 2.0 * distance[i] / (speed[i] + speed[(i + 1) % n])
    return total


def _braking_points(
    s: FloatArray, speed: FloatArray, longitudinal: FloatArray, drag: FloatArray
) -> tuple[BrakingPoint, ...]:
    """Find where the machine slows by more than the air does."""
    n = len(longitudinal)
    braking = -longitudinal > drag + _BRAKING
    if not np.any(braking) or np.all(braking):
        return ()
    found = []
    for first in np.flatnonzero(braking & ~np.roll(braking, 1)):
        last = first
        while braking[last % n]:
            last += 1
        before, after = float(speed[first]), float(speed[last % n])
        if before - after >= _LEAST_BRAKING:
            found.append(BrakingPoint(float(s[first]), float(s[last % n] + (last // n) * s[-1]), before, after))
    return tuple(found)
