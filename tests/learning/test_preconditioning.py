"""Networks that see observations in other coordinates: nothing is lost, and the deployed actor is the learner's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_policy.contract.bundle import Actor
from bike_policy.contract.observation import LEAN_LAYOUT, PROP_LAYOUT, Rows
from bike_sim.sim.batch import COMPILED_ENGINE
from bike_sim.sim.config import SimulatorConfig
from bike_training.curricula.parts import PartsCurriculum
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.learning.learner import actor_tensors, build_model
from bike_training.learning.preconditioning import coordinates, shown
from bike_training.learning.presets import load_preset
from bike_training.tasks.path import TASKS


def test_preview_points_become_the_lean_preview() -> None:
    """The same line, seen as points every 0.2 s and as leans, is the same to the networks."""
    rng = np.random.default_rng(0)
    seen = Rows.of_path(*(rng.normal(size=(1, size)) for size in (10, 12, LEAN_LAYOUT.preview_count)))
    points = replace(PROP_LAYOUT, preview_interval=0.2, preview_count=11)
    as_lean = LEAN_LAYOUT.observe(seen)[0, -11:]
    changed = (points.observe(seen) @ coordinates(points))[0, -11:]
    assert changed == pytest.approx(as_lean, abs=1e-4)


@pytest.mark.parametrize("name", ["prop", "alt1", "alt2", "lean"])
def test_nothing_is_lost(name: str) -> None:
    assert np.linalg.cond(coordinates(TASKS[name].layout).astype(np.float64)) < 1e4


def test_only_paths_and_only_one_learner() -> None:
    with pytest.raises(ValueError, match="precondition=True is for tasks on paths"):
        coordinates(load_preset("race").task.layout)
    with pytest.raises(ValueError, match="needs the learner sbx, not sb3"):
        build_model(load_preset("paper").changed({"learner.precondition": True}).sac, TASKS["prop"], None, 0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="critic_only=roll needs the learner sbx, not sb3"):
        build_model(load_preset("paper").changed({"learner.critic_only": "roll"}).sac, TASKS["prop"], None, 0)  # type: ignore[arg-type]


def test_what_is_hidden_is_named_by_numbers_or_blocks() -> None:
    layout = load_preset("race").task.layout
    rows = shown(layout, "slips,front_load_n")
    hidden = [name for name, seen in zip(layout.names, rows, strict=True) if not seen]
    assert hidden == ["rear_slip", "front_slip", "front_load_n"]
    assert shown(layout, "").all()
    assert shown(PROP_LAYOUT, "roll").sum() == PROP_LAYOUT.size - 1
    with pytest.raises(ValueError, match="hide 'tires'; the observation has"):
        shown(layout, "slips,tires")
    with pytest.raises(ValueError, match="hide all of the observation"):
        shown(layout, ",".join(layout.terms))


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"critic_only": "roll,steer"},
        {"precondition": "true", "critic_only": "roll", "unseen": "steer"},
    ],
)
def test_the_deployed_actor_answers_as_the_one_that_learns(settings: dict[str, str]) -> None:
    pytest.importorskip("sbx")
    task = TASKS["prop"]
    settings = {"environments": "2", "buffer_size": "100", "layers": "16,16", **settings}
    preset = load_preset("fast").changed({f"learner.{name}": value for name, value in settings.items()})
    episodes = PartsCurriculum().episodes(0)
    env = BatchVecEnv(2, task, episodes, SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01), 0)
    try:
        model = build_model(preset.sac, task, env, 3)
        observations = env.reset()
        wanted, _ = model.predict(observations, deterministic=True)
        weights, biases = actor_tensors(model)
        found = Actor(weights, biases).act_batch(observations)
    finally:
        env.close()
    hidden = shown(task.layout, f"{preset.sac.critic_only},{preset.sac.unseen}") == 0.0
    assert not weights[0][:, hidden].any()
    assert weights[0][:, ~hidden].any(axis=0).all()
    assert np.abs(wanted).max() > 1e-3
    assert found == pytest.approx(wanted, abs=1e-5)
