"""Nearest point, errors and preview on a sampled line, compiled.

Between two samples the line is the cubic Hermite piece through both with their headings.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit
from numpy import ndarray

BEHIND = 1.0
"""Reach of the search behind the last nearest point, m."""
AHEAD = 3.0
"""Reach of the search ahead of the last nearest point, m.

The window is what keeps the projection continuous: at a crossing the other branch is nearer in the plane but farther
along the line. It is long enough for the step of a control period at 30 m/s and for cutting a sharp corner;
:func:`window` makes it longer where a point moves farther from one look to the next.
"""
MOVED_SHARE = 1.5
"""The window is at least this many times the distance that the point has moved: more than it gains on the line by
cutting a corner."""


class SampledLine(NamedTuple):
    """A line in samples at even distances; a closed one repeats its first sample at the end.

    Attributes:
        x: m.
        y: m.
        heading: rad, not wrapped.
        curvature: 1/m.
        spacing: distance of the samples, m.
        closed: whether it is closed.
    """

    x: ndarray
    y: ndarray
    heading: ndarray
    curvature: ndarray
    spacing: float
    closed: bool


@njit(cache=True)
def wrap_angle(angle: float) -> float:
    """Return the angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True)
def locate(s: float, spacing: float, count: int, closed: bool) -> tuple[int, float]:
    """Return the piece of an arc length (m) and the fraction within it; open lines extend straight beyond both ends."""
    length = spacing * (count - 1)
    if closed and not 0.0 < s < length:  # the remainder of what is less is itself, and takes a while
        s = s % length
        if s >= length:  # the remainder of what is less than nothing below 0 is rounded to the length
            s = 0.0
    piece = min(max(math.floor(s / spacing), 0), count - 2)
    u = s / spacing - piece
    return piece, min(u, 1.0) if closed else u


@njit(cache=True)
def point_at(line: SampledLine, s: float) -> tuple[float, float, float, float]:
    """Return position and unit tangent (x, y, tx, ty) at an arc length s, m.

    An open line is extended straight beyond its ends.
    """
    x, y, heading, _, spacing, closed = line
    count = len(x)
    i, u = locate(s, spacing, count, closed)
    if u < 0.0 or u > 1.0:
        end = 0 if u < 0.0 else count - 1
        cos, sin = math.cos(heading[end]), math.sin(heading[end])
        along = s - spacing * end
        return x[end] + along * cos, y[end] + along * sin, cos, sin
    return _on_piece(x, y, i, u, _tangents(heading, spacing, i))


@njit(cache=True)
def _tangents(heading: ndarray, spacing: float, i: int) -> tuple[float, float, float, float]:
    """Return the tangents at both ends of a piece, as long as its arc, m: x and y at its begin, x and y at its end.

    The chord is a little shorter than the arc; with its length, points would be shifted.
    """
    return (
        math.cos(heading[i]) * spacing,
        math.sin(heading[i]) * spacing,
        math.cos(heading[i + 1]) * spacing,
        math.sin(heading[i + 1]) * spacing,
    )


@njit(cache=True)
def _on_piece(
    x: ndarray, y: ndarray, i: int, u: float, tangents: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """Return position and unit tangent at a fraction of a piece with given tangents at its ends."""
    ax, ay, bx, by = tangents
    u2 = u * u
    u3 = u2 * u
    h00 = 2.0 * u3 - 3.0 * u2 + 1.0
    h10 = u3 - 2.0 * u2 + u
    h01 = 3.0 * u2 - 2.0 * u3
    h11 = u3 - u2
    px = h00 * x[i] + h10 * ax + h01 * x[i + 1] + h11 * bx
    py = h00 * y[i] + h10 * ay + h01 * y[i + 1] + h11 * by
    d00 = 6.0 * u2 - 6.0 * u
    d10 = 3.0 * u2 - 4.0 * u + 1.0
    d11 = 3.0 * u2 - 2.0 * u
    tx = d00 * (x[i] - x[i + 1]) + d10 * ax + d11 * bx
    ty = d00 * (y[i] - y[i + 1]) + d10 * ay + d11 * by
    norm = math.sqrt(tx * tx + ty * ty)
    return px, py, tx / norm, ty / norm


@njit(cache=True)
def hermite(a: ndarray, b: ndarray, u: float) -> tuple[float, float]:
    """Return the point at a fraction u between two samples of a line, as `point_at` does, m.

    Args:
        a: x, y and the tangent's x and y, as long as the arc between both samples, m.
        b: the same at the next one.
        u: between 0 and 1.
    """
    u2 = u * u
    u3 = u2 * u
    along = u3 - 2.0 * u2 + u
    back = u3 - u2
    h01 = 3.0 * u2 - 2.0 * u3
    h00 = 2.0 * u3 - 3.0 * u2 + 1.0
    px = h00 * a[0] + along * a[2] + h01 * b[0] + back * b[2]
    py = h00 * a[1] + along * a[3] + h01 * b[1] + back * b[3]
    return px, py


@njit(cache=True)
def curvature_at(line: SampledLine, s: float) -> float:
    """Return the curvature (1/m) of the sample nearest below an arc length, so that steps stay steps."""
    i, u = locate(s, line.spacing, len(line.curvature), line.closed)
    return line.curvature[i + 1] if u >= 1.0 else line.curvature[i]


@njit(cache=True)
def window(least: float, moved: float, length: float) -> float:
    """Return how far to search for the nearest point, m.

    Args:
        least: shortest window, m.
        moved: distance that the point has moved since the last search, m.
        length: of the line, m: all that can be searched.
    """
    wanted = MOVED_SHARE * moved
    return min(wanted, length) if wanted > least else least


@njit(cache=True)
def project(
    line: SampledLine, px: float, py: float, s_near: float, behind: float, ahead: float
) -> tuple[float, float, float]:
    """Return the nearest point of the line within a window around s_near.

    Args:
        line: samples of the line.
        px: point in the map frame, m.
        py: the same, m.
        s_near: arc length of the last nearest point, m.
        behind: window behind s_near, m.
        ahead: window ahead of it, m.

    Returns:
        Arc length (m; grows over laps of a closed line, clipped to an open one), signed distance (m, positive left
        of the line), heading of the line there (rad, wrapped).
    """
    x, y, heading, _, spacing, closed = line
    count = len(x)
    length = spacing * (count - 1)
    first = math.floor((s_near - behind) / spacing)
    last = math.ceil((s_near + ahead) / spacing)
    if not closed:
        first, last = max(first, 0), min(last, count - 1)
        if first > last:
            first = last = min(max(first, 0), count - 1)
    best, best_d2 = first, 1e300
    j = first % (count - 1) if closed else first
    for k in range(first, last + 1):
        d2 = (x[j] - px) ** 2 + (y[j] - py) ** 2
        if d2 < best_d2:
            best_d2 = d2
            best = k
        j += 1
        if closed and j == count - 1:
            j = 0
    # Newton on the distance, with the line's local direction; three rounds end below 1e-9 m.
    s = best * spacing
    known, tangents = -1, (0.0, 0.0, 0.0, 0.0)
    for _ in range(3):
        i, u = locate(s, spacing, count, closed)
        if 0.0 <= u <= 1.0:
            if i != known:  # sines and cosines are most of the work, and mostly those of the round before
                known, tangents = i, _tangents(heading, spacing, i)
            qx, qy, tx, ty = _on_piece(x, y, i, u, tangents)
        else:
            qx, qy, tx, ty = point_at(line, s)
        along = (px - qx) * tx + (py - qy) * ty
        across = (py - qy) * tx - (px - qx) * ty
        bend = (heading[i + 1] - heading[i]) / spacing * across
        s += along / max(1.0 - bend, 0.2)
        s = min(max(s, (best - 1) * spacing), (best + 1) * spacing)
        if not closed:
            s = min(max(s, 0.0), length)
    i, u = locate(s, spacing, count, closed)
    if i == known and 0.0 <= u <= 1.0:
        qx, qy, tx, ty = _on_piece(x, y, i, u, tangents)
    else:
        qx, qy, tx, ty = point_at(line, s)
    across = (py - qy) * tx - (px - qx) * ty
    # Beyond an open end, or at a kink, the distance is not perpendicular: keep the sign, use the full distance.
    distance = math.sqrt((px - qx) ** 2 + (py - qy) ** 2)
    return s, math.copysign(distance, across), math.atan2(ty, tx)


@njit(cache=True)
def preview(line: SampledLine, pose: tuple[float, float, float], s: float, step: float, points: ndarray) -> None:
    """Write the preview points in the vehicle's frame (Weyrer et al. 2026, Eq. 5 and Fig. 6).

    Args:
        line: samples of the line.
        pose: rear contact point in the map frame, m, and yaw of the vehicle, rad.
        s: arc length of the nearest point, m.
        step: preview distance along the line, m.
        points: filled with x (m, positive forward) and y (m, positive to the left) in the C-frame, shape (2, n).
    """
    px, py, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    for k in range(points.shape[1]):
        qx, qy, _, _ = point_at(line, s + k * step)
        points[0, k] = cos * (qx - px) + sin * (qy - py)
        points[1, k] = cos * (qy - py) - sin * (qx - px)
