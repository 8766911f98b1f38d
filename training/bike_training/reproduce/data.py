"""What experiments leave: tables as CSV, small enough to ship, from which figures are drawn again."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

_FILE, _KIND = "file", "kind"


def table(file: str, kind: type[Any]) -> Any:
    """Return an attribute of `Tables`: the rows of a file, of one kind."""
    return field(default=(), metadata={_FILE: file, _KIND: kind})


@dataclass(frozen=True)
class Run:
    """A learning run.

    Attributes:
        setting: its name. seed: of the run. status: as in a sweep. steps: learning steps made.
        finished_at: learning step at which the curriculum ended; -1 where it has not.
        cpu_seconds: processor time of its last attempt, s; -1 where it has not ended.
    """

    setting: str
    seed: int
    status: str
    steps: int
    finished_at: int
    cpu_seconds: float


@dataclass(frozen=True)
class Validation:
    """A validation of a run.

    Attributes:
        setting, seed: of the run. step: learning step. part: of the curriculum.
        error: mean of its errors, as the paper defines them.
    """

    setting: str
    seed: int
    step: int
    part: int
    error: float


@dataclass(frozen=True)
class Tables:
    """The tables of every paper; those of one paper add their own with `table`."""

    runs: tuple[Run, ...] = table("runs.csv", Run)
    validations: tuple[Validation, ...] = table("validations.csv", Validation)


Row = TypeVar("Row")
Data = TypeVar("Data", bound=Tables)


def kind_of(tables: type[Tables], name: str) -> type[Any]:
    """Return the kind of row of a table."""
    kind: type[Any] = next(spec for spec in fields(tables) if spec.name == name).metadata[_KIND]
    return kind


def file_of(tables: type[Tables], name: str) -> str:
    """Return the name of the file of a table."""
    return str(next(spec for spec in fields(tables) if spec.name == name).metadata[_FILE])


def write_rows(path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Write a table, and replace an old one only when it is whole."""
    names = list(get_type_hints(kind))
    part = path.with_suffix(".part")
    with part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in rows:
            values = (getattr(row, name) for name in names)
            writer.writerow([f"{value:.6g}" if isinstance(value, float) else value for value in values])
    part.replace(path)


def read_rows(path: Path, kind: type[Row]) -> tuple[Row, ...]:
    """Read a table.

    Raises:
        FileNotFoundError: there is none. ValueError: it is another table, or has a value that means nothing.
    """
    kinds = get_type_hints(kind)
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if list(reader.fieldnames or ()) != list(kinds):
            raise ValueError(f"{path} must have the columns {', '.join(kinds)}")
        return tuple(kind(**{name: _value(record[name], kinds[name], path) for name in kinds}) for record in reader)


def _value(text: str, kind: type, path: Path) -> Any:
    if kind is bool:
        if text not in ("True", "False"):
            raise ValueError(f"{path}: {text!r} is neither True nor False")
        return text == "True"
    return kind(text)


def write_data(folder: Path, data: Tables) -> None:
    """Write all tables into a folder."""
    for spec in fields(data):
        write_rows(folder / spec.metadata[_FILE], spec.metadata[_KIND], getattr(data, spec.name))


def read_data(folder: Path, kind: type[Data]) -> Data:
    """Read all tables of a folder.

    Raises:
        FileNotFoundError: one is missing. ValueError: one is of another kind.
    """
    found = {spec.name: read_rows(folder / spec.metadata[_FILE], spec.metadata[_KIND]) for spec in fields(kind)}
    return kind(**found)
