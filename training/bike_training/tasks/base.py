"""The protocol of a task, for environments and learners that do not depend on a vehicle."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import Blocks, ObservationLayout
from bike_sim.sim.request import Preview

FloatArray = NDArray[np.float64]


class RideBlocks(Blocks, Protocol):
    """Blocks that a task evaluates: one snapshot, or a batch with leading dimensions.

    Attributes:
        fallen: whether the vehicle has fallen.
    """

    @property
    def fallen(self) -> bool | NDArray[np.bool_]: ...  # noqa: D102


class Task(Protocol):
    """A learning problem: observation, action, reward, and failure of an episode.

    Attributes:
        max_steps: steps after which an episode is truncated.
    """

    @property
    def max_steps(self) -> int: ...  # noqa: D102
    @property
    def layout(self) -> ObservationLayout: ...  # noqa: D102
    @property
    def action(self) -> ActionLayout: ...  # noqa: D102

    @property
    def preview(self) -> Preview:
        """The preview that shows exactly what the layout needs."""
        ...

    def reward_terms(self, blocks: RideBlocks) -> dict[str, FloatArray]:
        """Return the weighted terms of the reward of one or many instants by name; their sum is the reward."""
        ...

    def failed(self, blocks: RideBlocks) -> NDArray[np.bool_]:
        """Return where a ride has failed, so that its episode is terminated."""
        ...

    def error(self, blocks: RideBlocks) -> FloatArray:
        """Return the tracking error of one or many rides, m."""
        ...

    @property
    def validation_duration(self) -> float:
        """Duration of a validation ride, s."""
        ...

    @property
    def largest_error(self) -> float:
        """The error that a failed ride counts as, m; errors of validation rides are parts of it."""
        ...

    def validation_error(self, errors: FloatArray, succeeded: bool) -> float:
        """Return the error of one validation ride, as a part of :attr:`largest_error`.

        Args:
            errors: at each step of the ride, m.
            succeeded: whether it did not fail.
        """
        ...

    def to_card(self) -> dict[str, Any]:
        """Return plain values for recordings."""
        ...


def sum_of(terms: Mapping[str, FloatArray]) -> FloatArray:
    """Return the reward that its terms make."""
    return functools.reduce(np.add, terms.values())


def has_failed(task: Task, blocks: RideBlocks) -> bool:
    """Return whether one ride has failed."""
    return bool(task.failed(blocks))
