"""The environments under their ids in Gymnasium."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_learners

from bike_sim.sim.config import SimulatorConfig
from bike_training.envs.env import BikeEnv
from bike_training.envs.vec_env import BatchVectorEnv
from bike_training.gymnasium_ids import IDS, register


@pytest.mark.parametrize("name", IDS)
def test_ids_make_environments_that_keep_both_contracts_and_are_drawn(name):
    """Nothing but the path's observation, of which no task bounds all, is warned of."""
    register()
    register()  # a second time changes nothing
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always", UserWarning)
        env = gymnasium.make(name, render_mode="rgb_array")
        check_env(env.unwrapped)
        check_for_learners(env.unwrapped)
    unexpected = [str(warning.message) for warning in warned if "is infinity" not in str(warning.message)]
    unexpected = [message for message in unexpected if "is -infinity" not in message]
    assert unexpected == []
    assert bool(warned) == (not env.observation_space.is_bounded())
    assert env.action_space.is_bounded()
    env.reset(seed=1)
    frame = env.render()
    assert (frame.shape, frame.dtype) == ((540, 960, 3), np.uint8)
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 50
    env.close()


def test_nothing_is_drawn_unless_it_is_asked_for():
    env = BikeEnv(config=SimulatorConfig(engine="whipple", time_step=0.01))
    env.reset(seed=1)
    assert env.render() is None
    with pytest.raises(ValueError, match="render_mode must be rgb_array or None, got 'human'"):
        BikeEnv(render_mode="human")


@pytest.mark.parametrize("order", ["gymnasium, bike_training", "bike_training, gymnasium"])
def test_importing_the_package_registers_them(order):
    """In any order, and the environment of the bicycle needs no learner."""
    code = f"""
import sys
sys.modules["stable_baselines3"] = None  # whoever imports it fails
import {order}
env = gymnasium.make("bike_training/Whipple-v0")
env.reset(seed=1)
print(env.spec.id, len(env.step(env.action_space.sample())))"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert ended.stdout.split() == ["bike_training/Whipple-v0", "5"], ended.stderr


@pytest.mark.parametrize("name", IDS)
def test_a_vector_environment_is_one_compiled_batch(name):
    env = gymnasium.make_vec(name, num_envs=3)
    assert isinstance(env.unwrapped, BatchVectorEnv)
    assert env.spec.max_episode_steps == IDS[name][1]
    first, _ = env.reset(seed=4)
    assert first.shape == (3, *env.single_observation_space.shape)
    again, _ = env.reset(seed=4)
    np.testing.assert_array_equal(first, again)
    ends = 0
    for _ in range(60):
        observations, rewards, terminated, truncated, infos = env.step(np.ones(env.action_space.shape, np.float32))
        assert env.observation_space.contains(observations)
        assert rewards.shape == terminated.shape == truncated.shape == (3,)
        ends += int(terminated.sum())
        assert ("final_obs" in infos) == bool((terminated | truncated).any())
    assert ends > 0
    env.close()


def test_options_that_a_batch_does_not_have_are_refused():
    with pytest.raises(ValueError, match="no option render_mode='human'"):
        gymnasium.make_vec("bike_training/Whipple-v0", num_envs=2, render_mode="human")
