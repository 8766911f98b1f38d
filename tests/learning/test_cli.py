"""The `bike` command from outside."""

import io
import json
import os
import re
import resource
import shutil
import subprocess
import sys

import numpy as np
import pytest

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.bundle import Actor, Bundle, load_bundle
from bike_policy.contract.observation import LEAN_LAYOUT
from bike_sim.sim.simulator import Simulator
from bike_training.cli import COMMANDS, CommandParser, main
from bike_training.envs.node_process import NodeLost
from bike_training.learning.run_settings import RunSettings
from bike_training.progress import progress_bar, told_parts


@pytest.fixture
def policy(tmp_path):
    """A linear law that balances and follows: steer into the fall, lean into the bend."""
    weight = np.zeros((1, LEAN_LAYOUT.size), dtype="f4")
    names = list(LEAN_LAYOUT.names)
    scales = dict(zip(LEAN_LAYOUT.names, LEAN_LAYOUT.gains, strict=True))
    weight[0, names.index("roll")] = -1.2 / scales["roll"]
    weight[0, names.index("roll_rate")] = -0.35 / scales["roll_rate"]
    actor = Actor([weight], [np.zeros(1, dtype="f4")])
    Bundle("linear", actor, LEAN_LAYOUT, ActionLayout.steering(np.radians(70)), "whipple", 0.05, {"seed": 0}).save(
        tmp_path / "p"
    )
    return tmp_path / "p"


def run_json(capsys, *words):
    code = main([*words, "--json"])
    out = capsys.readouterr().out
    assert len(out.strip().splitlines()) == 1
    return code, json.loads(out)


def test_help_comes_at_once_and_shows_how_to_use_a_command():
    """In processor time, so that other work on the machine does not count."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "bike_training.cli", "analyze", "--help"]
    text = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.6
    assert text == CommandParser("analyze").format_help()
    for name, command in COMMANDS.items():
        text = CommandParser(name).format_help()
        assert "--json" in text
        assert f"duration: {command.duration}\n" in text
        assert "example" in text


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")])
def test_matrix_products_of_a_command_have_one_thread_unless_somebody_asks_for_more(given, threads):
    """Which is decided before NumPy is loaded, since later it is not heard."""
    code = """
import os, sys
import bike_training.cli
assert "numpy" not in sys.modules
sys.argv = ["bike", "--version"]
bike_training.cli.main()
print(os.environ["OPENBLAS_NUM_THREADS"])
"""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")} | given
    told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert told.stdout.split()[-1] == threads


def test_progress_is_one_speed_in_a_terminal_and_few_lines_in_a_log(capfd, monkeypatch):
    with progress_bar("rides", "ride", 1000) as bar:
        assert capfd.readouterr().err == "rides: 0/1000 ride [00:00<?]\n"
        for _ in range(1000):
            bar.update()
    lines = capfd.readouterr().err.splitlines()
    assert lines[-1].startswith("rides: 1000/1000 ride [")
    assert len(lines) <= 2
    with progress_bar("rides", "ride", 1000, quiet=True):
        assert not capfd.readouterr().err
    terminal = Terminal()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        with progress_bar("circle", "m", 100) as bar:
            bar.set_postfix_str("4.00 m/s", refresh=False)
            bar.update(100)
            bar.refresh()
    last = terminal.getvalue().strip().splitlines()[-1].split("\r")[-1]
    assert "100/100 m" in last
    assert "4.00 m/s" in last
    assert last.count("/s") == 1
    for quiet, told in ((False, "measuring: weave\n"), (True, "")):
        told_parts("measuring", quiet)("weave")
        assert capfd.readouterr().err == told


@pytest.mark.parametrize(
    "words",
    [["ride", "--rider", "classical", "--laps", "1", "--engine", "compiled"],
     ["train", "whipple", "--set", "learner=sb3", "--steps", "40", "--out", "run"]],
)  # fmt: skip
def test_the_first_line_comes_before_the_work(words, tmp_path):
    """Through a pipe."""
    command = [sys.executable, "-m", "bike_training.cli", *words]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=tmp_path)
    first = process.stderr.readline().decode()
    if "loading" in first:
        first = process.stderr.readline().decode()
    assert process.poll() is None
    assert re.search(r": 0/\S+ \w+ \[00:00<\?", first)
    process.kill()
    process.communicate()


def test_train_export_and_evaluate(tmp_path, capsys):
    run = str(tmp_path / "run")
    words = ["train", "whipple", "--out", run, "--steps", "400", "--record-every", "0", *SMALL_WORDS]
    code, result = run_json(capsys, *words)
    assert (code, result["schema"], result["figures"]["steps"]) == (0, "bike.train/1", 400)
    (tmp_path / "list.json").write_text("[]")
    assert main(["export", run, "--which", "last", "--evaluation", str(tmp_path / "list.json")]) == 2
    assert "one JSON object" in capsys.readouterr().err
    assert main(["export", run, "--name", "mine"]) == 0  # as an interrupted run advises
    assert "there is no 'best' actor yet, so this is the last one" in capsys.readouterr().err
    for parts in ("0.5,0.7", "0", "half"):
        assert main(["export", run, "--which", "last", "--range", parts]) == 2
        assert f"--range {parts}: needs a part" in capsys.readouterr().err
    run_json(capsys, "export", run, "--which", "last", "--range", "0.5", "--out", str(tmp_path / "half"))
    whole, half = (load_bundle(folder).action.columns[0].scale for folder in (run + "/policy", tmp_path / "half"))
    assert half == 0.5 * whole
    for limits in ("3", "3:1,2:1", "3:fast", "3:-1", ""):
        assert main(["export", run, "--which", "last", "--within", limits]) == 2
        assert f"--within {limits}: " in capsys.readouterr().err
    run_json(capsys, "export", run, "--which", "last", "--within", "3:1.2,4.5:0.8", "--out", str(tmp_path / "held"))
    assert load_bundle(tmp_path / "held").action.columns[0].within == ((3.0, 1.2), (4.5, 0.8))
    run_json(capsys, "export", run, "--which", "last", "--symmetric", "--out", str(tmp_path / "odd"))
    plain, odd = (load_bundle(folder).actor for folder in (run + "/policy", tmp_path / "odd"))
    seen = np.random.default_rng(0).normal(size=(5, LEAN_LAYOUT.size)).astype(np.float32)
    both = (seen, seen * LEAN_LAYOUT.mirror_signs)
    means = [np.arctanh(actor.act_batch(each)) for actor in (plain, odd) for each in both]
    np.testing.assert_allclose(means[2], 0.5 * (means[0] - means[1]), atol=1e-5)
    np.testing.assert_allclose(means[3], -means[2], atol=1e-5)
    words = ["evaluate", run + "/policy", "--speeds", "4", "--engine", "whipple", "--time-step", "0.01"]
    code, result = run_json(capsys, *words, "--out", str(tmp_path / "out"))
    assert result["figures"]["policy"] == "mine"
    assert result["figures"]["rides_count"] == 1
    assert code == (0 if result["ok"] else 1)
    assert (tmp_path / "out" / "evaluation.png").stat().st_size > 10_000


def test_evaluate_rides_a_line_with_a_known_law(policy, tmp_path, capsys, monkeypatch):
    """Its stability is that of another test."""
    monkeypatch.setattr("bike_training.commands.evaluate.stability", lambda rider: {})
    words = ["evaluate", str(policy), "--course", "line", "--speeds", "7", "--random-rides", "0"]
    words += ["--engine", "whipple", "--time-step", "0.01"]
    code, result = run_json(capsys, *words, "--out", str(tmp_path / "out"))
    assert code == 0
    figures = result["figures"]
    assert figures["completed_count"] == 1
    # From the reference configuration on a line there is nothing to correct.
    assert figures["worst_max_m"] < 1e-6


def test_the_seed_of_an_evaluation_draws_other_noise(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("bike_training.commands.evaluate.stability", lambda rider: {})
    words = ["evaluate", "lqr", "--course", "line", "--speeds", "7", "--random-rides", "0", "--disturbances", "noise"]
    words += ["--engine", "whipple", "--time-step", "0.01", "--out", str(tmp_path)]
    found = [run_json(capsys, *words, "--seed", seed)[1]["figures"]["disturbed"][0] for seed in ("0", "1", "0")]
    assert found[0] == found[2]
    assert found[0]["worst_mean_m"] != found[1]["worst_mean_m"]


SMALL = ("layers=8,8", "environments=4", "updates=4", "buffer_size=1000", "learning_starts=200")
SMALL_WORDS = ["--set", "learner=sb3", *(word for setting in SMALL for word in ("--set", f"learner.{setting}"))]


def settings_of(run):
    return json.loads((run / "settings.json").read_text())


def test_a_resume_takes_what_may_change_and_keeps_the_rest(tmp_path, capsys):
    run = tmp_path / "run"
    words = ["train", "whipple", "--out", str(run)]
    code, _ = run_json(capsys, *words, "--steps", "40", "--seed", "3", *SMALL_WORDS)
    assert code == 0
    first = settings_of(run)
    assert (first["seed"], first["record_every"], first["preset"]["learner"]["steps"]) == (3, 10, 40)
    code, result = run_json(capsys, *words, "--resume")
    assert (code, result["figures"]["steps"]) == (0, 40)
    assert settings_of(run) == first
    changes = ["--steps", "60", "--until-finished", "--checkpoint-every", "70", "--record-every", "0"]
    code, result = run_json(capsys, *words, "--resume", *changes)
    assert (code, result["figures"]["steps"]) == (0, 60)
    second = settings_of(run)
    assert second == first | {
        "preset": first["preset"] | {"learner": first["preset"]["learner"] | {"steps": 60}},
        "until_finished": True,
        "checkpoint_every": 70,
        "record_every": 0,
    }
    changes = ["--steps", "66", "--engine", "pybullet", "--simulators", "3", "--time-step", "0.01"]
    changes += ["--no-until-finished"]
    code, result = run_json(capsys, *words, "--resume", *changes)
    assert (code, result["figures"]["steps"]) == (0, 66)
    third = settings_of(run)
    assert (third["engine"], third["time_step"], third["until_finished"]) == ("pybullet", 0.01, False)
    assert [third["preset"]["learner"][name] for name in ("environments", "updates")] == [3, 3]
    code, result = run_json(capsys, *words, "--resume", "--steps", "69")
    assert settings_of(run) == third | {
        "preset": third["preset"] | {"learner": third["preset"]["learner"] | {"steps": 69}}
    }


def test_simulators_are_as_many_as_asked_for(monkeypatch):
    """Also where the preset rides one bicycle; the updates for each step stay the preset's."""

    asked = []

    def refuse(settings: RunSettings, *args: object, **options: object) -> None:
        asked.append(settings.preset)
        raise ValueError("nothing is learned here")

    monkeypatch.setattr("bike_training.learning.process.run", refuse)

    def chosen(*words):
        assert main(["train", "whipple", "--out", "x", *words]) == 2
        return asked[-1].sac.environments, asked[-1].sac.updates

    assert chosen("--preset", "paper", "--client", "ros", "--simulators", "4") == (4, 4)
    assert chosen("--preset", "paper", "--client", "ros") == (1, 1)
    assert chosen("--client", "ros") == (2, 2)
    assert chosen("--engine", "pybullet", "--simulators", "8") == (8, 8)
    assert chosen() == (8, 8)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("settings.json", "{", "cannot be read"),
        ("settings.json", "[]", "table of settings"),
        ("settings.json", '{"preset": {"name": "x", "colour": 1}}', "colour"),
        ("settings.json", '{"preset": {"name": "x", "learner": {"layers": ["a"]}}}', "layers"),
        ("settings.json", '{"preset": {"name": "x"}, "seed": "one"}', "seed"),
    ],
)
def test_damaged_settings_are_named(name, text, message, tmp_path, capsys):
    (tmp_path / name).write_text(text)
    assert main(["train", "whipple", "--out", str(tmp_path), "--resume"]) == 2
    error = capsys.readouterr().err
    assert str(tmp_path / name) in error
    assert message in error
    assert len(error.strip().splitlines()) == 1


def test_export_and_curves_name_what_they_cannot_read(tmp_path, capsys):
    run = tmp_path / "run"
    run_json(capsys, "train", "whipple", "--out", str(run), "--steps", "40", *SMALL_WORDS)

    def told(*words):
        assert main([*words]) == 2
        error = capsys.readouterr().err
        assert len(error.strip().splitlines()) == 1
        return error

    assert "there is no 'last' actor yet; train longer\n" in told("export", str(run), "--which", "last")
    assert "--which last" in told("export", str(run), "--which", "best")
    (run / "validations.csv").write_text("step,seconds,part,mean_error_m,passed\n")
    assert "has no validation yet" in told("analyze", str(run))
    whole = (run / "run.json").read_text()
    (run / "run.json").write_text('{"steps": 3')
    assert "run.json cannot be read" in told("export", str(run))
    (run / "validations.csv").write_text("step,seconds,part,mean_error_m,passed\n4000,1.0,1,0.3,0\n8000,2\n")
    assert "run.json cannot be read" in told("analyze", str(run))
    (run / "run.json").write_text(whole)
    assert main(["analyze", str(run), "--out", str(tmp_path / "pictures")]) == 1  # drawn, and not finished
    assert (tmp_path / "pictures" / "learning_curves.png").is_file()
    shutil.copytree(run, tmp_path / "race")
    (tmp_path / "race" / "validations.csv").write_text("step,seconds,part,mean_excess,passed\n4000,1.0,1,0.3,0\n")
    assert main(["analyze", str(tmp_path / "race"), "--out", str(tmp_path / "race"), "--json"]) == 1
    assert '"last_errors_median": 0.3' in capsys.readouterr().out
    (run / "run.json").write_text("[]")
    assert "run.json must hold" in told("analyze", str(run))


def test_a_lost_simulator_says_how_to_go_on(tmp_path, capsys, monkeypatch):
    def lost(*args):
        raise NodeLost("sim_node ended")

    monkeypatch.setattr(Simulator, "step", lost)
    words = ["train", "whipple", "--out", str(tmp_path), "--engine", "pybullet", *SMALL_WORDS]
    assert main([*words, "--steps", "40"]) == 2
    assert "sim_node ended; go on from the checkpoint" in capsys.readouterr().err.splitlines()[-1]
