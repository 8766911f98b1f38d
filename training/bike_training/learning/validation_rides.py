"""Validation rides during learning, with the deterministic actor."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.actor import Actor
from bike_policy.contract.rows import row_of
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.envs.clients import Client
from bike_training.tasks.base import Task
from bike_training.tasks.fleet import batch_of


def selection_error(
    actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest], machines: Sequence[str] = ()
) -> float:
    """Ride all requests side by side and return the figure by which the task compares actors, less is better."""
    return task.selection_error(*ride_side_by_side(actor, task, config, requests, machines=machines))


def validate_batch(
    actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest], machines: Sequence[str] = ()
) -> list[float]:
    """Ride all requests side by side and return the error of each ride, as the task defines it."""
    track, alive = ride_side_by_side(actor, task, config, requests, machines=machines)
    return [task.validation_error(track[:, i], bool(alive[i])) for i in range(len(requests))]


def ride_side_by_side(
    actor: Actor,
    task: Task,
    config: SimulatorConfig,
    requests: list[ResetRequest],
    disturb: Callable[[Batch, int, NDArray[np.bool_]], None] = lambda *_: None,
    machines: Sequence[str] = (),
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ride a batch; return the errors, shape (control periods, rides), and which rides did not fail.

    Args:
        actor: who rides.
        task: what the actor sees, and what is a failure.
        config: of the batch.
        requests: a ride each.
        disturb: called before each control period with the batch, the period's number and which rides go on.
        machines: names or files that the rides take in turn, where there are several; none for the config's.
    """
    batch, rides = batch_of(task.strict(), len(requests), config, machines)
    try:
        for index, request in enumerate(requests):
            batch.reset(index, request)
            rides.begin(index, batch, request, batch.course(index))
        steps = round(task.validation_duration / config.control_period)
        track = np.zeros((steps, len(requests)))
        alive = np.ones(len(requests), dtype=bool)
        for step in range(steps):
            if step % task.repeat == 0:
                actions = actor.act_batch(rides.observe(batch))
                rides.act(batch, actions)
            disturb(batch, step, alive)
            batch.step(rides.commands(batch))
            rides.advance(batch)
            track[step] = rides.error(batch)
            if (step + 1) % task.repeat == 0:
                alive &= ~rides.judge(batch).failed
                # A fallen vehicle would leave the model's range; it lies still for the rest of the ride.
                batch.state[~alive] = 0.0
            if not alive.any():
                break
        return track, alive
    finally:
        batch.close()


def validate_simulator(
    actor: Actor, task: Task, simulator: Callable[[int], Client], requests: list[ResetRequest]
) -> list[float]:
    """Ride all requests one after the other, each through the simulator of its number, and return their errors."""
    return [_ride(actor, task, simulator(row), request) for row, request in enumerate(requests)]


def _ride(actor: Actor, task: Task, simulator: Client, request: ResetRequest) -> float:
    rides = task.strict().rides(1, simulator.vehicle)
    row = row_of(simulator.reset(request))
    assert simulator.course is not None
    rides.begin(0, row, request, simulator.course)
    track: list[float] = []
    steps = round(task.validation_duration / simulator.config.control_period)
    for step in range(steps):
        if step % task.repeat == 0:
            action = actor.act(rides.observe(row)[0])
            rides.act(row, action[None])
        snapshot = simulator.step(*rides.commands(row)[0].tolist())
        row = row_of(snapshot)
        rides.advance(row)
        track.append(float(rides.error(row)[0]))
        if ((step + 1) % task.repeat == 0 or snapshot.fallen) and rides.judge(row).failed[0]:
            return task.validation_error(np.array(track), False)
    return task.validation_error(np.array(track), True)
