"""Rides with the deterministic actor during learning: validations, and the comparison of actors.

Once the curriculum is finished, actors are compared on rides that are always the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from bike_policy.contract.bundle import Actor
from bike_policy.contract.observation import rows_of
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.envs.clients import Client
from bike_training.learning.progress import Progress
from bike_training.learning.run_settings import RunSettings
from bike_training.tasks.base import Task, batch_of


def selection_error(
    actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest], machines: Sequence[str] = ()
) -> float:
    """Ride all requests side by side and return the figure by which the task compares actors, less is better."""
    return task.selection_error(*ride_side_by_side(actor, task, config, requests, machines=machines))


class SideBySide:
    """Vehicles side by side for rides of one task, with what has been planned for their courses.

    Whoever rides many times keeps one of these: a guide plans and rehearses each line once, not once for all rides.
    """

    def __init__(self, task: Task, count: int, config: SimulatorConfig, machines: Sequence[str] = ()) -> None:
        """Make room for rides.

        Args:
            task: what is seen, and what is a failure.
            count: number of rides.
            config: of the batch.
            machines: names or files that the rides take in turn, where there are several; none for the config's.
        """
        self.count, self._task, self._period = count, task, config.control_period
        self._batch, self._rides = batch_of(task.strict(), count, config, machines)

    def ride(
        self,
        actor: Actor,
        requests: Sequence[ResetRequest],
        disturb: Callable[[Batch, int, NDArray[np.bool_]], None] = lambda *_: None,
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the errors, shape (control periods, rides), and which rides did not fail.

        Args:
            actor: the rider.
            requests: a ride each.
            disturb: called before each control period with the batch, the period's number and which rides go on.
        """
        batch, rides, task = self._batch, self._rides, self._task
        for index, request in enumerate(requests):
            batch.reset(index, request)
            rides.begin(index, batch, request, batch.course(index))
        steps = round(task.validation_duration / self._period)
        track = np.zeros((steps, self.count))
        alive = np.ones(self.count, dtype=bool)
        for step in range(steps):
            if step % task.repeat == 0:
                actions = actor.act_batch(rides.observe(batch))
                rides.act(batch, actions)
            disturb(batch, step, alive)
            batch.step(rides.commands(batch))
            rides.advance(batch)
            track[step] = rides.error(batch)
            if (step + 1) % task.repeat == 0:
                alive &= ~rides.evaluate(batch).failed
                # A fallen vehicle would leave the model's range; it lies still for the rest of the ride.
                batch.state[~alive] = 0.0
            if not alive.any():
                break
        return track, alive

    def errors(self, actor: Actor, requests: Sequence[ResetRequest]) -> list[float]:
        """Return the error of each ride, as the task defines it."""
        track, alive = self.ride(actor, requests)
        return [self._task.validation_error(track[:, i], bool(alive[i])) for i in range(self.count)]

    def close(self) -> None:
        """Release the engines."""
        self._batch.close()


def ride_side_by_side(
    actor: Actor,
    task: Task,
    config: SimulatorConfig,
    requests: Sequence[ResetRequest],
    disturb: Callable[[Batch, int, NDArray[np.bool_]], None] = lambda *_: None,
    machines: Sequence[str] = (),
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ride once, see `SideBySide`."""
    with closing(SideBySide(task, len(requests), config, machines)) as together:
        return together.ride(actor, requests, disturb)


def validate_simulator(
    actor: Actor, task: Task, simulator: Callable[[int], Client], requests: list[ResetRequest]
) -> list[float]:
    """Ride all requests one after the other, each through the simulator of its number, and return their errors."""
    return [_ride(actor, task, simulator(row), request) for row, request in enumerate(requests)]


def _ride(actor: Actor, task: Task, simulator: Client, request: ResetRequest) -> float:
    rides = task.strict().make_state(1, simulator.vehicle)
    row = rows_of(simulator.reset(request))
    assert simulator.course is not None
    rides.begin(0, row, request, simulator.course)
    track: list[float] = []
    steps = round(task.validation_duration / simulator.config.control_period)
    for step in range(steps):
        if step % task.repeat == 0:
            action = actor.act(rides.observe(row)[0])
            rides.act(row, action[None])
        snapshot = simulator.step(*rides.commands(row)[0].tolist())
        row = rows_of(snapshot)
        rides.advance(row)
        track.append(float(rides.error(row)[0]))
        if ((step + 1) % task.repeat == 0 or snapshot.fallen) and rides.evaluate(row).failed[0]:
            return task.validation_error(np.array(track), False)
    return task.validation_error(np.array(track), True)


class Validation(NamedTuple):
    """Result of a validation.

    Attributes:
        part: part of the curriculum that it was ridden in.
        mean_error: of its rides, m.
        max_error: largest error of a ride, m.
        succeeded: whether every ride passed.
    """

    part: int
    mean_error: float
    max_error: float
    succeeded: bool


class Validator:
    """Rides validations as the environments of a run do, with simulators of its own where it needs them."""

    def __init__(self, settings: RunSettings, task: Task) -> None:
        """Prepare to validate; nothing is started before the first ride."""
        self._settings, self._task = settings, task
        self._simulators: dict[SimulatorConfig, Simulator] = {}
        self._together: SideBySide | None = None

    def simulator(self, row: int = 0) -> Simulator:
        """Return the simulator of a ride in this process: its bits are those of every client, ten times as fast."""
        config = self._settings.simulator(row)
        if config not in self._simulators:
            self._simulators[config] = Simulator(config)
        return self._simulators[config]

    def ride(self, actor: Actor, requests: list[ResetRequest]) -> list[float]:
        """Ride all requests and return their errors, as the task defines them."""
        if self._settings.compiled:
            return self._side_by_side(len(requests)).errors(actor, requests)
        return validate_simulator(actor, self._task, self.simulator, requests)

    def _side_by_side(self, count: int) -> SideBySide:
        """Return vehicles for a number of rides: those of the last validation, unless it had another number."""
        if self._together is None or self._together.count != count:
            if self._together is not None:
                self._together.close()
            settings = self._settings
            self._together = SideBySide(self._task, count, settings.simulator(), settings.machines)
        return self._together

    def close(self) -> None:
        """Release the simulators; a later ride starts others."""
        together, self._together = self._together, None
        if together is not None:
            together.close()
        while self._simulators:
            self._simulators.popitem()[1].close()


def take_in(progress: Progress, actor: Actor, step: int, errors: Sequence[float], largest_error: float) -> Validation:
    """Take a validation into the progress of a run, and move the curriculum on if it was fully successful.

    Args:
        progress: of the run.
        actor: the rider.
        step: learning step.
        errors: of the rides, as parts of the largest error.
        largest_error: m.
    """
    curriculum = progress.curriculum
    part, succeeded = curriculum.part, curriculum.passes(errors)
    passed = curriculum.validated(step, errors)
    progress.recent_error_m = float(np.mean(errors) * largest_error)
    progress.validated_at, progress.validation_due = step, False
    progress.validations += 1
    if succeeded:
        progress.latest_success, progress.success_step = actor, step
    if passed and curriculum.finished:
        progress.finished_after = round(progress.seconds, 1)
    return Validation(part, progress.recent_error_m, max(errors) * largest_error, succeeded)


ACTORS: Final = "actors"
"""Folder of a run for actors that are kept."""


def comparison_is_due(progress: Progress, step: int, every: int) -> bool:
    """Return whether actors are to be compared at a learning step.

    Args:
        progress: of the run.
        step: learning step.
        every: learning steps between two comparisons once the curriculum is finished.
    """
    return progress.curriculum.finished and step - progress.selected_at >= every


def keep(out: Path, actor: Actor, step: int) -> None:
    """Keep the actor of a learning step on disk.

    Args:
        out: folder of the run.
        actor: the present one.
        step: learning step.
    """
    actors = out / ACTORS
    actors.mkdir(exist_ok=True)
    save_file(actor.tensors(), actors / f"{step:09d}.safetensors")


def kept(out: Path, step: int) -> tuple[int, Actor] | None:
    """Return the first actor that a run has kept from a learning step on, with its own step; None without one."""
    for path in sorted((out / ACTORS).glob("*.safetensors")):
        if int(path.stem) >= step:
            return int(path.stem), Actor.from_tensors(load_file(path))
    return None


def compare(
    out: Path,
    actor: Actor,
    progress: Progress,
    step: int,
    task: Task,
    config: SimulatorConfig,
    machines: Sequence[str] = (),
) -> float:
    """Keep the present actor on disk, and compare it with the best one so far.

    Args:
        out: folder of the run.
        actor: the present one.
        progress: of the run; it remembers the best.
        step: learning step.
        task: what is ridden.
        config: of its simulator.
        machines: that the rides take in turn, where there are several.

    Returns:
        The actor's error, as the task compares actors.
    """
    progress.selected_at = step
    keep(out, actor, step)
    error = selection_error(actor, task, config, progress.curriculum.selection_requests(task.preview), machines)
    if error < progress.best_error_m:
        progress.best, progress.best_error_m, progress.best_step = actor, error, step
    return error
