"""The environments: Gymnasium's contract, the rules of the episode, and the same ride in all of them."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from bike_sim.physics.state import MIRROR_SIGNS, ROLL
from bike_sim.physics.vehicle_files import load_vehicle
from bike_sim.reset import ResetRequest
from bike_sim.simulator import Simulator, SimulatorConfig
from bike_training.batch import RideBatch
from bike_training.curriculum import Curriculum, RideRanges
from bike_training.env import BikeEnv
from bike_training.task import TASKS
from bike_training.vec_env import CompiledVecEnv

RANGES = Curriculum(part=4, entered_at=-10_000).ranges(0)
COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)


@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_contract(task):
    check_env(BikeEnv("local", task, RANGES, COMPILED), skip_render_check=True)


def test_gymnasium_contract_on_pybullet():
    check_env(BikeEnv("local", "prop"), skip_render_check=True)


def test_batch_rides_as_the_simulator_does():
    """The compiled batch and the simulator on the same engine give the same numbers, bit for bit."""
    task = TASKS["lean"]
    requests = [
        ResetRequest(seed=seed, speed_range=RANGES.speed, path_ranges=RANGES.paths, perturb=True, preview=task.preview)
        for seed in range(5)
    ]
    batch = RideBatch(5, load_vehicle("whipple"), task.preview, time_step=0.01)
    commands = np.random.default_rng(0).uniform(-0.2, 0.2, (30, 5))
    for index, request in enumerate(requests):
        batch.reset(index, request)
    history = [(batch.states.copy(), batch.seen.copy(), batch.preview_y.copy())]
    for row in commands:
        batch.step(row)
        history.append((batch.states.copy(), batch.seen.copy(), batch.preview_y.copy()))
    for index, request in enumerate(requests):
        simulator = Simulator(COMPILED)
        snapshot = simulator.reset(request)
        for step, (states, seen, preview) in enumerate(history):
            np.testing.assert_array_equal(snapshot.state, states[index])
            np.testing.assert_array_equal(snapshot.seen, seen[index])
            np.testing.assert_array_equal(snapshot.preview_y, preview[index])
            if step < len(commands):
                snapshot = simulator.step(commands[step, index])


def test_episode_goes_on_once_after_its_full_length_and_then_begins_anew():
    task = replace(TASKS["prop"], max_steps=3)
    env = BikeEnv("local", task, RideRanges((5.0, 5.0), RANGES.paths), COMPILED)
    first, _ = env.reset(seed=5)
    for _ in range(3):
        last, _, terminated, truncated, _ = env.step(np.zeros(1, dtype=np.float32))
    assert truncated
    assert not terminated
    again, _ = env.reset()
    np.testing.assert_array_equal(again, last)
    for _ in range(3):
        last, _, _, truncated, _ = env.step(np.zeros(1, dtype=np.float32))
    assert truncated
    fresh, _ = env.reset()
    assert not np.array_equal(fresh, last)
    assert not np.array_equal(fresh, first)


def test_compiled_environment_keeps_the_same_rules():
    task = replace(TASKS["prop"], max_steps=3)
    env = CompiledVecEnv(2, task, RideRanges((5.0, 5.0), RANGES.paths), seed=1, time_step=0.01)
    env.reset()
    actions = np.zeros((2, 1), dtype=np.float32)
    for episode in range(2):
        for _ in range(3):
            observations, _, dones, infos = env.step(actions)
        assert dones.all()
        assert all(info["TimeLimit.truncated"] for info in infos)
        same = [np.array_equal(o, i["terminal_observation"]) for o, i in zip(observations, infos, strict=True)]
        assert same == [episode == 0] * 2


def test_a_fall_terminates_and_is_not_a_time_limit():
    env = CompiledVecEnv(1, TASKS["prop"], RANGES, seed=1, time_step=0.01)
    env.reset()
    for _ in range(200):
        _, _, dones, infos = env.step(np.ones((1, 1), dtype=np.float32))
        if dones[0]:
            break
    assert dones[0]
    assert infos[0]["TimeLimit.truncated"] is False


def test_mirrored_ride_gets_the_same_rewards():
    """Mirroring state, path and actions mirrors the ride."""
    task = TASKS["lean"]
    vehicle = load_vehicle("whipple")
    left, right = (RideBatch(1, vehicle, task.preview, time_step=0.01) for _ in range(2))
    request = ResetRequest(seed=4, course="line", speed_range=(4.0, 4.0), preview=task.preview)
    left.reset(0, request)
    right.reset(0, request)
    left.states[0, ROLL] = 0.02
    right.states[0] = left.states[0] * MIRROR_SIGNS
    commands = np.random.default_rng(2).uniform(-0.1, 0.1, 40)
    for command in commands:
        left.step(np.array([command]))
        right.step(np.array([-command]))
        np.testing.assert_array_equal(right.states[0], left.states[0] * MIRROR_SIGNS)
        mine = task.layout.observe(left.states, left.preview_y)
        other = task.layout.observe(right.states, right.preview_y)
        np.testing.assert_allclose(other, mine * task.layout.mirror_signs, atol=1e-6)
