"""Tables that experiments leave: CSV files, small enough to ship, from which figures are drawn again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Final

import pandas as pd
import yaml

Tables = dict[str, pd.DataFrame]
"""The tables of a paper by their names in its file."""
PaperFile = Mapping[str, Any]
"""Content of a paper's file: tables of its experiments, statements, and published figures."""

_OF_RUN: Final = {"setting": "str", "seed": "int"}
"""Columns of a table about learning runs, which come first."""


def read_paper(name: str) -> PaperFile:
    """Return what is known of a paper: tables of its experiments, statements, and published figures."""
    folder = resources.files("bike_training") / "reproduce"
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    common, found = (
        yaml.load((folder / f"{each}.yaml").read_text(encoding="utf-8"), loader) for each in ("common", name)
    )
    return {**found, "tables": common | found["tables"]}


def table(paper: PaperFile, name: str, rows: Iterable[Any] = ()) -> pd.DataFrame:
    """Return a table of a paper.

    Args:
        paper: from `read_paper`.
        name: of the table.
        rows: values in the order of its columns.
    """
    kinds = _kinds(paper, name)
    return pd.DataFrame(list(rows), columns=list(kinds)).astype(kinds)


def tables(paper: PaperFile, **rows: Iterable[Any]) -> Tables:
    """Return all tables of a paper with some rows, by the names of the tables; the others are empty."""
    return {name: table(paper, name, rows.get(name, ())) for name in paper["tables"]}


def _kinds(paper: PaperFile, name: str) -> dict[str, str]:
    entry = paper["tables"][name]
    own = {column: kind for column, (kind, _) in entry["columns"].items()}
    return {**_OF_RUN, **own} if entry.get("of_run") else own


def select(frame: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """Return the rows whose columns have given values; a list or tuple names several."""
    for name, value in values.items():
        frame = frame[frame[name].isin(value if isinstance(value, list | tuple) else [value])]
    return frame


def write_data(paper: PaperFile, folder: Path, data: Tables) -> None:
    """Write tables into a folder, and replace an old one only when the new one is whole."""
    for name, rows in data.items():
        path = folder / paper["tables"][name]["file"]
        part = path.with_suffix(".part")
        rows.to_csv(part, index=False, float_format="%.6g", na_rep="nan", lineterminator="\r\n")
        part.replace(path)


def read_data(paper: PaperFile, folder: Path, names: Iterable[str] = ()) -> Tables:
    """Read tables of a folder, all where none is named.

    Raises:
        FileNotFoundError: one is missing.
        ValueError: one is another table, or has a value that means nothing.
    """
    found = {}
    for name in names or paper["tables"]:
        kinds, path = _kinds(paper, name), folder / paper["tables"][name]["file"]
        if list(pd.read_csv(path, nrows=0).columns) != list(kinds):
            raise ValueError(f"{path} must have the columns {', '.join(kinds)}")
        try:
            found[name] = pd.read_csv(path, dtype=kinds, keep_default_na=False, na_values="nan")  # type: ignore[arg-type]
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    return found


def last_steps(runs: pd.DataFrame) -> Any:
    """Return the learning step at which each run ended its curriculum, or its last one where it has not."""
    return runs["finished_at"].where(runs["finished_at"] >= 0, runs["steps"]).to_numpy(float)
