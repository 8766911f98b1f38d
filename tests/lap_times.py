"""Times of laps from places of a ride, by the account of the simulator."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from bike_sim.course import timing_account as acc
from bike_sim.course.lap_timing import EXACT, REACH, Event, LapLog, Timing, ideal_distance, outside
from bike_sim.course.projection import project, window
from bike_sim.course.track import Track


class Sample(NamedTuple):
    """Time, and progress and offset of the rear and the front contact point from the centre line."""

    time: float
    progress: float
    offset: float
    front_progress: float
    front_offset: float


def time_laps(track: Track, samples: Iterable[Sample]) -> tuple[Timing, tuple[Event, ...]]:
    """Return the summary of a ride, and what happened in it."""
    account, log, events, last = np.zeros(1, dtype=acc.ACCOUNT)[0], LapLog(), [], math.nan
    scale, measured = (track.table, track.centre.spacing, track.length), track.ideal is not None
    for time, progress, offset, *front in samples:
        moved = 0.0 if math.isnan(last) else progress - last
        rows = np.empty((acc.rows_for(len(track.marks), moved / track.length), acc.ROW_SIZE))
        away = min(outside(*scale, progress, offset), outside(*scale, *front))
        place = acc.Place(time, progress, away, ideal_distance(*scale, progress, offset), 0.0)
        count = acc.feed(account, acc.Lines(track.marks, track.length, acc.CIRCUIT, measured), place, rows)
        events += [log.take(row) for row in rows[:count].tolist()]
        last = progress
    return log.timing(account, measured), tuple(events)


def samples_of(
    track: Track, time: np.ndarray, rear: np.ndarray, front: np.ndarray, begin: float, front_begin: float
) -> Iterator[Sample]:
    """Yield where contact points of a ride were, that began near these places."""
    near, front_near = float(begin), float(front_begin)
    for k in range(len(time)):
        reach = window(REACH, math.dist(rear[k], rear[max(k - 1, 0)]), track.centre.length)
        near, offset, _ = project(track.centre.samples, *map(float, rear[k]), near, reach, reach)
        front_near, front_offset, _ = project(track.centre.samples, *map(float, front[k]), front_near, reach, reach)
        if k == 0 and abs(near - begin) < EXACT:
            near = float(begin)
        yield Sample(float(time[k]), near, offset, front_near, front_offset)
