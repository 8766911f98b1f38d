"""A paper's experiments: a sweep, the rides of its runs, and tables, verdicts and figures made of them."""

from __future__ import annotations

import csv
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import matplotlib as mpl
import pandas as pd

from bike_training.progress import progress_bar
from bike_training.reproduce.data import PaperFile, Tables, read_data, table, tables, write_data
from bike_training.reproduce.statement import Statement
from bike_training.sweeps.runs import Plan, PlannedRun, read_record
from bike_training.sweeps.spec import Sweep, sweep_from_document


@dataclass(frozen=True, kw_only=True)
class Experiment(ABC):
    """Settings of an experiment.

    Attributes:
        title: name of the sweep.
        settings: names of those that are learned.
        seeds: of the runs of each setting.
        steps: most learning steps of a run.
    """

    title: str
    settings: tuple[str, ...]
    seeds: tuple[int, ...] = tuple(range(5))
    steps: int

    @abstractmethod
    def base(self) -> dict[str, Any]:
        """Return the entries of every run, in a sweep."""

    @abstractmethod
    def entries(self, setting: str) -> dict[str, Any]:
        """Return the entries of the runs of a setting."""

    def named(self) -> list[tuple[str, int]]:
        """Return setting and seed of every run, one seed of all settings first: what is interrupted shows them all."""
        return [(name, seed) for seed in self.seeds for name in self.settings]

    def document(self) -> dict[str, Any]:
        """Return the file of the sweep that learns it all; its runs are in the order of `named`."""
        runs = [self.entries(name) | {"seed": seed} for name, seed in self.named()]
        return {"name": self.title, "task": "train", "base": self.base(), "runs": runs}

    def sweep(self) -> Sweep:
        """Return the sweep."""
        return sweep_from_document(self.document(), self.title)


Kind = TypeVar("Kind", bound=Experiment)

Advance = Callable[[], None]
Rows = Mapping[str, Sequence[Any]]
"""Rows by the name of their table."""


@dataclass(frozen=True)
class Paper(Generic[Kind]):
    """All that `bike reproduce` needs of a paper.

    Attributes:
        name: for the command line.
        file: its tables and published values.
        experiment: the default one.
        quick: an experiment that tries the whole way in seconds, and learns nothing.
        error: column of ``validations.csv`` of a run that holds the error of a validation.
        unit: of that error.
        ridden: tables that the rides of a run fill; kept in its folder.
        rides: returns the number of rides of a run, for a progress bar.
        ride: rides what a run in a folder has learned; returns None where it has nothing to ride.
        add_details: adds what needs all runs: the folders of those that rode, by setting and seed.
        statements: of the paper.
        figures: functions that draw, by file.
        written: functions that write a table as Markdown, by heading.
        counts: returns the numbers of rides that the command prints, by name.
    """

    name: str
    file: PaperFile
    experiment: Kind
    quick: Kind
    error: str
    unit: float
    ridden: tuple[str, ...]
    rides: Callable[[Kind], int]
    ride: Callable[[Path, str, int, Kind, Advance], Rows | None]
    add_details: Callable[[Tables, Mapping[tuple[str, int], Path], Kind], Tables]
    statements: Sequence[Statement]
    figures: Mapping[str, Callable[[Tables, Any], Any]]
    written: Mapping[str, Callable[[Tables], str]]
    counts: Callable[[Tables], Mapping[str, int]]


@contextmanager
def learned(folder: Path) -> Iterator[Mapping[str, Any] | None]:
    """Open what a run has learned so far: the progress of its checkpoint, None where it has none."""
    from bike_training.learning.checkpoint import Checkpoint, find_checkpoint  # late: PyTorch takes seconds

    if find_checkpoint(folder) is None:
        yield None
        return
    checkpoint = Checkpoint(folder)
    with checkpoint.reading():
        yield checkpoint.run["progress"]


def collect(paper: Paper[Kind], plan: Plan, experiment: Kind, quiet: bool) -> Tables:
    """Return the tables of what has been learned, and ride what has not ridden yet.

    Args:
        paper: of the experiments.
        plan: its runs as they stand, in the order of the experiment.
        experiment: its settings.
        quiet: show no progress.
    """
    runs: list[Any] = []
    validations: list[Any] = []
    ridden: list[Tables] = []
    folders: dict[tuple[str, int], Path] = {}
    each = paper.rides(experiment)
    with progress_bar("riding", "ride", each * len(plan.runs), quiet=quiet) as bar:
        for (setting, seed), planned in zip(experiment.named(), plan.runs, strict=True):
            rows = _validations(paper, planned.folder, setting, seed)
            validations += rows
            runs.append(_run_row(planned, setting, seed, rows))
            before = bar.n
            if _ride(paper, planned.folder, setting, seed, experiment, bar.update):
                folders[setting, seed] = planned.folder
                ridden.append(read_data(paper.file, planned.folder, paper.ridden))
            bar.update(before + each - bar.n)
    data = tables(paper.file, runs=runs, validations=validations)
    data |= {name: pd.concat([of[name] for of in ridden], ignore_index=True) for name in paper.ridden if ridden}
    return paper.add_details(data, folders, experiment)


def _ride(
    paper: Paper[Kind], folder: Path, setting: str, seed: int, experiment: Kind, update: Callable[[], Any]
) -> bool:
    """Ride what a run has learned unless its tables are there already; return whether they are now."""
    with suppress(FileNotFoundError):
        ended = (folder / "run.json").stat().st_mtime
        files = [folder / paper.file["tables"][name]["file"] for name in paper.ridden]
        if all(file.stat().st_mtime >= ended for file in files):
            return True
    found = paper.ride(folder, setting, seed, experiment, update)
    if found is None:
        return False
    write_data(paper.file, folder, {name: table(paper.file, name, found[name]) for name in paper.ridden})
    return True


def _run_row(planned: PlannedRun, setting: str, seed: int, validations: list[Any]) -> tuple[Any, ...]:
    """Return how a run stands; the steps of one that was interrupted are those of its last validation at least."""
    summary = read_record(planned.folder / "run.json") or {}
    result = read_record(planned.folder / "result.json") or {}
    finished = summary.get("finished_at_step")
    steps = summary.get("steps", validations[-1][2] if validations else 0)
    return setting, seed, planned.status, steps, -1 if finished is None else finished, result.get("cpu_seconds", -1.0)


def _validations(paper: Paper[Kind], folder: Path, setting: str, seed: int) -> list[Any]:
    rows = []
    with suppress(FileNotFoundError), (folder / "validations.csv").open(newline="", encoding="utf-8") as file:
        for record in csv.DictReader(file):
            with suppress(KeyError, TypeError, ValueError):  # a line that a kill has cut short
                error = float(record[paper.error]) / paper.unit
                rows.append((setting, seed, int(record["step"]), int(float(record["part"])), error))
    return rows


def draw_all(paper: Paper[Any], data: Any, out: Path) -> list[Path]:
    """Draw all figures of a paper from its tables and return their files."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    paths = []
    for name, draw in paper.figures.items():
        figure = draw(data, plt)
        figure.savefig(out / name, dpi=90)
        plt.close(figure)
        paths.append(out / name)
    return paths


def all_tables(paper: Paper[Any], data: Any) -> str:
    """Return all tables of a paper as Markdown, with headings."""
    return "\n".join(f"### {title}\n\n{write(data)}" for title, write in paper.written.items())
