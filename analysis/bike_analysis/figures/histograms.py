"""How often a quantity had which value, by time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bike_analysis.read.tables import Floats


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
