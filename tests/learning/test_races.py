"""Evaluating a racing policy: `bike evaluate` on superbikes and the bundle of a run."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_policy.contract.bundle import Actor, Bundle, load_bundle
from bike_policy.contract.observation import COMPACT, GUIDED
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_training.cli import main
from bike_training.commands.evaluate import _pairs
from bike_training.rollout.races import SLOW, ride_races
from bike_training.tasks.race import RaceTask


def bundle(throttle: float) -> Bundle:
    """Return a policy that goes straight with one throttle."""
    task = RaceTask()
    weights = [np.zeros((2, COMPACT.size), dtype=np.float32)]
    actor = Actor(weights, [np.array([0.0, np.arctanh(throttle)], dtype=np.float32)])
    return Bundle("straight", actor, task.layout, task.action, "panigale_v4r", 0.02)


def test_rides_that_leave_the_track_are_not_whole(oval: str) -> None:
    result = ride_races(bundle(0.3), "panigale_v4r", oval, starts=4)
    assert (result["rides"], result["whole"], result["times_s"], result["best_s"]) == (4, 0, [], None)
    assert result["falls"] + result["walls"] >= 3
    assert [ride["start"] for ride in result["lost"]] == [0, 1, 2, 3]
    for ride in result["lost"]:
        assert (ride["arc_length_m"] is None) == (ride["cause"] == SLOW)
        assert ride["arc_length_m"] is None or 0.0 <= ride["arc_length_m"] < 1200.0
    assert sum(ride["cause"] == "wall" for ride in result["lost"]) == result["walls"]
    assert (result["finished"], result["off_track_s"]) == (0, 0.0)  # no lap whose time off the track could count
    assert 0.02 <= result["outside_s"] < 4 * 60.0
    assert 25.0 < result["theory_s"] < 35.0


def test_an_actor_that_answers_nothing_rides_as_its_guide_and_as_the_classical_rider(
    oval: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "classical", "--vehicle", "panigale_v4r", "--course", oval, "--starts", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    (race,) = json.loads((tmp_path / "races.json").read_text())["races"]
    assert (race["rides"], race["whole"], race["falls"]) == (1, 1, 0)
    assert "classical" in capsys.readouterr().out
    task = RaceTask(observation="guided", guided=True)
    actor = Actor([np.zeros((2, GUIDED.size), dtype=np.float32)], [np.zeros(2, dtype=np.float32)])
    policy = Bundle("nothing", actor, task.layout, task.action, "panigale_v4r", 0.02)
    result = ride_races(policy, "panigale_v4r", oval, starts=1)
    names = ("whole", "falls", "finished", "off_track_s", "outside_s", "lost")
    assert [result[name] for name in names] == [1, 0, 1, 0.0, 0.0, []]
    assert result["best_s"] == pytest.approx(race["best_s"], rel=0.02)


def test_the_engine_and_its_step_are_those_asked_for() -> None:
    """PyBullet and the compiled engine agree to their steps' rounding; another step leads a little elsewhere."""
    kinds = {"compiled": {}, "pybullet": {"engine": "pybullet"}, "fine": {"time_step": 0.001}}
    places = {
        name: ride_races(bundle(0.3), "panigale_v4r", "barcelona", starts=1, **kind)["line_distance_m"]
        for name, kind in kinds.items()
    }
    assert places["pybullet"] == pytest.approx(places["compiled"], abs=1e-6)
    assert 1e-5 < abs(places["fine"] - places["compiled"]) < 0.1
    with pytest.raises(ValueError, match="engine 'whipple' has no tyres"):
        ride_races(bundle(0.3), "panigale_v4r", "barcelona", starts=1, engine="whipple")


def test_rides_are_disturbed_and_lost_ones_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A weak engine, and commands that are late, change where a ride that goes straight is lost."""
    policy, weak = tmp_path / "straight", tmp_path / "weak.yaml"
    bundle(0.3).save(policy)
    weak.write_text("format: bike.disturbances/1\nvehicle: {motor.peak_power: 0.75, motor.peak_torque: 0.75}\n")
    late = tmp_path / "late.yaml"
    late.write_text("format: bike.disturbances/1\ncommand_delay_s: 0.1\nobservation_delay_s: 0.1\n")
    words = ["evaluate", str(policy), "--vehicle", "panigale_v4r", "--starts", "1", "--out", str(tmp_path)]
    assert main([*words, "--disturbances", str(weak), str(late)]) == 1  # for the ride that nothing disturbs
    figures = json.loads((tmp_path / "races.json").read_text())
    assert [race["disturbances"] for race in figures["races"]] == ["none", "weak", "late"]
    assert len({ride["arc_length_m"] for ride in figures["lost"]}) == 3
    lost, printed = figures["lost"][0], capsys.readouterr().out
    assert f"lost: panigale_v4r on barcelona, start 0: {lost['cause']} at {lost['arc_length_m']:.0f} m" in printed


@pytest.mark.parametrize("name", ["wind", "heavy", "delay_50"])
def test_disturbances_that_no_superbike_has_are_refused_before_the_first_ride(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["evaluate", "classical", "--starts", "1", "--disturbances", "grip_095", name, "--out", str(out)]) == 2
    assert not out.exists()


def test_bicycle_policies_and_paths_are_refused() -> None:
    with pytest.raises(ValueError, match="follows paths; it cannot race"):
        ride_races(load_bundle("whipple"), "panigale_v4r", "barcelona", 1)
    with pytest.raises(ValueError, match="benchmark"):
        ride_races(CLASSICAL_SETTINGS, "panigale_v4r", "benchmark", 1)


def test_a_run_becomes_a_bundle_with_its_share_that_is_evaluated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    words = ["train", "panigale_v4r", "--preset", "race_direct", "--out", str(run), "--steps", "60", "--json"]
    words += ["--record-every", "0"]
    small = ("layers=8", "environments=2", "updates=1", "learning_starts=20")
    for setting in ("learner=sb3", "curriculum.share=0.9", *(f"learner.{setting}" for setting in small)):
        words += ["--set", setting]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["figures"]["steps"] == 60
    assert main(["export", str(run), "--which", "last", "--name", "beginner", "--json"]) == 0
    capsys.readouterr()
    assert main(["export", str(run), "--which", "last", "--within", "3:1"]) == 2
    assert "of a bicycle's steering" in capsys.readouterr().err
    assert main(["export", str(run), "--which", "last", "--symmetric"]) == 2
    assert "is for policies of bicycles" in capsys.readouterr().err
    exported = load_bundle(run / "policy")
    assert exported.layout.races
    assert exported.layout == replace(COMPACT, share=0.9)
    out = tmp_path / "races"
    words = ["evaluate", str(run / "policy"), "--starts", "2", "--out", str(out), "--json"]
    words += ["--vehicle", "panigale_v4r", "--course", "barcelona"]
    assert main(words) == 1  # a beginner
    races = json.loads((out / "races.json").read_text())["races"]
    assert [race["whole"] for race in races] == [0]
    assert (out / "races.csv").read_text().startswith("vehicle,circuit,rides")


def test_machines_ride_each_circuit_or_take_circuits_in_turn() -> None:
    assert _pairs("ab", "xyz", False) == [("a", "x"), ("b", "x"), ("a", "y"), ("b", "y"), ("a", "z"), ("b", "z")]
    assert _pairs("ab", "xyz", True) == [("a", "x"), ("b", "y"), ("a", "z")]
