"""Observation and outcome of the frozen tasks of bicycles, compiled: as NumPy they take a third of a step of 64 rows.

They compute what `ObservationLayout.observe` and `PathTask` do for these tasks; a test holds them together.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.schema import GRAVITY

FloatArray = NDArray[np.float64]


@njit(cache=True)
def observe(
    state: FloatArray,
    preview_y: FloatArray,
    columns: NDArray[np.int64],
    step: float,
    gains: FloatArray,
    bounds: FloatArray,
    seen: NDArray[np.float32],
) -> None:
    """Write the observations of the layout ``fine``.

    Args:
        state: minimal states, shape (n, 10).
        preview_y: offsets of the preview points, m, shape (n, points).
        columns: of the state that are shown.
        step: interval of the preview, s.
        gains: factor of each number.
        bounds: largest magnitude of each number.
        seen: filled, shape (n, columns and points).
    """
    first, points = len(columns), preview_y.shape[1]
    for row in range(len(state)):
        for place in range(first + points):
            if place < first:
                value = state[row, columns[place]]
            else:
                k = place - first
                value = preview_y[row, k]
                if k == 1:
                    value = (value - preview_y[row, 0]) / step
                elif k > 1:
                    value = (value - 2.0 * preview_y[row, k - 1] + preview_y[row, k - 2]) / (GRAVITY * step**2)
            value = value * gains[place]
            if np.isnan(value):
                value = 0.0
            seen[row, place] = max(-bounds[place], min(bounds[place], value))


@njit(cache=True)
def evaluate(
    distance: FloatArray,
    roll: FloatArray,
    fallen: NDArray[np.bool_],
    thresholds: tuple[float, float],
    sharpness: float,
    rewards: FloatArray,
    failed: NDArray[np.bool_],
) -> None:
    """Write the terms of the reward and who has failed.

    Args:
        distance: of the rear contact to the path, m, shape (n,).
        roll: rad.
        fallen: whether a ride is over.
        thresholds: largest distance (m) and roll (rad).
        sharpness: width of the peak, m.
        rewards: filled, shape (2, n): half the linear term and half the peak.
        failed: filled.
    """
    for row in range(len(distance)):
        away = abs(distance[row])
        rewards[0, row] = 0.5 * max(0.0, min(1.0, (thresholds[0] - away) / thresholds[0]))
        rewards[1, row] = 0.5 * np.exp(-away / sharpness)
        failed[row] = not (away <= thresholds[0] and abs(roll[row]) <= thresholds[1]) or fallen[row]
