"""Validation rides during learning, with the deterministic actor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.actor import Actor
from bike_policy.contract.bundle import Bundle
from bike_policy.riders.learned import LearnedRider
from bike_sim.sim.batch import make_batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.envs.clients import Client
from bike_training.rollout.rollout import rollout
from bike_training.tasks.base import Task, has_failed


def rms_error(actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest]) -> float:
    """Return the RMS error over all rides, m; a failed ride counts as the task's largest error throughout.

    The root mean square weighs the places where a ride is worst, which the mean hides.
    """
    track, alive = ride_side_by_side(actor, task, config, requests)
    track[:, ~alive] = task.largest_error
    return float(np.sqrt(np.mean(track**2)))


def validate_batch(actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest]) -> list[float]:
    """Ride all requests side by side and return the error of each ride, as the task defines it."""
    track, alive = ride_side_by_side(actor, task, config, requests)
    return [task.validation_error(track[:, i], bool(alive[i])) for i in range(len(requests))]


def ride_side_by_side(
    actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ride a batch; return the errors (m), shape (steps, rides), and which rides did not fail."""
    batch = make_batch(len(requests), config, task.preview)
    try:
        for index, request in enumerate(requests):
            batch.reset(index, request)
        steps = round(task.validation_duration / config.control_period)
        track = np.zeros((steps, len(requests)))
        alive = np.ones(len(requests), dtype=bool)
        for step in range(steps):
            actions = actor.act_batch(task.layout.observe(batch))
            batch.step(task.action.to_commands(actions, batch.vehicle.max_steer))
            track[step] = task.error(batch)
            alive &= ~task.failed(batch)
            # A fallen vehicle would leave the model's range; it lies still for the rest of the ride.
            batch.state[~alive] = 0.0
            if not alive.any():
                break
        return track, alive
    finally:
        batch.close()


def validate_simulator(actor: Actor, task: Task, simulator: Client, requests: list[ResetRequest]) -> list[float]:
    """Ride all requests one after the other through a simulator and return the error of each ride."""
    return [_ride(actor, task, simulator, request) for request in requests]


def _ride(actor: Actor, task: Task, simulator: Client, request: ResetRequest) -> float:
    config = simulator.config
    rider = LearnedRider(
        Bundle("validated", actor, task.layout, task.action, simulator.vehicle.name, config.control_period)
    )
    track: list[float] = []
    for snapshot in rollout(simulator, rider, request):
        if not snapshot.step:
            continue
        track.append(float(task.error(snapshot)))
        if has_failed(task, snapshot):
            return task.validation_error(np.array(track), False)
        if snapshot.step == round(task.validation_duration / config.control_period):
            break
    return task.validation_error(np.array(track), True)
