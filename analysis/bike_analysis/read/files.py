"""The files of a recording: one, or several of a rosbag2 directory, also where its recorder was killed."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import yaml

from bike_analysis.read.container import Container, RecordingError, open_regular

METADATA_FILE: Final = "metadata.yaml"
LARGEST_METADATA: Final = 4 * 1024 * 1024
"""Beyond this size `METADATA_FILE` is not parsed, bytes. That of a thousand files has a tenth of it."""

_NUMBERED: Final = re.compile(r"(.+)_(\d+)\.mcap")


class RecordingFiles(NamedTuple):
    """Files of a recording.

    Attributes:
        files: Those that can be read, in order, at least one.
        warnings: What is missing or cannot be read, one sentence each.
    """

    files: tuple[Path, ...]
    warnings: tuple[str, ...]


def find_files(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Files of a recording as `examine_files` finds them, without its warnings."""
    return examine_files(path).files


def examine_files(path: str | os.PathLike[str]) -> RecordingFiles:
    """Find the MCAP files of a recording.

    Args:
        path: An MCAP file, or a rosbag2 directory. One that was split while recording has several files, which its
            ``metadata.yaml`` lists, but for the last one of a killed recorder: it is found by its number.

    Returns:
        The files, and the faults of others.

    Raises:
        FileNotFoundError: If it does not exist.
        RecordingError: If the directory has several files and nothing says that they belong together, or if none of
            several can be read.
        OSError: If none of several can be opened.
    """
    target = Path(path)
    if not target.exists():
        raise FileNotFoundError(f"recording {target} does not exist")
    if target.is_file():
        return RecordingFiles((target,), ())
    if not target.is_dir():
        raise RecordingError(f"{target} is neither a file nor a directory")
    listed = _listed_files(target)
    there = [file for file in listed if file.is_file()]
    missing = tuple(f"{file.name} is missing: {METADATA_FILE} lists it" for file in listed if file not in there)
    files = [*there, *_numbered_after(listed[-1])] if listed else []
    if files:
        readable, unreadable = _readable(files)
        return RecordingFiles(readable, missing + unreadable)
    files = sorted(target.glob("*.mcap"))
    if not files:
        raise FileNotFoundError(f"directory {target} holds no .mcap file")
    if len(files) > 1:
        names = ", ".join(f.name for f in files[:5])
        raise RecordingError(f"directory {target} holds {len(files)} recordings ({names}); name one of them")
    return RecordingFiles(tuple(files), missing)


def _listed_files(directory: Path) -> list[Path]:
    """Files that the directory's metadata.yaml lists; they may be missing."""
    try:
        with open_regular(directory / METADATA_FILE) as file:
            text = file.read(LARGEST_METADATA + 1)
        if len(text) > LARGEST_METADATA:
            return []
        content = yaml.safe_load(text.decode("utf-8"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        return [directory / name for name in names if isinstance(name, str)]
    except (OSError, ValueError, KeyError, TypeError, RecursionError, yaml.YAMLError):
        return []


def _numbered_after(last: Path) -> list[Path]:
    """Files that follow the last listed one by their numbers: a killed recorder lists only those that it finished."""
    match = _NUMBERED.fullmatch(last.name)
    if match is None:
        return []
    found = [(_NUMBERED.fullmatch(file.name), file) for file in last.parent.glob("*.mcap")]
    numbers = {int(m[2]): file for m, file in found if m is not None and m[1] == match[1] and file.is_file()}
    return [numbers[number] for number in sorted(numbers) if number > int(match[2])]


def _readable(files: Sequence[Path]) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Leave out what no message can be read of, such as an empty file.

    Raises:
        RecordingError, OSError: That of the first file, if this is true of all.
    """
    readable, errors = [], []
    for file in files:
        try:
            Container(file).check()
        except (RecordingError, OSError) as error:
            errors.append(error)
        else:
            readable.append(file)
    if not readable:
        raise errors[0]
    return tuple(readable), tuple(f"left out: {error}" for error in errors)
