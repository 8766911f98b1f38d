"""What a sweep keeps of a run in its folder: how it ended, or why it did not."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

RESULT_FILE: Final = "result.json"
FAILURE_FILE: Final = "failure.json"
ATTEMPTS_FILE: Final = "attempts.jsonl"
SCHEMA: Final = "bike.sweep.run/1"

FINISHED, FAILED, INTERRUPTED, MISSING = "finished", "failed", "interrupted", "missing"
"""How a run stands."""


def write_record(path: Path, record: dict[str, Any]) -> None:
    """Write a record so that a kill leaves either none or all of it."""
    unfinished = path.with_name(f"{path.name}.part")
    unfinished.write_text(json.dumps(record, indent=1), encoding="utf-8")
    unfinished.replace(path)


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


def standing_of(folder: Path) -> tuple[str, str]:
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


def note_attempt(folder: Path, attempt: dict[str, Any]) -> int:
    """Write down that an attempt begins, and return its number, from 1."""
    path = folder / ATTEMPTS_FILE
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(attempt) + "\n")
    return len(path.read_text(encoding="utf-8").splitlines())
