"""The environments under their ids in Gymnasium."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from bike_training.envs.vec_env import BatchVectorEnv
from bike_training.gymnasium_ids import IDS, register


@pytest.mark.parametrize("name", IDS)
def test_ids_make_environments_that_keep_the_contract(name):
    register()
    register()  # a second time changes nothing
    env = gymnasium.make(name)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


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
    assert env.spec.max_episode_steps == IDS[name][2]
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
