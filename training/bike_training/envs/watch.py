"""Notification of the rides of an environment, for recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bike_sim.sim.request import ResetRequest


class RideWatch(Protocol):
    """Follows the rides of one vehicle while it learns.

    Environments have none unless they are given one, and then do nothing for it.
    """

    def begun(self, request: ResetRequest) -> None:
        """Take note that a ride begins; the one before is over."""
        ...

    def stepped(
        self,
        observation: NDArray[np.float32],
        action: NDArray[np.floating],
        states: Sequence[NDArray[np.float64]],
    ) -> None:
        """Take note of a decision.

        Args:
            observation: of the policy.
            action: of the policy, in [-1, 1], one number per column of the task's action.
            states: minimal state at the end of each control period that it was held.
        """
        ...
