"""The experiments of the superbike paper (Sect. VI): SAC with SPDL and alone on three circuits, and their rides.

Source: Self-Paced Curriculum Reinforcement Learning for Autonomous Superbike Racing in Simulation.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from bike_policy.contract.bundle import Actor, Bundle
from bike_policy.riders.racing import RacingRider
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.sim.events import EventKind
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.files import load_vehicle
from bike_training.curricula.spdl import FASTEST, SLOWEST, Gaussian
from bike_training.learning.presets import Preset
from bike_training.learning.run_settings import RunSettings
from bike_training.reproduce.data import Tables, table
from bike_training.reproduce.figures import SPDL_THRESHOLD, SUPERBIKE_FIGURES
from bike_training.reproduce.paper import Advance, Experiment, Paper, Rows, learned
from bike_training.reproduce.superbike_results import (
    ACTORS,
    CIRCUITS,
    KINDS,
    MACHINE,
    MACHINES,
    PAPER,
    STATEMENTS,
    TABLES,
    best_run,
    circuit_of,
    kind_of,
    setting_of,
)
from bike_training.rollout.laps import ride_laps
from bike_training.rollout.races import ride_races
from bike_training.sweeps.jobs import TrainJob
from bike_training.tasks.race import RACE_WEIGHTS

NO_PLAN: Final = {
    "task.observation": "paper_race",
    "task.weights": {name: weight for name, weight in RACE_WEIGHTS.items() if name != "line"},
    "curriculum.share": 10.0,
    "curriculum.start_line": True,
    "task.max_steps": 2500,
    "curriculum.failure_share": 0.0,
    "learner.mirror": False,
}
"""No planned speed in reward or observation, no distance to a line in the reward, starts at the start line, and 150 s
for an episode: who always starts there does not see the rest of the lap in shorter ones."""
PUBLISHED: Final = {"preset": "race_paper", "learner": "sbx"}
"""The published learner as well, which is that of Stable-Baselines3, by its sibling in JAX: on a GPU, where one is."""
CURRICULA: Final[Mapping[str, Mapping[str, Any]]] = {
    "spdl": {"curriculum": "spdl", "curriculum.threshold": SPDL_THRESHOLD},
    "sac": {"curriculum": "target"},
    "schedule": {"curriculum": "schedule"},
    "stages": {"curriculum": "schedule", "curriculum.stages": 4},
    "spdl450": {"curriculum": "spdl", "curriculum.threshold": 450.0},
    "spdl600": {"curriculum": "spdl", "curriculum.threshold": 600.0},
    "plain-spdl": {"curriculum": "spdl", "curriculum.threshold": SPDL_THRESHOLD} | NO_PLAN,
    "plain-sac": {"curriculum": "target"} | NO_PLAN,
    "plain-schedule": {"curriculum": "schedule"} | NO_PLAN,
    "published-spdl": {"curriculum": "spdl", "curriculum.threshold": SPDL_THRESHOLD} | PUBLISHED,
    "published-sac": {"curriculum": "target"} | PUBLISHED,
    "swings": {
        "curriculum": "target",
        "task.weights": {**RACE_WEIGHTS, "steer_history": 0.5, "lean_history": 0.5},
    },
    "unplanned-reward": {
        "curriculum": "target",
        "task.weights": {name: RACE_WEIGHTS[name] for name in RACE_WEIGHTS if name not in ("line", "overspeed")},
    },
    "unplanned-observation": {"curriculum": "target", "task.observation": "paper_race"},
    "points-ahead": {"curriculum": "target", "task.observation": "points_ahead"},
    "no-lean-history": {"curriculum": "target", "task.observation": "no_lean_history"},
    "no-failures": {"curriculum": "target", "curriculum.failure_share": 0.0},
    "no-mirror": {"curriculum": "target", "learner.mirror": False},
}
"""Settings by the first part of a setting's name: all arms draw from SPDL's target in the end. The first two are the
paper's. ``schedule`` moves to the target whatever the returns are: what self-pacing adds is the difference from it;
``stages`` jumps there in four. Those called plain have the paper's observation, and its speed limit in place of a
planned speed; those called published its learner too. Those of `superbike_results.ABLATIONS` are ``sac`` with one thing
changed."""
EARLY: Final = 1150 / 1900
"""The paper's early snapshot as a part of its run (Table I)."""
PRESET: Final = "race_direct"
ITERATION: Final = 5000
"""Decisions between two updates of SPDL, as published, however long a run is."""

CHECKPOINTS: Final = 20
VALIDATIONS: Final = 20
COMPARISONS: Final = 4
"""Most of each in a long run: a checkpoint holds the whole replay buffer, a validation rides as long as 6,000 decisions
of learning take, a comparison three times as long."""
EPISODES_EVERY: Final = 5
"""Rows of a run's log for each row of the table, so that it stays small enough to ship."""
MOMENT_EVERY: Final = 5
"""Control periods of 20 ms for each row of a lap."""
NONE: Final = -1.0
SETTINGS: Final = (*CURRICULA, *(setting_of(kind, circuit) for circuit in CIRCUITS[1:] for kind in KINDS))


@dataclass(frozen=True, kw_only=True)
class SuperbikeExperiment(Experiment):
    """Settings of the experiments.

    Attributes:
        settings: a curriculum on a circuit each.
        steps: decisions of a run.
        starts: rides of each actor, all around the circuit.
        laps: flying laps of each of them.
        machines: that actors ride without learning on them.
        transfer_starts: rides on each, a flying lap each.
        learner: further settings, as entries of a sweep.
        threshold: expected return that SPDL keeps, in place of the setting's.
        iteration: decisions between two updates of SPDL.
    """

    title: str = "superbike paper"
    settings: tuple[str, ...] = SETTINGS
    steps: int = 300_000
    starts: int = 8
    laps: int = 3
    machines: tuple[str, ...] = MACHINES
    transfer_starts: int = 4
    learner: tuple[tuple[str, Any], ...] = ()
    threshold: float | None = None
    iteration: int = ITERATION

    @property
    def early(self) -> int:
        """Learning step of the early snapshot."""
        return max(1, round(EARLY * self.steps))

    def base(self) -> dict[str, Any]:
        """Return the entries of every run."""
        learner = {
            "curriculum.validate_every": max(10_000, self.steps // VALIDATIONS),
            "curriculum.select_every": max(50_000, self.steps // COMPARISONS),
            "curriculum.spread": 0.0,
            **dict(self.learner),
        }
        return {
            "vehicle": MACHINE,
            "steps": self.steps,
            "keep_every": self.early,
            "checkpoint_every": max(RunSettings.checkpoint_every, self.steps // CHECKPOINTS),
            "set": learner,
        }

    def entries(self, setting: str) -> dict[str, Any]:
        """Return the entries of the runs of a setting."""
        curriculum = dict(CURRICULA[kind_of(setting)])
        if self.threshold is not None and "curriculum.threshold" in curriculum:
            curriculum["curriculum.threshold"] = self.threshold
        if curriculum["curriculum"] == "schedule":
            curriculum["curriculum.schedule"] = max(1, self.steps // 2)
        preset = curriculum.pop("preset", PRESET)
        circuits = {"curriculum.circuits": [circuit_of(setting)], "curriculum.iteration": self.iteration}
        return {"preset": preset, "set": curriculum | circuits}


QUICK: Final = SuperbikeExperiment(
    settings=SETTINGS[:2],
    seeds=(0,),
    steps=400,
    starts=2,
    laps=1,
    machines=(MACHINE, "r1"),
    transfer_starts=1,
    learner=(
        ("learner", "sb3"),
        ("learner.layers", [8]),
        ("learner.layer_norm", False),
        ("learner.batch_size", 16),
        ("learner.buffer_size", 2000),
        ("learner.learning_starts", 20),
        ("learner.environments", 4),
        ("learner.updates", 1),
        ("task.max_steps", 10),
        ("curriculum.validate_every", 200),
        ("task.validation_duration", 2.0),
    ),
    iteration=100,
    threshold=-1000.0,
)
"""Tries the whole way in seconds; it learns nothing, and its threshold lets SPDL go on all the same."""


def ride(folder: Path, setting: str, seed: int, experiment: SuperbikeExperiment, advance: Advance) -> Rows | None:
    """Ride the actors of a run and read its logs; None where it has not learned yet."""
    actors = deployed(folder, experiment)
    if actors is None:
        return None
    circuit = circuit_of(setting)
    laps: list[Any] = []
    for name, (step, bundle) in actors.items():
        result = ride_races(bundle, MACHINE, circuit, experiment.starts, experiment.laps)
        mean, best = _mean_and_best(result)
        counts = [result[each] for each in ("rides", "whole", "falls", "walls", "finished")]
        outside = result["outside_s"] / result["rides"]
        laps.append((setting, seed, name, step, *counts, mean, best, result["line_distance_m"], outside))
        advance()
    transfers: list[Any] = []
    for machine in experiment.machines if "best" in actors else ():
        result = ride_races(actors["best"][1], machine, circuit, experiment.transfer_starts, 1)
        median = float(np.median(result["times_s"])) if result["times_s"] else NONE
        _, best = _mean_and_best(result)
        transfers.append((setting, seed, circuit, machine, result["rides"], result["whole"], best, median))
        advance()
    return {
        "laps": laps,
        "transfers": transfers,
        "contexts": contexts(folder, setting, seed),
        "episodes": _episodes(folder, setting, seed),
    }


def deployed(folder: Path, experiment: SuperbikeExperiment) -> dict[str, tuple[int, Bundle]] | None:
    """Return the actors of a run with their learning steps, those that it has: early, late and best.

    Early is the averaged actor at the published part of the run, late that at its end. Best is what `bike export`
    deploys: the best on the rides that actors are compared on, or that of the last validation that was whole, or
    the last one.

    Args:
        folder: of the run.
        experiment: its settings.
    """
    from bike_training.learning.progress import chosen_actor  # late: PyTorch takes seconds
    from bike_training.learning.validation import kept

    with learned(folder) as progress:
        if progress is None:
            return None
        summary = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        steps = summary["steps"]
        last, _, _ = chosen_actor(progress, "last", steps)
        best, _, best_step = chosen_actor(progress, "best", steps)
    preset, vehicle = Preset.from_plain(summary["preset"]), load_vehicle(MACHINE)
    form = preset.deployed_layout, preset.task.action, vehicle.name, vehicle.control_period
    found: dict[str, tuple[int, Actor]] = {}
    early = kept(folder, experiment.early)
    if early is not None:
        found["early"] = early
    if last is not None:
        found["best"] = (best_step, best) if best is not None else (steps, last)
        if steps >= experiment.steps:
            found["late"] = steps, last
    return {name: (step, Bundle(name, actor, *form)) for name, (step, actor) in found.items()}


def _mean_and_best(result: Mapping[str, Any]) -> tuple[float, float]:
    times = result["times_s"]
    return (float(np.mean(times)), times[0]) if times else (NONE, NONE)


def contexts(folder: Path, setting: str, seed: int) -> list[Any]:
    """Return the distributions of a run's self-paced curriculum, update by update; none of another curriculum."""
    with learned(folder) as progress:
        stored: Mapping[str, Any] = {} if progress is None else progress["curriculum"]
        if "distributions" not in stored:
            return []
        known = [Gaussian.from_flat(flat) for flat in stored["distributions"]]
        rows, place = [], 0
        for number, step, stage, mean, std, kl, value in stored["steps"]:
            # An update without enough episodes leaves no distribution.
            if place + 1 < len(known) and np.allclose(known[place + 1].mean, mean):
                place += 1
            factor = known[place].factor
            covariance = factor @ factor.T
            correlation = covariance[0, 2] / np.sqrt(covariance[0, 0] * covariance[2, 2])
            span = FASTEST - SLOWEST
            means = *mean[:2], SLOWEST + span * mean[2]
            figures = (*means, *std[:2], span * std[2], correlation, kl, value)
            rows.append((setting, seed, number, step, stage, *figures))
    return rows


def _episodes(folder: Path, setting: str, seed: int) -> list[Any]:
    found: dict[int, dict[str, float]] = {}
    for name, step, value in TrainJob.curve(folder):
        if name in ("episode_steps", "episode_return"):
            found.setdefault(int(step), {})[name] = value
    rows = [
        (setting, seed, step, values["episode_steps"], values["episode_return"])
        for step, values in sorted(found.items())
        if len(values) == 2
    ]
    return rows[::EPISODES_EVERY]


def add_details(data: Tables, folders: Mapping[tuple[str, int], Path], experiment: SuperbikeExperiment) -> Tables:
    """Return the tables with a flying lap of the best run of each setting on the first circuit (Figs. 3 and 4).

    Args:
        data: of runs and rides.
        folders: of the runs that rode, by setting and seed.
        experiment: its settings.
    """
    moments: list[Any] = []
    for kind in KINDS:
        seed = best_run(data, kind)
        actors = None if seed is None else deployed(folders[kind, seed], experiment)
        if seed is not None and actors is not None:
            moments += flying_lap(actors["best"][1], kind, seed)
    return data | {"moments": table(PAPER, "moments", moments)}


def flying_lap(bundle: Bundle, setting: str, seed: int) -> Sequence[Any]:
    """Ride an out-lap and a flying lap, and return the flying one, as far as it goes."""
    moments: list[Any] = []
    begun = [NONE]

    def report(snapshot: Snapshot, length: float) -> None:
        if any(event.kind is EventKind.LAP for event in snapshot.events):
            begun.append(snapshot.time)
        if len(begun) != 2 or snapshot.step % MOMENT_EVERY:
            return
        state, look = snapshot.state, snapshot.look
        assert snapshot.circuit is not None, "it rides a circuit"
        progress = snapshot.circuit.place[lk.CENTRE_PROGRESS]
        values = (progress, state[st.X], state[st.Y], look[lk.SPEED], look[lk.LATERAL_ERROR])
        moments.append((setting, seed, snapshot.time - begun[1], *values))

    rider = RacingRider(bundle)
    ride_laps(MACHINE, circuit_of(setting), 1, rider=rider, engine=SUPERBIKE_ENGINE, report=report)
    return moments


SUPERBIKE: Final[Paper[SuperbikeExperiment]] = Paper(
    name="superbike",
    file=PAPER,
    experiment=SuperbikeExperiment(),
    quick=QUICK,
    error="mean_excess",
    unit=1.0,
    ridden=("laps", "transfers", "contexts", "episodes"),
    rides=lambda experiment: len(ACTORS) + len(experiment.machines),
    ride=ride,
    add_details=add_details,
    statements=STATEMENTS,
    figures=SUPERBIKE_FIGURES,
    written=TABLES,
    counts=lambda data: {
        "rides": int(data["laps"]["rides"].sum()),
        "rides_completed": int(data["laps"]["whole"].sum()),
    },
)
