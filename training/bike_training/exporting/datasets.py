"""Recorded rides as data sets of learning: in Minari's format, and in LeRobot's (version 3).

Each ride is ridden again, so that observations, actions and rewards are those of `two_wheeler/Path-v0`, whoever rode:
a policy, a classical rider, a hand.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import rows_of
from bike_sim.vehicles.files import load_vehicle
from bike_training.benchmark.tasks import BICYCLE, benchmark_of
from bike_training.replay import read_rides, replayed
from bike_training.tasks.base import sum_of

TASK: Final = "two_wheeler/Path-v0"
"""Whose observations, actions and rewards the data sets have."""
MINARI_FOLDERS: Final = "MINARI_DATASETS_PATH"
"""Environment variable that names the folder of Minari's data sets."""
LEROBOT_VERSION: Final = "v3.0"

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class Episode:
    """A ride as a learner sees it.

    Attributes:
        rider: name of who rode, as it was recorded.
        observations: shape (steps + 1, size).
        actions: in [-1, 1], shape (steps, columns).
        rewards: shape (steps,).
        failed: whether it ended in failure.
    """

    rider: str
    observations: FloatArray
    actions: FloatArray
    rewards: FloatArray
    failed: bool


def read_episodes(paths: Sequence[Path]) -> list[Episode]:
    """Ride recorded rides again.

    Args:
        paths: recordings of the benchmark bicycle on paths.

    Raises:
        FileNotFoundError: there is no such recording.
        ValueError: a ride of another vehicle, on a circuit, with another control period, or that cannot be ridden.
    """
    task, vehicle = benchmark_of(TASK).task, load_vehicle(BICYCLE)
    layout, factor = task.layout, task.action.columns[0].factor(vehicle.max_steer)
    episodes = []
    for path in paths:
        recording, rides = read_rides(path)
        for ride in rides:
            period = float(ride.ride.states.control_period[0])
            if ride.vehicle != BICYCLE or abs(period - vehicle.control_period) > 1e-9:
                raise ValueError(
                    f"{path}: data sets are made of rides of {BICYCLE!r} with a command every "
                    f"{vehicle.control_period:g} s, not of {ride.vehicle!r} with one every {period:g} s"
                )
            state = task.make_state(1, vehicle)
            seen: list[FloatArray] = []
            actions: list[float] = []
            rewards: list[float] = []
            failed = False
            picked: Any = None
            for snapshot, preview in replayed(ride):
                if snapshot.circuit is not None:
                    raise ValueError(f"{path}: data sets are made of rides on paths, not on circuits")
                if picked is None:
                    picked = layout.pick_preview(preview.by_time, preview.interval, preview.count)
                rows = rows_of(snapshot)
                rows = rows._replace(preview_xy=rows.preview_xy[:, :, picked])
                if seen:
                    outcome = state.evaluate(rows)
                    actions.append(snapshot.steering / factor)
                    rewards.append(float(sum_of(outcome.terms)[0]))
                    failed = bool(outcome.failed[0])
                seen.append(state.observe(rows)[0])
                if failed:
                    break
            if actions:
                shown, given, earned = (np.array(values, dtype="f4") for values in (seen, np.c_[actions], rewards))
                episodes.append(Episode(recording.notes.get("policy") or "unknown", shown, given, earned, failed))
    if not episodes:
        raise ValueError("the recordings hold no ride with a command")
    return episodes


def write_minari(episodes: Sequence[Episode], folder: Path, name: str) -> str:
    """Write a data set that ``minari.load_dataset`` loads, and return its id.

    Args:
        episodes: of rides.
        folder: of data sets; `MINARI_FOLDERS` names it to Minari.
        name: of the data set.

    Raises:
        ModuleNotFoundError: Minari is not installed.
        ValueError: there is such a data set already.
    """
    if find_spec("minari") is None or find_spec("h5py") is None:
        raise ModuleNotFoundError("data sets of Minari need it: pip install 'minari[hdf5]'", name="minari")
    before = os.environ.get(MINARI_FOLDERS)
    os.environ[MINARI_FOLDERS] = str(folder.resolve())  # where Minari writes, and nothing else says so
    try:
        # By name: the package is nobody's requirement here.
        minari, collector = (import_module(f"minari{part}") for part in ("", ".data_collector"))

        dataset_id = f"two_wheeler/path/{name}-v0"
        if (folder / dataset_id).exists():
            raise ValueError(f"{folder / dataset_id} is there already; give another folder")
        benchmark = benchmark_of(TASK)
        env = make_env_of(TASK)
        buffers = [
            collector.EpisodeBuffer(
                id=number,
                observations=list(episode.observations),
                actions=list(episode.actions),
                rewards=episode.rewards.tolist(),
                terminations=[False] * (len(episode.rewards) - 1) + [episode.failed],
                truncations=[False] * (len(episode.rewards) - 1) + [not episode.failed],
            )
            for number, episode in enumerate(episodes)
        ]
        minari.create_dataset_from_buffers(
            dataset_id,
            buffers,
            observation_space=env.observation_space,
            action_space=env.action_space,
            algorithm_name=", ".join(dict.fromkeys(episode.rider for episode in episodes)),
            author="two-wheeler lab",
            description=f"Rides that were recorded, as {TASK} observes and rewards them: {benchmark.summary}.",
        )
        env.close()
    finally:
        os.environ.pop(MINARI_FOLDERS)
        if before is not None:
            os.environ[MINARI_FOLDERS] = before
    return dataset_id


def make_env_of(name: str) -> Any:
    """Return the environment of a frozen task, for its spaces."""
    from bike_training.benchmark.tasks import make_env  # late: it makes an engine

    return make_env(name)


def write_lerobot(episodes: Sequence[Episode], folder: Path) -> Path:
    """Write a data set that ``LeRobotDataset(repo_id, root=folder)`` loads, with all frames in one file.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: the folder is not empty.
    """
    if find_spec("pyarrow") is None:
        raise ModuleNotFoundError("data sets of LeRobot need pyarrow: pip install pyarrow", name="pyarrow")
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    if folder.exists() and any(folder.iterdir()):
        raise ValueError(f"{folder} is not empty; give another folder")
    task = benchmark_of(TASK)
    fps = round(1.0 / load_vehicle(BICYCLE).control_period)
    frames, rows = [], []
    first = 0
    for number, episode in enumerate(episodes):
        count = len(episode.rewards)
        done = np.zeros(count, dtype=bool)
        done[-1] = True
        frame = {
            "observation.state": episode.observations[:-1],
            "action": episode.actions,
            "next.reward": episode.rewards[:, None],
            "next.done": done[:, None],
            "timestamp": (np.arange(count) / fps).astype(np.float32)[:, None],
            "frame_index": np.arange(count)[:, None],
            "episode_index": np.full((count, 1), number),
            "index": first + np.arange(count)[:, None],
            "task_index": np.zeros((count, 1), dtype=np.int64),
        }
        frames.append(frame)
        row: dict[str, Any] = {
            "episode_index": number, "tasks": [task.summary], "length": count,
            "data/chunk_index": 0, "data/file_index": 0,
            "dataset_from_index": first, "dataset_to_index": first + count,
            "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
        }  # fmt: skip
        for key, values in frame.items():
            row |= {f"stats/{key}/{kind}": value for kind, value in _statistics(values).items()}
        rows.append(row)
        first += count
    together = {key: np.concatenate([frame[key] for frame in frames]) for key in frames[0]}
    for name in ("data/chunk-000", "meta/episodes/chunk-000"):
        (folder / name).mkdir(parents=True)
    columns = {
        key: pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        if values.shape[1] > 1
        else pa.array(values[:, 0])  # LeRobot takes a feature of shape (1,) for a number
        for key, values in together.items()
    }
    pq.write_table(pa.table(columns), folder / "data/chunk-000/file-000.parquet")
    pq.write_table(pa.Table.from_pylist(rows), folder / "meta/episodes/chunk-000/file-000.parquet")
    pd.DataFrame({"task_index": [0]}, index=pd.Index([task.summary], name="task")).to_parquet(
        folder / "meta/tasks.parquet"
    )
    names = {"observation.state": [*_names()], "action": list(task.task.action.names)}
    info = {
        "codebase_version": LEROBOT_VERSION,
        "robot_type": BICYCLE,
        "total_episodes": len(episodes),
        "total_frames": first,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 500,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {
            key: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": names.get(key)}
            for key, values in together.items()
        },
    }
    (folder / "meta/info.json").write_text(json.dumps(info, indent=1), encoding="utf-8")
    statistics = {key: _statistics(values) for key, values in together.items()}
    (folder / "meta/stats.json").write_text(json.dumps(statistics, indent=1), encoding="utf-8")
    return folder


def _names() -> list[str]:
    layout = benchmark_of(TASK).task.layout
    return [str(name) for name in layout.names]


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    """Return what LeRobot keeps of a feature to normalise it."""
    numbers = values.astype(np.float64)
    found = {"min": numbers.min(axis=0), "max": numbers.max(axis=0), "mean": numbers.mean(axis=0)}
    found |= {"std": numbers.std(axis=0), "count": np.array([len(numbers)])}
    return {kind: value.tolist() for kind, value in found.items()}
