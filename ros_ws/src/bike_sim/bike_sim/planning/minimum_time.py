"""The fastest line for a machine: the ideal line that its theoretical lap asks for.

The line of least curvature is a good line, but not always a fast one: on a long curve it stays outside, where the way
is longer than the speed is higher. From the better of it and the median, this module descends on the lap time of
:mod:`bike_sim.planning.lap_limit` itself. Each round differentiates the lap time by the offsets (back through both
passes of the profile) and takes the step of a sparse quadratic programme over B-splines of offsets, whose metric is the
change of log curvature, weighted with the time spent there: lap time grows with about its square root.

What a turn leaves for the brakes falls in steps, where one aid after the other begins to act, and a descent stops at
such kinks (up to 1.4 % of a lap too early). So it begins with smooth limits of about the same size, and only goes on
from there with the machine's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import BSpline

from bike_sim.course.racing_line import (
    MARGIN,
    STATION_SPACING,
    Stations,
    at_samples,
    curvature_jacobian,
    curvature_of,
    least_curvature,
    solve_step,
    stations_of,
)
from bike_sim.course.track import Track
from bike_sim.planning.envelope import Envelope, Limits, left_by_turning
from bike_sim.planning.lap_limit import (
    Patch,
    braked,
    corner_speed_of,
    corner_speeds,
    driven,
    lap_limit,
    profile_time,
    solve_profile,
)
from bike_sim.schema import GRAVITY

FloatArray = NDArray[np.float64]

STATIONS_A_KNOT = 4
"""Stations between the knots of the spline: what bends within less than 12 m is no line that one rides."""

MAX_ROUNDS = 60
REACH = 3.0
"""Largest change of a coefficient in one round, m."""
FIRST_STIFFNESS = 30.0
LAST_STIFFNESS = 1e5
"""Factor of the metric in the first round, and that at which the descent ends; it adapts as Levenberg's does."""

ROLL_COST = 0.005
"""Cost of rolling in the descent, s for each second at 1 rad/s; it takes out wiggles that no one could ride
and costs some hundredths of a second a lap."""

SMOOTH_EXPONENT, SMOOTH_DECLINE = 2.0, 0.8
"""Brakes beside a turn in the smooth limits: ``(1 - use^exponent)^decline`` of the upright machine's."""

# Curvature below which the metric no longer counts changes relative to it, 1/m.
_STRAIGHT = 1.0 / 400.0
# At the very limit of cornering what the tyres have left along the road falls to nothing, with an infinite slope.
# The descent keeps one per cent of the speed below it; the laps that are compared in the end do not.
_HELD = 0.99
_SIGNIFICANT = 1e-5
_LEVEL = Patch(0.0, 0.0, 0.0, 0.0)


def with_fastest_line(
    track: Track,
    envelope: Envelope,
    spacing: float = STATION_SPACING,
    margin: float = MARGIN,
    roll_cost: float = ROLL_COST,
) -> Track:
    """Return the circuit with the machine's fastest line as its ideal line.

    Its theoretical lap is at least as fast as that of the median and of the line of least curvature.

    Args:
        track: the circuit.
        envelope: the machine's limits.
        spacing: distance of stations, m.
        margin: distance kept from the limits, m.
        roll_cost: see `ROLL_COST`; more gives a line that is easier to ride.

    Raises:
        NoLineError: the solver finds no line.
    """
    stations = stations_of(track, spacing, margin)
    gentle = least_curvature(stations)
    limits = envelope.limits
    best, shortest = np.zeros(len(track.centre.s)), lap_limit(envelope, track.centre).lap_time
    smooth = fastest_offsets(stations, smoothed(envelope).limits, gentle, roll_cost)
    for start in (gentle, smooth, fastest_offsets(stations, limits, smooth, roll_cost)):
        offset = at_samples(track, stations, start)
        # lines are computed for a level road: hills and banking move the best one by little
        time = lap_limit(envelope, replace(track.with_ideal(offset).line(1.0), height=None, bank=None)).lap_time
        if time < shortest:
            best, shortest = offset, time
    return track.with_ideal(best)


def smoothed(envelope: Envelope) -> Envelope:
    """Return the envelope with brakes that a turn weakens smoothly, for a descent to begin with."""
    left = left_by_turning(envelope.brake_table.shape[2], SMOOTH_EXPONENT, SMOOTH_DECLINE)
    drag = envelope.drag[:, None]
    return replace(envelope, brake_table=drag + np.maximum(envelope.brake_table[:, :, :1] - drag, 0.0) * left)


def fastest_offsets(stations: Stations, limits: Limits, start: FloatArray, roll_cost: float = ROLL_COST) -> FloatArray:
    """Descend on the lap time.

    Args:
        stations: the circuit.
        limits: the machine's.
        start: offsets to begin with, m; the median is tried as well.
        roll_cost: see `ROLL_COST`.

    Returns:
        Offsets of the stations, m.

    Raises:
        NoLineError: the solver finds no step.
    """
    basis = _spline_basis(stations.count)
    median = np.clip(np.zeros(stations.count), stations.lowest, stations.highest)
    offset = min((start, median), key=lambda line: polygon_time(stations, line, limits))
    time = polygon_time(stations, offset, limits)
    change = _differences(stations.count)
    stiffness, idle = FIRST_STIFFNESS, 0
    for _ in range(MAX_ROUNDS):
        gradient, spent = time_gradient(stations, offset, limits)
        curvature, length, jacobian = curvature_jacobian(stations, offset)
        # Roll angle is about v^2 curvature / g, so its rate is this many times the change of curvature to the next.
        effort = roll_cost * spent * ((length / spent) ** 3 / (GRAVITY * length)) ** 2
        rolled = change @ curvature
        gradient = gradient + 2.0 * jacobian.T @ (change.T @ (effort * rolled))
        bent = jacobian @ basis
        turned = change @ bent
        metric = bent.T @ sparse.diags(spent / (curvature**2 + _STRAIGHT**2)) @ bent
        rolling = 2.0 * turned.T @ sparse.diags(effort) @ turned
        bounds = _bounds(stations, offset)
        while stiffness < LAST_STIFFNESS:
            step = basis @ solve_step(stiffness * metric + rolling, basis.T @ gradient, *bounds)
            trial = np.clip(offset + step, stations.lowest, stations.highest)
            trial_time = polygon_time(stations, trial, limits)
            trial_rolled = change @ curvature_of(stations, trial)[0]
            gained = time - trial_time + float(effort @ (rolled**2 - trial_rolled**2))
            if gained > 0.0:
                break
            stiffness *= 3.0
        else:
            break
        # Where the linear prediction holds, longer steps are worth trying, elsewhere shorter ones.
        promised = -float(gradient @ step)
        stiffness *= 0.4 if gained > 0.6 * promised else (2.0 if gained < 0.3 * promised else 1.0)
        idle = idle + 1 if gained < _SIGNIFICANT * time else 0
        offset, time = trial, trial_time
        if idle == 3:
            break
    return offset


def _differences(count: int) -> sparse.csc_matrix:
    """Return the matrix that takes the difference of each station's value to the next one's, around the circuit."""
    here = np.arange(count)
    return sparse.csc_matrix(
        (np.repeat([1.0, -1.0], count), (np.tile(here, 2), np.concatenate([(here + 1) % count, here]))), (count, count)
    )


def _spline_basis(count: int) -> sparse.csc_matrix:
    """Return the periodic cubic B-splines at the stations, shape (stations, coefficients)."""
    knots = max(8, count // STATIONS_A_KNOT)
    at = np.arange(count) * knots / count
    rows, columns, values = [], [], []
    hat = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)
    for shift in range(-1, 3):
        column = np.floor(at).astype(np.int64) + shift
        rows.append(np.arange(count))
        columns.append(column % knots)
        values.append(np.nan_to_num(hat(at - column)))
    return sparse.csc_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (count, knots))


def _bounds(stations: Stations, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bounds of the coefficients: within them, the spline stays within the limits at all stations.

    The splines are positive and add up to one, so a step is a mean of its coefficients; each is bounded by what the
    stations around it allow.
    """
    count = stations.count
    knots = max(8, count // STATIONS_A_KNOT)
    place = np.arange(count) * knots / count
    lowest, highest = np.full(knots, -REACH), np.full(knots, REACH)
    for shift in range(-1, 3):
        column = (np.floor(place).astype(np.int64) + shift) % knots
        np.maximum.at(lowest, column, np.minimum(stations.lowest - offset, 0.0))
        np.minimum.at(highest, column, np.maximum(stations.highest - offset, 0.0))
    return lowest, highest


def polygon_time(stations: Stations, offset: FloatArray, limits: Limits) -> float:
    """Return the lap time on the polygon of stations at offsets (m), s."""
    bend, distance = _shape(stations, offset)
    flat = np.zeros(stations.count)
    corner = _HELD * corner_speeds(bend, flat, flat, limits)
    speed = solve_profile(corner, bend, distance, flat, flat, flat, flat, limits)
    return float(profile_time(speed, distance))


def time_gradient(stations: Stations, offset: FloatArray, limits: Limits) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the lap time by the offsets (s/m), and the time spent at each station (s)."""
    curvature, _, jacobian = curvature_jacobian(stations, offset)
    _, distance = _shape(stations, offset)
    by_bend, by_distance, spent = _adjoint(curvature, distance, limits)
    step = np.roll(_path(stations, offset), -1, axis=0) - _path(stations, offset)
    along = step / np.linalg.norm(step, axis=1)[:, None]
    ahead = np.sum(along * np.roll(stations.normals, -1, axis=0), axis=1)
    here = np.sum(along * stations.normals, axis=1)
    by_offset = jacobian.T @ by_bend + np.roll(by_distance * ahead, 1) - by_distance * here
    return np.asarray(by_offset), spent


def _path(stations: Stations, offset: FloatArray) -> FloatArray:
    return stations.points + offset[:, None] * stations.normals


def _shape(stations: Stations, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the curvature at each station (1/m) and the distance from it to the next (m)."""
    bend, _ = curvature_of(stations, offset)
    path = _path(stations, offset)
    return bend, np.linalg.norm(np.roll(path, -1, axis=0) - path, axis=1)


@njit(cache=True)
def _adjoint(bend: np.ndarray, distance: np.ndarray, limits: Limits) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of the lap time by curvature (s m) and distance (s/m), and the time at each point (s).

    The profile is solved as in :func:`~bike_sim.planning.lap_limit.solve_profile`, noting which limit binds where; then
    the derivatives run back through both passes (reverse accumulation).
    """
    n = len(bend)
    level = np.zeros(n)
    corner = _HELD * corner_speeds(bend, level, level, limits)
    slowest = np.argmin(corner)
    square = corner**2
    driving, braking = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for k in range(slowest, slowest + 2 * n):
        i, j = k % n, (k + 1) % n
        reached = driven(limits, square[i], bend[i], bend[j], distance[i], _LEVEL)
        if reached < square[j]:
            square[j], driving[j] = reached, True
    forward = square.copy()
    for k in range(slowest + 2 * n, slowest, -1):
        i, j = k % n, (k - 1) % n
        reached = braked(limits, square[i], bend[i], bend[j], distance[j], _LEVEL)
        if reached < square[j]:
            square[j], braking[j] = reached, True
    speed = np.sqrt(square)
    by_square, by_bend, by_distance, spent = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        j = (i + 1) % n
        total = speed[i] + speed[j]
        by_distance[i] += 2.0 / total
        by_square[i] -= distance[i] / (total * total * speed[i])
        by_square[j] -= distance[i] / (total * total * speed[j])
        spent[i] = 2.0 * distance[i] / total
    for k in range(slowest + 1, slowest + 2 * n + 1):
        i, j = k % n, (k - 1) % n
        if braking[j]:
            pull, by_square[j] = by_square[j], 0.0
            here = (square[i], bend[i], bend[j], distance[j])
            d = _derivatives(limits, here[0], here[1], here[2], here[3], False)
            by_square[i] += pull * d[0]
            by_bend[i] += pull * d[1]
            by_bend[j] += pull * d[2]
            by_distance[j] += pull * d[3]
    for k in range(slowest + 2 * n - 1, slowest - 1, -1):
        i, j = k % n, (k + 1) % n
        if driving[j]:
            pull, by_square[j] = by_square[j], 0.0
            d = _derivatives(limits, forward[i], bend[i], bend[j], distance[i], True)
            by_square[i] += pull * d[0]
            by_bend[i] += pull * d[1]
            by_bend[j] += pull * d[2]
            by_distance[i] += pull * d[3]
    for i in range(n):
        h = 1e-4 * abs(bend[i]) + 1e-9
        more, less = corner_speed_of(limits, bend[i] + h, 0.0, 0.0), corner_speed_of(limits, bend[i] - h, 0.0, 0.0)
        by_bend[i] += by_square[i] * _HELD**2 * (more * more - less * less) / (2.0 * h)
    return by_bend, by_distance, spent


@njit(cache=True)
def _derivatives(
    limits: Limits, square: float, bend: float, other: float, distance: float, forward: bool
) -> np.ndarray:
    """Return the derivatives of one step of a pass by squared speed, both curvatures and distance."""
    found = np.empty(4)
    for place, h in enumerate((1e-5 * square, 1e-8, 1e-8, 1e-5)):
        reached = np.empty(2)
        for side in range(2):
            at = np.array([square, bend, other, distance])
            at[place] += h if side else -h
            if forward:
                reached[side] = driven(limits, at[0], at[1], at[2], at[3], _LEVEL)
            else:
                reached[side] = braked(limits, at[0], at[1], at[2], at[3], _LEVEL)
        found[place] = (reached[1] - reached[0]) / (2.0 * h)
    return found
