"""Speed of the environments on one core: physics, projection, preview, observation and reward together.

Processor time of the steps is counted. Rides are steered by a linear balancing law, so that they last: speed in free
fall is not the speed of riding.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, Final

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
from bike_training.curricula.parts import RideRanges
from bike_training.envs.env import BikeEnv
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.tasks.path import TASKS

SPEED: Final = 5.0
"""m/s; the bicycle balances itself there, so that a ride lasts without a policy."""

ROUNDS: Final = 5

SUPERBIKE: Final = "panigale_v4r"
SUSPENDED: Final = "gsxr1000"
CIRCUIT: Final = "barcelona"


def gymnasium_speed(time_step: float, engine: str = "pybullet", steps: int = 400) -> float:
    """Return steps per second of the Gymnasium environment with the paper's observation, the best of some rounds.

    Args:
        time_step: integration step, s.
        engine: physics engine.
        steps: steps of a round.
    """
    config = SimulatorConfig(engine=engine, time_step=time_step)
    env = BikeEnv("local", TASKS["prop"], RideRanges((SPEED, SPEED), CURRICULUM_PATHS[0]), config)
    best = 0.0
    for seed in range(ROUNDS):
        env.reset(seed=seed)
        spent = 0.0
        for _ in range(steps):
            assert env.snapshot is not None
            roll, roll_rate = env.snapshot.state[ROLL], env.snapshot.state[ROLL_RATE]
            action = np.array([np.clip(-0.4 * roll - 0.1 * roll_rate, -1.0, 1.0)], dtype=np.float32)
            begun = time.process_time()
            _, _, terminated, truncated, _ = env.step(action)
            spent += time.process_time() - begun
            if terminated or truncated:
                env.reset()
        best = max(best, steps / spent)
    env.close()
    return best


def vector_speed(count: int = 64, steps: int = 100) -> float:
    """Return steps per second of all bicycles of the compiled vector environment together, the best of some rounds.

    Args:
        count: number of bicycles.
        steps: steps of a round.
    """
    ranges = RideRanges((SPEED, SPEED), CURRICULUM_PATHS[0])
    config = SimulatorConfig(engine="whipple", time_step=0.01)
    best = 0.0
    for seed in range(ROUNDS):
        env = BatchVecEnv(count, TASKS["prop"], ranges, config, seed)
        env.reset()
        env.step(np.zeros((count, 1), dtype=np.float32))
        begun, falls = time.process_time(), 0
        for _ in range(steps):
            states = env.batch.state
            actions = np.clip(-0.4 * states[:, ROLL] - 0.1 * states[:, ROLL_RATE], -1.0, 1.0).astype(np.float32)[
                :, None
            ]
            falls += int(env.step(actions)[2].sum())
        spent = time.process_time() - begun
        best = max(best, count * steps / spent)
        assert falls < count, "the balancing law must keep the bicycles up"
    return best


def superbike_speed(steps: int = 2000) -> float:
    """Return the time of a control step of a superbike on a circuit, with all that it sees, us, the best of rounds.

    Args:
        steps: steps of a round, ridden by the classical rider from the start line on.
    """
    machine = Simulator(superbike_config(SUPERBIKE))
    rider, request = ClassicalRider(), machine.at_own_speed(ResetRequest(course=CIRCUIT))
    best = math.inf
    for _ in range(ROUNDS):
        snapshot = machine.reset(request)
        assert machine.course is not None
        rider.begin(machine.vehicle, machine.course, machine.config.control_period, machine.preview)
        spent = 0.0
        for _ in range(steps):
            command = rider.command(snapshot)
            assert command is not None
            begun = time.process_time()
            snapshot = machine.step(*command)
            spent += time.process_time() - begun
        assert not snapshot.fallen, "the rider must stay on the track"
        best = min(best, 1e6 * spent / steps)
    machine.close()
    return best


def superbike_reset(resets: int = 50) -> float:
    """Return the time of a reset of a superbike on a circuit whose line is known, us, the best of some rounds.

    Args:
        resets: resets of a round.
    """
    machine = Simulator(superbike_config(SUPERBIKE))
    request = machine.at_own_speed(ResetRequest(course=CIRCUIT))
    machine.reset(request)
    best = math.inf
    for _ in range(ROUNDS):
        begun = time.process_time()
        for _ in range(resets):
            machine.reset(request)
        best = min(best, 1e6 * (time.process_time() - begun) / resets)
    machine.close()
    return best


def superbike_batch_speed(count: int = 32, steps: int = 100, vehicle: str = SUPERBIKE) -> float:
    """Return control steps per second of all superbikes of a compiled batch together, the best of some rounds.

    They begin all around the circuit and keep near its median by asking for the lean of its curvature.

    Args:
        count: number of superbikes.
        steps: steps of a round.
        vehicle: name of the superbike.
    """
    config = replace(superbike_config(vehicle), engine="compiled")
    batch = Batch(count, config)
    places = np.linspace(0.0, 0.966 * load_track(CIRCUIT).length, count)
    best = 0.0
    for _ in range(ROUNDS):
        for row, progress in enumerate(places):
            batch.reset(row, ResetRequest(course=CIRCUIT, progress=float(progress), speed_share=0.6, line=0.0))
        spent = 0.0
        for _ in range(steps):
            speed, error, turned, bend = batch.look[:, [lk.SPEED, lk.LATERAL_ERROR, lk.HEADING_ERROR, lk.CURVATURE]].T
            lean = np.arctan(bend * speed**2 / GRAVITY) - 0.02 * error - 0.5 * turned
            commands = np.stack([np.clip(lean / math.radians(60.0), -1.0, 1.0), np.full(count, 0.05)], axis=1)
            begun = time.process_time()
            batch.step(commands)
            spent += time.process_time() - begun
        assert batch.fallen.sum() < count // 4, "most must ride to the end"
        best = max(best, count * steps / spent)
    batch.close()
    return best


def measure(scale: float = 1.0) -> dict[str, Any]:
    """Return all figures of this module.

    Args:
        scale: factor on the number of steps of each round.
    """

    def steps(count: int) -> int:
        return max(1, round(scale * count))

    return {
        "gymnasium_pybullet_5ms_steps_per_s": gymnasium_speed(0.005, steps=steps(400)),
        "gymnasium_pybullet_1ms_steps_per_s": gymnasium_speed(0.001, steps=steps(400)),
        "vector_of_64_compiled_steps_per_s": vector_speed(64, steps(100)),
        "superbike_step_us": superbike_speed(steps(2000)),
        "superbike_reset_us": superbike_reset(steps(50)),
        "superbike_batch_of_32_steps_per_s": superbike_batch_speed(32, steps(100)),
        "suspended_batch_of_32_steps_per_s": superbike_batch_speed(32, steps(100), SUSPENDED),
    }
