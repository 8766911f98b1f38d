"""What a preset learns and in which order: settings that a task and a curriculum are made of.

A new subject is a record of settings with ``make`` and an entry in TASK_SETTINGS or CURRICULUM_SETTINGS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from bike_sim.vehicles.bicycle import Vehicle
from bike_training.curricula.base import Curriculum
from bike_training.curricula.parts import PartsCurriculum
from bike_training.curricula.race import CircuitSet, RaceCurriculum, SpeedCurriculum
from bike_training.curricula.spdl import SpdlCurriculum
from bike_training.learning.setting_records import check_number, check_positive
from bike_training.tasks.path import TASKS, PathTask
from bike_training.tasks.race import RaceTask


class CurriculumSettings(Protocol):
    """Settings of a curriculum."""

    @property
    def curriculum(self) -> str:
        """Name of the curriculum."""
        ...

    @property
    def validate_every(self) -> int:
        """Least number of learning steps between two validations."""
        ...

    @property
    def select_every(self) -> int:
        """Learning steps between two comparisons of actors once the curriculum is finished."""
        ...

    def make(self, vehicles: Sequence[Vehicle]) -> Curriculum:
        """Return the curriculum of vehicles, which rows take in turn, at its beginning.

        Raises:
            ValueError: it is not for these vehicles. FileNotFoundError: an unknown course.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class PartsSettings:
    """Settings of the curriculum in four parts.

    Attributes:
        curriculum: its name.
        refine: ride beyond the intervals of the last part once it is finished.
        sharp: a third of the rides of the last part each are fast and slow ones with sharp transfers, which are rare in
            its intervals.
        last_speeds: rides of a validation of the last part, at so many even speeds with both ends, so that none is left
            out by luck; 0 for ten at random speeds, as published.
        validate_every: least learning steps between two validations.
        select_every: learning steps between two comparisons of actors once the curriculum is finished.
    """

    curriculum: str = "parts"
    refine: bool = False
    sharp: bool = False
    last_speeds: int = 0
    validate_every: int = 4000
    select_every: int = 10_000

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        if self.curriculum != "parts":
            raise ValueError(f"preset setting curriculum={self.curriculum!r} is not one of parts")
        for name in ("validate_every", "select_every"):
            check_number(name, getattr(self, name), 1, math.inf)
        check_number("last_speeds", self.last_speeds, 0, 1000)

    def make(self, vehicles: Sequence[Vehicle]) -> Curriculum:
        """Return the curriculum at its beginning."""
        return PartsCurriculum(self.refine, self.sharp, self.last_speeds)


RACE_CURRICULA: Final = ("none", "speed", "spdl", "target", "schedule")


@dataclass(frozen=True, kw_only=True)
class RaceCurriculumSettings:
    """Settings of the curricula of races.

    Attributes:
        curriculum: ``none``, ``speed``, ``spdl``, or a baseline of the latter: ``target`` draws from its target from
            the beginning, ``schedule`` moves there by a fixed schedule.
        circuits: names or files of circuits, with commas between them.
        share: part of the planned speed that is asked in the end.
        spread: half width of the interval that the share of an episode is drawn from.
        failure_share: part of the starts that lead up to where rides failed lately.
        first_share: with which ``speed`` begins.
        counted: episodes with a share that ``speed`` counts, nine tenths of them whole, before it asks for more.
        threshold: expected return of an episode that ``spdl`` keeps (delta).
        kl: largest divergence of an update of ``spdl``, nat.
        iteration: learning steps between two of its updates.
        schedule: learning steps after which ``schedule`` is at the target.
        sampled: most circuits that a validation rides, drawn anew for each; comparisons ride the first ones.
        validate_every: least learning steps between two validations.
        select_every: learning steps between two comparisons of actors, once a validation was whole.
    """

    curriculum: str = "none"
    circuits: str = "barcelona"
    share: float = 1.0
    spread: float = 0.0
    failure_share: float = 0.0
    first_share: float = 0.6
    counted: int = 100
    threshold: float = 500.0
    kl: float = 0.05
    iteration: int = 5000
    schedule: int = 150_000
    sampled: int = 12
    validate_every: int = 10_000
    select_every: int = 30_000

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        if self.curriculum not in RACE_CURRICULA:
            raise ValueError(f"preset setting curriculum={self.curriculum!r} is not one of {', '.join(RACE_CURRICULA)}")
        for name in ("share", "first_share", "kl"):
            check_positive(name, getattr(self, name))
        check_number("spread", self.spread, 0.0, 0.9 * self.share)
        check_number("failure_share", self.failure_share, 0.0, 1.0)
        check_number("threshold", self.threshold)
        for name in ("counted", "iteration", "schedule", "sampled", "validate_every", "select_every"):
            check_number(name, getattr(self, name), 1, math.inf)
        if not all(name.strip() for name in self.circuits.split(",")):
            raise ValueError(f"preset setting circuits={self.circuits!r} must name circuits, with commas between them")

    def make(self, vehicles: Sequence[Vehicle]) -> Curriculum:
        """Return the curriculum at its beginning; see `CurriculumSettings`."""
        ground = CircuitSet(vehicles, [name.strip() for name in self.circuits.split(",")])
        common = (ground, self.share, self.spread, self.failure_share, self.sampled)
        if self.curriculum == "speed":
            return SpeedCurriculum(*common, first=self.first_share, counted=self.counted)
        if self.curriculum in ("spdl", "target", "schedule"):
            pacing = "self" if self.curriculum == "spdl" else self.curriculum
            spdl = {"threshold": self.threshold, "kl": self.kl, "iteration": self.iteration}
            return SpdlCurriculum(*common, **spdl, pacing=pacing, schedule=self.schedule)
        return RaceCurriculum(*common)


TASK_SETTINGS: Final[dict[str, type[Any]]] = {**dict.fromkeys(TASKS, PathTask), "race": RaceTask}
CURRICULUM_SETTINGS: Final[dict[str, type[Any]]] = {
    "parts": PartsSettings,
    **dict.fromkeys(RACE_CURRICULA, RaceCurriculumSettings),
}
"""Which settings belong to a name."""
