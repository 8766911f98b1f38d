"""Laps and sectors of a ride on a closed course, found from its states; recorded events of the timing are preferred.

The start line lies where the course's arc length is 0 and the sectors begin where its sections do. A line counts once,
when it is first crossed forward, and the time of crossing is interpolated in progress between two states, as
`bike_sim.course.lap_timing` does while riding. Where the recording has the simulator's own LAP and SECTOR events, their
times are taken, so that every page and program shows the same lap time. That timer itself needs a circuit with its
limits and every contact point; here laps are found also where only the progress was recorded, with gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.messages import RecordedEvent
from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import Floats, Table

SHORTEST_COURSE: Final = 1.0
"""A course shorter than a bicycle is no course but damage, m."""
ON_THE_LINE: Final = 0.05
"""A ride that begins at most this far beyond a line began on it, m."""
MOST_LAPS: Final = 2000
"""Laps that are distinguished in one ride."""
SAME_CROSSING: Final = 0.25
"""An event belongs to a crossing found from the states if their times differ by less than this, s."""


@dataclass(frozen=True)
class CompleteLap:
    """A complete lap.

    Attributes:
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

    number: int
    begin_s: float
    duration_s: float
    begin_m: float
    sectors_s: tuple[float, ...]
    first: int
    last: int
    from_events: bool
    out_lap: bool

    @property
    def rows(self) -> slice:
        """Rows of the ride's states inside the lap."""
        return slice(self.first, self.last)

    @property
    def end_s(self) -> float:
        """When it ended, s since the ride's first state."""
        return self.begin_s + self.duration_s


def find_laps(ride: Ride) -> tuple[CompleteLap, ...]:
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


def _lap(
    ride: Ride, number: int, k: int, crossed: dict[tuple[int, int], float], starts: Floats, length: float
) -> CompleteLap:
    """The lap between two crossings of the start line."""
    begin, end = crossed[k, 0], crossed[k + 1, 0]
    marks = [crossed.get((k, mark)) for mark in range(len(starts))] + [end]
    sectors: tuple[float, ...] = ()
    if len(starts) > 1 and all(mark is not None for mark in marks):
        sectors = tuple(float(t) for t in np.diff(np.array(marks, dtype=np.float64)))
    first, last = np.searchsorted(ride.time, [begin, end])
    out_lap = begin <= float(ride.time[0])
    return CompleteLap(number, begin, end - begin, k * length, sectors, int(first), int(last), False, out_lap)


def counted_laps(laps: Sequence[CompleteLap]) -> list[CompleteLap]:
    """Laps that count for the best lap and the best sectors: without out-laps, unless there are no others."""
    return [lap for lap in laps if not lap.out_lap] or list(laps)


def _as_recorded(ride: Ride, lap: CompleteLap) -> CompleteLap:
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
    )


def reset_time(ride: Ride) -> float:
    """Time since the reset at the ride's first state, s: 0 unless the recorder came late."""
    period = ride.states.control_period[np.isfinite(ride.states.control_period)]
    return float(ride.states.step[0] * period[0]) if len(period) else 0.0


def _nearest(events: Sequence[RecordedEvent], time_s: float) -> RecordedEvent | None:
    """The event nearest to a time since the reset, if it is the same crossing."""
    near = min(events, key=lambda event: abs(event.time_s - time_s), default=None)
    return near if near is not None and abs(near.time_s - time_s) < SAME_CROSSING else None


def lap_of_states(ride: Ride, laps: Sequence[CompleteLap]) -> NDArray[np.int64]:
    """Number of the complete lap of each state; 0 outside."""
    number = np.zeros(len(ride.states), dtype=np.int64)
    for lap in laps:
        number[lap.rows] = lap.number
    return number
