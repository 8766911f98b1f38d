"""The driver of a sweep: hands the missing runs to Ray and collects how they end."""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

from bike_training.sweeps.board import Board
from bike_training.sweeps.cluster import ray_cluster
from bike_training.sweeps.plan import PlannedRun
from bike_training.sweeps.records import FAILED, FINISHED, INTERRUPTED, RESULT_FILE, result_of, write_record
from bike_training.sweeps.spec import RunSpec
from bike_training.sweeps.worker import TELL_EVERY, execute

LOOK_EVERY: Final = 1.0
"""Wall-clock time between two looks at how far the runs have come, s."""
REPORTS: Final = 100.0
"""Reports of progress of a whole sweep at most, 1/s: more would fill the head of a large one (docs/notes)."""
SHUTDOWN_TIMEOUT_S: Final = 60.0
"""Longest wait for interrupted runs to write their checkpoints, s."""


class Show(Protocol):
    """Shows how a sweep goes on."""

    def came(self, name: str, done: float, total: float, words: str) -> None:
        """A run has come so far."""
        ...

    def ended(self, name: str, record: dict[str, Any]) -> None:
        """A run has ended."""
        ...


@dataclass(frozen=True)
class Place:
    """Where runs are done.

    Attributes:
        address: of a Ray cluster; None starts Ray on this machine.
        cores: of this machine, without an address; None for all.
        store: second place for the folders of runs, at an fsspec address, or None.
    """

    address: str | None = None
    cores: int | None = None
    store: str | None = None


def do_runs(runs: Sequence[PlannedRun], out: Path, place: Place, retries: int, show: Show) -> bool:
    """Do runs, in this order as far as there is room.

    Args:
        runs: what is to be done.
        out: folder of the sweep.
        place: where.
        retries: how often one is begun again when its worker or its machine is lost.
        show: where to show it.

    Returns:
        Whether it was interrupted.

    Raises:
        ConnectionError: no cluster at the address.
    """
    with ray_cluster(out, place.address, place.cores) as ray:
        board = ray.remote(Board).options(num_cpus=0, max_restarts=-1).remote()
        task, every = ray.remote(_task), max(TELL_EVERY, len(runs) / REPORTS)
        waiting = {
            task.options(
                num_cpus=planned.run.cores,
                memory=int(planned.run.memory_gb * 1e9),
                max_retries=retries,
                retry_exceptions=False,
                name=planned.folder.name,
            ).remote(planned.run, planned.folder, place.store, board, every): planned
            for planned in runs
        }
        try:
            while waiting:
                _collect(ray, waiting, show, LOOK_EVERY)
                _look(ray, board, show)
        except KeyboardInterrupt:
            _interrupt(ray, waiting, show)
            return True
    return False


def _task(run: RunSpec, folder: Path, store: str | None, board: Any, every: float) -> dict[str, Any]:
    """Do a run in a process of Ray.

    Ray cancels a task by what Python does at SIGINT. Where the sweep was begun in the background of a shell or under
    nohup, its workers have inherited that this signal is ignored, and would not hear it.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def told(done: float, total: float, words: str) -> None:
        board.tell.remote(folder.name, done, total, words)

    return execute(run, folder, store, told, tell_every=every)


def _collect(ray: Any, waiting: dict[Any, PlannedRun], show: Show, patience: float) -> None:
    """Take in the runs that have ended."""
    ended, _ = ray.wait(list(waiting), num_returns=1, timeout=patience)
    for reference in ended:
        planned = waiting.pop(reference)
        record = _record_of(ray, reference)
        if record["status"] == FINISHED and result_of(planned.folder) is None:  # a machine with disks of its own
            with suppress(OSError):
                planned.folder.mkdir(parents=True, exist_ok=True)
                write_record(planned.folder / RESULT_FILE, record)
        show.ended(planned.folder.name, record)


def _record_of(ray: Any, reference: Any) -> dict[str, Any]:
    """Return the record of a run that has ended, however it ended."""
    try:
        record: dict[str, Any] = ray.get(reference)
    except ray.exceptions.TaskCancelledError:
        return {"status": INTERRUPTED}
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError) as error:
        why = "memory ran out" if isinstance(error, ray.exceptions.OutOfMemoryError) else "its worker was lost"
        return {"status": FAILED, "error": f"{why} more often than retries allow"}
    except ray.exceptions.RayError as error:
        lines = str(error).strip().splitlines()
        return {"status": FAILED, "error": (lines[0] if lines else type(error).__name__)[:300]}
    return record


def _look(ray: Any, board: Any, show: Show) -> None:
    with suppress(ray.exceptions.RayError):  # the board begins anew where its machine was lost
        for name, line in ray.get(board.take.remote(), timeout=5.0).items():
            show.came(name, *line)


def _interrupt(ray: Any, waiting: dict[Any, PlannedRun], show: Show) -> None:
    """Let runs write their checkpoints and end; a second interruption ends them at once."""
    end = time.monotonic() + SHUTDOWN_TIMEOUT_S
    for reference in waiting:
        ray.cancel(reference, force=False)
    with suppress(KeyboardInterrupt):
        while waiting and time.monotonic() < end:
            _collect(ray, waiting, show, LOOK_EVERY)
