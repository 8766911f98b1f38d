"""Validation rides during learning: ten random rides of 30 s with the deterministic actor."""

from __future__ import annotations

import numpy as np

from bike_policy.action import ActionScale
from bike_policy.actor import Actor
from bike_sim import ride
from bike_sim.physics.state import ROLL
from bike_sim.physics.vehicle import Vehicle, load_vehicle
from bike_sim.reset import ResetRequest
from bike_training.batch import RideBatch
from bike_training.clients import Client
from bike_training.curriculum import VALIDATION_DURATION, VALIDATION_RIDES, RideRanges
from bike_training.task import Task, failed, validation_error
from bike_training.vec_env import distances


def draw_requests(task: Task, ranges: RideRanges, rng: np.random.Generator) -> list[ResetRequest]:
    """Draw the requests of one validation."""
    return [
        ResetRequest(
            seed=int(rng.integers(2**31)),
            speed_range=ranges.speed,
            path_ranges=ranges.paths,
            path_length=1.2 * VALIDATION_DURATION * ranges.speed[1],
            perturb=True,
            preview=task.preview,
        )
        for _ in range(VALIDATION_RIDES)
    ]


def validate_compiled(
    actor: Actor, task: Task, vehicle: Vehicle, requests: list[ResetRequest], time_step: float = 0.01
) -> list[float]:
    """Ride all requests side by side on the compiled engine and return the errors e_i (Eq. 12)."""
    batch = RideBatch(len(requests), vehicle, task.preview, vehicle.control_period, time_step)
    for index, request in enumerate(requests):
        batch.reset(index, request)
    steps = round(VALIDATION_DURATION / vehicle.control_period)
    track = np.zeros((steps, len(requests)))
    alive = np.ones(len(requests), dtype=bool)
    scale = task.max_steer / vehicle.max_steer
    for step in range(steps):
        actions = actor.act_batch(task.layout.observe(batch.states, batch.preview_y))
        batch.step(np.clip(actions * scale, -1.0, 1.0))
        track[step] = distances(task, batch.seen)
        alive &= ~failed(np.abs(batch.seen[:, ride.LATERAL_ERROR]), batch.states[:, ROLL])
        # A fallen bicycle would leave the model's range; it lies still for the rest of the validation.
        batch.states[~alive] = 0.0
        if not alive.any():
            break
    return [validation_error(track[:, i], bool(alive[i])) for i in range(len(requests))]


def validate_simulator(actor: Actor, task: Task, simulator: Client, requests: list[ResetRequest]) -> list[float]:
    """Ride all requests one after the other through a simulator and return the errors e_i (Eq. 12)."""
    return [_ride(actor, task, simulator, request) for request in requests]


def _ride(actor: Actor, task: Task, simulator: Client, request: ResetRequest) -> float:
    vehicle = load_vehicle("whipple")
    scale = ActionScale(task.max_steer)
    track: list[float] = []
    snapshot = simulator.reset(request)
    for _ in range(round(VALIDATION_DURATION / vehicle.control_period)):
        action = actor.act(task.layout.observe(snapshot.state, snapshot.preview_y))
        snapshot = simulator.step(scale.to_command(action, vehicle.max_steer))
        track.append(float(distances(task, snapshot.seen)))
        if failed(snapshot.distance, snapshot.state[ROLL]):
            return validation_error(np.array(track), False)
    return validation_error(np.array(track), True)
