"""The aligned table in files for other programs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import pandas as pd

from bike_analysis.figures.compare import Comparison


def aligned_table(comparisons: Sequence[Comparison]) -> pd.DataFrame:
    """Put comparisons on several courses into one table.

    Args:
        comparisons: At least one.

    Returns:
        The rows of `Comparison.table`, with the name of the ``course`` in front.
    """
    parts = []
    for comparison in comparisons:
        part = comparison.table.copy(deep=False)
        part.insert(0, "course", comparison.course)
        parts.append(part)
    return parts[0] if len(parts) == 1 else pd.concat(parts, ignore_index=True)


def write_csv(table: pd.DataFrame, path: str | os.PathLike[str]) -> Path:
    """Write a table as CSV: a line of names, commas, points, ten digits; empty where a value is not known.

    Raises:
        OSError: If the file cannot be written.
    """
    target = _target(path)
    table.to_csv(target, index=False, float_format="%.10g", errors="backslashreplace")
    return target


def write_parquet(table: pd.DataFrame, path: str | os.PathLike[str]) -> Path:
    """Write a table as Parquet, in full precision.

    Raises:
        ModuleNotFoundError: If pyarrow is not installed.
        OSError: If the file cannot be written.
    """
    if find_spec("pyarrow") is None:
        raise ModuleNotFoundError("Parquet files need pyarrow: pip install pyarrow", name="pyarrow")
    target = _target(path)
    table.to_parquet(target, index=False, compression="zstd")
    return target


def _target(path: str | os.PathLike[str]) -> Path:
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    return target
