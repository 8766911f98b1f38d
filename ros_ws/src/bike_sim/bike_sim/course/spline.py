"""A smooth line through given points, sampled uniformly in arc length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Samples = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Arc length, x, y, heading and curvature of a line, as `Course` has them."""

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)


def chord_lengths(points: FloatArray) -> FloatArray:
    """Return the chord length at each point of an array of shape (n, 2), m, beginning at 0."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))


def smooth_line(points: FloatArray, closed: bool, spacing: float) -> tuple[Samples, FloatArray]:
    """Lay an interpolating cubic spline through points and sample it uniformly in arc length.

    The spline's parameter is the chord length. A closed line is periodic, with curvature continuous over the joint; an
    open one ends with curvature zero (natural).

    Args:
        points: shape (n, 2), m, no neighbours equal; a closed line repeats its first point at the end.
        closed: whether the line is closed.
        spacing: wanted distance of samples, m. It is stretched so that the last sample is the end.

    Returns:
        Arc length (m, from 0 in equal steps), x, y (m), heading (rad, not wrapped) and curvature (1/m) of the samples;
        and the chord length at which the given points lie before each, m, which interpolates what belongs to them.
    """
    from scipy.interpolate import CubicSpline  # late: a start that needs none is spared it

    chord = chord_lengths(points)
    spline = CubicSpline(chord, points, bc_type="periodic" if closed else "natural")
    velocity, acceleration = spline.derivative(1), spline.derivative(2)

    def arc(begin: FloatArray, end: FloatArray) -> FloatArray:
        """Integrate the speed |dr/du| by Gauss's rule over short intervals within one cubic piece."""
        half = 0.5 * (end - begin)
        nodes = (begin + half)[:, None] + half[:, None] * _GAUSS_NODES
        return half * (np.linalg.norm(velocity(nodes), axis=-1) @ _GAUSS_WEIGHTS)

    # Pieces no longer than the spacing: the speed hardly changes within, so the rule is exact to rounding.
    parts = np.maximum(1, np.ceil(np.diff(chord) / spacing)).astype(int)
    knots = np.repeat(chord[:-1], parts)
    inner = np.arange(len(knots)) - np.repeat(np.cumsum(parts) - parts, parts)
    knots = np.append(knots + inner * np.repeat(np.diff(chord) / parts, parts), chord[-1])
    arcs = np.concatenate(([0.0], np.cumsum(arc(knots[:-1], knots[1:]))))

    s = np.linspace(0.0, arcs[-1], max(2, round(arcs[-1] / spacing) + 1))
    piece = np.clip(np.searchsorted(arcs, s, side="right") - 1, 0, len(knots) - 2)
    low, high = knots[piece], knots[piece + 1]
    u = low + (high - low) * (s - arcs[piece]) / np.maximum(arcs[piece + 1] - arcs[piece], 1e-300)
    # One step of Newton is enough: within so short a piece the arc length is almost linear in the parameter.
    speed = np.maximum(np.linalg.norm(velocity(u), axis=-1), 1e-9)
    u = np.clip(u + (s - arcs[piece] - arc(low, u)) / speed, low, high)
    u[0], u[-1] = chord[0], chord[-1]

    x, y = spline(u).T
    dx, dy = velocity(u).T
    ddx, ddy = acceleration(u).T
    curvature = (dx * ddy - dy * ddx) / np.maximum(np.hypot(dx, dy), 1e-9) ** 3
    return (s, x, y, np.unwrap(np.arctan2(dy, dx)), curvature), u


MAX_WAVE = 40.0
"""Shorter wavelengths along the road are treated as noise, m, as far as the tolerance allows."""

TOLERANCE = 0.15
"""Root mean square by which smoothing may move a line, m; its largest move is four times as much."""

WIDTH_SHARE = 0.02
"""On narrow roads the tolerance is this share of the least width."""

GRID = 1.0
"""Spacing of the smoothed points, m; shorter on small circuits."""


def smooth_closed(points: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Take short waves out of a closed line.

    A low pass of third order without phase, applied over the chord length: a wave keeps 1 / (1 + (cut / wave)^6) of
    its height. The cut is shortened until the line moves by no more than the tolerance.

    Args:
        points: shape (n, 2), m; the last repeats the first.
        tolerance: root mean square of the allowed move, m.

    Returns:
        Smoothed points on a uniform grid, shape (m, 2), the last repeating the first; the chord length of the given
        line at which they lie, m; and how far they were moved to the left, m.
    """
    from scipy.interpolate import CubicSpline  # late: a start that needs none is spared it

    chord = chord_lengths(points)
    spline = CubicSpline(chord, points, bc_type="periodic")
    count = max(200, round(chord[-1] / GRID))
    at = np.linspace(0.0, chord[-1], count, endpoint=False)
    given = spline(at)
    tangent = spline(at, 1)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
    waves = np.fft.rfft(given, axis=0)
    frequency = np.fft.rfftfreq(count, chord[-1] / count)
    cut = min(MAX_WAVE, 0.25 * float(chord[-1]))
    shortest = 2.0 * float(chord[-1]) / count
    while cut > shortest:
        smooth = np.fft.irfft(waves / (1.0 + (frequency * cut) ** 6)[:, None], count, axis=0)
        moved = np.sum((smooth - given) * normal, axis=1)
        if np.sqrt(np.mean(moved**2)) <= tolerance and np.abs(moved).max() <= 4.0 * tolerance:
            break
        cut *= 0.85
    else:
        smooth, moved = given, np.zeros(count)
    return np.vstack([smooth, smooth[:1]]), np.append(at, chord[-1]), np.append(moved, moved[0])
