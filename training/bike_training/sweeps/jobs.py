"""Kinds of runs of a sweep: trainings and laps. A new kind is a class as below and an entry in JOBS.

Its class attributes are the processor cores and the main memory (GB) that a run needs, and the axis of its curves with
its unit. ``from_entries`` checks the entries of a run, on which its result depends alone; ``estimate`` returns the
processor time that it takes, s, from measured costs; ``run`` does it in a folder, or goes on with what is there, and
returns plain figures and whether a signal interrupted it; ``curve`` returns rows of quantity, place on the axis, and
value.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

from bike_policy.riders.classical import CLASSICAL
from bike_policy.riders.rider import make_rider
from bike_sim.course import files as course_files
from bike_sim.course.random_courses import seed_of
from bike_sim.documents import show
from bike_sim.physics.engines import SUPERBIKE_ENGINES
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles import files as vehicle_files
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_whole
from bike_training.learning.run_settings import RECORD_ENDS, RunSettings, settings_of
from bike_training.rollout.laps import ride_laps

if TYPE_CHECKING:
    from bike_training.learning.process import LearningProcess  # needs the learning packages

Report = Callable[[float, float, str], None]
"""Called with the work done, the whole work in the same unit, and a text for people."""

# The runs of a sweep share most of what they name.
load_vehicle = cache(vehicle_files.load_vehicle)
load_track = cache(course_files.load_track)
load_rider = cache(make_rider)


def check_kinds(task: str, entries: Mapping[str, Any], kinds: Mapping[str, type | UnionType]) -> None:
    """Check names and kinds of the entries of a run.

    Raises:
        ValueError: naming the entry and its value.
    """
    for name, value in entries.items():
        if name not in kinds:
            raise ValueError(f"task {task} has no entry {name!r}; it has {', '.join(sorted(kinds))}")
        wanted = kinds[name]
        if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool):
            named = getattr(wanted, "__name__", str(wanted).replace(" |", " or"))
            raise ValueError(f"{name} must be {named}, got {show(value)}")


_TRAIN_KINDS: Final[Mapping[str, type | UnionType]] = {
    **dict.fromkeys(("vehicle", "preset", "client", "engine"), str),
    **dict.fromkeys(("simulators", "seed", "steps", "checkpoint_every", "record_every", "keep_every"), int),
    **{"set": dict, "until_finished": bool, "time_step": int | float},
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

_VALIDATION_COLUMNS: Final = ("mean_error_m", "max_error_m", "mean_excess", "max_excess", "part", "seconds")
_EPISODE_COLUMNS: Final = {"rollout/ep_len_mean": "episode_steps", "rollout/ep_rew_mean": "episode_return"}

LEARNING_START_SECONDS: Final = 14.0
"""Processor time until the first step: packages are loaded and updates compiled, s."""
STEP_SECONDS: Final = {"local": 1.5e-4, "ros": 1.2e-3}
"""Processor time of a step of one vehicle, by client, s."""
UPDATE_SECONDS: Final = {"sbx": 1.1e-3, "sb3": 6.0e-3, "ppo": 4.0e-4, "a2c": 2.0e-4}
"""Processor time of an update with the default networks and batch, by learner, s; of those without a replay buffer all
their passes over the steps of an environment. Rough estimate."""


@dataclass(frozen=True)
class TrainJob:
    """A training; the same as `bike train` with these settings, bit for bit.

    Attributes:
        settings: of the run.
    """

    settings: RunSettings

    cores: ClassVar[float] = 1.0
    memory_gb: ClassVar[float] = 1.5
    axis: ClassVar[str] = "step"

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries: those of `bike train`, with those of ``--set`` under ``set``."""
        check_kinds("train", entries, _TRAIN_KINDS)
        settings = settings_of(entries, RECORD_ENDS)
        for name in settings.machines:
            settings.preset.task.check_vehicle(load_vehicle(name))
        return cls(settings)

    def estimate(self) -> float:
        """Return the processor time that it will take, s."""
        learner, steps = self.settings.preset.sac, self.settings.expected_steps()
        update = UPDATE_SECONDS[learner.learner] * learner.updates / learner.environments
        return LEARNING_START_SECONDS + steps * (STEP_SECONDS[self.settings.client] + update)

    def run(self, folder: Path, report: Report) -> tuple[dict[str, Any], bool]:
        """Learn, or go on from the checkpoint in the folder."""
        from bike_training.learning.checkpoint import find_checkpoint
        from bike_training.learning.process import run

        def watch(process: LearningProcess) -> None:
            steps = process.model.num_timesteps
            report(steps, self.settings.expected_steps(steps), process.words())

        summary = run(self.settings, folder, watch, resume=find_checkpoint(folder) is not None)
        return {name: summary[name] for name in _KEPT if name in summary}, summary["interrupted"]

    @staticmethod
    def curve(folder: Path) -> list[tuple[str, float, float]]:
        """Return validations, comparisons, and mean length and return of episodes over the learning steps."""
        rows = _columns(folder / "validations.csv", "step", {name: name for name in _VALIDATION_COLUMNS})
        episodes: list[tuple[str, float, float]] = []
        for path in sorted((folder / "tensorboard").glob("progress*.csv"), key=_began_at):
            # A session's rows take the place of those it was begun anew from.
            episodes = [row for row in episodes if row[1] <= _began_at(path)]
            episodes += _columns(path, "time/total_timesteps", _EPISODE_COLUMNS)
        rows += episodes
        with suppress(FileNotFoundError), (folder / "selection.csv").open(encoding="utf-8") as file:
            rows += [("selection_rms_m", float(step), float(error)) for step, error in csv.reader(file)]
        return rows


def _began_at(path: Path) -> int:
    """Return the learning step from which on a session wrote a table, named as `session_logger` names them."""
    number = path.stem.rpartition("_")[2]
    return int(number) if number.isdigit() else 0


def _columns(path: Path, axis: str, names: Mapping[str, str]) -> list[tuple[str, float, float]]:
    """Return named columns of a table of a run as rows of a curve; a field that is empty or cut short is left out."""
    rows: list[tuple[str, float, float]] = []
    with suppress(FileNotFoundError), path.open(encoding="utf-8", newline="") as file:
        for record in csv.DictReader(file):
            for name, quantity in names.items():
                with suppress(KeyError, TypeError, ValueError):
                    rows.append((quantity, float(record[axis]), float(record[name])))
    return rows


FIGURES_FILE: Final = "figures.json"

START_SECONDS: Final = 6.0
"""Processor time until the first ride: packages and kernels are loaded, s."""
LAP_SECONDS: Final = 30.0
"""Processor time of a lap of a superbike, s."""
LINE_SECONDS: Final = 20.0
"""Processor time of the line of one machine on one circuit, where it is not in the cache yet, s."""


@dataclass(frozen=True)
class LapJob:
    """Laps of a superbike, as `bike ride` on a circuit; entries are its options.

    Attributes:
        vehicle: name or file of a superbike.
        course: name or file of a circuit.
        laps: flying laps.
        rider: name of a rider or of a policy that races, or folder of one.
        engine: that integrates the machine.
    """

    vehicle: str = "panigale_v4r"
    course: str = "barcelona"
    laps: int = 3
    rider: str = CLASSICAL
    engine: str = SUPERBIKE_ENGINES[0]

    cores: ClassVar[float] = 1.0
    memory_gb: ClassVar[float] = 1.0
    axis: ClassVar[str] = "lap"

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries: those of `bike ride` on a circuit."""
        check_kinds("lap", entries, dict.fromkeys(("vehicle", "course", "rider", "engine"), str) | {"laps": int})
        job = cls(**entries)
        check_whole("laps", job.laps, 1)
        if job.engine not in SUPERBIKE_ENGINES:
            raise ValueError(f"engine must be one of {', '.join(SUPERBIKE_ENGINES)}, got {show(job.engine)}")
        if not isinstance(load_vehicle(job.vehicle), Superbike):
            raise ValueError(f"vehicle {show(job.vehicle)} is no superbike; laps are ridden on superbikes")
        if seed_of(job.course) is None:  # any seed has a random circuit, so that none is drawn here
            load_track(job.course)
        load_rider(job.rider)
        return job

    def estimate(self) -> float:
        """Return the processor time that it will take, s."""
        return START_SECONDS + LINE_SECONDS + LAP_SECONDS * (self.laps + 1)

    def run(self, folder: Path, report: Report) -> tuple[dict[str, Any], bool]:
        """Ride the out-lap and the flying laps, and keep the figures."""
        rider, laps = make_rider(self.rider), self.laps

        def show_place(snapshot: Snapshot, length: float) -> None:
            if snapshot.step % 50 == 0:
                report(snapshot.progress, length * (laps + 1), "")

        figures, _ = ride_laps(self.vehicle, self.course, laps, rider=rider, engine=self.engine, report=show_place)
        (folder / FIGURES_FILE).write_text(json.dumps(figures), encoding="utf-8")
        return {name: value for name, value in figures.items() if not isinstance(value, list | dict)}, False

    @staticmethod
    def curve(folder: Path) -> list[tuple[str, float, float]]:
        """Return the times of the flying laps, which begin with lap 2; none where it has not finished."""
        path = folder / FIGURES_FILE
        times = json.loads(path.read_text(encoding="utf-8"))["laps_s"] if path.is_file() else []
        return [("lap_s", float(lap), float(time)) for lap, time in enumerate(times, start=2)]


Job = TrainJob | LapJob
JOBS: Final[dict[str, type[TrainJob] | type[LapJob]]] = {"train": TrainJob, "lap": LapJob}
"""Every kind of run by the name of its task."""
