"""Small things about columns of numbers that may be unknown (NaN)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def rms_of(values: NDArray[Any]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def over(function: Any, values: NDArray[Any]) -> float | None:
    """Apply a function to the finite values; None if there are none (the field was not recorded)."""
    finite = values[np.isfinite(values)]
    return float(function(finite)) if len(finite) else None


def rate(values: Floats, time_s: Floats) -> Floats:
    """Change over time by central differences; NaN where there are fewer than two values or time stands still."""
    if len(values) < 2:
        return np.full(len(values), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.asarray(np.gradient(values, time_s), dtype=np.float64)
    found[~np.isfinite(found)] = np.nan
    return found
