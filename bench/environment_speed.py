"""Speed of the environments on one core: physics, projection, preview, observation and reward together.

Processor time of the steps is counted, of the best of some rounds. Rides are steered by a linear balancing law, so that
they last: speed in free fall is not the speed of riding.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from typing import Any, Final

import gymnasium as gym
import numpy as np

from bike_policy.riders.classical import ClassicalRider
from bike_sim.course.files import load_track
from bike_sim.course.random_courses import CURRICULUM_PATHS
from bike_sim.physics.state import ROLL, ROLL_RATE
from bike_sim.schema import GRAVITY
from bike_sim.sim import look as lk
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.benchmark.tasks import benchmark_of
from bike_training.curricula.parts import RideRanges
from bike_training.envs.env import BikeEnv
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.tasks.path import TASKS

SPEED: Final = 5.0
"""m/s; the bicycle balances itself there, so that a ride lasts without a policy."""
RANGES: Final = RideRanges((SPEED, SPEED), CURRICULUM_PATHS[0])
ROUNDS: Final = 5
SUPERBIKE: Final = "panigale_v4r"
SUSPENDED: Final = "gsxr1000"
CIRCUIT: Final = "barcelona"
FROZEN: Final = "two_wheeler/Balance-v0"

Ride = Generator[Callable[[], Any], Any, None]
"""Yields what is timed, a step, and gets what it returned."""


def step_time(ride: Callable[[int], Ride], steps: int) -> float:
    """Return the processor time of a step, s, of the best round.

    Args:
        ride: begins the ride of a round by its number.
        steps: steps of a round.
    """
    best = math.inf
    for number in range(ROUNDS):
        work, found, spent = ride(number), None, 0.0
        for _ in range(steps):
            step = work.send(found)
            begun = time.process_time()
            found = step()
            spent += time.process_time() - begun
        work.close()
        best = min(best, spent / steps)
    return best


def gymnasium(time_step: float, seed: int) -> Ride:
    """Ride the Gymnasium environment with the paper's observation, in PyBullet."""
    env = BikeEnv("local", TASKS["prop"], RANGES, SimulatorConfig(time_step=time_step))
    env.reset(seed=seed)
    while True:
        assert env.snapshot is not None
        roll, roll_rate = env.snapshot.state[[ROLL, ROLL_RATE]]
        action = np.array([np.clip(-0.4 * roll - 0.1 * roll_rate, -1.0, 1.0)], dtype=np.float32)
        _, _, terminated, truncated, _ = yield partial(env.step, action)
        if terminated or truncated:
            env.reset()


def vector(count: int, seed: int) -> Ride:
    """Ride bicycles of the compiled vector environment."""
    env = BatchVecEnv(count, TASKS["prop"], RANGES, SimulatorConfig(engine="whipple", time_step=0.01), seed)
    env.reset()
    falls = 0
    while falls < count:
        states = env.batch.state
        actions = np.clip(-0.4 * states[:, [ROLL]] - 0.1 * states[:, [ROLL_RATE]], -1.0, 1.0).astype(np.float32)
        falls += int((yield partial(env.step, actions))[2].sum())
    raise AssertionError("the balancing law must keep the bicycles up")


def frozen(mode: str, count: int, seed: int) -> Ride:
    """Ride bicycles of a frozen task, as ``make_vec`` makes them: one batch, or an environment each (``sync``)."""
    names = benchmark_of(FROZEN).task.layout.names
    law = np.zeros((len(names), 1), dtype=np.float32)
    law[[names.index("roll"), names.index("roll_rate")], 0] = -0.6, -0.35
    envs = gym.make_vec(FROZEN, num_envs=count, vectorization_mode=mode)
    observations, _ = envs.reset(seed=seed)
    while True:
        observations = (yield partial(envs.step, np.clip(observations @ law, -1.0, 1.0)))[0]


def superbike(_: int) -> Ride:
    """Ride a superbike on a circuit, by the classical rider from the start line on."""
    machine, rider = Simulator(superbike_config(SUPERBIKE)), ClassicalRider()
    snapshot = machine.reset(machine.at_own_speed(ResetRequest(course=CIRCUIT)))
    assert machine.course is not None
    rider.begin(machine.vehicle, machine.course, machine.config.control_period, machine.preview)
    while not snapshot.fallen:
        command = rider.command(snapshot)
        assert command is not None
        snapshot = yield partial(machine.step, *command)
    raise AssertionError("the rider must stay on the track")


def superbike_resets(_: int) -> Ride:
    """Reset a superbike on a circuit whose line is known."""
    machine = Simulator(superbike_config(SUPERBIKE))
    request = machine.at_own_speed(ResetRequest(course=CIRCUIT))
    machine.reset(request)
    while True:
        yield partial(machine.reset, request)


def superbike_batch(count: int, vehicle: str, _: int) -> Ride:
    """Ride superbikes all around the circuit, near its median by the lean of its curvature, in a compiled batch."""
    batch = Batch(count, replace(superbike_config(vehicle), engine="compiled"))
    for row, progress in enumerate(np.linspace(0.0, 0.966 * load_track(CIRCUIT).length, count)):
        batch.reset(row, ResetRequest(course=CIRCUIT, progress=float(progress), speed_share=0.6, line=0.0))
    while batch.fallen.sum() < count // 4:
        speed, error, turned, bend = batch.look[:, [lk.SPEED, lk.LATERAL_ERROR, lk.HEADING_ERROR, lk.CURVATURE]].T
        lean = np.arctan(bend * speed**2 / GRAVITY) - 0.02 * error - 0.5 * turned
        commands = np.stack([np.clip(lean / math.radians(60.0), -1.0, 1.0), np.full(count, 0.05)], axis=1)
        yield partial(batch.step, commands)
    raise AssertionError("most must ride to the end")


def measure(scale: float = 1.0) -> dict[str, float]:
    """Return all figures of this module.

    Args:
        scale: factor on the number of steps of each round.
    """

    def took(ride: Callable[[int], Ride], steps: int) -> float:
        return step_time(ride, max(1, round(scale * steps)))

    return {
        "gymnasium_pybullet_5ms_steps_per_s": 1.0 / took(partial(gymnasium, 0.005), 400),
        "gymnasium_pybullet_1ms_steps_per_s": 1.0 / took(partial(gymnasium, 0.001), 400),
        "vector_of_64_compiled_steps_per_s": 64.0 / took(partial(vector, 64), 100),
        "make_vec_of_64_steps_per_s": 64.0 / took(partial(frozen, "vector_entry_point", 64), 100),
        "sync_vector_env_of_8_steps_per_s": 8.0 / took(partial(frozen, "sync", 8), 50),
        "superbike_step_us": 1e6 * took(superbike, 2000),
        "superbike_reset_us": 1e6 * took(superbike_resets, 50),
        "superbike_batch_of_32_steps_per_s": 32.0 / took(partial(superbike_batch, 32, SUPERBIKE), 100),
        "suspended_batch_of_32_steps_per_s": 32.0 / took(partial(superbike_batch, 32, SUSPENDED), 100),
    }
