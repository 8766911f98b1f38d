"""Scores of riders and policies in frozen tasks, files of results, and their verification.

The commands of every episode are recorded. An error is always that of a recording, ridden in one batch: evaluation
records first and rides then, verification only rides.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_policy.planning.plan_verification import BatchRider
from bike_policy.riders.base import Rider, bundle_of
from bike_policy.riders.classical import CLASSICAL
from bike_policy.riders.disturbed import DisturbedRider
from bike_policy.riders.rider import make_rider
from bike_sim.documents import DocumentError, alternatives, show
from bike_sim.sim.batch import Batch
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.worlds import load_worlds
from bike_sim.vehicles.files import load_vehicle
from bike_training.arguments import read_json
from bike_training.benchmark.tasks import BENCHMARKS, Benchmark, benchmark_of
from bike_training.rollout.races import rider_of
from bike_training.rollout.rollout import rollout, with_preview
from bike_training.tasks.base import TaskState, batch_of
from bike_training.tasks.race import RaceTask

SCHEMA: Final = "bike.benchmark/1"
RESULTS_FILE: Final = "results.json"
COMMANDS_FILE: Final = "commands.npz"
TOLERANCE: Final = 1e-6
"""Largest difference of an error that counts as the same: machines round differently."""
LARGEST_RESULTS: Final = 64 * 1024 * 1024

Actions = Callable[[NDArray[np.float32]], NDArray[np.floating]]
"""Actions in [-1, 1] of observations, shapes (n, columns) and (n, layout size)."""
FloatArray = NDArray[np.float64]
Report = Callable[[int, int], None]


def _begin(benchmark: Benchmark) -> tuple[Batch, TaskState]:
    """Begin the episodes that decide a score, side by side."""
    batch, state = batch_of(benchmark.judged_task(), benchmark.count, benchmark.config)
    for row, request in enumerate(benchmark.judged_requests()):
        batch.reset(row, request)
        state.begin(row, batch, request, batch.course(row))
    return batch, state


def errors_of(benchmark: Benchmark, commands: FloatArray) -> list[dict[str, Any]]:
    """Ride recorded commands.

    Args:
        benchmark: the task.
        commands: steering and throttle at each control period, shape (periods, episodes, 2); NaN where a ride had
            ended.

    Returns:
        Of each episode its ``error`` and whether it ``failed``.

    Raises:
        ValueError: commands of another shape, or out of range before the end of a ride.
    """
    return _ride(benchmark, commands=commands)[1]


def record_actions(benchmark: Benchmark, actions: Actions, report: Report = lambda done, total: None) -> FloatArray:
    """Ride a policy of the task's own observations and actions.

    Returns:
        Commands as `errors_of` takes them.
    """
    return _ride(benchmark, actions=actions, report=report)[0]


def _ride(
    benchmark: Benchmark,
    actions: Actions | None = None,
    commands: FloatArray | None = None,
    rider: BatchRider | None = None,
    report: Report = lambda done, total: None,
) -> tuple[FloatArray, list[dict[str, Any]]]:
    """Ride all episodes side by side; return commands and errors."""
    task = benchmark.judged_task()
    shape = (task.max_steps * task.repeat, benchmark.count, 2)
    if commands is not None and commands.shape != shape:
        raise DocumentError(f"recorded commands have the shape {commands.shape}, this task's are {shape}")
    batch, state = _begin(benchmark)
    with closing(batch):
        late = _late(benchmark, batch, rider)
        errors, failed = np.zeros(shape[:2]), np.zeros(benchmark.count, dtype=np.bool_)
        ends = np.full(benchmark.count, shape[0])
        given = np.full(shape, np.nan)
        if rider is not None:
            for row in range(benchmark.count):
                rider.begin(row, batch, batch.course(row))
        idle = np.zeros((benchmark.count, task.action.size))
        for decision in range(task.max_steps):
            report(decision, task.max_steps)
            if failed.all():
                break
            state.act(batch, idle if actions is None else actions(state.observe(batch)))
            for period in range(decision * task.repeat, (decision + 1) * task.repeat):
                if commands is not None:
                    now = commands[period]
                else:
                    now = state.commands(batch) if rider is None else late(rider.commands(batch, period))
                riding = ~(failed | batch.fallen)
                if not (np.abs(now[riding]) <= 1.0).all():
                    raise DocumentError(f"a recorded command at control period {period} is no number in [-1, 1]")
                given[period, riding] = now[riding]
                batch.step(np.where(riding[:, None], np.nan_to_num(now), 0.0))
                state.advance(batch)
                errors[period] = state.error(batch)
            over = state.evaluate(batch).failed & ~failed
            failed |= over
            batch.halt(failed)
            ends[over] = (decision + 1) * task.repeat
        return given, [
            {"error": _error(benchmark, errors[: ends[row], row], bool(failed[row])), "failed": bool(failed[row])}
            for row in range(benchmark.count)
        ]


def _late(benchmark: Benchmark, batch: Batch, rider: BatchRider | None) -> Callable[[FloatArray], FloatArray]:
    """Return what delays the commands of a rider of machines side by side, each by its own world's delay."""
    worlds = _worlds(benchmark)
    late = np.array([world.periods(world.command_delay_s, batch.config.control_period) for world in worlds])
    if rider is None or not late.any():
        return lambda commands: commands
    sent = deque([np.zeros((batch.count, 2))] * (int(late.max()) + 1), maxlen=int(late.max()) + 1)

    def delayed(commands: FloatArray) -> FloatArray:
        sent.appendleft(commands)
        return np.array([sent[delay][row] for row, delay in enumerate(late)])

    return delayed


def _worlds(benchmark: Benchmark) -> list[Disturbances]:
    """Return the disturbances of each episode."""
    known = load_worlds(benchmark.judged_task().disturbances) or [Disturbances()]
    return [known[row % len(known)] for row in range(benchmark.count)]


def _error(benchmark: Benchmark, errors: FloatArray, failed: bool) -> float:
    """Return the error of an episode: mean distance (m), or time over the planned lap's as a part of it."""
    task = benchmark.task
    if failed:
        return task.largest_error
    if isinstance(task, RaceTask):
        return task.validation_error(errors, True)
    return float(errors.mean())


def record_rider(benchmark: Benchmark, name: str, report: Report = lambda done, total: None) -> FloatArray:
    """Ride a rider or a policy by name, whatever its own observation is.

    Returns:
        Commands as `errors_of` takes them.

    Raises:
        ValueError: a rider of another kind of vehicle. FileNotFoundError: there is no such rider.
    """
    races = isinstance(benchmark.task, RaceTask)
    rider = None if name == CLASSICAL else make_rider(name)
    bundle = None if rider is None else bundle_of(rider)
    if races != (name == CLASSICAL or (bundle is not None and bundle.layout.races)):
        raise ValueError(f"rider {show(name)} does not ride {benchmark.vehicle!r}, the vehicle of this task")
    if races:
        machine, period = load_vehicle(benchmark.vehicle), benchmark.config.control_period
        racing = rider_of(bundle or CLASSICAL_SETTINGS, machine, period, benchmark.count)
        return _ride(benchmark, rider=racing, report=report)[0]
    assert rider is not None, "the classical rider races"
    task = benchmark.judged_task()
    commands = np.full((task.max_steps * task.repeat, benchmark.count, 2), np.nan)
    for row, (request, world) in enumerate(zip(benchmark.judged_requests(), _worlds(benchmark), strict=True)):
        report(row, benchmark.count)
        _ride_alone(benchmark, DisturbedRider(rider, world), request, world, commands[:, row])
    return commands


def _ride_alone(
    benchmark: Benchmark, rider: Rider, request: ResetRequest, world: Disturbances, commands: FloatArray
) -> None:
    """Ride one episode and write its commands."""
    with closing(Simulator(benchmark.config, world)) as simulator:
        given: list[tuple[float, float]] = []
        for snapshot in rollout(simulator, rider, with_preview(request, rider)):
            if snapshot.step:
                given.append((snapshot.steering, snapshot.throttle))
            if len(given) == len(commands):
                break
    commands[: len(given)] = given
    commands[len(given) :] = 0.0  # where it gave up, what it left


# ------------------------------------------------------------------------------------------------------------- results


def write_results(folder: Path, name: str, rider: str, commands: FloatArray) -> dict[str, Any]:
    """Write the recordings of a task's episodes, and the results that they give.

    Args:
        folder: made if need be; takes `RESULTS_FILE` and `COMMANDS_FILE`.
        name: id of the task.
        rider: for people.
        commands: see `errors_of`.

    Returns:
        The results.

    Raises:
        ValueError: an unknown task, or commands that are not of its shape. OSError: a file cannot be written.
    """
    benchmark = benchmark_of(name)
    episodes = errors_of(benchmark, commands)
    error = float(np.mean([episode["error"] for episode in episodes]))
    results = {
        "schema": SCHEMA,
        "task": name,
        "rider": rider,
        "error": error,
        "error_name": benchmark.task.error_name,
        "score": benchmark.score(error),
        "failed": sum(episode["failed"] for episode in episodes),
        "episodes": episodes,
        "commands": COMMANDS_FILE,
    }
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / COMMANDS_FILE, commands=commands)
    (folder / RESULTS_FILE).write_text(json.dumps(results, indent=1), encoding="utf-8")
    return results


def verify_results(path: Path) -> dict[str, Any]:
    """Ride the recordings of a file of results again.

    Returns:
        ``task``, ``rider``, the ``score`` that the recordings give, the ``claimed`` one, and ``faults``: a sentence for
        each claim that they do not bear out.

    Raises:
        ValueError: results of another version or of an unknown task, or a damaged file.
        OSError: a file cannot be read.
    """
    claimed = read_json(path)
    if claimed.get("schema") != SCHEMA:
        raise DocumentError(f"{path}: results of {show(claimed.get('schema'))}, this software verifies {SCHEMA}")
    missing = [key for key in ("task", "rider", "error", "score", "episodes", "commands") if key not in claimed]
    if missing:
        raise DocumentError(f"{path}: the results lack {', '.join(missing)}")
    if claimed["task"] not in BENCHMARKS:
        hint = alternatives(str(claimed["task"]), BENCHMARKS)
        raise DocumentError(f"{path}: results of an unknown task or version {show(claimed['task'])}; {hint}")
    benchmark = BENCHMARKS[claimed["task"]]
    commands = _read_commands(path.parent / Path(str(claimed["commands"])).name)
    try:
        episodes = errors_of(benchmark, commands)
        faults = _faults(claimed, benchmark, episodes)
    except (TypeError, KeyError, ValueError) as error:
        raise DocumentError(f"{path}: {error}") from None
    score = benchmark.score(float(np.mean([episode["error"] for episode in episodes])))
    return {"task": claimed["task"], "rider": str(claimed["rider"]), "score": score, "claimed": claimed["score"]} | {
        "faults": faults
    }


def _faults(claimed: Mapping[str, Any], benchmark: Benchmark, episodes: list[dict[str, Any]]) -> list[str]:
    """Return the claims that differ from what was ridden."""
    if len(claimed["episodes"]) != len(episodes):
        return [f"{len(claimed['episodes'])} episodes are claimed, the task has {len(episodes)}"]
    faults = []
    for number, (told, found) in enumerate(zip(claimed["episodes"], episodes, strict=True), start=1):
        if not _same(told["error"], found["error"]) or told["failed"] != found["failed"]:
            ends = " and a failure" * found["failed"]
            faults.append(
                f"episode {number}: an error of {told['error']:.6g} is claimed, its recording gives "
                f"{found['error']:.6g}{ends}"
            )
    mean = float(np.mean([episode["error"] for episode in episodes]))
    for name, value in (("error", mean), ("score", benchmark.score(mean))):
        if not _same(claimed[name], value):
            faults.append(f"{name} {claimed[name]:.6g} is claimed, the recordings give {value:.6g}")
    return faults


def _same(claimed: float, found: float) -> bool:
    return math.isfinite(claimed) and abs(claimed - found) <= TOLERANCE * max(1.0, abs(found))


def _read_commands(path: Path) -> FloatArray:
    """Return recorded commands.

    Raises:
        ValueError: the file is not one of them. OSError: it cannot be read.
    """
    if path.stat().st_size > LARGEST_RESULTS:
        raise DocumentError(f"{path} has {path.stat().st_size} bytes, more than recorded commands take")
    try:
        with np.load(path, allow_pickle=False) as stored:
            return np.asarray(stored["commands"], dtype=np.float64)
    except (ValueError, KeyError, EOFError) as error:
        raise DocumentError(f"{path} does not hold recorded commands ({error})") from None
