"""Relation of a ride to its course: where it ends at the finish of an open one, and when it was beyond the limits.

A position is off the track if both contact points are outside (as `bike_sim.course.lap_timing` counts it). The limits
are those of the recorded course: distances from the followed line to the left and to the right.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from bike_analysis.read.messages import RecordedCourse
from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import Floats, Table
from bike_sim.course.finish import Finish, FinishCut, find_finish

_HELD: Final = (
    *("control_period", "steering_limit", "course_length", "curvature"),
    *("steering_command", "throttle_command", "steer_torque"),
)
"""Columns of numbers that are constant over a step, so that nothing is interpolated."""


def evaluated_ride(ride: Ride) -> Ride:
    """Cut a ride at the finish of its open course.

    Args:
        ride: A ride as recorded.

    Returns:
        The same ride whose last state is interpolated at the finish, lateral errors behind the end measured to the
        course's straight continuation. Without a recorded course the states behind the finish are left out and none is
        interpolated. A ride on a closed course, and one that does not reach the finish, is returned unchanged.
    """
    states = ride.states
    if states.course_closed[-1]:
        return ride
    finish = course_finish(ride.course)
    if finish is None:
        behind = states.progress >= states.course_length
        return ride if behind[0] or not behind.any() else _until(ride, states.take(slice(0, int(np.argmax(behind)))))
    states = _extended(states, finish)
    cut = find_finish(finish.length, states.progress)
    return ride if cut is None else _until(ride, _cut_states(states, cut))


def course_finish(course: RecordedCourse | None) -> Finish | None:
    """The finish of a recorded course; None where it is closed or has no line."""
    if course is None or course.closed or len(course.s) < 2:
        return None
    dx, dy, step = course.x[-1] - course.x[-2], course.y[-1] - course.y[-2], course.s[-1] - course.s[-2]
    bend = 0.5 * step * course.curvature[-1] if len(course.curvature) == len(course.s) else 0.0
    return Finish(float(course.s[-1]), float(course.x[-1]), float(course.y[-1]), math.atan2(dy, dx) + float(bend))


def _extended(states: Table, finish: Finish) -> Table:
    """The states, with progress and lateral errors extended straight beyond the finish."""
    progress, lateral = finish.extend(states.progress, states.lateral_error, states.x, states.y)
    front = finish.extend(states.front_progress, states.front_lateral_error, states.front_x, states.front_y)
    return states.with_columns(
        progress=progress, lateral_error=lateral, front_progress=front[0], front_lateral_error=front[1]
    )


def _cut_states(states: Table, cut: FinishCut) -> Table:
    values = {
        name: cut.hold(column) if column.dtype != np.float64 or name in _HELD else cut.interpolate(column)
        for name, column in states.values.items()
    }
    # Behind the finish it may count as off course for the distance to the end point alone.
    values["off_course"] = np.append(states.off_course[: cut.rows], states.off_course[cut.rows - 1])
    values["finished"] = np.append(states.finished[: cut.rows], True)
    order, episode, step = (cut.hold(column) for column in (states.order, states.episode, states.step))
    return Table(order, cut.interpolate(states.time_s), episode, step, values)


def _until(ride: Ride, states: Table) -> Ride:
    telemetry = ride.telemetry
    if telemetry is not None:
        telemetry = telemetry.take(telemetry.step <= states.step[-1])
    return replace(ride, states=states, telemetry=telemetry)


def has_limits(course: RecordedCourse | None) -> bool:
    """Whether a course was recorded with both limits."""
    return course is not None and 0 < len(course.s) == len(course.width_left) == len(course.width_right)


def beyond_limits(states: Table, course: RecordedCourse | None) -> Floats:
    """Distance beyond the limits of the contact point that is less far out, m.

    Args:
        states: Table of a ride.
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
