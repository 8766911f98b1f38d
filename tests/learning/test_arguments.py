"""What a command refuses before it starts anything: one line that names the option and the value, and exit code 2."""

from pathlib import Path

import pytest

from bike_training import cli
from bike_training.arguments import recording_folder
from bike_training.commands import declarations as dc
from bike_training.commands.declarations import COMMANDS
from bike_training.learning.run_settings import GRADIENT_TABLE as TABLE

SUBJECTS = {
    "ride": {
        dc.BICYCLE: [],
        dc.SUPERBIKE: ["--vehicle", "r1"],
        dc.NODES: ["--vehicle", "r1", "--nodes"],
        dc.ALL: ["--all"],
    },
    "race": {dc.WORK: ["r1", "zx10rr"], dc.REPLAY: ["--replay", "race.mcap"]},
    "train": {
        dc.BICYCLE: ["--out", "never"],
        dc.SUPERBIKE: ["r1", "--out", "never"],
        dc.RESUMED: ["--out", "never", "--resume"],
        dc.REFINEMENT: ["--out", "never", "--preset", "exact"],
        dc.BEST_LAP: ["r1", "--out", "never", "--preset", "optimum"],
    },
    "evaluate": {
        dc.BICYCLE: ["whipple"],
        dc.SUPERBIKE: ["racer"],
        dc.CLASSICAL: ["classical"],
        dc.BENCHMARK: ["whipple", "--task", "two_wheeler/Path-v0"],
        dc.VERIFICATION: ["--verify", "results.json"],
    },
    "analyze": {
        dc.RECORDING: ["ride.mcap"],
        dc.REPLAY: ["ride.mcap", "--replay"],
        dc.EXPLANATION: ["ride.mcap", "--explain"],
        dc.RUNS: ["run"],
        dc.SWEEP: ["sweep"],
        dc.TOPIC: ["ride.mcap", "--topic", "/bike/state"],
        dc.DATASET: ["ride.mcap", "--minari", "sets"],
    },
    "live": {
        dc.BICYCLE: [],
        dc.SUPERBIKE: ["--vehicle", "r1"],
        dc.ATTACHED: ["--attach"],
        dc.RACE: ["--race", "r1", "zx10rr"],
    },
    "sweep": {dc.WORK: ["seeds.yaml", "--out", "never"]},
    "validate": {
        dc.BICYCLE: [],
        dc.SUPERBIKE: ["--vehicle", "superbikes"],
        dc.CIRCUIT: ["--course", "barcelona"],
        dc.TEMPLATE: ["--template"],
        dc.PARAMETERS: ["--parameters", "Browser.txt"],
    },
    "bench": {dc.WORK: []},
    "export": {dc.RUN: ["run"], dc.REFINED: ["refined"], dc.POLICY: ["whipple", "--onnx", "actor.onnx"]},
    "reproduce": {
        dc.LEARNING: ["bicycle", "--out", "never"],
        dc.DATA: ["bicycle", "--out", "never", "--data", "data"],
    },
}
"""Words that make each command be about each of its subjects."""

SELECTING = {
    *("--all", "--nodes", "--resume", "--replay", "--explain", "--attach", "--course", "--data", "--template"),
    *("--parameters", "--task", "--verify", "--topic", "--minari", "--lerobot", "--race"),
}
"""Options that choose the subject of their command, so that none of another subject can be given beside them."""


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders by which a command knows what it is about."""
    for name in ("run/run.json", "sweep/runs.parquet", f"refined/{TABLE}"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)


PAIRS = [(command, subject) for command, subjects in SUBJECTS.items() for subject in subjects]


def test_the_table_has_all_commands_and_subjects() -> None:
    assert {name: set(command.functions) for name, command in COMMANDS.items()} == {
        name: set(subjects) for name, subjects in SUBJECTS.items()
    }


@pytest.mark.parametrize(("command", "subject"), PAIRS)
def test_options_apply_to_the_subject_or_are_refused_by_name(command, subject, folders, tmp_path, capsys) -> None:
    """The others have their defaults."""
    words = SUBJECTS[command][subject]
    args = cli.parse(command, words)
    assert args.subject == subject
    parser = dc.CommandParser(command)
    assert set(parser.options) | {"json", "subject"} == set(vars(args))
    for name, (flag, defaults) in parser.options.items():
        if subject in defaults or not flag.startswith("--") or flag in SELECTING:
            continue
        action = next(action for action in parser._actions if action.dest == name)
        given = [] if action.nargs == 0 else [str(next(iter(action.choices))) if action.choices else "1"]
        if flag == "--compare":
            given = ["lqr"]
        before = sorted(tmp_path.iterdir())
        assert cli.main([command, *words, flag, *given]) == 2, flag
        error = capsys.readouterr().err
        assert error.startswith(f"bike {command}: "), error
        assert flag in error
        assert error.count("\n") == 1
        assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rid"], "did you mean ride?"),
        (["fly"], "there are ride, race, train, "),
        (["ride", "--sped", "3"], "did you mean --speed?"),
        (["ride", "--speed", "fast"], "invalid float value: 'fast'"),
        (["ride", "--engine", "diesel"], "invalid choice: 'diesel'"),
        (["ride", "--engine", "pybulet"], "did you mean pybullet? See bike ride --help"),
        (["ride", "--course", "junctoin"], "did you mean junction? There are benchmark, circle, "),
        (["ride", "--vehicle", "pangale_v4r"], "did you mean panigale_v4r? There are cbr1000rr_r, "),
        (
            ["live", "--rider", "raser"],
            "did you mean racer? There are adaptive, generalist, overtaker, racer, spdl_barcelona, ",
        ),
        (["evaluate", "stanly"], "did you mean stanley? There are adaptive, generalist, "),
        (["ride", "--disturbances", "widn"], "did you mean wind? There are "),
        (["ride", "--course", "barcelona", "--disturbances", "wind"], "'wind' push a bicycle"),
        (["ride", "--all", "--disturbances", "wind"], "'wind' push a bicycle"),
        (["bench", "phisics"], "unknown part 'phisics'; did you mean physics? There are "),
        (["train", "--preset", "fats", "--out", "never"], "did you mean fast? There are alt1, "),
        (["train", "--set", "learner.gama=1", "--out", "never"], "did you mean learner.gamma? There are "),
        (["ride", "--all", "--nodes"], "leave --all out"),
        (["ride", "--nodes"], "'whipple' is a bicycle"),
        (["ride", "--vehicle", "unicycle"], "'unicycle'"),
        (["ride", "--vehicle", "r1", "--engine", "whipple"], "'whipple'"),
        (["ride", "--vehicle", "r1", "--rider", "whipple"], "rider 'whipple' is for a bicycle, and 'r1' is a superb"),
        (["live", "--vehicle", "whipple", "--rider", "racer"], "rider 'racer' is for a superbike, and 'whipple' is a"),
        (["evaluate", "--compare", "lqr", "racer"], "rider 'racer' is for a superbike"),
        (["ride", "--rider", "racer", "--nodes", "--beside", "mpc"], "rider 'mpc' is for a bicycle"),
        (["ride", "--rider", "racer", "--course", "circle"], "superbikes lap circuits, and course 'circle' is a path"),
        (["train", "r1", "--preset", "exact", "--out", "never"], "not of 'r1'"),
        (["train", "--preset", "slow", "--out", "never"], "preset 'slow' is no .yaml file; there are alt1, "),
        (["evaluate", "lqr", "--compare", "mpc"], "--compare names all riders"),
        (["evaluate", "racer", "--vehicle", "whipple"], "'racer'"),
        (["analyze", "a.mcap", "--replay", "--explain"], "choose one"),
        (["analyze", "a.mcap", "b.mcap", "--replay"], "--replay takes one recording, got 2"),
        (["live", "--attach", "--domain", "233"], "--domain must be 0 to 232"),
        (["ride", "--speed", "0"], "--speed must be positive and finite, got 0 m/s"),
        (["ride", "--speed", "nan"], "--speed must be positive and finite, got nan m/s"),
        (["ride", "--domain", "-1"], "--domain must be 0 to 232, got -1"),
        (["ride", "--time-step", "0.003"], "not a whole number of time steps"),
        (["ride", "--vehicle", "r1", "--nodes", "--laps", "0"], "--laps must be at least 1, got 0"),
        (["evaluate", "no_such_policy"], "no_such_policy"),
        (["evaluate", "--speeds", "4", "0"], "--speeds must be positive and finite, got 0 m/s"),
        (["evaluate", "--random-rides", "-1"], "--random-rides must be at least 0, got -1"),
        (["evaluate", "--seed", "-1"], "--seed must be at least 0, got -1"),
        (["evaluate", "--client", "ros", "--course", "nowhere"], "'nowhere'"),
        (["evaluate", "racer", "--starts", "0"], "--starts must be at least 1, got 0"),
        (["validate", "--time-step", "0"], "--time-step must be positive and at most 0.05 s, got 0 s"),
        (["validate", "--vehicle", "superbikes", "--time-step", "0"], "must be positive and at most 0.02 s, got 0 s"),
        (["validate", "--course", "barcelona", "--lateral-g", "1e9"], "--lateral-g must be positive and at most 10 g"),
        (["train", "--out", "never", "--resume"], "no run to resume"),
        (["train", "--out", "never", "--set", "task=foo"], "task='foo'"),
        (["train", "--out", "never", "--set", "task.weights.foo=1"], "'foo'"),
        (["train", "--out", "never", "--set", "learner.gamma=.nan"], "gamma=nan"),
        (["train", "--out", "never", "--set", "learner.averaging=1"], "averaging=1.0"),
        (["train", "--out", "never", "--set", "learner.batch_size=0"], "batch_size=0"),
        (["train", "--out", "never", "--set", "learner.layers=64,0"], "layers=(64, 0)"),
        (["train", "--out", "never", "--set", "task.max_steer=.inf"], "max_steer"),
        (["train", "--out", "never", "--steps", "-5"], "steps=-5"),
        (["train", "--out", "never", "--seed", "-1"], "setting seed=-1 must be 0 to 4294967295"),
        (["train", "--out", "never", "--checkpoint-every", "0"], "checkpoint_every"),
        (["train", "--out", "never", "--record-every", "-1"], "record_every"),
        (["train", "--out", "never", "--engine", "pybullet", "--simulators", "0"], "--simulators"),
        (["train", "--out", "never", "--simulators", "4"], "--simulators 4 is for simulators"),
        (["train", "--out", "never", "--time-step", "0.001"], "--time-step 0.001 is for simulators"),
        (["train", "--out", "never", "--engine", "pybullet", "--time-step", "nan"], "time_step"),
        (["train", "--out", "never", "--resume", "--set", "learner.gamma=0.9"], "--set is for a bicycle"),
        (["train", "--preset", "exact", "--out", "never", "--set", "speed=3"], "no setting 'speed'"),
        (["train", "--preset", "exact", "--out", "never", "--set", "learner.tail=500"], "tail=500 must be 0 to"),
        (["train", "--preset", "exact", "--out", "never", "--set", "curriculum.refine=true"], "takes no curriculum"),
        (["export", "."], "no checkpoint"),
        (["analyze", "nothing.mcap"], "nothing.mcap"),
        (["analyze", "--explain", "none.mcap", "--policy", ""], "is not a policy bundle"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(words, message, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("bike")
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [["sweep", "{file}", "--out", "out"], ["ride", "--course", "x" * 5000], ["y" * 999]])
def test_no_error_is_longer_than_a_few_lines(words, tmp_path, monkeypatch, capsys) -> None:
    """Also where a file repeats itself in its error."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "sweep.yaml"
    file.write_text("task: " + 100_000 * "ab" + "\n")
    assert cli.main([word.format(file=file) for word in words]) == 2
    error = capsys.readouterr().err
    assert len(error) <= cli.MAX_ERROR + 30
    assert error.count("\n") == 1


def test_the_version_is_that_of_the_project(capsys) -> None:
    assert cli.main(["--version"]) == 0
    version = capsys.readouterr().out.split()[1]
    assert f'version = "{version}"' in (Path(__file__).parents[2] / "pyproject.toml").read_text()


@pytest.mark.parametrize(
    "words",
    [
        ["ride", "--vehicle", "r1", "--nodes"],
        ["evaluate"],
        ["validate"],
    ],
)
def test_a_folder_that_cannot_be_made_is_known_before_the_work(words, tmp_path, capsys):
    pytest.importorskip("rclpy")
    (tmp_path / "file").write_text("precious")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert cli.main([*words, "--out", str(out)]) == 2
        assert capsys.readouterr().err == f"bike {words[0]}: --out {out} cannot be a folder: a file is in the way\n"


def test_a_recording_is_never_replaced_unasked(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for number in ("", "-2", "-3"):
        with recording_folder(None, "ride", False) as folder:
            assert folder == Path(f"out/ride{number}")
            with recording_folder(None, "ride", False) as beside:  # while this one is ridden
                assert beside.name != folder.name
            (folder / "ride.mcap").touch()
    with recording_folder(None, "ride", True) as folder:
        assert folder == Path("out/ride")
    with recording_folder(folder, "ride", True) as given:
        assert given == folder
    with pytest.raises(FileExistsError, match="--out out/ride holds ride"):
        recording_folder(folder, "ride", False).__enter__()


@pytest.mark.parametrize("words", [["ride"], ["ride", "--rider", "racer", "--nodes"], ["live"]])
def test_a_folder_with_a_recording_is_refused(words, tmp_path, capsys) -> None:
    pytest.importorskip("rclpy")
    (tmp_path / "old.mcap").write_text("precious")
    assert cli.main([*words, "--out", str(tmp_path)]) == 2
    assert "holds old.mcap; choose another folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["old.mcap"]
