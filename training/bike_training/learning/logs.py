"""What a run writes down while it learns: tables of validations and of comparisons, and the logs of a session."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import Logger, make_output_format

from bike_training.learning.checkpoint import drop_rows_after


def validation_columns(error: str) -> tuple[str, ...]:
    """Return the columns of validations whose error has a name."""
    return ("step", "seconds", "part", f"mean_{error}", f"max_{error}", "passed", "updates")


class RunTables:
    """``validations.csv`` and ``selection.csv`` of a run."""

    def __init__(self, folder: Path, error: str) -> None:
        """Write into the folder of a run whose errors have a name."""
        self._columns = validation_columns(error)
        self.validations, self.selection = folder / "validations.csv", folder / "selection.csv"

    def begin(self) -> None:
        """Begin both anew, also where a run was killed before its first checkpoint."""
        with self.validations.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow(self._columns)
        self.selection.unlink(missing_ok=True)

    def drop_after(self, step: int) -> None:
        """Drop the rows that were written after the checkpoint of a learning step."""
        drop_rows_after(self.validations, step)
        drop_rows_after(self.selection, step)

    def add_validation(self, row: Sequence[Any]) -> None:
        """Add a row in the order of `validation_columns`."""
        _append(self.validations, row)

    def add_selection(self, step: int, error: float) -> None:
        """Add the selection error of the actor of a learning step."""
        _append(self.selection, (step, round(error, 6)))


def _append(path: Path, row: Sequence[Any]) -> None:
    with path.open("a", newline="", encoding="utf-8") as file:
        csv.writer(file).writerow(row)


def session_logger(out: Path, step: int) -> Logger:
    """Return the logger of a session that begins at a learning step.

    Each session has its own table, for the logger overwrites what it finds.
    """
    folder = str(out / "tensorboard")
    suffix = f"_from_{step:09d}" if step else ""
    return Logger(folder, [make_output_format("tensorboard", folder), make_output_format("csv", folder, suffix)])


def no_logger() -> Logger:
    """Return a logger that writes nothing, for a learner that does not run."""
    return Logger(None, [])
