"""Settings of the learner: how it learns, whatever the task is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

from bike_training.learning.setting_records import check_number, check_positive

LARGEST_SEED: Final = 2**32 - 1
"""The generators of the learner take no larger one."""


@dataclass(frozen=True, kw_only=True)
class Algorithm:
    """Settings of soft actor-critic (Haarnoja et al. 2018), and of what goes with it here.

    Attributes:
        learner: ``sb3`` (Stable-Baselines3, torch) or ``sbx`` (its sibling in JAX).
        environments: vehicles that ride side by side.
        updates: gradient updates after each step of all vehicles.
        layers: hidden layers of actor and critics.
        layer_norm: normalise the critics' hidden layers (sbx only).
        precondition: networks see observations in coordinates of order one, see `preconditioning` (sbx only).
        critic_only: what of the observation the critics see and the actor does not: names of numbers or blocks, with
            commas between them (sbx only).
        unseen: what neither sees, named likewise: what learning is worth without it (sbx only).
        batch_size: transitions of an update.
        learning_rate: of actor, critics and temperature.
        final_learning_rate: reached linearly at the end of the run.
        gamma: discount of a control step.
        tau: share of the critics that their targets take over in an update.
        buffer_size: transitions kept.
        learning_starts: steps with random actions before the first update.
        policy_delay: updates of the critics for each one of the actor (sbx only).
        target_entropy: entropy that the temperature is tuned to, nat; smaller means less noise.
        temperature: what the entropy is worth at the start, in units of reward.
        mirror: learn each transition as often mirrored left to right as it happened.
        averaging: share of the averaged actor kept in an update of the average; 0 deploys the actor itself.
        steps: learning steps in all.
    """

    learner: Literal["sb3", "sbx"] = "sb3"
    environments: int = 1
    updates: int = 1
    layers: tuple[int, ...] = (256, 256)
    layer_norm: bool = False
    precondition: bool = False
    critic_only: str = ""
    unseen: str = ""
    batch_size: int = 256
    learning_rate: float = 3e-4
    final_learning_rate: float = 3e-4
    gamma: float = 0.99
    tau: float = 0.005
    buffer_size: int = 1_000_000
    learning_starts: int = 100
    policy_delay: int = 1
    target_entropy: float = -1.0
    temperature: float = 1.0
    mirror: bool = False
    averaging: float = 0.0
    steps: int = 1_000_000

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        if self.learner not in ("sb3", "sbx"):
            raise ValueError(f"preset setting learner={self.learner!r} is not sb3 or sbx")
        if not self.layers or not all(isinstance(size, int) and size >= 1 for size in self.layers):
            raise ValueError(f"preset setting layers={self.layers!r} must be sizes of at least 1")
        for name in ("environments", "updates", "batch_size", "buffer_size", "policy_delay", "steps"):
            check_number(name, getattr(self, name), 1, math.inf)
        check_number("learning_starts", self.learning_starts, 0, math.inf)
        for name in ("learning_rate", "final_learning_rate", "gamma", "tau", "averaging"):
            check_number(name, getattr(self, name), 0.0, 1.0)
        check_number("target_entropy", self.target_entropy)
        for name in ("learning_rate", "tau", "temperature"):
            check_positive(name, getattr(self, name))
        if self.averaging == 1.0:
            raise ValueError("preset setting averaging=1.0 would never take in the actor")
