"""What a curriculum is, which draws episodes and adapts to their results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.settings import Settings


class EndedEpisode(NamedTuple):
    """Result of an episode of learning.

    Attributes:
        request: of the episode, with its context.
        total: sum of its rewards.
        steps: its length, decisions.
        failed: whether it was terminated.
        progress: where it ended, arc length of the followed line, m.
    """

    request: ResetRequest
    total: float
    steps: int
    failed: bool
    progress: float


class Episodes(Protocol):
    """Distribution of new episodes."""

    def draw(self, rng: np.random.Generator, preview: Preview, row: int = 0) -> ResetRequest:
        """Draw how an episode begins, its curriculum context included.

        Args:
            rng: draws.
            preview: what the task needs to see of the course.
            row: which of the vehicles side by side begins; it decides which machine that is.
        """


class Curriculum(ABC):
    """Decides which episodes are drawn during learning.

    Attributes:
        part: number of the present part, from 1; always 1 without parts.
        finished_at: learning step at which all was passed that it has to teach, or None.
    """

    part: int = 1
    finished_at: int | None = None

    @property
    def finished(self) -> bool:
        """Whether all that it has to teach has been passed."""
        return self.finished_at is not None

    @abstractmethod
    def episodes(self, step: int) -> Episodes:
        """Return where episodes are drawn from at a learning step."""

    def imitated(self) -> Episodes:
        """Return the episodes in which an actor imitates a teacher, before the first learning step."""
        return self.episodes(0)

    def may_validate(self, step: int) -> bool:
        """Return whether a validation means something at a learning step."""
        return True

    @abstractmethod
    def validation_requests(self, preview: Preview, rng: np.random.Generator) -> list[ResetRequest]:
        """Draw the rides of one validation, for rows that take the machines in turn.

        Args:
            preview: what the task needs to see of the course.
            rng: draws.
        """

    @abstractmethod
    def selection_requests(self, preview: Preview) -> list[ResetRequest]:
        """Return the rides that actors are compared on: always the same, and none that a validation draws."""

    @abstractmethod
    def passes(self, errors: Sequence[float]) -> bool:
        """Return whether a validation with these errors was fully successful."""

    @property
    def asks_for_stability(self) -> bool:
        """Whether a part is passed only with an actor whose closed loop is stable."""
        return False

    @property
    def compares_stability(self) -> bool:
        """Whether actors whose closed loop is stable are selected before all others."""
        return False

    def ended(self, episode: EndedEpisode) -> None:  # noqa: B027
        """Take note of how an episode of learning went."""

    def validated(self, step: int, errors: Sequence[float]) -> bool:
        """Take the errors of a validation; return whether a part was passed with it."""
        if self.finished or not self.passes(errors):
            return False
        self.finished_at = step
        return True

    def figures(self) -> dict[str, float]:
        """Return its figures for the logs beside its part, by name."""
        return {}

    def state_dict(self) -> dict[str, Any]:
        """Return where it stands, as plain values and arrays."""
        return {"part": self.part, "finished_at": self.finished_at}

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue from where :meth:`state_dict` was taken."""
        self.part, self.finished_at = stored["part"], stored["finished_at"]


class CurriculumSettings(Settings, ABC):
    """Settings of a curriculum; `bike_training.settings` says what a record is.

    Attributes:
        curriculum: name of its kind.
        validate_every: least learning steps between two validations.
        select_every: learning steps between two comparisons of actors once the curriculum is finished.
    """

    place = "curriculum"
    curriculum: str
    validate_every: int
    select_every: int

    @abstractmethod
    def make(self, vehicles: Sequence[Vehicle]) -> Curriculum:
        """Return the curriculum of vehicles, which rows take in turn, at its beginning.

        Raises:
            ValueError: it is not for these vehicles.
            FileNotFoundError: an unknown course.
        """
