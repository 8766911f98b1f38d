"""Runs and their checkpoints: stopped at any time without a trace in what is learned; reading one runs no code."""

import io
import json
import os
import pickle
import shutil
import signal
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from bike_sim.sim.request import ResetRequest
from bike_training.cli import main
from bike_training.learning import checkpoint
from bike_training.learning.checkpoint import Checkpoint
from bike_training.learning.presets import load_preset
from bike_training.learning.process import LearningProcess, run, stored_settings
from bike_training.learning.run_settings import RunSettings
from tests.tiny import TINY

FILES = ["state.json", "tensors.safetensors", "replay.npz"]
PRESET = load_preset("fast").changed({**TINY, "learner.steps": 120})
SETTINGS = RunSettings(PRESET, seed=5)


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "run"
    summary = run(RunSettings(PRESET.changed({"learner.steps": 60}), seed=5), folder)
    assert (summary["steps"], summary["updates"], summary["interrupted"]) == (60, 20, False)
    stored = json.loads((folder / "run.json").read_text())
    assert summary == stored | {"interrupted": False}
    assert (stored["vehicle"], stored["seed"], stored["steps"]) == ("whipple", 5, 60)
    return folder


def without_clock(summary: dict) -> dict:
    return {name: value for name, value in summary.items() if name != "seconds"}


@pytest.mark.parametrize("learner", ["sb3", "a2c", pytest.param("sbx", marks=pytest.mark.slow)])
def test_a_run_that_was_stopped_and_resumed_is_the_whole_run_bit_for_bit(learner, tmp_path):
    """Its networks, optimisers, random generators, rides, replay buffer and summary."""
    settings = replace(SETTINGS, preset=PRESET.changed({"learner": learner}))
    whole = run(settings, tmp_path / "whole")

    def stop(process) -> None:
        if process.model.num_timesteps == 60:
            signal.raise_signal(signal.SIGINT)

    stopped = run(settings, tmp_path / "parts", stop)
    assert (stopped["interrupted"], stopped["steps"]) == (True, 60)
    assert stored_settings(tmp_path / "parts") == settings
    resumed = run(settings, tmp_path / "parts", resume=True)
    assert without_clock(resumed) == without_clock(whole)
    replays = learner != "a2c"
    assert (resumed["interrupted"], resumed["steps"], resumed["updates"]) == (False, 120, 50 if replays else 12)
    folders = [tmp_path / name / "checkpoint" for name in ("whole", "parts")]
    tensors = [load_file(folder / "tensors.safetensors") for folder in folders]
    buffers = [dict(np.load(folder / "replay.npz")) for folder in folders] if replays else ({}, {})
    for mine, other in (tensors, buffers):
        assert set(mine) == set(other)
        for name, array in mine.items():
            np.testing.assert_array_equal(array, other[name], err_msg=name)
    states = [json.loads((folder / "state.json").read_text()) for folder in folders]
    assert states[0]["run"]["env"] == states[1]["run"]["env"]
    assert states[0]["learner"]["generators"] == states[1]["learner"]["generators"]


class Planted:
    """A pickle that leaves a mark when it is loaded."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return os.mkdir, (str(self.mark),)


def planted(mark: Path, kind: str) -> bytes:
    """Return a malicious pickle, bare or in the files that NumPy and PyTorch keep pickles in."""
    data = io.BytesIO()
    if kind == "pickle":
        pickle.dump(Planted(mark), data)
    elif kind == "npz":
        np.savez(data, **{name: np.array([Planted(mark)], dtype=object) for name in ("rewards", "pos", "full")})
    else:
        with zipfile.ZipFile(data, "w") as archive:
            archive.writestr("archive/data.pkl", pickle.dumps(Planted(mark)))
            archive.writestr("data", pickle.dumps(Planted(mark)))
    return data.getvalue()


@pytest.mark.parametrize("kind", ["pickle", "npz", "zip"])
def test_a_planted_pickle_does_execute_where_it_is_loaded(kind, tmp_path):
    """Else the next test would prove nothing."""
    data = io.BytesIO(planted(tmp_path / "mark", kind))
    if kind == "pickle":
        pickle.load(data)
    elif kind == "npz":
        np.load(data, allow_pickle=True)["pos"]
    else:
        pickle.loads(zipfile.ZipFile(data).read("data"))
    assert (tmp_path / "mark").exists()


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "pickle") for name in (*FILES, "../run.json", "../settings.json")),
        *((FILES[2], k) for k in ("npz", "zip")),
    ],
)
def test_no_code_of_a_checkpoint_runs(name, kind, finished_run, tmp_path, capsys):
    folder = shutil.copytree(finished_run, tmp_path / "run")
    (folder / "checkpoint" / name).write_bytes(planted(tmp_path / "mark", kind))
    resume = ["train", "whipple", "--out", str(folder), "--resume", "--steps", "70"]
    codes = []
    for words in (["export", str(folder), "--which", "last"], resume):
        codes.append(main(words))
        told = capsys.readouterr().err.strip().splitlines()
        assert not (tmp_path / "mark").exists()
        if codes[-1]:
            assert "cannot be read" in told[-1]
            assert Path(name).name in told[-1]
    assert 2 in codes  # each file is read by one of them at least


def test_another_format_is_refused(finished_run, tmp_path):
    folder = shutil.copytree(finished_run, tmp_path / "run")
    path = folder / "checkpoint" / "state.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": "bike.checkpoint/0"}))
    with pytest.raises(ValueError, match=r"state\.json cannot be read \(its format is 'bike\.checkpoint/0'"):
        Checkpoint(folder)


def test_networks_of_another_size_are_refused(finished_run):
    settings = stored_settings(finished_run)
    wider = replace(settings, preset=settings.preset.changed({"learner.layers": [16]}))
    with pytest.raises(ValueError, match="has shape"):
        LearningProcess(wider, finished_run, 80, resume=True)


def test_a_pipe_in_place_of_a_file_is_not_waited_for(finished_run, tmp_path):
    folder = shutil.copytree(finished_run, tmp_path / "run")
    path = folder / "checkpoint" / "tensors.safetensors"
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ValueError, match="no regular file"):
        Checkpoint(folder)


def test_a_tree_comes_back_as_it_was(tmp_path):
    tree = {
        "big": 2**127 + 1,
        "third": 1.0 / 3.0,
        "none": None,
        "list": [1, "a", True, {"deep": np.arange(6, dtype=np.float32).reshape(2, 3).T}],
        "scalar": np.array(7, dtype=np.int64),
        "flags": np.array([True, False]),
        "empty": np.zeros((0, 3)),
    }
    arrays = {}
    text = json.dumps(checkpoint._without_arrays(tree, "", arrays))
    save_file(arrays, tmp_path / "a.safetensors")
    read = checkpoint._with_arrays(json.loads(text), load_file(tmp_path / "a.safetensors"))
    assert {key: read[key] for key in ("big", "third", "none")} == {key: tree[key] for key in ("big", "third", "none")}
    assert read["list"][:3] == [1, "a", True]
    pairs = [(read["list"][3]["deep"], tree["list"][3]["deep"])]
    pairs += [(read[key], tree[key]) for key in ("scalar", "flags", "empty")]
    for mine, other in pairs:
        assert mine.dtype == other.dtype
        np.testing.assert_array_equal(mine, other)
    with pytest.raises(TypeError):
        json.dumps(checkpoint._without_arrays({"object": object()}, "", arrays))


def test_a_request_comes_back_as_it_was():
    request = ResetRequest(
        seed=2**62, speed_range=(1 / 3, 5.0), initial_state=np.linspace(0.1, 1.0, 10), context=(0.1, 2.0), perturb=True
    )
    again = ResetRequest.from_card(json.loads(json.dumps(request.to_card())))
    assert again == replace(request, initial_state=request.initial_state.tolist())
