"""Checkpoints of a learning run: all that lets it go on as if it had not stopped, without pickle.

A checkpoint is written beside the last one and then takes its place, so that a kill costs nothing, whenever it comes.
It holds numbers only, as JSON, safetensors and NumPy arrays: reading one runs no code of its maker. A learner is made
anew from its settings and then takes the stored numbers over, by name.
"""

from __future__ import annotations

import csv
import io
import json
import random
import shutil
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file
from stable_baselines3 import SAC
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

_ARRAY: Final = "$array"
"""Key of a table that stands for an array of the other file."""


def write_tree(tree: dict[str, Any], plain: Path, tensors: Path) -> None:
    """Write a tree of tables, lists, texts, numbers, truth values, None and NumPy arrays.

    Args:
        tree: what to write.
        plain: JSON file; it is written last, so where it is, both are whole.
        tensors: safetensors file.

    Raises:
        TypeError: a value of another kind.
    """
    arrays: dict[str, NDArray[Any]] = {}
    text = json.dumps(_without_arrays(tree, "", arrays))
    save_file(arrays, tensors)
    unfinished = plain.with_name(f"{plain.name}.part")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(plain)


def read_plain(plain: Path) -> dict[str, Any]:
    """Read the JSON file of a tree; its arrays are still missing.

    Raises:
        ValueError: no such tree.
    """
    tree = json.loads(plain.read_text(encoding="utf-8"))
    if not isinstance(tree, dict):
        raise ValueError(f"it holds a {type(tree).__name__} and not a table")
    return tree


def with_tensors(plain: dict[str, Any], tensors: Path) -> dict[str, Any]:
    """Return a tree with its arrays.

    Args:
        plain: result of :func:`read_plain`.
        tensors: its safetensors file.

    Raises:
        SafetensorError: a damaged file. KeyError: an array is missing there.
    """
    found: dict[str, Any] = _with_arrays(plain, load_file(tensors))
    return found


def _without_arrays(node: Any, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(node, np.ndarray):
        arrays[name] = np.array(node, order="C")  # the format takes the bytes as they lie
        return {_ARRAY: name}
    if isinstance(node, dict):
        return {key: _without_arrays(value, f"{name}/{key}" if name else key, arrays) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_without_arrays(value, f"{name}/{index}", arrays) for index, value in enumerate(node)]
    return node.item() if isinstance(node, np.generic) else node


def _with_arrays(node: Any, arrays: dict[str, NDArray[Any]]) -> Any:
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

_TRAIN_STATES: Final = ("policy.actor_state", "policy.qf_state", "ent_coef_state")
_TRAIN_PARTS: Final = ("step", "params", "target_params", "opt_state")
_KEYS: Final = ("key", "policy.key", "policy.noise_key")
"""Attributes in which sbx keeps networks with their optimisers, and its random keys."""


def learner_state(model: OffPolicyAlgorithm) -> dict[str, Any]:
    """Return all that :func:`restore_learner` needs but the replay buffer, as plain values and arrays."""
    networks = _torch_arrays(model) if isinstance(model, SAC) else _jax_arrays(model)
    started = model._last_obs is not None
    return {
        "counters": {name: getattr(model, name) for name in _COUNTERS},
        "episodes": [dict(info) for info in model.ep_info_buffer or ()],
        "last_observations": np.array(model._last_obs) if started else None,
        "last_episode_starts": np.array(model._last_episode_starts) if started else None,
        "networks": networks,
        "generators": _generators(model),
    }


def restore_learner(model: OffPolicyAlgorithm, stored: dict[str, Any]) -> None:
    """Let a new learner of the same settings go on from a stored state, bit for bit.

    Args:
        model: the learner; its networks must have the stored shapes.
        stored: result of :func:`learner_state`.

    Raises:
        ValueError: networks of other names or shapes.
        KeyError: an entry is missing.
    """
    for name in _COUNTERS:
        setattr(model, name, stored["counters"][name])
    model.ep_info_buffer = deque(stored["episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # no task here tells of success
    model._last_obs = stored["last_observations"]
    model._last_episode_starts = stored["last_episode_starts"]
    if isinstance(model, SAC):
        _restore_torch(model, stored["networks"])
    else:
        _restore_jax(model, stored["networks"])
    _restore_generators(model, stored["generators"])  # last: making a learner draws


def _generators(model: OffPolicyAlgorithm) -> dict[str, Any]:
    version, words, gauss = random.getstate()
    return {
        "python": {"version": version, "words": np.array(words, dtype=np.uint64), "gauss": gauss},
        "numpy": np.random.get_state(legacy=False),
        "torch": torch.get_rng_state().numpy(),
        "action_space": model.action_space.np_random.bit_generator.state,
    }


def _restore_generators(model: OffPolicyAlgorithm, stored: dict[str, Any]) -> None:
    python = stored["python"]
    random.setstate((python["version"], tuple(python["words"].tolist()), python["gauss"]))
    np.random.set_state(stored["numpy"])
    torch.set_rng_state(torch.from_numpy(stored["torch"]))
    model.action_space.np_random.bit_generator.state = stored["action_space"]


def _torch_modules(model: SAC) -> dict[str, Any]:
    """Return what holds tensors, by name; the policy holds actor, critics and their targets."""
    found: dict[str, Any] = {
        "policy": model.policy,
        "actor.optimizer": model.actor.optimizer,
        "critic.optimizer": model.critic.optimizer,
    }
    if model.ent_coef_optimizer is not None:
        found["ent_coef.optimizer"] = model.ent_coef_optimizer
    return found


def _torch_tensors(model: SAC) -> Iterator[tuple[str, torch.Tensor]]:
    for name, module in _torch_modules(model).items():
        if isinstance(module, torch.optim.Optimizer):
            for number, moments in module.state_dict()["state"].items():
                yield from ((f"{name}/{number}/{key}", value) for key, value in moments.items())
        else:
            yield from ((f"{name}/{key}", value) for key, value in module.state_dict().items())
    if model.log_ent_coef is not None:
        yield "log_ent_coef", model.log_ent_coef


def _torch_arrays(model: SAC) -> dict[str, NDArray[Any]]:
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in _torch_tensors(model)}


def _restore_torch(model: SAC, stored: dict[str, NDArray[Any]]) -> None:
    tensors = {name: torch.from_numpy(np.array(array)) for name, array in stored.items()}
    for name, module in _torch_modules(model).items():
        own = {key.removeprefix(f"{name}/"): value for key, value in tensors.items() if key.startswith(f"{name}/")}
        if not isinstance(module, torch.optim.Optimizer):
            _check_shapes(name, {key: value.shape for key, value in module.state_dict().items()}, own)
            module.load_state_dict(own)
            continue
        state: dict[int, dict[str, torch.Tensor]] = {}
        for key, value in own.items():
            number, _, moment = key.partition("/")
            state.setdefault(int(number), {})[moment] = value
        # The groups hold settings only, which the new learner has already.
        module.load_state_dict({"state": state, "param_groups": module.state_dict()["param_groups"]})
    if model.log_ent_coef is not None:
        model.log_ent_coef.data = tensors["log_ent_coef"]


def _check_shapes(name: str, wanted: dict[str, Any], stored: dict[str, Any]) -> None:
    """Refuse networks of another kind before anything is changed.

    Raises:
        ValueError: naming the first difference.
    """
    if set(wanted) != set(stored):
        raise ValueError(f"{name} has other parts: {sorted(set(wanted) ^ set(stored))[:3]}")
    for key, shape in wanted.items():
        if tuple(shape) != tuple(stored[key].shape):
            raise ValueError(f"{name}/{key} has shape {tuple(stored[key].shape)}, the learner needs {tuple(shape)}")


def _jax_leaves(model: Any, place: str) -> tuple[dict[str, Any], Any]:
    """Return the numbers of one network with its optimiser by stable path names, and how they fit together."""
    import jax

    state = _attribute(model, place)
    parts = {part: getattr(state, part) for part in _TRAIN_PARTS if hasattr(state, part)}
    leaves, tree = jax.tree_util.tree_flatten_with_path(parts)
    return {f"{place}{jax.tree_util.keystr(path)}": leaf for path, leaf in leaves}, tree


def _jax_arrays(model: Any) -> dict[str, NDArray[Any]]:
    found = {key: np.array(_attribute(model, key)) for key in _KEYS}
    for place in _TRAIN_STATES:
        found.update({name: np.array(leaf) for name, leaf in _jax_leaves(model, place)[0].items()})
    return found


def _restore_jax(model: Any, stored: dict[str, NDArray[Any]]) -> None:
    import jax
    import jax.numpy as jnp

    for place in _TRAIN_STATES:
        leaves, tree = _jax_leaves(model, place)
        own = {key: value for key, value in stored.items() if key.startswith((f"{place}[", f"{place}."))}
        _check_shapes(place, {key: np.shape(leaf) for key, leaf in leaves.items()}, own)
        parts = jax.tree_util.tree_unflatten(
            tree, [jnp.asarray(own[key], dtype=jnp.asarray(leaf).dtype) for key, leaf in leaves.items()]
        )
        _set_attribute(model, place, _attribute(model, place).replace(**parts))
    for key in _KEYS:
        _set_attribute(model, key, jnp.asarray(stored[key]))


def _attribute(model: Any, place: str) -> Any:
    holder, _, name = place.rpartition(".")
    return getattr(getattr(model, holder) if holder else model, name)


def _set_attribute(model: Any, place: str, value: Any) -> None:
    holder, _, name = place.rpartition(".")
    setattr(getattr(model, holder) if holder else model, name, value)


CHECKPOINT: Final = "checkpoint"
FORMAT: Final = "bike.checkpoint/1"
_FRESH, _OLD = f"{CHECKPOINT}.new", f"{CHECKPOINT}.old"
_STATE, _TENSORS, _REPLAY = "state.json", "tensors.safetensors", "replay.npz"
"""The state is written last: where it is, the checkpoint is whole."""
_PICKLED: Final = "state.pkl"
"""Name of its counterpart in checkpoints of earlier versions."""
_ARRAYS: Final = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(folder: Path, model: OffPolicyAlgorithm, run_state: dict[str, Any]) -> None:
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
    _save_replay(fresh / _REPLAY, model.replay_buffer)
    state = {"format": FORMAT, "run": run_state, "learner": learner_state(model)}
    write_tree(state, fresh / _STATE, fresh / _TENSORS)
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
    pickled = (folder / CHECKPOINT / _PICKLED).exists()
    return pickled or find_checkpoint(folder) is not None or (folder / "run.json").exists()


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
        self._folder = _present(folder)
        with _readable(self._folder / _STATE) as path:
            plain = read_plain(path)
            if plain.get("format") != FORMAT:
                raise ValueError(f"its format is {plain.get('format')!r} and not {FORMAT}")
        with _readable(self._folder / _TENSORS) as path:
            state = with_tensors(plain, path)
        with self.reading():
            self.run: dict[str, Any] = state["run"]
            self._learner: dict[str, Any] = state["learner"]

    def restore(self, model: OffPolicyAlgorithm) -> None:
        """Let a new learner of the same settings go on from here, random generators of the process included.

        Raises:
            ValueError: it is damaged, or of another task.
        """
        with _readable(self._folder / _REPLAY) as path:
            _load_replay(path, model.replay_buffer)
        with self.reading():
            restore_learner(model, self._learner)

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Name this checkpoint in whatever goes wrong while the state of the run is taken over."""
        with _readable(self._folder):
            yield


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
    if checkpoint is not None:
        return checkpoint
    pickled = folder / CHECKPOINT / _PICKLED
    if pickled.exists():
        raise ValueError(
            f"{pickled.parent} was written by an earlier version, as a pickle, which could run code of its maker; it "
            "is no longer read, so begin the run anew in another folder"
        )
    raise FileNotFoundError(
        f"{folder} holds no checkpoint ({folder / CHECKPOINT / _STATE} is missing); "
        "a run that ended before its first one begins anew, without --resume"
    )


@contextmanager
def _readable(path: Path) -> Iterator[Path]:
    """Turn whatever a damaged file of a checkpoint raises while it is read into one clear error."""
    if not (path.is_file() or path.is_dir()):  # a pipe would be waited for
        raise ValueError(f"{path} cannot be read (it is missing, or no regular file); the checkpoint is damaged")
    try:
        yield path
    except OSError:
        raise  # names the file
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        reason = f"no entry {reason}" if isinstance(error, KeyError) else reason
        raise ValueError(
            f"{path} cannot be read ({reason[:200]}); it is damaged, or another version of this software wrote it"
        ) from error


def _save_replay(path: Path, buffer: ReplayBuffer | None) -> None:
    assert buffer is not None
    end = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: getattr(buffer, name)[:end] for name in _ARRAYS}
    np.savez(path, pos=buffer.pos, full=buffer.full, **arrays)


def _load_replay(path: Path, buffer: ReplayBuffer | None) -> None:
    assert buffer is not None
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
