"""The file of a sweep: a grid or a list of runs, checked in whole before anything starts."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from bike_sim.documents import MAX_YAML_SIZE, DocumentError, parse_yaml, read_text, show
from bike_training.sweeps.jobs import JOBS, Job

MAX_RUNS: Final = 20_000
"""Runs of one sweep at most: what a schedule and a table on one machine are still quick with."""
DIGEST_LENGTH: Final = 10
LABEL_LENGTH: Final = 80

_KEYS: Final = {"name", "task", "base", "grid", "runs", "cores", "memory_gb", "retries"}
_SET: Final = "set"
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9._=,+-]+")

Progress = Callable[[Sequence[Any]], Iterable[Any]]
"""Passes a sequence on while it shows how far it is."""


@dataclass(frozen=True)
class RunSpec:
    """One run: what its result depends on, and what it needs of a machine.

    Attributes:
        task: name in :data:`bike_training.sweeps.jobs.JOBS`.
        entries: its entries, as the file has them.
        varied: those of them that differ between the runs of the sweep, flat, ``set.gamma`` for a setting.
        cores: processor cores that are kept for it.
        memory_gb: main memory that is kept for it, GB.
        estimate: processor time that it is expected to take, s.
    """

    task: str
    entries: Mapping[str, Any]
    varied: Mapping[str, Any]
    cores: float
    memory_gb: float
    estimate: float = 0.0

    @property
    def digest(self) -> str:
        """Identity of the run, from task and entries alone."""
        text = json.dumps({"task": self.task, **self.entries}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:DIGEST_LENGTH]

    @property
    def label(self) -> str:
        """Text for people that sets it apart from the others."""
        return ",".join(f"{key.removeprefix('set.')}={_short(value)}" for key, value in self.varied.items())

    @property
    def group(self) -> str:
        """The same without the seed: runs of a group are repetitions of each other."""
        parts = {key: value for key, value in self.varied.items() if key != "seed"}
        return ",".join(f"{key.removeprefix('set.')}={_short(value)}" for key, value in parts.items()) or self.task

    @property
    def name(self) -> str:
        """Name of its folder. The digest at its end finds it again when another sweep labels it otherwise."""
        label = _UNSAFE.sub("_", self.label)[:LABEL_LENGTH].strip("_") or self.task
        return f"{label}-{self.digest}"

    def job(self) -> Job:
        """Return the run as something that can be done.

        Raises:
            ValueError: an entry that is unknown or means nothing.
            FileNotFoundError: an unknown vehicle, course or rider.
        """
        return JOBS[self.task].from_entries(self.entries)


@dataclass(frozen=True)
class Sweep:
    """A sweep.

    Attributes:
        name: for people.
        runs: all runs, each once.
        retries: how often a run is begun again, or goes on, after its worker or its machine was lost.
    """

    name: str
    runs: tuple[RunSpec, ...]
    retries: int = 3


def load_sweep(path: Path, progress: Progress = iter) -> Sweep:
    """Read the file of a sweep and check every run of it.

    Args:
        path: the file.
        progress: shows how many runs have been checked.

    Raises:
        FileNotFoundError: there is none, or a run names a vehicle, course or rider that does not exist.
        ValueError: it is no such file, or a run in it cannot be; names the entry.
    """
    try:
        return sweep_from_document(parse_yaml(read_text(path, MAX_YAML_SIZE)), path.stem, path.parent, progress)
    except FileNotFoundError as error:
        if error.filename is None:
            raise FileNotFoundError(f"sweep '{path}': {error}") from None
        raise FileNotFoundError(f"sweep '{path}' does not exist") from None
    except ValueError as error:
        raise ValueError(
            f"sweep '{path}' {error}" if isinstance(error, DocumentError) else f"{path}: {error}"
        ) from None


def sweep_from_document(document: Any, name: str = "sweep", folder: Path = Path(), progress: Progress = iter) -> Sweep:
    """Return the sweep that a parsed file describes.

    Args:
        document: content of the file.
        name: where the file gives none.
        folder: files that an entry names are looked for here.
        progress: as of `load_sweep`.

    Raises:
        FileNotFoundError: as of `load_sweep`.
        ValueError: as of `load_sweep`.
    """
    if not isinstance(document, dict):
        raise ValueError(f"a sweep is a table with task, base, grid or runs; got {show(document)}")
    unknown = sorted(set(map(str, document)) - _KEYS)
    if unknown:
        raise ValueError(f"unknown entry {unknown[0]!r}; a sweep has {', '.join(sorted(_KEYS))}")
    retries = document.get("retries", 3)
    if not isinstance(retries, int) or isinstance(retries, bool) or not 0 <= retries <= 1000:
        raise ValueError(f"retries must be a whole number from 0 to 1000, got {show(retries)}")
    found = [_absolute(entries, folder) for entries in _expand(document)]
    varied = _varied([_flat(entries) for _, entries in found])
    runs, seen = [], dict[str, int]()
    for place, (task, entries) in enumerate(progress(found)):
        kind = JOBS[task]
        flat = _flat(entries)
        run = RunSpec(
            task,
            entries,
            {key: flat[key] for key in varied if key in flat},
            _amount(document, "cores", kind.cores),
            _amount(document, "memory_gb", kind.memory_gb),
        )
        try:
            run = replace(run, estimate=run.job().estimate())
        except (ValueError, FileNotFoundError) as error:
            where = f"run {place + 1} of {len(found)}" + (f" ({run.label})" if run.label else "")
            raise type(error)(f"{where}: {error}") from None
        if run.digest in seen:
            raise ValueError(f"run {place + 1} is run {seen[run.digest]} again ({run.label or run.task})")
        seen[run.digest] = place + 1
        runs.append(run)
    title = document.get("name", name)
    if not isinstance(title, str) or not title.strip() or len(title) > 200:
        raise ValueError(f"name must be text of at most 200 characters, got {show(title)}")
    return Sweep(title, tuple(runs), retries)


def _expand(document: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """Return task and entries of every run that the file describes."""
    base = _table(document.get("base", {}), "base")
    grid = _table(document.get("grid", {}), "grid")
    for key, values in grid.items():
        if not isinstance(values, list) or not values:
            raise ValueError(f"grid entry {key!r} must be a list of values, got {show(values)}")
    listed = document.get("runs", [{}])
    if not isinstance(listed, list) or not listed:
        raise ValueError(f"runs must be a list of tables, got {show(listed)}")
    count = len(listed) * math.prod(map(len, grid.values()))
    if count > MAX_RUNS:
        raise ValueError(f"{count} runs; a sweep has at most {MAX_RUNS}")
    found = []
    for own, values in itertools.product(listed, itertools.product(*grid.values())):
        entries = _merged(base, dict(zip(grid, values, strict=True)))
        entries = _merged(entries, _table(own, "an entry of runs"))
        task = entries.pop("task", document.get("task", "train"))
        if task not in JOBS:
            raise ValueError(f"task {show(task)} is not one of {', '.join(JOBS)}")
        found.append((task, entries))
    return found


def _table(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{what} must be a table of entries, got {show(value)}")
    return value


def _merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries over others; ``set.gamma`` is the entry ``gamma`` of ``set``."""
    merged = {**first, _SET: dict(_table(first.get(_SET, {}), _SET))}
    for key, value in second.items():
        if key == _SET:
            merged[_SET].update(_table(value, _SET))
        elif key.startswith(f"{_SET}."):
            merged[_SET][key[len(_SET) + 1 :]] = value
        else:
            merged[key] = value
    if not merged[_SET]:
        del merged[_SET]
    return merged


def _absolute(found: tuple[str, dict[str, Any]], folder: Path) -> tuple[str, dict[str, Any]]:
    """Return entries whose files are named from the root: a worker runs in another folder."""
    task, entries = found
    near = {
        key: str((folder / value).resolve())
        for key, value in entries.items()
        if isinstance(value, str) and key in ("vehicle", "course", "policy", "rider") and (folder / value).exists()
    }
    return task, {**entries, **near}


def _flat(entries: Mapping[str, Any]) -> dict[str, Any]:
    inner = {f"{_SET}.{key}": value for key, value in entries.get(_SET, {}).items()}
    return {**{key: value for key, value in entries.items() if key != _SET}, **inner}


def _varied(flats: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the names of entries that differ between runs, in the order in which the runs give them."""
    names = dict.fromkeys(itertools.chain.from_iterable(flats))
    first = flats[0]
    return [name for name in names if any(flat.get(name) != first.get(name) for flat in flats[1:])]


def _amount(document: Mapping[str, Any], name: str, default: float) -> float:
    value = document.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= 4096.0:
        raise ValueError(f"{name} must be a positive number up to 4096, got {show(value)}")
    return float(value)


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "x".join(map(_short, value))
    if isinstance(value, dict):
        return "+".join(f"{key}{_short(entry)}" for key, entry in value.items())
    if isinstance(value, str) and "/" in value:
        return Path(value).stem
    return f"{value:g}" if isinstance(value, float) else str(value)
