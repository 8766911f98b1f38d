"""Limits of a circuit: their checks, and the walls behind the run-off."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course

if TYPE_CHECKING:
    from scipy import spatial

FloatArray = NDArray[np.float64]

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
    """How far behind the limits the walls stand, m.

    Attributes:
        straight: along straights. inside: inside of corners. outside: outside of sharp corners.
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
    assert centre.width_left is not None
    assert centre.width_right is not None
    for side, reach in (
        ("left", centre.curvature * centre.width_left),
        ("right", -centre.curvature * centre.width_right),
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
    left = _offset_points(centre, rows, centre.width_left[rows])
    right = _offset_points(centre, rows, -centre.width_right[rows])
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

    assert centre.width_left is not None
    assert centre.width_right is not None
    half = 0.5 * (centre.width_left + centre.width_right)[rows]
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

    assert centre.width_left is not None
    assert centre.width_right is not None
    rows = _stations(centre)
    length = round(_TANGENT / _STATION)
    # Fully wide at 100 m radius and less.
    bend = np.clip(centre.curvature[rows] * 100.0, -1.0, 1.0)
    tree = spatial.cKDTree(_offset_points(centre, rows, np.zeros(len(rows))))
    found = []
    for sign, widths in ((1.0, centre.width_left), (-1.0, centre.width_right)):
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
