"""Checkpoints of a learning run: everything that lets it go on as if it had not stopped.

A checkpoint is written beside the last one and then takes its place, so that a kill costs nothing, whenever it comes.
It holds numbers only, as JSON, safetensors and NumPy arrays without pickle: reading one runs no code of its maker.
"""

from __future__ import annotations

import csv
import io
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from bike_training.learning.learner_state import learner_state, restore_learner
from bike_training.learning.stored_tree import read_plain, with_tensors, write_tree

CHECKPOINT: Final = "checkpoint"
FORMAT: Final = "bike.checkpoint/1"
_FRESH, _OLD = f"{CHECKPOINT}.new", f"{CHECKPOINT}.old"
_STATE, _TENSORS, _REPLAY = "state.json", "tensors.safetensors", "replay.npz"
"""The state is written last: where it is, the checkpoint is whole."""
_PICKLED: Final = "state.pkl"
"""What checkpoints of earlier versions have in its place."""
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
    """Tell whether a folder holds a run that can go on, or what is left of one that did."""
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
