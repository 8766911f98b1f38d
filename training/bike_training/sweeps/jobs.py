"""Kinds of runs of a sweep: trainings, evaluations and laps. A new kind is a class as below and an entry in JOBS.

Its class attributes are the processor cores and the main memory (GB) that a run needs, and the axis of its curves with
its unit. ``from_entries`` checks the entries of a run, on which its result depends alone; ``estimate`` returns the
processor time that it takes, s, from measured costs; ``run`` does it in a folder, or goes on with what is there, and
returns plain figures and whether a signal interrupted it; ``curve`` returns rows of quantity, place on the axis, and
value.
"""

from __future__ import annotations

import csv
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_policy.riders.classical import CLASSICAL
from bike_policy.riders.rider import bundle_of, make_rider
from bike_sim.course import files as course_files
from bike_sim.course.random_courses import seed_of
from bike_sim.documents import show
from bike_sim.physics.engines import ENGINE_KINDS, SUPERBIKE_ENGINES
from bike_sim.sim.config import SimulatorConfig
from bike_sim.vehicles import files as vehicle_files
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, check_whole
from bike_training.envs.clients import CLIENT_KINDS, make_client
from bike_training.learning import presets
from bike_training.learning.run_settings import RECORD_ENDS, RunSettings, with_simulator
from bike_training.learning.run_settings import SUPERBIKE_ENGINES as LEARNING_ENGINES
from bike_training.rollout.evaluation import SPEEDS, evaluate
from bike_training.rollout.laps import pair_figures, ride_laps
from bike_training.rollout.rollout import ride_through

if TYPE_CHECKING:
    from bike_training.learning.process import LearningProcess  # needs the learning packages

Report = Callable[[float, float, str], None]
"""Called with the work done, the whole work in the same unit, and a text for people."""

# The runs of a sweep share most of what they name.
load_vehicle = cache(vehicle_files.load_vehicle)
load_course = cache(course_files.load_course)
load_preset = cache(presets.load_preset)
load_rider = cache(make_rider)


@cache
def check_circuit(name: str) -> None:
    """Check that there is a circuit; a random one is not drawn, because any seed has one.

    Raises:
        ValueError: it is not a circuit.
        FileNotFoundError: there is none.
    """
    if seed_of(name) is None:
        course_files.load_track(name)


def check_kinds(task: str, entries: Mapping[str, Any], kinds: Mapping[str, tuple[type, ...]]) -> None:
    """Check names and kinds of the entries of a run.

    Args:
        task: its task.
        entries: as the file has them.
        kinds: what each may be.

    Raises:
        ValueError: naming the entry and its value.
    """
    for name, value in entries.items():
        if name not in kinds:
            raise ValueError(f"task {task} has no entry {name!r}; it has {', '.join(sorted(kinds))}")
        wanted = kinds[name]
        if not isinstance(value, wanted) or (isinstance(value, bool) and bool not in wanted):
            named = " or ".join(kind.__name__ for kind in wanted)
            raise ValueError(f"{name} must be {named}, got {show(value)}")


_TRAIN_KINDS: Final[Mapping[str, tuple[type, ...]]] = {
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

LEARNING_START_SECONDS: Final = 14.0
"""Processor time until the first step: packages are loaded and updates compiled, s."""
STEP_SECONDS: Final = {"local": 1.5e-4, "ros": 1.2e-3}
"""Processor time of a step of one vehicle, by client, s."""
UPDATE_SECONDS: Final = {"sbx": 1.1e-3, "sb3": 6.0e-3}
"""Processor time of an update with the default networks and batch, by learner, s. Rough estimate."""


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
        preset = load_preset(entries.get("preset", "fast")).changed(entries.get("set", {}))
        if "steps" in entries:
            preset = preset.changed({"learner.steps": entries["steps"]})
        chosen = {
            key: entries[key]
            for key in ("vehicle", "seed", "until_finished", "checkpoint_every", "record_every", "keep_every")
            if key in entries
        }
        begun = RunSettings(preset, **{"record_every": RECORD_ENDS, **chosen})
        if begun.superbike:
            begun = replace(begun, engine=LEARNING_ENGINES["local"])
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
        return LEARNING_START_SECONDS + steps * (STEP_SECONDS[self.settings.client] + update)

    def run(self, folder: Path, report: Report) -> tuple[dict[str, Any], bool]:
        """Learn, or go on from the checkpoint in the folder."""
        from bike_training.learning.checkpoint import find_checkpoint
        from bike_training.learning.run import run

        def watch(process: LearningProcess) -> None:
            steps = process.model.num_timesteps
            report(steps, self.settings.expected_steps(steps), process.words())

        summary = run(self.settings, folder, watch, resume=find_checkpoint(folder) is not None)
        return {name: summary[name] for name in _KEPT if name in summary}, summary["interrupted"]

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


FIGURES_FILE: Final = "figures.json"

_EVALUATE_KINDS: Final[Mapping[str, tuple[type, ...]]] = {
    **dict.fromkeys(("policy", "course", "client", "vehicle", "engine"), (str,)),
    "speeds": (list,),
    "random_rides": (int,),
    "seed": (int,),
    "time_step": (int, float),
}

START_SECONDS: Final = 6.0
"""Processor time until the first ride: packages and kernels are loaded, s."""
RIDE_SECONDS: Final = {"pybullet": 1.5, "whipple": 0.4}
"""Processor time of a ride of an evaluation at a step of 1 ms, by engine, s. Rough estimate."""
LAP_SECONDS: Final = 30.0
"""Processor time of a lap of a superbike, s."""
LINE_SECONDS: Final = 20.0
"""Processor time of the line of one machine on one circuit, where it is not in the cache yet, s."""


class RidingJob(ABC):
    """Rides whose figures stay in the folder of the run; curves are drawn from them."""

    cores: ClassVar[float] = 1.0

    @abstractmethod
    def ride(self, report: Report) -> dict[str, Any]:
        """Ride all of it and return plain figures."""

    @staticmethod
    @abstractmethod
    def points(figures: Mapping[str, Any]) -> list[tuple[str, float, float]]:
        """Return the curves that figures hold."""

    def run(self, folder: Path, report: Report) -> tuple[dict[str, Any], bool]:
        """Ride, and keep the figures."""
        figures = self.ride(report)
        (folder / FIGURES_FILE).write_text(json.dumps(figures), encoding="utf-8")
        return {name: value for name, value in figures.items() if not isinstance(value, list | dict)}, False

    @classmethod
    def curve(cls, folder: Path) -> list[tuple[str, float, float]]:
        """Return its curves; none where it has not finished."""
        path = folder / FIGURES_FILE
        return cls.points(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else []


@dataclass(frozen=True)
class EvaluateJob(RidingJob):
    """An evaluation of a policy, as `bike evaluate`.

    Attributes:
        policy: name of a rider or bundle, or folder of one.
        course: the fixed course.
        speeds: m/s.
        random_rides: rides on random paths at each speed.
        seed: of the random paths.
        client: ``local`` or ``ros``.
        config: vehicle, engine and step.
    """

    policy: str
    course: str
    speeds: tuple[float, ...]
    random_rides: int
    seed: int
    client: str
    config: SimulatorConfig

    memory_gb: ClassVar[float] = 0.8
    axis: ClassVar[str] = "speed_m_s"

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries: those of `bike evaluate`."""
        check_kinds("evaluate", entries, _EVALUATE_KINDS)
        policy, course = entries.get("policy", DEFAULT_POLICY), entries.get("course", "benchmark")
        client, engine = entries.get("client", "local"), entries.get("engine", "pybullet")
        for name, value, known in (("client", client, CLIENT_KINDS), ("engine", engine, ENGINE_KINDS)):
            if value not in known:
                raise ValueError(f"{name} {show(value)} is not one of {', '.join(known)}")
        speeds = entries.get("speeds", list(SPEEDS))
        if not speeds or not all(isinstance(speed, int | float) and not isinstance(speed, bool) for speed in speeds):
            raise ValueError(f"speeds must be numbers, got {show(speeds)}")
        for speed in speeds:
            check_positive("speeds", speed, "m/s")
        time_step = float(entries.get("time_step", 0.001))
        check_positive("time_step", time_step, "s")
        rides, seed = entries.get("random_rides", 1), entries.get("seed", 0)
        check_whole("random_rides", rides, 0)
        check_whole("seed", seed, 0)
        config = SimulatorConfig(entries.get("vehicle", SimulatorConfig.vehicle), engine, time_step)
        load_vehicle(config.vehicle)
        load_course(course)
        bundle = bundle_of(load_rider(policy))
        if bundle is not None:
            bundle.check_fit(config.vehicle, config.control_period)
        return cls(policy, course, tuple(map(float, speeds)), rides, seed, client, config)

    def estimate(self) -> float:
        """Return the processor time that it will take, s."""
        rides = len(self.speeds) * (1 + self.random_rides)
        ride = RIDE_SECONDS.get(self.config.engine, RIDE_SECONDS["pybullet"])
        return START_SECONDS + rides * ride * 0.001 / self.config.time_step

    def ride(self, report: Report) -> dict[str, Any]:
        """Ride all of it."""
        rider, ridden = make_rider(self.policy), 0
        total = len(self.speeds) * (1 + self.random_rides)

        def tick() -> None:
            nonlocal ridden
            ridden += 1
            report(ridden, total, "")

        client = make_client(self.client, self.config)
        try:
            return evaluate(
                lambda request, longest: ride_through(client, rider, request, longest),
                self.course, self.speeds, self.random_rides, self.seed, tick,
            )  # fmt: skip
        finally:
            client.close()

    @staticmethod
    def points(figures: Mapping[str, Any]) -> list[tuple[str, float, float]]:
        """Return mean and largest distance over the speed, on the course and on random paths."""
        return [
            (f"{prefix}{name}", float(ride["speed_m_s"]), float(ride[name]))
            for prefix, key in (("", "rides"), ("random_", "random"))
            for ride in figures.get(key, [])
            for name in ("mean_m", "max_m")
        ]


@dataclass(frozen=True)
class LapJob(RidingJob):
    """Laps of a superbike, as `bike ride` on a circuit.

    Attributes:
        vehicle: name or file of a superbike.
        course: name or file of a circuit.
        laps: flying laps.
        rider: name of a rider or of a policy that races, or folder of one.
        engine: that integrates the machine.
    """

    vehicle: str
    course: str
    laps: int
    rider: str = CLASSICAL
    engine: str = SUPERBIKE_ENGINES[0]

    memory_gb: ClassVar[float] = 1.0
    axis: ClassVar[str] = "lap"

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries: those of `bike ride` on a circuit."""
        check_kinds("lap", entries, dict.fromkeys(("vehicle", "course", "rider", "engine"), (str,)) | {"laps": (int,)})
        vehicle, course = entries.get("vehicle", "panigale_v4r"), entries.get("course", "barcelona")
        laps, rider = entries.get("laps", 3), entries.get("rider", CLASSICAL)
        engine = entries.get("engine", SUPERBIKE_ENGINES[0])
        check_whole("laps", laps, 1)
        if engine not in SUPERBIKE_ENGINES:
            raise ValueError(f"engine must be one of {', '.join(SUPERBIKE_ENGINES)}, got {show(engine)}")
        if not isinstance(load_vehicle(vehicle), Superbike):
            raise ValueError(f"vehicle {show(vehicle)} is no superbike; laps are ridden on superbikes")
        check_circuit(course)
        load_rider(rider)
        return cls(vehicle, course, laps, rider, engine)

    def estimate(self) -> float:
        """Return the processor time that it will take, s."""
        return START_SECONDS + LINE_SECONDS + LAP_SECONDS * (self.laps + 1)

    def ride(self, report: Report) -> dict[str, Any]:
        """Ride the out-lap and the flying laps."""
        ridden = ride_laps(
            self.vehicle,
            self.course,
            self.laps,
            rider=make_rider(self.rider),
            engine=self.engine,
            report=lambda snapshot, length: (
                report(snapshot.progress, length * (self.laps + 1), "") if snapshot.step % 50 == 0 else None
            ),
        )
        return pair_figures(ridden, self.laps)

    @staticmethod
    def points(figures: Mapping[str, Any]) -> list[tuple[str, float, float]]:
        """Return the times of the flying laps, which begin with lap 2."""
        return [("lap_s", float(lap), float(time)) for lap, time in enumerate(figures["laps_s"], start=2)]


Job = TrainJob | EvaluateJob | LapJob
JOBS: Final[dict[str, type[TrainJob] | type[EvaluateJob] | type[LapJob]]] = {
    "train": TrainJob,
    "evaluate": EvaluateJob,
    "lap": LapJob,
}
"""Every kind of run by the name of its task."""
