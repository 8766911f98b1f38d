"""Rides with the deterministic actor side by side, as validations and comparisons of actors are, and kept actors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from bike_policy.contract.bundle import Actor
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.tasks.base import Task, batch_of


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
                batch.halt(~alive)
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


ACTORS: Final = "actors"
"""Folder of a run for actors that are kept."""


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
