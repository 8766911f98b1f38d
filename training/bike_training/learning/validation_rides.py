"""Validation rides during learning, with the deterministic actor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.actor import Actor
from bike_policy.contract.observation import rows_of
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.envs.clients import Client
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
            actor: who rides.
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
