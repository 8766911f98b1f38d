"""How far a learning run has come."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bike_policy.contract.actor import Actor
from bike_training.curricula.parts import PartsCurriculum
from bike_training.learning.learner import AveragedActor


@dataclass
class Progress:
    """What a process remembers beside learner and environment.

    Attributes:
        curriculum: where it stands.
        averaged: average of the actor.
        rng: draws of validation rides.
        seconds: time spent learning so far, s, earlier sessions included.
        validated_at: learning step of the last validation.
        validation_due: whether an episode has just reached its full length when a validation was allowed.
        handled_at: learning step that was last averaged and validated, so that a resumed run does not do it twice.
        validations: number of validations.
        latest_success: most recent actor that passed all rides of a validation in the highest part so far.
        recent_error_m: mean distance of the last validation, m.
        best: actor with the least selection error since the curriculum was finished.
        best_error_m: its selection error, m.
        best_step: learning step at which it was found.
        selected_at: learning step of the last comparison.
    """

    curriculum: PartsCurriculum
    averaged: AveragedActor
    rng: np.random.Generator
    seconds: float = 0.0
    validated_at: int = 0
    validation_due: bool = False
    handled_at: int = -1
    validations: int = 0
    latest_success: Actor | None = None
    success_step: int = 0
    recent_error_m: float = float("nan")
    best: Actor | None = None
    best_error_m: float = float("inf")
    best_step: int = 0
    selected_at: int = 0
    extra: dict[str, Any] = field(default_factory=dict)

    def may_validate(self, step: int, every: int) -> bool:
        """Tell whether an episode that reaches its full length at a learning step asks for a validation.

        One that does so during the wait or while the intervals grow asks for none later (Weyrer et al. 2026, Sects.
        4.2, 4.3).

        Args:
            step: learning step.
            every: least learning steps between two validations.
        """
        return step - self.validated_at >= every and self.curriculum.may_validate(step)
