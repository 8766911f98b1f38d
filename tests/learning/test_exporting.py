"""Policies in forms that other machines run: each answers as the policy does."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.bundle import Actor, Bundle, load_bundle, shipped_policies
from bike_policy.contract.observation import PROP_LAYOUT, ObservationLayout, Rows
from bike_policy.riders.rider import learned_rider
from bike_sim.schema import LOOK, STATE
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.cli import main
from bike_training.exporting.c_header import CompiledHeader, compiler, make_header, rounded
from bike_training.exporting.onnx_file import LARGEST_DIFFERENCE, check_onnx, largest_difference, onnx_bytes

with_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")
PATH_LAYOUT = ObservationLayout(
    "all", ("x", "y", "yaw_wrapped", "yaw_cos", "roll", "front_wheel", "rear_wheel", "steer_rate", "preview_lean"),
    (0.1, 0.1, 1.0, 1.0, 2.0, 0.01, 0.01, 0.5, 1.0),
)  # fmt: skip


def seen(bundle: Bundle, count: int = 64) -> np.ndarray:
    """Observations of usual size; those of a ride need a plan of the lap, which takes half a minute."""
    size = np.minimum(bundle.layout.high, 0.3)
    return (np.random.default_rng(1).uniform(-1.0, 1.0, (count, bundle.layout.size)) * size).astype(np.float32)


def made(layout: ObservationLayout, layers: tuple[int, ...] = (8,)) -> Bundle:
    """A policy that was not learned."""
    rng, sizes = np.random.default_rng(2), (layout.size, *layers, 1)
    weights = [rng.normal(0.0, 0.3, (b, a)).astype(np.float32) for a, b in itertools.pairwise(sizes)]
    actor = Actor(weights, [rng.normal(0.0, 0.1, size).astype(np.float32) for size in sizes[1:]])
    return Bundle("made */ up", actor, layout, ActionLayout.steering(0.5, ((2.0, 0.4), (4.0, 0.1))), "whipple", 0.05)


@pytest.mark.parametrize("name", shipped_policies())
def test_onnxruntime_answers_as_the_actor_does_in_any_number(name: str, tmp_path: Path) -> None:
    bundle = load_bundle(name)
    path = tmp_path / "actor.onnx"
    path.write_bytes(onnx_bytes(bundle))
    for count in (1, 64):
        allowed = largest_difference(bundle.actor, seen(bundle, count))
        assert check_onnx(path, bundle.actor, seen(bundle, count)) <= allowed
        assert LARGEST_DIFFERENCE <= allowed < (1e-4 if name == "adaptive" else 1e-5)
    other = Actor([weight.T * np.float32(1.01) for weight in bundle.actor.weights], bundle.actor.biases)
    with pytest.raises(ValueError, match="onnxruntime's actions differ by"):
        check_onnx(path, other, seen(bundle))


def test_the_file_says_what_its_numbers_are(tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    bundle = load_bundle("racer")
    (tmp_path / "racer.onnx").write_bytes(onnx_bytes(bundle))
    notes = onnxruntime.InferenceSession(tmp_path / "racer.onnx").get_modelmeta().custom_metadata_map
    assert tuple(json.loads(notes["observation"])) == bundle.layout.names
    assert ObservationLayout.from_card(json.loads(notes["layout"])) == bundle.layout
    assert ActionLayout.from_card(json.loads(notes["action"])) == bundle.action
    assert float(notes["control_period_s"]) == bundle.control_period


@with_compiler
@pytest.mark.parametrize(
    ("name", "weights"), [(name, ("float", "int8")[place % 2]) for place, name in enumerate(shipped_policies())]
)
def test_a_compiled_header_answers_as_the_policy_does(name: str, weights: str) -> None:
    bundle = load_bundle(name)
    observations = seen(bundle)
    header = make_header(bundle, weights, observations, "nowhere")
    actions = CompiledHeader(header).act(observations, bundle.action.size)
    expected = bundle.actor if weights == "float" else rounded(bundle.actor)[2]
    np.testing.assert_allclose(actions, expected.act_batch(observations), atol=2e-5)
    error = np.abs(actions - bundle.actor.act_batch(observations)).max()
    assert error == pytest.approx(header.error, abs=2e-5)  # as the header states
    assert (error > 1e-3) == (weights == "int8")
    assert header.named == (not bundle.layout.races)
    assert header.multiply_adds == sum(weight.size for weight in bundle.actor.weights)


@with_compiler
@pytest.mark.parametrize("layout", [PROP_LAYOUT, PATH_LAYOUT, replace(PATH_LAYOUT, name="short", preview_count=3)])
def test_named_inputs_give_the_observation_and_the_limits_of_the_action(layout: ObservationLayout) -> None:
    bundle, rng = made(layout), np.random.default_rng(3)
    header = make_header(bundle, "float", seen(bundle), "nowhere")
    state, look = rng.uniform(-4.0, 4.0, (200, len(STATE))), rng.uniform(1.0, 5.0, (200, len(LOOK)))
    preview = np.cumsum(rng.uniform(-0.1, 0.1, (200, 2, layout.preview_count)), axis=2)
    columns = [look[:, LOOK.index(name)] if name == "speed" else state[:, STATE.index(name)] for name in header.fields]
    commands = CompiledHeader(header).answer(np.column_stack([*columns, preview[:, 0], preview[:, 1]]), 1)
    actions = bundle.actor.act_batch(layout.observe(Rows.of_path(state, look, preview)))
    expected = bundle.action.to_commands(actions, 1.0, look[:, LOOK.index("speed")])[:, :1]
    np.testing.assert_allclose(commands, expected, atol=1e-4)
    assert np.ptp(expected) > 0.3


@with_compiler
@pytest.mark.parametrize(("name", "largest"), [("whipple_exact", 2e-5), ("whipple", 5e-5)])
def test_the_shipped_bicycles_are_steered_by_their_headers(name: str, largest: float) -> None:
    """Points in single precision tell bends the worse the closer they lie: every 0.1 s, and every 0.05 s."""
    bundle = load_bundle(name)
    header = make_header(bundle, "float", seen(bundle), "nowhere")
    library, rider = CompiledHeader(header), learned_rider(bundle)
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.01))
    snapshot = simulator.reset(
        ResetRequest(course="benchmark", speed_range=(4.0, 4.0), preview=rider.preview or simulator.preview)
    )
    rider.begin(simulator.vehicle, simulator.course, simulator.config.control_period, simulator.preview)
    while snapshot.time < 12.0:
        rows = [snapshot.speed if name == "speed" else snapshot.state[STATE.index(name)] for name in header.fields]
        answer = (
            library.answer(np.array([[*rows, *snapshot.preview_x, *snapshot.preview_y]]), 1)[0, 0]
            / simulator.vehicle.max_steer
        )
        assert answer == pytest.approx(rider.command(snapshot)[0], abs=largest)
        snapshot = simulator.step(float(answer), 0.0)
    assert abs(snapshot.distance) < 0.1


def test_the_command_writes_both_and_refuses_what_it_cannot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    onnx, c = tmp_path / "new" / "p.onnx", tmp_path / "p.h"
    assert main(["export", "whipple", "--onnx", str(onnx), "--c", str(c), "--weights", "int8", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["observations"] == 400
    assert figures["onnx_difference"] <= LARGEST_DIFFERENCE
    (header,) = figures["headers"]
    assert f"{header['rounding_max']:.2g} at most" in " ".join(c.read_text().split())
    assert header["cortex_m4_cycles"] > 7 * header["multiply_adds"]
    assert main(["export", "racer", "--weights", "int8", "--out", str(tmp_path / "coarse"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["figures"] == {"name": "racer", "out": str(tmp_path / "coarse")}
    coarse, racer = load_bundle(tmp_path / "coarse"), load_bundle("racer")
    for mine, theirs in zip(coarse.actor.weights, rounded(racer.actor)[2].weights, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert coarse.layout == racer.layout
    assert coarse.results == {} != racer.results
    for words, message in (
        (["whipple"], "whipple is a policy already; say what to write"),
        (["whipple", "--c", str(c), "--name", "other"], "--name is for a run"),
        (["whipple", "--c", str(c), "--recording", str(tmp_path / "no.mcap")], "no.mcap"),
    ):
        assert main(["export", *words]) == 2
        assert message in capsys.readouterr().err


@with_compiler
def test_the_example_in_c_steers_towards_the_line_and_into_the_lean(tmp_path: Path) -> None:
    bundle = load_bundle("whipple")
    (tmp_path / "bike_whipple.h").write_text(make_header(bundle, "float", seen(bundle), "nowhere").text)
    source = Path(__file__).parents[2] / "examples" / "policy_in_c.c"
    words = [compiler(), "-std=c99", f"-I{tmp_path}", str(source), "-o", str(tmp_path / "policy"), "-lm"]
    subprocess.run(words, check=True)
    said = subprocess.run([tmp_path / "policy"], capture_output=True, text=True, check=True).stdout
    straight, leaning = (float(number) for number in re.findall(r"steer to (-?[\d.]+)", said))
    assert leaning < straight
