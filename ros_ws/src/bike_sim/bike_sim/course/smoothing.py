"""Smoothing of measured circuits: noise of a few centimetres at 5 m spacing would be all that curvature shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.spline import chord_lengths

FloatArray = NDArray[np.float64]

LONGEST_WAVE = 40.0
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
    cut = min(LONGEST_WAVE, 0.25 * float(chord[-1]))
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
