"""What the experiments leave: tables as CSV, small enough to ship, from which figures are drawn again."""

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


@dataclass(frozen=True)
class Instant:
    """An instant of the ride of Figs. 12 and 13.

    Attributes:
        progress: along the path, m. x, y: rear contact, m. front_x, front_y: front contact, m. roll: rad. steer: rad.
        curvature: of the path at the rear contact, 1/m.
    """

    progress: float
    x: float
    y: float
    front_x: float
    front_y: float
    roll: float
    steer: float
    curvature: float


@dataclass(frozen=True)
class Impact:
    """What a feature of an observation does to the set point of the steering angle (Fig. 14).

    Attributes:
        policy: setting, or name of a shipped actor. observation: number. feature: name in the layout.
        value: of the feature, in its unit. shap: share in the set point, rad.
    """

    policy: str
    observation: int
    feature: str
    value: float
    shap: float


@dataclass(frozen=True)
class Direction:
    """A row of Table 8, in degrees.

    Attributes:
        roll, steer: posture. published: direction of the front contact. formula: by Eq. (A.10).
        whipple, pybullet: measured by rolling in an engine.
    """

    roll: float
    steer: float
    published: float
    formula: float
    whipple: float
    pybullet: float


@dataclass(frozen=True)
class SteeringStep:
    """An instant of the step response of Fig. 16.

    Attributes:
        time: s. whipple, pybullet: steering angle in an engine, deg.
    """

    time: float
    whipple: float
    pybullet: float


@dataclass(frozen=True)
class Chance:
    """How often learning meets a full circle (Sect. 6).

    Attributes:
        paths: drawn from part 4. length: least length of each, m. circles: paths with five bends in a row to one side.
    """

    paths: int
    length: float
    circles: int


Row = TypeVar("Row", Run, Validation, Rides, Track, Instant, Impact, Direction, SteeringStep, Chance)


@dataclass(frozen=True)
class Data:
    """All tables."""

    runs: tuple[Run, ...] = ()
    validations: tuple[Validation, ...] = ()
    rides: tuple[Rides, ...] = ()
    tracks: tuple[Track, ...] = ()
    ride: tuple[Instant, ...] = ()
    impacts: tuple[Impact, ...] = ()
    directions: tuple[Direction, ...] = ()
    steering: tuple[SteeringStep, ...] = ()
    chances: tuple[Chance, ...] = ()


FILES: Final[dict[str, tuple[str, Any]]] = {
    "runs": ("runs.csv", Run),
    "validations": ("validations.csv", Validation),
    "rides": ("rides.csv", Rides),
    "tracks": ("junction.csv", Track),
    "ride": ("ride.csv", Instant),
    "impacts": ("impacts.csv", Impact),
    "directions": ("table8.csv", Direction),
    "steering": ("steering_step.csv", SteeringStep),
    "chances": ("full_circles.csv", Chance),
}
"""File and kind of row of each table of `Data`."""


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
    for table, (name, kind) in FILES.items():
        write_rows(folder / name, kind, getattr(data, table))


def read_data(folder: Path) -> Data:
    """Read all tables of a folder.

    Raises:
        FileNotFoundError: one is missing. ValueError: one is of another kind.
    """
    return Data(**{table: read_rows(folder / name, kind) for table, (name, kind) in FILES.items()})
