"""Validation rides during learning: ten random rides of 30 s with the deterministic actor."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.actor import Actor
from bike_sim.course.random_paths import CURRICULUM_PATHS
from bike_sim.physics.state import ROLL
from bike_sim.sim import look as ride
from bike_sim.sim.batch import RideBatch
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.curricula.parts import SPEED_RANGES, VALIDATION_DURATION, VALIDATION_RIDES, RideRanges
from bike_training.envs.clients import Client
from bike_training.tasks.path import DISTANCE_THRESHOLD, Task, distances, failed, has_failed, validation_error

SELECTION_RIDES_PER_SPEED: Final = 5
SELECTION_SEED: Final = 2**32
"""Rides at each of 21 speeds that actors are compared on, and the seed of the first; training draws below 2**31."""


def draw_requests(task: Task, ranges: RideRanges, rng: np.random.Generator) -> list[ResetRequest]:
    """Draw the requests of one validation."""
    length = 1.2 * VALIDATION_DURATION * ranges.speed[1]
    return [ranges.draw(rng, task.preview, length) for _ in range(VALIDATION_RIDES)]


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


def selection_error(actor: Actor, task: Task, vehicle: Vehicle, time_step: float = 0.01) -> float:
    """Return the RMS distance over all selection rides, m; a failed ride counts as 3.5 m throughout.

    The root mean square weighs the places where a ride is worst, which the mean hides.
    """
    track, alive = _ride_batch(actor, task, vehicle, selection_requests(task), time_step)
    track[:, ~alive] = DISTANCE_THRESHOLD
    return float(np.sqrt(np.mean(track**2)))


def validate_compiled(
    actor: Actor, task: Task, vehicle: Vehicle, requests: list[ResetRequest], time_step: float = 0.01
) -> list[float]:
    """Ride all requests side by side on the compiled engine and return the errors e_i (Eq. 12)."""
    track, alive = _ride_batch(actor, task, vehicle, requests, time_step)
    return [validation_error(track[:, i], bool(alive[i])) for i in range(len(requests))]


def _ride_batch(
    actor: Actor, task: Task, vehicle: Vehicle, requests: list[ResetRequest], time_step: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ride on the compiled engine; return the distances (m), shape (steps, rides), and which rides did not fail."""
    batch = RideBatch(len(requests), vehicle, task.preview, vehicle.control_period, time_step)
    for index, request in enumerate(requests):
        batch.reset(index, request)
    steps = round(VALIDATION_DURATION / vehicle.control_period)
    track = np.zeros((steps, len(requests)))
    alive = np.ones(len(requests), dtype=bool)
    for step in range(steps):
        actions = actor.act_batch(task.layout.observe(batch.states, batch.preview_y))
        batch.step(task.action_scale.to_commands(actions, vehicle.max_steer))
        track[step] = distances(task, batch.seen)
        alive &= ~failed(np.abs(batch.seen[:, ride.LATERAL_ERROR]), batch.states[:, ROLL], batch.lying)
        # A fallen bicycle would leave the model's range; it lies still for the rest of the ride.
        batch.states[~alive] = 0.0
        if not alive.any():
            break
    return track, alive


def validate_simulator(actor: Actor, task: Task, simulator: Client, requests: list[ResetRequest]) -> list[float]:
    """Ride all requests one after the other through a simulator and return the errors e_i (Eq. 12)."""
    return [_ride(actor, task, simulator, request) for request in requests]


def _ride(actor: Actor, task: Task, simulator: Client, request: ResetRequest) -> float:
    vehicle = load_vehicle("whipple")
    track: list[float] = []
    snapshot = simulator.reset(request)
    for _ in range(round(VALIDATION_DURATION / vehicle.control_period)):
        action = actor.act(task.layout.observe(snapshot.state, snapshot.preview_y))
        snapshot = simulator.step(task.action_scale.to_command(action, vehicle.max_steer))
        track.append(float(distances(task, snapshot.seen)))
        if has_failed(snapshot):
            return validation_error(np.array(track), False)
    return validation_error(np.array(track), True)
