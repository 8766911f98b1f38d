"""The account of lap timing, compiled: one record, fed place by place; live rides and recordings use it.

On a circuit, timing begins when the start line is first crossed (or with the first place, if that lies on it); on a
path with the first place. A line counts once, when it is first crossed forward: riding back over it and on again
changes nothing. The time of a crossing is interpolated in progress.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.schema import Quantity, Schema

Record = Any
FloatArray = NDArray[np.float64]

LEFT_TRACK, LAP, FINISH, SECTOR, BACK_ON_TRACK = 2, 4, 5, 6, 7
"""Kinds of rows; the numbers are those of ``bike_msgs/RideEvent``."""

ROW: Final = Schema(
    (
        Quantity("kind", "1", 1, "one of the above"),
        Quantity("time", "s", 1, "of the crossing"),
        Quantity("progress", "m", 1, "of the line"),
        Quantity("value", "s", 1, "duration of what ends there"),
        Quantity("number", "1", 1, "of the sector in its lap, or of the lap"),
        Quantity("began", "s", 1, "beginning of a lap"),
        Quantity("off_track", "s", 1, "time off the track in a lap"),
        Quantity("distance", "m", 1, "mean distance to the ideal line in a lap"),
    )
)
"""Columns of a row."""
KIND, TIME, PROGRESS, VALUE = map(ROW.index, ("kind", "time", "progress", "value"))
NUMBER, BEGAN, OFF_TRACK, DISTANCE = map(ROW.index, ("number", "began", "off_track", "distance"))
ROW_SIZE: Final = len(ROW)

SUMS: Final = np.dtype([("time", np.float64), ("off_track", np.float64), ("distance", np.float64)])
"""Sums over time: time (s), time off the track (s), distance to the ideal line times time (m s)."""

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

CIRCUIT, CLOSED_PATH, OPEN_PATH = 0, 1, 2
"""Kinds of courses: the end of an open path is reached once; a path's laps have no sector that ends with them."""

_END_SLACK: Final = 1e-9
"""Distance from the end of an open path at which it is reached, m: the projection stops there."""


class Lines(NamedTuple):
    """Lines across a course.

    Attributes:
        marks: progress of the sectors' beginnings between 0 and the length, m, growing.
        length: of a lap, or of an open path, m.
        kind: CIRCUIT, CLOSED_PATH or OPEN_PATH.
        measured: whether there is an ideal line.
    """

    marks: FloatArray
    length: float
    kind: int
    measured: bool


class Place(NamedTuple):
    """A vehicle on a course at one instant.

    Attributes:
        time: s, growing.
        progress: of the rear contact point, m, growing over laps.
        outside: distance of the contact point that is less far out beyond the limits, m; 0 on a path.
        distance: of the rear contact point to the ideal line, m.
        moved: distance ridden since the last place where progress may show less, as at the end of an open path, m.
    """

    time: float
    progress: float
    outside: float
    distance: float
    moved: float


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
def line_at(index: int, lines: Lines) -> float:
    """Return the progress of a line, m; infinite behind the end of an open path."""
    count = len(lines.marks) + 1
    lap, mark = index // count, index % count
    if lines.kind == OPEN_PATH and index > count:
        return math.inf
    return lap * lines.length + (lines.marks[mark - 1] if mark > 0 else 0.0)


@njit(cache=True)
def share_above_zero(a: float, b: float) -> float:
    """Return the fraction of a straight line from a to b that is above zero."""
    if a > 0.0 and b > 0.0:
        return 1.0
    if a <= 0.0 and b <= 0.0:
        return 0.0
    return max(a, b) / abs(a - b)


@njit(cache=True)
def feed(account: Record, lines: Lines, place: Place, rows: FloatArray) -> int:
    """Take the next place, and return the number of rows written, in the order of time.

    Args:
        account: an `ACCOUNT`, advanced.
        lines: of the course.
        place: of the vehicle.
        rows: out, shape (at least `rows_for`, ROW_SIZE).
    """
    if lines.measured:
        account.farthest = max(place.distance, account.farthest)
    count = _begin(account, lines, place, rows) if account.started == 0 else _go_on(account, lines, place, rows)
    account.started = 1
    account.time, account.progress = place.time, place.progress
    account.outside, account.distance = place.outside, place.distance
    return count


@njit(cache=True)
def _begin(account: Record, lines: Lines, place: Place, rows: FloatArray) -> int:
    count = len(lines.marks) + 1
    if lines.kind != CIRCUIT:
        account.next, account.timed = 1, 1
        while line_at(account.next, lines) <= place.progress:
            account.next += 1
        account.lap_began = account.sector_began = place.time
        account.sectors = (account.next - 1) % count
        return 0
    account.next = count * math.floor(place.progress / lines.length)
    while line_at(account.next, lines) < place.progress:
        account.next += 1
    if place.outside > 0.0:
        account.away, account.left_at = 1, place.time
    if line_at(account.next, lines) == place.progress:
        return _cross(account, lines, place.time, place.progress, rows, 0)
    return 0


@njit(cache=True)
def _go_on(account: Record, lines: Lines, place: Place, rows: FloatArray) -> int:
    time, progress, outside, distance = place.time, place.progress, place.outside, place.distance
    t, s, out, away = account.time, account.progress, account.outside, account.distance
    slack = _END_SLACK if lines.kind == OPEN_PATH else 0.0
    count = _border(account, time, progress, outside, rows)
    while True:
        line = line_at(account.next, lines)
        if line - slack > progress:
            break
        # everything is linear in progress between two places
        moved = progress - s
        if lines.kind == OPEN_PATH and line >= lines.length - slack:
            moved = max(moved, place.moved)
        share = min(max((line - s) / moved, 0.0), 1.0) if moved > 0.0 else 1.0
        t_line, out_line = t + share * (time - t), out + share * (outside - out)
        away_line = away + share * (distance - away)
        _add(account, t_line - t, out, out_line, away, away_line)
        count = _cross(account, lines, t_line, line, rows, count)
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
def _cross(account: Record, lines: Lines, time: float, line: float, rows: FloatArray, count: int) -> int:
    """Count a line, and write the sector and the lap that end there."""
    starts_lap = account.next % (len(lines.marks) + 1) == 0
    account.next += 1
    if account.timed and not (starts_lap and lines.kind != CIRCUIT):
        account.sectors += 1
        _write(rows, count, SECTOR, time, line, time - account.sector_began)
        rows[count, NUMBER] = account.sectors
        count += 1
    account.sector_began = time
    if starts_lap:
        if lines.kind == OPEN_PATH:
            _write(rows, count, FINISH, time, line, 0.0)
            count += 1
        elif account.timed:
            account.laps += 1
            _write(rows, count, LAP, time, line, time - account.lap_began)
            rows[count, NUMBER], rows[count, BEGAN] = account.laps, account.lap_began
            rows[count, OFF_TRACK] = account.lap.off_track
            rows[count, DISTANCE] = mean_distance(account.lap, lines.measured)
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
