"""Validations during learning: ten rides or so with the deterministic actor, and what follows from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bike_policy.contract.actor import Actor
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.learning.progress import Progress
from bike_training.learning.run_settings import RunSettings
from bike_training.learning.validation_rides import SideBySide, validate_simulator
from bike_training.tasks.base import Task


class Validation(NamedTuple):
    """What came of a validation.

    Attributes:
        part: part of the curriculum that it was ridden in.
        mean_error: of its rides, m. max_error: largest error of a ride, m.
        succeeded: whether every ride passed.
    """

    part: int
    mean_error: float
    max_error: float
    succeeded: bool


class Validator:
    """Rides validations as the environments of a run do, with simulators of its own where it needs them."""

    def __init__(self, settings: RunSettings, task: Task) -> None:
        """Prepare to validate; nothing is started before the first ride."""
        self._settings, self._task = settings, task
        self._simulators: dict[SimulatorConfig, Simulator] = {}
        self._together: SideBySide | None = None

    def simulator(self, row: int = 0) -> Simulator:
        """Return the simulator of a ride in this process: its bits are those of every client, ten times as fast."""
        config = self._settings.simulator(row)
        if config not in self._simulators:
            self._simulators[config] = Simulator(config)
        return self._simulators[config]

    def ride(self, actor: Actor, requests: list[ResetRequest]) -> list[float]:
        """Ride all requests and return their errors, as the task defines them."""
        if self._settings.compiled:
            return self._side_by_side(len(requests)).errors(actor, requests)
        return validate_simulator(actor, self._task, self.simulator, requests)

    def _side_by_side(self, count: int) -> SideBySide:
        """Return vehicles for a number of rides: those of the last validation, unless it had another number."""
        if self._together is None or self._together.count != count:
            if self._together is not None:
                self._together.close()
            settings = self._settings
            self._together = SideBySide(self._task, count, settings.simulator(), settings.machines)
        return self._together

    def close(self) -> None:
        """Release the simulators; a later ride starts others."""
        together, self._together = self._together, None
        if together is not None:
            together.close()
        while self._simulators:
            self._simulators.popitem()[1].close()


def take_in(progress: Progress, actor: Actor, step: int, errors: Sequence[float], largest_error: float) -> Validation:
    """Take a validation into the progress of a run, and move the curriculum on if it was fully successful.

    Args:
        progress: of the run.
        actor: who rode.
        step: learning step.
        errors: of the rides, as parts of the largest error.
        largest_error: m.
    """
    curriculum = progress.curriculum
    part, succeeded = curriculum.part, curriculum.passes(errors)
    passed = curriculum.validated(step, errors)
    progress.recent_error_m = float(np.mean(errors) * largest_error)
    progress.validated_at, progress.validation_due = step, False
    progress.validations += 1
    if succeeded:
        progress.latest_success, progress.success_step = actor, step
    if passed and curriculum.finished:
        progress.finished_after = round(progress.seconds, 1)
    return Validation(part, progress.recent_error_m, max(errors) * largest_error, succeeded)
