"""The protocol of a task, for environments and learners that do not depend on a vehicle."""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import ObservationLayout
from bike_policy.contract.race import RaceLayout
from bike_policy.contract.rows import RowBlocks
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]


class StepResult(NamedTuple):
    """What a decision was worth to each vehicle.

    Attributes:
        terms: weighted terms of the reward by name, shape (n,) each; their sum is the reward.
        failed: whose episode is terminated, shape (n,).
    """

    terms: dict[str, FloatArray]
    failed: NDArray[np.bool_]


class TaskState(Protocol):
    """What a task shows and judges of vehicles side by side, with what it must remember of their rides.

    A decision is: :meth:`observe`, :meth:`act`, control periods between :meth:`commands` and :meth:`advance`, then
    :meth:`evaluate`.
    """

    def begin(self, row: int, blocks: RowBlocks, request: ResetRequest, course: Course) -> None:
        """Begin the ride of one vehicle.

        Args:
            row: of the vehicle.
            blocks: of all vehicles, after its reset.
            request: how it began.
            course: the followed line.
        """
        ...

    def observe(self, blocks: RowBlocks) -> NDArray[np.float32]:
        """Return the observations, shape (n, layout.size)."""
        ...

    def act(self, blocks: RowBlocks, actions: NDArray[np.floating]) -> None:
        """Take actions that are held from now on, shape (n, action.size)."""
        ...

    def commands(self, blocks: RowBlocks) -> FloatArray:
        """Return what the actions become in a control period: steering and throttle in [-1, 1], shape (n, 2)."""
        ...

    def advance(self, blocks: RowBlocks) -> None:
        """Take note of the end of a control period."""
        ...

    def evaluate(self, blocks: RowBlocks) -> StepResult:
        """Return what has come of the decision."""
        ...

    def error(self, blocks: RowBlocks) -> FloatArray:
        """Return the error of each vehicle at this instant, shape (n,); the task says what it is."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Return the memory, as plain values and arrays."""
        ...

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Go on from where :meth:`state_dict` was taken, after each row has begun again."""
        ...


class Task(Protocol):
    """A learning problem: observation, action, reward, and failure of an episode.

    Attributes:
        max_steps: steps after which an episode is truncated.
    """

    @property
    def max_steps(self) -> int: ...  # noqa: D102
    @property
    def layout(self) -> ObservationLayout | RaceLayout: ...  # noqa: D102
    @property
    def action(self) -> ActionLayout: ...  # noqa: D102

    @property
    def preview(self) -> Preview:
        """The preview that shows exactly what the layout needs."""
        ...

    @property
    def repeat(self) -> int:
        """Control periods that a decision is held."""
        ...

    def rides(self, count: int, vehicle: Vehicle) -> TaskState:
        """Return what it shows and judges of a number of vehicles.

        Raises:
            ValueError: the task is not for this vehicle.
        """
        ...

    def strict(self) -> Task:
        """Return the task as validations ride it."""
        ...

    @property
    def error_name(self) -> str:
        """What the error of a ride is, with its unit."""
        ...

    @property
    def validation_duration(self) -> float:
        """Duration of a validation ride, s."""
        ...

    @property
    def largest_error(self) -> float:
        """The error that a failed ride counts as; errors of validation rides are parts of it."""
        ...

    def validation_error(self, errors: FloatArray, succeeded: bool) -> float:
        """Return the error of one validation ride, as a part of :attr:`largest_error`.

        Args:
            errors: at each control period of the ride.
            succeeded: whether it did not fail.
        """
        ...

    def selection_error(self, track: FloatArray, whole: NDArray[np.bool_]) -> float:
        """Return the figure by which actors are compared, less is better.

        Args:
            track: errors at each control period, shape (periods, rides).
            whole: which rides did not fail, shape (rides,).
        """
        ...

    def to_card(self) -> dict[str, Any]:
        """Return plain values for recordings."""
        ...


def sum_of(terms: Mapping[str, FloatArray]) -> FloatArray:
    """Return the reward that its terms make."""
    return functools.reduce(np.add, terms.values())


def check_weights(weights: Mapping[str, float], known: Collection[str], negative: bool = False) -> None:
    """Check the weights of a reward.

    Args:
        weights: of the terms by name.
        known: names of all terms.
        negative: whether weights may be less than 0.

    Raises:
        ValueError: naming the term and its weight.
    """
    unknown = sorted(set(weights) - set(known))
    if unknown or not weights:
        raise ValueError(f"reward has unknown terms {unknown}; there are {', '.join(known)}")
    wanted = "finite" if negative else "finite and not negative"
    for name, weight in weights.items():
        if not (math.isfinite(weight) and (negative or weight >= 0.0)):
            raise ValueError(f"weight of the reward term {name} must be {wanted}, got {weight!r}")


def check_positive_settings(task: Any, names: Collection[str]) -> None:
    """Check that settings of a task are positive.

    Raises:
        ValueError: naming the setting and its value.
    """
    for name in names:
        if not getattr(task, name) > 0:
            raise ValueError(f"{name} must be positive, got {getattr(task, name)!r}")
