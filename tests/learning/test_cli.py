"""The `bike` command from outside."""

import json

import numpy as np
import pytest

from bike_policy.action import ActionScale
from bike_policy.actor import Actor
from bike_policy.bundle import Bundle
from bike_policy.observation import LEAN_LAYOUT
from bike_training.cli import COMMANDS, main


@pytest.fixture
def policy(tmp_path):
    """A linear law that balances and follows: steer into the fall, lean into the bend."""
    weight = np.zeros((1, LEAN_LAYOUT.size), dtype="f4")
    names = list(LEAN_LAYOUT.names)
    scales = dict(zip(LEAN_LAYOUT.features, LEAN_LAYOUT.scales, strict=True))
    weight[0, names.index("roll")] = -1.2 / scales["roll"]
    weight[0, names.index("roll_rate")] = -0.35 / scales["roll_rate"]
    actor = Actor([weight], [np.zeros(1, dtype="f4")])
    Bundle("linear", actor, LEAN_LAYOUT, ActionScale(np.radians(70)), "whipple", 0.05, {"seed": 0}).save(tmp_path / "p")
    return tmp_path / "p"


def run_json(capsys, *words):
    code = main([*words, "--json"])
    out = capsys.readouterr().out
    assert len(out.strip().splitlines()) == 1
    return code, json.loads(out)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_shows_how_to_use_it(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert "--json" in text
    assert "example" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["evaluate", "no_such_policy"], "no_such_policy"),
        (["train", "whipple", "--out", "{tmp}", "--resume"], "no run to resume"),
        (["train", "whipple", "--out", "{tmp}", "--set", "gama=0.9"], "gama"),
        (["train", "whipple", "--out", "{tmp}", "--set", "gamma=high"], "high"),
        (["export", "{tmp}"], "no checkpoint"),
        (["analyze", "{tmp}/nothing.mcap"], "nothing.mcap"),
        (["bench", "everything"], "everything"),
        (["curves", "{tmp}"], "validations.csv"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(words, message, tmp_path, capsys):
    assert main([word.format(tmp=tmp_path) for word in words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_train_export_and_evaluate(tmp_path, capsys):
    run = str(tmp_path / "run")
    sizes = ["--set", "layers=16,16", "--set", "learner=sb3", "--set", "environments=8", "--set", "updates=1"]
    code, result = run_json(capsys, "train", "whipple", "--out", run, "--steps", "2400", "--record-every", "0", *sizes)
    assert (code, result["schema"], result["figures"]["steps"]) == (0, "bike.train/1", 2400)
    code, result = run_json(capsys, "export", run, "--which", "last", "--name", "mine")
    assert code == 0
    words = ["evaluate", run + "/policy", "--speeds", "4", "--engine", "whipple", "--time-step", "0.01"]
    code, result = run_json(capsys, *words, "--out", str(tmp_path / "out"))
    assert result["figures"]["policy"] == "mine"
    assert result["figures"]["rides_count"] == 1
    assert code == (0 if result["ok"] else 1)
    assert (tmp_path / "out" / "evaluation.png").stat().st_size > 10_000


def test_evaluate_rides_a_line_with_a_known_law(policy, tmp_path, capsys):
    words = ["evaluate", str(policy), "--course", "line", "--speeds", "4", "5", "--random-rides", "0"]
    code, result = run_json(capsys, *words, "--out", str(tmp_path / "out"))
    assert code == 0
    figures = result["figures"]
    assert figures["completed_count"] == 2
    # From the reference configuration on a line there is nothing to correct.
    assert figures["worst_max_m"] < 1e-6
