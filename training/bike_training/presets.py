"""Presets of a learning process: one frozen record of everything that decides how it learns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, Literal

from bike_training.task import TASKS, Task


@dataclass(frozen=True)
class Preset:
    """Settings of the learner.

    Attributes:
        name: name of the preset.
        task: name in :data:`bike_training.task.TASKS`.
        learner: ``sb3`` (Stable-Baselines3, torch) or ``sbx`` (its sibling in JAX).
        environments: bicycles that ride side by side.
        updates: gradient updates after each step of all bicycles.
        layers: hidden layers of actor and critics.
        layer_norm: normalise the critics' hidden layers (sbx only).
        batch_size: transitions of an update.
        learning_rate: of actor, critics and temperature.
        final_learning_rate: reached linearly at the end of the run.
        gamma: discount of a control step.
        tau: share of the critics that their targets take over in an update.
        buffer_size: transitions kept.
        learning_starts: steps with random actions before the first update.
        target_entropy: entropy that the temperature is tuned to, nat; smaller means less noise.
        mirror: learn each transition as often mirrored left to right as it happened.
        averaging: share of the averaged actor kept in an update of the average; 0 deploys the actor itself.
        validate_every: least learning steps between two validations.
        max_steer: steering set value of action 1, rad.
        reward: overrides the task's reward; empty keeps it.
        sharpness: width of the ``sharp`` reward's peak, m.
        refine: ride beyond the intervals of the last part once the curriculum is finished.
    """

    name: str
    task: str = "prop"
    learner: Literal["sb3", "sbx"] = "sb3"
    environments: int = 1
    updates: int = 1
    layers: tuple[int, ...] = (256, 256)
    layer_norm: bool = False
    batch_size: int = 256
    learning_rate: float = 3e-4
    final_learning_rate: float = 3e-4
    gamma: float = 0.99
    tau: float = 0.005
    buffer_size: int = 1_000_000
    learning_starts: int = 100
    target_entropy: float = -1.0
    mirror: bool = False
    averaging: float = 0.0
    validate_every: int = 4000
    max_steer: float = math.radians(70.0)
    reward: str = ""
    sharpness: float = 0.2
    refine: bool = False

    def make_task(self) -> Task:
        """Return the task that this preset learns."""
        task = replace(TASKS[self.task], max_steer=self.max_steer, sharpness=self.sharpness)
        return replace(task, reward=self.reward) if self.reward else task  # type: ignore[arg-type]

    def to_card(self) -> dict[str, Any]:
        """Return plain values for a policy card."""
        card = asdict(self)
        card["layers"] = list(self.layers)
        return card

    def override(self, values: Mapping[str, str]) -> Preset:
        """Return a copy with values given as text, as on a command line.

        Raises:
            ValueError: an unknown name or a value of the wrong kind.
        """
        known = {spec.name: spec for spec in fields(self)}
        changed: dict[str, Any] = {}
        for name, text in values.items():
            if name not in known:
                raise ValueError(f"preset has no setting {name!r}; it has {sorted(known)}")
            changed[name] = _parse(name, text, getattr(self, name))
        return replace(self, **changed)


def _parse(name: str, text: str, current: Any) -> Any:
    try:
        if isinstance(current, bool):
            return {"true": True, "false": False}[text.lower()]
        if isinstance(current, tuple):
            return tuple(int(part) for part in text.split(","))
        return type(current)(text)
    except (KeyError, ValueError) as error:
        raise ValueError(f"preset setting {name}={text!r} is not a {type(current).__name__}") from error


PAPER: Final = Preset("paper")
"""*prop.* as published: SAC of Stable-Baselines3 with its defaults, one update a step.

Source: Weyrer et al. (2026), Sect. 5.1.
"""

FAST: Final = Preset(
    "fast",
    task="lean",
    learner="sbx",
    environments=8,
    updates=8,
    layers=(64, 64),
    final_learning_rate=1e-5,
    gamma=0.97,
    learning_starts=2000,
    target_entropy=-3.0,
    mirror=True,
    averaging=0.999,
    reward="sharp",
    refine=True,
)
"""The default: many bicycles, small networks, mirrored replay, little noise and a reward that is sharp at the path.

Why each of them was chosen is in docs/training.md, what came of them in docs/results.md.
"""

PRESETS: Final[dict[str, Preset]] = {
    "paper": PAPER,
    "fast": FAST,
    **{name: replace(PAPER, name=name, task=name) for name in ("alt1", "alt2", "alt3", "alt4", "alt5")},
}
"""All presets by name; alt1 to alt5 are the paper's other settings (Table 5)."""
