"""The account of lap timing, compiled: one record, fed place by place; live rides, batches and recordings use it.

Timing begins when the start line is first crossed (or with the first place, if that lies on it). A line counts once,
when it is first crossed forward: riding back over it and on again changes nothing. The time of a crossing is
interpolated in progress.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Record = Any
FloatArray = NDArray[np.float64]

LEFT_TRACK, LAP, SECTOR, BACK_ON_TRACK = 2, 4, 6, 7
"""Kinds of rows; the numbers are those of ``bike_msgs/RideEvent``."""

KIND, TIME, PROGRESS, VALUE, NUMBER, BEGAN, OFF_TRACK, DISTANCE = range(8)
"""Columns of a row: kind, time (s), progress (m) and what came to an end there: duration (s), number of the sector in
its lap or of the lap, of a lap its beginning (s), time off the track (s) and mean distance to the ideal line (m)."""
ROW_SIZE: Final = 8

SUMS: Final = np.dtype([("time", np.float64), ("off_track", np.float64), ("distance", np.float64)])
"""What adds up over time: time (s), time off the track (s), distance to the ideal line times time (m s)."""

ACCOUNT: Final = np.dtype(
    [
        ("started", np.int64),
        ("time", np.float64),
        ("progress", np.float64),
        ("outside", np.float64),
        ("distance", np.float64),
        ("next", np.int64),  # index of the next line to cross; line k * (marks + 1) is the start of lap k
        ("timed", np.int64),  # whether the start line has been crossed
        ("lap_began", np.float64),
        ("sector_began", np.float64),
        ("sectors", np.int64),
        ("laps", np.int64),
        ("away", np.int64),
        ("left_at", np.float64),
        ("farthest", np.float64),
        ("lap", SUMS),
        ("ride", SUMS),
    ]
)
"""An account; all zeros before the first place."""


def rows_for(marks: int, laps: float) -> int:
    """Return how many rows a step can write that rides over a number of laps (a fraction counts as one more)."""
    return 2 * (marks + 1) * (math.ceil(abs(laps)) + 1) + 2


@njit(cache=True)
def sample(column: FloatArray, spacing: float, length: float, s: float) -> float:
    """Return a column of a closed line at an arc length of any lap (m), linear between samples."""
    u = (s % length) / spacing
    i = min(int(u), len(column) - 2)
    return column[i] + (u - i) * (column[i + 1] - column[i])


@njit(cache=True)
def line_at(index: int, marks: FloatArray, length: float) -> float:
    """Return the progress of a line, m."""
    lines = len(marks) + 1
    lap, mark = index // lines, index % lines
    return lap * length + (marks[mark - 1] if mark > 0 else 0.0)


@njit(cache=True)
def share_above_zero(a: float, b: float) -> float:
    """Return the fraction of a straight line from a to b that is above zero."""
    if a > 0.0 and b > 0.0:
        return 1.0
    if a <= 0.0 and b <= 0.0:
        return 0.0
    return max(a, b) / abs(a - b)


@njit(cache=True)
def feed(
    account: Record, marks: FloatArray, length: float, measured: bool, time: float, progress: float, outside: float,
    distance: float, rows: FloatArray,
) -> int:  # fmt: skip
    """Take the next place, and return the number of rows written, in the order of time.

    Args:
        account: an `ACCOUNT`, advanced.
        marks: progress of the sectors' beginnings between 0 and the length, m, growing.
        length: of the circuit, m.
        measured: whether there is an ideal line.
        time: s, growing.
        progress: of the rear contact point, m, growing over laps.
        outside: distance of the contact point that is less far out beyond the limits, m.
        distance: of the rear contact point to the ideal line, m.
        rows: out, shape (at least `rows_for`, ROW_SIZE).
    """
    if measured:
        account.farthest = max(distance, account.farthest)
    if account.started == 0:
        count = _begin(account, marks, length, time, progress, outside, rows)
    else:
        count = _go_on(account, marks, length, measured, time, progress, outside, distance, rows)
    account.started = 1
    account.time, account.progress, account.outside, account.distance = time, progress, outside, distance
    return count


@njit(cache=True)
def _begin(
    account: Record, marks: FloatArray, length: float, time: float, progress: float, outside: float, rows: FloatArray
) -> int:
    account.next = (len(marks) + 1) * math.floor(progress / length)
    while line_at(account.next, marks, length) < progress:
        account.next += 1
    if outside > 0.0:
        account.away, account.left_at = 1, time
    if line_at(account.next, marks, length) == progress:
        return _cross(account, marks, False, time, progress, rows, 0)
    return 0


@njit(cache=True)
def _go_on(
    account: Record, marks: FloatArray, length: float, measured: bool, time: float, progress: float, outside: float,
    distance: float, rows: FloatArray,
) -> int:  # fmt: skip
    t, s, out, away = account.time, account.progress, account.outside, account.distance
    count = _border(account, time, progress, outside, rows)
    while True:
        line = line_at(account.next, marks, length)
        if line > progress:
            break
        # everything is linear in progress between two places
        moved = progress - s
        share = min(max((line - s) / moved, 0.0), 1.0) if moved > 0.0 else 1.0
        t_line, out_line = t + share * (time - t), out + share * (outside - out)
        away_line = away + share * (distance - away)
        _add(account, t_line - t, out, out_line, away, away_line)
        count = _cross(account, marks, measured, t_line, line, rows, count)
        t, s, out, away = t_line, line, out_line, away_line
    _add(account, time - t, out, outside, away, distance)
    _sort(rows, count)
    return count


@njit(cache=True)
def _border(account: Record, time: float, progress: float, outside: float, rows: FloatArray) -> int:
    """Write the row of leaving the track or of coming back."""
    a, b = account.outside, outside
    if (a > 0.0) == (b > 0.0):
        return 0
    share = a / (a - b)
    at = account.time + share * (time - account.time)
    where = account.progress + share * (progress - account.progress)
    if b > 0.0:
        _write(rows, 0, LEFT_TRACK, at, where, 0.0)
        account.away, account.left_at = 1, at
    else:
        _write(rows, 0, BACK_ON_TRACK, at, where, at - account.left_at if account.away else 0.0)
        account.away = 0
    return 1


@njit(cache=True)
def _write(rows: FloatArray, row: int, kind: int, time: float, progress: float, value: float) -> None:
    rows[row, KIND], rows[row, TIME], rows[row, PROGRESS], rows[row, VALUE] = kind, time, progress, value
    for column in range(NUMBER, ROW_SIZE):
        rows[row, column] = 0.0


@njit(cache=True)
def _add(account: Record, span: float, a: float, b: float, near: float, far: float) -> None:
    """Add a time (s) to the sums of lap and ride, with the distances beyond the limits and to the ideal line (m)."""
    if span <= 0.0:
        return
    outside, distance = span * share_above_zero(a, b), 0.5 * span * (near + far)
    account.lap.time += span
    account.lap.off_track += outside
    account.lap.distance += distance
    account.ride.time += span
    account.ride.off_track += outside
    account.ride.distance += distance


@njit(cache=True)
def mean_distance(sums: Record, measured: bool) -> float:
    """Return the mean distance to the ideal line over time, m; NaN without one."""
    return sums.distance / sums.time if measured and sums.time > 0.0 else math.nan


@njit(cache=True)
def _cross(
    account: Record, marks: FloatArray, measured: bool, time: float, line: float, rows: FloatArray, count: int
) -> int:
    """Count a line, and write the sector and the lap that end there."""
    starts_lap = account.next % (len(marks) + 1) == 0
    account.next += 1
    if account.timed:
        account.sectors += 1
        _write(rows, count, SECTOR, time, line, time - account.sector_began)
        rows[count, NUMBER] = account.sectors
        count += 1
    account.sector_began = time
    if starts_lap:
        if account.timed:
            account.laps += 1
            _write(rows, count, LAP, time, line, time - account.lap_began)
            rows[count, NUMBER], rows[count, BEGAN] = account.laps, account.lap_began
            rows[count, OFF_TRACK] = account.lap.off_track
            rows[count, DISTANCE] = mean_distance(account.lap, measured)
            count += 1
        account.timed, account.lap_began, account.sectors = 1, time, 0
        account.lap.time = account.lap.off_track = account.lap.distance = 0.0
    return count


@njit(cache=True)
def _sort(rows: FloatArray, count: int) -> None:
    """Sort rows by time; those of the same time keep their order."""
    for k in range(1, count):
        j = k
        while j > 0 and rows[j - 1, TIME] > rows[j, TIME]:
            for column in range(ROW_SIZE):
                rows[j - 1, column], rows[j, column] = rows[j, column], rows[j - 1, column]
            j -= 1
