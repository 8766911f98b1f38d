"""A training as a run of a sweep."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

from bike_sim.vehicles.files import load_vehicle
from bike_training.learning.presets import load_preset
from bike_training.learning.run_settings import SUPERBIKE_ENGINES, RunSettings, with_simulator
from bike_training.sweeps.job_parts import JobEnd, Tell, check_kinds

if TYPE_CHECKING:
    from bike_training.learning.process import LearningProcess  # needs the learning packages

_KINDS: Final[Mapping[str, tuple[type, ...]]] = {
    "vehicle": (str,),
    "preset": (str,),
    "set": (dict,),
    "client": (str,),
    "engine": (str,),
    "time_step": (int, float),
    "simulators": (int,),
    "seed": (int,),
    "steps": (int,),
    "until_finished": (bool,),
    "checkpoint_every": (int,),
    "record_every": (int,),
    "keep_every": (int,),
}
_KEPT: Final = (
    "steps",
    "updates",
    "part",
    "finished_at_step",
    "finished_after_s",
    "best_step",
    "best_selection_rms_m",
    "best_selection_excess",
)
"""Entries of a run's summary that are figures of it; the rest says what it is."""

_EPISODE_COLUMNS: Final = {"rollout/ep_len_mean": "episode_steps", "rollout/ep_rew_mean": "episode_return"}

START_SECONDS: Final = 14.0
"""Processor time until the first step: packages are loaded and updates compiled, s."""
STEP_SECONDS: Final = {"local": 1.5e-4, "ros": 1.2e-3}
"""Processor time of a step of one vehicle, by client, s."""
UPDATE_SECONDS: Final = {"sbx": 1.1e-3, "sb3": 6.0e-3}
"""Processor time of an update with the default networks and batch, by learner, s. Rough estimate."""


@dataclass(frozen=True)
class TrainJob:
    """A training; the same as `bike train` with these settings, bit for bit.

    Attributes:
        settings: what it is.
        watch: called after each step of all vehicles, by a search that may stop it.
    """

    settings: RunSettings
    watch: Callable[[LearningProcess], None] | None = field(default=None, compare=False)

    cores: ClassVar[float] = 1.0
    memory_gb: ClassVar[float] = 1.5
    axis: ClassVar[str] = "step"

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries: those of `bike train`, with those of ``--set`` under ``set``."""
        check_kinds("train", entries, _KINDS)
        preset = load_preset(entries.get("preset", "fast")).changed(entries.get("set", {}))
        if "steps" in entries:
            preset = preset.changed({"learner.steps": entries["steps"]})
        chosen = {
            key: entries[key]
            for key in ("vehicle", "seed", "until_finished", "checkpoint_every", "record_every", "keep_every")
            if key in entries
        }
        begun = RunSettings(preset, **chosen)
        if begun.superbike:
            begun = replace(begun, engine=SUPERBIKE_ENGINES["local"])
        settings = with_simulator(
            begun,
            entries.get("client"),
            entries.get("engine"),
            entries.get("time_step"),
            entries.get("simulators"),
        )
        for name in settings.machines:
            preset.task.check_vehicle(load_vehicle(name))
        return cls(settings)

    def estimate(self) -> float:
        """Return the processor time that it will take, s."""
        learner, steps = self.settings.preset.sac, self.settings.expected_steps()
        update = UPDATE_SECONDS[learner.learner] * learner.updates / learner.environments
        return START_SECONDS + steps * (STEP_SECONDS[self.settings.client] + update)

    def run(self, folder: Path, tell: Tell) -> JobEnd:
        """Learn, or go on from the checkpoint in the folder."""
        from bike_training.learning.checkpoint import find_checkpoint
        from bike_training.learning.run import run

        def report(process: LearningProcess) -> None:
            if self.watch is not None:
                self.watch(process)
            steps = process.model.num_timesteps
            tell(steps, self.settings.expected_steps(steps), process.words())

        summary = run(self.settings, folder, report, resume=find_checkpoint(folder) is not None)
        return JobEnd({name: summary[name] for name in _KEPT if name in summary}, summary["interrupted"])

    @staticmethod
    def curve(folder: Path) -> list[tuple[str, float, float]]:
        """Return validations, comparisons, and mean length and return of episodes over the learning steps."""
        rows = _columns(
            folder / "validations.csv",
            "step",
            ("mean_error_m", "max_error_m", "mean_excess", "max_excess", "part", "seconds"),
        )
        rows += _episodes(folder / "tensorboard")
        with suppress(FileNotFoundError), (folder / "selection.csv").open(encoding="utf-8") as file:
            rows += [("selection_rms_m", float(step), float(error)) for step, error in csv.reader(file)]
        return rows


def _episodes(folder: Path) -> list[tuple[str, float, float]]:
    """Return mean length and return of episodes; a session's rows take the place of those it was begun anew from."""
    rows: list[tuple[str, float, float]] = []
    for path in sorted(folder.glob("progress*.csv"), key=_began_at):
        rows = [row for row in rows if row[1] <= _began_at(path)]
        rows += _columns(path, "time/total_timesteps", _EPISODE_COLUMNS, _EPISODE_COLUMNS)
    return rows


def _began_at(path: Path) -> int:
    """Return the learning step from which on a session wrote a table, named as `session_logger` names them."""
    number = path.stem.rpartition("_")[2]
    return int(number) if number.isdigit() else 0


def _columns(
    path: Path, axis: str, names: Any, renamed: Mapping[str, str] | None = None
) -> list[tuple[str, float, float]]:
    """Return columns of a table of a run as rows of a curve; a field that is empty or cut short is left out."""
    rows: list[tuple[str, float, float]] = []
    with suppress(FileNotFoundError), path.open(encoding="utf-8", newline="") as file:
        for record in csv.DictReader(file):
            for name in names:
                with suppress(KeyError, TypeError, ValueError):
                    quantity = renamed[name] if renamed else name
                    rows.append((quantity, float(record[axis]), float(record[name])))
    return rows
