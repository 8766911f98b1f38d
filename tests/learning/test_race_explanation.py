"""SHAP values of a racing policy's blocks, and what it sees of a ride that was ridden before."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from bike_policy.contract.action import LINE_OFFSET, PACE, ActionColumn, ActionLayout
from bike_policy.contract.bundle import Actor, Bundle, load_bundle
from bike_policy.contract.observation import GUIDED
from bike_policy.riders.racing import RacingRider
from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.explain.drawing import draw
from bike_training.explain.observations import Onlooker
from bike_training.explain.shap_values import explain
from bike_training.replay import RecordedCommands
from bike_training.rollout.rollout import rollout

ACTION = ActionLayout((ActionColumn(LINE_OFFSET, 0.6), ActionColumn(PACE, 0.05)))
SMALL = {"permutations": 3, "background": 20, "most": 15, "silent": True}


def bundle_of(weights: list[np.ndarray]) -> Bundle:
    actor = Actor([w.astype("f4") for w in weights], [np.zeros(len(w), dtype="f4") for w in weights])
    return Bundle("made up", actor, GUIDED, ACTION, "panigale_v4r", 0.02)


def made_up(seed: int) -> tuple[Bundle, np.ndarray]:
    rng = np.random.default_rng(seed)
    weights = [rng.normal(0.0, 0.2, (b, a)) for a, b in pairwise((GUIDED.size, 12, 2))]
    return bundle_of(weights), rng.uniform(-1.0, 1.0, (40, GUIDED.size)).astype("f4")


def test_values_of_blocks_sum_to_the_actions() -> None:
    bundle, observations = made_up(1)
    found = explain(bundle, observations, **SMALL)
    assert found.values.shape == (15, len(GUIDED.terms), 2)
    assert found.additivity_error < 1e-6
    assert np.all(np.ptp(found.outputs, axis=0) > [0.01, 0.001])  # there is something to share
    np.testing.assert_allclose(found.shares.sum(axis=0), 1.0)


def test_a_linear_policy_has_the_values_of_the_closed_form() -> None:
    rng = np.random.default_rng(2)
    weight = 1e-4 * rng.normal(size=(2, GUIDED.size))  # so small that the tanh is a line
    observations = rng.uniform(-1.0, 1.0, (15, GUIDED.size)).astype("f4")
    found = explain(bundle_of([weight]), observations, **SMALL)
    parts = (observations - observations.mean(axis=0))[:, None, :] * weight * np.array([[0.6], [0.05]])
    expected = np.stack([parts[..., places].sum(axis=-1) for places in GUIDED.places.values()], axis=1)
    np.testing.assert_allclose(found.values, expected, atol=2e-8)


def test_blocks_without_weights_or_without_changes_have_no_value(tmp_path: Path) -> None:
    bundle, observations = made_up(3)
    tensors = bundle.actor.tensors()
    tensors["layers.0.weight"][:, GUIDED.places["stations"]] = 0.0
    observations[:, GUIDED.places["limits"]] = 0.3
    found = explain(replace(bundle, actor=Actor.from_tensors(tensors)), observations, **SMALL)
    for name in ("stations", "limits"):
        assert np.abs(found.values[:, GUIDED.terms.index(name)]).max() < 1e-8
    assert found.steady == ("limits",)
    assert np.abs(found.values).max() > 1e-3
    draw(found, "made up", tmp_path / "blocks.png")
    assert (tmp_path / "blocks.png").stat().st_size > 10_000


def test_who_looks_on_sees_what_who_rides_sees() -> None:
    bundle = load_bundle("spdl_barcelona")  # has no guide, whose plan would take most of the time
    layout = bundle.layout
    request = ResetRequest(course="barcelona", progress=700.0, speed_range=(25.0, 25.0), seed=4, perturb=True)
    config = replace(superbike_config("panigale_v4r"), engine=SUPERBIKE_ENGINE)
    commands = []
    with_policy = Simulator(config)
    for snapshot in rollout(with_policy, RacingRider(bundle), request):
        commands.append((snapshot.steering, snapshot.throttle))
        if snapshot.step == 100:
            break
    with_policy.close()
    given = np.array(commands[1:])
    seen = []
    for turned in (1.0, -1.0):
        onlooker = Onlooker(bundle, RecordedCommands(given[:, 0], turned * given[:, 1]))
        again = Simulator(config)
        assert sum(1 for _ in rollout(again, onlooker, request)) > 30
        again.close()
        assert onlooker.steps == list(range(0, layout.repeat * len(onlooker.steps), layout.repeat))
        assert (onlooker.differ == 0.0) == (turned == 1.0)
        seen.append(np.stack(onlooker.seen))
    assert seen[0].shape == (34, layout.size)
    assert not np.array_equal(seen[0][1], seen[1][1])
