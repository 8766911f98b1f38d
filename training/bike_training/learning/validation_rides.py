"""Validation rides during learning: ten random rides of 30 s with the deterministic actor."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.actor import Actor
from bike_policy.contract.bundle import Bundle
from bike_policy.riders.learned import LearnedRider
from bike_sim.course.random_paths import CURRICULUM_PATHS
from bike_sim.sim.batch import make_batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.curricula.base import Episodes
from bike_training.curricula.parts import SPEED_RANGES, VALIDATION_DURATION, VALIDATION_RIDES
from bike_training.envs.clients import Client
from bike_training.rollout.rollout import rollout
from bike_training.tasks.base import Task, has_failed
from bike_training.tasks.path import DISTANCE_THRESHOLD, validation_error

SELECTION_RIDES_PER_SPEED: Final = 5
SELECTION_SEED: Final = 2**32
"""Rides at each of 21 speeds that actors are compared on, and the seed of the first; training draws below 2**31."""


def draw_requests(task: Task, episodes: Episodes, rng: np.random.Generator) -> list[ResetRequest]:
    """Draw the requests of one validation, with paths that are long enough for all of a ride."""
    drawn = [episodes.draw(rng, task.preview) for _ in range(VALIDATION_RIDES)]
    return [replace(request, path_length=1.2 * VALIDATION_DURATION * request.speed_range[1]) for request in drawn]


def selection_requests(task: Task) -> list[ResetRequest]:
    """Return the rides that actors are compared on: always the same, on random paths of the last part.

    They are drawn from seeds that no training run reaches by counting, and the benchmark path is not among them.
    """
    return [
        ResetRequest(
            seed=SELECTION_SEED + number,
            speed_range=(speed, speed),
            path_ranges=CURRICULUM_PATHS[-1],
            path_length=1.2 * VALIDATION_DURATION * speed + 20.0,
            preview=task.preview,
        )
        for number, speed in enumerate(np.tile(np.linspace(*SPEED_RANGES[-1], 21), SELECTION_RIDES_PER_SPEED).tolist())
    ]


def selection_error(actor: Actor, task: Task, config: SimulatorConfig) -> float:
    """Return the RMS distance over all selection rides, m; a failed ride counts as 3.5 m throughout.

    The root mean square weighs the places where a ride is worst, which the mean hides.
    """
    track, alive = ride_side_by_side(actor, task, config, selection_requests(task))
    track[:, ~alive] = DISTANCE_THRESHOLD
    return float(np.sqrt(np.mean(track**2)))


def validate_batch(actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest]) -> list[float]:
    """Ride all requests side by side and return the errors e_i (Eq. 12)."""
    track, alive = ride_side_by_side(actor, task, config, requests)
    return [validation_error(track[:, i], bool(alive[i])) for i in range(len(requests))]


def ride_side_by_side(
    actor: Actor, task: Task, config: SimulatorConfig, requests: list[ResetRequest]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ride a batch; return the errors (m), shape (steps, rides), and which rides did not fail."""
    batch = make_batch(len(requests), config, task.preview)
    try:
        for index, request in enumerate(requests):
            batch.reset(index, request)
        steps = round(VALIDATION_DURATION / config.control_period)
        track = np.zeros((steps, len(requests)))
        alive = np.ones(len(requests), dtype=bool)
        for step in range(steps):
            actions = actor.act_batch(task.layout.observe(batch))
            batch.step(task.action.to_commands(actions, batch.vehicle.max_steer))
            track[step] = task.error(batch)
            alive &= ~task.failed(batch)
            # A fallen bicycle would leave the model's range; it lies still for the rest of the ride.
            batch.state[~alive] = 0.0
            if not alive.any():
                break
        return track, alive
    finally:
        batch.close()


def validate_simulator(actor: Actor, task: Task, simulator: Client, requests: list[ResetRequest]) -> list[float]:
    """Ride all requests one after the other through a simulator and return the errors e_i (Eq. 12)."""
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
            return validation_error(np.array(track), False)
        if snapshot.step == round(VALIDATION_DURATION / config.control_period):
            break
    return validation_error(np.array(track), True)
