"""Networks that see observations in other coordinates, and mirrored replay."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import jax
import numpy as np
import pytest

from bike_policy.contract.action import DRIVE, LEAN_REQUEST, ActionColumn, ActionLayout
from bike_policy.contract.bundle import Actor
from bike_policy.contract.observation import COMPACT, LEAN_LAYOUT, PROP_LAYOUT, Rows
from bike_sim.schema import GRAVITY
from bike_sim.vehicles.files import load_vehicle
from bike_training.learning.learner import ON_POLICY, MirrorReplayBuffer, actor_tensors, build_model
from bike_training.learning.preconditioning import coordinates, networks
from bike_training.learning.presets import load_preset
from bike_training.learning.process import make_environment
from bike_training.learning.run_settings import RunSettings
from bike_training.tasks.path import TASKS


def test_preview_points_become_the_lean_preview() -> None:
    """The same line, seen as points every 0.2 s and as leans, is the same to the networks."""
    rng = np.random.default_rng(0)
    seen = Rows.of_path(*(rng.normal(size=(1, *size)) for size in ((10,), (12,), (2, LEAN_LAYOUT.preview_count))))
    points = replace(PROP_LAYOUT, preview_interval=0.2, preview_count=11)
    as_lean = LEAN_LAYOUT.observe(seen)[0, -11:]
    changed = (points.observe(seen) @ coordinates(points))[0, -11:]
    assert changed == pytest.approx(as_lean, abs=1e-4)


@pytest.mark.parametrize("name", ["prop", "alt1", "alt2", "lean", "fine"])
def test_nothing_is_lost(name: str) -> None:
    assert np.linalg.cond(coordinates(TASKS[name].layout).astype(np.float64)) < 1e4


def test_only_paths_and_only_one_learner() -> None:
    with pytest.raises(ValueError, match="precondition=True is for tasks on paths"):
        coordinates(load_preset("race").task.layout)
    with pytest.raises(ValueError, match="needs the learner sbx, not sb3"):
        build_model(load_preset("paper").changed({"learner.precondition": True}).sac, TASKS["prop"], None, 0)  # type: ignore[arg-type]


def test_the_deployed_actor_answers_as_the_one_that_learns() -> None:
    layout = TASKS["prop"].layout
    actor = networks(layout, TASKS["prop"].action)["actor_class"](net_arch=(16, 16), action_dim=1)
    observations = np.random.default_rng(3).normal(size=(2, layout.size)).astype(np.float32)
    params = actor.init(jax.random.PRNGKey(3), observations)
    wanted = actor.apply(params, observations).mode()
    policy = SimpleNamespace(actor=actor, actor_state=SimpleNamespace(params=params))
    found = Actor(*actor_tensors(SimpleNamespace(policy=policy))).act_batch(observations)
    assert np.abs(wanted).max() > 1e-3
    assert found == pytest.approx(np.asarray(wanted), abs=1e-5)


@pytest.mark.parametrize("learner", ["ppo", "a2c"])
def test_learners_without_replay_have_the_same_kind_of_actor(learner: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is deployed answers with the mean of the policy that learned, within [-1, 1]."""
    monkeypatch.setitem(ON_POLICY, "ppo", (ON_POLICY["ppo"][0], 64))  # type: ignore[arg-type]  # updates sooner
    preset = load_preset("paper").changed({"learner": learner, "learner.layers": [8, 8], "learner.environments": 2})
    settings = RunSettings(preset)
    env = make_environment(settings, preset.task, preset.curriculum.make([load_vehicle("whipple")]).episodes(0))
    model = build_model(preset.sac, preset.task, env, 0)
    before = actor_tensors(model)[0][0]
    model.learn(128 if learner == "ppo" else 20)
    assert not np.array_equal(before, actor_tensors(model)[0][0])
    observations = env.reset()
    wanted, _ = model.predict(observations, deterministic=True)
    assert Actor(*actor_tensors(model)).act_batch(observations) == pytest.approx(wanted, abs=1e-6)
    env.close()


@pytest.mark.parametrize("name", ["fine", "turn"])
def test_critics_see_a_steady_turn_as_no_deviation(name: str) -> None:
    """On its line a bicycle leans as the line asks for, and the set point is the steering angle: all of it is 0."""
    task = TASKS[name]
    lean, steer = np.tan(0.3), 0.2
    time = task.layout.preview_interval * np.arange(task.layout.preview_count)
    state, preview = np.zeros((1, 10)), np.stack((1e3 * time, 0.5 * GRAVITY * lean * time**2))
    state[0, [3, 4]] = -lean, steer
    seen = task.layout.observe(Rows.of_path(state, np.zeros((1, 12)), preview[None]))
    changed = dict(zip(task.layout.names, (seen @ coordinates(task.layout))[0], strict=True))
    assert changed["roll"] == pytest.approx(0.0, abs=1e-4)
    assert changed["t_p9"] == pytest.approx(lean / 0.3, rel=1e-3)
    critics = networks(task.layout, task.action)["vector_critic_class"].keywords
    given = steer / task.max_steer
    shown = critics["action_gain"] * given - seen[0] @ critics["action_origin"]
    assert shown == pytest.approx(0.0, abs=1e-5)
    assert critics["action_gain"] * 0.1 / task.max_steer == pytest.approx(1.0)


ACTION = ActionLayout((ActionColumn(LEAN_REQUEST), ActionColumn(DRIVE)))


@pytest.mark.parametrize("layout", [LEAN_LAYOUT, COMPACT], ids=lambda layout: layout.name)
def test_throttle_keeps_its_sign_steering_flips_and_limits_change_sides(layout):
    signs, places = layout.mirror_signs, layout.mirror_places
    buffer = MirrorReplayBuffer(
        1,
        gym.spaces.Box(-np.inf, np.inf, (layout.size,), np.float32),
        gym.spaces.Box(-1.0, 1.0, (2,), np.float32),
        device="cpu",
        mirror_signs=signs,
        mirror_places=places,
        action_signs=ACTION.mirror_signs,
    )
    observation = np.arange(1.0, layout.size + 1.0, dtype=np.float32)
    buffer.add(
        observation[None],
        2.0 * observation[None],
        np.array([[0.25, 0.75]], dtype=np.float32),
        np.array([3.0]),
        np.array([False]),
        [{}],
    )
    np.random.seed(0)
    drawn = buffer.sample(400)
    flipped = drawn.actions[:, 0].numpy() < 0.0
    assert 100 < flipped.sum() < 300  # about half
    np.testing.assert_array_equal(np.abs(drawn.actions[:, 0].numpy()), np.full(400, 0.25, dtype=np.float32))
    np.testing.assert_array_equal(drawn.actions[:, 1].numpy(), np.full(400, 0.75, dtype=np.float32))
    for seen, factor in ((drawn.observations, 1.0), (drawn.next_observations, 2.0)):
        expected = np.where(flipped[:, None], factor * observation[places] * signs, factor * observation)
        np.testing.assert_array_equal(seen.numpy(), expected.astype(np.float32))
    np.testing.assert_array_equal(drawn.rewards.numpy(), np.full((400, 1), 3.0, dtype=np.float32))
