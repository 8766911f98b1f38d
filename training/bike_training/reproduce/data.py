"""What the experiments leave: four tables as CSV, small enough to ship, from which figures are drawn again."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, TypeVar, get_type_hints


@dataclass(frozen=True)
class Run:
    """A learning run.

    Attributes:
        setting: name in Table 5. seed: of the run. status: as in a sweep. steps: learning steps made.
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
        error: mean of its errors e_i (Eq. 12).
    """

    setting: str
    seed: int
    step: int
    part: int
    error: float


@dataclass(frozen=True)
class Rides:
    """A ride of a controller.

    Attributes:
        setting, seed: of its run. course: ``benchmark`` or ``random``. speed: m/s. completed: it came to its end.
        mean: mean distance of the rear contact, m. largest: m.
    """

    setting: str
    seed: int
    course: str
    speed: float
    completed: bool
    mean: float
    largest: float


@dataclass(frozen=True)
class Track:
    """An instant of a ride on the junction.

    Attributes:
        rider: controller or classical rider. time: s. x, y: rear contact, m. front_x, front_y: front contact, m.
        rear_error, front_error: their lateral errors, m. completed: whether the ride came to its end.
    """

    rider: str
    time: float
    x: float
    y: float
    front_x: float
    front_y: float
    rear_error: float
    front_error: float
    completed: bool


Row = TypeVar("Row", Run, Validation, Rides, Track)


@dataclass(frozen=True)
class Data:
    """All tables."""

    runs: tuple[Run, ...]
    validations: tuple[Validation, ...]
    rides: tuple[Rides, ...]
    tracks: tuple[Track, ...]


FILES: Final[dict[str, type]] = {
    "runs.csv": Run,
    "validations.csv": Validation,
    "rides.csv": Rides,
    "junction.csv": Track,
}


def write_rows(path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Write a table, and replace an old one only when it is whole."""
    names = [spec.name for spec in fields(kind)]
    part = path.with_suffix(".part")
    with part.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(names)
        for row in rows:
            values = (getattr(row, name) for name in names)
            table.writerow([f"{value:.6g}" if isinstance(value, float) else value for value in values])
    part.replace(path)


def read_rows(path: Path, kind: type[Row]) -> tuple[Row, ...]:
    """Read a table.

    Raises:
        FileNotFoundError: there is none. ValueError: it is another table, or has a value that means nothing.
    """
    kinds = get_type_hints(kind)
    with path.open(newline="", encoding="utf-8") as file:
        table = csv.DictReader(file)
        if list(table.fieldnames or ()) != list(kinds):
            raise ValueError(f"{path} must have the columns {', '.join(kinds)}")
        return tuple(kind(**{name: _value(record[name], kinds[name], path) for name in kinds}) for record in table)


def _value(text: str, kind: type, path: Path) -> Any:
    if kind is bool:
        if text not in ("True", "False"):
            raise ValueError(f"{path}: {text!r} is neither True nor False")
        return text == "True"
    return kind(text)


def write_data(folder: Path, data: Data) -> None:
    """Write all tables into a folder."""
    write_rows(folder / "runs.csv", Run, data.runs)
    write_rows(folder / "validations.csv", Validation, data.validations)
    write_rows(folder / "rides.csv", Rides, data.rides)
    write_rows(folder / "junction.csv", Track, data.tracks)


def read_data(folder: Path) -> Data:
    """Read all tables of a folder.

    Raises:
        FileNotFoundError: one is missing. ValueError: one is of another kind.
    """
    return Data(
        read_rows(folder / "runs.csv", Run),
        read_rows(folder / "validations.csv", Validation),
        read_rows(folder / "rides.csv", Rides),
        read_rows(folder / "junction.csv", Track),
    )
