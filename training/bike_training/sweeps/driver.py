"""The driver of a sweep: hands the missing runs to Ray and collects how they end."""

from __future__ import annotations

import json
import signal
import sys
import time
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any, Final

from tqdm import tqdm

from bike_training.arguments import write_whole
from bike_training.progress import progress_bar
from bike_training.sweeps.cluster import first_line, ray_cluster
from bike_training.sweeps.runs import (
    FAILED,
    FINISHED,
    INTERRUPTED,
    REPORT_PERIOD_S,
    RESULT_FILE,
    Plan,
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


class _Display(AbstractContextManager["_Display"]):
    """Shows a sweep on standard error: one bar over its runs, and one line for each that ends; quiet only failures."""

    def __init__(self, plan: Plan, quiet: bool) -> None:
        self._quiet, self._total = quiet, len(plan.runs)
        self._done = self._total - len(plan.missing)
        self._shares: dict[str, float] = {}
        self._bar = progress_bar("runs", "run", self._total, quiet=quiet)
        self._bar.initial = self._bar.n = self._done

    def __exit__(self, *_: object) -> None:
        """Leave the terminal as it was."""
        self._bar.close()

    def show_progress(self, name: str, done: float, total: float, text: str) -> None:
        """Show how far a run has come."""
        self._shares[name] = min(1.0, done / total) if total else 0.0
        self._bar.set_postfix_str(f"{name}: {done:.0f} of {total:.0f} {text}", refresh=False)
        self._bar.update(round(self._done + sum(self._shares.values()), 2) - self._bar.n)

    def show_end(self, name: str, record: dict[str, Any]) -> None:
        """Show how a run has ended, in one line."""
        self._shares.pop(name, None)
        status = record["status"]
        self._done += status == FINISHED
        if status == FAILED:
            tqdm.write(f"{name}: failed: {record['error']}", file=sys.stderr)
        elif not self._quiet:
            took = f" after {tqdm.format_interval(record['seconds'])}" if "seconds" in record else ""
            tqdm.write(f"{name}: {status}{took} ({self._done} of {self._total} done)", file=sys.stderr)


def do_runs(plan: Plan, out: Path, place: tuple[str | None, int | None], retries: int, quiet: bool) -> bool:
    """Do the missing runs of a sweep, the longest first as far as there is room.

    Args:
        plan: the sweep as it stands.
        out: its folder.
        place: address of a Ray cluster, None starts Ray on this machine; and cores of this machine that it may use
            without an address, None for all.
        retries: how often one is begun again when its worker or its machine is lost.
        quiet: whether only failures are shown.

    Returns:
        Whether it was interrupted.

    Raises:
        ConnectionError: no cluster at the address.
    """
    runs = plan.missing
    if not runs:
        return False
    with _Display(plan, quiet) as display, ray_cluster(out, *place) as ray:
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


def _collect(ray: Any, waiting: dict[Any, PlannedRun], display: _Display, patience: float) -> None:
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


def _show_progress(ray: Any, reports: Any, display: _Display) -> None:
    with suppress(ray.exceptions.RayError):  # the queue begins anew where its machine was lost
        size = ray.get(reports.actor.qsize.remote(), timeout=5.0)
        latest = {name: line for name, *line in ray.get(reports.actor.get_nowait_batch.remote(size), timeout=5.0)}
        for name, line in latest.items():
            display.show_progress(name, *line)


def _interrupt(ray: Any, waiting: dict[Any, PlannedRun], display: _Display) -> None:
    """Let runs write their checkpoints and end; a second interruption ends them at once."""
    end = time.monotonic() + SHUTDOWN_TIMEOUT_S
    for reference in waiting:
        ray.cancel(reference, force=False)
    with suppress(KeyboardInterrupt):
        while waiting and time.monotonic() < end:
            _collect(ray, waiting, display, POLL_PERIOD_S)
