"""Tables of lines for rows of vehicles: one array for compiled and vectorised look-ups, whatever lines are ridden."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
LineT = TypeVar("LineT")

KEPT: Final = 64
"""Lines that are kept: a training on three circuits with 21 lines each plans each of them once.

There are more tables where more rows ride on lines of their own."""


class LineTables(Generic[LineT]):
    """Tables one behind another; rows on the same line share one, and lines not ridden for the longest go.

    Attributes:
        samples: of all tables, shape (m, columns). offset: first sample of each row's table.
        last: number of its intervals less one. spacing: of its samples, m.
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
