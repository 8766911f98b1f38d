"""Paths from files: a YAML document of elements, or the points and widths of a CSV file.

The YAML keys are listed in :data:`KEYS`, the CSV columns in :data:`bike_sim.course.csv_line.COLUMNS`; docs/courses.md
shows both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bike_sim.course.course import OFF_COURSE_LIMIT, SAMPLE_SPACING, Course
from bike_sim.course.csv_line import MAX_CSV_SIZE, CentreLine, CourseFileError, parse_csv
from bike_sim.course.document import (
    MAX_LENGTH,
    check_keys,
    description_of,
    length_of,
    name_of,
    number_of,
    start_of,
    truth_of,
    values_of,
)
from bike_sim.course.elements import Arc, Element, Line, Quintic
from bike_sim.course.spline import chord_lengths, smooth_line
from bike_sim.documents import DocumentError, read_text, shorten, show

FORMAT = "bike.course/1"

KEYS = ("format", "name", "description", "closed", "off_course_limit_m", "start", "elements", "csv")
"""Keys of a path's file; exactly one of ``elements`` and ``csv`` must be there."""


def path_from_document(document: Mapping[str, Any], path: Path) -> Course:
    """Make a path of a YAML document whose values are all strings.

    Args:
        document: content of the file.
        path: the file; a CSV file that it names is searched in its folder.

    Raises:
        FileNotFoundError: the CSV file does not exist. ValueError: naming the key or element and the fault.
    """
    check_keys("", document, KEYS)
    name = name_of(document, "name", path.stem)
    description_of(document, "")
    closed = truth_of(document["closed"], "closed") if "closed" in document else None
    limit = OFF_COURSE_LIMIT
    if "off_course_limit_m" in document:
        limit = length_of(document["off_course_limit_m"], "off_course_limit_m")
    if ("elements" in document) == ("csv" in document):
        raise CourseFileError("must have either 'elements' or 'csv'")
    if "csv" in document:
        if "start" in document:
            raise CourseFileError(
                "'start' belongs to 'elements'; the points of a CSV file are in the map frame already"
            )
        return path_from_points(name, _line_beside(path, document["csv"], closed), limit)
    elements, sections = _parse_elements(document["elements"])
    return Course.from_elements(
        name,
        elements,
        start=start_of(document.get("start", {})),
        closed=bool(closed),
        off_course_limit=limit,
        section_names=sections,
    )


def _line_beside(path: Path, csv: Any, closed: bool | None) -> CentreLine:
    """Read the CSV file that a YAML file names."""
    if not isinstance(csv, str) or not csv.strip():
        raise CourseFileError(f"csv must be the name of a file beside this one, got {show(csv)}")
    csv_path = path.parent / csv
    shown = shorten(str(csv_path))
    try:
        return parse_csv(read_text(csv_path, MAX_CSV_SIZE), closed)
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no course file {shown}, which {shorten(str(path))} names") from None
    except DocumentError as error:
        raise CourseFileError(f"its CSV file {shown} {error}") from None


def path_from_points(name: str, line: CentreLine, off_course_limit: float = OFF_COURSE_LIMIT) -> Course:
    """Make a path of points: a spline through them as they are, widths linear between them.

    Raises:
        CourseFileError: longer than any course.
    """
    chord = chord_lengths(line.points)
    if chord[-1] > MAX_LENGTH:
        raise CourseFileError(
            f"is {chord[-1] / 1e3:.6g} km long, at most {MAX_LENGTH / 1e3:g} km are possible; metres?"
        )
    smooth = smooth_line(line.points, line.closed, SAMPLE_SPACING)
    # Between points the widths are linear: a spline could overshoot to a width below zero.
    widths = [None if w is None else np.interp(smooth.chord, chord, w) for w in (line.width_left, line.width_right)]
    return Course.from_line(
        name,
        smooth,
        closed=line.closed,
        off_course_limit=off_course_limit,
        width_left=widths[0],
        width_right=widths[1],
    )


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
    except DocumentError:
        raise
    except ValueError as error:
        raise CourseFileError(f"{where}{error}") from None
    return element, name_of(entry, "section", "", where)


def _line(value: Any, where: str) -> Line:
    return Line(length_of(value, f"{where} length in m"))


def _arc(value: Any, where: str) -> Arc:
    radius, angle = values_of(value, where, ("radius_m", "angle_deg"))
    return Arc(length_of(radius, f"{where} radius_m"), math.radians(number_of(angle, f"{where} angle_deg")))


def _quintic(value: Any, where: str) -> Quintic:
    extent, width = values_of(value, where, ("length_m", "width_m"))
    return Quintic(length_of(extent, f"{where} length_m"), length_of(width, f"{where} width_m"))


_ELEMENTS: Mapping[str, Callable[[Any, str], Element]] = {"line": _line, "arc": _arc, "quintic": _quintic}
