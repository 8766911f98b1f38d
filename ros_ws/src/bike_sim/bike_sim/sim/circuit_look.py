"""What is seen of a superbike on a circuit at one instant. Compiled; the sibling of :mod:`bike_sim.sim.look`.

The vector of derived quantities has the order of :mod:`bike_sim.sim.look` and relates to the followed line; the
places on the centre line come besides. Speed, pitch and yaw rate are those of the simulated machine: with tyres, ideal rolling
does not tell them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy import ndarray

from bike_sim.course import projection
from bike_sim.course.course import Course
from bike_sim.physics import kinematics
from bike_sim.physics.state import YAW, X, Y
from bike_sim.sim import look as ride

STATIONS = 20
"""Points of each of the three lines ahead."""

LINE, LEFT, RIGHT = range(3)
"""Places of the followed line and of both limits in the course points."""

# Places in the vector of what relates to the centre line.
PROGRESS, OFFSET, FRONT_PROGRESS, FRONT_OFFSET = range(4)

LEAST_SPACING = 0.5
"""Distance of stations at a standstill, m."""


@njit(cache=True)
def centre_progress(
    x: ndarray, y: ndarray, heading: ndarray, spacing: float, line_x: ndarray, line_y: ndarray
) -> ndarray:
    """Return the progress along a closed centre line at the samples of a line beside it, growing, m.

    Args:
        x: samples of the centre line, m.
        y: the same, m.
        heading: the same, rad.
        spacing: of its samples, m.
        line_x: samples of the line, m; the first lies beside the start.
        line_y: the same, m.
    """
    found = np.empty(len(line_x))
    near = 0.0
    for i in range(len(line_x)):
        near, _, _ = projection.project(x, y, heading, spacing, True, line_x[i], line_y[i], near, 5.0, 5.0)
        found[i] = near
    return found


@njit(cache=True)
def _sample(column: ndarray, spacing: float, s: float) -> float:
    """Return a column of a closed line at an arc length of any lap, linear between samples."""
    u = (s % (spacing * (len(column) - 1))) / spacing
    i = min(int(u), len(column) - 2)
    return column[i] + (u - i) * (column[i + 1] - column[i])


@njit(cache=True)
def look(
    state: ndarray,
    speed: float,
    pitch: float,
    yaw_rate: float,
    parameters: ndarray,
    line: tuple[ndarray, ndarray, ndarray, ndarray],
    line_spacing: float,
    to_centre: ndarray,
    centre: tuple[ndarray, ndarray, ndarray],
    spacing: float,
    limits: tuple[ndarray, ndarray, ndarray],
    interval: float,
    reach: float,
    seen: ndarray,
    place: ndarray,
    points: ndarray,
) -> None:
    """Fill what is seen.

    Args:
        state: minimal state.
        speed: forward speed, m/s.
        pitch: rad, positive nose down.
        yaw_rate: rad/s.
        parameters: flat vehicle parameters.
        line: x, y, heading, curvature of the followed line.
        line_spacing: distance of its samples, m.
        to_centre: progress along the centre line at its samples, m.
        centre: x, y, heading of the centre line.
        spacing: distance of its samples, m.
        limits: distance to the left and to the right limit (m) and height (m), at the centre line's samples.
        interval: time between stations, s.
        reach: how far ahead the nearest points are searched, m.
        seen: vector in the order of `ride`, in and out.
        place: progress and offset of both contact points on the centre line, in and out.
        points: out, stations of the followed line and of both limits, in base_link, m, shape (3, STATIONS, 3).
    """
    front_x, front_y = kinematics.front_contact(state, parameters)
    seen[ride.PITCH], seen[ride.YAW_RATE], seen[ride.SPEED] = pitch, yaw_rate, speed
    seen[ride.FRONT_X], seen[ride.FRONT_Y] = front_x, front_y
    lx, ly, lh, lc = line
    s, distance, heading = projection.project(
        lx, ly, lh, line_spacing, True, state[X], state[Y], seen[ride.PROGRESS], reach, reach
    )
    seen[ride.PROGRESS], seen[ride.LATERAL_ERROR] = s, distance
    seen[ride.HEADING_ERROR] = projection.wrap_angle(state[YAW] - heading)
    seen[ride.CURVATURE] = projection.curvature_at(lc, line_spacing, True, s)
    front_s, front_distance, _ = projection.project(
        lx, ly, lh, line_spacing, True, front_x, front_y, seen[ride.FRONT_PROGRESS], reach, reach
    )
    seen[ride.FRONT_PROGRESS], seen[ride.FRONT_LATERAL_ERROR] = front_s, front_distance
    cx, cy, ch = centre
    place[PROGRESS], place[OFFSET], _ = projection.project(
        cx, cy, ch, spacing, True, state[X], state[Y], place[PROGRESS], reach, reach
    )
    place[FRONT_PROGRESS], place[FRONT_OFFSET], _ = projection.project(
        cx, cy, ch, spacing, True, front_x, front_y, place[FRONT_PROGRESS], reach, reach
    )
    step = max(interval * speed, LEAST_SPACING)
    seen[ride.PREVIEW_SPACING] = step
    cos, sin = math.cos(state[YAW]), math.sin(state[YAW])
    left, right, height = limits
    ground = _sample(height, spacing, place[PROGRESS])
    lap = line_spacing * (len(lx) - 1)
    for k in range(points.shape[1]):
        at = s + k * step
        qx, qy, _, _ = projection.point_at(lx, ly, lh, line_spacing, True, at)
        u = (at % lap) / line_spacing
        i = min(int(u), len(to_centre) - 2)
        c = to_centre[i] + (u - i) * (to_centre[i + 1] - to_centre[i])
        mx, my, tx, ty = projection.point_at(cx, cy, ch, spacing, True, c)
        z = _sample(height, spacing, c) - ground
        for row in range(3):
            if row == LINE:
                px, py = qx, qy
            else:
                aside = _sample(left, spacing, c) if row == LEFT else -_sample(right, spacing, c)
                px, py = mx - aside * ty, my + aside * tx
            px -= state[X]
            py -= state[Y]
            points[row, k, 0] = cos * px + sin * py
            points[row, k, 1] = cos * py - sin * px
            points[row, k, 2] = z


def columns(course: Course) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Return a course's x, y, heading and curvature as compiled code takes them."""
    return course.x, course.y, course.heading, course.curvature
