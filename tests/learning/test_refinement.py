"""Learning through the model: derivatives are those of the engine, and descending them teaches to ride."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bike_policy.contract.bundle import Actor, load_bundle
from bike_policy.contract.observation import FINE_LAYOUT, PROP_LAYOUT, TURN_LAYOUT
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import WhippleEngine
from bike_sim.sim import look as lk
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training import cli
from bike_training.curricula.parts import REFINEMENT, PartsCurriculum
from bike_training.learning import gradients, linear_rides
from bike_training.learning.gradients import (
    STEEP,
    Comparison,
    GradientLearning,
    MirrorSymmetricActor,
    Weights,
    cost,
)
from bike_training.learning.linear_rides import (
    FREE,
    LinearRides,
    ObservationJacobian,
    Segment,
    motion_slopes,
    push_sideways,
)
from bike_training.learning.presets import GradientSettings, load_preset
from bike_training.learning.run_settings import RunSettings
from bike_training.rollout.stability import stability
from bike_training.tasks.path import TASKS

COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)
TASK = TASKS["fine"]
SMALL = GradientSettings(
    layers=(16,), bicycles=6, periods=20, tail=5, updates=2, segments=3, select_every=3, learning_rate=5e-3
)


@pytest.fixture(autouse=True)
def few_rides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compares actors on a few of the rides and at one speed."""
    requests = PartsCurriculum.selection_requests
    monkeypatch.setattr(PartsCurriculum, "selection_requests", lambda *of: requests(*of)[::10])
    monkeypatch.setattr(gradients, "stability", lambda rider: stability(rider, (4.5,)))


def run_of(learner: GradientSettings, start: str = "") -> RunSettings:
    return RunSettings(replace(load_preset("exact"), learner=learner), start=start)


def test_slopes_are_those_of_the_engine_and_of_what_is_seen() -> None:
    request = ResetRequest(seed=5, speed_range=(5.0, 5.0), perturb=True, path_length=200.0, preview=TASK.preview)
    batch = Batch(2, COMPILED, TASK.preview)
    for row in range(2):
        batch.reset(row, request)
    commands = np.full((2, 2), 0.02)
    for _ in range(12):  # into a lean, off the line
        batch.step(commands)
    assert abs(batch.look[0, lk.HEADING_ERROR]) > 0.01
    begun = batch.state_dict()
    slopes = motion_slopes(batch, commands[:, 0])[0]
    sight = ObservationJacobian(TASK.layout)
    far = 1e-4
    for column in range(7):
        batch.restore(begun)
        state, command = batch.state[1], commands.copy()
        if column == 0:
            yaw = state[st.YAW]
            state[[st.X, st.Y]] += far * np.array([-math.sin(yaw), math.cos(yaw)])
        elif column < 6:
            state[(st.YAW, *FREE)[column - 1]] += far
        else:
            command[1, 0] += far
        batch.step(command)
        yaw = batch.state[0, st.YAW]
        moved = batch.state[1] - batch.state[0]
        away = np.array([math.cos(yaw) * moved[st.Y] - math.sin(yaw) * moved[st.X], *moved[[st.YAW, *FREE]]])
        np.testing.assert_allclose(slopes[:, column], away / far, atol=3e-3 * max(1.0, np.abs(away).max() / far))
        error = batch.look[1, lk.LATERAL_ERROR] - batch.look[0, lk.LATERAL_ERROR]
        assert error == pytest.approx(away[0] * math.cos(batch.look[0, lk.HEADING_ERROR]), abs=1e-3 * far)
        seen = TASK.layout.observe(batch)
        told = sight.slopes(batch.preview_xy[:, 0])[0] @ away
        # Observations have single precision; 25 points 0.1 s apart make second differences of their last digit.
        np.testing.assert_allclose(told, (seen[1] - seen[0]).astype(float), atol=0.04 * far + 3e-6)
    batch.close()


def test_a_push_leaves_what_the_disturbance_leaves() -> None:
    batch = Batch(2, COMPILED, TASK.preview)
    for row in range(2):
        batch.reset(row, ResetRequest(seed=row, course="line", speed_range=(3.0, 3.0), preview=TASK.preview))
    push_sideways(batch, 1, 60.0)
    engine = WhippleEngine(batch.vehicle, 1e-4)
    engine.reset(batch.state[0])
    engine.push(0.0, 60.0 / 1e-4, 0.3, 0.9)
    np.testing.assert_allclose(batch.state[1], engine.state(), rtol=1e-9)
    assert batch.state[1, st.ROLL_RATE] < -0.3  # pushed to the left, it falls to the left
    batch.close()


def test_pushed_rides_count_in_a_comparison() -> None:
    process = GradientLearning(run_of(replace(SMALL, impulse=60.0), "whipple_exact"))
    hit: list[int] = []

    def strike(batch: object, row: int, impulse: float) -> None:
        hit.append(row)
        assert abs(impulse) <= 60.0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear_rides, "push_sideways", strike)
        process._rides.ride(process._folded(), 200, 0.0)
    assert {row % 2 for row in hit} == {1}
    found = process.compare()
    assert 0 < found.pushed <= found.ridden
    assert found.pushed_mean_m > found.mean_m
    process.close()


def test_layouts_that_show_the_map_are_refused() -> None:
    with pytest.raises(ValueError, match=r"prop.*yaw_cos.*no slopes"):
        ObservationJacobian(PROP_LAYOUT)


def test_previews_that_are_not_linear_in_their_points_are_refused() -> None:
    with pytest.raises(ValueError, match=r"turn.*preview_turn.*no slopes"):
        ObservationJacobian(TURN_LAYOUT)


def ridden(weights: Weights, actor: MirrorSymmetricActor) -> Segment:
    """Return a segment of rides."""
    rides = LinearRides(SMALL, TASK, REFINEMENT, COMPILED, seed=4)
    segment = rides.ride(actor.folded(weights), 16, push=0.0)
    rides.close()
    return Segment(*(jnp.asarray(part) for part in segment))


def test_the_cost_of_a_changed_actor_is_that_of_its_ride_to_first_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gradients, "_FAR", 0.0)  # these rides neither steer nor lean far
    monkeypatch.setattr(gradients, "_STEEP", 0.0)
    settings = replace(SMALL, tail=0, square=5.0, steer_rate=0.1, change=2.0, lean=2.0, steer=5.0)
    actor = MirrorSymmetricActor(FINE_LAYOUT)
    weights = actor.draw((16,), seed=2)
    weights[-1] = (weights[-1][0] * 30.0, weights[-1][1])  # a new network hardly steers
    segment = ridden(weights, actor)
    assert float(segment.whole.min()) == 1.0
    none = jnp.zeros((16, 6, 6))
    judged = jax.jit(lambda changed, held, rides: cost(settings, actor, changed, held, rides, none))

    def first_order(changed: Weights) -> float:
        return float(judged(changed, weights, segment))

    def in_truth(changed: Weights) -> float:
        return float(judged(changed, changed, ridden(changed, actor)))

    direction = jax.tree.map(
        lambda leaf: jnp.asarray(np.random.default_rng(1).normal(size=leaf.shape), jnp.float32), weights
    )
    changes = []
    for judge in (first_order, in_truth):
        more, less = (
            judge(jax.tree.map(lambda leaf, move, sign=sign: leaf + sign * 3e-3 * move, weights, direction))
            for sign in (1.0, -1.0)
        )
        changes.append(more - less)
    assert abs(changes[1]) > 1e-5
    assert changes[0] == pytest.approx(changes[1], rel=0.03)


def test_the_deployed_network_is_the_odd_part_of_the_learned_one() -> None:
    actor = MirrorSymmetricActor(FINE_LAYOUT)
    weights = actor.draw((16, 8), seed=7)
    weights[-1] = (weights[-1][0] * 100.0, weights[-1][1] + 0.3)
    seen = np.random.default_rng(0).normal(size=(50, FINE_LAYOUT.size)).astype(np.float32)
    answers = actor.folded(weights).act_batch(seen)
    assert np.abs(answers).max() > 0.1
    np.testing.assert_allclose(answers[:, 0], actor.act(weights, jnp.asarray(seen)), atol=2e-6)
    mirrored = actor.folded(weights).act_batch(seen * FINE_LAYOUT.mirror_signs)
    np.testing.assert_allclose(mirrored, -answers, atol=2e-6)


def test_an_actor_that_was_folded_is_taken_up_as_it_was_learned() -> None:
    actor = MirrorSymmetricActor(FINE_LAYOUT)
    weights = actor.draw((16, 8), seed=7)
    weights[-1] = (weights[-1][0], jnp.zeros(1))  # the odd part has none
    again = actor.take(actor.folded(weights))
    for before, after in zip(jax.tree.leaves(weights), jax.tree.leaves(again), strict=True):
        np.testing.assert_allclose(after, before)
    kernels = [np.ones((size, width), np.float32) for size, width in ((8, FINE_LAYOUT.size), (1, 8))]
    other = Actor(kernels, [np.zeros(8, np.float32), np.zeros(1, np.float32)])
    assert actor.take(other)[0][0].shape == (FINE_LAYOUT.size, 8)


def test_an_actor_is_better_by_rides_then_by_stability_then_by_distance() -> None:
    calm = Comparison(105, 0.02, 0.03, 0.2, 0.95, 0.0)
    assert calm.better_than(None)
    assert calm._replace(mean_m=0.01).better_than(calm)
    assert not calm._replace(mean_m=0.01, spectral_radius=1.2).better_than(calm)
    assert not calm._replace(ridden=104, mean_m=0.01).better_than(calm)
    assert calm._replace(ridden=104, pushed=105).better_than(calm._replace(pushed=103))
    assert not calm._replace(spectral_radius=0.8, mean_m=0.021).better_than(calm)


@pytest.mark.slow
def test_it_learns_to_stay_upright_from_nothing() -> None:
    """Within seconds; how exactly it rides in the end stands in docs/reference/results.md."""
    settings = replace(SMALL, bicycles=12, periods=60, tail=20, updates=12, segments=20)
    process = GradientLearning(run_of(settings))
    wholes = []
    for _ in range(settings.segments):
        process.learn()
        wholes.append(float(process.ridden.whole.mean()))
    process.close()
    assert np.mean(wholes[:3]) < 0.8  # a third of the rides hardly bend, and fall late without being steered
    assert np.mean(wholes[-5:]) > 0.95


def test_the_command_writes_the_same_policy_again(tmp_path: Path) -> None:
    first = GradientLearning(run_of(SMALL)).run(tmp_path / "a")
    GradientLearning(run_of(SMALL)).run(tmp_path / "b")
    tensors = [(tmp_path / name / "policy" / "actor.safetensors").read_bytes() for name in "ab"]
    assert tensors[0] == tensors[1]
    rows = list(csv.DictReader((tmp_path / "a" / "refinement.csv").open()))
    assert [row["segment"] for row in rows] == ["3"]
    card = load_bundle(tmp_path / "a" / "policy").training
    assert card["begins_with"] == "nothing"
    assert card["steps"] == first["steps"] == 3 * 20 * 6
    (tmp_path / "evaluation.json").write_text('{"worst_mean_m": 0.5, "rides": []}', encoding="utf-8")
    words = ["export", str(tmp_path / "a"), "--name", "mine", "--evaluation", str(tmp_path / "evaluation.json")]
    assert cli.main([*words, "--within", "3:1.2,4.5:0.8", "--out", str(tmp_path / "mine")]) == 0
    exported = load_bundle(tmp_path / "mine")
    assert exported.action.columns[0].within == ((3.0, 1.2), (4.5, 0.8))
    assert (exported.name, exported.results) == ("mine", {"worst_mean_m": 0.5})
    assert exported.training["steps"] == card["steps"]
    later = GradientLearning(run_of(SMALL, str(tmp_path / "a" / "policy")))
    assert later.summary()["begins_with"]["steps"] == card["steps"]
    later.close()


def test_steep_rides_begin_anew_with_every_segment() -> None:
    rides = LinearRides(replace(SMALL, bicycles=4, steep=0.5), TASK, REFINEMENT, COMPILED, seed=4, starts=STEEP)
    actor = MirrorSymmetricActor(FINE_LAYOUT)
    still = actor.folded(actor.draw((8,), seed=1))
    for _ in range(2):
        first = rides.ride(still, 4, push=0.5).seen[0]
        rolls = FINE_LAYOUT.names.index("roll")
        np.testing.assert_array_equal(first[:2, rolls], 0.0)
        assert np.all(first[2:, rolls] != 0.0)
    rides.close()


def test_an_actor_of_less_reach_steers_the_same_by_a_little_and_less_at_most() -> None:
    whole, short = MirrorSymmetricActor(FINE_LAYOUT), MirrorSymmetricActor(FINE_LAYOUT, 0.8)
    weights = whole.draw((8,), seed=3)
    taken = short.take(whole.folded(weights))
    seen = jnp.asarray(np.random.default_rng(0).normal(size=(20, FINE_LAYOUT.size)), jnp.float32)
    np.testing.assert_allclose(short.act(taken, seen), whole.act(weights, seen), rtol=1e-2, atol=1e-5)
    assert float(jnp.abs(short.act(taken, 1e6 * seen)).max()) <= 0.8 + 1e-6
