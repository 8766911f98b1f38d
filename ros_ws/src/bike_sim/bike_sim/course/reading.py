"""Paths and circuits out of YAML documents and of the points of CSV files, with one clear error for each invalid value.

A path is a list of elements or a CSV file, a circuit a table of straights and arcs or a CSV file with widths. The keys
are :data:`PATH_KEYS` and :data:`TRACK_KEYS`, the CSV columns :data:`bike_sim.course.csv_line.COLUMNS`;
docs/reference/courses.md and docs/reference/circuits.md show them. Values of a document are strings. Functions that
read one take it and the place where it stands, for the message.
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
from bike_sim.course.track import Corner, Track, corners_of, equal_sectors, find_corners
from bike_sim.documents import DocumentError, check_name, check_text, read_text, shorten, show

FloatArray = NDArray[np.float64]
Made = TypeVar("Made")
Reader = Callable[[Any, str], Any]
Forms = Mapping[str, Reader]

MAX_PARTS: Final = 200
MAX_SEED: Final = 2**62


def check_keys(where: str, found: Mapping[Any, Any], known: tuple[str, ...]) -> None:
    """Refuse keys that are not known."""
    for key in found:
        if key not in known:
            raise CourseFileError(f"{where}unknown key {show(key)}; known are {', '.join(known)}")


def record(
    value: Any, where: str, make: Callable[..., Made], forms: Forms, defaults: Mapping[str, Any] | None = None
) -> Made:
    """Return what is made of the values of a mapping, in the order of its keys.

    Args:
        value: the mapping.
        where: it stands.
        make: of the values, as arguments.
        forms: reader of each key's value.
        defaults: values of keys that may be left out.
    """
    defaults = defaults or {}
    if not isinstance(value, dict):
        raise CourseFileError(f"{where} must be a mapping with {' and '.join(forms)}, got {show(value)}")
    check_keys(f"{where}: ", value, tuple(forms))
    for key in forms:
        if key not in value and key not in defaults:
            raise CourseFileError(f"{where}: {key} is missing")
    read = {key: form(value[key], f"{where}: {key}") for key, form in forms.items() if key in value}
    return made(where, make, *(read.get(key, defaults.get(key)) for key in forms))


def made(where: str, make: Callable[..., Made], *values: Any) -> Made:
    """Return what is made of values; where they are refused, the message says where they stand."""
    try:
        return make(*values)
    except DocumentError:
        raise
    except ValueError as error:
        raise CourseFileError(f"{where}: {error}") from None


def number(value: Any, where: str) -> float:
    """Return a finite number."""
    try:
        found = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        raise CourseFileError(f"{where} is {show(value)}, a number is needed") from None
    if not math.isfinite(found):
        raise CourseFileError(f"{where} is {show(value)}, a finite number is needed")
    return found


def length(value: Any, where: str, most: float = MAX_LENGTH) -> float:
    """Return a finite number that can be a length of a course, m."""
    found = number(value, where)
    if abs(found) > most:
        raise CourseFileError(f"{where} is {show(value)}, more than {most:g} m; metres?")
    return found


def angle(value: Any, where: str) -> float:
    """Return an angle that is given in degrees, rad."""
    return math.radians(number(value, where))


def seed(value: Any, where: str) -> int:
    """Return the seed of something random."""
    if not isinstance(value, str) or not value.isdecimal() or int(value) > MAX_SEED:
        raise CourseFileError(f"{where} must be a whole number from 0 to {MAX_SEED}, got {show(value)}")
    return int(value)


def truth(value: Any, where: str) -> bool:
    """Return a truth value, written true or false."""
    return bool(one_of({"true": True, "false": False}, value, where))


def one_of(options: Mapping[str, Any], value: Any, where: str) -> Any:
    """Return what a word stands for."""
    if not isinstance(value, str) or value not in options:
        raise CourseFileError(f"{where} must be one of {', '.join(options)}, got {show(value)}")
    return options[value]


def coordinate(value: Any, where: str) -> float:
    """Return a place on a map, m."""
    return length(value, where, MAX_COORDINATE)


def start_of(document: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return x, y, heading of a beginning (m, m, rad)."""
    forms: Forms = {"x_m": coordinate, "y_m": coordinate, "heading_deg": angle}
    return record(document.get("start", {}), "start", lambda *pose: pose, forms, dict.fromkeys(forms, 0.0))


def name_of(found: Mapping[str, Any], key: str, default: str, where: str = "") -> str:
    """Return the name under a key, or the default where the key is not there.

    Raises:
        DocumentError: it is not a valid name, nor is the default, the file's name.
    """
    if key not in found:
        return default and check_name(default, f"{where}the file's name, which the course takes without '{key}',")
    return check_name(found[key], f"{where}{key}")


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
    if "description" in document:
        check_text(document["description"], "description")
    closed = truth(document["closed"], "closed") if "closed" in document else None
    limit = length(document.get("off_course_limit_m", str(OFF_COURSE_LIMIT)), "off_course_limit_m")
    if ("elements" in document) == ("csv" in document):
        raise CourseFileError("must have either 'elements' or 'csv'")
    if "csv" in document:
        if "start" in document:
            raise CourseFileError(
                "'start' belongs to 'elements'; the points of a CSV file are in the map frame already"
            )
        return path_from_points(name, _line_beside(path, document["csv"], closed), limit)
    elements, sections = _elements(document["elements"])
    return Course.from_elements(
        name,
        elements,
        start=start_of(document),
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
    chord = _chord_of(line)
    samples, before = smooth_line(line.points, line.closed, SAMPLE_SPACING)
    # Between points the widths are linear: a spline could overshoot to a width below zero.
    left, right = (None if w is None else np.interp(before, chord, w) for w in (line.width_left, line.width_right))
    return Course(name, *samples, line.closed, off_course_limit, left, right)


def _chord_of(line: CentreLine) -> FloatArray:
    """Return the chord lengths at the points of a line, m, that is no longer than any course."""
    chord = chord_lengths(line.points)
    if chord[-1] > MAX_LENGTH:
        raise CourseFileError(
            f"is {chord[-1] / 1e3:.6g} km long, at most {MAX_LENGTH / 1e3:g} km are possible; metres?"
        )
    return chord


def _entries(entries: Any) -> list[Any]:
    if not isinstance(entries, list) or not entries:
        raise CourseFileError("elements must be a list with at least one element")
    return entries


def _elements(entries: Any) -> tuple[list[Element], list[str] | None]:
    """Return the elements, and one section name an element or None if no element names one.

    An element without a name belongs to the section of the one before it.
    """
    elements: list[Element] = []
    sections: list[str] = []
    total = 0.0
    kinds = ", ".join(_ELEMENTS)
    for count, entry in enumerate(_entries(entries), start=1):
        where = f"element {count}: "
        if not isinstance(entry, dict):
            raise CourseFileError(f"{where}must be a mapping with one of {kinds}, got {show(entry)}")
        check_keys(where, entry, (*_ELEMENTS, "section"))
        found = [kind for kind in _ELEMENTS if kind in entry]
        if len(found) != 1:
            raise CourseFileError(f"{where}must have exactly one of {kinds}, has {' and '.join(found) or 'none'}")
        elements.append(_ELEMENTS[found[0]](entry[found[0]], f"{where}{found[0]}"))
        sections.append(name_of(entry, "section", "", where) or (sections[-1] if sections else "start"))
        total += elements[-1].length
        if total > MAX_LENGTH:
            raise CourseFileError(f"{where}the course grows longer than {MAX_LENGTH / 1e3:g} km; metres and degrees?")
    named = any("section" in entry for entry in entries)
    return elements, sections if named else None


_ELEMENTS: Final[Mapping[str, Reader]] = {
    "line": lambda value, where: made(where, Line, length(value, where)),
    "arc": partial(record, make=Arc, forms={"radius_m": length, "angle_deg": angle}),
    "quintic": partial(record, make=Quintic, forms={"length_m": length, "width_m": length}),
}

TRACK_FORMAT = "bike.track/1"

TRACK_KEYS = (
    "format", "name", "description", "length_m", "start", "transition_m", "width_m", "elements", "sectors_after",
    "elevation_m", "run_off_m", "banking_deg", "bumps", "wet", "wind", "run_off_kinds", "walls", "records_s", "sources",
)  # fmt: skip
"""Keys of a circuit file; ``format``, ``length_m``, ``width_m`` and ``elements`` must be there."""

TRANSITION = 40.0
"""Length of curvature ramps where a file does not say, m (own estimate from public outlines)."""

MAX_PIECES = 300
"""Most straights and arcs of a table: what closes them takes a time that grows with their square."""

LEAST_TRACK_POINTS = 8
"""A circuit given by fewer points is no circuit."""

LEAST_WIDTH = 0.5
"""Road narrower than this is a mistake, m."""


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
    given = _chord_of(line)
    points, there, moved = smooth_closed(line.points, min(TOLERANCE, WIDTH_SHARE * least))
    samples, before = smooth_line(points, True, SAMPLE_SPACING)
    # Distances to the limits, which do not move with the line.
    source = np.interp(before, chord_lengths(points), there)
    aside = np.interp(source, there, moved)
    centre = Course(
        name,
        *samples,
        closed=True,
        width_left=np.maximum(np.interp(source, given, line.width_left) - aside, 0.0),
        width_right=np.maximum(np.interp(source, given, line.width_right) + aside, 0.0),
        sections=equal_sectors(float(samples[0][-1])),
    )
    check_limits(centre)
    walls = wall_distances(centre, RunOff())
    return Track(centre, np.zeros(len(centre.s)), *walls, find_corners(centre), None, "from measured points")


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
    transition = length(document.get("transition_m", str(TRANSITION)), "transition_m")
    width = length(document["width_m"], "width_m")
    if width < LEAST_WIDTH:
        raise CourseFileError(f"width_m is {width}, a road is at least {LEAST_WIDTH} m wide")
    pieces = close_layout(_pieces(document["elements"]), length(document["length_m"], "length_m"), transition)
    profile = curvature_profile(pieces, transition)
    samples = trace_layout(profile, SAMPLE_SPACING, start_of(document))
    corners, s = corners_of(pieces, profile.begins), samples[0]
    sectors, half = _sectors(document.get("sectors_after"), corners, float(s[-1])), np.full(len(s), 0.5 * width)
    centre = Course(name, *samples, True, 0.5 * width, half, half.copy(), sectors)
    check_limits(centre)
    run_off = RunOff()
    if "run_off_m" in document:
        forms = dict.fromkeys(("straight", "inside", "outside"), length)
        run_off = record(document["run_off_m"], "run_off_m", RunOff, forms)
    left, right = wall_distances(centre, run_off)
    elevation = _elevation(document.get("elevation_m"), s)
    description = check_text(document["description"], "description") if "description" in document else name
    return Track(centre, elevation, left, right, corners, None, description, _surface(document, s))


def _pieces(entries: Any) -> list[Piece]:
    if len(_entries(entries)) > MAX_PIECES:
        raise CourseFileError(
            f"elements has {len(entries)} entries, at most {MAX_PIECES} are possible; give points as CSV"
        )
    pieces = []
    for count, entry in enumerate(entries, start=1):
        where = f"element {count}"
        if not isinstance(entry, dict) or ("straight_m" in entry) == ("arc" in entry):
            raise CourseFileError(f"{where}: must have either straight_m or arc")
        check_keys(f"{where}: ", entry, ("straight_m", "arc", "corner"))
        if "straight_m" in entry:
            pieces.append(made(where, Piece, length(entry["straight_m"], f"{where}: straight_m")))
            continue
        turn = partial(Piece, corner=name_of(entry, "corner", "", f"{where}: "))
        piece = record(entry["arc"], f"{where}: arc", turn, {"length_m": length, "angle_deg": angle})
        if piece.angle == 0.0:
            raise CourseFileError(f"{where}: angle_deg of an arc must not be 0")
        pieces.append(piece)
    return pieces


def _sectors(after: Any, corners: tuple[Corner, ...], lap: float) -> tuple[tuple[str, float], ...]:
    if after is None:
        return equal_sectors(lap)
    ends = {corner.name: corner.end for corner in corners}
    if not isinstance(after, list) or any(not isinstance(name, str) or name not in ends for name in after):
        raise CourseFileError(
            f"sectors_after must be a list of corner names among {', '.join(ends)}, got {show(after)}"
        )
    begins = [0.0, *(ends[name] for name in after)]
    if any(b <= a for a, b in itertools.pairwise(begins)) or begins[-1] >= lap:
        raise CourseFileError("sectors_after must name corners in the order of riding")
    return tuple((f"sector {i + 1}", begin) for i, begin in enumerate(begins))


def _pairs(entries: Any, key: str, least: int, s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distances (m, growing) and the values at them out of a list of pairs, at least so many."""
    if not isinstance(entries, list) or len(entries) < least:
        raise CourseFileError(f"{key} must be a list of at least {least} pairs of distance and value")
    pairs = []
    for count, entry in enumerate(entries, start=1):
        where = f"{key}: entry {count}"
        if not isinstance(entry, list) or len(entry) != 2:
            raise CourseFileError(f"{where} must be a pair of distance and value")
        pairs.append([length(value, where) for value in entry])
    at, values = np.array(pairs).T
    if np.any(np.diff(at) <= 0.0) or at[0] < 0.0 or at[-1] >= s[-1]:
        raise CourseFileError(f"{key}: distances must grow from 0 and stay below the length of {s[-1]:.0f} m")
    return at, values


def _elevation(entries: Any, s: FloatArray) -> FloatArray:
    """Lay a periodic cubic spline through heights."""
    if entries is None:
        return np.zeros(len(s))
    from scipy.interpolate import CubicSpline  # late: a start that needs none is spared it

    at, height = _pairs(entries, "elevation_m", 3, s)
    closed = CubicSpline(np.append(at, at[0] + s[-1]), np.append(height, height[0]), bc_type="periodic")
    return np.asarray(closed(s))


def _bank(entries: Any, s: FloatArray) -> FloatArray | None:
    """Lay a closed curve without overshoot through pairs of distance and angle."""
    if entries is None:
        return None
    from scipy.interpolate import PchipInterpolator  # late: a start that needs none is spared it

    at, degrees = _pairs(entries, "banking_deg", 2, s)
    for steep in np.flatnonzero(np.abs(degrees) > 45.0)[:1]:
        raise CourseFileError(
            f"banking_deg: entry {steep + 1}: the angle is {degrees[steep]:g} deg; at most 45 are possible"
        )
    slope = np.array([math.tan(math.radians(each)) for each in degrees])
    # a lap before and one behind, so that the curve closes
    around = np.concatenate([at - s[-1], at, at + s[-1]])
    return np.asarray(PchipInterpolator(around, np.tile(slope, 3))(s))


def _surface(document: Mapping[str, Any], s: FloatArray) -> RoadSurface:
    """Return the surface that a document describes, over a centre line whose samples have these arc lengths (m)."""

    def place(value: Any, where: str) -> float:
        found = length(value, where)
        if not 0.0 <= found <= s[-1]:
            raise CourseFileError(f"{where} is {found:g}, and must be 0 to the length of {s[-1]:.0f} m")
        return found

    def parts(key: str, make: Callable[..., Made], forms: Forms) -> tuple[Made, ...]:
        entries = document.get(key, [])
        if not isinstance(entries, list) or len(entries) > MAX_PARTS:
            raise CourseFileError(f"{key} must be a list of at most {MAX_PARTS} parts")
        forms = {"from_m": place, "to_m": place, **forms}
        return tuple(record(entry, f"{key}: part {n}", make, forms) for n, entry in enumerate(entries, start=1))

    density, bumps_seed = _bumps(document["bumps"]) if "bumps" in document else (0.0, 0)
    wind, walls = Wind(), Walls()
    if "wind" in document:
        forms = {"speed_m_s": number, "towards_deg": angle, "gusts": number, "seed": seed}
        wind = record(document["wind"], "wind", Wind, forms)
    if "walls" in document:
        usual = {"friction": walls.friction, "restitution": walls.restitution, "hit_m_s": walls.hit}
        walls = record(document["walls"], "walls", Walls, dict.fromkeys(usual, number), usual)
    sides = partial(one_of, {side: side for side in SIDES})
    kinds = partial(one_of, {kind.name.lower(): kind for kind in RunOffKind})
    return RoadSurface(
        _bank(document.get("banking_deg"), s),
        density,
        bumps_seed,
        parts("wet", WetPatch, {"grip": number}),
        parts("run_off_kinds", RunOffPart, {"side": sides, "kind": kinds}),
        wind,
        walls,
    )


def _density(value: Any, where: str) -> float:
    found = number(value, where)
    if not 0.0 <= found <= 1.0:
        raise CourseFileError(f"{where} is {found:g}; m3, as 16e-6 of class A?")
    return found


def _bumps(value: Any) -> tuple[float, int]:
    """Return density (m3) and seed of bumps."""
    if not isinstance(value, dict) or ("class" in value) == ("density_m3" in value):
        raise CourseFileError(f"bumps must be a mapping with seed and either class or density_m3, got {show(value)}")
    forms: Forms = {"class": partial(one_of, CLASSES)} if "class" in value else {"density_m3": _density}
    return record(value, "bumps", lambda density, drawn: (density, drawn), {**forms, "seed": seed})
