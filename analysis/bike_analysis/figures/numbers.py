"""Columns of numbers that may be unknown (NaN): means, rates, shares of time; and lap times as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.tables import Floats


def rms_of(values: NDArray[Any]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def over(function: Any, values: NDArray[Any]) -> float | None:
    """Apply a function to the finite values; None if there are none (the field was not recorded)."""
    finite = values[np.isfinite(values)]
    return float(function(finite)) if len(finite) else None


def rate(values: Floats, time_s: Floats) -> Floats:
    """Change over time by central differences; NaN where there are fewer than two values or time stands still.

    Central differences over two steps, from the previous to the next state.
    The difference to the state before alone would be that of half a step earlier, with twice the noise.
    """
    if len(values) < 2:
        return np.full(len(values), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.asarray(np.gradient(values, time_s), dtype=np.float64)
    found[~np.isfinite(found)] = np.nan
    return found


def best_times(laps: Iterable[Sequence[float | None]]) -> tuple[float | None, ...]:
    """The best time of each sector, s.

    Args:
        laps: Times of the sectors, one row per lap; None where a sector was not completed. Rows are of equal length.

    Returns:
        One entry per sector; None where no lap completed it.
    """
    return tuple(min((t for t in times if t is not None), default=None) for times in zip(*laps, strict=True))


def best_sectors_together(laps: Iterable[Sequence[float | None]]) -> float | None:
    """The sum of the best time of each sector, s: the theoretical best lap.

    Args:
        laps: As in `best_times`.

    Returns:
        The sum of the times as they are, none of them rounded; None unless every sector has a time.
    """
    best = best_times(laps)
    known = [time for time in best if time is not None]
    return float(sum(known)) if known and len(known) == len(best) else None


def lap_text(seconds: float) -> str:
    """Return a lap time as people write it: to the millisecond, with minutes where there are any."""
    minutes, milliseconds = divmod(round(1e3 * seconds), 60_000)  # rounded first: 59.9996 s are a minute
    rest = 1e-3 * milliseconds
    return f"{minutes}:{rest:06.3f}" if minutes else f"{rest:.3f}"


def significant(value: float, digits: int = 4) -> str:
    """Return a figure of unknown size for people: four significant digits, thousands with commas, no exponent."""
    if value == 0.0 or not np.isfinite(value):
        return "0" if value == 0.0 else "–"
    decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{min(decimals, 8)}f}"


def time_shares(values: Floats, time_s: Floats, edges: Sequence[float]) -> tuple[float, ...]:
    """Share of the time that a quantity spent in each bin.

    Args:
        values: One per state; missing ones are left out, those beyond the ends count in the first and the last bin.
        time_s: Of each state, s.
        edges: Of the bins, rising; one more than bins.

    Returns:
        Shares, %, together 100; zeros where nothing is known. A value holds until the next state.
    """
    lasting = np.diff(time_s, append=time_s[-1:])
    known = np.isfinite(values) & (lasting > 0.0)
    if not known.any():
        return (0.0,) * (len(edges) - 1)
    within = np.clip(values[known], edges[0], np.nextafter(edges[-1], -np.inf))
    counts, _ = np.histogram(within, np.asarray(edges), weights=lasting[known])
    return tuple(float(share) for share in 100.0 * counts / counts.sum())
