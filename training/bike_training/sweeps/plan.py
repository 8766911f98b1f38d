"""What of a sweep is to be done, in which order, and how long it will take."""

from __future__ import annotations

import heapq
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bike_training.sweeps.records import FINISHED, folder_of, result_of, standing_of
from bike_training.sweeps.spec import RunSpec, Sweep

RUNS_FOLDER: Final = "runs"


@dataclass(frozen=True)
class PlannedRun:
    """A run of a sweep as it stands.

    Attributes:
        run: what it is. folder: its folder. status: how it stands. error: why it failed, or empty.
        seconds: how long it took if it has finished, else how long it is expected to take from its beginning, s.
    """

    run: RunSpec
    folder: Path
    status: str
    error: str
    seconds: float

    @property
    def finished(self) -> bool:
        """Whether nothing of it is to be done."""
        return self.status == FINISHED


@dataclass(frozen=True)
class Plan:
    """A sweep as it stands in its folder.

    Attributes:
        runs: in the order of the sweep's file.
        scale: measured over estimated time of the finished runs, by which the others are expected to take longer.
    """

    runs: tuple[PlannedRun, ...]
    scale: float = 1.0

    @property
    def missing(self) -> tuple[PlannedRun, ...]:
        """Runs that are to be done, the longest first: then no long one is left alone at the end."""
        left = [run for run in self.runs if not run.finished]
        return tuple(sorted(left, key=lambda run: -run.seconds))

    def hours(self, cores: float) -> float:
        """Return the time that what is missing is expected to take, h."""
        needs = [(run.seconds, run.run.cores) for run in self.missing]
        return schedule([seconds for seconds, _ in needs], slots_of(cores, [need for _, need in needs])) / 3600.0


def make_plan(sweep: Sweep, out: Path) -> Plan:
    """Look at what a folder holds of a sweep."""
    runs = out / RUNS_FOLDER
    folders = [folder_of(runs, run.name, run.digest) for run in sweep.runs]
    estimates = [run.job().estimate() for run in sweep.runs]
    results = [result_of(folder) for folder in folders]
    ratios = [
        float(result["seconds"]) / estimate
        for result, estimate in zip(results, estimates, strict=True)
        if result is not None and result["attempts"] == 1
    ]
    scale = statistics.median(ratios) if ratios else 1.0
    return Plan(
        tuple(
            PlannedRun(run, folder, *standing_of(folder), float(result["seconds"]) if result else scale * estimate)
            for run, folder, result, estimate in zip(sweep.runs, folders, results, estimates, strict=True)
        ),
        scale,
    )


def slots_of(cores: float, needs: Sequence[float]) -> int:
    """Return how many runs are done side by side.

    Args:
        cores: processor cores.
        needs: cores that each run declares.
    """
    return max(1, int(cores / max(needs, default=1.0) + 1e-9))


def schedule(seconds: Sequence[float], slots: int, start: float = 0.0) -> float:
    """Return when the last run ends, s, where each begins as soon as a slot is free, in order.

    Args:
        seconds: duration of each run, s.
        slots: runs side by side.
        start: time that a slot needs before each run, s.
    """
    free = [0.0] * slots
    for duration in seconds:
        heapq.heapreplace(free, free[0] + start + duration)
    return max(free)
