"""Presets of a learning process: one frozen record of everything that decides how it learns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from typing import Any, Final, Literal

from bike_training.tasks.path import SHARP, TASKS, PathTask

LARGEST_SEED: Final = 2**32 - 1
"""The generators of the learner take no larger one."""


@dataclass(frozen=True)
class Preset:
    """Settings of the learner.

    Attributes:
        name: name of the preset.
        task: name in :data:`bike_training.tasks.path.TASKS`.
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
        weights: terms of the reward by name and their weights; empty keeps the task's.
        sharpness: width of the term ``path_peak``, m.
        refine: ride beyond the intervals of the last part once the curriculum is finished.
        steps: learning steps in all.
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
    weights: Mapping[str, float] = field(default_factory=dict)
    sharpness: float = 0.2
    refine: bool = False
    steps: int = 1_000_000

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        if self.task not in TASKS:
            raise ValueError(f"preset setting task={self.task!r} is not one of {', '.join(TASKS)}")
        if self.learner not in ("sb3", "sbx"):
            raise ValueError(f"preset setting learner={self.learner!r} is not sb3 or sbx")
        if not self.layers or not all(isinstance(size, int) and size >= 1 for size in self.layers):
            raise ValueError(f"preset setting layers={self.layers!r} must be sizes of at least 1")
        for name in ("environments", "updates", "batch_size", "buffer_size", "validate_every", "steps"):
            _check(name, getattr(self, name), 1, math.inf)
        _check("learning_starts", self.learning_starts, 0, math.inf)
        for name in ("learning_rate", "final_learning_rate", "gamma", "tau", "averaging"):
            _check(name, getattr(self, name), 0.0, 1.0)
        for name in ("target_entropy", "max_steer", "sharpness"):
            _check(name, getattr(self, name), -math.inf, math.inf)
        for name in ("learning_rate", "tau", "max_steer", "sharpness"):
            value = getattr(self, name)
            if not value > 0.0:
                raise ValueError(f"preset setting {name}={value!r} must be positive")
        if not isinstance(self.weights, Mapping):
            raise ValueError(f"preset setting weights={self.weights!r} must name reward terms and their weights")
        if self.averaging == 1.0:
            raise ValueError("preset setting averaging=1.0 would never take in the actor")
        self.make_task()

    def make_task(self) -> PathTask:
        """Return the task that this preset learns."""
        task = replace(TASKS[self.task], max_steer=self.max_steer, sharpness=self.sharpness)
        return replace(task, weights=dict(self.weights)) if self.weights else task

    def to_card(self) -> dict[str, Any]:
        """Return plain values for a policy card."""
        card = asdict(self)
        card["layers"], card["weights"] = list(self.layers), dict(self.weights)
        return card

    @classmethod
    def from_card(cls, card: dict[str, Any]) -> Preset:
        """Read what :meth:`to_card` wrote.

        Raises:
            ValueError: an entry is missing, unknown, or of another kind.
        """
        check_entries(cls, card, needed=("name", "layers"))
        return cls(**{**card, "layers": tuple(card["layers"])})

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


def check_entries(kind: type[Any], stored: Any, needed: Sequence[str]) -> None:
    """Check that stored values are those of a record of settings.

    Args:
        kind: dataclass of the record.
        stored: what was read.
        needed: entries without a default.

    Raises:
        ValueError: it is no table, or an entry is missing, unknown, or of another kind than its default.
    """
    if not isinstance(stored, dict):
        raise ValueError(f"{kind.__name__} must be a table of settings, got {type(stored).__name__}")
    defaults = {spec.name: spec.default for spec in fields(kind)}
    unknown, missing = sorted(set(stored) - set(defaults)), sorted(set(needed) - set(stored))
    if unknown or missing:
        raise ValueError(f"{kind.__name__}: unknown entries {unknown}, missing entries {missing}")
    for name, value in stored.items():
        default = defaults[name]
        wanted = (int, float) if isinstance(default, float) else list if isinstance(default, tuple) else type(default)
        if default is not MISSING and not isinstance(value, wanted):
            raise ValueError(f"{kind.__name__}: entry {name} is {value!r}, not a {type(default).__name__}")


def _check(name: str, value: float, least: float, most: float) -> None:
    if math.isnan(value) or not least <= value <= most or math.isinf(value):
        wanted = "finite" if math.isinf(least) else f"at least {least:g}"
        if math.isfinite(most):
            wanted = f"{least:g} to {most:g}"
        raise ValueError(f"preset setting {name}={value!r} must be {wanted}")


def _parse(name: str, text: str, current: Any) -> Any:
    try:
        if isinstance(current, bool):
            return {"true": True, "false": False}[text.lower()]
        if isinstance(current, tuple):
            return tuple(int(part) for part in text.split(","))
        if isinstance(current, Mapping):
            return {name: float(weight) for name, _, weight in (part.partition(":") for part in text.split(","))}
        return type(current)(text)
    except (KeyError, ValueError) as error:
        kind = "list like 64,64" if isinstance(current, tuple) else type(current).__name__
        if isinstance(current, Mapping):
            kind = "list like path_linear:0.5,path_peak:0.5"
        raise ValueError(f"preset setting {name}={text!r} is not a {kind}") from error


PAPER: Final = Preset("paper", steps=4_000_000)
"""*prop.* as published: SAC of Stable-Baselines3 with its defaults, one update a step.

Source: Weyrer et al. (2026), Sects. 4 (n_tot) and 5.1.
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
    weights=SHARP,
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
