"""Paths and circuits out of YAML documents and of the points of CSV files, with one clear error for each invalid value.

A path is a list of elements or a CSV file, a circuit a table of straights and arcs or a CSV file with widths. The keys
are :data:`PATH_KEYS` and :data:`TRACK_KEYS`, the CSV columns :data:`bike_sim.course.csv_line.COLUMNS`;
docs/reference/courses.md and docs/reference/circuits.md show them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import MAX_LENGTH, OFF_COURSE_LIMIT, SAMPLE_SPACING, Course
from bike_sim.course.csv_line import MAX_COORDINATE, MAX_CSV_SIZE, CentreLine, CourseFileError, parse_csv
from bike_sim.course.elements import Arc, Element, Line, Quintic
from bike_sim.course.layout import Piece, close_layout, curvature_profile, trace_layout
from bike_sim.course.road import (
    CLASSES,
    SIDES,
    RoadSurface,
    RunOff,
    RunOffKind,
    RunOffPart,
    Walls,
    WetPatch,
    Wind,
    check_limits,
    wall_distances,
)
from bike_sim.course.spline import TOLERANCE, WIDTH_SHARE, chord_lengths, smooth_closed, smooth_line
from bike_sim.course.track import Corner, Track, find_corners
from bike_sim.documents import DocumentError, check_name, check_text, read_text, shorten, show

FloatArray = NDArray[np.float64]

START_KEYS = ("x_m", "y_m", "heading_deg")
"""Keys of the position and heading at which a course begins."""


def values_of(value: Any, where: str, keys: tuple[str, ...]) -> list[Any]:
    """Return the values of a mapping that has exactly these keys."""
    if not isinstance(value, dict):
        raise CourseFileError(f"{where} must be a mapping with {' and '.join(keys)}, got {show(value)}")
    check_keys(f"{where}: ", value, keys)
    for key in keys:
        if key not in value:
            raise CourseFileError(f"{where}: {key} is missing")
    return [value[key] for key in keys]


def check_keys(where: str, found: Mapping[Any, Any], known: tuple[str, ...]) -> None:
    """Refuse keys that are not known."""
    for key in found:
        if key not in known:
            raise CourseFileError(f"{where}unknown key {show(key)}; known are {', '.join(known)}")


def name_of(found: Mapping[str, Any], key: str, default: str, where: str = "") -> str:
    """Return the name under a key, or the default where the key is not there.

    Raises:
        DocumentError: it is not a valid name, nor is the default, the file's name.
    """
    if key not in found:
        return default and check_name(default, f"{where}the file's name, which the course takes without '{key}',")
    return check_name(found[key], f"{where}{key}")


def description_of(found: Mapping[str, Any], default: str) -> str:
    """Return the description, or the default if there is none."""
    return check_text(found["description"], "description") if "description" in found else default


def truth_of(value: Any, name: str) -> bool:
    """Return a truth value, written true or false."""
    if value not in ("true", "false"):
        raise CourseFileError(f"{name} must be true or false, got {show(value)}")
    return bool(value == "true")


def number_of(value: Any, name: str) -> float:
    """Return a finite number."""
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        raise CourseFileError(f"{name} is {show(value)}, a number is needed") from None
    if not math.isfinite(number):
        raise CourseFileError(f"{name} is {show(value)}, a finite number is needed")
    return number


def length_of(value: Any, name: str) -> float:
    """Return a finite number that can be a length of a course, m."""
    number = number_of(value, name)
    if abs(number) > MAX_LENGTH:
        raise CourseFileError(f"{name} is {show(value)}, more than {MAX_LENGTH:g} m; metres?")
    return number


def start_of(start: Any) -> tuple[float, float, float]:
    """Return x, y, heading of a beginning (m, m, rad)."""
    if not isinstance(start, dict):
        raise CourseFileError(f"start must be a mapping with the keys {', '.join(START_KEYS)}, got {show(start)}")
    check_keys("start: ", start, START_KEYS)
    x, y, heading = (number_of(start.get(key, "0"), f"start: {key}") for key in START_KEYS)
    for key, value in zip(START_KEYS, (x, y, heading), strict=True):
        if abs(value) > MAX_COORDINATE:
            raise CourseFileError(f"start: {key} is {value:g}, beyond {MAX_COORDINATE:g}; metres and degrees?")
    return x, y, math.radians(heading)


PATH_FORMAT = "bike.course/1"

PATH_KEYS = ("format", "name", "description", "closed", "off_course_limit_m", "start", "elements", "csv")
"""Keys of a path's file; exactly one of ``elements`` and ``csv`` must be there."""


def path_from_document(document: Mapping[str, Any], path: Path) -> Course:
    """Make a path of a YAML document whose values are all strings.

    Args:
        document: content of the file.
        path: the file; a CSV file that it names is searched in its folder.

    Raises:
        FileNotFoundError: the CSV file does not exist.
        ValueError: naming the key or element and the fault.
    """
    check_keys("", document, PATH_KEYS)
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


Made = TypeVar("Made")

SURFACE_KEYS: Final = ("banking_deg", "bumps", "wet", "wind", "run_off_kinds", "walls")
"""Keys of a circuit file that describe its surface; none must be there."""

MAX_PARTS: Final = 200
MAX_SEED: Final = 2**62


def surface_of(document: Mapping[str, Any], s: FloatArray) -> RoadSurface:
    """Return the surface that a document describes.

    Args:
        document: content of the file; values are strings.
        s: arc length of the centre line's samples, m.

    Raises:
        ValueError: naming the key and the fault.
    """
    density, seed = _bumps_of(document.get("bumps"))
    return RoadSurface(
        _bank(document.get("banking_deg"), s),
        density,
        seed,
        tuple(_parts(document.get("wet"), "wet", s, ("grip",), _wet)),
        tuple(_parts(document.get("run_off_kinds"), "run_off_kinds", s, ("side", "kind"), _run_off_part)),
        _wind(document.get("wind")),
        _walls(document.get("walls")),
    )


def _refused(where: str, make: Callable[[], Made]) -> Made:
    """Return what is made, or refuse its values with the key in front."""
    try:
        return make()
    except DocumentError:
        raise
    except ValueError as error:
        raise CourseFileError(f"{where}: {error}") from None


def _heights(entries: Any, key: str, least: int, s: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return distances (m, growing) and the values at them out of a list of pairs, or None where there is no list.

    Args:
        entries: content of the document, or None.
        key: its key.
        least: fewest pairs.
        s: arc length of the centre line's samples, m.
    """
    if entries is None:
        return None
    if not isinstance(entries, list) or len(entries) < least:
        raise CourseFileError(f"{key} must be a list of at least {least} pairs of distance and value")
    pairs = []
    for number, entry in enumerate(entries, start=1):
        where = f"{key}: entry {number}"
        if not isinstance(entry, list) or len(entry) != 2:
            raise CourseFileError(f"{where} must be a pair of distance and value")
        pairs.append([length_of(value, where) for value in entry])
    at, values = np.array(pairs).T
    if np.any(np.diff(at) <= 0.0) or at[0] < 0.0 or at[-1] >= s[-1]:
        raise CourseFileError(f"{key}: distances must grow from 0 and stay below the length of {s[-1]:.0f} m")
    return at, values


def _bank(entries: Any, s: FloatArray) -> FloatArray | None:
    """Lay a closed curve without overshoot through pairs of distance and angle."""
    pairs = _heights(entries, "banking_deg", 2, s)
    if pairs is None:
        return None
    from scipy.interpolate import PchipInterpolator  # late: a start that needs none is spared it

    at, angle = pairs
    for number in np.flatnonzero(np.abs(angle) > 45.0)[:1]:
        raise CourseFileError(
            f"banking_deg: entry {number + 1}: the angle is {angle[number]:g} deg; at most 45 are possible"
        )
    slope = np.array([math.tan(math.radians(each)) for each in angle])
    # a lap before and one behind, so that the curve closes
    around = np.concatenate([at - s[-1], at, at + s[-1]])
    return np.asarray(PchipInterpolator(around, np.tile(slope, 3))(s))


def _bumps_of(value: Any) -> tuple[float, int]:
    if value is None:
        return 0.0, 0
    if not isinstance(value, dict) or ("class" in value) == ("density_m3" in value):
        raise CourseFileError(f"bumps must be a mapping with seed and either class or density_m3, got {show(value)}")
    key = "class" if "class" in value else "density_m3"
    chosen, seed = values_of(value, "bumps", (key, "seed"))
    if key == "density_m3":
        density = number_of(chosen, "bumps: density_m3")
        if not 0.0 <= density <= 1.0:
            raise CourseFileError(f"bumps: density_m3 is {density:g}; m3, as 16e-6 of class A?")
        return density, _seed(seed, "bumps: seed")
    if not isinstance(chosen, str) or chosen not in CLASSES:
        raise CourseFileError(f"bumps: class must be one of {', '.join(CLASSES)}, got {show(chosen)}")
    return CLASSES[chosen], _seed(seed, "bumps: seed")


def _seed(value: Any, where: str) -> int:
    if not isinstance(value, str) or not value.isdecimal() or int(value) > MAX_SEED:
        raise CourseFileError(f"{where} must be a whole number from 0 to {MAX_SEED}, got {show(value)}")
    return int(value)


def _parts(entries: Any, key: str, s: FloatArray, others: tuple[str, ...], make: Callable[..., Made]) -> list[Made]:
    """Return the parts of the lap in a list of mappings with from_m, to_m and other keys."""
    if entries is None:
        return []
    if not isinstance(entries, list) or len(entries) > MAX_PARTS:
        raise CourseFileError(f"{key} must be a list of at most {MAX_PARTS} parts")
    made = []
    for number, entry in enumerate(entries, start=1):
        where = f"{key}: part {number}"
        begin, end, *values = values_of(entry, where, ("from_m", "to_m", *others))
        places = [length_of(begin, f"{where}: from_m"), length_of(end, f"{where}: to_m")]
        if not all(0.0 <= place <= s[-1] for place in places):
            raise CourseFileError(f"{where}: from_m and to_m must be 0 to the length of {s[-1]:.0f} m")
        made.append(_refused(where, partial(make, *places, *values, where)))
    return made


def _wet(begin: float, end: float, grip: Any, where: str) -> WetPatch:
    return WetPatch(begin, end, number_of(grip, f"{where}: grip"))


def _run_off_part(begin: float, end: float, side: Any, kind: Any, where: str) -> RunOffPart:
    kinds = {item.name.lower(): item for item in RunOffKind}
    if not isinstance(kind, str) or kind not in kinds:
        raise CourseFileError(f"{where}: kind must be one of {', '.join(kinds)}, got {show(kind)}")
    if not isinstance(side, str) or side not in SIDES:
        raise CourseFileError(f"{where}: side must be one of {', '.join(SIDES)}, got {show(side)}")
    return RunOffPart(begin, end, side, kinds[kind])


def _wind(value: Any) -> Wind:
    if value is None:
        return Wind()
    keys = ("speed_m_s", "towards_deg", "gusts", "seed")
    speed, towards, gusts, seed = values_of(value, "wind", keys)
    numbers = [number_of(v, f"wind: {k}") for k, v in zip(keys[:3], (speed, towards, gusts), strict=True)]
    return _refused("wind", lambda: Wind(numbers[0], math.radians(numbers[1]), numbers[2], _seed(seed, "wind: seed")))


def _walls(value: Any) -> Walls:
    if value is None:
        return Walls()
    if not isinstance(value, dict):
        raise CourseFileError(f"walls must be a mapping, got {show(value)}")
    keys = {"friction": "friction", "restitution": "restitution", "hit_m_s": "hit"}
    check_keys("walls: ", value, tuple(keys))
    numbers = {keys[key]: number_of(number, f"walls: {key}") for key, number in value.items()}
    return _refused("walls", lambda: Walls(**numbers))


TRACK_FORMAT = "bike.track/1"

TRACK_KEYS = (
    "format",
    "name",
    "description",
    "length_m",
    "start",
    "transition_m",
    "width_m",
    "elements",
    "sectors_after",
    "elevation_m",
    "run_off_m",
    *SURFACE_KEYS,
    "records_s",
    "sources",
)
"""Keys of a circuit file; ``format``, ``length_m``, ``width_m`` and ``elements`` must be there."""

RUN_OFF_KEYS = ("straight", "inside", "outside")

TRANSITION = 40.0
"""Length of curvature ramps where a file does not say, m (own estimate from public outlines)."""

MAX_PIECES = 300
"""Most straights and arcs of a table: what closes them takes a time that grows with their square."""

LEAST_TRACK_POINTS = 8
"""A circuit given by fewer points is no circuit."""

LEAST_WIDTH = 0.5
"""Road narrower than this is a mistake, m."""

SECTORS = 3
"""Sectors of a circuit whose file names none: equal parts."""


def track_from_points(name: str, line: CentreLine) -> Track:
    """Make a circuit of measured points: smoothed, its limits checked, its corners found, flat.

    Raises:
        ValueError: not closed, without widths, too few points, or limits that cross.
    """
    if not line.closed:
        gap = math.dist(line.points[0], line.points[-1])
        raise CourseFileError(
            f"is not closed: its ends at rows {line.rows[0]} and {line.rows[-1]} are {gap:.4g} m apart, farther than "
            "neighbours are; is a part of the lap missing?"
        )
    if line.width_left is None or line.width_right is None:
        raise CourseFileError("has no widths; a circuit needs the columns w_tr_right_m and w_tr_left_m")
    if len(line.points) - 1 < LEAST_TRACK_POINTS:
        raise CourseFileError(f"has {len(line.points) - 1} points, a circuit needs at least {LEAST_TRACK_POINTS}")
    width = line.width_left + line.width_right
    least = float(np.min(width))
    if least < LEAST_WIDTH:
        raise CourseFileError(
            f"is {least:.2f} m wide at row {line.rows[int(np.argmin(width))]}; a road is at least {LEAST_WIDTH} m wide"
        )
    given = chord_lengths(line.points)
    if given[-1] > MAX_LENGTH:
        raise CourseFileError(
            f"is {given[-1] / 1e3:.6g} km long, at most {MAX_LENGTH / 1e3:g} km are possible; metres?"
        )
    points, there, moved = smooth_closed(line.points, min(TOLERANCE, WIDTH_SHARE * least))
    smooth = smooth_line(points, True, SAMPLE_SPACING)
    # Distances to the limits, which do not move with the line.
    source = np.interp(smooth.chord, chord_lengths(points), there)
    aside = np.interp(source, there, moved)
    centre = Course.from_line(
        name,
        smooth,
        closed=True,
        width_left=np.maximum(np.interp(source, given, line.width_left) - aside, 0.0),
        width_right=np.maximum(np.interp(source, given, line.width_right) + aside, 0.0),
        sections=tuple((f"sector {i + 1}", i * float(smooth.s[-1]) / SECTORS) for i in range(SECTORS)),
    )
    check_limits(centre)
    run_off_left, run_off_right = wall_distances(centre, RunOff())
    return Track(
        centre, np.zeros(len(centre.s)), run_off_left, run_off_right, find_corners(centre), None, "from measured points"
    )


def track_from_document(document: Mapping[str, Any], path: Path) -> Track:
    """Make a circuit of a YAML document whose values are all strings.

    Args:
        document: content of the file.
        path: the file, after which a circuit without a name is called.

    Raises:
        ValueError: naming the key or element and the fault.
    """
    check_keys("", document, TRACK_KEYS)
    for key in ("length_m", "width_m", "elements"):
        if key not in document:
            raise CourseFileError(f"{key} is missing")
    name = name_of(document, "name", path.stem)
    length = length_of(document["length_m"], "length_m")
    transition = length_of(document.get("transition_m", str(TRANSITION)), "transition_m")
    width = length_of(document["width_m"], "width_m")
    if width < LEAST_WIDTH:
        raise CourseFileError(f"width_m is {width}, a road is at least {LEAST_WIDTH} m wide")
    pieces = close_layout(_pieces(document["elements"]), length, transition)
    profile = curvature_profile(pieces, transition)
    s, x, y, heading, curvature = trace_layout(profile, SAMPLE_SPACING, start_of(document.get("start", {})))
    corners = _corners(pieces, profile.begins)
    centre = Course(
        name,
        s,
        x,
        y,
        heading,
        curvature,
        closed=True,
        off_course_limit=0.5 * width,
        width_left=np.full(len(s), 0.5 * width),
        width_right=np.full(len(s), 0.5 * width),
        sections=_sectors(document.get("sectors_after"), corners, float(s[-1])),
    )
    check_limits(centre)
    run_off_left, run_off_right = wall_distances(centre, _run_off_widths(document.get("run_off_m")))
    elevation = _elevation(document.get("elevation_m"), s)
    surface = surface_of(document, s)
    return Track(centre, elevation, run_off_left, run_off_right, corners, None, description_of(document, name), surface)


def _pieces(entries: Any) -> list[Piece]:
    if not isinstance(entries, list) or not entries:
        raise CourseFileError("elements must be a list with at least one element")
    if len(entries) > MAX_PIECES:
        raise CourseFileError(
            f"elements has {len(entries)} entries, at most {MAX_PIECES} are possible; give points as CSV"
        )
    pieces = []
    for number, entry in enumerate(entries, start=1):
        where = f"element {number}: "
        if not isinstance(entry, dict) or ("straight_m" in entry) == ("arc" in entry):
            raise CourseFileError(f"{where}must have either straight_m or arc")
        check_keys(where, entry, ("straight_m", "arc", "corner"))
        try:
            if "straight_m" in entry:
                pieces.append(Piece(length_of(entry["straight_m"], f"{where}straight_m")))
                continue
            length, angle = values_of(entry["arc"], f"{where}arc", ("length_m", "angle_deg"))
            turned = math.radians(number_of(angle, f"{where}angle_deg"))
            if turned == 0.0:
                raise CourseFileError(f"{where}angle_deg of an arc must not be 0")
            pieces.append(Piece(length_of(length, f"{where}length_m"), turned, name_of(entry, "corner", "", where)))
        except DocumentError:
            raise
        except ValueError as error:
            raise CourseFileError(f"{where}{error}") from None
    return pieces


def _corners(pieces: tuple[Piece, ...], begins: FloatArray) -> tuple[Corner, ...]:
    """Return one corner for each run of neighbouring pieces with the same corner name."""
    corners: list[Corner] = []
    for name, run in itertools.groupby(zip(pieces, begins, strict=True), key=lambda item: item[0].corner):
        members = [(piece, float(begin)) for piece, begin in run]
        if not name:
            continue
        if any(corner.name == name for corner in corners):
            raise CourseFileError(f"corner {name!r} has pieces in two places")
        # Of the table, not of the samples: a ramp to a sharper neighbour lies half within this corner.
        sharpest, begin = max(members, key=lambda member: abs(member[0].curvature))
        end = members[-1][1] + members[-1][0].length
        angle = sum(piece.angle for piece, _ in members)
        apex = begin + 0.5 * sharpest.length
        corners.append(Corner(name, members[0][1], apex, end, angle, 1.0 / abs(sharpest.curvature)))
    return tuple(corners)


def _sectors(after: Any, corners: tuple[Corner, ...], length: float) -> tuple[tuple[str, float], ...]:
    if after is None:
        return tuple((f"sector {i + 1}", i * length / SECTORS) for i in range(SECTORS))
    ends = {corner.name: corner.end for corner in corners}
    if not isinstance(after, list) or any(not isinstance(name, str) or name not in ends for name in after):
        raise CourseFileError(
            f"sectors_after must be a list of corner names among {', '.join(ends)}, got {show(after)}"
        )
    begins = [0.0, *(ends[name] for name in after)]
    if any(b <= a for a, b in itertools.pairwise(begins)) or begins[-1] >= length:
        raise CourseFileError("sectors_after must name corners in the order of riding")
    return tuple((f"sector {i + 1}", begin) for i, begin in enumerate(begins))


def _run_off_widths(value: Any) -> RunOff:
    if value is None:
        return RunOff()
    straight, inside, outside = values_of(value, "run_off_m", RUN_OFF_KEYS)
    return RunOff(
        *(length_of(v, f"run_off_m: {k}") for v, k in zip((straight, inside, outside), RUN_OFF_KEYS, strict=True))
    )


def _elevation(entries: Any, s: FloatArray) -> FloatArray:
    """Lay a periodic cubic spline through heights."""
    pairs = _heights(entries, "elevation_m", 3, s)
    if pairs is None:
        return np.zeros(len(s))
    from scipy.interpolate import CubicSpline  # late: a start that needs none is spared it

    at, height = pairs
    closed = CubicSpline(np.append(at, at[0] + s[-1]), np.append(height, height[0]), bc_type="periodic")
    return np.asarray(closed(s))
