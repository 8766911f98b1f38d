"""References of followed lines: curvature and planned speed along a circuit, in tables for rows of vehicles.

What is followed and how fast it can be ridden is known before the ride; where the vehicle is on it comes with each
state. Observation and reward look both up here, so that they mean the same reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
LineT = TypeVar("LineT")

KEPT: Final = 64
"""Lines that are kept: a training on three circuits with 21 lines each plans each of them once.

There are more tables where more rows ride on lines of their own."""

GRIPS: Final = (1.0, 0.9, 0.8, 0.7)
"""Grips of the road, falling and evenly spaced, for which references that follow the inferred grip are planned."""

OPEN: Final = 1000.0
"""Speed limit of a ride without one, m/s: finite, so that it passes through every file and message."""


class LineTables(Generic[LineT]):
    """Tables one behind another; rows on the same line share one, and lines not ridden for the longest go.

    Attributes:
        samples: of all tables, shape (m, columns).
        offset: first sample of each row's table.
        last: number of its intervals less one.
        spacing: of its samples, m.
    """

    def __init__(self, count: int, blank: Sequence[float], table_of: Callable[[LineT], FloatArray]) -> None:
        """Make room for a number of rows.

        Args:
            count: of rows.
            blank: sample that rows have before they begin.
            table_of: makes the table of a line, shape (samples, columns).
        """
        self.samples: FloatArray = np.array([blank, blank])
        self.offset, self.last = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self.spacing = np.ones(count)
        self._blank, self._table_of = self.samples, table_of
        # By identity: a line is planned once and then handed out again; keeping it keeps its id from being reused.
        self._tables: dict[int, tuple[LineT, FloatArray]] = {}
        self._first: dict[int, int] = {}
        self._followed: dict[int, int] = {}

    def begin(self, row: int, line: LineT, spacing: float) -> None:
        """Let a row follow a line from now on, whose samples are `spacing` apart, m."""
        key = id(line)
        known = self._tables.pop(key, None)
        table = self._table_of(line) if known is None else known[1]
        self._tables[key] = line, table  # at the end: the first is the one that was not asked for the longest
        self._followed[row] = key
        if known is None:
            self._lay()
        self.offset[row], self.last[row], self.spacing[row] = self._first[key], len(table) - 2, spacing

    def _lay(self) -> None:
        """Lay all tables anew, without those beyond `KEPT` that no row follows."""
        followed = set(self._followed.values())
        spare = [key for key in self._tables if key not in followed]
        for key in spare[: max(len(self._tables) - KEPT, 0)]:
            del self._tables[key]
        tables = [self._blank, *(table for _, table in self._tables.values())]
        self.samples = np.concatenate(tables)
        places = np.cumsum([len(table) for table in tables]).tolist()
        self._first = dict(zip(self._tables, places, strict=False))
        for row, key in self._followed.items():
            self.offset[row] = self._first[key]


class Reference(NamedTuple):
    """A closed followed line, sampled evenly; the last sample repeats the first.

    Attributes:
        spacing: distance of the samples, m.
        curvature: 1/m, positive turning left.
        speed: planned speed on the known road, m/s.
        slower: planned speeds on each of `GRIPS` but the first, m/s, shape (samples, 3); None where they are not
            followed.
    """

    spacing: float
    curvature: FloatArray
    speed: FloatArray
    slower: FloatArray | None = None

    def table(self) -> FloatArray:
        """Return curvature and speeds as columns."""
        columns = [self.curvature, self.speed, *([] if self.slower is None else self.slower.T)]
        return np.stack(columns, axis=1)


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
        blank = (0.0, *np.ones(len(GRIPS) if adaptive else 1))
        self.lines = LineTables[Reference](count, blank, Reference.table)

    def begin(self, row: int, reference: Reference, share: float = 1.0, cap: float = OPEN) -> None:
        """Let a row follow a line from now on.

        Args:
            row: of the vehicle.
            reference: of the line.
            share: part of the planned speed that is asked.
            cap: speed limit, m/s.

        Raises:
            ValueError: a reference, share or limit that means nothing.
        """
        if len(reference.curvature) != len(reference.speed) or len(reference.speed) < 3:
            raise ValueError(
                f"a reference needs as many curvatures as speeds, at least 3, got {len(reference.curvature)} and "
                f"{len(reference.speed)}"
            )
        if not share > 0.0 or not cap > 0.0:
            raise ValueError(f"share of the planned speed and speed limit must be positive, got {share!r} and {cap!r}")
        self.lines.begin(row, reference, reference.spacing)
        self.share[row], self.cap[row] = share, cap

    def at(self, progress: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return curvature (1/m) and the speed that is asked (m/s), linear between samples.

        Args:
            progress: arc length of the line, of any lap, m, shape (n,) or (n, k).
        """
        many = (slice(None),) + (None,) * (progress.ndim - 1)
        lines = self.lines
        length = lines.spacing * (lines.last + 1)
        u = np.mod(progress, length[many]) / lines.spacing[many]
        i = np.minimum(u.astype(np.int64), lines.last[many])
        u -= i
        i += lines.offset[many]
        here, step = lines.samples[i], lines.samples[i + 1] - lines.samples[i]
        curvature, *speeds = np.moveaxis(here + u[..., None] * step, -1, 0)
        speed = self._on_grip(speeds, many) if self._adaptive else speeds[0]
        return curvature, np.minimum(self.share[many] * speed, self.cap[many])

    def _on_grip(self, speeds: Sequence[FloatArray], many: tuple[slice | None, ...]) -> FloatArray:
        """Return the speed for each row's grip, linear between those of `GRIPS`."""
        place = np.clip((GRIPS[0] - self.grip) / (GRIPS[0] - GRIPS[1]), 0.0, len(GRIPS) - 1.0)[many]
        weights = [np.maximum(0.0, 1.0 - np.abs(place - k)) for k in range(len(GRIPS))]
        return np.asarray(sum(weight * speed for weight, speed in zip(weights, speeds, strict=True)))
