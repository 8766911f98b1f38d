"""Loading of courses: shipped ones by name, random circuits by seed, and the user's files by path.

A course is a path (a line to follow) or a circuit (a closed line with limits, walls and corners). Both are found, read
and refused by the same code; what a file says is turned into one of them by :mod:`bike_sim.course.reading`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

from bike_sim.course.course import Course
from bike_sim.course.csv_line import MAX_CSV_SIZE, CentreLine, CourseFileError, parse_csv
from bike_sim.course.random_courses import RANDOM_CIRCUIT, random_circuit, seed_of
from bike_sim.course.reading import (
    PATH_FORMAT,
    PATH_KEYS,
    TRACK_FORMAT,
    path_from_document,
    path_from_points,
    track_from_document,
    track_from_points,
)
from bike_sim.course.track import Track
from bike_sim.documents import (
    MAX_YAML_SIZE,
    DocumentError,
    alternatives,
    check_name,
    parse_yaml,
    read_text,
    shorten,
    show,
)

Kind = Literal["path", "circuit"]

_FORMATS: Mapping[str, Kind] = {PATH_FORMAT: "path", TRACK_FORMAT: "circuit"}
_FOLDERS: Mapping[Kind, str] = {"path": "courses", "circuit": "tracks"}
_YAML, _CSV = (".yaml", ".yml"), ".csv"


class _Content(NamedTuple):
    """The content of a course's file, a YAML document or the points of a CSV file, before the course is built."""

    path: Path
    kind: Kind
    said: Mapping[str, Any] | CentreLine

    @property
    def name(self) -> str:
        """Name of a course that is called after its file."""
        return check_name(self.path.stem, "the file's name, which the course takes,")


def shipped_courses() -> tuple[str, ...]:
    """Return the names of the shipped paths, sorted."""
    return _shipped("path")


def shipped_tracks() -> tuple[str, ...]:
    """Return the names of the shipped circuits, sorted."""
    return _shipped("circuit")


def kind_of(name_or_path: str | Path) -> Kind:
    """Return the kind of a name or a file, without building the course.

    A CSV file is a circuit when its line is closed and has widths; a YAML file is what its format says, a path without.

    Args:
        name_or_path: as for `load_course`.

    Raises:
        FileNotFoundError: no such course or file.
        CourseFileError: the file cannot be read; faults that need the built course are not checked.
    """
    if seed_of(name_or_path) is not None:
        return "circuit"
    with _content(name_or_path) as content:
        return content.kind


def load_course(name_or_path: str | Path) -> Course:
    """Load the line of a course.

    Args:
        name_or_path: name of a shipped path; name of a shipped circuit or ``random_circuit:<seed>`` for its centre
            line; or path of a ``.yaml``, ``.yml`` or ``.csv`` file. The points of a CSV file are taken as they are,
            where `load_track` smooths them.

    Raises:
        FileNotFoundError: no such course or file.
        CourseFileError: the file is broken; the message names the row or element and the fault.
    """
    seed = seed_of(name_or_path)
    if seed is not None:
        return random_circuit(seed).centre
    with _content(name_or_path) as content:
        if isinstance(content.said, CentreLine):
            return path_from_points(content.name, content.said)
        if content.kind == "circuit":
            return track_from_document(content.said, content.path).centre
        return path_from_document(content.said, content.path)


def load_track(name_or_path: str | Path) -> Track:
    """Load a circuit, without its ideal line.

    Args:
        name_or_path: name of a shipped circuit, ``random_circuit:<seed>``, or path of a ``.yaml``, ``.yml`` or ``.csv``
            file.

    Raises:
        FileNotFoundError: no such circuit or file.
        CourseFileError: the file is broken, or is a path; the message names the row or element and the fault.
    """
    if seed_of(name_or_path) is not None or not Path(name_or_path).suffix:
        return _named_track(str(name_or_path))
    return _read_track(name_or_path)


@lru_cache(maxsize=4)
def _named_track(name: str) -> Track:
    """Return a shipped or random circuit, which does not change while a program runs."""
    seed = seed_of(name)
    return _read_track(name) if seed is None else random_circuit(seed)


def _read_track(name_or_path: str | Path) -> Track:
    with _content(name_or_path) as content:
        if isinstance(content.said, CentreLine):
            return track_from_points(content.name, content.said)
        if content.kind == "circuit":
            return track_from_document(content.said, content.path)
        raise CourseFileError(
            f"is a path; a circuit has the format {TRACK_FORMAT!r} or is the CSV file of a closed line with widths"
        )


def _shipped(kind: Kind) -> tuple[str, ...]:
    folder = resources.files("bike_sim") / "config" / _FOLDERS[kind]
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml")))


@contextmanager
def _content(name_or_path: str | Path) -> Iterator[_Content]:
    """Find and read a course; every error within names the file."""
    path = Path(name_or_path)
    if not path.suffix:
        path = _shipped_file(str(name_or_path))
    shown = shorten(str(path))
    try:
        yield _read(path)
    except FileNotFoundError as error:
        # A file that the course's file names has been named already; an error of the system has a number.
        raise (error if error.errno is None else FileNotFoundError(f"there is no course file {shown}")) from None
    except ValueError as error:
        cause = None if isinstance(error, DocumentError) else error
        raise CourseFileError(f"course file {shown}: {error}") from cause


def _shipped_file(name: str) -> Path:
    for kind, folder in _FOLDERS.items():
        if name in _shipped(kind):
            return Path(str(resources.files("bike_sim"))) / "config" / folder / f"{name}.yaml"
    known = alternatives(name, (*shipped_courses(), *shipped_tracks(), f"{RANDOM_CIRCUIT}:<seed>"))
    raise FileNotFoundError(
        f"no shipped course is called {show(name, 100)}; {known}; a file of your own ends in .yaml or .csv"
    )


def _read(path: Path) -> _Content:
    ending = path.suffix.lower()
    if ending == _CSV:
        line = parse_csv(read_text(path, MAX_CSV_SIZE))
        return _Content(path, "circuit" if line.closed and line.width_left is not None else "path", line)
    if ending not in _YAML:
        raise CourseFileError(f"the ending {show(path.suffix)} is not known; use .yaml, .yml or .csv")
    document = parse_yaml(read_text(path, MAX_YAML_SIZE), as_text=True)
    if not isinstance(document, dict):
        raise CourseFileError(
            f"must be a mapping with the keys {', '.join(PATH_KEYS)} of a path, or those of a circuit"
        )
    form = document.get("format", PATH_FORMAT)
    if not isinstance(form, str) or form not in _FORMATS:
        raise CourseFileError(
            f"format is {show(form)}, this version reads {PATH_FORMAT!r} (a path) and {TRACK_FORMAT!r} (a circuit)"
        )
    return _Content(path, _FORMATS[form], document)
