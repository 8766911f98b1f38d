"""The file of a sweep: what runs it stands for, and what is wrong with it, before anything starts."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from bike_training.cli import main
from bike_training.sweeps.jobs import TrainJob
from bike_training.sweeps.runs import FINISHED, SCHEMA, make_plan
from bike_training.sweeps.spec import load_sweep, sweep_from_document

from .conftest import tiny


def test_a_grid_is_every_combination_and_nothing_else() -> None:
    sweep = sweep_from_document(tiny(grid={"seed": [0, 1, 2], "set.learner.gamma": [0.9, 0.99]}))
    settings = [run.job().settings for run in sweep.runs]
    assert [(s.seed, s.preset.learner.gamma) for s in settings] == [(a, b) for a in (0, 1, 2) for b in (0.9, 0.99)]
    assert {s.preset.sac.layers for s in settings} == {(8,)}
    assert [run.label for run in sweep.runs[:2]] == ["seed=0,learner.gamma=0.9", "seed=0,learner.gamma=0.99"]
    assert {run.group for run in sweep.runs} == {"learner.gamma=0.9", "learner.gamma=0.99"}


def test_listed_runs_stand_over_the_base_and_may_be_of_several_tasks() -> None:
    document = {
        "base": {},
        "runs": [
            {"task": "train", "vehicle": "whipple", "seed": 4},
            {"task": "lap", "vehicle": "r1", "laps": 1},
        ],
    }
    runs = sweep_from_document(document).runs
    assert [run.task for run in runs] == ["train", "lap"]
    assert not any("None" in run.group for run in runs), "entries that a run does not have"


def test_a_run_is_known_by_what_it_is_and_not_by_its_sweep() -> None:
    alone = sweep_from_document(tiny(base={**tiny()["base"], "seed": 1})).runs[0]
    among = sweep_from_document(tiny(grid={"seed": [0, 1]}, cores=2)).runs[1]
    assert alone.digest == among.digest
    assert alone.name != among.name  # its label tells what differs in its own sweep


def test_a_finished_run_is_found_by_another_sweep_of_it(tmp_path: Path) -> None:
    first = sweep_from_document(tiny(grid={"seed": [0, 1]}))
    folder = tmp_path / "runs" / first.runs[0].name
    folder.mkdir(parents=True)
    record = {"schema": SCHEMA, "status": FINISHED, "seconds": 50.0, "attempts": 1, "figures": {}}
    (folder / "result.json").write_text(json.dumps(record))
    second = make_plan(sweep_from_document(tiny(grid={"seed": [0, 1], "set.learner.gamma": [0.97, 0.99]})), tmp_path)
    assert [run.finished for run in second.runs] == [False] * 4  # gamma is given there, so these are other runs
    third = make_plan(sweep_from_document(tiny(grid={"seed": [5, 0]}, name="more")), tmp_path)
    assert [run.finished for run in third.runs] == [False, True]
    assert third.runs[0].seconds == pytest.approx(50.0)  # as long as the one like it that was measured


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ([], "a sweep is a table"),
        ({"grids": {}}, "unknown entry 'grids'"),
        ({"task": "dance"}, "task 'dance' is not one of train, lap"),
        (tiny(grid={"seed": 3}), "grid entry 'seed' must be a list"),
        (tiny(grid={"seed": list(range(200)), "set.learner.gamma": [0.9 + k / 2e3 for k in range(101)]}), "20200 runs"),
        (tiny(grid={"sed": [1]}), "task train has no entry 'sed'"),
        (tiny(grid={"seed": [0, -1]}), r"run 2 of 2 \(seed=-1\): .*seed=-1 must be"),
        (tiny(grid={"seed": [0, True]}), "seed must be int, got True"),
        (tiny(grid={"set.learner.gamma": [0.9, 2.0]}), "gamma=2.0 must be 0 to 1"),
        (tiny(grid={"set.learner.gama": [0.9]}), "preset has no setting 'learner.gama'"),
        (tiny(grid={"client": ["remote"]}), "client='remote' is not known; there are local, ros"),
        (tiny(grid={"seed": [1, 1]}), r"run 2 is run 1 again \(train\)"),
        (tiny(cores=0), "cores must be a positive number"),
        (tiny(retries=-1), "retries must be a whole number"),
        ({"task": "lap", "base": {"vehicle": "whipple"}}, "is no superbike"),
        ({"task": "lap", "base": {"laps": 0}}, "laps must be at least 1"),
        ({"task": "lap", "base": {"engine": "whipple"}}, "engine must be one of pybullet, compiled, got 'whipple'"),
    ],
)
def test_what_is_wrong_is_named(document, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        sweep_from_document(document)


@pytest.mark.parametrize(
    "document", [{"task": "lap", "base": {"course": "mars"}}, tiny(grid={"vehicle": ["whipple", "unicycle"]})]
)
def test_what_does_not_exist_is_named(document, write) -> None:
    with pytest.raises(FileNotFoundError, match=r"spec.yaml.*(mars|unicycle)"):
        load_sweep(write(document))


def test_a_bad_file_starts_nothing_and_makes_no_folder(tmp_path: Path, write, capsys) -> None:
    path = write(tiny(grid={"set.learner.gamma": [0.9, 2.0]}))
    assert main(["sweep", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "run 2 of 2 (learner.gamma=2)" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_plan_starts_nothing_and_tells_the_hours(tmp_path: Path, write, capsys) -> None:
    path = write({"base": {"vehicle": "whipple", "steps": 1_000_000}, "grid": {"seed": list(range(10))}})
    assert main(["sweep", str(path), "--out", str(tmp_path / "out"), "--plan", "--cores", "2", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["runs_by_status"]["missing"] == 10
    one = TrainJob.from_entries({"vehicle": "whipple", "steps": 1_000_000}).estimate() / 3600.0
    assert figures["estimate_h"] == pytest.approx(5 * one, abs=1e-3)  # shared by two cores
    assert not (tmp_path / "out").exists()


def test_many_runs_are_checked_without_drawing_their_circuits(monkeypatch) -> None:
    def draw(name: str) -> None:
        raise AssertionError(f"{name} was drawn")

    monkeypatch.setattr("bike_training.sweeps.jobs.load_track", draw)
    sweep = load_sweep(Path(__file__).parents[2] / "docs" / "data" / "classical_random.yaml")
    assert len(sweep.runs) == 500
    assert all(run.estimate > 0.0 for run in sweep.runs)


def test_the_first_line_of_a_plan_waits_for_no_learner() -> None:
    program = "import sys, bike_training.commands.sweep; sys.exit('bike_training.learning.presets' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_a_run_until_its_end_is_never_told_to_be_further_than_it_is() -> None:
    plain, until = (
        TrainJob.from_entries({"vehicle": "whipple", **more}).settings for more in ({}, {"until_finished": True})
    )
    steps = until.preset.sac.steps
    for made in (0, 1, 1000, steps // 2, steps - 1, steps, steps + 1, 10 * steps):
        assert plain.expected_steps(made) == steps
        assert min(made, steps) <= until.expected_steps(made) <= steps


def test_a_superbike_learns_on_the_compiled_engine_as_it_does_by_itself() -> None:
    job = TrainJob.from_entries({"vehicle": "panigale_v4r", "preset": "race_direct"})
    assert job.settings.compiled
