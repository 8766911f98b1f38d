"""Checkpoints of a learning process: everything that lets it go on as if it had not stopped.

A checkpoint is written beside the last one and then takes its place, so that a kill costs nothing, whenever it comes.
It holds pickles and is meant for the machine that made it; policies are shipped as bundles instead.
"""

from __future__ import annotations

import csv
import io
import pickle
import random
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

CHECKPOINT: Final = "checkpoint"
_FRESH, _OLD = f"{CHECKPOINT}.new", f"{CHECKPOINT}.old"
_STATE: Final = "state.pkl"
"""Written last: where it is, the checkpoint is whole."""
_ARRAYS: Final = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(folder: Path, model: OffPolicyAlgorithm, process_state: dict[str, Any]) -> None:
    """Write a checkpoint into ``folder/checkpoint``.

    Args:
        folder: folder of the run.
        model: the learner.
        process_state: whatever else the process must remember; it is pickled.
    """
    current, fresh, old = (folder / name for name in (CHECKPOINT, _FRESH, _OLD))
    standing = find_checkpoint(folder)
    if standing is not None and standing != current:
        standing.rename(current)  # a kill came between the two renames below
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    model.save(fresh / "model.zip")
    _save_replay(fresh / "replay.npz", model.replay_buffer)
    state = {
        "process": process_state,
        "random": random.getstate(),
        "numpy": np.random.get_state(),
        "torch": torch.get_rng_state(),
        "action_space": model.action_space.np_random.bit_generator.state,
        "jax_key": np.asarray(model.key) if hasattr(model, "key") else None,
    }
    unfinished = fresh / f"{_STATE}.part"
    unfinished.write_bytes(pickle.dumps(state))
    unfinished.rename(fresh / _STATE)
    shutil.rmtree(old, ignore_errors=True)
    if current.exists():
        current.rename(old)
    fresh.rename(current)
    shutil.rmtree(old, ignore_errors=True)


def find_checkpoint(folder: Path) -> Path | None:
    """Return the folder of the newest whole checkpoint of a run, or None."""
    places = (folder / name for name in (CHECKPOINT, _FRESH, _OLD))
    return next((place for place in places if (place / _STATE).is_file()), None)


def holds_run(folder: Path) -> bool:
    """Tell whether a folder holds a run that can go on, or what is left of one that did."""
    return find_checkpoint(folder) is not None or (folder / "run.json").exists()


def load_process_state(folder: Path) -> dict[str, Any]:
    """Return what :func:`save_checkpoint` was given as process state.

    Raises:
        FileNotFoundError: there is no checkpoint.
        ValueError: it is damaged.
    """
    process: dict[str, Any] = _read_state(_present(folder))["process"]
    return process


def load_model(folder: Path, env: VecEnv) -> OffPolicyAlgorithm:
    """Load the learner of a checkpoint and restore all random generators.

    Args:
        folder: folder of the run.
        env: the environment that goes on.

    Raises:
        FileNotFoundError: there is no checkpoint.
        ValueError: it is damaged, or of another task.
    """
    checkpoint = _present(folder)
    state = _read_state(checkpoint)
    path = checkpoint / "model.zip"
    with _readable(path):
        if state["jax_key"] is None:
            model: Any = SAC.load(path, env=env, device="cpu", force_reset=False)
        else:
            from sbx import SAC as JaxSAC

            model = JaxSAC.load(path, env=env, force_reset=False)
            import jax.numpy as jnp

            model.key = jnp.asarray(state["jax_key"])
    with _readable(checkpoint / "replay.npz") as replay:
        _load_replay(replay, model.replay_buffer)
    random.setstate(state["random"])
    np.random.set_state(state["numpy"])
    torch.set_rng_state(state["torch"])
    model.action_space.np_random.bit_generator.state = state["action_space"]
    loaded: OffPolicyAlgorithm = model
    return loaded


def drop_rows_after(path: Path, step: int) -> None:
    """Drop the rows of a run's table that were written after its checkpoint, and one that a kill cut short.

    Args:
        path: CSV file with the learning step in its first column; it need not exist.
        step: last learning step that the checkpoint knows of.
    """
    if not path.exists():
        return
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    kept = [row for row in rows if len(row) == len(rows[0]) and (not row[0].isdigit() or int(row[0]) <= step)]
    text = io.StringIO(newline="")
    csv.writer(text).writerows(kept)
    write_whole(path, text.getvalue())


def write_whole(path: Path, text: str) -> None:
    """Write a text so that a kill leaves either the file of before or all of the new one."""
    unfinished = path.with_name(f"{path.name}.part")
    unfinished.write_text(text, encoding="utf-8", newline="")
    unfinished.replace(path)


def _present(folder: Path) -> Path:
    checkpoint = find_checkpoint(folder)
    if checkpoint is None:
        raise FileNotFoundError(
            f"{folder} holds no checkpoint ({folder / CHECKPOINT / _STATE} is missing); "
            "a run that ended before its first one begins anew, without --resume"
        )
    return checkpoint


def _read_state(checkpoint: Path) -> dict[str, Any]:
    with _readable(checkpoint / _STATE) as path:
        state: dict[str, Any] = pickle.loads(path.read_bytes())
        return state


@contextmanager
def _readable(path: Path) -> Iterator[Path]:
    """Turn whatever a damaged file of a checkpoint raises while it is read into one clear error."""
    try:
        yield path
    except OSError:
        raise  # names the file
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(
            f"{path} cannot be read ({reason}); it is damaged, or another version of this software wrote it"
        ) from error


def _save_replay(path: Path, buffer: ReplayBuffer | None) -> None:
    assert buffer is not None
    end = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: getattr(buffer, name)[:end] for name in _ARRAYS}
    np.savez(path, pos=buffer.pos, full=buffer.full, **arrays)


def _load_replay(path: Path, buffer: ReplayBuffer | None) -> None:
    assert buffer is not None
    with np.load(path) as stored:
        if stored["rewards"].shape[1] == buffer.n_envs:
            for name in _ARRAYS:
                getattr(buffer, name)[: len(stored[name])] = stored[name]
            buffer.pos = int(stored["pos"])
            buffer.full = bool(stored["full"])
            return
        # Another number of bicycles: each transition stands for itself, so they may be dealt out anew.
        rows = min(stored["rewards"].size // buffer.n_envs, buffer.buffer_size)
        for name in _ARRAYS:
            target = getattr(buffer, name)
            transitions = stored[name].reshape(-1, *target.shape[2:])[-rows * buffer.n_envs :]
            target[:rows] = transitions.reshape(rows, buffer.n_envs, *target.shape[2:])
        buffer.pos = rows % buffer.buffer_size
        buffer.full = rows == buffer.buffer_size
