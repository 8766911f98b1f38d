"""Runs of a sweep in their folders: status, plan of the missing ones, and one run in the process that does it."""

from __future__ import annotations

import json
import os
import socket
import statistics
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from bike_sim.recording.in_use import Claim, claim_folder
from bike_training.arguments import write_whole
from bike_training.learning.run_settings import source_commit
from bike_training.sweeps.jobs import Report
from bike_training.sweeps.spec import RunSpec, Sweep

RESULT_FILE: Final = "result.json"
FAILURE_FILE: Final = "failure.json"
ATTEMPTS_FILE: Final = "attempts.jsonl"
SCHEMA: Final = "bike.sweep.run/1"

FINISHED, FAILED, INTERRUPTED, MISSING = "finished", "failed", "interrupted", "missing"
"""Status of a run."""


def read_record(path: Path) -> dict[str, Any] | None:
    """Return a record, or None where there is none that can be read."""
    with suppress(OSError, ValueError):
        found = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(found, dict):
            return found
    return None


def result_of(folder: Path) -> dict[str, Any] | None:
    """Return the result of the run in a folder, or None where it has not finished."""
    found = read_record(folder / RESULT_FILE)
    return found if found and found.get("schema") == SCHEMA and found.get("status") == FINISHED else None


def status_of(folder: Path) -> tuple[str, str]:
    """Return how the run in a folder stands, and for one that failed why."""
    if result_of(folder) is not None:
        return FINISHED, ""
    failure = read_record(folder / FAILURE_FILE)
    if failure is not None:
        return FAILED, str(failure.get("error", ""))
    return (INTERRUPTED if (folder / ATTEMPTS_FILE).exists() else MISSING), ""


def folder_of(runs: Path, name: str, digest: str) -> Path:
    """Return the folder of a run: the one that ends in its digest, whatever an earlier sweep called it."""
    known = sorted(runs.glob(f"*-{digest}")) if runs.is_dir() else []
    return known[0] if known else runs / name


RUNS_FOLDER: Final = "runs"


@dataclass(frozen=True)
class PlannedRun:
    """A run of a sweep as it stands.

    Attributes:
        run: its entries and needs.
        folder: its folder.
        status: finished, failed, interrupted or missing.
        error: cause of failure, or empty.
        seconds: how long it took if it has finished, else how long it is expected to take from its beginning, s.
    """

    run: RunSpec
    folder: Path
    status: str
    error: str
    seconds: float

    @property
    def finished(self) -> bool:
        """Whether nothing of it is to be done."""
        return self.status == FINISHED


@dataclass(frozen=True)
class Plan:
    """A sweep as it stands in its folder.

    Attributes:
        runs: in the order of the sweep's file.
    """

    runs: tuple[PlannedRun, ...]

    @property
    def missing(self) -> tuple[PlannedRun, ...]:
        """Runs that are to be done, the longest first: then no long one is left alone at the end."""
        left = [run for run in self.runs if not run.finished]
        return tuple(sorted(left, key=lambda run: -run.seconds))

    @property
    def counts(self) -> dict[str, int]:
        """Number of runs by status."""
        found = [run.status for run in self.runs]
        return {status: found.count(status) for status in (FINISHED, FAILED, INTERRUPTED, MISSING)}

    def hours(self, cores: float) -> float:
        """Return the time that what is missing is expected to take, h: its work shared evenly, or its longest run."""
        slots = max(1, int(cores / max((run.run.cores for run in self.missing), default=1.0) + 1e-9))
        seconds = [run.seconds for run in self.missing]
        return max(sum(seconds) / slots, *seconds[:1], 0.0) / 3600.0


def make_plan(sweep: Sweep, out: Path) -> Plan:
    """Look at what a folder holds of a sweep."""
    runs = out / RUNS_FOLDER
    folders = [folder_of(runs, run.name, run.digest) for run in sweep.runs]
    estimates = [run.estimate for run in sweep.runs]
    results = [result_of(folder) for folder in folders]
    ratios = [
        float(result["seconds"]) / estimate
        for result, estimate in zip(results, estimates, strict=True)
        if result is not None and result["attempts"] == 1
    ]
    scale = statistics.median(ratios) if ratios else 1.0  # by which the others are expected to take longer
    return Plan(
        tuple(
            PlannedRun(run, folder, *status_of(folder), float(result["seconds"]) if result else scale * estimate)
            for run, folder, result, estimate in zip(sweep.runs, folders, results, estimates, strict=True)
        )
    )


CLAIM_TIMEOUT_S: Final = 60.0
"""Longest wait for a folder that the worker of a killed driver still holds, s."""
REPORT_PERIOD_S: Final = 1.0
"""Wall-clock time between two reports of progress, s."""
ERROR_LENGTH: Final = 300


def execute(
    run: RunSpec,
    folder: Path,
    report: Report | None = None,
    report_period: float = REPORT_PERIOD_S,
) -> dict[str, Any]:
    """Do a run, or go on with it.

    Args:
        run: its task and entries.
        folder: its folder; nothing else is written.
        report: called now and then with the work done, the whole work, and a text.
        report_period: wall-clock time between two calls, s.

    Returns:
        Its record: with ``status`` finished, interrupted, or failed; a failure is no exception here, so that it
        stops no other run.
    """
    began, clock, processor = datetime.now(UTC), time.perf_counter(), time.process_time()
    record: dict[str, Any] = {
        "schema": SCHEMA,
        "run": folder.name,
        "digest": run.digest,
        "task": run.task,
        "entries": dict(run.entries),
    }
    record |= {"host": socket.gethostname(), "started_at": began.isoformat(timespec="seconds")}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _claimed(folder):
            done = result_of(folder)
            if done is not None:
                return done
            (folder / FAILURE_FILE).unlink(missing_ok=True)
            with (folder / ATTEMPTS_FILE).open("a+", encoding="utf-8") as file:
                begun = {"started_at": record["started_at"], "host": record["host"], "pid": os.getpid()}
                file.write(json.dumps(begun) + "\n")
                file.seek(0)
                attempt = len(file.readlines())
            figures, interrupted = run.job().run(folder, _throttled(report, report_period))
            record |= {
                "status": INTERRUPTED if interrupted else FINISHED,
                "figures": figures,
                "attempts": attempt,
                "seconds": round(time.perf_counter() - clock, 2),
                "cpu_seconds": round(time.process_time() - processor, 2),
                "commit": source_commit(),
                "ended_at": datetime.now(UTC).isoformat(timespec="seconds"),
            }
            if not interrupted:
                write_whole(folder / RESULT_FILE, json.dumps(record, indent=1))
            return record
    except KeyboardInterrupt:
        return record | {"status": INTERRUPTED}
    except Exception as error:
        return record | _failure(folder, error)


def _failure(folder: Path, error: Exception) -> dict[str, Any]:
    """Write down why a run failed, where that can be written, and return it."""
    lines = str(error).strip().splitlines()
    words = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    failure = {"status": FAILED, "error": words[:ERROR_LENGTH]}
    with suppress(OSError):  # the disk may be what is full
        (folder / "error.txt").write_text("".join(traceback.format_exception(error)), encoding="utf-8")
        write_whole(folder / FAILURE_FILE, json.dumps(failure, indent=1))
    return failure


def _claimed(folder: Path) -> Claim:
    """Claim the folder of a run; a worker whose driver was killed lets go of it within seconds.

    Raises:
        OSError: another process holds it for too long.
    """
    end = time.monotonic() + CLAIM_TIMEOUT_S
    while True:
        try:
            return claim_folder(folder)
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)


def _throttled(report: Report | None, every: float) -> Report:
    last = 0.0

    def throttled(done: float, total: float, words: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < every and done < total:
            return
        last = now
        if report is not None:
            report(done, total, words)

    return throttled
