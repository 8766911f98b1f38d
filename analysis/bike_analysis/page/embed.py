"""Columns of numbers inside a page: small enough for an hour at 100 Hz, exact to a stated quantum.

A column becomes integer multiples of its quantum. Differences from row to row are small, so they are zigzag coded
(sign in the lowest bit), split into four planes of bytes, deflated and written in base64. ``page_data.js`` undoes this.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MISSING: Final = -(2**31)
"""Multiple that stands for NaN."""
_LARGEST: Final = 2**30


def embed(values: NDArray[Any], quantum: float) -> dict[str, Any]:
    """Pack a column.

    Args:
        values: Numbers; NaN and infinity become NaN.
        quantum: What the numbers are rounded to; made coarser where they would not fit 31 bits.

    Returns:
        ``rows``, ``quantum`` and ``data``, ready for JSON.

    Raises:
        ValueError: If the quantum is not positive.
    """
    if not quantum > 0.0:
        raise ValueError(f"the quantum of a column must be positive, got {quantum!r}")
    column = np.asarray(values, dtype=np.float64)
    known = np.isfinite(column)
    largest = float(np.abs(column[known]).max(initial=0.0))
    quantum = max(quantum, largest / _LARGEST)
    multiples = np.where(known, np.rint(np.where(known, column, 0.0) / quantum), MISSING).astype(np.int64)
    steps = np.diff(multiples, prepend=0).astype(np.int32)  # differences wrap, and so do the sums that undo them
    zigzag = ((steps << 1) ^ (steps >> 31)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()
    return {
        "rows": len(column),
        "quantum": quantum,
        "data": base64.b64encode(zlib.compress(planes, 6)).decode("ascii"),
    }
