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
_COMMON: Final[Mapping[str, Any]] = {
    "runs": {
        "file": "runs.csv",
        "of_run": True,
        "columns": {
            "status": ["str", "as in a sweep."],
            "steps": ["int", "learning steps made."],
            "finished_at": ["int", "learning step at which the curriculum ended; -1 where it has not."],
            "cpu_seconds": ["float", "processor time of its last attempt, s; -1 where it has not ended."],
        },
    },
    "validations": {
        "file": "validations.csv",
        "of_run": True,
        "columns": {
            "step": ["int", "learning step."],
            "part": ["int", "of the curriculum."],
            "error": ["float", "mean of its errors, as the paper defines them."],
        },
    },
}
"""Tables that every paper has."""


def read_paper(name: str) -> PaperFile:
    """Return what is known of a paper: tables of its experiments, statements, and published figures."""
    file = resources.files("bike_training") / "reproduce" / f"{name}.yaml"
    found = yaml.load(file.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    return {**found, "tables": _COMMON | found["tables"]}


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


def file_of(paper: PaperFile, name: str, folder: Path) -> Path:
    """Return the file of a table in a folder."""
    return folder / str(paper["tables"][name]["file"])


def write_table(paper: PaperFile, name: str, folder: Path, rows: pd.DataFrame) -> None:
    """Write a table, and replace an old one only when it is whole."""
    path = file_of(paper, name, folder)
    part = path.with_suffix(".part")
    rows.to_csv(part, index=False, float_format="%.6g", na_rep="nan", lineterminator="\r\n")
    part.replace(path)


def read_table(paper: PaperFile, name: str, folder: Path) -> pd.DataFrame:
    """Read a table.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is another table, or has a value that means nothing.
    """
    kinds, path = _kinds(paper, name), file_of(paper, name, folder)
    if list(pd.read_csv(path, nrows=0).columns) != list(kinds):
        raise ValueError(f"{path} must have the columns {', '.join(kinds)}")
    try:
        return pd.read_csv(path, dtype=kinds, keep_default_na=False, na_values="nan")  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def write_data(paper: PaperFile, folder: Path, data: Tables) -> None:
    """Write all tables into a folder."""
    for name, rows in data.items():
        write_table(paper, name, folder, rows)


def read_data(paper: PaperFile, folder: Path) -> Tables:
    """Read all tables of a folder.

    Raises:
        FileNotFoundError: one is missing.
        ValueError: one is of another kind.
    """
    return {name: read_table(paper, name, folder) for name in paper["tables"]}


def last_steps(runs: pd.DataFrame) -> Any:
    """Return the learning step at which each run ended its curriculum, or its last one where it has not."""
    return runs["finished_at"].where(runs["finished_at"] >= 0, runs["steps"]).to_numpy(float)
