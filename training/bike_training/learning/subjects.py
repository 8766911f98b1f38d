"""What a preset learns and in which order: settings that a task and a curriculum are made of.

A new subject is a record of settings with ``make`` and an entry in TASK_SETTINGS or CURRICULUM_SETTINGS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, Protocol

from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.curricula.base import Curriculum
from bike_training.curricula.parts import PartsCurriculum
from bike_training.learning.setting_records import check_number, check_positive
from bike_training.tasks.base import Task
from bike_training.tasks.path import TASKS


class TaskSettings(Protocol):
    """Settings of a task."""

    @property
    def task(self) -> str:
        """Name of the task."""
        ...

    def make(self) -> Task:
        """Return the task."""
        ...

    def check_vehicle(self, vehicle: Vehicle) -> None:
        """Refuse a vehicle that the task is not for.

        Raises:
            ValueError: naming vehicle and task.
        """
        ...


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

    def make(self) -> Curriculum:
        """Return the curriculum at its beginning."""
        ...


@dataclass(frozen=True, kw_only=True)
class PathSettings:
    """Settings of a bicycle's path following.

    Attributes:
        task: name in :data:`bike_training.tasks.path.TASKS`.
        max_steer: steering set point of action 1, rad.
        weights: terms of the reward by name and their weights; empty keeps the task's.
        sharpness: width of the term ``path_peak``, m.
    """

    task: str = "prop"
    max_steer: float = math.radians(70.0)
    weights: Mapping[str, float] = field(default_factory=dict)
    sharpness: float = 0.2

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        if self.task not in TASKS:
            raise ValueError(f"preset setting task={self.task!r} is not one of {', '.join(TASKS)}")
        for name in ("max_steer", "sharpness"):
            check_positive(name, getattr(self, name))
        if not isinstance(self.weights, Mapping):
            raise ValueError(f"preset setting weights={self.weights!r} must name reward terms and their weights")
        self.make()

    def make(self) -> Task:
        """Return the task."""
        task = replace(TASKS[self.task], max_steer=self.max_steer, sharpness=self.sharpness)
        return replace(task, weights=dict(self.weights)) if self.weights else task

    def check_vehicle(self, vehicle: Vehicle) -> None:
        """Refuse superbikes: they ride circuits, and this task shows and judges none."""
        if isinstance(vehicle, Superbike):
            raise ValueError(f"task {self.task!r} is for bicycles on paths, and {vehicle.name!r} is a superbike")


@dataclass(frozen=True, kw_only=True)
class PartsSettings:
    """Settings of the curriculum in four parts.

    Attributes:
        curriculum: its name.
        refine: ride beyond the intervals of the last part once it is finished.
        validate_every: least learning steps between two validations.
    """

    curriculum: str = "parts"
    refine: bool = False
    validate_every: int = 4000

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        if self.curriculum != "parts":
            raise ValueError(f"preset setting curriculum={self.curriculum!r} is not one of parts")
        check_number("validate_every", self.validate_every, 1, math.inf)

    def make(self) -> Curriculum:
        """Return the curriculum at its beginning."""
        return PartsCurriculum(self.refine)


TASK_SETTINGS: Final[dict[str, type[Any]]] = dict.fromkeys(TASKS, PathSettings)
CURRICULUM_SETTINGS: Final[dict[str, type[Any]]] = {"parts": PartsSettings}
"""Which settings belong to a name."""
