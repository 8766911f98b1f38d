import dataclasses
import math
import os
import time
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import save_file

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.bundle import Actor, Bundle, load_bundle, shipped_policies
from bike_policy.contract.observation import LEAN_LAYOUT
from tests.odd_files import ODD, put_odd_file


def make_actor(inputs=LEAN_LAYOUT.size, seed=0):
    rng = np.random.default_rng(seed)
    shapes = [(8, inputs), (8, 8), (1, 8)]
    return Actor(
        [rng.normal(size=s).astype("f4") for s in shapes], [rng.normal(size=s[0]).astype("f4") for s in shapes]
    )


@pytest.fixture
def bundle():
    return Bundle(
        "test", make_actor(), LEAN_LAYOUT, ActionLayout.steering(math.radians(70)), "whipple", 0.05, {"seed": 1}, {}
    )


def test_actor_is_the_torch_network():
    actor = make_actor()
    layers = []
    for weight, bias in zip(actor.weights, actor.biases, strict=True):
        linear = torch.nn.Linear(*weight.shape)
        linear.weight.data = torch.as_tensor(weight.T.copy())
        linear.bias.data = torch.as_tensor(bias)
        layers += [linear, torch.nn.ReLU()]
    network = torch.nn.Sequential(*layers[:-1], torch.nn.Tanh())
    observations = np.random.default_rng(2).normal(size=(20, actor.inputs)).astype("f4")
    expected = network(torch.as_tensor(observations)).detach().numpy()
    np.testing.assert_allclose(actor.act_batch(observations), expected, rtol=1e-5, atol=1e-6)
    assert actor.act(observations[3]) == pytest.approx(expected[3], rel=1e-5, abs=1e-6)
    assert actor.act(observations[3]).shape == (actor.outputs,)


def test_round_trip(bundle, tmp_path):
    bundle.save(tmp_path / "policy")
    loaded = load_bundle(tmp_path / "policy")
    observation = np.linspace(-1, 1, LEAN_LAYOUT.size, dtype="f4")
    assert loaded.actor.act(observation) == bundle.actor.act(observation)
    assert (loaded.layout, loaded.action, loaded.training) == (bundle.layout, bundle.action, bundle.training)


@given(value=st.floats(-1.0, 1.0))
def test_a_held_action_is_the_answer_to_anything(value):
    policy = Bundle("test", make_actor(), LEAN_LAYOUT, ActionLayout.steering(math.radians(70)), "whipple", 0.05)
    held = policy.holding([value])
    seen = np.random.default_rng(3).normal(size=(5, LEAN_LAYOUT.size)).astype("f4")
    np.testing.assert_allclose(held.actor.act_batch(seen), value, atol=1e-5)
    assert (held.layout, held.action) == (policy.layout, policy.action)


@pytest.mark.parametrize("action", [[], [0.0, 0.0], [1.5], [math.nan]])
def test_a_held_action_that_does_not_fit_is_refused(bundle, action):
    with pytest.raises(ValueError, match=r"has 1 numbers in \[-1, 1\] \(steering_set_value\), got"):
        bundle.holding(action)


def test_fit_names_the_difference(bundle):
    bundle.check_fit("whipple", 0.05)
    with pytest.raises(ValueError, match="panigale"):
        bundle.check_fit("panigale", 0.05)
    with pytest.raises(ValueError, match=r"0\.1 s"):
        bundle.check_fit("whipple", 0.1)


def test_unknown_policy_lists_the_shipped_ones():
    with pytest.raises(FileNotFoundError, match="and no folder of that name; there are"):
        load_bundle("no_such_policy")


@given(junk=st.binary(max_size=300))
def test_junk_weights_give_one_clear_error(junk, tmp_path_factory):
    folder = tmp_path_factory.mktemp("policy")
    Bundle("test", make_actor(), LEAN_LAYOUT, ActionLayout.steering(1.0), "whipple", 0.05).save(folder)
    (folder / "actor.safetensors").write_bytes(junk)
    with pytest.raises(ValueError, match=r"actor\.safetensors|not an actor"):
        load_bundle(folder)


def test_wrong_sizes_and_values_are_refused(bundle):
    with pytest.raises(ValueError, match="takes 3 numbers"):
        Bundle("test", make_actor(3), LEAN_LAYOUT, ActionLayout.steering(1.0), "whipple", 0.05)
    with pytest.raises(ValueError, match="shape"):
        bundle.actor.act(np.zeros(3, dtype="f4"))
    with pytest.raises(ValueError, match="not finite"):
        bundle.actor.act(np.full(LEAN_LAYOUT.size, np.nan, dtype="f4"))
    with pytest.raises(ValueError, match="not finite"):
        Actor([np.full((1, 3), np.inf, dtype="f4")], [np.zeros(1, dtype="f4")])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("part", ["weight", "bias"])
@pytest.mark.parametrize(
    ("kind", "value", "message"),
    [("f4", 1e38, r"layer 0 holds a weight of 1e\+38, beyond 1e\+06$"), ("f8", 1e300, "holds values that are not fin")],
)
def test_weights_that_overflow_are_refused_in_one_line(bundle, tmp_path, part, kind, value, message):
    bundle.save(tmp_path)
    tensors = {name: tensor.astype(kind) for name, tensor in bundle.actor.tensors().items()}
    tensors[f"layers.0.{part}"].flat[0] = value
    save_file(tensors, tmp_path / "actor.safetensors")
    check_refused(tmp_path, message)


@pytest.mark.parametrize("name", shipped_policies())
def test_shipped_policies_load(name):
    bundle = load_bundle(name)
    assert bundle.training["commit"] != "unknown"
    assert bundle.results


def check_refused(folder, message):
    begin = time.process_time()
    with pytest.raises((ValueError, FileNotFoundError), match=message) as caught:
        load_bundle(folder)
    assert time.process_time() - begin < 5.0
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 800


@pytest.mark.timeout(30)
@pytest.mark.parametrize("name", ["actor.safetensors", "card.yaml"])
@pytest.mark.parametrize("kind", [*ODD, "missing", "huge"])
def test_files_that_are_no_regular_ones_are_refused_at_once(bundle, tmp_path, monkeypatch, name, kind):
    bundle.save(tmp_path)
    monkeypatch.chdir(tmp_path)
    os.unlink(name)
    if kind == "missing":
        message = f"not a policy bundle: it has no {name}"
    elif kind == "huge":
        message = f"{name} is larger than"
        with open(name, "wb") as stream:
            stream.truncate(2**33)
    else:
        message = f"{name} {put_odd_file(Path(name), kind)}"
    check_refused(tmp_path, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format: 1\nformat: 1", "key 'format' is given twice"),
        ("format: 2024-13-45", "month must be in 1..12"),
        ("format: [" + "1," * 1000 + "]", "policy format a list"),
        ("format: " + "x" * 9000, "policy format 'xxx"),
        ("\n".join(f"k{i}: 1" for i in range(2000)), "policy format None"),
    ],
)
def test_evil_cards_are_refused_in_one_short_line(bundle, tmp_path, text, message):
    bundle.save(tmp_path)
    (tmp_path / "card.yaml").write_text(text)
    check_refused(tmp_path, message)


@pytest.mark.parametrize(
    ("entry", "value", "message"),
    [
        ("format", 99, "format 99"),
        ("layout", {}, "missing entries"),
        ("action", {"meaning": "throttle"}, "action"),
        ("name", "a\x1b[2J", "name of the card .* cannot be shown"),
        ("name", "x" * 201, "name of the card has 201 characters, at most 200"),
        ("vehicle", ["whipple"], "vehicle of the card must be text, got a list"),
        ("control_period_s", -0.05, "above 0 and at most 10 s, got -0.05"),
        ("control_period_s", math.nan, "control_period_s"),
        ("control_period_s", 10**400, "control_period_s"),
        ("control_period_s", "0.05", "control_period_s of the card must be a number"),
        ("training", 3, "training of the card must be a mapping, got 3"),
        ("results", [1], "results of the card must be a mapping, got a list"),
        ("layout", 5, "layout of the card must be a mapping, got 5"),
        ("layout", {"x" * 9000: 1}, "unknown entries"),
        ("action", {"columns": [{"scale": 10**400, "meaning": "steering_set_value"}]}, "too large"),
    ],
)
def test_evil_entries_of_a_card_are_named(bundle, tmp_path, entry, value, message):
    bundle.save(tmp_path)
    card = yaml.safe_load((tmp_path / "card.yaml").read_text())
    (tmp_path / "card.yaml").write_text(yaml.safe_dump({**card, entry: value}))
    check_refused(tmp_path, message)


def test_a_card_that_names_a_thing_twice_is_written_without_aliases(bundle, tmp_path):
    shared = [1, 2, 3]
    twice = dataclasses.replace(bundle, training={"a": shared, "b": shared})
    twice.save(tmp_path)
    assert load_bundle(tmp_path).training == {"a": shared, "b": shared}


@pytest.mark.parametrize("name", ["../policies/whipple", "x" * 100_000, "a\x1b[2Jb", "no\nsuch"])
def test_evil_names_of_policies_are_shown_tame(name):
    check_refused(name, "and no folder of that name")


def test_a_speed_outside_the_training_is_warned_of():
    shipped = load_bundle("whipple")
    assert shipped.speed_warning(2.0) is None is shipped.speed_warning(7.0)
    warning = shipped.speed_warning(99.0)
    assert warning is not None
    assert "2 to 7 m/s, 99 m/s is outside" in warning
