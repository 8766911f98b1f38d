"""Courses from files: shipped by name, or one's own as YAML (elements) or CSV (points and widths).

The YAML keys are listed in :data:`KEYS`, the CSV columns in :data:`bike_sim.course.csv_line.COLUMNS`; docs/courses.md
shows both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from bike_sim.course.course import OFF_COURSE_LIMIT, SAMPLE_SPACING, Course
from bike_sim.course.csv_line import CentreLine, CourseFileError, parse_csv
from bike_sim.course.elements import Arc, Element, Line, Quintic
from bike_sim.course.spline import chord_lengths, smooth_line

FORMAT = "bike.course/1"

KEYS = ("format", "name", "description", "closed", "off_course_limit_m", "start", "elements", "csv")
"""Keys of a course file; exactly one of ``elements`` and ``csv`` must be there."""

START_KEYS = ("x_m", "y_m", "heading_deg")

MAX_LENGTH = 100e3
"""Longest course, m. A longer one is a mistake of units, and would fill the memory with samples."""

MAX_FILE_SIZE = 50_000_000
"""Largest course file, bytes."""


def shipped_courses() -> tuple[str, ...]:
    """Return the names of the shipped courses, sorted."""
    folder = resources.files("bike_sim") / "config" / "courses"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def load_course(name_or_path: str | Path) -> Course:
    """Load a course.

    Args:
        name_or_path: name of a shipped course, or path of a ``.yaml``, ``.yml`` or ``.csv`` file.

    Raises:
        FileNotFoundError: no such course or file.
        CourseFileError: the file is broken; the message names the row or element and what is wrong.
    """
    path = Path(name_or_path)
    if not path.suffix:
        if str(name_or_path) not in shipped_courses():
            raise FileNotFoundError(
                f"no shipped course is called {str(name_or_path)[:100]!r} (there are {', '.join(shipped_courses())}); "
                "a course of your own is given as the path of a .yaml or .csv file"
            )
        with resources.as_file(resources.files("bike_sim") / "config" / "courses" / f"{path}.yaml") as shipped:
            return _load_file(shipped)
    if path.suffix.lower() not in (".yaml", ".yml", ".csv"):
        raise CourseFileError(f"course file {path}: the ending {path.suffix!r} is not known; use .yaml, .yml or .csv")
    return _load_file(path)


def _load_file(path: Path) -> Course:
    try:
        text = _read_text(path)
        if path.suffix.lower() == ".csv":
            return _course_from_points(path.stem, parse_csv(text), OFF_COURSE_LIMIT)
        return _course_from_yaml(_parse_yaml(text), path)
    except CourseFileError as error:
        raise CourseFileError(f"course file {path}: {error}") from None
    except FileNotFoundError:
        raise
    except ValueError as error:
        raise CourseFileError(f"course file {path}: {error}") from error


def _read_text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_FILE_SIZE:
            raise CourseFileError(f"is larger than {MAX_FILE_SIZE // 1_000_000} MB, which no course is")
        data = path.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no course file {path}") from None
    except OSError as error:
        raise CourseFileError(f"cannot be read: {error.strerror}") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CourseFileError(f"is not a UTF-8 text file (byte {error.start} is {data[error.start]:#04x})") from None
    if "\0" in text:
        raise CourseFileError("is a binary file")
    if not text.strip():
        raise CourseFileError("is empty")
    return text


def _parse_yaml(text: str) -> Mapping[str, Any]:
    # The base loader leaves every value a string: what a number or a truth value is, is decided here, where a mistake
    # can be named, and '1e3' is a number as everywhere else.
    try:
        document = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.MarkedYAMLError as error:
        where = f"row {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise CourseFileError(f"{where}{error.problem or error.context}") from None
    except yaml.YAMLError as error:
        raise CourseFileError(f"is not YAML: {str(error).splitlines()[0]}") from None
    except RecursionError:
        raise CourseFileError("is nested too deeply") from None
    if not isinstance(document, dict):
        raise CourseFileError(f"must be a mapping with the keys {', '.join(KEYS)}")
    return document


class _UniqueKeyLoader(yaml.BaseLoader):
    """Base loader that refuses a key given twice, of which YAML would silently drop the first."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(problem=f"key {key.value!r} is given twice", problem_mark=key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def _course_from_yaml(document: Mapping[str, Any], path: Path) -> Course:
    _check_keys("", document, KEYS)
    if "format" in document and document["format"] != FORMAT:
        raise CourseFileError(f"format is {_show(document['format'])}, this version reads {FORMAT!r}")
    name = _text(document, "name", path.stem)
    closed = _truth(document["closed"], "closed") if "closed" in document else None
    limit = OFF_COURSE_LIMIT
    if "off_course_limit_m" in document:
        limit = _number(document["off_course_limit_m"], "off_course_limit_m")
    if ("elements" in document) == ("csv" in document):
        raise CourseFileError("must have either 'elements' or 'csv'")
    if "csv" in document:
        if "start" in document:
            raise CourseFileError(
                "'start' belongs to 'elements'; the points of a CSV file are in the map frame already"
            )
        csv_path = path.parent / _text(document, "csv", "")
        try:
            line = parse_csv(_read_text(csv_path), closed)
        except CourseFileError as error:
            raise CourseFileError(f"its CSV file {csv_path} {error}") from None
        return _course_from_points(name, line, limit)
    elements, sections = _parse_elements(document["elements"])
    return Course.from_elements(
        name,
        elements,
        start=_parse_start(document.get("start", {})),
        closed=bool(closed),
        off_course_limit=limit,
        section_names=sections,
    )


def _course_from_points(name: str, line: CentreLine, off_course_limit: float) -> Course:
    chord = chord_lengths(line.points)
    if chord[-1] > MAX_LENGTH:
        raise CourseFileError(
            f"is {chord[-1] / 1e3:.6g} km long, at most {MAX_LENGTH / 1e3:g} km are possible; metres?"
        )
    smooth = smooth_line(line.points, line.closed, SAMPLE_SPACING)
    # Between points the widths are linear: a spline could overshoot to a width below zero.
    widths = [None if w is None else np.interp(smooth.chord, chord, w) for w in (line.width_left, line.width_right)]
    return Course(
        name,
        smooth.s,
        smooth.x,
        smooth.y,
        smooth.heading,
        smooth.curvature,
        line.closed,
        off_course_limit,
        width_left=widths[0],
        width_right=widths[1],
    )


def _parse_start(start: Any) -> tuple[float, float, float]:
    if not isinstance(start, dict):
        raise CourseFileError(f"start must be a mapping with the keys {', '.join(START_KEYS)}, got {_show(start)}")
    _check_keys("start: ", start, START_KEYS)
    x, y, heading = (_number(start.get(key, "0"), f"start: {key}") for key in START_KEYS)
    return x, y, math.radians(heading)


def _parse_elements(entries: Any) -> tuple[list[Element], list[str] | None]:
    """Return the elements, and one section name an element or None if no element names one.

    An element without a name belongs to the section of the one before it.
    """
    if not isinstance(entries, list) or not entries:
        raise CourseFileError("elements must be a list with at least one element")
    elements: list[Element] = []
    sections: list[str] = []
    total = 0.0
    for number, entry in enumerate(entries, start=1):
        where = f"element {number}: "
        element, section = _parse_element(entry, where)
        elements.append(element)
        sections.append(section or (sections[-1] if sections else "start"))
        total += element.length
        if total > MAX_LENGTH:
            raise CourseFileError(f"{where}the course grows longer than {MAX_LENGTH / 1e3:g} km; metres and degrees?")
    named = any("section" in entry for entry in entries)
    return elements, sections if named else None


def _parse_element(entry: Any, where: str) -> tuple[Element, str]:
    kinds = ", ".join(_ELEMENTS)
    if not isinstance(entry, dict):
        raise CourseFileError(f"{where}must be a mapping with one of {kinds}, got {_show(entry)}")
    _check_keys(where, entry, (*_ELEMENTS, "section"))
    found = [kind for kind in _ELEMENTS if kind in entry]
    if len(found) != 1:
        raise CourseFileError(f"{where}must have exactly one of {kinds}, has {' and '.join(found) or 'none'}")
    kind = found[0]
    try:
        element = _ELEMENTS[kind](entry[kind], f"{where}{kind}")
    except CourseFileError:
        raise
    except ValueError as error:
        raise CourseFileError(f"{where}{error}") from None
    return element, _text(entry, "section", "", where)


def _line(value: Any, where: str) -> Line:
    return Line(_length(value, f"{where} length in m"))


def _arc(value: Any, where: str) -> Arc:
    radius, angle = _values(value, where, ("radius_m", "angle_deg"))
    return Arc(_length(radius, f"{where} radius_m"), math.radians(_number(angle, f"{where} angle_deg")))


def _quintic(value: Any, where: str) -> Quintic:
    extent, width = _values(value, where, ("length_m", "width_m"))
    return Quintic(_length(extent, f"{where} length_m"), _length(width, f"{where} width_m"))


_ELEMENTS: Mapping[str, Callable[[Any, str], Element]] = {"line": _line, "arc": _arc, "quintic": _quintic}


def _values(value: Any, where: str, keys: tuple[str, ...]) -> list[Any]:
    if not isinstance(value, dict):
        raise CourseFileError(f"{where} must be a mapping with {' and '.join(keys)}, got {_show(value)}")
    _check_keys(f"{where}: ", value, keys)
    for key in keys:
        if key not in value:
            raise CourseFileError(f"{where}: {key} is missing")
    return [value[key] for key in keys]


def _check_keys(where: str, found: Mapping[Any, Any], known: tuple[str, ...]) -> None:
    for key in found:
        if key not in known:
            raise CourseFileError(f"{where}unknown key {_show(key)}; known are {', '.join(known)}")


def _text(found: Mapping[str, Any], key: str, default: str, where: str = "") -> str:
    value = found.get(key, default)
    if not isinstance(value, str) or (key in found and not value.strip()):
        raise CourseFileError(f"{where}{key} must be text, got {_show(value)}")
    return value


def _truth(value: Any, name: str) -> bool:
    if value not in ("true", "false"):
        raise CourseFileError(f"{name} must be true or false, got {_show(value)}")
    return bool(value == "true")


def _number(value: Any, name: str) -> float:
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        raise CourseFileError(f"{name} is {_show(value)}, a number is needed") from None
    if not math.isfinite(number):
        raise CourseFileError(f"{name} is {_show(value)}, a finite number is needed")
    return number


def _length(value: Any, name: str) -> float:
    number = _number(value, name)
    if abs(number) > MAX_LENGTH:
        raise CourseFileError(f"{name} is {_show(value)}, more than {MAX_LENGTH:g} m; metres?")
    return number


def _show(value: Any) -> str:
    """Return a short text of a value from a file; lists and mappings may be huge, so they are only named."""
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else value[:57] + "...")
    return "a list" if isinstance(value, list) else "a mapping"
