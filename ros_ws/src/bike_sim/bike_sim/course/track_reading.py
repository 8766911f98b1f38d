"""Circuits from files: a YAML table of corners, or the centre line and widths of a CSV file.

The YAML keys are listed in :data:`KEYS`, the CSV columns in :data:`bike_sim.course.csv_line.COLUMNS`; docs/circuits.md
shows both.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import SAMPLE_SPACING, Course
from bike_sim.course.csv_line import CentreLine, CourseFileError
from bike_sim.course.document import (
    MAX_LENGTH,
    check_keys,
    description_of,
    length_of,
    name_of,
    number_of,
    start_of,
    values_of,
)
from bike_sim.course.layout import Piece, close_layout, curvature_profile, trace_layout
from bike_sim.course.limits import RunOff, check_limits, wall_distances
from bike_sim.course.road_reading import SURFACE_KEYS, surface_of
from bike_sim.course.smoothing import TOLERANCE, WIDTH_SHARE, smooth_closed
from bike_sim.course.spline import chord_lengths, smooth_line
from bike_sim.course.track import Corner, Track, find_corners
from bike_sim.documents import DocumentError, show

FloatArray = NDArray[np.float64]

FORMAT = "bike.track/1"

KEYS = (
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

LEAST_POINTS = 8
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
    if len(line.points) - 1 < LEAST_POINTS:
        raise CourseFileError(f"has {len(line.points) - 1} points, a circuit needs at least {LEAST_POINTS}")
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
    check_keys("", document, KEYS)
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
    run_off_left, run_off_right = wall_distances(centre, _run_off(document.get("run_off_m")))
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


def _run_off(value: Any) -> RunOff:
    if value is None:
        return RunOff()
    straight, inside, outside = values_of(value, "run_off_m", RUN_OFF_KEYS)
    return RunOff(
        *(length_of(v, f"run_off_m: {k}") for v, k in zip((straight, inside, outside), RUN_OFF_KEYS, strict=True))
    )


def _elevation(entries: Any, s: FloatArray) -> FloatArray:
    """Lay a periodic cubic spline through heights."""
    from scipy.interpolate import CubicSpline  # late: a start that needs none is spared it

    if entries is None:
        return np.zeros(len(s))
    if not isinstance(entries, list) or len(entries) < 3:
        raise CourseFileError("elevation_m must be a list of at least three pairs of distance and height")
    knots = []
    for number, entry in enumerate(entries, start=1):
        if not isinstance(entry, list) or len(entry) != 2:
            raise CourseFileError(f"elevation_m: entry {number} must be a pair of distance and height")
        knots.append([length_of(value, f"elevation_m: entry {number}") for value in entry])
    at, height = np.array(knots).T
    if np.any(np.diff(at) <= 0.0) or at[0] < 0.0 or at[-1] >= s[-1]:
        raise CourseFileError(f"elevation_m: distances must grow from 0 and stay below the length of {s[-1]:.0f} m")
    closed = CubicSpline(np.append(at, at[0] + s[-1]), np.append(height, height[0]), bc_type="periodic")
    return np.asarray(closed(s))
