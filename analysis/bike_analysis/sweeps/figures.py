"""Figures of a sweep: one line for each group and figure, and comparisons of groups that share seeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, Final, TypedDict

import numpy as np
import pandas as pd

from bike_analysis.sweeps.statistics import Floats, bootstrap, paired
from bike_analysis.sweeps.tables import FIGURE

MOST_COMPARED: Final = 12
"""Groups up to which every two are compared; of more, each is compared with the first."""
LARGER_IS_BETTER: Final = ("part", "completed_count", "random_completed_count", "valid_laps", "laps")
"""Figures of which more is better; of all others less is."""
_NO_RESULT: Final = (
    "steps",
    "updates",
    "best_step",
    "success_step",
    "rides_count",
    "random_rides_count",
    "wanted_laps",
)
"""Figures that say how much was done and not how well."""


class GroupFigure(TypedDict):
    """A figure of a group of runs; interval of the interquartile mean."""

    group: str
    figure: str
    runs: int
    mean: float
    iqm: float
    low: float | None
    high: float | None
    median: float
    min: float
    max: float


class Comparison(TypedDict):
    """Two groups on the seeds that both have; difference is second minus first."""

    figure: str
    first: str
    second: str
    seeds: int
    difference: float
    low: float | None
    high: float | None
    share_larger: float


def figure_names(runs: pd.DataFrame) -> list[str]:
    """Return the figures that tell how good runs are, in the order of the table."""
    names = [name.removeprefix(FIGURE) for name in runs.columns if name.startswith(FIGURE)]
    return [
        name
        for name in names
        if name not in _NO_RESULT
        and pd.api.types.is_numeric_dtype(runs[FIGURE + name])
        and not pd.api.types.is_bool_dtype(runs[FIGURE + name])
        and runs[FIGURE + name].notna().any()
    ]


def finished(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that have finished."""
    return runs[runs["status"] == "finished"]


def values_of(runs: pd.DataFrame, figure: str) -> Floats:
    """Return the known values of a figure."""
    values = pd.to_numeric(runs[FIGURE + figure]).to_numpy(dtype=np.float64, na_value=np.nan)
    known: Floats = values[np.isfinite(values)]
    return known


def group_figures(runs: pd.DataFrame) -> list[GroupFigure]:
    """Return the figures of all groups of finished runs."""
    found: list[GroupFigure] = []
    for figure in figure_names(runs):
        for group, members in finished(runs).groupby("group", sort=False):
            values = values_of(members, figure)
            if not len(values):
                continue
            estimate = bootstrap(values)
            found.append(
                {
                    "group": str(group),
                    "figure": figure,
                    "runs": len(values),
                    "mean": float(values.mean()),
                    "iqm": estimate.value,
                    "low": _known(estimate.low),
                    "high": _known(estimate.high),
                    "median": float(np.median(values)),
                    "min": float(values.min()),
                    "max": float(values.max()),
                }
            )
    return found


def comparisons(runs: pd.DataFrame) -> list[Comparison]:
    """Compare groups on the seeds that they share."""
    done = finished(runs)
    groups = [str(group) for group in done["group"].unique()]
    pairs = list(itertools.combinations(groups, 2))
    if len(groups) > MOST_COMPARED:
        pairs = [(groups[0], other) for other in groups[1:]]
    found: list[Comparison] = []
    for figure in figure_names(runs):
        by_seed = {group: _by_seed(done[done["group"] == group], figure) for group in groups}
        for first, second in pairs:
            shared = sorted(by_seed[first].keys() & by_seed[second].keys())
            if len(shared) < 2:
                continue
            difference, larger = paired(
                np.array([by_seed[first][seed] for seed in shared]),
                np.array([by_seed[second][seed] for seed in shared]),
            )
            found.append(
                {
                    "figure": figure,
                    "first": first,
                    "second": second,
                    "seeds": len(shared),
                    "difference": difference.value,
                    "low": _known(difference.low),
                    "high": _known(difference.high),
                    "share_larger": larger,
                }
            )
    return found


def curves_of(curves: pd.DataFrame, quantity: str, group: str, runs: Sequence[str]) -> list[tuple[Floats, Floats]]:
    """Return x and value of a quantity for runs of a group."""
    part = curves[(curves["quantity"] == quantity) & (curves["group"] == group) & curves["run"].isin(runs)]
    found = []
    for _, rows in part.groupby("run", sort=False):
        ordered = rows.sort_values("x", kind="stable")
        found.append((ordered["x"].to_numpy(np.float64), ordered["value"].to_numpy(np.float64)))
    return found


def _by_seed(runs: pd.DataFrame, figure: str) -> dict[int, float]:
    values: dict[int, float] = {}
    for seed, value in zip(runs["seed"], runs[FIGURE + figure], strict=True):
        if not pd.isna(seed) and not pd.isna(value) and math.isfinite(float(value)):
            values[int(seed)] = float(value)
    return values


def _known(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None
