"""References of followed lines: curvature and planned speed along a circuit, in tables for rows of vehicles.

What is followed and how fast it can be ridden is known before the ride; where the vehicle is on it comes with each
state. Observation and reward look both up here, so that they mean the same reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

KEPT: Final = 128
"""Lines that are kept: a training on three circuits with 21 lines each plans each of them once, one of ten machines on
a hundred circuits too.

There are more tables where more rows ride on lines of their own."""

GRIPS: Final = (1.0, 0.9, 0.8, 0.7)
"""Grips of the road, falling and evenly spaced, for which references that follow the inferred grip are planned."""

OPEN: Final = 1000.0
"""Speed limit of a ride without one, m/s: finite, so that it passes through every file and message."""


class LineTable(NamedTuple):
    """Columns along a closed line, sampled evenly; the last sample repeats the first.

    Those of a reference are curvature (1/m, positive turning left), planned speed on the known road (m/s) and, where
    references follow the inferred grip, on each of `GRIPS` but the first.

    Attributes:
        spacing: distance of the samples, m.
        table: shape (samples, columns).
    """

    spacing: float
    table: FloatArray


Plans = tuple[FloatArray, NDArray[np.int64], NDArray[np.int64], FloatArray]
"""Tables of all lines, and of each ride its first row in them, its number of intervals less one, and their length."""


class LineTables:
    """Tables of lines one behind another; rows on the same line share one, and lines not ridden for the longest go.

    Attributes:
        samples: of all tables, shape (m, columns).
        offset: first sample of each row's table.
        last: number of its intervals less one.
        spacing: of its samples, m.
    """

    def __init__(self, count: int, blank: Sequence[float]) -> None:
        """Make room for a number of rows, which have a blank sample before they begin."""
        self.samples: FloatArray = np.array([blank, blank])
        self.offset, self.last = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self.spacing = np.ones(count)
        self._blank = self.samples
        # By identity: a line is planned once and then handed out again; keeping it keeps its id from being reused.
        self._lines: dict[int, Any] = {}
        self._first: dict[int, int] = {}
        self._followed: dict[int, int] = {}

    def begin(self, row: int, line: Any) -> None:
        """Let a row follow a line from now on, which has ``spacing`` and ``table`` as a `LineTable`."""
        key = id(line)
        known = self._lines.pop(key, None)
        self._lines[key] = line  # at the end: the first is the one that was not asked for the longest
        self._followed[row] = key
        if known is None:
            self._lay()
        self.offset[row], self.last[row], self.spacing[row] = self._first[key], len(line.table) - 2, line.spacing

    @property
    def plans(self) -> Plans:
        """The tables of all rows as compiled code reads them."""
        return self.samples, self.offset, self.last, self.spacing

    def _lay(self) -> None:
        """Lay all tables anew, without those beyond `KEPT` that no row follows."""
        followed = set(self._followed.values())
        spare = [key for key in self._lines if key not in followed]
        for key in spare[: max(len(self._lines) - KEPT, 0)]:
            del self._lines[key]
        tables = [self._blank, *(line.table for line in self._lines.values())]
        self.samples = np.concatenate(tables)
        places = np.cumsum([len(table) for table in tables]).tolist()
        self._first = dict(zip(self._lines, places, strict=False))
        for row, key in self._followed.items():
            self.offset[row] = self._first[key]


@njit(cache=True)
def plan_at(plans: Plans, row: int, column: int, s: float) -> float:
    """Return a column of a ride's table at an arc length of any lap."""
    table, offset, last, spacing = plans
    u = (s % (spacing[row] * (last[row] + 1))) / spacing[row]
    i = min(int(u), last[row])
    u -= i
    i += offset[row]
    return float(table[i, column] + u * (table[i + 1, column] - table[i, column]))


class ReferenceRows:
    """References of vehicles side by side; rows on the same line share its samples.

    Attributes:
        share: part of the planned speed that is asked of each row.
        cap: speed limit of each row, m/s.
        grip: of the road that each row's speed is planned for; only known where references are adaptive.
        lines: that the rows follow.
    """

    def __init__(self, count: int, adaptive: bool = False) -> None:
        """Make room for a number of vehicles.

        Args:
            count: of vehicles.
            adaptive: whether the planned speed follows `grip`; references then need slower speeds.
        """
        self.share = np.ones(count)
        self.cap = np.full(count, OPEN)
        self.grip = np.ones(count)
        self._adaptive = adaptive
        self.lines = LineTables(count, (0.0, *np.ones(len(GRIPS) if adaptive else 1)))

    def begin(self, row: int, reference: LineTable, share: float = 1.0, cap: float = OPEN) -> None:
        """Let a row follow a line from now on.

        Args:
            row: of the vehicle.
            reference: of the line.
            share: part of the planned speed that is asked.
            cap: speed limit, m/s.

        Raises:
            ValueError: a share or limit that means nothing.
        """
        if not share > 0.0 or not cap > 0.0:
            raise ValueError(f"share of the planned speed and speed limit must be positive, got {share!r} and {cap!r}")
        self.lines.begin(row, reference)
        self.share[row], self.cap[row] = share, cap

    def at(self, progress: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return curvature (1/m) and the speed that is asked (m/s), linear between samples.

        Args:
            progress: arc length of the line, of any lap, m, shape (n,) or (n, k).
        """
        many = np.ascontiguousarray(progress).reshape(len(progress), -1)
        curvature, speed = np.empty(many.shape), np.empty(many.shape)
        _look_up(many, self.lines.plans, self.share, self.cap, self.grip, self._adaptive, curvature, speed)
        return curvature.reshape(progress.shape), speed.reshape(progress.shape)


@njit(cache=True)
def _look_up(
    progress: FloatArray, plans: Plans, share: FloatArray, cap: FloatArray, grip: FloatArray, adaptive: bool,
    curvature: FloatArray, speed: FloatArray,
) -> None:  # fmt: skip
    """Fill in curvature and speed of `ReferenceRows.at`; an unknown place has neither."""
    for row in range(len(progress)):
        # The speed for a grip is linear between those of GRIPS.
        place = min(max((GRIPS[0] - grip[row]) / (GRIPS[0] - GRIPS[1]), 0.0), len(GRIPS) - 1.0)
        for k in range(progress.shape[1]):
            s = progress[row, k]
            if not math.isfinite(s):
                curvature[row, k] = speed[row, k] = math.nan
                continue
            curvature[row, k], planned = plan_at(plans, row, 0, s), plan_at(plans, row, 1, s)
            if adaptive:
                planned *= max(0.0, 1.0 - abs(place))
                for j in range(1, len(GRIPS)):
                    planned += max(0.0, 1.0 - abs(place - j)) * plan_at(plans, row, 1 + j, s)
            speed[row, k] = min(share[row] * planned, cap[row])
