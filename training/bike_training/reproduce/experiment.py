"""What an experiment learns: settings, seeds and steps, as a sweep."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from bike_training.sweeps.spec import Sweep, sweep_from_document


@dataclass(frozen=True, kw_only=True)
class Experiment(ABC):
    """What is done.

    Attributes:
        settings: that are learned, by name. seeds: of the runs of each setting. steps: most learning steps of a run.
    """

    settings: tuple[str, ...]
    seeds: tuple[int, ...] = tuple(range(5))
    steps: int

    @property
    @abstractmethod
    def title(self) -> str:
        """Name of the sweep."""

    @abstractmethod
    def base(self) -> dict[str, Any]:
        """Return the entries of every run, in a sweep."""

    @abstractmethod
    def entries(self, setting: str) -> dict[str, Any]:
        """Return the entries of the runs of a setting."""

    def named(self) -> list[tuple[str, int]]:
        """Return setting and seed of every run, one seed of all settings first: what is interrupted shows them all."""
        return [(name, seed) for seed in self.seeds for name in self.settings]

    def document(self) -> dict[str, Any]:
        """Return the file of the sweep that learns it all; its runs are in the order of `named`."""
        runs = [self.entries(name) | {"seed": seed} for name, seed in self.named()]
        return {"name": self.title, "task": "train", "base": self.base(), "runs": runs}

    def sweep(self) -> Sweep:
        """Return the sweep."""
        return sweep_from_document(self.document(), self.title)
