"""The tables of what has been learned: how the runs stand, and the rides of what they leave."""

from __future__ import annotations

import csv
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from bike_training.progress import progress_bar
from bike_training.reproduce.data import Data, Run, Validation, file_of, kind_of, read_rows, write_rows
from bike_training.reproduce.paper import Kind, Paper
from bike_training.sweeps.plan import Plan, PlannedRun


def collect(paper: Paper[Kind, Data], plan: Plan, experiment: Kind, quiet: bool) -> Data:
    """Return the tables of what has been learned, and ride what has not ridden yet.

    Args:
        paper: whose experiments they are.
        plan: its runs as they stand, in the order of the experiment.
        experiment: what is done.
        quiet: show no progress.
    """
    runs: list[Run] = []
    validations: list[Validation] = []
    ridden: dict[str, list[Any]] = {name: [] for name in paper.ridden}
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
                for name in paper.ridden:
                    path = planned.folder / file_of(paper.tables, name)
                    ridden[name] += read_rows(path, kind_of(paper.tables, name))
            bar.update(before + each - bar.n)
    data = paper.tables(tuple(runs), tuple(validations))
    data = replace(data, **{name: tuple(rows) for name, rows in ridden.items()})
    return paper.look_closely(data, folders, experiment)


def _ride(
    paper: Paper[Kind, Data], folder: Path, setting: str, seed: int, experiment: Kind, update: Callable[[], Any]
) -> bool:
    """Ride what a run has learned unless its tables are there already; return whether they are now."""
    paths = {name: folder / file_of(paper.tables, name) for name in paper.ridden}
    with suppress(FileNotFoundError):
        learned = (folder / "run.json").stat().st_mtime
        if all(path.stat().st_mtime >= learned for path in paths.values()):
            return True
    found = paper.ride(folder, setting, seed, experiment, update)
    if found is None:
        return False
    for name, path in paths.items():
        write_rows(path, kind_of(paper.tables, name), found[name])
    return True


def _run_row(planned: PlannedRun, setting: str, seed: int, rows: list[Validation]) -> Run:
    """Return how a run stands; the steps of one that was interrupted are those of its last validation at least."""
    summary: dict[str, Any] = {}
    with suppress(FileNotFoundError, ValueError):
        summary = yaml.safe_load((planned.folder / "run.json").read_text(encoding="utf-8"))
    result: dict[str, Any] = {}
    with suppress(FileNotFoundError, ValueError):
        result = yaml.safe_load((planned.folder / "result.json").read_text(encoding="utf-8"))
    finished = summary.get("finished_at_step")
    steps = int(summary.get("steps", rows[-1].step if rows else 0))
    cpu = float(result.get("cpu_seconds", -1.0))
    return Run(setting, seed, planned.status, steps, -1 if finished is None else int(finished), cpu)


def _validations(paper: Paper[Kind, Data], folder: Path, setting: str, seed: int) -> list[Validation]:
    rows = []
    with suppress(FileNotFoundError), (folder / "validations.csv").open(newline="", encoding="utf-8") as file:
        for record in csv.DictReader(file):
            with suppress(KeyError, TypeError, ValueError):  # a line that a kill has cut short
                error = float(record[paper.error]) / paper.unit
                rows.append(Validation(setting, seed, int(record["step"]), int(float(record["part"])), error))
    return rows
