"""The two tables of a sweep (docs/reference/sweeps.md), and the figures of its groups of runs.

One row of ``runs.parquet`` is a run, one row of ``curves.parquet`` a point of a curve.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from bike_analysis.sweeps.statistics import Floats, Interval, bootstrap, paired

RUNS_TABLE: Final = "runs.parquet"
CURVES_TABLE: Final = "curves.parquet"

RUN_COLUMNS: Final[Mapping[str, str]] = {
    "run": "string",
    "digest": "string",
    "task": "string",
    "group": "string",
    "seed": "Int64",
    "status": "string",
    "error": "string",
    "seconds": "Float64",
    "cpu_seconds": "Float64",
    "attempts": "Int64",
    "host": "string",
    "commit": "string",
    "started_at": "string",
    "ended_at": "string",
    "entries": "string",
}
"""Columns that every table of runs has, with their kinds in pandas."""
SETTING: Final = "setting_"
"""Beginning of the columns with the entries that differ between runs."""
FIGURE: Final = "figure_"
"""Beginning of the columns with the figures of runs."""
CURVE_COLUMNS: Final[Mapping[str, str]] = {
    "run": "string",
    "group": "string",
    "seed": "Int64",
    "quantity": "string",
    "axis": "string",
    "x": "float64",
    "value": "float64",
}
"""Columns of the table of curves."""


FINISHED: Final = "finished"
"""Status of a run whose figures count."""
MAX_COMPARED_GROUPS: Final = 12
"""Groups up to which every two are compared; of more, each is compared with the first."""
_EFFORT: Final = (
    "steps",
    "updates",
    "best_step",
    "success_step",
    "rides_count",
    "random_rides_count",
    "wanted_laps",
)
"""Figures that say how much was done and not how well."""


def _need_parquet() -> None:
    """Check that there is a reader and writer of Parquet.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
    """
    if find_spec("pyarrow") is None:
        raise ModuleNotFoundError("the tables of a sweep need pyarrow: make setup-sweep", name="pyarrow")


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as Parquet, so that a kill leaves either the file of before or all of the new one.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        OSError: it cannot be written.
    """
    _need_parquet()
    unfinished = path.with_name(f"{path.name}.part")
    try:
        table.to_parquet(unfinished, index=False, compression="zstd")
        unfinished.replace(path)
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno, f"{path} cannot be written ({reason})") from None


def read_tables(folder: str | os.PathLike[str]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the table of runs and the table of curves of a sweep.

    Raises:
        FileNotFoundError: the folder holds no sweep.
        ValueError: a table is damaged, or another file.
        ModuleNotFoundError: pyarrow is not installed.
    """
    _need_parquet()
    place = Path(folder)
    tables = []
    for name, columns in ((RUNS_TABLE, RUN_COLUMNS), (CURVES_TABLE, CURVE_COLUMNS)):
        path = place / name
        if not path.is_file():
            raise FileNotFoundError(f"{place} holds no sweep ({name} is missing); bike sweep writes it")
        try:
            table = pd.read_parquet(path)
        except (OSError, ValueError) as error:
            reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
            raise ValueError(f"{path} cannot be read ({reason[:200]}); it is damaged, or no Parquet file") from None
        missing = sorted(set(columns) - set(table.columns))
        if missing:
            raise ValueError(f"{path} has no column {', '.join(missing)}; it is not a table of bike sweep")
        tables.append(table)
    return tables[0], tables[1]


def finished(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs that have finished."""
    return runs[runs["status"] == FINISHED]


def figure_names(runs: pd.DataFrame) -> list[str]:
    """Return the figures of merit of runs, in the order of the table."""

    def is_result(column: str) -> bool:
        values = runs[column]
        kinds = pd.api.types
        numbers = kinds.is_numeric_dtype(values) and not kinds.is_bool_dtype(values)
        return column.removeprefix(FIGURE) not in _EFFORT and numbers and bool(values.notna().any())

    columns = [name for name in runs.columns if name.startswith(FIGURE)]
    return [name.removeprefix(FIGURE) for name in columns if is_result(name)]


def _values(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the known figures of finished runs, a row each: ``group``, ``seed``, ``figure`` and ``value``."""
    names = {FIGURE + name: name for name in figure_names(runs)}
    rows = finished(runs).rename(columns=names).melt(["group", "seed"], list(names.values()), "figure")
    rows["value"] = pd.to_numeric(rows["value"]).astype("float64")
    return rows[np.isfinite(rows["value"])]


def _known(interval: Interval) -> dict[str, float | None]:
    """Return both ends of an interval, None where one run has none."""
    return {name: end if math.isfinite(end) else None for name, end in (("low", interval.low), ("high", interval.high))}


def group_figures(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the figures of all groups of finished runs: a row for each group and figure, ready for JSON.

    The columns are ``group``, ``figure``, ``runs``, ``mean``, ``iqm`` (interquartile mean) with its interval ``low`` to
    ``high``, ``median``, ``min`` and ``max``.
    """
    found = []
    for (figure, group), rows in _values(runs).groupby(["figure", "group"], sort=False):
        values = rows["value"]
        estimate = bootstrap(values.to_numpy())
        row = {"group": str(group), "figure": str(figure), "runs": len(values), "mean": float(values.mean())}
        row |= {"iqm": estimate.value, **_known(estimate), "median": float(values.median())}
        found.append(row | {"min": float(values.min()), "max": float(values.max())})
    return found


def comparisons(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Compare groups on the seeds that they share: a row for each figure and two groups, ready for JSON.

    The columns are ``figure``, ``first``, ``second``, ``seeds`` (their number), ``difference`` (second minus first)
    with its interval ``low`` to ``high``, and ``share_larger``, the share of seeds with a larger second.
    """
    groups = [str(group) for group in finished(runs)["group"].unique()]
    pairs = list(itertools.combinations(groups, 2))
    if len(groups) > MAX_COMPARED_GROUPS:
        pairs = [(groups[0], other) for other in groups[1:]]
    found = []
    for figure, rows in _values(runs).dropna(subset="seed").groupby("figure", sort=False):
        by_seed = rows.pivot_table("value", "seed", "group", aggfunc="last").reindex(columns=groups)
        for first, second in pairs:
            shared = by_seed[[first, second]].dropna()
            if len(shared) < 2:
                continue
            difference, larger = paired(shared[first].to_numpy(), shared[second].to_numpy())
            row = {"figure": str(figure), "first": first, "second": second, "seeds": len(shared)}
            found.append(row | {"difference": difference.value, **_known(difference), "share_larger": larger})
    return found


def curves_of(curves: pd.DataFrame, quantity: str, group: str, runs: Sequence[str]) -> list[tuple[Floats, Floats]]:
    """Return x and value of a quantity for runs of a group."""
    part = curves[(curves["quantity"] == quantity) & (curves["group"] == group) & curves["run"].isin(runs)]
    rows = (rows.sort_values("x", kind="stable") for _, rows in part.groupby("run", sort=False))
    return [(each["x"].to_numpy(np.float64), each["value"].to_numpy(np.float64)) for each in rows]
