"""Data sets of learning from recordings: what a loader finds is what was ridden."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import minari
import numpy as np
import pyarrow.parquet as pq
import pytest

from bike_policy.contract.bundle import Actor
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.benchmark.tasks import benchmark_of
from bike_training.cli import main
from bike_training.exporting.datasets import MINARI_FOLDERS, TASK, read_episodes
from bike_training.learning.episode_recording import Standing, record_ride
from bike_training.tasks.path import PathTask

STEPS = 600
"""Control periods of a validation ride, which is recorded."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path, task = tmp_path_factory.mktemp("recording") / "ride.mcap", PathTask(task="fine")
    weights = dict.fromkeys(task.layout.names, 0.0) | {"roll": -0.6, "roll_rate": -0.35}  # steers into the fall
    actor = Actor([np.array([list(weights.values())], dtype="f4")], [np.zeros(1, dtype="f4")])
    config = SimulatorConfig(engine="whipple", time_step=0.01)
    request = ResetRequest(course="line", speed_range=(5.0, 5.0), preview=task.preview)
    record_ride(path, actor, task, config, request, Standing(100, 1, None))
    return path


def test_an_episode_is_the_ride(recording: Path) -> None:
    (episode,) = read_episodes([recording])
    assert episode.actions.shape == (STEPS, 1)
    assert episode.observations.shape == (STEPS + 1, benchmark_of(TASK).task.layout.size)
    assert np.abs(episode.actions).max() <= 1.0
    assert (episode.rewards > 0.5).all()  # at 4 m/s near the path
    assert not episode.failed
    # Put into the vehicle's set point, the actions are the commands: the ride itself, which is ridden again for them.
    assert np.isfinite(episode.observations).all()


def test_minari_loads_what_was_written(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = ["analyze", str(recording), "--minari", str(tmp_path), "--name", "classical"]
    assert main(command) == 0
    monkeypatch.setenv(MINARI_FOLDERS, str(tmp_path))
    loaded = minari.load_dataset("two_wheeler/path/classical-v0")
    (episode,) = read_episodes([recording])
    assert loaded.total_steps == STEPS
    found = next(iter(loaded.iterate_episodes()))
    np.testing.assert_array_equal(found.observations, episode.observations)
    np.testing.assert_array_equal(found.actions, episode.actions)
    np.testing.assert_allclose(found.rewards, episode.rewards, rtol=1e-6)
    assert list(found.truncations) == [False] * (STEPS - 1) + [True]
    assert main(command) == 2  # there already


def test_lerobots_files_are_those_of_version_3(recording: Path, tmp_path: Path, capsys) -> None:
    folder = tmp_path / "set"
    assert main(["analyze", str(recording), str(recording), "--lerobot", str(folder), "--json"]) == 0
    info = json.loads((folder / "meta/info.json").read_text())
    table = pq.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    frames = table.to_pydict()
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 20, 2)
    assert set(info["features"]) == set(frames)
    for name, feature in info["features"].items():  # what LeRobot 0.4.4 makes of a feature: one number is no list
        kind, (size,) = table.schema.field(name).type, feature["shape"]
        assert (str(kind) if size == 1 else str(kind.value_type)).replace("double", "float64") == (
            {"float32": "float"}.get(feature["dtype"], feature["dtype"])
        )
        assert size == 1 or kind.list_size == size
    assert frames["index"] == list(range(2 * STEPS)) == list(range(info["total_frames"]))
    assert frames["frame_index"] == [*range(STEPS)] * 2
    np.testing.assert_allclose(frames["timestamp"][:STEPS], np.arange(STEPS) / 20.0, rtol=1e-6)
    (episode, _) = read_episodes([recording, recording])
    np.testing.assert_array_equal(np.array(frames["action"][:STEPS], dtype=np.float32)[:, None], episode.actions)
    names = info["features"]["observation.state"]["names"]
    assert len(names) == info["features"]["observation.state"]["shape"][0] == episode.observations.shape[1]
    rides = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pydict()
    assert rides["dataset_from_index"] == [0, STEPS]
    assert rides["dataset_to_index"] == [STEPS, 2 * STEPS]
    tasks = pq.read_table(folder / "meta/tasks.parquet").to_pydict()
    assert tasks["task"] == rides["tasks"][0]
    stats = json.loads((folder / "meta/stats.json").read_text())
    assert stats["action"]["max"] == [pytest.approx(episode.actions.max())]
    capsys.readouterr()
    assert main(["analyze", str(recording), "--lerobot", str(folder)]) == 2
    assert "is not empty; give another folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("program", "words"), [("rerun", ["mcap", "convert", "{ride}", "-o", "{rrd}"]), ("mcap", ["doctor", "{ride}"])]
)
def test_other_programs_open_a_recording(recording: Path, tmp_path: Path, program: str, words: list[str]) -> None:
    """Rerun (package rerun-sdk) and the command line of MCAP, where they are installed."""
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    places = {"ride": recording, "rrd": tmp_path / "ride.rrd"}
    command = [program, *(word.format(**places) for word in words)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    if program == "rerun":
        for topic in ("state", "command", "episode", "course", "events"):
            assert f"/bike/{topic}" in ended.stdout + ended.stderr
