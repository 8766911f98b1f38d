"""What rides after learning, and what a run tells of its curriculum."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
from bike_training.reproduce.paper import Advance, Rows
from bike_training.reproduce.superbike.data import Context, Data, Episodes, Laps, Moment, Transfer
from bike_training.reproduce.superbike.experiment import CURRICULA, MACHINE, SuperbikeExperiment, circuit_of
from bike_training.rollout.laps import ride_laps
from bike_training.rollout.races import RaceResult, ride_races
from bike_training.sweeps.training_job import TrainJob

ACTORS: Final = ("early", "late", "best")
EPISODES_EVERY: Final = 5
"""Rows of a run's log for each row of the table, so that it stays small enough to ship."""
MOMENT_EVERY: Final = 5
"""Control periods of 20 ms for each row of a lap."""
NONE: Final = -1.0


def ride(folder: Path, setting: str, seed: int, experiment: SuperbikeExperiment, advance: Advance) -> Rows | None:
    """Ride the actors of a run and read its logs; None where it has not learned yet."""
    actors = deployed(folder, experiment)
    if actors is None:
        return None
    circuit = circuit_of(setting)
    laps: list[Laps] = []
    for name, (step, bundle) in actors.items():
        result = ride_races(bundle, MACHINE, circuit, experiment.starts, experiment.laps)
        laps.append(_laps(result, setting, seed, name, step))
        advance()
    transfers: list[Transfer] = []
    for machine in experiment.machines if "best" in actors else ():
        result = ride_races(actors["best"][1], machine, circuit, experiment.transfer_starts, 1)
        median = float(np.median(result.times)) if result.times else NONE
        best = min(result.times, default=NONE)
        transfers.append(Transfer(setting, seed, circuit, machine, result.rides, result.whole, best, median))
        advance()
    return {
        "laps": laps,
        "transfers": transfers,
        "contexts": contexts(folder, setting, seed),
        "episodes": _episodes(folder, setting, seed),
    }


def rides_of(experiment: SuperbikeExperiment) -> int:
    """Return how many times `ride` advances for a run that has all its actors."""
    return len(ACTORS) + len(experiment.machines)


def deployed(folder: Path, experiment: SuperbikeExperiment) -> dict[str, tuple[int, Bundle]] | None:
    """Return the actors of a run with their learning steps, those that it has: early, late and best.

    Early is the averaged actor at the published part of the run, late that at its end. Best is what `bike export`
    deploys: the best on the rides that actors are compared on, or that of the last validation that was whole, or
    the last one.

    Args:
        folder: of the run.
        experiment: what is done.
    """
    from bike_training.learning.checkpoint import Checkpoint, find_checkpoint  # late: PyTorch takes seconds
    from bike_training.learning.progress import chosen_actor
    from bike_training.learning.validation import kept

    if find_checkpoint(folder) is None:
        return None
    checkpoint = Checkpoint(folder)
    summary = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    with checkpoint.reading():
        progress, steps = checkpoint.run["progress"], summary["steps"]
        last, _, _ = chosen_actor(progress, "last", steps)
        best, _, best_step = chosen_actor(progress, "best", steps)
        preset = Preset.from_plain(summary["preset"])
    found: dict[str, tuple[int, Actor]] = {}
    early = kept(folder, experiment.early)
    if early is not None:
        found["early"] = early
    if last is not None:
        found["best"] = (best_step, best) if best is not None else (steps, last)
        if steps >= experiment.steps:
            found["late"] = steps, last
    return {name: (step, _bundle(name, actor, preset)) for name, (step, actor) in found.items()}


def _bundle(name: str, actor: Actor, preset: Preset) -> Bundle:
    vehicle = load_vehicle(MACHINE)
    action = preset.task.action
    return Bundle(name, actor, preset.deployed_layout, action, vehicle.name, vehicle.control_period)


def _laps(result: RaceResult, setting: str, seed: int, actor: str, step: int) -> Laps:
    mean = float(np.mean(result.times)) if result.times else NONE
    return Laps(
        setting,
        seed,
        actor,
        step,
        result.rides,
        result.whole,
        result.falls,
        result.walls,
        result.finished,
        mean,
        min(result.times, default=NONE),
        result.line,
        result.outside / result.rides,
    )


def contexts(folder: Path, setting: str, seed: int) -> list[Context]:
    """Return the distributions of a run's self-paced curriculum, update by update; none of another curriculum."""
    from bike_training.learning.checkpoint import Checkpoint  # late: PyTorch takes seconds

    checkpoint = Checkpoint(folder)
    with checkpoint.reading():
        stored: Mapping[str, Any] = checkpoint.run["progress"]["curriculum"]
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
            means = float(mean[0]), float(mean[1]), SLOWEST + span * float(mean[2])
            stds = float(std[0]), float(std[1]), span * float(std[2])
            figures = (*means, *stds, float(correlation), float(kl), float(value))
            rows.append(Context(setting, seed, int(number), int(step), str(stage), *figures))
    return rows


def _episodes(folder: Path, setting: str, seed: int) -> list[Episodes]:
    found: dict[int, dict[str, float]] = {}
    for name, step, value in TrainJob.curve(folder):
        if name in ("episode_steps", "episode_return"):
            found.setdefault(int(step), {})[name] = value
    rows = [
        Episodes(setting, seed, step, values["episode_steps"], values["episode_return"])
        for step, values in sorted(found.items())
        if len(values) == 2
    ]
    return rows[::EPISODES_EVERY]


def best_run(data: Data, setting: str, actor: str = "best") -> int | None:
    """Return the seed of the run whose actor rode most rides whole, and of these the quickest; None without one."""
    rows = [row for row in data.laps if (row.setting, row.actor) == (setting, actor) and row.whole]
    return min(rows, key=lambda row: (-row.whole / row.rides, row.mean)).seed if rows else None


def look_closely(data: Data, folders: Mapping[tuple[str, int], Path], experiment: SuperbikeExperiment) -> Data:
    """Return the tables with a flying lap of the best run of each setting on the first circuit (Figs. 3 and 4).

    Args:
        data: of runs and rides.
        folders: of the runs that rode, by setting and seed.
        experiment: what is done.
    """
    moments: list[Moment] = []
    for kind in CURRICULA:
        seed = best_run(data, kind)
        actors = None if seed is None else deployed(folders[kind, seed], experiment)
        if seed is not None and actors is not None:
            moments += flying_lap(actors["best"][1], kind, seed)
    return replace(data, moments=tuple(moments))


def choose(data: Data, places: Sequence[Data]) -> Data:
    """Return the tables with the flying laps of the best of all runs.

    Args:
        data: of all runs and rides.
        places: tables of each place.
    """
    best = [(kind, best_run(data, kind)) for kind in CURRICULA]
    found = [row for run in best for place in places for row in place.moments if (row.setting, row.seed) == run]
    return replace(data, moments=tuple(found))


def flying_lap(bundle: Bundle, setting: str, seed: int) -> Sequence[Moment]:
    """Ride an out-lap and a flying lap, and return the flying one, as far as it goes."""
    moments: list[Moment] = []
    begun = [NONE]

    def tell(snapshot: Snapshot, length: float) -> None:
        if any(event.kind is EventKind.LAP for event in snapshot.events):
            begun.append(snapshot.time)
        if len(begun) != 2 or snapshot.step % MOMENT_EVERY:
            return
        state, look = snapshot.state, snapshot.look
        assert snapshot.circuit is not None, "it rides a circuit"
        progress = snapshot.circuit.place[lk.CENTRE_PROGRESS]
        values = (progress, state[st.X], state[st.Y], look[lk.SPEED], look[lk.LATERAL_ERROR])
        moments.append(Moment(setting, seed, float(snapshot.time - begun[1]), *map(float, values)))

    rider = RacingRider(bundle)
    ride_laps(MACHINE, circuit_of(setting), 1, rider=rider, engine=SUPERBIKE_ENGINE, tell=tell)
    return moments
