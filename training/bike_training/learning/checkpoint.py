"""Checkpoints of a learning run: all that lets it go on as if it had not stopped, without pickle.

A checkpoint is written beside the last one and then takes its place, so that a kill costs nothing, whenever it comes.
It holds numbers only, as JSON, safetensors and NumPy arrays: reading one runs no code of its maker. A learner is made
anew from its settings and then takes the stored numbers over, by name.
"""

from __future__ import annotations

import json
import random
import shutil
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer

from bike_training.arguments import write_whole

_ARRAY: Final = "$array"
"""Key of a table that stands for an array of the other file."""


def _without_arrays(node: Any, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    """Return a tree of tables, lists and plain values whose arrays are handed over by name."""
    if isinstance(node, np.ndarray):
        arrays[name] = np.array(node, order="C")  # the format takes the bytes as they lie
        return {_ARRAY: name}
    if isinstance(node, dict):
        return {key: _without_arrays(value, f"{name}/{key}" if name else key, arrays) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_without_arrays(value, f"{name}/{index}", arrays) for index, value in enumerate(node)]
    if isinstance(node, np.generic):
        return node.item()
    # Those of torch and JAX.
    return _without_arrays(np.asarray(node), name, arrays) if hasattr(node, "__array__") else node


def _with_arrays(node: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    if isinstance(node, dict):
        if set(node) == {_ARRAY}:
            return arrays[node[_ARRAY]]
        return {key: _with_arrays(value, arrays) for key, value in node.items()}
    return [_with_arrays(value, arrays) for value in node] if isinstance(node, list) else node


_COUNTERS: Final = (
    "num_timesteps",
    "_total_timesteps",
    "_num_timesteps_at_start",
    "_episode_num",
    "_n_updates",
    "_current_progress_remaining",
)
"""Counters of Stable-Baselines3."""

_TORCH: Final = (SAC, PPO, A2C)
"""Learners of Stable-Baselines3; the policy of sbx is a module of torch as well, without tensors."""
_TRAIN_STATES: Final = ("policy.actor_state", "policy.qf_state", "ent_coef_state")
_KEYS: Final = ("key", "policy.key", "policy.noise_key")
"""Attributes in which sbx keeps networks with their optimisers, and its random keys."""


def _learner_state(model: BaseAlgorithm) -> dict[str, Any]:
    """Return all of a learner but its replay buffer, as plain values and arrays."""
    started = model._last_obs is not None
    version, words, gauss = random.getstate()
    return {
        "counters": {name: getattr(model, name) for name in _COUNTERS},
        "episodes": [dict(info) for info in model.ep_info_buffer or ()],
        "last_observations": np.array(model._last_obs) if started else None,
        "last_episode_starts": np.array(model._last_episode_starts) if started else None,
        "networks": _networks(model),
        "generators": {
            "python": {"version": version, "words": np.array(words, dtype=np.uint64), "gauss": gauss},
            "numpy": np.random.get_state(legacy=False),
            "torch": torch.get_rng_state().numpy(),
            "action_space": model.action_space.np_random.bit_generator.state,
        },
    }


def _restore_learner(model: BaseAlgorithm, stored: dict[str, Any]) -> None:
    """Let a new learner of the same settings go on from a stored state, bit for bit."""
    for name in _COUNTERS:
        setattr(model, name, stored["counters"][name])
    model.ep_info_buffer = deque(stored["episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # no task here tells of success
    model._last_obs = stored["last_observations"]
    model._last_episode_starts = stored["last_episode_starts"]
    restore = _restore_torch if isinstance(model, _TORCH) else _restore_jax
    restore(model, stored["networks"])
    generators = stored["generators"]  # last: making a learner draws
    python = generators["python"]
    random.setstate((python["version"], tuple(python["words"].tolist()), python["gauss"]))
    np.random.set_state(generators["numpy"])
    torch.set_rng_state(torch.from_numpy(generators["torch"]))
    model.action_space.np_random.bit_generator.state = generators["action_space"]


def _networks(model: Any) -> dict[str, Any]:
    """Return networks, optimisers and random keys by name, as tables of arrays."""
    if isinstance(model, _TORCH):
        found = {name: part.state_dict() for name, part in _torch_parts(model).items()}
        entropy = getattr(model, "log_ent_coef", None)
        return found if entropy is None else {**found, "log_ent_coef": entropy.detach()}
    from flax.serialization import to_state_dict

    states = {name: to_state_dict(_attribute(model, name)) for name in _TRAIN_STATES}
    return {**states, **{name: _attribute(model, name) for name in _KEYS}}


def _torch_parts(model: Any) -> dict[str, Any]:
    """Return what holds tensors, by name; the policy holds actor, critics and their targets."""
    if not isinstance(model, SAC):
        return {"policy": model.policy, "policy.optimizer": model.policy.optimizer}
    found: dict[str, Any] = {
        "policy": model.policy,
        "actor.optimizer": model.actor.optimizer,
        "critic.optimizer": model.critic.optimizer,
    }
    if model.ent_coef_optimizer is not None:
        found["ent_coef.optimizer"] = model.ent_coef_optimizer
    return found


def _restore_torch(model: Any, stored: dict[str, Any]) -> None:
    _check_shapes("policy", model.policy.state_dict(), stored["policy"])
    for name, part in _torch_parts(model).items():
        if not isinstance(part, torch.optim.Optimizer):
            part.load_state_dict(_tensors(stored[name]))
            continue
        state = {int(number): _tensors(moments) for number, moments in stored[name]["state"].items()}
        # The groups hold settings only, which the new learner has already.
        part.load_state_dict({"state": state, "param_groups": part.state_dict()["param_groups"]})
    if "log_ent_coef" in stored:
        model.log_ent_coef.data = torch.from_numpy(stored["log_ent_coef"])


def _tensors(arrays: dict[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}


def _check_shapes(name: str, wanted: Any, stored: Any) -> None:
    """Refuse networks of another kind before anything is changed.

    Raises:
        ValueError: naming the first difference.
    """
    if isinstance(wanted, Mapping):
        if set(wanted) != set(stored):
            raise ValueError(f"{name} has other parts: {sorted(set(wanted) ^ set(stored))[:3]}")
        for key, part in wanted.items():
            _check_shapes(f"{name}/{key}", part, stored[key])
    elif np.shape(wanted) != np.shape(stored):
        raise ValueError(f"{name} has shape {np.shape(stored)}, the learner needs {tuple(np.shape(wanted))}")


def _restore_jax(model: Any, stored: dict[str, Any]) -> None:
    import jax
    import jax.numpy as jnp
    from flax.serialization import from_state_dict

    own = _networks(model)
    _check_shapes("networks", own, stored)
    parts = jax.tree.map(lambda new, old: jnp.asarray(old, dtype=jnp.asarray(new).dtype), own, stored)
    for name in _TRAIN_STATES:
        _set_attribute(model, name, from_state_dict(_attribute(model, name), parts[name]))
    for name in _KEYS:
        _set_attribute(model, name, parts[name])


def _attribute(model: Any, place: str) -> Any:
    holder, _, name = place.rpartition(".")
    return getattr(getattr(model, holder) if holder else model, name)


def _set_attribute(model: Any, place: str, value: Any) -> None:
    holder, _, name = place.rpartition(".")
    setattr(getattr(model, holder) if holder else model, name, value)


CHECKPOINT: Final = "checkpoint"
FORMAT: Final = "bike.checkpoint/2"
_FRESH, _OLD = f"{CHECKPOINT}.new", f"{CHECKPOINT}.old"
_STATE, _TENSORS, _REPLAY = "state.json", "tensors.safetensors", "replay.npz"
"""The state is written last: where it is, the checkpoint is whole."""
_ARRAYS: Final = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(folder: Path, model: BaseAlgorithm, run_state: dict[str, Any]) -> None:
    """Write a checkpoint into ``folder/checkpoint``.

    Args:
        folder: folder of the run.
        model: the learner.
        run_state: whatever else the run must remember, as plain values and arrays.
    """
    current, fresh, old = (folder / name for name in (CHECKPOINT, _FRESH, _OLD))
    standing = find_checkpoint(folder)
    if standing is not None and standing != current:
        standing.rename(current)  # a kill came between the two renames below
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    buffer = getattr(model, "replay_buffer", None)
    if buffer is not None:
        end = buffer.buffer_size if buffer.full else buffer.pos
        kept = {name: getattr(buffer, name)[:end] for name in _ARRAYS}
        np.savez(fresh / _REPLAY, pos=buffer.pos, full=buffer.full, **kept)
    arrays: dict[str, NDArray[Any]] = {}
    state = {"format": FORMAT, "run": run_state, "learner": _learner_state(model)}
    text = json.dumps(_without_arrays(state, "", arrays))
    save_file(arrays, fresh / _TENSORS)
    write_whole(fresh / _STATE, text)
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
    """Return whether a folder holds a run that can go on, or what is left of one that did."""
    return find_checkpoint(folder) is not None or (folder / "run.json").exists()


class Checkpoint:
    """A checkpoint that has been read.

    Attributes:
        run: what :func:`save_checkpoint` was given as the state of the run.
    """

    def __init__(self, folder: Path) -> None:
        """Read the checkpoint of a run.

        Raises:
            FileNotFoundError: there is none.
            ValueError: it is damaged, or another version of this software wrote it.
        """
        found = find_checkpoint(folder)
        if found is None:
            raise FileNotFoundError(
                f"{folder} holds no checkpoint ({folder / CHECKPOINT / _STATE} is missing); "
                "a run that ended before its first one begins anew, without --resume"
            )
        self._folder = found
        with readable(found / _STATE):
            state = json.loads((found / _STATE).read_text(encoding="utf-8"))
            kind = state.get("format") if isinstance(state, dict) else type(state).__name__
            if kind != FORMAT:
                raise ValueError(f"its format is {kind!r} and not {FORMAT}")
        with readable(found / _TENSORS):
            state = _with_arrays(state, load_file(found / _TENSORS))
        with self.reading():
            self.run: dict[str, Any] = state["run"]
            self._learner: dict[str, Any] = state["learner"]

    def restore(self, model: BaseAlgorithm) -> None:
        """Let a new learner of the same settings go on from here, random generators of the process included.

        Raises:
            ValueError: it is damaged, or of another task.
        """
        path, buffer = self._folder / _REPLAY, getattr(model, "replay_buffer", None)
        if buffer is not None:
            with readable(path):
                _load_replay(path, buffer)
        with self.reading():
            _restore_learner(model, self._learner)

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Name this checkpoint in whatever goes wrong while the state of the run is taken over."""
        with readable(self._folder):
            yield


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file of a checkpoint raises while it is read into one clear error."""
    if not (path.is_file() or path.is_dir()):  # a pipe would be waited for
        raise ValueError(f"{path} cannot be read (it is missing, or no regular file); the checkpoint is damaged")
    try:
        yield
    except OSError:
        raise  # names the file
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        reason = f"no entry {reason}" if isinstance(error, KeyError) else reason
        raise ValueError(
            f"{path} cannot be read ({reason[:200]}); it is damaged, or another version of this software wrote it"
        ) from error


def _load_replay(path: Path, buffer: ReplayBuffer) -> None:
    with np.load(path, allow_pickle=False) as stored:
        if stored["rewards"].shape[1] == buffer.n_envs:
            for name in _ARRAYS:
                getattr(buffer, name)[: len(stored[name])] = stored[name]
            buffer.pos = int(stored["pos"])
            buffer.full = bool(stored["full"])
            return
        # Another number of vehicles: each transition stands for itself, so they may be dealt out anew.
        rows = min(stored["rewards"].size // buffer.n_envs, buffer.buffer_size)
        for name in _ARRAYS:
            target = getattr(buffer, name)
            transitions = stored[name].reshape(-1, *target.shape[2:])[-rows * buffer.n_envs :]
            target[:rows] = transitions.reshape(rows, buffer.n_envs, *target.shape[2:])
        buffer.pos = rows % buffer.buffer_size
        buffer.full = rows == buffer.buffer_size
