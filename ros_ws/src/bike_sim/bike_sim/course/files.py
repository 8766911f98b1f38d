"""Loading of courses: shipped ones by name, random circuits by seed, and the user's files by path.

A course is a path (a line to follow) or a circuit (a closed line with limits, walls and corners). Both are found, read
and refused by the same code; what a file says is turned into one of them by :mod:`bike_sim.course.reading`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Literal, TypeVar

from bike_sim.course.course import Course
from bike_sim.course.csv_line import MAX_CSV_SIZE, CentreLine, CourseFileError, parse_csv
from bike_sim.course.random_courses import RANDOM_CIRCUIT, random_circuit, seed_of
from bike_sim.course.reading import (
    PATH_FORMAT,
    PATH_KEYS,
    TRACK_FORMAT,
    number_of,
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

_Built = TypeVar("_Built")

_FORMATS: Mapping[str, Kind] = {PATH_FORMAT: "path", TRACK_FORMAT: "circuit"}
_FOLDERS: Mapping[Kind, str] = {"path": "courses", "circuit": "tracks"}
_YAML, _CSV = (".yaml", ".yml"), ".csv"


@dataclass(frozen=True)
class _Content:
    """The content of a course's file, before the course is built.

    Attributes:
        path: the file.
        kind: path or circuit.
        said: a YAML document, or the points of a CSV file.
    """

    path: Path
    kind: Kind
    said: Mapping[str, Any] | CentreLine


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
    return _read(name_or_path, lambda content: content.kind)


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
    return random_circuit(seed).centre if seed is not None else _read(name_or_path, _course_of)


def load_track(name_or_path: str | Path) -> Track:
    """Load a circuit, without its ideal line.

    Args:
        name_or_path: name of a shipped circuit, ``random_circuit:<seed>``, or path of a ``.yaml``, ``.yml`` or ``.csv``
            file.

    Raises:
        FileNotFoundError: no such circuit or file.
        CourseFileError: the file is broken, or is a path; the message names the row or element and the fault.
    """
    seed = seed_of(name_or_path)
    return random_circuit(seed) if seed is not None else _read(name_or_path, _track_of)


def track_records(name: str) -> dict[str, float]:
    """Return the published lap records of a circuit, s, by name; empty if its file has none.

    Raises:
        FileNotFoundError: no such circuit.
        CourseFileError: a record is no number.
    """

    def records(content: _Content) -> dict[str, float]:
        said = content.said if isinstance(content.said, Mapping) else {}
        entries = said.get("records_s", {})
        if not isinstance(entries, dict):
            raise CourseFileError(f"records_s must be a mapping of names and times in s, got {show(entries)}")
        return {str(key): number_of(value, f"records_s: {show(key)}") for key, value in entries.items()}

    return {} if seed_of(name) is not None else _read(name, records)


def _course_of(content: _Content) -> Course:
    if isinstance(content.said, CentreLine):
        return path_from_points(_stem(content.path), content.said)
    if content.kind == "circuit":
        return track_from_document(content.said, content.path).centre
    return path_from_document(content.said, content.path)


def _track_of(content: _Content) -> Track:
    if isinstance(content.said, CentreLine):
        return track_from_points(_stem(content.path), content.said)
    if content.kind == "path":
        raise CourseFileError(
            f"is a path; a circuit has the format {TRACK_FORMAT!r} or is the CSV file of a closed line with widths"
        )
    return track_from_document(content.said, content.path)


def _stem(path: Path) -> str:
    """Return the name of a course that is called after its file."""
    return check_name(path.stem, "the file's name, which the course takes,")


def _shipped(kind: Kind) -> tuple[str, ...]:
    folder = resources.files("bike_sim") / "config" / _FOLDERS[kind]
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def _read(name_or_path: str | Path, use: Callable[[_Content], _Built]) -> _Built:
    """Find, read and build a course; every error names the file."""
    path = Path(name_or_path)
    if path.suffix:
        return _use(path, use)
    with resources.as_file(_shipped_file(str(name_or_path))) as shipped:
        return _use(shipped, use)


def _shipped_file(name: str) -> Traversable:
    for kind, folder in _FOLDERS.items():
        if name in _shipped(kind):
            return resources.files("bike_sim") / "config" / folder / f"{name}.yaml"
    known = alternatives(name, (*shipped_courses(), *shipped_tracks(), f"{RANDOM_CIRCUIT}:<seed>"))
    raise FileNotFoundError(
        f"no shipped course is called {show(name, 100)}; {known}; a file of your own ends in .yaml or .csv"
    )


def _use(path: Path, use: Callable[[_Content], _Built]) -> _Built:
    shown = shorten(str(path))
    try:
        return use(_content_of(path))
    except FileNotFoundError as error:
        # A file that the course's file names has been named already; an error of the system has a number.
        raise (error if error.errno is None else FileNotFoundError(f"there is no course file {shown}")) from None
    except ValueError as error:
        cause = None if isinstance(error, DocumentError) else error
        raise CourseFileError(f"course file {shown}: {error}") from cause


def _content_of(path: Path) -> _Content:
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
