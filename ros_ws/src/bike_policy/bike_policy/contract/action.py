"""The action contract: what the one number that a policy answers means."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

ACTION_MEANING: Final = "steering_set_value"
"""The only meaning so far: set value of the steering angle, positive to the left."""


@dataclass(frozen=True)
class ActionScale:
    """How the action in [-1, 1] becomes the steering command in [-1, 1] of the vehicle.

    Attributes:
        max_steer: steering set value of action 1, rad. The paper's choice is the vehicle's own 70 degrees (Weyrer et
            al. 2026, Sect. 3.4).
        meaning: ACTION_MEANING.
    """

    max_steer: float
    meaning: str = ACTION_MEANING

    def __post_init__(self) -> None:
        """Refuse an unknown meaning and a scale that is not positive."""
        if self.meaning != ACTION_MEANING:
            raise ValueError(f"unknown action meaning {self.meaning!r}, this software knows {ACTION_MEANING!r}")
        if not math.isfinite(self.max_steer) or self.max_steer <= 0.0:
            raise ValueError(f"action scale max_steer must be positive and finite, got {self.max_steer!r}")

    def to_command(self, action: float, vehicle_max_steer: float) -> float:
        """Return the steering command in [-1, 1] for an action.

        Args:
            action: in [-1, 1].
            vehicle_max_steer: steering set value of command 1, rad.
        """
        return min(max(action * (self.max_steer / vehicle_max_steer), -1.0), 1.0)

    def to_commands(self, actions: NDArray[np.floating], vehicle_max_steer: float) -> NDArray[np.float64]:
        """Return :meth:`to_command` of many actions at once, the same bit for bit."""
        return np.clip(np.asarray(actions, dtype=np.float64) * (self.max_steer / vehicle_max_steer), -1.0, 1.0)

    def to_card(self) -> dict[str, Any]:
        """Return plain values for a policy card."""
        return {"max_steer": float(self.max_steer), "meaning": self.meaning}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> ActionScale:
        """Read from a policy card.

        Raises:
            ValueError: a missing or unknown entry.
        """
        if set(card) != {"max_steer", "meaning"}:
            raise ValueError(f"action entry of the card must hold max_steer and meaning, got {sorted(card)}")
        return cls(float(card["max_steer"]), str(card["meaning"]))
