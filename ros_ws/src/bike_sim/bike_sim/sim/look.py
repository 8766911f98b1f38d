"""Derived quantities of one control instant: motion, relation to the course, preview, course points. Compiled.

The same kernels serve one simulator and batches, bicycles and superbikes, so that all see the same numbers bit for bit.

A vehicle that rolls without slip has its motion from its minimal state. With tyres it has not: then the caller writes
pitch, yaw rate and speed of the simulated machine into the look before.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy import ndarray

from bike_sim.course import projection
from bike_sim.course.projection import SampledLine
from bike_sim.course.timing_account import sample
from bike_sim.physics import kinematics
from bike_sim.physics.state import FRONT_WHEEL_RATE, ROLL, STEER, YAW, X, Y
from bike_sim.schema import LIMITS, LOOK
from bike_sim.schema import PLACE as CENTRE_PLACE
from bike_sim.sim.request import COURSE_POINTS
from bike_sim.sim.request import STATIONS as STATIONS
from bike_sim.vehicles.bicycle import PARAMETER_NAMES

PITCH: Final = LOOK.index("pitch")
YAW_RATE: Final = LOOK.index("yaw_rate")
SPEED: Final = LOOK.index("speed")
FRONT_X: Final = LOOK.index("front_x")
FRONT_Y: Final = LOOK.index("front_y")
PROGRESS: Final = LOOK.index("progress")
LATERAL_ERROR: Final = LOOK.index("lateral_error")
HEADING_ERROR: Final = LOOK.index("heading_error")
CURVATURE: Final = LOOK.index("curvature")
FRONT_PROGRESS: Final = LOOK.index("front_progress")
FRONT_LATERAL_ERROR: Final = LOOK.index("front_lateral_error")
PREVIEW_SPACING: Final = LOOK.index("preview_spacing")
LOOK_SIZE: Final = len(LOOK)
FIELDS: Final = LOOK.names

CENTRE_PROGRESS: Final = CENTRE_PLACE.index("centre_progress")
CENTRE_OFFSET: Final = CENTRE_PLACE.index("centre_offset")
FRONT_CENTRE_PROGRESS: Final = CENTRE_PLACE.index("front_centre_progress")
FRONT_CENTRE_OFFSET: Final = CENTRE_PLACE.index("front_centre_offset")
PLACE_SIZE: Final = len(CENTRE_PLACE)

REAR_LEFT: Final = LIMITS.index("rear_left_margin")
REAR_RIGHT: Final = LIMITS.index("rear_right_margin")
FRONT_LEFT: Final = LIMITS.index("front_left_margin")
FRONT_RIGHT: Final = LIMITS.index("front_right_margin")
OUTSIDE: Final = LIMITS.index("outside")
OFF_TRACK_TIME: Final = LIMITS.index("off_track_time")
WALL_ENERGY: Final = LIMITS.index("wall_energy")
WRONG_WAY: Final = LIMITS.index("wrong_way")
CIRCUIT_SIZE: Final = len(LIMITS)

LINES: Final = ("line", "left", "right")
"""Rows of the course points: the followed line and both limits."""
LINE, LEFT, RIGHT = map(LINES.index, LINES)

STATION_SIZE: Final = 11
"""Numbers that a station shows at a sample of a line, see :func:`stations`."""

LEAST_SPACING: Final = 0.5
"""Distance of stations at a standstill, m."""

# Beginnings of the blocks of a view: derived quantities, then these.
PLACE: Final = LOOK_SIZE
CIRCUIT: Final = PLACE + PLACE_SIZE
POINTS: Final = CIRCUIT + CIRCUIT_SIZE
VIEW_SIZE: Final = POINTS + 9 * STATIONS
"""A view is one vector: derived quantities, place, relation to the limits and course points."""

_INTERVAL: Final = COURSE_POINTS.interval
_FRONT_RADIUS = PARAMETER_NAMES.index("rF")


class Machine(NamedTuple):
    """A vehicle as the kernels take it.

    Attributes:
        parameters: flat vehicle parameters.
        rolling: whether it rolls without slip, so that its motion follows from the minimal state.
        mass: kg.
    """

    parameters: ndarray
    rolling: bool
    mass: float


class Circuit(NamedTuple):
    """Lines and limits of a circuit as the kernels take them.

    Attributes:
        ahead: stations of the followed line, from :func:`stations`.
        centre: the centre line.
        height: of the centre line at its samples, m.
        bank: rise per m to the left there.
    """

    ahead: ndarray
    centre: SampledLine
    height: ndarray
    bank: ndarray


class Points(NamedTuple):
    """Form of a preview, see :class:`bike_sim.sim.request.Preview`."""

    by_time: bool
    interval: float


@njit(cache=True, inline="always")
def _move(state: ndarray, machine: Machine, look: ndarray) -> None:
    """Fill the derived motion; see the module's docstring for vehicles that do not roll without slip."""
    parameters = machine.parameters
    if machine.rolling:
        look[PITCH] = kinematics.pitch(state[ROLL], state[STEER], parameters)
        look[YAW_RATE] = kinematics.yaw_rate(state, parameters)
        look[SPEED] = kinematics.rear_speed(state, parameters)
    look[FRONT_X], look[FRONT_Y] = kinematics.front_contact(state, parameters)


@njit(cache=True, inline="always")
def _relate(state: ndarray, line: SampledLine, behind: float, ahead: float, fresh: bool, look: ndarray) -> None:
    """Fill the errors of both contact points to the followed line, searched in a window around the last projections."""
    s, distance, direction = projection.project(line, state[X], state[Y], look[PROGRESS], behind, ahead)
    look[PROGRESS] = s
    look[LATERAL_ERROR] = distance
    look[HEADING_ERROR] = projection.wrap_angle(state[YAW] - direction)
    look[CURVATURE] = projection.curvature_at(line, s)
    near = s + 1.0 if fresh else look[FRONT_PROGRESS]
    s, distance, _ = projection.project(line, look[FRONT_X], look[FRONT_Y], near, behind, ahead)
    look[FRONT_PROGRESS] = s
    look[FRONT_LATERAL_ERROR] = distance


@njit(cache=True, inline="always")
def preview_line(
    state: ndarray, machine: Machine, line: SampledLine, points: Points, look: ndarray, preview: ndarray
) -> None:
    """Fill the preview of the followed line (Weyrer et al. 2026, Eqs. 5 and 14).

    Args:
        state: minimal state.
        machine: where it rolls, the speed of the points is that of the front wheel's rolling; else that of the look,
            with LEAST_SPACING.
        line: the followed one.
        points: form of the preview.
        look: its progress is where the preview begins; its preview spacing is set.
        preview: out, m, base_footprint, shape (2, points).
    """
    step = points.interval
    if points.by_time and machine.rolling:
        step = points.interval * machine.parameters[_FRONT_RADIUS] * state[FRONT_WHEEL_RATE]
    elif points.by_time:
        step = max(points.interval * look[SPEED], LEAST_SPACING)
    look[PREVIEW_SPACING] = step
    projection.preview(line, (state[X], state[Y], state[YAW]), look[PROGRESS], step, preview)


@njit(cache=True)
def derive_on_path(
    state: ndarray, machine: Machine, line: SampledLine, points: Points, fresh: bool, look: ndarray, preview: ndarray
) -> None:
    """Fill the derived quantities of a path.

    Args:
        state: minimal state, see :mod:`bike_sim.physics.state`.
        machine: the vehicle.
        line: the path.
        points: form of the preview.
        fresh: search for the front contact from the rear one, after a reset.
        look: vector of LOOK_SIZE, in and out: the last progress is where the search begins.
        preview: out, m, base_footprint, shape (2, points).
    """
    _move(state, machine, look)
    _relate(state, line, projection.BEHIND, projection.AHEAD, fresh, look)
    preview_line(state, machine, line, points, look, preview)


@njit(cache=True)
def centre_progress(centre: SampledLine, line_x: ndarray, line_y: ndarray) -> ndarray:
    """Return the progress along a closed centre line at the samples of another line of the circuit, increasing, m.

    Args:
        centre: the centre line.
        line_x: samples of the line, m; the first is at the start line.
        line_y: the same, m.
    """
    found = np.empty(len(line_x))
    near = 0.0
    for i in range(len(line_x)):
        near, _, _ = projection.project(centre, line_x[i], line_y[i], near, 5.0, 5.0)
        found[i] = near
    return found


@njit(cache=True)
def stations(
    line: ndarray, line_spacing: float, to_centre: ndarray, centre: SampledLine,
    limits: tuple[ndarray, ndarray, ndarray, ndarray],
) -> ndarray:  # fmt: skip
    """Return what a station shows at every sample of a line of a circuit: one row each, so that memory is read once.

    Args:
        line: x, y, heading and curvature of the line, shape (4, n).
        line_spacing: distance of its samples, m.
        to_centre: progress along the centre line at its samples, m.
        centre: the centre line.
        limits: distance to the left and to the right limit (m), height (m) and bank (rise per m to the left), at the
            centre line's samples.

    Returns:
        x and y of the line, of its tangent as long as the distance of its samples, and of the left and of the right
        limit beside it, then the heights of line and limits, all m, shape (n, STATION_SIZE).
    """
    spacing = centre.spacing
    left, right, height, bank = limits
    around = spacing * (len(height) - 1)
    rows = np.empty((line.shape[1], STATION_SIZE))
    for i in range(line.shape[1]):
        c = to_centre[i]
        mx, my, tx, ty = projection.point_at(centre, c)
        aside, across = sample(left, spacing, around, c), sample(right, spacing, around, c)
        rows[i, 0], rows[i, 1] = line[0, i], line[1, i]
        rows[i, 2], rows[i, 3] = math.cos(line[2, i]) * line_spacing, math.sin(line[2, i]) * line_spacing
        rows[i, 4], rows[i, 5] = mx - aside * ty, my + aside * tx
        rows[i, 6], rows[i, 7] = mx + across * ty, my - across * tx
        middle, tilt = sample(height, spacing, around, c), sample(bank, spacing, around, c)
        beside = tx * (line[1, i] - my) - ty * (line[0, i] - mx)
        rows[i, 8], rows[i, 9], rows[i, 10] = middle + beside * tilt, middle + aside * tilt, middle - across * tilt
    return rows


@njit(cache=True)
def derive_on_circuit(
    state: ndarray, machine: Machine, line: SampledLine, circuit: Circuit, reach: float, stopped: bool, view: ndarray
) -> float:
    """Fill look, place and course points, and return the heading of the centre line beside the rear contact, rad.

    Args:
        state: minimal state.
        machine: the vehicle.
        line: the followed line.
        circuit: around it.
        reach: how far around where they were the nearest points are searched, m.
        stopped: whether a wall holds the vehicle, so that its speed and yaw rate are 0.
        view: in and out; the last look and place are where the search begins.
    """
    look, place = view[:PLACE], view[PLACE:CIRCUIT]
    points = view[POINTS:VIEW_SIZE].reshape((3, STATIONS, 3))
    _move(state, machine, look)
    if stopped:
        look[YAW_RATE] = look[SPEED] = 0.0
    _relate(state, line, reach, reach, False, look)
    centre, height, bank = circuit.centre, circuit.height, circuit.bank
    spacing = centre.spacing
    place[CENTRE_PROGRESS], place[CENTRE_OFFSET], direction = projection.project(
        centre, state[X], state[Y], place[CENTRE_PROGRESS], reach, reach
    )
    place[FRONT_CENTRE_PROGRESS], place[FRONT_CENTRE_OFFSET], _ = projection.project(
        centre, look[FRONT_X], look[FRONT_Y], place[FRONT_CENTRE_PROGRESS], reach, reach
    )
    look[PREVIEW_SPACING] = max(_INTERVAL * look[SPEED], LEAST_SPACING)
    around, here = spacing * (len(height) - 1), place[CENTRE_PROGRESS]
    ground = sample(height, spacing, around, here) + place[CENTRE_OFFSET] * sample(bank, spacing, around, here)
    _course_points(state, circuit.ahead, line.spacing, ground, look, points)
    return direction


@njit(cache=True)
def _course_points(
    state: ndarray, ahead: ndarray, spacing: float, ground: float, look: ndarray, points: ndarray
) -> None:
    """Fill the stations ahead, with heights above the ground at the vehicle (m)."""
    cos, sin = math.cos(state[YAW]), math.sin(state[YAW])
    x, y = state[X], state[Y]
    for k in range(points.shape[1]):
        i, u = projection.locate(look[PROGRESS] + k * look[PREVIEW_SPACING], spacing, len(ahead), True)
        a, b = ahead[i], ahead[i + 1]
        px, py = projection.hermite(a, b, u)
        for row in range(3):
            if row != LINE:
                at = 2 * row + 2
                px, py = a[at] + u * (b[at] - a[at]), a[at + 1] + u * (b[at + 1] - a[at + 1])
            points[row, k, 0] = cos * (px - x) + sin * (py - y)
            points[row, k, 1] = cos * (py - y) - sin * (px - x)
            points[row, k, 2] = a[8 + row] + u * (b[8 + row] - a[8 + row]) - ground
