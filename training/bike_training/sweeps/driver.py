"""The driver of a sweep: hands the missing runs to Ray and collects how they end."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from bike_training.arguments import write_whole
from bike_training.sweeps.cluster import first_line, ray_cluster
from bike_training.sweeps.display import Display
from bike_training.sweeps.runs import (
    FAILED,
    FINISHED,
    INTERRUPTED,
    REPORT_PERIOD_S,
    RESULT_FILE,
    PlannedRun,
    execute,
    result_of,
)
from bike_training.sweeps.spec import RunSpec

POLL_PERIOD_S: Final = 1.0
"""Wall-clock time between two polls of the progress of the runs, s."""
REPORT_RATE: Final = 100.0
"""Reports of progress of a whole sweep at most, 1/s: more would fill the head of a large one (docs/notes)."""
SHUTDOWN_TIMEOUT_S: Final = 60.0
"""Longest wait for interrupted runs to write their checkpoints, s."""


Place = tuple[str | None, int | None]
"""Address of a Ray cluster, and processor cores of this machine."""


def do_runs(runs: Sequence[PlannedRun], out: Path, place: Place, retries: int, display: Display) -> bool:
    """Do runs, in this order as far as there is room.

    Args:
        runs: what is to be done.
        out: folder of the sweep.
        place: address of a Ray cluster, None starts Ray on this machine; and cores of this machine that it may use
            without an address, None for all.
        retries: how often one is begun again when its worker or its machine is lost.
        display: shows progress and ends.

    Returns:
        Whether it was interrupted.

    Raises:
        ConnectionError: no cluster at the address.
    """
    with ray_cluster(out, *place) as ray:
        from ray.util.queue import Queue

        reports = Queue(actor_options={"num_cpus": 0, "max_restarts": -1})
        task, period = ray.remote(_task), max(REPORT_PERIOD_S, len(runs) / REPORT_RATE)
        waiting = {
            task.options(
                num_cpus=planned.run.cores,
                memory=int(planned.run.memory_gb * 1e9),
                max_retries=retries,
                retry_exceptions=False,
                name=planned.folder.name,
            ).remote(planned.run, planned.folder, reports, period): planned
            for planned in runs
        }
        try:
            while waiting:
                _collect(ray, waiting, display, POLL_PERIOD_S)
                _show_progress(ray, reports, display)
        except KeyboardInterrupt:
            _interrupt(ray, waiting, display)
            return True
    return False


def _task(run: RunSpec, folder: Path, reports: Any, period: float) -> dict[str, Any]:
    """Do a run in a process of Ray.

    Ray cancels a task by what Python does at SIGINT. Where the sweep was begun in the background of a shell or under
    nohup, its workers have inherited that this signal is ignored.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def report(done: float, total: float, text: str) -> None:
        reports.actor.put_nowait.remote((folder.name, done, total, text))  # the queue's own method waits for the actor

    return execute(run, folder, report, report_period=period)


def _collect(ray: Any, waiting: dict[Any, PlannedRun], display: Display, patience: float) -> None:
    """Take in the runs that have ended."""
    ended, _ = ray.wait(list(waiting), num_returns=1, timeout=patience)
    for reference in ended:
        planned = waiting.pop(reference)
        record = _record_of(ray, reference)
        if record["status"] == FINISHED and result_of(planned.folder) is None:  # a machine with disks of its own
            with suppress(OSError):
                planned.folder.mkdir(parents=True, exist_ok=True)
                write_whole(planned.folder / RESULT_FILE, json.dumps(record, indent=1))
        display.show_end(planned.folder.name, record)


def _record_of(ray: Any, reference: Any) -> dict[str, Any]:
    """Return the record of a run that has ended, however it ended."""
    errors = ray.exceptions
    try:
        record: dict[str, Any] = ray.get(reference)
    except errors.TaskCancelledError:
        return {"status": INTERRUPTED}
    except errors.OutOfMemoryError:
        return {"status": FAILED, "error": "memory ran out more often than retries allow"}
    except (errors.WorkerCrashedError, errors.NodeDiedError):
        return {"status": FAILED, "error": "its worker was lost more often than retries allow"}
    except errors.RayError as error:
        return {"status": FAILED, "error": first_line(error)}
    return record


def _show_progress(ray: Any, reports: Any, display: Display) -> None:
    with suppress(ray.exceptions.RayError):  # the queue begins anew where its machine was lost
        size = ray.get(reports.actor.qsize.remote(), timeout=5.0)
        latest = {name: line for name, *line in ray.get(reports.actor.get_nowait_batch.remote(size), timeout=5.0)}
        for name, line in latest.items():
            display.show_progress(name, *line)


def _interrupt(ray: Any, waiting: dict[Any, PlannedRun], display: Display) -> None:
    """Let runs write their checkpoints and end; a second interruption ends them at once."""
    end = time.monotonic() + SHUTDOWN_TIMEOUT_S
    for reference in waiting:
        ray.cancel(reference, force=False)
    with suppress(KeyboardInterrupt):
        while waiting and time.monotonic() < end:
            _collect(ray, waiting, display, POLL_PERIOD_S)
