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

from bike_sim.course.course import OFF_COURSE_LIMIT, SAMPLE_SPACING, Course
from bike_sim.course.csv_line import CentreLine, CourseFileError, parse_csv
from bike_sim.course.document import (
    MAX_LENGTH,
    check_keys,
    length_of,
    number_of,
    parse_yaml,
    read_text,
    show,
    text_of,
    truth_of,
    values_of,
)
from bike_sim.course.elements import Arc, Element, Line, Quintic
from bike_sim.course.spline import chord_lengths, smooth_line
from bike_sim.course.track_files import load_track, shipped_tracks

FORMAT = "bike.course/1"

KEYS = ("format", "name", "description", "closed", "off_course_limit_m", "start", "elements", "csv")
"""Keys of a course file; exactly one of ``elements`` and ``csv`` must be there."""

START_KEYS = ("x_m", "y_m", "heading_deg")


def shipped_courses() -> tuple[str, ...]:
    """Return the names of the shipped courses, sorted."""
    folder = resources.files("bike_sim") / "config" / "courses"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def load_course(name_or_path: str | Path) -> Course:
    """Load a course.

    Args:
        name_or_path: name of a shipped course, or of a shipped circuit for its centre line, or path of a ``.yaml``,
            ``.yml`` or ``.csv`` file.

    Raises:
        FileNotFoundError: no such course or file.
        CourseFileError: the file is broken; the message names the row or element and what is wrong.
    """
    path = Path(name_or_path)
    if not path.suffix:
        if str(name_or_path) in shipped_tracks():
            return load_track(name_or_path).centre
        if str(name_or_path) not in shipped_courses():
            known = ", ".join((*shipped_courses(), *shipped_tracks()))
            raise FileNotFoundError(
                f"no shipped course is called {str(name_or_path)[:100]!r} (there are {known}); "
                "a course of your own is given as the path of a .yaml or .csv file"
            )
        with resources.as_file(resources.files("bike_sim") / "config" / "courses" / f"{path}.yaml") as shipped:
            return _load_file(shipped)
    if path.suffix.lower() not in (".yaml", ".yml", ".csv"):
        raise CourseFileError(f"course file {path}: the ending {path.suffix!r} is not known; use .yaml, .yml or .csv")
    return _load_file(path)


def _load_file(path: Path) -> Course:
    try:
        text = read_text(path)
        if path.suffix.lower() == ".csv":
            return _course_from_points(path.stem, parse_csv(text), OFF_COURSE_LIMIT)
        return _course_from_yaml(parse_yaml(text, KEYS), path)
    except CourseFileError as error:
        raise CourseFileError(f"course file {path}: {error}") from None
    except FileNotFoundError:
        raise
    except ValueError as error:
        raise CourseFileError(f"course file {path}: {error}") from error


def _course_from_yaml(document: Mapping[str, Any], path: Path) -> Course:
    check_keys("", document, KEYS)
    if "format" in document and document["format"] != FORMAT:
        raise CourseFileError(f"format is {show(document['format'])}, this version reads {FORMAT!r}")
    name = text_of(document, "name", path.stem)
    closed = truth_of(document["closed"], "closed") if "closed" in document else None
    limit = OFF_COURSE_LIMIT
    if "off_course_limit_m" in document:
        limit = number_of(document["off_course_limit_m"], "off_course_limit_m")
    if ("elements" in document) == ("csv" in document):
        raise CourseFileError("must have either 'elements' or 'csv'")
    if "csv" in document:
        if "start" in document:
            raise CourseFileError(
                "'start' belongs to 'elements'; the points of a CSV file are in the map frame already"
            )
        csv_path = path.parent / text_of(document, "csv", "")
        try:
            line = parse_csv(read_text(csv_path), closed)
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
        raise CourseFileError(f"start must be a mapping with the keys {', '.join(START_KEYS)}, got {show(start)}")
    check_keys("start: ", start, START_KEYS)
    x, y, heading = (number_of(start.get(key, "0"), f"start: {key}") for key in START_KEYS)
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
        raise CourseFileError(f"{where}must be a mapping with one of {kinds}, got {show(entry)}")
    check_keys(where, entry, (*_ELEMENTS, "section"))
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
    return element, text_of(entry, "section", "", where)


def _line(value: Any, where: str) -> Line:
    return Line(length_of(value, f"{where} length in m"))


def _arc(value: Any, where: str) -> Arc:
    radius, angle = values_of(value, where, ("radius_m", "angle_deg"))
    return Arc(length_of(radius, f"{where} radius_m"), math.radians(number_of(angle, f"{where} angle_deg")))


def _quintic(value: Any, where: str) -> Quintic:
    extent, width = values_of(value, where, ("length_m", "width_m"))
    return Quintic(length_of(extent, f"{where} length_m"), length_of(width, f"{where} width_m"))


_ELEMENTS: Mapping[str, Callable[[Any, str], Element]] = {"line": _line, "arc": _arc, "quintic": _quintic}
