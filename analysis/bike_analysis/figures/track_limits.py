"""Where a ride was beyond the limits of its course, and for how long.

A position is off the track if both contact points are outside (as `bike_sim.course.lap_timing` counts it). The limits
are those of the recorded course: distances from the followed line to the left and to the right.
"""

from __future__ import annotations

import numpy as np

from bike_analysis.read.messages import RecordedCourse
from bike_analysis.read.tables import Floats, States


def has_limits(course: RecordedCourse | None) -> bool:
    """Whether a course was recorded with both limits."""
    return course is not None and 0 < len(course.s) == len(course.width_left) == len(course.width_right)


def beyond_limits(states: States, course: RecordedCourse | None) -> Floats:
    """Distance beyond the limits of the contact point that is less far out, m.

    Args:
        states: States of a ride.
        course: Its course.

    Returns:
        One value per state, negative on the track; NaN without limits. Without the front contact the rear one counts.
    """
    if course is None or not has_limits(course):
        return np.full(len(states), np.nan)
    rear = _outside(course, states.progress, states.lateral_error)
    front = _outside(course, states.front_progress, states.front_lateral_error)
    return np.fmin(rear, front)


def _outside(course: RecordedCourse, progress: Floats, offset: Floats) -> Floats:
    station = np.mod(progress, course.length) if course.closed and course.length > 0.0 else progress
    left = np.interp(station, course.s, course.width_left)
    right = np.interp(station, course.s, course.width_right)
    return np.maximum(offset - left, -offset - right)


def time_outside(time_s: Floats, outside: Floats, begin_s: float = -np.inf, end_s: float = np.inf) -> float | None:
    """Time beyond the limits, s; `outside` is taken as linear between states.

    Args:
        time_s: Of each state, s.
        outside: How far outside, m; negative on the track.
        begin_s: Only from here on, s.
        end_s: Only until here, s.

    Returns:
        The time; None if unknown.
    """
    if len(time_s) < 2 or not np.isfinite(outside).any():
        return None
    a, b = outside[:-1], outside[1:]
    begin, end = np.maximum(time_s[:-1], begin_s), np.minimum(time_s[1:], end_s)
    span = np.diff(time_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where((a > 0) & (b > 0), 1.0, np.where((a > 0) | (b > 0), np.maximum(a, b) / np.abs(a - b), 0.0))
        inside = np.clip((end - begin) / span, 0.0, 1.0)
    return float(np.nansum(span * share * inside))
