"""Figures of repeated runs: interquartile means, bootstrap intervals, paired comparisons.

Source: Agarwal, Schwarzer, Castro, Courville, Bellemare, Deep Reinforcement Learning at the Edge of the Statistical
Precipice, NeurIPS 2021. All take plain arrays; draws come from a fixed seed, so the same runs give the same figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Statistic = Callable[[Floats], Floats]
"""Reduces the last axis."""

LEVEL: Final = 0.95
"""Share of the intervals."""
DRAWS: Final = 10_000
"""Bootstrap samples: the ends of an interval then move by less than two percent of its width from seed to seed."""
SEED: Final = 2021


class Interval(NamedTuple):
    """A figure with its bootstrap interval."""

    value: float
    low: float
    high: float


def interquartile_mean(values: Floats) -> Floats:
    """Return the mean of the middle half of values along the last axis.

    Of a number of values that four does not divide, those at the quartiles count with the share that lies inside.
    """
    ordered = np.sort(values, axis=-1)
    count = ordered.shape[-1]
    edges = np.arange(count + 1) / count
    weights = np.clip(np.minimum(edges[1:], 0.75) - np.maximum(edges[:-1], 0.25), 0.0, None)
    result: Floats = (ordered * weights).sum(axis=-1) / weights.sum()
    return result


def bootstrap(
    values: Sequence[float] | Floats, statistic: Statistic = interquartile_mean, seed: int = SEED
) -> Interval:
    """Return a statistic of runs and its percentile bootstrap interval.

    Args:
        values: one value a run, finite.
        statistic: estimated quantity.
        seed: of the draws.

    Raises:
        ValueError: there are no values, or one is not finite.
    """
    sample = _finite(values)
    if len(sample) == 1:
        return Interval(float(sample[0]), float("nan"), float("nan"))
    drawn = statistic(sample[_draw(len(sample), seed)])
    low, high = np.quantile(drawn, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2])
    return Interval(float(statistic(sample)), float(low), float(high))


def paired(first: Floats, second: Floats) -> tuple[Interval, float]:
    """Compare two groups of runs that share seeds.

    Args:
        first: one value a seed.
        second: the same seeds in the same order.

    Returns:
        Interquartile mean of second - first with its interval, and the share of seeds with a larger second.

    Raises:
        ValueError: they are not of the same length, or there is no seed.
    """
    if len(first) != len(second):
        raise ValueError(f"pairs need the same seeds on both sides, got {len(first)} and {len(second)}")
    difference = _finite(np.asarray(second) - np.asarray(first))
    wins = np.mean(difference > 0.0) + 0.5 * np.mean(difference == 0.0)
    return bootstrap(difference), float(wins)


class Band(NamedTuple):
    """A mean curve of several runs with its interval at each place; all of shape (n,)."""

    x: Floats
    value: Floats
    low: Floats
    high: Floats


def band(curves: Sequence[tuple[Floats, Floats]], points: int = 200) -> Band | None:
    """Return the interquartile mean over runs of curves that are known at places of their own, and its interval.

    Between two places a curve keeps its last value; before its first and after its last place it is not known, and the
    band covers the stretch on which all are.

    Args:
        curves: x (rising) and value of each run.
        points: places of the band.

    Returns:
        The band, or None where the curves have no stretch in common.
    """
    known = [(x, value) for x, value in curves if len(x)]
    if not known:
        return None
    first, last = max(x[0] for x, _ in known), min(x[-1] for x, _ in known)
    if not first <= last:
        return None
    grid = np.linspace(first, last, points if last > first else 1)
    held = np.stack([value[np.searchsorted(x, grid, side="right") - 1] for x, value in known])
    if len(known) == 1:
        return Band(grid, held[0], held[0], held[0])
    drawn = interquartile_mean(held.T[:, _draw(len(known), SEED, 1000)])
    low, high = np.quantile(drawn, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2], axis=1)
    return Band(grid, interquartile_mean(held.T), low, high)


def _draw(count: int, seed: int, draws: int = DRAWS) -> NDArray[Any]:
    """Return places in a sample, drawn with replacement, shape (draws, count)."""
    return np.random.default_rng(seed).integers(0, count, (draws, count))


def _finite(values: Sequence[float] | Floats) -> Floats:
    sample = np.asarray(values, dtype=np.float64)
    if not len(sample) or not np.isfinite(sample).all():
        raise ValueError(f"a bootstrap needs finite values, got {sample.tolist()[:10]}")
    return sample
