"""Relation of a ride to its course: its finish, the limits, and the laps and sectors of a closed one.

The start line lies where the course's arc length is 0 and the sectors begin where its sections do. A line counts once,
when it is first crossed forward, and the time of crossing is interpolated in progress between two states, as
`bike_sim.course.lap_timing` does while riding. Where the recording has the simulator's own LAP and SECTOR events, their
times are taken, so that every page and program shows the same lap time. That timer itself needs a circuit with its
limits and every contact point; here laps are found also where only the progress was recorded, with gaps.

A position is off the track if both contact points are outside the limits of the recorded course: distances from the
followed line to the left and to the right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bike_analysis.figures.rides import Ride
from bike_analysis.read.messages import Floats, RecordedCourse, RecordedEvent, Table
from bike_sim.course.course import Course
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
    progress, lateral = finish.extend(states.progress, states.lateral_error, states.x, states.y)
    front = finish.extend(states.front_progress, states.front_lateral_error, states.front_x, states.front_y)
    states = states.with_columns(
        progress=progress, lateral_error=lateral, front_progress=front[0], front_lateral_error=front[1]
    )
    cut = find_finish(finish.length, states.progress)
    return ride if cut is None else _until(ride, _cut_states(states, cut))


def course_finish(course: RecordedCourse | None) -> Finish | None:
    """The finish of a recorded course; None where it is closed or has no line."""
    if course is None or course.closed or len(course.s) < 2:
        return None
    dx, dy, step = course.x[-1] - course.x[-2], course.y[-1] - course.y[-2], course.s[-1] - course.s[-2]
    bend = 0.5 * step * course.curvature[-1] if len(course.curvature) == len(course.s) else 0.0
    return Finish(float(course.s[-1]), float(course.x[-1]), float(course.y[-1]), math.atan2(dy, dx) + float(bend))


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
    return replace(ride, states=states, telemetry=ride.telemetry.take(ride.telemetry.step <= states.step[-1]))


def has_limits(course: RecordedCourse | Course | None) -> bool:
    """Whether a course has both limits."""
    if course is None or course.width_left is None or course.width_right is None:
        return False
    return 0 < len(course.s) == len(course.width_left) == len(course.width_right)


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


SHORTEST_COURSE: Final = 1.0
"""A course shorter than a bicycle is no course but damage, m."""
ON_THE_LINE: Final = 0.05
"""A ride that begins at most this far beyond a line began on it, m."""
MOST_LAPS: Final = 2000
"""Laps that are distinguished in one ride."""
AT_RESET: Final = 1e-6
"""A lap that begins this soon after the reset begins with the ride, s."""
SAME_CROSSING: Final = 0.25
"""An event belongs to a crossing found from the states if their times differ by less than this, s."""


@dataclass(frozen=True, eq=False)
class Lap:
    """A complete lap.

    Attributes:
        ride: The ride that it is in.
        number: From 1 within its ride.
        begin_s: When it began, s since the ride's first state.
        duration_s: Lap time, s.
        begin_m: Progress at which it began, m: a multiple of the course's length.
        sectors_s: Times of the sectors, s, in order; empty where the course has none or one is not known.
        first: First row of the ride's states inside the lap.
        last: Row after the last one inside.
        from_events: Whether the lap time is that of the recorded event.
        out_lap: Whether it began with the ride itself, as from a rolling start, and not by riding over the line.
    """

    ride: Ride
    number: int
    begin_s: float
    duration_s: float
    begin_m: float
    sectors_s: tuple[float, ...]
    first: int
    last: int
    from_events: bool
    out_lap: bool

    def __repr__(self) -> str:
        return f"<Lap {self.label}: {self.duration_s:.3f} s>"

    @property
    def label(self) -> str:
        """Name for people."""
        return f"{self.ride.label}, lap {self.number}"

    def table(self) -> pd.DataFrame:
        """The rows of the ride's table inside the lap, with ``time_s`` counted from the start line."""
        table = self.ride.table().iloc[self.rows].reset_index(drop=True)
        table["time_s"] -= self.begin_s
        return table

    @property
    def rows(self) -> slice:
        """Rows of the ride's states inside the lap."""
        return slice(self.first, self.last)

    @property
    def end_s(self) -> float:
        """When it ended, s since the ride's first state."""
        return self.begin_s + self.duration_s


def find_laps(ride: Ride) -> tuple[Lap, ...]:
    """Find the complete laps of a ride.

    Args:
        ride: A ride.

    Returns:
        Laps in order; none on an open course or where the progress was not recorded.
    """
    length = course_length(ride)
    if length is None:
        return ()
    starts = sector_starts(ride)
    crossed = line_crossings(ride, length, starts)
    begins = sorted(k for k, mark in crossed if mark == 0 and (k + 1, 0) in crossed)
    laps = []
    for number, k in enumerate(begins, start=1):
        lap = _lap(ride, number, k, crossed, starts, length)
        if lap.first < lap.last:  # else no state of it was recorded, and its times are those of a gap
            laps.append(_as_recorded(ride, lap))
    return tuple(laps)


def course_length(ride: Ride) -> float | None:
    """Length of the closed course of a ride, m; None for an open or unknown one."""
    return known_length(ride.states) if ride.states.course_closed[-1] else None


def known_length(states: Table) -> float | None:
    """Length of the course as last recorded, m; None if no state has a valid one."""
    lengths = states.course_length[states.course_length >= SHORTEST_COURSE]
    return float(lengths[-1]) if len(lengths) else None


def lap_range(first_m: float, last_m: float, length: float) -> range:
    """Numbers of the laps of a closed course, counted from 0, between two values of progress.

    At most `MOST_LAPS`: where damage makes a course tiny or a ride endless, nothing is counted for hours.
    """
    if not (np.isfinite(first_m) and np.isfinite(last_m) and length > 0.0):
        return range(0)
    first = int(first_m // length)
    return range(first, min(int(last_m // length), first + MOST_LAPS) + 1)


def sector_starts(ride: Ride) -> Floats:
    """Arc lengths at which the sectors of a closed course begin, m: 0 first, then those inside the course."""
    length, course = course_length(ride), ride.course
    if length is None or course is None or not len(course.section_starts):
        return np.zeros(1)
    inside = np.unique(course.section_starts)
    return np.concatenate([[0.0], inside[(inside > ON_THE_LINE) & (inside < length)]])


def line_crossings(ride: Ride, length: float, starts: Floats) -> dict[tuple[int, int], float]:
    """When each line was first crossed.

    Args:
        ride: A ride on a closed course.
        length: Of the course, m.
        starts: Arc lengths of the lines, m, from 0.

    Returns:
        Time in s since the ride's first state, by number of the lap (of the course's own count) and of the line.
    """
    progress, time = farther_than_before(ride.states.progress, ride.time)
    if not len(progress):
        return {}
    laps = np.array(lap_range(progress[0], progress[-1], length))
    lines = (laps[:, None] * length + starts[None, :]).ravel()
    names = [(int(k), mark) for k in laps for mark in range(len(starts))]
    at_first = (lines < progress[0]) & (lines >= progress[0] - ON_THE_LINE)
    inside = ((lines >= progress[0]) & (lines <= progress[-1])) | at_first
    times = np.where(at_first, time[0], np.interp(lines, progress, time))
    return {name: float(t) for name, t, known in zip(names, times, inside, strict=True) if known}


def farther_than_before(progress: Floats, time: Floats) -> tuple[Floats, Floats]:
    """Progress and time of the states at which a ride was farther than ever before."""
    known = np.isfinite(progress)
    progress, time = progress[known], time[known]
    if not len(progress):
        return progress, time
    farthest = np.maximum.accumulate(progress)
    fresh = np.append(True, np.diff(farthest) > 0.0)
    return progress[fresh], time[fresh]


def _lap(ride: Ride, number: int, k: int, crossed: dict[tuple[int, int], float], starts: Floats, length: float) -> Lap:
    """The lap between two crossings of the start line."""
    begin, end = crossed[k, 0], crossed[k + 1, 0]
    marks = [crossed.get((k, mark)) for mark in range(len(starts))] + [end]
    sectors: tuple[float, ...] = ()
    if len(starts) > 1 and all(mark is not None for mark in marks):
        sectors = tuple(float(t) for t in np.diff(np.array(marks, dtype=np.float64)))
    first, last = np.searchsorted(ride.time, [begin, end])
    out_lap = begin <= float(ride.time[0])
    return Lap(ride, number, begin, end - begin, k * length, sectors, int(first), int(last), False, out_lap)


def counted_laps(laps: Sequence[Lap]) -> list[Lap]:
    """Laps that count for the best lap and the best sectors: without out-laps, unless there are no others."""
    return [lap for lap in laps if not lap.out_lap] or list(laps)


def _as_recorded(ride: Ride, lap: Lap) -> Lap:
    """The same lap with the times of the recorded events, where there are any for it."""
    zero = reset_time(ride)
    end = _nearest([e for e in ride.events if e.kind == "lap"], lap.end_s + zero)
    if end is None or not end.value > 0.0:
        return lap
    sectors = [e for e in ride.events if e.kind == "sector"]
    times: list[float] = []
    at = lap.begin_s + zero
    for seconds in lap.sectors_s:
        at += seconds
        event = _nearest(sectors, at)
        if event is not None:
            times.append(event.value)
    complete = len(times) == len(lap.sectors_s)
    return replace(
        lap,
        begin_s=end.time_s - end.value - zero,
        duration_s=end.value,
        sectors_s=tuple(times) if complete else lap.sectors_s,
        from_events=True,
        out_lap=end.time_s - end.value <= AT_RESET,
    )


def reset_time(ride: Ride) -> float:
    """Time since the reset at the ride's first state, s: 0 unless the recorder came late."""
    period = ride.states.control_period[np.isfinite(ride.states.control_period)]
    return float(ride.states.step[0] * period[0]) if len(period) else 0.0


def _nearest(events: Sequence[RecordedEvent], time_s: float) -> RecordedEvent | None:
    """The event nearest to a time since the reset, if it is the same crossing."""
    near = min(events, key=lambda event: abs(event.time_s - time_s), default=None)
    return near if near is not None and abs(near.time_s - time_s) < SAME_CROSSING else None


def lap_of_states(ride: Ride, laps: Sequence[Lap]) -> NDArray[np.int64]:
    """Number of the complete lap of each state; 0 outside."""
    number = np.zeros(len(ride.states), dtype=np.int64)
    for lap in laps:
        number[lap.rows] = lap.number
    return number
