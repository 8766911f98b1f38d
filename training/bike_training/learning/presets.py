"""Presets: task, curriculum and learner of a run, one frozen record each, with one form in YAML and JSON."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, Final

from bike_policy.contract.observation import ObservationLayout
from bike_sim.documents import DocumentError, alternatives, check_name, parse_yaml, read_text, show
from bike_training.curricula.base import CurriculumSettings
from bike_training.curricula.parts import PartsSettings
from bike_training.curricula.race import RaceCurriculumSettings
from bike_training.curricula.rivals import RivalsSettings, SpdlRivalsSettings
from bike_training.curricula.spdl import ScheduleSettings, SpdlSettings, TargetSettings
from bike_training.settings import (
    AT_LEAST_0,
    AT_LEAST_1,
    POSITIVE,
    Settings,
    change_plain,
    check_choice,
    check_number,
    from_plain,
    to_plain,
)
from bike_training.tasks.path import TASKS, PathTask
from bike_training.tasks.race import RaceTask

LARGEST_SEED: Final = 2**32 - 1
"""The generators of the learner take no larger one."""
SUFFIX: Final = ".yaml"
MOST_AVERAGING: Final = (0.0, 0.999999)
"""Limits of the share that an average keeps: 1 would never take in the actor."""


SAC_LEARNERS: Final = ("sb3", "sbx", "ppo", "a2c")


@dataclass(frozen=True, kw_only=True)
class SacSettings(Settings):
    """Settings of soft actor-critic (Haarnoja et al. 2018), and of what goes with it here.

    Attributes:
        learner: ``sb3`` (Stable-Baselines3, torch) or ``sbx`` (its sibling in JAX); ``ppo`` and ``a2c`` of
            Stable-Baselines3 take environments, layers, learning rates, discount and averaging; the rest is theirs.
        environments: vehicles that ride side by side.
        updates: gradient updates after each step of all vehicles.
        layers: hidden layers of actor and critics.
        layer_norm: normalise the critics' hidden layers (sbx only).
        precondition: networks see observations in coordinates of order one, see `preconditioning` (sbx only).
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
        rounds: of imitation of a teacher that is told the world, before the first step, see `imitation` (sbx only).
        anchor: weight of the squared distance of the mean action from that of the imitating actor, in units of reward.
        critic_steps: steps with that actor in which the critics learn alone.
        steps: learning steps in all.
    """

    place = "learner"
    limits: ClassVar = {
        **dict.fromkeys(("rounds", "anchor", "critic_steps"), AT_LEAST_0),
        **dict.fromkeys(("environments", "updates", "batch_size", "buffer_size", "policy_delay", "steps"), AT_LEAST_1),
        "learning_starts": AT_LEAST_0,
        **dict.fromkeys(("learning_rate", "tau"), (POSITIVE[0], 1.0)),
        **dict.fromkeys(("final_learning_rate", "gamma"), (0.0, 1.0)),
        "averaging": MOST_AVERAGING,
        "target_entropy": (-math.inf, math.inf),
        "temperature": POSITIVE,
    }

    learner: str = "sb3"
    environments: int = 1
    updates: int = 1
    layers: tuple[int, ...] = (256, 256)
    layer_norm: bool = False
    precondition: bool = False
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
    rounds: int = 0
    anchor: float = 0.0
    critic_steps: int = 0
    steps: int = 1_000_000

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        check_choice("learner.learner", self.learner, SAC_LEARNERS)
        if self.rounds and self.learner != "sbx":
            raise ValueError(f"setting learner.rounds={self.rounds} needs the learner sbx, not {self.learner}")
        for name in ("anchor", "critic_steps"):
            if getattr(self, name) and not self.rounds:
                raise ValueError(f"setting learner.{name}={getattr(self, name)!r} needs learner.rounds of imitation")
        _check_layers(self.layers)


@dataclass(frozen=True, kw_only=True)
class GradientSettings(Settings):
    """Settings of learning through the derivatives of rides, see `bike_training.learning.gradients`.

    Attributes:
        learner: ``gradients``.
        layers: hidden layers of the network, which is ridden as the odd part of itself, twice as wide.
        bicycles: that ride side by side.
        periods: control periods of a segment.
        tail: of them those in which the actor is held.
        updates: of the actor with each segment.
        segments: in all.
        learning_rate: at the beginning.
        final_learning_rate: reached in the end along a half cosine.
        averaging: share of the averaged actor kept in an update; the average is what is compared and deployed.
        knee: d of the cost, m.
        square: a of the cost, 1/m^2.
        steer_rate: b of the cost, s^2/rad^2.
        change: c of the cost.
        lean: weight of the squared roll beyond 38 deg, 1/rad^2: a ride fails at 45.
        steer: weight of the squared steering angle beyond 40 deg, 1/rad^2: a little further the fork of a leaning
            bicycle turns over, whatever the drive does.
        risky: weight that rides get besides that of every ride which lean beyond 38 deg or fail. A fall ends what its
            ride costs, so without it falls count no more than a swing on a straight.
        push: rates that pushes leave in the rides, rad/s.
        impulse: largest sideways push on a half of the rides, N s. Where it is not 0, a quarter of the rides are SLOW
            and actors are compared under pushes as well.
        steep: share of the bicycles that begin each segment on STEEP. Where it is not 0, actors are compared on such
            starts as well.
        select_every: segments between two comparisons of actors.
    """

    place = "learner"
    limits: ClassVar = {
        **dict.fromkeys(("bicycles", "periods", "updates", "segments", "select_every"), AT_LEAST_1),
        "steep": (0.0, 1.0),
        "averaging": MOST_AVERAGING,
        **dict.fromkeys(("learning_rate", "final_learning_rate", "knee"), POSITIVE),
        **dict.fromkeys(("square", "steer_rate", "change", "lean", "steer", "risky"), AT_LEAST_0),
        **dict.fromkeys(("push", "impulse"), AT_LEAST_0),
    }

    learner: str = "gradients"
    layers: tuple[int, ...] = (64, 64)
    bicycles: int = 64
    periods: int = 120
    tail: int = 40
    updates: int = 20
    segments: int = 300
    learning_rate: float = 2e-3
    final_learning_rate: float = 1e-5
    averaging: float = 0.998
    knee: float = 0.005
    square: float = 1.0
    steer_rate: float = 0.002
    change: float = 1.0
    lean: float = 20.0
    steer: float = 0.0
    risky: float = 0.0
    push: float = 0.1
    impulse: float = 0.0
    steep: float = 0.0
    select_every: int = 25

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        _check_layers(self.layers)
        check_number("learner.tail", self.tail, 0, self.periods - 1)


def _check_layers(layers: tuple[int, ...]) -> None:
    if not layers or not all(isinstance(size, int) and size >= 1 for size in layers):
        raise ValueError(f"setting learner.layers={layers!r} must be sizes of at least 1")


KINDS: Final[Mapping[str, Mapping[str, type[Any]]]] = {
    "task": {**dict.fromkeys(TASKS, PathTask), "race": RaceTask},
    "curriculum": {
        "parts": PartsSettings,
        "none": RaceCurriculumSettings,
        "spdl": SpdlSettings,
        "target": TargetSettings,
        "schedule": ScheduleSettings,
        "rivals": RivalsSettings,
        "spdl_rivals": SpdlRivalsSettings,
    },
    "learner": {**dict.fromkeys(SAC_LEARNERS, SacSettings), "gradients": GradientSettings},
}
"""Records by place and by the name of their kind, which they hold under the name of their place."""


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Task, order and method of a run.

    Attributes:
        name: name of the preset.
        task: settings of the task.
        curriculum: settings of the curriculum.
        learner: settings of the learner.
    """

    name: str
    task: PathTask | RaceTask
    curriculum: CurriculumSettings
    learner: SacSettings | GradientSettings

    def __post_init__(self) -> None:
        """Refuse settings that mean nothing together.

        Raises:
            ValueError: a curriculum for a learner that has rides of its own, or of races for a task that sees nobody.
        """
        if isinstance(self.learner, GradientSettings) and self.curriculum != PartsSettings():
            raise ValueError(f"learner {self.learner.learner} rides rides of its own: it takes no curriculum")
        if isinstance(self.curriculum, RivalsSettings) and not self.task.layout.sees_others:
            raise ValueError(
                f"curriculum rivals is of races: task.observation={self.task.layout.name!r} cannot see others, and "
                "wheel_to_wheel can"
            )

    @property
    def sac(self) -> SacSettings:
        """Settings of soft actor-critic.

        Raises:
            ValueError: another learner.
        """
        if not isinstance(self.learner, SacSettings):
            raise ValueError(f"preset {self.name!r} learns by {self.learner.learner}, which has no such settings")
        return self.learner

    @property
    def published(self) -> bool:
        """Whether this is one of the paper's: its file leaves curriculum and learner, but for steps, as by default.

        Of these the last actor that passed a validation is deployed.
        """
        own = load_preset(self.name) if self.name in preset_names() else None
        learner = None if own is None else own.learner
        if own is None or not isinstance(learner, SacSettings):
            return False
        return own.curriculum == PartsSettings() and learner == SacSettings(steps=learner.steps)

    @property
    def deployed_layout(self) -> ObservationLayout:
        """Observation of a deployed actor: in races, of the part of the planned speed that is asked in the end."""
        layout = self.task.layout
        return replace(layout, share=getattr(self.curriculum, "share", 1.0)) if layout.races else layout

    def to_plain(self) -> dict[str, Any]:
        """Return plain values that :meth:`from_plain` reads."""
        return to_plain(self)

    @classmethod
    def from_plain(cls, stored: Any, name: str | None = None) -> Preset:
        """Read settings; what a record leaves out has its default.

        Args:
            stored: a table with the tables task, curriculum and learner.
            name: of the preset; None where the table holds it.

        Raises:
            ValueError: an entry is missing, unknown, of another kind, or means nothing.
        """
        if not isinstance(stored, Mapping):
            raise ValueError(f"a preset must be a table of settings, got {show(stored)}")
        unknown = sorted(set(map(str, stored)) - {"name", *KINDS})
        if unknown:
            raise ValueError(f"a preset has no setting {show(unknown[0])}; {alternatives(unknown[0], KINDS)}")
        records = {place: _record(place, stored.get(place, {})) for place in KINDS}
        return cls(name=check_name(stored.get("name") if name is None else name, "name of a preset"), **records)

    def changed(self, changes: Mapping[str, Any]) -> Preset:
        """Return a copy with settings changed.

        Args:
            changes: values by path, as ``learner.gamma``, in plain form or as text of a command line. ``task``,
                ``curriculum`` and ``learner`` alone change the kind: what the new kind has too, and was not left as
                it is by default, stays.

        Raises:
            ValueError: an unknown setting, or a value that means nothing.
        """
        plain = self.to_plain()
        for place in KINDS:
            if place in changes:
                plain[place] = _of_kind(place, plain[place], changes[place])
        for path, value in changes.items():
            if path not in KINDS:
                change_plain(plain, path, value, "a preset")
        return Preset.from_plain(plain)


def _record(place: str, stored: Any) -> Any:
    """Return a record of a place.

    Raises:
        ValueError: an unknown kind, or see `from_plain`.
    """
    if not isinstance(stored, Mapping):
        raise ValueError(f"{place} must be a table of settings, got {show(stored)}")
    kinds = KINDS[place]
    kind = stored.get(place, next(iter(kinds)))
    check_choice(place, kind, kinds)
    return from_plain(kinds[kind], stored, place)


def _of_kind(place: str, plain: Mapping[str, Any], kind: Any) -> dict[str, Any]:
    """Return settings for another kind, with what is not as it is by default."""
    default = to_plain(_record(place, {place: plain[place]}))
    check_choice(place, kind, KINDS[place])
    known = {spec.name for spec in fields(KINDS[place][kind])}
    kept = {name: value for name, value in plain.items() if name in known and value != default[name]}
    return to_plain(_record(place, {**kept, place: kind}))


@functools.cache
def preset_names() -> tuple[str, ...]:
    """Return the names of the shipped presets."""
    folder = resources.files("bike_training") / "presets"
    return tuple(sorted(file.name.removesuffix(SUFFIX) for file in folder.iterdir() if file.name.endswith(SUFFIX)))


@functools.cache
def load_preset(name: str) -> Preset:
    """Return a preset.

    Args:
        name: of a shipped one, or path of a YAML file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: an unknown name, or a file with what is not a preset.
    """
    if name not in preset_names() and not name.endswith(SUFFIX):
        raise ValueError(f"preset {show(name)} is no {SUFFIX} file; {alternatives(name, preset_names())}")
    shipped = Path(str(resources.files("bike_training"))) / "presets" / f"{name}{SUFFIX}"
    path = Path(name) if name.endswith(SUFFIX) else shipped
    try:
        return Preset.from_plain(parse_yaml(read_text(path, 100_000)), path.stem)
    except DocumentError as error:
        raise ValueError(f"{path} {error}") from error
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
