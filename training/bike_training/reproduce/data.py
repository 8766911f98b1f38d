"""Tables that experiments leave: CSV files, small enough to ship, from which figures are drawn again."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, make_dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, Final, TypeVar, get_type_hints

import yaml

_FILE, _KIND = "file", "kind"
_COLUMNS: Final[Mapping[str, type]] = {"str": str, "int": int, "float": float, "bool": bool}


def read_paper(name: str) -> dict[str, Any]:
    """Return what is known of a paper: tables of its experiments, statements, and published figures."""
    file = resources.files("bike_training") / "reproduce" / f"{name}.yaml"
    found: dict[str, Any] = yaml.load(file.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    return found


def table(file: str, kind: type[Any]) -> Any:
    """Return an attribute of `Tables`: the rows of a file, of one kind."""
    return field(default=(), metadata={_FILE: file, _KIND: kind})


@dataclass(frozen=True)
class RunRow:
    """A row about a learning run.

    Attributes:
        setting: name of its setting.
        seed: of the run.
    """

    setting: str
    seed: int


@dataclass(frozen=True)
class Run(RunRow):
    """A learning run.

    Attributes:
        status: as in a sweep.
        steps: learning steps made.
        finished_at: learning step at which the curriculum ended; -1 where it has not.
        cpu_seconds: processor time of its last attempt, s; -1 where it has not ended.
    """

    status: str
    steps: int
    finished_at: int
    cpu_seconds: float


@dataclass(frozen=True)
class Validation(RunRow):
    """A validation of a run.

    Attributes:
        step: learning step.
        part: of the curriculum.
        error: mean of its errors, as the paper defines them.
    """

    step: int
    part: int
    error: float


@dataclass(frozen=True)
class Tables:
    """The tables of every paper; `tables_of` adds those of one."""

    runs: tuple[Run, ...] = table("runs.csv", Run)
    validations: tuple[Validation, ...] = table("validations.csv", Validation)

    def with_rows(self, **tables: tuple[Any, ...]) -> Tables:
        """Return the tables with others in the place of some, by their names."""
        return replace(self, **tables)

    def __getattr__(self, name: str) -> Any:
        """Refuse a table that the paper does not have.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(f"no table {name!r}")


def tables_of(paper: Mapping[str, Any]) -> type[Tables]:
    """Return the kind of the tables of a paper, whose rows are records.

    Args:
        paper: from `read_paper`.
    """
    found = []
    for name, entry in paper["tables"].items():
        columns = [(column, _COLUMNS[kind]) for column, (kind, _) in entry["columns"].items()]
        kind = make_dataclass(entry["row"], columns, bases=(RunRow,) if entry.get("of_run") else (), frozen=True)
        found.append((name, tuple[kind, ...], table(entry["file"], kind)))  # type: ignore[valid-type]
    return make_dataclass("Data", found, bases=(Tables,), frozen=True)


def row_kinds(tables: type[Tables]) -> tuple[Any, ...]:
    """Return the kinds of the rows of a paper's own tables, in their order."""
    return tuple(spec.metadata[_KIND] for spec in fields(tables)[len(fields(Tables)) :])


Row = TypeVar("Row")


def table_of(tables: type[Tables], name: str) -> tuple[str, type[Any]]:
    """Return the file of a table, and the kind of its rows."""
    metadata = next(spec for spec in fields(tables) if spec.name == name).metadata
    return metadata[_FILE], metadata[_KIND]


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
        FileNotFoundError: there is none.
        ValueError: it is another table, or has a value that means nothing.
    """
    kinds = get_type_hints(kind)

    def value_of(text: str, kind: type) -> Any:
        if kind is bool and text not in ("True", "False"):
            raise ValueError(f"{path}: {text!r} is neither True nor False")
        return text == "True" if kind is bool else kind(text)

    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if list(reader.fieldnames or ()) != list(kinds):
            raise ValueError(f"{path} must have the columns {', '.join(kinds)}")
        return tuple(kind(**{name: value_of(record[name], kinds[name]) for name in kinds}) for record in reader)


def write_data(folder: Path, data: Tables) -> None:
    """Write all tables into a folder."""
    for spec in fields(data):
        write_rows(folder / spec.metadata[_FILE], spec.metadata[_KIND], getattr(data, spec.name))


def read_data(folder: Path, kind: type[Tables]) -> Tables:
    """Read all tables of a folder.

    Raises:
        FileNotFoundError: one is missing.
        ValueError: one is of another kind.
    """
    found = {spec.name: read_rows(folder / spec.metadata[_FILE], spec.metadata[_KIND]) for spec in fields(kind)}
    return kind(**found)
