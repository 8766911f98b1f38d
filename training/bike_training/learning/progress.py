"""Progress of a learning run, and the tables that it writes."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from bike_policy.contract.bundle import Actor
from bike_training.arguments import write_whole
from bike_training.curricula.base import Curriculum
from bike_training.learning.learner import AveragedActor

_ACTORS: Final = ("latest_success", "best")
_APART: Final = ("curriculum", "averaged", "rng", *_ACTORS)
"""Fields of a progress that are no plain values."""


@dataclass
class Progress:
    """State of a run beside learner and environment.

    Attributes:
        curriculum: where it stands.
        averaged: average of the actor.
        rng: draws of validation rides.
        seconds: time spent learning so far, s, earlier sessions included.
        validated_at: learning step of the last validation.
        validation_due: whether an episode has just reached its full length when a validation was allowed.
        handled_at: learning step that was last averaged and validated, so that a resumed run does not do it twice.
        validations: a row for each: learning step, seconds, part, mean and largest error, whether it passed, updates.
        selections: a row for each comparison of actors: learning step and selection error.
        latest_success: most recent actor that passed all rides of a validation in the highest part so far.
        success_step: learning step at which it did.
        recent_error_m: mean error of the last validation, in the unit of the task (m for a path).
        best: actor with the least selection error since the curriculum was finished.
        best_error_m: its selection error, m.
        best_step: learning step at which it was found.
        selected_at: learning step of the last comparison.
        finished_after: time spent learning when the curriculum was finished, s, or None.
        stages: where it rode: client, engine, vehicles side by side, updates and first learning step of each.
    """

    curriculum: Curriculum
    averaged: AveragedActor
    rng: np.random.Generator
    seconds: float = 0.0
    validated_at: int = 0
    validation_due: bool = False
    handled_at: int = -1
    validations: list[list[Any]] = field(default_factory=list)
    selections: list[list[Any]] = field(default_factory=list)
    latest_success: Actor | None = None
    success_step: int = 0
    recent_error_m: float = float("nan")
    best: Actor | None = None
    best_error_m: float = float("inf")
    best_step: int = 0
    selected_at: int = 0
    finished_after: float | None = None
    stages: list[dict[str, Any]] = field(default_factory=list)

    def write_tables(self, folder: Path, error: str) -> None:
        """Write ``validations.csv`` and ``selection.csv`` of a run whose errors have a name."""
        columns = ["step", "seconds", "part", f"mean_{error}", f"max_{error}", "passed", "updates"]
        _write_table(folder / "validations.csv", [columns, *self.validations])
        _write_table(folder / "selection.csv", self.selections)

    def state_dict(self) -> dict[str, Any]:
        """Return all that :meth:`restore` needs, as plain values and arrays."""
        return {
            **{spec.name: getattr(self, spec.name) for spec in fields(self) if spec.name not in _APART},
            **{name: _tensors(getattr(self, name)) for name in _ACTORS},
            "curriculum": self.curriculum.state_dict(),
            "averaged": self.averaged.state_dict(),
            "rng": self.rng.bit_generator.state,
        }

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Go on from where :meth:`state_dict` was taken.

        Raises:
            KeyError: an entry is missing.
            ValueError: an actor that is none.
        """
        for spec in fields(self):
            if spec.name not in _APART:
                setattr(self, spec.name, stored[spec.name])
        for name in _ACTORS:
            setattr(self, name, stored_actor(stored, name))
        self.curriculum.restore(stored["curriculum"])
        self.averaged.restore(stored["averaged"])
        self.rng.bit_generator.state = stored["rng"]


def _write_table(path: Path, rows: Sequence[Sequence[Any]]) -> None:
    """Write rows, or no file where there are none."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    if rows:
        write_whole(path, text.getvalue())
    else:
        path.unlink(missing_ok=True)


def _tensors(actor: Actor | None) -> dict[str, Any] | None:
    return None if actor is None else dict(actor.tensors())


def stored_actor(stored: Mapping[str, Any], name: str) -> Actor | None:
    """Return an actor of a stored progress, or None if there was none yet.

    Args:
        stored: result of :meth:`Progress.state_dict`.
        name: ``best``, ``latest_success``, or ``averaged`` for the one that would be deployed without a comparison.
    """
    if name == "averaged":
        averaged = AveragedActor(0.0)
        averaged.restore(stored["averaged"])
        return averaged.actor() if averaged.count else None
    tensors = stored[name]
    return None if tensors is None else Actor.from_tensors(tensors)


def chosen_actor(stored: Mapping[str, Any], which: str, steps: int) -> tuple[Actor | None, str, int]:
    """Return an actor of a stored progress, which one it is, and the learning step that it is of.

    Args:
        stored: result of :meth:`Progress.state_dict`.
        which: ``best`` of those that were compared (``success`` where none was), ``success`` for the most recent one
            that passed a validation, or ``last``.
        steps: learning steps so far.
    """
    if which == "best" and stored["best"] is not None:
        return stored_actor(stored, "best"), "best", stored["best_step"]
    if which in ("best", "success"):
        return stored_actor(stored, "latest_success"), "success", stored["success_step"]
    return stored_actor(stored, "averaged"), "last", steps  # none before learning began
