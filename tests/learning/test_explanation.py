"""SHAP values of a policy on a recorded ride: sums, symmetry, and signs that follow the policy."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest

from bike_analysis.read.container import find_files
from bike_policy.contract.action import ActionLayout
from bike_policy.contract.bundle import Actor, Bundle, load_bundle
from bike_policy.contract.observation import LEAN_LAYOUT, PROP_LAYOUT
from bike_training.cli import main
from bike_training.explain.drawing import labels
from bike_training.explain.shap_values import correlation, explain, outputs_of
from tests.bags import split_recording

SMALL = {"permutations": 4, "background": 20, "silent": True}
COURSE = """format: bike.course/1
name: short slalom
description: A run-up and two bends.
closed: false
off_course_limit_m: 3.5
elements:
  - {line: 8.0, section: run-up}
  - {arc: {radius_m: 10.0, angle_deg: -45.0}, section: slalom}
  - {arc: {radius_m: 10.0, angle_deg: 90.0}, section: slalom}
  - {arc: {radius_m: 10.0, angle_deg: -45.0}, section: slalom}
  - {line: 4.0, section: end}
"""


def bundle_of(actor, layout=LEAN_LAYOUT):
    return Bundle("made up", actor, layout, ActionLayout.steering(1.0), "whipple", 0.05)


def random_bundle(layout, rng, hidden=12):
    """A policy that nobody trained."""
    weights = [rng.normal(0.0, 0.4, (hidden, layout.size)), rng.normal(0.0, 0.4, (1, hidden))]
    biases = [rng.normal(0.0, 0.2, hidden), rng.normal(0.0, 0.2, 1)]
    return bundle_of(Actor([w.astype("f4") for w in weights], [b.astype("f4") for b in biases]), layout)


def swapped(bundle, names):
    """The same policy with the opposite answer to some features."""
    tensors = {name: value.copy() for name, value in bundle.actor.tensors().items()}
    places = [place for place, name in enumerate(bundle.layout.names) if name in names]
    tensors["layers.0.weight"][:, places] *= -1.0
    return replace(bundle, actor=Actor.from_tensors(tensors))


def mirrored(bundle):
    """The policy that answers the mirrored observation with the mirrored steering."""
    tensors = {name: value.copy() for name, value in bundle.actor.tensors().items()}
    last = max(int(name.split(".")[1]) for name in tensors)
    tensors["layers.0.weight"] *= bundle.layout.mirror_signs
    for part in ("weight", "bias"):
        tensors[f"layers.{last}.{part}"] *= -1.0
    return replace(bundle, actor=Actor.from_tensors(tensors))


def sign_of(explanation, place):
    """The correlation of a feature with its SHAP values."""
    return correlation(explanation.features[:, place], explanation.values[:, place])


def observations_of(layout, rng, count=40):
    return rng.normal(0.0, 0.3, (count, layout.size)).astype("f4")


# ---------------------------------------------------------------------------------------------------------- the values


def test_values_sum_to_the_output_minus_the_base():
    rng, layout = np.random.default_rng(1), PROP_LAYOUT
    bundle, observations = random_bundle(layout, rng), observations_of(layout, rng)
    explanation = explain(bundle, observations, **SMALL)
    sums = explanation.values.sum(axis=1)
    np.testing.assert_allclose(sums, outputs_of(bundle, observations) - explanation.base, atol=1e-6)
    assert explanation.additivity_error < 1e-6
    assert np.ptp(sums) > 0.1  # there is something to share


def test_a_linear_policy_has_the_values_of_the_closed_form():
    rng = np.random.default_rng(2)
    weight = 1e-3 * rng.normal(size=(1, LEAN_LAYOUT.size))  # so small that the tanh is a line
    bundle = bundle_of(Actor([weight.astype("f4")], [np.zeros(1, dtype="f4")]))
    observations = observations_of(LEAN_LAYOUT, rng, count=20)
    explanation = explain(bundle, observations, **SMALL)
    expected = weight * (observations - observations.mean(axis=0))
    np.testing.assert_allclose(explanation.values, expected, atol=2e-8)


def test_the_mirrored_policy_on_the_mirrored_ride_has_the_opposite_values():
    rng = np.random.default_rng(3)
    bundle, observations = random_bundle(LEAN_LAYOUT, rng), observations_of(LEAN_LAYOUT, rng)
    one = explain(bundle, observations, **SMALL)
    other = explain(mirrored(bundle), observations * LEAN_LAYOUT.mirror_signs, **SMALL)
    np.testing.assert_allclose(other.values, -one.values, atol=1e-6)
    np.testing.assert_allclose(other.features, one.features * LEAN_LAYOUT.mirror_signs, rtol=1e-12)
    for place in (LEAN_LAYOUT.names.index(name) for name in ("roll", "roll_rate", "steer")):
        assert sign_of(other, place) == pytest.approx(sign_of(one, place), abs=1e-4)


def test_correlation_is_that_of_the_textbook():
    rng = np.random.default_rng(6)
    x = rng.normal(size=50)
    assert correlation(x, -2.0 * x + 1.0) == pytest.approx(-1.0)
    assert np.isnan(correlation(x, np.full(50, 3.0)))


def test_labels_name_every_number_once():
    for layout in (LEAN_LAYOUT, PROP_LAYOUT):
        assert len(set(labels(layout))) == layout.size
    assert "t_p3: line 1.2 s ahead" in labels(PROP_LAYOUT)


# ------------------------------------------------------------------------------------------------------ a recorded ride


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A short slalom, ridden by the shipped policy through the nodes."""
    pytest.importorskip("rclpy")
    folder = tmp_path_factory.mktemp("slalom")
    (folder / "short_slalom.yaml").write_text(COURSE)
    words = ["ride", "--course", str(folder / "short_slalom.yaml"), "--engine", "whipple", "--out", str(folder)]
    assert main([*words, "--json"]) == 0
    return folder / "ride.mcap"


@pytest.fixture(scope="module")
def seen(recording):
    from bike_training.explain.observations import read_observations

    return read_observations(recording, load_bundle("whipple"), "slalom")


@pytest.mark.ros
def test_observations_are_those_that_were_driven_on(seen):
    """The policy answers each of them as it did in the ride."""
    bundle = load_bundle("whipple")
    assert len(seen.observations) > 100
    assert seen.differ < 1e-6
    assert np.ptp(outputs_of(bundle, seen.observations)) > 0.1


@pytest.mark.ros
def test_a_recording_in_several_files_shows_the_same(recording, seen, tmp_path):
    from bike_training.explain.observations import read_observations

    assert len(find_files(split_recording(recording, tmp_path / "split", 2.0))) > 3
    split = read_observations(tmp_path / "split", load_bundle("whipple"), "slalom")
    np.testing.assert_array_equal(split.observations, seen.observations)
    assert split.differ == seen.differ


@pytest.mark.ros
def test_signs_follow_the_policy(seen):
    bundle = load_bundle("whipple")
    roll = bundle.layout.names.index("roll")
    shipped = explain(bundle, seen.observations[::3], **SMALL)
    assert sign_of(shipped, roll) < -0.9  # it steers into the fall
    fallen = explain(swapped(bundle, ["roll"]), seen.observations[::3], **SMALL)
    assert sign_of(fallen, roll) > 0.9


@pytest.mark.ros
def test_command_explains_the_policy_that_the_recording_names(recording, tmp_path, capsys, monkeypatch):
    few = functools.partial(explain, permutations=4, background=20)
    monkeypatch.setattr("bike_training.commands.explain.explain", few)
    assert main(["analyze", str(recording), "--explain", "--out", str(tmp_path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    figures = result["figures"]
    assert result["schema"] == "bike.analyze_explanation/2"
    assert (figures["policy"], figures["section"], figures["course"]) == ("whipple", "slalom", "short slalom")
    assert figures["commands_differ"] < 1e-6
    assert figures["additivity_error"] < 1e-5
    (action,) = figures["actions"]
    sizes = [part["mean_abs"] for part in action["parts"]]
    assert sizes == sorted(sizes, reverse=True)
    assert {part["name"]: part["correlation"] for part in action["parts"]}["roll"] < -0.9
    assert json.loads((tmp_path / "explanation.json").read_text()) == figures
    assert (tmp_path / "explanation.png").stat().st_size > 20_000


@pytest.mark.ros
def test_another_policy_is_explained_but_said_to_be_another(recording, tmp_path, capsys):
    swapped(load_bundle("whipple"), ["roll"]).save(tmp_path / "other")
    words = ["analyze", str(recording), "--explain", "--policy", str(tmp_path / "other"), "--section", "end"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert "did not drive the ride" in " ".join(capsys.readouterr().out.split())


@pytest.mark.ros
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["{ride}", "--section", "circle"], "no section 'circle'; there is run-up, slalom, end, all"),
        (["{ride}", "--ride", "7"], "no ride 7"),
        (["{ride}", "--policy", "classical"], "no policy 'classical'"),
        (["{ride}", "--policy", "{tmp}"], "card.yaml"),
        (["{ride}.not"], "ride.mcap.not"),
        (["{tmp}"], "mcap"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(recording, words, message, tmp_path, capsys):
    filled = [word.format(ride=recording, tmp=tmp_path) for word in words]
    assert main(["analyze", "--explain", *filled, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
