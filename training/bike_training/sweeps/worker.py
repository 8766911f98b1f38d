"""One run in the process that does it: its folder is claimed, it begins or goes on, and its end is written down."""

from __future__ import annotations

import os
import socket
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from bike_sim.recording.in_use import Claim, claim_folder
from bike_training.learning.run_settings import source_commit
from bike_training.sweeps.job_parts import Tell
from bike_training.sweeps.jobs import Job
from bike_training.sweeps.records import (
    FAILED,
    FAILURE_FILE,
    FINISHED,
    INTERRUPTED,
    RESULT_FILE,
    SCHEMA,
    note_attempt,
    result_of,
    write_record,
)
from bike_training.sweeps.spec import RunSpec
from bike_training.sweeps.store import Store

PATIENCE: Final = 60.0
"""Longest wait for a folder that the worker of a killed driver still holds, s."""
TELL_EVERY: Final = 1.0
"""Wall-clock time between two reports of progress, s."""
LONGEST_ERROR: Final = 300


def execute(
    run: RunSpec,
    folder: Path,
    store: str | None = None,
    told: Tell | None = None,
    job: Job | None = None,
    tell_every: float = TELL_EVERY,
) -> dict[str, Any]:
    """Do a run, or go on with it.

    Args:
        run: what it is.
        folder: its folder; nothing else is written.
        store: address of a second place for the folder, or None.
        told: called now and then with work done, all of it, and words.
        job: the run, where it is watched; else it is made of its entries.
        tell_every: wall-clock time between two calls, s.

    Returns:
        Its record: with ``status`` finished, interrupted, or failed; a failure is no exception here, so that it is told
        in one line and stops no other run.
    """
    began, clock, processor = datetime.now(UTC), time.perf_counter(), time.process_time()
    record = {
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
            second = Store(store) if store else None
            if second:
                second.pull(folder)
            done = result_of(folder)
            if done is not None:
                return done
            (folder / FAILURE_FILE).unlink(missing_ok=True)
            attempt = note_attempt(
                folder, {"started_at": record["started_at"], "host": record["host"], "pid": os.getpid()}
            )
            end = (job or run.job()).run(folder, _throttled(told, _keeper(folder, second), tell_every))
            ended: dict[str, Any] = {
                "status": INTERRUPTED if end.interrupted else FINISHED,
                "figures": end.figures,
                "attempts": attempt,
                "seconds": round(time.perf_counter() - clock, 2),
                "cpu_seconds": round(time.process_time() - processor, 2),
                "commit": source_commit(),
                "ended_at": datetime.now(UTC).isoformat(timespec="seconds"),
            }
            record |= ended
            if not end.interrupted:
                write_record(folder / RESULT_FILE, record)
            if second:
                second.push(folder)
            return record
    except KeyboardInterrupt:
        return record | {"status": INTERRUPTED}
    except Exception as error:
        return record | _failure(folder, error)


def _failure(folder: Path, error: Exception) -> dict[str, Any]:
    """Write down why a run failed, where that can be written, and return it."""
    lines = str(error).strip().splitlines()
    words = f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
    failure = {"status": FAILED, "error": words[:LONGEST_ERROR]}
    with suppress(OSError):  # the disk may be what is full
        (folder / "error.txt").write_text("".join(traceback.format_exception(error)), encoding="utf-8")
        write_record(folder / FAILURE_FILE, failure)
    return failure


@contextmanager
def _claimed(folder: Path) -> Iterator[None]:
    """Hold the folder of a run; a worker whose driver was killed lets go of it within seconds.

    Raises:
        OSError: another process holds it for too long.
    """
    end = time.monotonic() + PATIENCE
    claim: Claim | None = None
    while claim is None:
        try:
            claim = claim_folder(folder)
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)
    with claim:
        yield


def _keeper(folder: Path, store: Store | None) -> Callable[[], None]:
    """Return what brings a new checkpoint to the store, when there is one."""
    state = folder / "checkpoint" / "state.json"
    seen = 0

    def keep() -> None:
        nonlocal seen
        with suppress(FileNotFoundError):
            changed = state.stat().st_mtime_ns
            if store is not None and changed != seen:
                seen = changed
                store.push(folder)

    return keep


def _throttled(told: Tell | None, keep: Callable[[], None], every: float) -> Tell:
    last = 0.0

    def tell(done: float, total: float, words: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < every and done < total:
            return
        last = now
        keep()
        if told is not None:
            told(done, total, words)

    return tell
