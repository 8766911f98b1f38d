"""The two tables of a sweep: one row a run, and one row a point of a curve. Documented in docs/reference/sweeps.md."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import pandas as pd

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


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as Parquet, so that a kill leaves either the file of before or all of the new one.

    Raises:
        ModuleNotFoundError: pyarrow is not installed. OSError: it cannot be written.
    """
    if find_spec("pyarrow") is None:
        raise ModuleNotFoundError("the tables of a sweep need pyarrow: make setup-sweep", name="pyarrow")
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
        FileNotFoundError: the folder holds no sweep. ValueError: a table is damaged, or another file.
        ModuleNotFoundError: pyarrow is not installed.
    """
    if find_spec("pyarrow") is None:
        raise ModuleNotFoundError("the tables of a sweep need pyarrow: make setup-sweep", name="pyarrow")
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
