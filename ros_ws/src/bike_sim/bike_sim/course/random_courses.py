"""Random courses: paths of elements for the training families, and closed circuits, one for each seed.

Paths: Weyrer et al. (2026), Sect. 4.1, Tables 3 and 4.

Circuits are closed, nowhere crossing, with widths and hills. Corners are drawn in the proportions of real circuits
(hairpins, medium and fast corners, tight chicanes; straights before some 60 % of them), in many tables at once. The
directions of a table are brought to one turn, and its straights are stretched as little as possible until the end lies
on the beginning (least squares in closed form). A table that would need too much of that, misses its length, or runs
into itself is dropped. The first that is left is laid as the shipped circuits are (:mod:`bike_sim.course.layout`):
curvature in ramps, ends closed to a nanometre, limits checked.

docs/reference/circuits.md compares the results with real circuits. Only uniform draws of PCG64 are used, whose stream
NumPy keeps; trigonometric functions may differ in the last digit between machines, and so may the circuits.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import MAX_LENGTH, OFF_COURSE_LIMIT, SAMPLE_SPACING, Course
from bike_sim.course.csv_line import CourseFileError
from bike_sim.course.elements import Arc, Element, Line, Quintic
from bike_sim.course.layout import Piece, close_layout, curvature_profile, trace_layout
from bike_sim.course.road import RunOff, check_limits, wall_distances
from bike_sim.course.track import Track, corners_of, equal_sectors
from bike_sim.documents import show

LINE_LENGTH = (5.0, 15.0)
"""Length of straight elements, m (Table 3)."""
ARC_ANGLE = (math.pi / 4.0, math.pi / 2.0)
"""Angle of circular elements, rad (Table 3)."""
MIX = (0.4, 0.4, 0.2)
"""Shares of circular, quintic and straight elements (Sect. 4.1)."""


@dataclass(frozen=True)
class PathRanges:
    """Intervals of the elements that the curriculum widens (Table 4), all in m.

    Attributes:
        radius_min: least radius of circular elements.
        radius_max: largest.
        quintic_length_min: least extent of quintic elements.
        quintic_length_max: largest.
        quintic_width_min: least lateral offset.
        quintic_width_max: largest.
    """

    radius_min: float
    radius_max: float
    quintic_length_min: float
    quintic_length_max: float
    quintic_width_min: float
    quintic_width_max: float

    def __post_init__(self) -> None:
        """Refuse empty, negative or non-finite intervals, and elements longer than any course."""
        for spec in fields(self):
            value = getattr(self, spec.name)
            if not math.isfinite(value) or value <= 0.0:
                raise ValueError(f"path range {spec.name} must be positive and finite, got {value!r}")
            if value > MAX_LENGTH:
                raise ValueError(f"path range {spec.name} must be at most {MAX_LENGTH:g} m, got {value!r}")
        for name in ("radius", "quintic_length", "quintic_width"):
            low, high = getattr(self, f"{name}_min"), getattr(self, f"{name}_max")
            if low > high:
                raise ValueError(f"path range {name} is empty: {low} > {high}")


CURRICULUM_PATHS = (
    PathRanges(14.0, 14.0, 20.0, 22.0, 2.0, 2.0),
    PathRanges(12.0, 14.0, 18.0, 22.0, 2.0, 4.0),
    PathRanges(10.0, 14.0, 16.0, 22.0, 2.0, 6.0),
    PathRanges(8.0, 14.0, 14.0, 22.0, 2.0, 8.0),
)
"""Path ranges of the four parts of the curriculum (Table 4)."""


def random_elements(rng: np.random.Generator, ranges: PathRanges, length: float) -> list[Element]:
    """Draw elements until they are at least as long as wanted.

    The first element is never a circle, because a perturbed bicycle could not follow it (Sect. 4.1).

    Args:
        rng: random generator.
        ranges: intervals of the elements.
        length: wanted length, m.
    """
    elements: list[Element] = []
    total = 0.0
    while total < length:
        element = _draw_element(rng, ranges, first=not elements)
        elements.append(element)
        total += element.length
    return elements


def _draw_element(rng: np.random.Generator, ranges: PathRanges, first: bool) -> Element:
    circle, quintic, line = MIX
    if first:
        circle = 0.0
    choice = rng.uniform(0.0, circle + quintic + line)
    sign = 1.0 if rng.integers(2) else -1.0
    if choice < circle:
        return Arc(rng.uniform(ranges.radius_min, ranges.radius_max), sign * rng.uniform(*ARC_ANGLE))
    if choice < circle + quintic:
        extent = rng.uniform(ranges.quintic_length_min, ranges.quintic_length_max)
        return Quintic(extent, sign * rng.uniform(ranges.quintic_width_min, ranges.quintic_width_max))
    return Line(rng.uniform(*LINE_LENGTH))


def random_course(
    rng: np.random.Generator,
    ranges: PathRanges,
    length: float,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    off_course_limit: float = OFF_COURSE_LIMIT,
) -> Course:
    """Draw a random path.

    Args:
        rng: random generator; the same state gives the same path.
        ranges: intervals of the elements.
        length: the path is at least this long, m.
        start: x, y, heading of its beginning (m, m, rad).
        off_course_limit: m.

    Raises:
        ValueError: a length that is not positive, or beyond MAX_LENGTH.
    """
    if not 0.0 < length <= MAX_LENGTH:
        raise ValueError(f"length of a random path must be above 0 and at most {MAX_LENGTH:g} m, got {length!r} m")
    elements = random_elements(rng, ranges, length)
    return Course.from_elements(
        "random", elements, start=start, off_course_limit=off_course_limit, spacing=SAMPLE_SPACING
    )


FloatArray = NDArray[np.float64]

RANDOM_CIRCUIT = "random_circuit"
"""A course of this name, a colon and a seed is a random circuit."""

MAX_SEED = 2**62
"""Largest seed, as of an episode."""

LENGTH = (2500.0, 6000.0)
"""Length of the centre line, m."""

RADIUS = (12.0, 400.0)
"""Radii of the corners, m."""

CORNERS = (8, 19)
"""Fewest and most corners."""

STEEPEST = 0.08
"""Largest grade, rise per m."""

_DRAWN = 2048
_ROUNDS = 2000
# A length is drawn, and how much of it belongs to a corner, m; the lap may miss it by so much.
_LENGTH_DRAWN, _A_CORNER, _LENGTH_MISSED = (2800.0, 5700.0), (230.0, 370.0), 250.0
_SHARES = (0.30, 0.50, 0.20)
_ANGLES = np.radians([[130.0, 190.0], [60.0, 130.0], [20.0, 60.0]])
_RADII = np.array([[14.0, 100.0], [18.0, 220.0], [90.0, 370.0]])
"""Shares, angles (rad) and radii (m) of hairpins, medium and fast corners: of the 39 corners of the three shipped
circuits 13 turn by more than 130 degrees, 19 by 60 to 130 and 7 by less."""
_CHICANE_SHARE, _CHICANE_ANGLE, _CHICANE_RADIUS, _CHICANE_GAP = 0.4, np.radians([40.0, 95.0]), (13.0, 35.0), 30.0
_SAME_SIDE = 0.62
# Share of corners that follow the one before without a straight, where they turn as it does and where they do not.
_NO_STRAIGHT, _NO_STRAIGHT_FLIPPED = 0.45, 0.30
# Shortest straight, m, and least mean of those beside the main one: what corners of some 110 m each leave of the lap.
_SHORTEST, _LEAST_MEAN, _ARC = 15.0, 50.0, 110.0
_MAIN_STRAIGHT = (500.0, 1050.0)
_LONGEST = 1150.0
# How much of its drawn length a straight may become.
_STRETCH = (0.35, 2.2)
_OPEN_TURN = 0.7
# Stations (m) for the check that roads stay apart; where roads are farther along, they are so far apart at least, m.
_STATION, _APART, _ALONG = 10.0, 26.0, 75.0
_TRANSITION = (25.0, 45.0)
_WIDTH, _WIDTH_WAVE = (10.5, 14.0), 1.2
_BEFORE_LINE = 0.35
_HEIGHTS = (2.0, 45.0)
_HILLS, _HILL_LENGTH = 6, (500.0, 2500.0)


_Tables = tuple[FloatArray, FloatArray, FloatArray]
"""Tables of corners, one a row: signed angles (rad), radii (m), and straights before the corners (m; 0 for none)."""


def seed_of(name: str | Path) -> int | None:
    """Return the seed of a random circuit's name, or None for another name.

    Raises:
        CourseFileError: the name is one of a random circuit without a seed that can be.
    """
    kind, colon, seed = str(name).partition(":")
    if kind != RANDOM_CIRCUIT:
        return None
    if not colon or not re.fullmatch(r"0|[1-9][0-9]{0,18}", seed, re.ASCII) or int(seed) > MAX_SEED:
        raise CourseFileError(
            f"course {show(str(name))}: a random circuit is called {RANDOM_CIRCUIT}:<seed>, with a whole number from 0 "
            f"to {MAX_SEED} (2^62) as seed, such as {RANDOM_CIRCUIT}:7"
        )
    return int(seed)


def random_circuit(seed: int) -> Track:
    """Make the circuit of a seed.

    Args:
        seed: 0 to MAX_SEED; the same seed gives the same circuit.

    Raises:
        ValueError: a seed outside its range.
    """
    if not 0 <= seed <= MAX_SEED:
        raise ValueError(f"seed of a random circuit must be 0 to {MAX_SEED} (2^62), got {show(seed)}")
    rng = np.random.Generator(np.random.PCG64(seed))
    length = float(_between(rng.random(), _LENGTH_DRAWN))
    count = int(np.clip(round(length / float(_between(rng.random(), _A_CORNER))), *CORNERS))
    transition = float(_between(rng.random(), _TRANSITION))
    mirror = 1.0 if rng.random() < 0.5 else -1.0
    for _ in range(_ROUNDS):
        for angle, radius, straight in zip(*_closed(*_draw(rng, count, length), length), strict=True):
            if not _keeps_apart(angle, radius, straight):
                continue
            # The rest is drawn from a separate stream, so that failed tables do not change it.
            details = np.random.Generator(np.random.PCG64([seed, 1]))
            try:
                return _track(seed, details, mirror * angle, radius, straight, transition)
            except ValueError:  # its limits cross, or ramps move its ends too far to close
                continue
    raise RuntimeError(f"no circuit was found for seed {seed} in {_ROUNDS * _DRAWN} tables")  # never seen


def _between(u: FloatArray | float, ends: tuple[float, float] | FloatArray) -> FloatArray:
    return ends[0] + np.asarray(u) * (ends[1] - ends[0])


def _draw(rng: np.random.Generator, count: int, length: float) -> _Tables:
    """Draw tables of corners whose angles add up to about one turn to the left; nothing in them closes yet."""
    u, v = rng.random((_DRAWN, count, 8)), rng.random((_DRAWN, 3))
    kind = np.searchsorted(np.cumsum(_SHARES[:-1]), u[..., 0], side="right")
    angle = _between(u[..., 1], np.moveaxis(_ANGLES[kind], -1, 0))
    side = np.where(u[..., 4] < _SAME_SIDE, 1.0, -1.0)
    # A chicane of two or three corners, neither the first nor the last corner of the lap.
    first = np.where(v[:, 0] < _CHICANE_SHARE, 1 + (v[:, 1] * (count - 4)).astype(int), -count)
    step = np.arange(count) - first[:, None]
    chicane = (step >= 0) & (step <= np.where(v[:, 2] < 0.5, 2, 1)[:, None])
    angle[chicane] = _between(u[..., 1], _CHICANE_ANGLE)[chicane]
    for after in (1, 2):
        side[chicane & (step == after)] = -side[:, :-1][(chicane & (step == after))[:, 1:]]
    turn = np.sum(angle * side, axis=1)
    near = np.abs(turn - 2.0 * math.pi) < _OPEN_TURN
    u, kind, angle, side, chicane, step = (column[near] for column in (u, kind, angle, side, chicane, step))
    # All angles take a share of what the turn lacks.
    angle *= 1.0 + side * ((2.0 * math.pi - turn[near]) / np.sum(angle, axis=1))[:, None]
    # The mean of two draws: the middle of the range on a logarithmic scale is the most frequent.
    radius = np.exp(_between(0.5 * (u[..., 2] + u[..., 3]), np.moveaxis(np.log(_RADII)[kind], -1, 0)))
    radius[chicane] = _between(u[..., 2], _CHICANE_RADIUS)[chicane]
    rare = 0.5 * (_NO_STRAIGHT + _NO_STRAIGHT_FLIPPED)
    mean = (length - 0.5 * sum(_MAIN_STRAIGHT) - count * _ARC) / (count * (1.0 - rare)) - _SHORTEST
    straight = _SHORTEST - max(_LEAST_MEAN, mean) * np.log1p(-0.98 * u[..., 6])
    flipped = side != np.roll(side, 1, axis=1)
    straight[u[..., 5] < np.where(flipped, _NO_STRAIGHT_FLIPPED, _NO_STRAIGHT)] = 0.0
    gap = np.where(u[..., 6] < 0.5, 0.0, _CHICANE_GAP * u[..., 6])
    within = chicane & (step > 0)
    straight[within] = gap[within]
    straight[:, 0] = _between(u[:, 0, 7], _MAIN_STRAIGHT)
    return angle * side, radius, straight


def _closed(angle: FloatArray, radius: FloatArray, straight: FloatArray, wanted: float) -> _Tables:
    """Return the tables that close, and are about as long as wanted (m), with straights that lead to the beginning."""
    heading = np.cumsum(angle, axis=1) - angle
    along = np.exp(1j * heading)
    signed = radius * np.sign(angle)
    arcs = along * signed * (np.sin(angle) + 1j * (1.0 - np.cos(angle)))
    end = np.sum(straight * along + arcs, axis=1)
    # Least squares of relative changes: longer straights take more.
    weight = straight**2
    xx, yy = np.sum(weight * along.real**2, axis=1), np.sum(weight * along.imag**2, axis=1)
    xy = np.sum(weight * along.real * along.imag, axis=1)
    determinant = xx * yy - xy**2
    solvable = determinant > 1e-6 * (xx + yy) ** 2
    safe = np.where(solvable, determinant, 1.0)
    pull_x = (xy * end.imag - yy * end.real) / safe
    pull_y = (xy * end.real - xx * end.imag) / safe
    closed = straight + weight * (along.real * pull_x[:, None] + along.imag * pull_y[:, None])
    missed = np.abs(np.sum(closed + radius * np.abs(angle), axis=1) - wanted)
    stretch = closed / np.where(straight > 0.0, straight, 1.0)
    sound = (straight == 0.0) | (
        (stretch > _STRETCH[0]) & (stretch < _STRETCH[1]) & (closed > 0.5 * _SHORTEST) & (closed < _LONGEST)
    )
    kept = solvable & np.all(sound, axis=1) & (missed < _LENGTH_MISSED)
    # The main straight stays the longest, which is what makes it the main one.
    kept &= closed[:, 0] >= closed.max(axis=1)
    return angle[kept], radius[kept], closed[kept]


def _keeps_apart(angle: FloatArray, radius: FloatArray, straight: FloatArray) -> bool:
    """Return whether no two places of a table's line that lie far along from each other are close."""
    from scipy.spatial import cKDTree  # late: a start that needs none is spared it

    points: list[NDArray[np.complex128]] = []
    at, heading = 0.0 + 0.0j, 0.0
    for theta, r, ahead in zip(angle.tolist(), radius.tolist(), straight.tolist(), strict=True):
        along = complex(math.cos(heading), math.sin(heading))
        if ahead > 0.0:
            points.append(at + along * np.arange(0.0, ahead, _STATION))
        at += along * ahead
        centre = at + 1j * along * math.copysign(r, theta)
        turned = np.arange(0.0, abs(theta), _STATION / r) * math.copysign(1.0, theta)
        points.append(centre + (at - centre) * np.exp(1j * turned))
        at = centre + (at - centre) * complex(math.cos(theta), math.sin(theta))
        heading += theta
    line = np.concatenate(points)
    steps = np.abs(np.diff(line, append=line[:1]))
    s, length = np.cumsum(steps) - steps, float(steps.sum())
    pairs = cKDTree(np.stack([line.real, line.imag], axis=1)).query_pairs(_APART, output_type="ndarray")
    along_road = np.abs(s[pairs[:, 0]] - s[pairs[:, 1]])
    return not bool(np.any(np.minimum(along_road, length - along_road) > _ALONG))


def _track(
    seed: int,
    rng: np.random.Generator,
    angle: FloatArray,
    radius: FloatArray,
    straight: FloatArray,
    transition: float,
) -> Track:
    """Lay the circuit of a table.

    Raises:
        ValueError: it cannot be closed within the radii and lengths, or its limits cross.
    """
    main = float(straight[0])
    pieces = [Piece((1.0 - _BEFORE_LINE) * main)]
    for number, (theta, r, ahead) in enumerate(zip(angle, radius, straight, strict=True), start=1):
        if number > 1 and ahead > 0.0:
            pieces.append(Piece(float(ahead)))
        pieces.append(Piece(float(abs(theta) * r), float(theta), str(number)))
    pieces.append(Piece(_BEFORE_LINE * main))
    closed = close_layout(pieces, sum(piece.length for piece in pieces), transition)
    profile = curvature_profile(closed, transition)
    corners = corners_of(closed, profile.begins)
    for corner in corners:
        if not RADIUS[0] <= corner.radius <= RADIUS[1]:
            raise ValueError(f"corner {corner.name} has a radius of {corner.radius:.1f} m")
    samples = trace_layout(profile, SAMPLE_SPACING, (0.0, 0.0, 2.0 * math.pi * rng.random()))
    half, sectors = 0.5 * _widths(rng, samples[0]), equal_sectors(float(samples[0][-1]))
    centre = Course(
        f"{RANDOM_CIRCUIT}:{seed}", *samples, True, float(np.mean(half)), half, half.copy(), sections=sectors
    )
    check_limits(centre)
    elevation = _heights(rng, centre.x, centre.y, centre.spacing)
    return Track(centre, elevation, *wall_distances(centre, RunOff()), corners, None, f"random circuit of seed {seed}")


def _widths(rng: np.random.Generator, s: FloatArray) -> FloatArray:
    """Return the width of the road, m: constant but for two slow waves over the lap."""
    mean, share = float(_between(rng.random(), _WIDTH)), rng.random()
    phases = 2.0 * math.pi * rng.random(2)
    around = 2.0 * math.pi * s / s[-1]
    wave = share * np.sin(2.0 * around + phases[0]) + (1.0 - share) * np.sin(5.0 * around + phases[1])
    width = mean + _WIDTH_WAVE * wave
    width[-1] = width[0]
    return np.asarray(width)


def _heights(rng: np.random.Generator, x: FloatArray, y: FloatArray, spacing: float) -> FloatArray:
    """Return the height of the centre line on rolling hills, m.

    Hills are plane waves in the map, so neighbouring roads have neighbouring heights and the lap closes.
    """
    u = rng.random((_HILLS, 4))
    lengths = np.exp(_between(u[:, 0], np.log(_HILL_LENGTH)))
    height = np.zeros_like(x)
    for length, (_, direction, phase, size) in zip(lengths.tolist(), u.tolist(), strict=True):
        across = x * math.cos(2.0 * math.pi * direction) + y * math.sin(2.0 * math.pi * direction)
        height += (0.3 + size) * length * np.sin(2.0 * math.pi * (across / length + phase))
    wanted = float(np.exp(_between(rng.random(), np.log(_HEIGHTS))))
    height *= wanted / float(np.ptp(height))
    steepest = float(np.abs(np.diff(height)).max()) / spacing
    height *= min(1.0, STEEPEST / steepest)
    height -= height[0]
    height[-1] = height[0]
    return height
