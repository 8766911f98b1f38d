"""What a curriculum is: which episodes are drawn when, and what it learns from how they went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from bike_sim.sim.request import Preview, ResetRequest


class Episodes(Protocol):
    """Where new episodes are drawn from."""

    def draw(self, rng: np.random.Generator, preview: Preview) -> ResetRequest:
        """Draw how an episode begins, its curriculum context included.

        Args:
            rng: draws.
            preview: what the task needs to see of the course.
        """
        ...


class Curriculum(Protocol):
    """Decides which episodes are drawn as learning goes on."""

    @property
    def finished(self) -> bool:
        """Whether all that it has to teach has been passed."""
        ...

    def episodes(self, step: int) -> Episodes:
        """Return where episodes are drawn from at a learning step."""
        ...

    def may_validate(self, step: int) -> bool:
        """Tell whether a validation means something at a learning step."""
        ...

    def validation(self) -> Episodes:
        """Return where the rides of a validation are drawn from."""
        ...

    def ended(self, context: Sequence[float], total: float, steps: int) -> None:
        """Take note of how an episode of learning went.

        Args:
            context: of its request.
            total: sum of its rewards.
            steps: its length.
        """
        ...

    def validated(self, step: int, errors: Sequence[float]) -> bool:
        """Take the errors of a validation; return whether a part was passed with it."""
        ...
