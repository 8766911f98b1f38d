"""Checks of the arguments of commands, which name the option and the value, and their files."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bike_sim.recording.in_use import claim_folder


def check_positive(option: str, value: float, unit: str, most: float = math.inf) -> None:
    """Check a number.

    Raises:
        ValueError: it is not finite, not above 0, or above the largest.
    """
    if not (math.isfinite(value) and 0.0 < value <= most):
        bound = "and finite" if math.isinf(most) else f"and at most {most:g} {unit}"
        raise ValueError(f"{option} must be positive {bound}, got {value:g} {unit}")


def check_whole(option: str, value: int, least: int, most: int | None = None) -> None:
    """Check a whole number.

    Raises:
        ValueError: it is less than the least or more than the most.
    """
    if value < least or (most is not None and value > most):
        wanted = f"at least {least}" if most is None else f"{least} to {most}"
        raise ValueError(f"{option} must be {wanted}, got {value}")


def seeds_of(option: str, text: str) -> tuple[int, ...]:
    """Return seeds: of ``N`` those from 0 to N - 1, of ``A-B`` those from A to B, both ends included.

    Raises:
        ValueError: it is neither, or there would be no seed.
    """
    match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", text, re.ASCII)
    if match is None:
        raise ValueError(f"{option} must be a number of seeds, as 5, or a range of seeds, as 2-4; got {text!r}")
    first, last = (0, int(match[1]) - 1) if match[2] is None else (int(match[1]), int(match[2]))
    if last < first:
        raise ValueError(f"{option} {text} holds no seed")
    return tuple(range(first, last + 1))


def make_folder(option: str, path: Path) -> None:
    """Make a folder for what a command writes, so that one that cannot be is known before and not after the work.

    Raises:
        FileExistsError: there is a file of that name. OSError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise FileExistsError(f"{option} {path} cannot be a folder: a file is in the way") from error


def write_whole(path: Path, text: str) -> None:
    """Write a text so that a kill leaves either the file of before or all of the new one."""
    unfinished = path.with_name(f"{path.name}.part")
    unfinished.write_text(text, encoding="utf-8", newline="")
    unfinished.replace(path)


def read_json(path: Path, needed: Iterable[str] = ()) -> dict[str, Any]:
    """Read a JSON object.

    Args:
        path: the file.
        needed: entries that it must have.

    Raises:
        OSError: there is no such file.
        ValueError: it holds something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as JSON ({error}); it is damaged or another file") from error
    if not isinstance(found, dict) or not set(needed) <= set(found):
        wanted = f" with {', '.join(sorted(needed))}" if needed else ""
        raise ValueError(f"{path} must hold one JSON object{wanted}; it is another file than asked for")
    return found


@contextmanager
def recording_folder(given: Path | None, usual: str, overwrite: bool) -> Iterator[Path]:
    """Make and claim the folder of a new recording.

    Args:
        given: the folder; None for the usual one or, where that is in use or holds a recording, the next number.
        usual: its name where none is given, in the folder out.
        overwrite: whether it may hold a recording.

    Yields:
        The folder.

    Raises:
        FileExistsError: the given folder holds a recording, or there is a file of its name.
        OSError: it cannot be made, or is in use.
    """
    for number in itertools.count(1):
        folder = given or Path("out", usual if number == 1 else f"{usual}-{number}")
        make_folder("--out", folder)
        if not overwrite and (found := sorted(folder.glob("*.mcap"))):
            if given is None:
                continue
            raise FileExistsError(f"--out {folder} holds {found[0].name}; choose another folder, or add --overwrite")
        try:
            claim = claim_folder(folder)
        except BlockingIOError:
            if given is None:
                continue
            raise
        with claim:
            yield folder
        return
