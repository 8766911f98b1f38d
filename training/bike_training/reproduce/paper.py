"""What a paper's experiments are: all that `bike reproduce` needs to know of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from bike_training.reproduce.data import Data
from bike_training.reproduce.experiment import Experiment
from bike_training.reproduce.statement import Statement

Kind = TypeVar("Kind", bound=Experiment)

Advance = Callable[[], None]
Rows = Mapping[str, Sequence[Any]]
"""Rows by the name of their table."""


@dataclass(frozen=True)
class Paper(Generic[Kind, Data]):
    """A paper.

    Attributes:
        name: for the command line. source: who wrote it, and what of it is done.
        experiment: what is done by default. quick: what tries the whole way in seconds, and learns nothing.
        tables: kinds of rows that it leaves.
        error: column of ``validations.csv`` of a run that holds the error of a validation. unit: of that error.
        ridden: tables that the rides of a run fill; kept in its folder.
        rides: rides of a run, for a progress bar.
        ride: ride what a run in a folder has learned; None where it has nothing to ride.
        look_closely: add what needs all runs: the folders of those that rode, by setting and seed.
        choose: of several places, take what `look_closely` has added from those that have the chosen ones of all runs;
            it is given the tables of all runs, and those of each place.
        statements: what it says. figures: what draws each, by file. written: tables as Markdown, by heading.
        counts: what the command tells of the rides, by name.
    """

    name: str
    source: str
    experiment: Kind
    quick: Kind
    tables: type[Data]
    error: str
    unit: float
    ridden: tuple[str, ...]
    rides: Callable[[Kind], int]
    ride: Callable[[Path, str, int, Kind, Advance], Rows | None]
    look_closely: Callable[[Data, Mapping[tuple[str, int], Path], Kind], Data]
    choose: Callable[[Data, Sequence[Data]], Data]
    statements: Sequence[Statement]
    figures: Mapping[str, Callable[[Data, Any], Any]]
    written: Mapping[str, Callable[[Data], str]]
    counts: Callable[[Data], Mapping[str, int]]
