"""The environments: Gymnasium's contract, the rules of the episode, and the same ride in all of them."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import EventKind
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import DIVERGED
from bike_training.curricula.parts import PartsCurriculum, RideRanges
from bike_training.envs.env import BikeEnv
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.tasks.path import TASKS

LAST_PART = PartsCurriculum()
LAST_PART.part, LAST_PART.entered_at = 4, -10_000
RANGES = LAST_PART.episodes(0)
COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)


@pytest.mark.parametrize(("task", "config"), [("alt2", COMPILED), ("fine", COMPILED), ("prop", SimulatorConfig())])
def test_gymnasium_contract(task, config):
    check_env(BikeEnv("local", task, RANGES, config))


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
    env = BatchVecEnv(2, task, RideRanges((5.0, 5.0), RANGES.paths), COMPILED, seed=1)
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
    env = BatchVecEnv(1, TASKS["prop"], RANGES, COMPILED, seed=1)
    env.reset()
    for _ in range(200):
        _, _, dones, infos = env.step(np.ones((1, 1), dtype=np.float32))
        if dones[0]:
            break
    assert dones[0]
    assert infos[0]["TimeLimit.truncated"] is False


def diverge_from(simulator: Simulator, monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    """Give states that are not numbers from a control step on."""
    slot, made = simulator.batch._slot, []
    advance = slot.advance

    def diverging(commands, rows) -> None:
        made.append(None)
        advance(commands, rows)
        if len(made) > step - 1:
            rows.moved[:] = np.nan

    monkeypatch.setattr(slot, "advance", diverging)


@pytest.mark.parametrize("config", [COMPILED, SimulatorConfig(time_step=0.005)], ids=lambda config: config.engine)
def test_physics_that_diverges_ends_the_episode_with_numbers(config, monkeypatch):
    """The last state that is one is shown again, as a fall."""
    client = Simulator(config)
    diverge_from(client, monkeypatch, 3)
    env = BikeEnv(client, "prop")
    env.reset(seed=1)
    steps = [env.step(np.zeros(1, dtype=np.float32)) for _ in range(3)]
    assert [terminated for _, _, terminated, _, _ in steps] == [False, False, True]
    last, snapshot = steps[-1], env.snapshot
    assert snapshot is not None
    assert (snapshot.step, snapshot.time, snapshot.fallen, snapshot.fall) == (3, 3 * 0.05, True, DIVERGED)
    assert [event.kind for event in snapshot.events] == [EventKind.FALL]
    np.testing.assert_array_equal(last[0], steps[-2][0])
    assert np.isfinite(last[0]).all()
    assert np.isfinite([last[1], *(value for name, value in last[4].items() if name != "request")]).all()
    again = client.step(0.0)
    assert (again.step, again.fallen, again.events) == (4, True, ())  # a fall is told once
    env.close()


def test_a_bicycle_that_lies_on_the_ground_ends_its_episode():
    """Below the threshold of roll too: it would lie there for the rest of the episode."""
    env = BatchVecEnv(2, TASKS["prop"], RANGES, COMPILED, seed=1)
    env.reset()
    env.batch._slot._lying[1] = True
    before = env.batch.state[1].copy()
    _, _, dones, infos = env.step(np.zeros((2, 1), dtype=np.float32))
    assert list(dones) == [False, True]
    assert infos[1]["TimeLimit.truncated"] is False
    np.testing.assert_array_equal(infos[1]["terminal_observation"][:2], before[:2].astype(np.float32))
    assert not env.batch._slot._lying.any()


def test_seed_decides_the_rides_after_the_next_reset():
    env = BatchVecEnv(2, TASKS["prop"], RANGES, COMPILED, seed=1)
    fresh = env.reset()
    later = env.reset()
    env.seed(1)
    np.testing.assert_array_equal(env.reset(), fresh)
    np.testing.assert_array_equal(env.reset(), later)
    assert not np.array_equal(fresh, later)


def test_a_method_answers_for_each_bicycle_that_is_asked():
    env = BatchVecEnv(3, TASKS["prop"], RANGES, COMPILED, seed=1)
    assert env.env_method("set_episodes", RANGES) == [None] * 3
    assert env.env_method("set_episodes", RANGES, indices=[0, 2]) == [None] * 2


def test_actions_mean_the_same_in_every_environment():
    """Also where the action is not the vehicle's own set point, in batches as one by one."""
    task = replace(TASKS["prop"], max_steer=0.3)
    single = BikeEnv("local", task, RANGES, COMPILED)
    batch = BatchVecEnv(1, task, RANGES, COMPILED, seed=0)
    single.reset(seed=3)
    request = single.client.request
    batch.reset()
    batch.batch.reset(0, request)
    for action in np.random.default_rng(0).uniform(-1.0, 1.0, (10, 1)).astype(np.float32):
        single.step(action)
        batch.step(action[None, :])
        np.testing.assert_array_equal(single.snapshot.state, batch.batch.state[0])
