"""The part of a ride that is evaluated: on an open course it ends at the finish, even if the ride continued."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.messages import RecordedCourse
from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import States
from bike_sim.course.finish import Finish, FinishCut, find_finish

_HELD: Final = (
    *("control_period", "steering_limit", "course_length", "curvature"),
    *("steering_command", "throttle_command", "steer_torque"),
)
"""Columns of numbers that are constant over a step, so that nothing is interpolated."""


def judged_ride(ride: Ride) -> Ride:
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


def _extended(states: States, finish: Finish) -> States:
    """The states, with progress and lateral errors extended straight beyond the finish."""
    progress, lateral = finish.extend(states.progress, states.lateral_error, states.x, states.y)
    front = finish.extend(states.front_progress, states.front_lateral_error, states.front_x, states.front_y)
    return replace(
        states, progress=progress, lateral_error=lateral, front_progress=front[0], front_lateral_error=front[1]
    )


def _cut_states(states: States, cut: FinishCut) -> States:
    columns: dict[str, NDArray[Any]] = {}
    for f in fields(states):
        column = getattr(states, f.name)
        held = column.dtype != np.float64 or f.name in _HELD
        columns[f.name] = cut.hold(column) if held else cut.interpolate(column)
    # Behind the finish it may count as off course for the distance to the end point alone.
    columns["off_course"] = np.append(states.off_course[: cut.rows], states.off_course[cut.rows - 1])
    columns["finished"] = np.append(states.finished[: cut.rows], True)
    return States(**columns)


def _until(ride: Ride, states: States) -> Ride:
    told = ride.telemetry
    if told is not None:
        told = told.take(told.step <= states.step[-1])
    return replace(ride, states=states, telemetry=told)
