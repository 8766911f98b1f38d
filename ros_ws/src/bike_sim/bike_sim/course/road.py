"""The road of a circuit: limits, run-off and walls, banking, bumps, wet patches, and the wind over it.

The surface is off by default: a road that nobody describes is level across, smooth, dry and without wind. Run-off and
walls have defaults, for no road is without.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course

if TYPE_CHECKING:
    from scipy import spatial

FloatArray = NDArray[np.float64]

LARGEST_BANK: Final = math.radians(45.0)
"""More is a wall."""


class RunOffKind(IntEnum):
    """Surface behind a limit."""

    ASPHALT = 0
    GRASS = 1
    GRAVEL = 2
    MIXED = 3
    """Grass, and gravel from GRASS_STRIP on."""


GRASS_STRIP: Final = 6.0
"""Width of the grass before the gravel of a mixed run-off, m (estimate)."""

SIDES: Final = ("left", "right", "both")


@dataclass(frozen=True)
class WetPatch:
    """A part of the road with less grip, over its whole width.

    Attributes:
        begin: progress along the centre line, m.
        end: m; less than the beginning where it lies over the start line.
        grip: factor on friction, above 0.
    """

    begin: float
    end: float
    grip: float

    def __post_init__(self) -> None:
        """Refuse a grip that is none."""
        if not 0.0 < self.grip <= 2.0:
            raise ValueError(f"grip must be above 0 and at most 2, got {self.grip!r}")


@dataclass(frozen=True)
class RunOffPart:
    """A part of the run-off.

    Attributes:
        begin: progress along the centre line, m.
        end: m; less than the beginning where it lies over the start line.
        side: one of SIDES.
        kind: its type.
    """

    begin: float
    end: float
    side: str
    kind: RunOffKind

    def __post_init__(self) -> None:
        """Refuse a side that is none."""
        if self.side not in SIDES:
            raise ValueError(f"side must be one of {', '.join(SIDES)}, got {self.side!r}")


@dataclass(frozen=True)
class Wind:
    """Wind over a circuit, everywhere the same.

    Attributes:
        speed: mean, m/s.
        towards: where it blows to, rad from the map's x axis to the left.
        gusts: standard deviation over the mean, 0.1 over water to 0.3 among buildings.
        seed: same seed, same gusts.
    """

    speed: float = 0.0
    towards: float = 0.0
    gusts: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no wind."""
        if not (0.0 <= self.speed <= 60.0 and math.isfinite(self.towards) and 0.0 <= self.gusts <= 1.0):
            raise ValueError(
                "wind must have a speed of 0 to 60 m/s, a finite direction and gusts of 0 to 1, got "
                f"{self.speed!r} m/s, {self.towards!r} rad and {self.gusts!r}"
            )


@dataclass(frozen=True)
class Walls:
    """Contact of vehicles with walls.

    Attributes:
        friction: along the wall, Coulomb's coefficient.
        restitution: part of the normal speed that is thrown back.
        hit: normal speed from which a touch ends the ride, m/s.
    """

    friction: float = 0.4
    restitution: float = 0.2
    hit: float = 3.0

    def __post_init__(self) -> None:
        """Refuse what no wall does."""
        if not (0.0 <= self.friction <= 2.0 and 0.0 <= self.restitution <= 1.0 and 0.0 <= self.hit <= 100.0):
            raise ValueError(
                "walls must have a friction of 0 to 2, a restitution of 0 to 1 and a hit of 0 to 100 m/s, got "
                f"{self.friction!r}, {self.restitution!r} and {self.hit!r} m/s"
            )


@dataclass(frozen=True)
class RoadSurface:
    """Everything about a circuit's ground beside its height; the values of a file are in docs/reference/circuits.md.

    Attributes:
        bank: rise per m to the left at the samples of the centre line; None where it is level across.
        bumps: density of the heights at 0.1 cycles per m, m3, see :mod:`bike_sim.course.road`; 0 is smooth.
        seed: of the bumps.
        wet: patches with less grip; where they overlap their factors multiply.
        run_off: parts that are not like the rest, which is grass, and grass and gravel where it is wide.
        wind: over all of it.
        walls: behind it.
        drift: change of the factor on friction in each lap, evenly along it, from the start line of the first lap on.
    """

    bank: FloatArray | None = None
    bumps: float = 0.0
    seed: int = 0
    wet: tuple[WetPatch, ...] = ()
    run_off: tuple[RunOffPart, ...] = ()
    wind: Wind = field(default_factory=Wind)
    walls: Walls = field(default_factory=Walls)
    drift: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a density that no road has."""
        if not 0.0 <= self.bumps <= 1.0:
            raise ValueError(f"bumps must have a density of 0 to 1 m3, got {self.bumps!r} m3")

    def grip(self, s: FloatArray) -> FloatArray:
        """Return the factor on friction at places of a lap, m: 1 where it is dry."""
        found = np.ones(len(s))
        for patch in self.wet:
            found[between(s, patch.begin, patch.end)] *= patch.grip
        return found


WIDE: Final = 20.0
"""Width from which a run-off that nobody describes has gravel behind its grass, m (estimate)."""


def run_off_kinds(
    s: FloatArray, widths: tuple[FloatArray, FloatArray], parts: tuple[RunOffPart, ...]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return what lies behind the left and the right limit at the samples of a centre line, as `RunOffKind`.

    Args:
        s: arc length of the samples, m.
        widths: of the left and the right run-off, m.
        parts: that somebody has described.
    """
    kinds = tuple(np.where(width >= WIDE, int(RunOffKind.MIXED), int(RunOffKind.GRASS)) for width in widths)
    for part in parts:
        within = between(s, part.begin, part.end)
        for side, kind in zip(("left", "right"), kinds, strict=True):
            if part.side in (side, "both"):
                kind[within] = int(part.kind)
    return kinds[0], kinds[1]


def between(s: FloatArray, begin: float, end: float) -> NDArray[np.bool_]:
    """Return which places lie in a part of a lap, m, that may go over the start line."""
    return (s >= begin) & (s < end) if begin <= end else (s >= begin) | (s < end)


REFERENCE: Final = 16e-6
"""Density of class A at 0.1 cycles per m, m3."""
CLASSES: Final = {name: REFERENCE * 4.0**k for k, name in enumerate("ABCDEFGH")}
"""Geometric mean of the density at 0.1 cycles per m by class, m3."""

_BAND: Final = (0.011, 2.83)
"""Spatial frequencies that the standard covers, cycles per m."""
_AT: Final = 0.1


def bump_profile(seed: int, samples: int, spacing: float) -> NDArray[np.float64]:
    """Return heights of a periodic profile of class A, m, shape (samples,); read-only.

    Each frequency has the amplitude of the spectrum and a random phase.

    Args:
        seed: same seed, same road.
        samples: number of heights.
        spacing: distance between them, m.
    """
    frequency = np.fft.rfftfreq(samples, spacing)
    within = (frequency >= _BAND[0]) & (frequency <= _BAND[1])
    amplitude = np.zeros(len(frequency))
    amplitude[within] = np.sqrt(2.0 * REFERENCE * (frequency[within] / _AT) ** -2.0 * frequency[1])
    phase = 2.0 * np.pi * np.random.default_rng(seed).random(len(frequency))
    profile = np.fft.irfft(0.5 * samples * amplitude * np.exp(1j * phase), samples)
    profile.setflags(write=False)
    return profile


_STATION = 2.0
# Largest distance along the road of two points that count as neighbours, in addition to their lateral offset.
_NEIGHBOURHOOD = 30.0
# Roads whose directions differ by less than this (rad) lie on each other where they meet, and by more they cross.
_SAME_WAY = math.radians(20.0)
# How far aside another part of the road is looked for, m, where the road is wider than twice that.
_BESIDE = 10.0
# Stations within that reach of a station, on average, of which a road without others nearby has about ten.
_CROWDED = 200
# A limit or wall stays this far (as a fraction of the radius) from the centre of a curve.
_RADIUS_SHARE = 0.9
# What is wide behind a corner begins this long before it and ends after it, m: where a straight line would lead.
_TANGENT = 60.0


@dataclass(frozen=True)
class RunOff:
    """Distances of the walls behind the limits, m.

    Attributes:
        straight: along straights.
        inside: inside of corners.
        outside: outside of sharp corners.
    """

    straight: float = 10.0
    inside: float = 10.0
    outside: float = 35.0

    def __post_init__(self) -> None:
        """Refuse distances that are not positive and finite."""
        for spec in fields(self):
            value = getattr(self, spec.name)
            if not math.isfinite(value) or value <= 0.0:
                raise ValueError(f"run-off {spec.name} must be positive and finite, got {value!r} m")


def check_limits(centre: Course) -> None:
    """Refuse a closed course whose limits cross.

    Raises:
        ValueError: a limit lies beyond the centre of a curve, so that it would run backwards, or the road runs into
            another part of itself or lies on it. A crossing of the centre line itself counts as a bridge.
    """
    widths = _widths(centre)
    for side, reach in zip(
        ("left", "right"), (centre.curvature * widths[0], -centre.curvature * widths[1]), strict=True
    ):
        worst = int(np.argmax(reach))
        if reach[worst] >= 1.0:
            radius = 1.0 / abs(centre.curvature[worst])
            width = reach[worst] * radius
            raise ValueError(
                f"the {side} limit crosses itself at {centre.s[worst]:.0f} m: it is {width:.1f} m from the centre line "
                f"in a curve of {radius:.1f} m radius; is a width or a point wrong, or are left and right exchanged?"
            )
    rows = _stations(centre)
    left = _offset_points(centre, rows, widths[0][rows])
    right = _offset_points(centre, rows, -widths[1][rows])
    middle = _offset_points(centre, rows, np.zeros(len(rows)))
    _check_once(centre, rows, middle)
    bridges = _crossings(middle, middle)
    for a, b in ((left, right), (left, left), (right, right)):
        for i, j in _crossings(a, b):
            if not any(_near(i, j, bridge, len(rows)) for bridge in bridges):
                raise ValueError(
                    f"the limits cross: the road at {centre.s[rows[i]]:.0f} m runs into the road at "
                    f"{centre.s[rows[j]]:.0f} m; are the widths too large?"
                )


def _check_once(centre: Course, rows: NDArray[np.int64], middle: FloatArray) -> None:
    """Refuse a road that overlaps with itself in the same direction, as in a file of two laps.

    Raises:
        ValueError: naming the two positions.
    """
    from scipy import spatial  # late: a start that needs none is spared it

    half = 0.5 * np.add(*_widths(centre))[rows]
    s, heading = centre.s[rows], centre.heading[rows]
    step = float(np.diff(s, append=centre.length).max())
    reach = math.hypot(min(float(half.max()), _BESIDE), step)
    tree = spatial.cKDTree(middle)
    if tree.count_neighbors(tree, reach) > _CROWDED * len(rows):  # so many pairs would fill the memory
        raise ValueError("the road lies on itself all along; does the file hold many laps?")
    pairs = tree.query_pairs(reach, output_type="ndarray")
    i, j = pairs.T
    along = np.abs(s[i] - s[j])
    along = np.minimum(along, centre.length - along)
    between = middle[j] - middle[i]
    aside = np.abs(between[:, 1] * np.cos(heading[i]) - between[:, 0] * np.sin(heading[i]))
    same_way = np.cos(heading[i] - heading[j]) > math.cos(_SAME_WAY)
    far = along > min(_NEIGHBOURHOOD, 0.25 * centre.length)
    found = np.flatnonzero(far & same_way & (aside < np.minimum(half[i], half[j])))
    if len(found):
        first = found[np.argmin(s[i[found]])]
        raise ValueError(
            f"the road at {s[i[first]]:.0f} m lies on the road at {s[j[first]]:.0f} m; does the file hold more than "
            "one lap?"
        )


def wall_distances(centre: Course, run_off: RunOff) -> tuple[FloatArray, FloatArray]:
    """Return the distance from the left and right limits to the walls behind them, m, at the samples.

    Outside of corners run-off grows with curvature, and it is wide where a rider who does not turn would arrive. Walls
    stay clear of other parts of the road and of the centre of the curve they stand in.
    """
    from scipy import ndimage, spatial  # late: a start that needs none is spared it

    rows = _stations(centre)
    length = round(_TANGENT / _STATION)
    # Fully wide at 100 m radius and less.
    bend = np.clip(centre.curvature[rows] * 100.0, -1.0, 1.0)
    tree = spatial.cKDTree(_offset_points(centre, rows, np.zeros(len(rows))))
    found = []
    for sign, widths in zip((1.0, -1.0), _widths(centre), strict=True):
        outside = ndimage.maximum_filter1d(np.maximum(-sign * bend, 0.0), 2 * length + 1, mode="wrap")
        inside = np.maximum(sign * bend, 0.0)
        wanted = run_off.straight + outside * (run_off.outside - run_off.straight)
        wanted = np.where(inside > outside, run_off.straight + inside * (run_off.inside - run_off.straight), wanted)
        wanted = ndimage.uniform_filter1d(wanted, length, mode="wrap")
        free = _free_distance(centre, rows, tree, sign, widths[rows], wanted)
        # The minimum over neighbours first, so that smoothing never brings a wall nearer than is free.
        window = 11
        # The running sum of the mean may end a rounding error below zero where no run-off is free.
        free = ndimage.minimum_filter1d(free, window, mode="wrap")
        free = np.maximum(ndimage.uniform_filter1d(free, window, mode="wrap"), 0.0)
        padded = np.append(rows, len(centre.s) - 1)
        found.append(np.interp(np.arange(len(centre.s)), padded, np.append(free, free[0])))
    return found[0], found[1]


def _free_distance(
    centre: Course, rows: NDArray[np.int64], tree: spatial.cKDTree, sign: float, widths: FloatArray, wanted: FloatArray
) -> FloatArray:
    """Shorten run-off until every wall is nearer to its own road than to any other part of it."""
    bend = np.maximum(sign * centre.curvature[rows], 0.0)
    with np.errstate(divide="ignore"):
        free = np.maximum(np.minimum(wanted, _RADIUS_SHARE / bend - widths), 0.0)
    s = centre.s[rows]
    for _ in range(20):
        offset = widths + free
        distance, nearest = tree.query(_offset_points(centre, rows, sign * offset))
        apart = np.abs(s[nearest] - s)
        apart = np.minimum(apart, centre.length - apart)
        # A point belongs to another part of the road if its nearest station is far along and nearer than its own.
        strange = (distance < 0.95 * offset) & (apart > _NEIGHBOURHOOD + 0.5 * math.pi * offset)
        strange &= free > 0.0
        if not np.any(strange):
            break
        free[strange] *= 0.8
    return free


def _widths(centre: Course) -> tuple[FloatArray, FloatArray]:
    assert centre.width_left is not None, "a circuit has limits"
    assert centre.width_right is not None, "a circuit has limits"
    return centre.width_left, centre.width_right


def _stations(centre: Course) -> NDArray[np.int64]:
    """Return the samples at about every 2 m (closer on small circuits), the last (which repeats the first) left out."""
    count = max(200, round(centre.length / _STATION))
    return np.unique(np.floor(np.linspace(0.0, len(centre.s) - 1, count, endpoint=False)).astype(np.int64))


def _offset_points(centre: Course, rows: NDArray[np.int64], offset: FloatArray) -> FloatArray:
    heading = centre.heading[rows]
    return np.stack([centre.x[rows] - offset * np.sin(heading), centre.y[rows] + offset * np.cos(heading)], axis=1)


def _crossings(a: FloatArray, b: FloatArray) -> list[tuple[int, int]]:
    """Return the segments in which two closed polygons cross; a polygon with itself is allowed."""
    from scipy import spatial  # late: a start that needs none is spared it

    step_a, step_b = np.roll(a, -1, axis=0) - a, np.roll(b, -1, axis=0) - b
    reach = 0.5 * float(max(np.hypot(*step_a.T).max(), np.hypot(*step_b.T).max()))
    near = spatial.cKDTree(a + 0.5 * step_a).query_ball_tree(spatial.cKDTree(b + 0.5 * step_b), 2.0 * reach)
    i = np.repeat(np.arange(len(a)), [len(found) for found in near])
    j = np.array([k for found in near for k in found], dtype=np.int64)
    if a is b:
        gap = np.abs(i - j)
        apart = np.minimum(gap, len(a) - gap) > 1
        i, j = i[apart], j[apart]
    if not len(i):
        return []
    between = b[j] - a[i]
    determinant = _cross(step_a[i], step_b[j])
    with np.errstate(divide="ignore", invalid="ignore"):
        u = _cross(between, step_b[j]) / determinant
        v = _cross(between, step_a[i]) / determinant
        hit = (u >= 0.0) & (u < 1.0) & (v >= 0.0) & (v < 1.0)
    return [(int(p), int(q)) for p, q in zip(i[hit], j[hit], strict=True)]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _near(i: int, j: int, bridge: tuple[int, int], count: int) -> bool:
    """Return whether a crossing of limits belongs to a bridge, whose limits cross within some widths of its middle."""

    def apart(p: int, q: int) -> int:
        return min(abs(p - q), count - abs(p - q))

    reach = round(_NEIGHBOURHOOD / _STATION)
    k, m = bridge
    return max(apart(i, k), apart(j, m)) <= reach or max(apart(i, m), apart(j, k)) <= reach
