"""What is seen of a ride at one instant: derived motion, relation to the course, preview. Compiled.

One kernel serves the single simulator and the batches of training, so that both see the same numbers.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy import ndarray

from bike_sim.course import projection
from bike_sim.physics import kinematics
from bike_sim.physics.state import FRONT_WHEEL_RATE, ROLL, STEER, YAW, X, Y
from bike_sim.vehicles.bicycle import PARAMETER_NAMES

# Places in the vector of derived quantities that `look` fills.
PITCH, YAW_RATE, SPEED, FRONT_X, FRONT_Y = range(5)
PROGRESS, LATERAL_ERROR, HEADING_ERROR, CURVATURE = range(5, 9)
FRONT_PROGRESS, FRONT_LATERAL_ERROR, PREVIEW_SPACING = range(9, 12)
LOOK_SIZE = 12

FIELDS = (
    "pitch",
    "yaw_rate",
    "speed",
    "front_x",
    "front_y",
    "progress",
    "lateral_error",
    "heading_error",
    "curvature",
    "front_progress",
    "front_lateral_error",
    "preview_spacing",
)
"""What they are called in messages and recordings, in the same order."""

_FRONT_RADIUS = PARAMETER_NAMES.index("rF")


@njit(cache=True)
def look(
    state: ndarray,
    parameters: ndarray,
    course_x: ndarray,
    course_y: ndarray,
    course_heading: ndarray,
    course_curvature: ndarray,
    spacing: float,
    closed: bool,
    by_time: bool,
    interval: float,
    fresh: bool,
    seen: ndarray,
    preview_x: ndarray,
    preview_y: ndarray,
) -> None:
    """Fill what is seen from a minimal state.

    Args:
        state: minimal state, see :mod:`bike_sim.physics.state`.
        parameters: flat vehicle parameters.
        course_x: samples of the course, m.
        course_y: the same, m.
        course_heading: the same, rad.
        course_curvature: the same, 1/m.
        spacing: distance of samples, m.
        closed: whether the course is closed.
        by_time: preview distance grows with speed (Weyrer et al. 2026, Eq. 14).
        interval: s if so, else m.
        fresh: search the whole window ahead from ``seen[PROGRESS]`` as given, after a reset.
        seen: vector of LOOK_SIZE, in and out: the last progress is where the search begins.
        preview_x: out, m, base_link.
        preview_y: out, m, base_link.
    """
    seen[PITCH] = kinematics.pitch(state[ROLL], state[STEER], parameters)
    seen[YAW_RATE] = kinematics.yaw_rate(state, parameters)
    seen[SPEED] = kinematics.rear_speed(state, parameters)
    front_x, front_y = kinematics.front_contact(state, parameters)
    seen[FRONT_X], seen[FRONT_Y] = front_x, front_y
    behind, ahead = projection.BEHIND, projection.AHEAD
    s, distance, heading = projection.project(
        course_x, course_y, course_heading, spacing, closed, state[X], state[Y], seen[PROGRESS], behind, ahead
    )
    seen[PROGRESS] = s
    seen[LATERAL_ERROR] = distance
    seen[HEADING_ERROR] = projection.wrap_angle(state[YAW] - heading)
    seen[CURVATURE] = projection.curvature_at(course_curvature, spacing, closed, s)
    front_near = s + 1.0 if fresh else seen[FRONT_PROGRESS]
    s, distance, _ = projection.project(
        course_x, course_y, course_heading, spacing, closed, front_x, front_y, front_near, behind, ahead
    )
    seen[FRONT_PROGRESS] = s
    seen[FRONT_LATERAL_ERROR] = distance
    step = interval * parameters[_FRONT_RADIUS] * state[FRONT_WHEEL_RATE] if by_time else interval
    seen[PREVIEW_SPACING] = step
    projection.preview(
        course_x,
        course_y,
        course_heading,
        spacing,
        closed,
        state[X],
        state[Y],
        state[YAW],
        seen[PROGRESS],
        step,
        preview_x,
        preview_y,
    )


def blank_look() -> np.ndarray:
    """Return a vector for :func:`look` with the search beginning at arc length 0."""
    return np.zeros(LOOK_SIZE)
