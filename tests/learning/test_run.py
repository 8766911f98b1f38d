"""The one entry of a run: settings in, summary out, and stopped at any time without a trace in what is learned."""

import json
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from bike_training.learning.presets import load_preset
from bike_training.learning.process import run, stored_settings
from bike_training.learning.run_settings import RunSettings

PRESET = load_preset("fast").changed(
    {
        "learner": "sb3",
        "curriculum.validate_every": 40,
        "learner.layers": [8],
        "learner.batch_size": 16,
        "learner.buffer_size": 400,
        "learner.learning_starts": 20,
        "learner.environments": 2,
        "learner.updates": 1,
        "learner.steps": 120,
    }
)
SETTINGS = RunSettings(PRESET, seed=5)


def without_clock(summary: dict) -> dict:
    return {name: value for name, value in summary.items() if name != "seconds"}


@pytest.mark.parametrize("learner", ["sb3", pytest.param("sbx", marks=pytest.mark.slow)])
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
    assert (resumed["interrupted"], resumed["steps"], resumed["updates"]) == (False, 120, 50)
    folders = [tmp_path / name / "checkpoint" for name in ("whole", "parts")]
    tensors = [load_file(folder / "tensors.safetensors") for folder in folders]
    replays = [dict(np.load(folder / "replay.npz")) for folder in folders]
    for mine, other in (tensors, replays):
        assert set(mine) == set(other)
        for name, array in mine.items():
            np.testing.assert_array_equal(array, other[name], err_msg=name)
    states = [json.loads((folder / "state.json").read_text()) for folder in folders]
    assert states[0]["run"]["env"] == states[1]["run"]["env"]
    assert states[0]["learner"]["generators"] == states[1]["learner"]["generators"]


def test_the_summary_is_what_the_folder_holds(tmp_path: Path):
    summary = run(replace(SETTINGS, preset=PRESET.changed({"learner.steps": 30})), tmp_path)
    stored = json.loads((tmp_path / "run.json").read_text())
    assert summary == stored | {"interrupted": False}
    assert (stored["vehicle"], stored["seed"], stored["steps"]) == ("whipple", 5, 30)
