"""A run that is stopped and resumed is the run that was not stopped."""

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_training.learner import actor_tensors
from bike_training.presets import FAST, PAPER
from bike_training.process import LearningProcess, RunSettings

TINY = {
    "layers": (16, 16),
    "batch_size": 32,
    "learning_starts": 200,
    "environments": 8,
    "updates": 2,
    "buffer_size": 5000,
}
STEPS = 1600


def learner_settings(learner: str) -> RunSettings:
    preset = replace(FAST, learner=learner, validate_every=400, **TINY)
    return RunSettings(preset, seed=3, checkpoint_every=10_000)


def weights(process: LearningProcess) -> np.ndarray:
    return np.concatenate([part.ravel() for parts in actor_tensors(process.model) for part in parts])


@pytest.mark.parametrize("learner", ["sbx", "sb3"])
def test_resume_goes_on_as_if_not_stopped(learner, tmp_path):
    settings = learner_settings(learner)
    whole = LearningProcess(settings, tmp_path / "whole", STEPS)
    whole.run()

    def stop(process: LearningProcess) -> None:
        if process.model.num_timesteps >= STEPS // 2:
            raise KeyboardInterrupt

    first = LearningProcess(settings, tmp_path / "parts", STEPS)
    with pytest.raises(KeyboardInterrupt):
        first.run(stop)
    assert first.model.num_timesteps == STEPS // 2
    second = LearningProcess(settings, tmp_path / "parts", STEPS, resume=True)
    second.run()
    assert second.model.num_timesteps == whole.model.num_timesteps == STEPS
    assert second.model._n_updates == whole.model._n_updates > 0
    np.testing.assert_array_equal(weights(second), weights(whole))
    for mine, other in zip(second.progress.averaged.weights, whole.progress.averaged.weights, strict=True):
        np.testing.assert_array_equal(mine, other)


def open_files(folder: Path) -> list[str]:
    """Return the files in a folder that this process holds open."""
    held = (os.path.realpath(link) for link in Path("/proc/self/fd").iterdir())
    return [path for path in held if path.startswith(str(folder.resolve()))]


def test_same_seed_same_run_and_other_seed_another(tmp_path):
    settings = learner_settings("sbx")
    runs = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        process = LearningProcess(replace(settings, seed=seed), tmp_path / name, 600)
        process.run()
        runs.append(weights(process))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[0] - runs[2]).max() > 1e-3


def test_paper_preset_learns_over_a_simulator(tmp_path):
    """One update a step on PyBullet, as published but tiny."""
    preset = replace(PAPER, layers=(16, 16), learning_starts=50)
    process = LearningProcess(RunSettings(preset, engine="pybullet"), tmp_path, 200)
    process.run()
    assert process.model._n_updates == 150
    assert not open_files(tmp_path)
    resumed = LearningProcess(RunSettings(preset, engine="pybullet"), tmp_path, 260, resume=True)
    resumed.run()
    assert resumed.model._n_updates == 210


def test_learning_learns(tmp_path):
    """A few thousand steps must make rides at least twice as long as random ones."""
    settings = RunSettings(replace(FAST, learning_starts=1000, layers=(32, 32), updates=16), seed=1)
    process = LearningProcess(settings, tmp_path, 20_000)
    lengths: list[float] = []

    def note(p: LearningProcess) -> None:
        lengths.append(p.env.steps.mean())

    process.run(note)
    early, late = np.mean(lengths[30:90]), np.mean(lengths[-60:])
    assert late > 2.0 * early


def test_a_folder_with_a_run_is_not_overwritten(tmp_path):
    settings = learner_settings("sb3")
    LearningProcess(settings, tmp_path, 8)
    with pytest.raises(ValueError, match="already holds a run"):
        LearningProcess(settings, tmp_path, 8)


@pytest.mark.parametrize("learner", ["sbx", "sb3"])
def test_a_run_goes_on_with_another_simulator(learner, tmp_path):
    """First on the compiled engine with many bicycles, then on PyBullet with two."""
    settings = learner_settings(learner)
    first = LearningProcess(settings, tmp_path, 800)
    first.run()
    preset = replace(settings.preset, environments=2, updates=1)
    second = LearningProcess(replace(settings, preset=preset, engine="pybullet"), tmp_path, 840, resume=True)
    assert second.model.replay_buffer.size() * 2 == first.model.replay_buffer.size() * 8
    np.testing.assert_array_equal(weights(second), weights(first))
    second.run()
    assert second.model.num_timesteps == 840
    assert second.model._n_updates == first.model._n_updates + 20
    assert [stage["engine"] for stage in second.summary()["stages"]] == ["whipple", "pybullet"]
    assert np.abs(weights(second) - weights(first)).max() > 0.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_with_a_whole_checkpoint(number, tmp_path):
    process = LearningProcess(learner_settings("sb3"), tmp_path, 100_000)

    def ask(p: LearningProcess) -> None:
        if p.model.num_timesteps == 400:
            signal.raise_signal(number)

    with pytest.raises(KeyboardInterrupt):
        process.run(ask)
    resumed = LearningProcess(learner_settings("sb3"), tmp_path, 440, resume=True)
    assert resumed.model.num_timesteps == 400
    np.testing.assert_array_equal(weights(resumed), weights(process))


def test_nothing_to_resume(tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        LearningProcess(learner_settings("sb3"), tmp_path, 8, resume=True)
