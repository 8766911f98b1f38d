"""Arrays of courses that the rows of a batch share."""

from __future__ import annotations

import numpy as np
from numba.typed import List
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Places:
    """Arrays that rows share by place: at most one place a row, and each array stands in one place only.

    Attributes:
        arrays: by place, for compiled loops.
    """

    def __init__(self, count: int, blank: FloatArray) -> None:
        """Make room for a number of rows; free places hold a blank array."""
        self.arrays = List([blank] * count)
        self._blank = blank
        self._held: list[FloatArray | None] = [None] * count
        self._place = [0] * count

    def put(self, row: int, array: FloatArray) -> int:
        """Return the place of an array that a row uses from now on; one that another row uses is not stored again."""
        before = self._place[row]
        self._held[row] = None
        users = {self._place[other]: held for other, held in enumerate(self._held) if held is not None}
        place = next((place for place, held in users.items() if held is array), None)
        if place is None:
            place = next(free for free in range(len(self._held)) if free not in users)
            self.arrays[place] = array
        if before not in users and before != place:
            self.arrays[before] = self._blank  # nobody rides there any more
        self._held[row], self._place[row] = array, place
        return place
