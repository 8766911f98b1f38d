"""Presets: everything that decides what a run learns, in which order and how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Final

from bike_policy.contract.observation import ObservationLayout
from bike_training.learning.algorithm import Algorithm
from bike_training.learning.setting_records import check_entries, parse
from bike_training.learning.subjects import (
    CURRICULUM_SETTINGS,
    TASK_SETTINGS,
    CurriculumSettings,
    PartsSettings,
    RaceCurriculumSettings,
)
from bike_training.tasks.path import SHARP, TASKS, PathTask
from bike_training.tasks.race import GUIDED_WEIGHTS, PAPER_WEIGHTS, RaceTask

_SUBJECTS: Final = ("task", "curriculum")
"""Records inside of a preset; each holds its own name under the name of its place."""


@dataclass(frozen=True, kw_only=True)
class Preset(Algorithm):
    """Settings of the learner, with those of what it learns.

    Attributes:
        name: name of the preset.
        task: settings of the task.
        curriculum: settings of the curriculum.
    """

    name: str
    task: PathTask | RaceTask = field(default_factory=PathTask)
    curriculum: CurriculumSettings = field(default_factory=PartsSettings)

    @property
    def published(self) -> bool:
        """Whether this is one of the paper's settings, of which it deploys the last actor that passed a validation."""
        return self.name == PAPER.name or self.name in _ALTERNATIVES

    @property
    def deployed_layout(self) -> ObservationLayout:
        """What a deployed actor sees: in races, of the part of the planned speed that it is asked for in the end."""
        layout = self.task.layout
        return replace(layout, share=getattr(self.curriculum, "share", 1.0)) if layout.races else layout

    def to_card(self) -> dict[str, Any]:
        """Return plain values for a policy card."""
        card = asdict(self)
        card["layers"] = list(self.layers)
        return {"name": card.pop("name"), "task": card.pop("task"), "curriculum": card.pop("curriculum"), **card}

    @classmethod
    def from_card(cls, card: dict[str, Any]) -> Preset:
        """Read what :meth:`to_card` wrote.

        Raises:
            ValueError: an entry is missing, unknown, or of another kind.
        """
        check_entries(cls, card, needed=("name", "layers"))
        inside: dict[str, Any] = {}
        for place, kinds in zip(_SUBJECTS, (TASK_SETTINGS, CURRICULUM_SETTINGS), strict=True):
            if place not in card:
                continue
            stored = card[place]
            name = stored.get(place) if isinstance(stored, dict) else stored
            if not isinstance(stored, dict) or name not in kinds:
                raise ValueError(f"Preset: entry {place} is {name!r}, not settings of one of {', '.join(kinds)}")
            check_entries(kinds[name], stored)
            inside[place] = kinds[name](**stored)
        return cls(**{**card, **inside, "layers": tuple(card["layers"])})

    def override(self, values: Mapping[str, str]) -> Preset:
        """Return a copy with values given as text, as on a command line; a name is looked for in every record.

        Raises:
            ValueError: an unknown name or a value of the wrong kind.
        """
        preset = self
        for name, text in values.items():
            preset = preset._with(name, text)
        return preset

    def _with(self, name: str, text: str) -> Preset:
        for place in _SUBJECTS:
            record: Any = getattr(self, place)
            if name in {spec.name for spec in fields(record)}:
                changed = replace(record, **{name: parse(name, text, getattr(record, name))})
                return replace(self, **{place: changed})
        if name not in {spec.name for spec in fields(self)}:
            raise ValueError(f"preset has no setting {name!r}; it has {self.setting_names()}")
        return replace(self, **{name: parse(name, text, getattr(self, name))})

    def setting_names(self) -> list[str]:
        """Return the names of all settings, those of task and curriculum included."""
        records: tuple[Any, ...] = (self, self.task, self.curriculum)
        return sorted({spec.name for record in records for spec in fields(record)})

    def settings(self) -> dict[str, Any]:
        """Return all settings with their values, those of task and curriculum included."""
        card = self.to_card()
        inside = {name: value for place in _SUBJECTS for name, value in card[place].items()}
        return {**card, **inside}


PAPER: Final = Preset(name="paper", steps=4_000_000)
"""*prop.* as published: SAC of Stable-Baselines3 with its defaults, one update a step.

Source: Weyrer et al. (2026), Sects. 4 (n_tot) and 5.1.
"""

FAST: Final = Preset(
    name="fast",
    task=PathTask(task="lean", weights=SHARP),
    curriculum=PartsSettings(refine=True),
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
)
"""The default: many bicycles, small networks, mirrored replay, little noise and a reward that is sharp at the path.

Why each of them was chosen is in docs/training.md, what came of them in docs/results.md.
"""

QUICK: Final = replace(
    FAST,
    name="quick",
    curriculum=PartsSettings(refine=True, sharp=True, last_speeds=126),
    environments=2,
    updates=4,
    learning_rate=1.5e-3,
    steps=90_000,
)
"""Finishes the curriculum in the fewest steps, with an actor that rides every speed; `FAST` ends more exactly.

Validations are asked for by whole episodes of 1,200 steps, so two bicycles wait a quarter as long for one as eight.
"""

RACE_DIRECT: Final = Preset(
    name="race_direct",
    task=RaceTask(),
    curriculum=RaceCurriculumSettings(spread=0.1, failure_share=0.25, validate_every=20_000, select_every=50_000),
    learner="sbx",
    environments=32,
    updates=8,
    layers=(64, 64),
    layer_norm=True,
    batch_size=256,
    learning_rate=5e-4,
    final_learning_rate=5e-5,
    gamma=0.98,
    learning_starts=2000,
    policy_delay=2,
    target_entropy=-6.0,
    mirror=True,
    averaging=0.999,
    steps=500_000,
)
"""Superbikes without a guide: many machines in one compiled loop, a compact observation, calm commands."""

RACE: Final = replace(
    RACE_DIRECT,
    name="race",
    task=RaceTask(observation="guided", guided=True, weights=GUIDED_WEIGHTS, repeat=10, max_steps=200),
    curriculum=RaceCurriculumSettings(failure_share=0.25, validate_every=20_000, select_every=50_000),
    updates=16,
    layers=(128, 128),
    gamma=0.95,
    temperature=0.02,
    target_entropy=-1.0,
    steps=200_000,
)
"""The default of superbikes: line and pace of a guide, decided every 0.2 s and rewarded by lap time.

Its noise is large (a target entropy of -1 instead of -6), for the guide smooths it: with less, actors ran into the
ends of their range before the critics could tell one action from another.
"""

RACE_PAPER: Final = Preset(
    name="race_paper",
    task=RaceTask(observation="paper_race", weights=PAPER_WEIGHTS, repeat=1, max_steps=1500, masked=False),
    curriculum=RaceCurriculumSettings(curriculum="spdl"),
    environments=10,
    updates=10,
    batch_size=512,
    steps=9_500_000,
)
"""The superbike paper: SAC of Stable-Baselines3, batches of 512, 10 environments (VI-A), its observation and reward.

Its learning rate and the size of its replay buffer could not be read; they are Stable-Baselines3's.
"""

_ALTERNATIVES: Final[dict[str, Preset]] = {
    name: replace(PAPER, name=name, task=PathTask(task=name)) for name in TASKS if name.startswith("alt")
}

PRESETS: Final[dict[str, Preset]] = {
    "paper": PAPER,
    "fast": FAST,
    "quick": QUICK,
    "race": RACE,
    "race_direct": RACE_DIRECT,
    "race_paper": RACE_PAPER,
    **_ALTERNATIVES,
}
"""All presets by name; alt1 to alt5 are the paper's other settings (Table 5)."""
