"""Checkpoints of a learning process: everything that lets it go on as if it had not stopped.

A checkpoint is written beside the last one and then takes its place, so that a kill in mid-write costs nothing. It
holds pickles and is meant for the machine that made it; policies are shipped as bundles instead.
"""

from __future__ import annotations

import pickle
import random
import shutil
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

CHECKPOINT: Final = "checkpoint"
_ARRAYS: Final = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(folder: Path, model: OffPolicyAlgorithm, process_state: dict[str, Any]) -> None:
    """Write a checkpoint into ``folder/checkpoint``.

    Args:
        folder: folder of the run.
        model: the learner.
        process_state: whatever else the process must remember; it is pickled.
    """
    fresh = folder / f"{CHECKPOINT}.new"
    old = folder / f"{CHECKPOINT}.old"
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
    (fresh / "state.pkl").write_bytes(pickle.dumps(state))
    current = folder / CHECKPOINT
    shutil.rmtree(old, ignore_errors=True)
    if current.exists():
        current.rename(old)
    fresh.rename(current)
    shutil.rmtree(old, ignore_errors=True)


def load_process_state(folder: Path) -> dict[str, Any]:
    """Return what :func:`save_checkpoint` was given as process state.

    Raises:
        FileNotFoundError: there is no checkpoint.
    """
    process: dict[str, Any] = _read_state(folder)["process"]
    return process


def load_model(folder: Path, env: VecEnv) -> OffPolicyAlgorithm:
    """Load the learner of a checkpoint and restore all random generators.

    Args:
        folder: folder of the run.
        env: the environment that goes on.
    """
    state = _read_state(folder)
    path = folder / CHECKPOINT / "model.zip"
    if state["jax_key"] is None:
        model: Any = SAC.load(path, env=env, device="cpu", force_reset=False)
    else:
        from sbx import SAC as JaxSAC

        model = JaxSAC.load(path, env=env, force_reset=False)
        import jax.numpy as jnp

        model.key = jnp.asarray(state["jax_key"])
    _load_replay(folder / CHECKPOINT / "replay.npz", model.replay_buffer)
    random.setstate(state["random"])
    np.random.set_state(state["numpy"])
    torch.set_rng_state(state["torch"])
    model.action_space.np_random.bit_generator.state = state["action_space"]
    loaded: OffPolicyAlgorithm = model
    return loaded


def _read_state(folder: Path) -> dict[str, Any]:
    path = folder / CHECKPOINT / "state.pkl"
    if not path.is_file():
        raise FileNotFoundError(f"{folder} holds no checkpoint to resume from ({path} is missing)")
    state: dict[str, Any] = pickle.loads(path.read_bytes())
    return state


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
