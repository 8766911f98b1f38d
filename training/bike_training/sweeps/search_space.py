"""What a search looks through: settings with their ranges, and what is good."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

from bike_sim.documents import show
from bike_training.sweeps.training_job import TrainJob

KINDS: Final = ("uniform", "loguniform", "randint", "choice")
METRICS: Final = {"advance": "max", "mean_error_m": "min", "episode_steps": "max"}
"""What can be searched for, and which way it is better.

``advance`` orders runs by how far they came: the part of the curriculum with the mean share of an episode that is
ridden, and once the curriculum is finished the share of the steps that were left.
"""
_KEYS: Final = {"settings", "trials", "metric", "seed", "grace_steps", "reduction"}
LARGEST_SPACE: Final = 12
"""Settings of a search; it is meant for a handful."""


@dataclass(frozen=True)
class SearchSpace:
    """A search.

    Attributes:
        settings: name of a preset's setting, with a kind of KINDS and its limits or choices.
        trials: runs in all.
        metric: name in METRICS.
        seed: of the sampler.
        grace_steps: learning steps that every run may make.
        reduction: one run of so many goes on at each rung (ASHA, Li et al. 2020).
    """

    settings: Mapping[str, tuple[str, tuple[Any, ...]]]
    trials: int = 20
    metric: str = "advance"
    seed: int = 0
    grace_steps: int = 20_000
    reduction: int = 3

    @classmethod
    def from_document(cls, document: Any) -> Self:
        """Read the entry ``search`` of a sweep.

        Raises:
            ValueError: naming what is wrong.
        """
        if not isinstance(document, dict) or not document.get("settings"):
            raise ValueError(f"search must be a table with settings, got {show(document)}")
        unknown = sorted(set(map(str, document)) - _KEYS)
        if unknown:
            raise ValueError(f"search has no entry {unknown[0]!r}; it has {', '.join(sorted(_KEYS))}")
        table = document["settings"]
        if not isinstance(table, dict) or len(table) > LARGEST_SPACE:
            raise ValueError(f"search settings must be a table of at most {LARGEST_SPACE}, got {show(table)}")
        for name, least in (("trials", 1), ("seed", 0), ("grace_steps", 1), ("reduction", 2)):
            value = document.get(name, least)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise ValueError(f"search {name} must be a whole number of at least {least}, got {show(value)}")
        metric = document.get("metric", "advance")
        if metric not in METRICS:
            raise ValueError(f"search metric {show(metric)} is not one of {', '.join(METRICS)}")
        settings = {str(name): _range(str(name), entry) for name, entry in table.items()}
        return cls(settings, **{name: value for name, value in document.items() if name != "settings"})

    def check(self, entries: Mapping[str, Any]) -> None:
        """Check that the run that is searched takes both ends of every range.

        Args:
            entries: of the training whose settings are searched.

        Raises:
            ValueError: naming the setting.
        """
        for name, (kind, values) in self.settings.items():
            if kind != "choice":
                values = (values[0], values[1] - 1 if kind == "randint" else values[1])
            for value in values:
                TrainJob.from_entries(with_settings(entries, {name: value}))


def with_settings(entries: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a training with settings of its preset changed."""
    return {**entries, "set": {**entries.get("set", {}), **settings}}


def _range(name: str, entry: Any) -> tuple[str, tuple[Any, ...]]:
    if not isinstance(entry, dict) or len(entry) != 1 or next(iter(entry)) not in KINDS:
        raise ValueError(f"search setting {name} must be one of {', '.join(KINDS)} with its values, got {show(entry)}")
    kind, values = next(iter(entry.items()))
    if not isinstance(values, list) or not values:
        raise ValueError(f"search setting {name}: {kind} must be a list of values, got {show(values)}")
    if kind == "choice":
        return kind, tuple(values)
    numbers = [value for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
    low = numbers[0] if numbers else math.nan
    if len(values) != 2 or len(numbers) != 2 or not low < numbers[1] or (kind == "loguniform" and not low > 0.0):
        raise ValueError(f"search setting {name}: {kind} must be its lower and its upper end, got {show(values)}")
    return kind, tuple(numbers)
