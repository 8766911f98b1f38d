"""The ideal line: the path within the limits that bends least (minimum curvature).

The line is a polygon of stations on the centre line's normals; its discrete curvature is linearised about the current
offsets, which gives a sparse quadratic programme with the limits as bounds, and again about its solution (sequential
quadratic programming, solved by OSQP). The formulation follows Heilmeier et al. (2019), Minimum curvature trajectory
planning and control for an autonomous race car, Vehicle System Dynamics 58(10), with finite differences instead of
splines so that all matrices stay banded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import CubicSpline

from bike_sim.course.projection import point_at
from bike_sim.course.track import Track

FloatArray = NDArray[np.float64]

STATION_SPACING = 3.0
"""Distance of stations, m, on circuits of kilometres."""

LEAST_STATIONS = 150
"""Small circuits get closer stations."""

MARGIN = 0.5
"""Distance that the line keeps from the limits, m; on narrow roads a tenth of the width."""

MAX_ROUNDS = 20
CONVERGED = 0.01
"""The line is done when no station moves by more than this, m."""

_STEP_PENALTY = 1e-9
_SIGNIFICANT = 1e-5


class NoLineError(ValueError):
    """No line could be computed between the limits."""


@dataclass(frozen=True)
class Stations:
    """A circuit sampled for optimisation, n stations, the first not repeated.

    Attributes:
        progress: of the stations along the centre line, m.
        points: on the centre line, shape (n, 2), m.
        normals: unit vectors to the left, shape (n, 2).
        lowest: least offset, m.
        highest: largest offset, m; both leave the margin.
        length: of the centre line, m.
    """

    progress: FloatArray
    points: FloatArray
    normals: FloatArray
    lowest: FloatArray
    highest: FloatArray
    length: float

    @property
    def count(self) -> int:
        """Number of stations."""
        return len(self.progress)


def stations_of(track: Track, spacing: float = STATION_SPACING, margin: float = MARGIN) -> Stations:
    """Sample a circuit at stations.

    Args:
        track: the circuit.
        spacing: wanted distance of stations, m.
        margin: distance kept from the limits, m.

    Raises:
        ValueError: spacing or margin that is not positive.
    """
    if not spacing > 0.0 or not margin >= 0.0:
        raise ValueError(f"station spacing must be positive and margin >= 0, got {spacing!r} and {margin!r} m")
    count = max(LEAST_STATIONS, round(track.length / spacing))
    # In exactly equal steps: offsets that are smooth from station to station would be a kinked line otherwise.
    progress = np.linspace(0.0, track.length, count, endpoint=False)
    found = [point_at(track.centre.samples, s) for s in progress]
    x, y, along, across = np.array(found).T
    left, right = track.at(track.width_left, progress), track.at(track.width_right, progress)
    kept = np.minimum(margin, 0.1 * (left + right))
    return Stations(
        progress,
        np.stack([x, y], axis=1),
        np.stack([-across, along], axis=1),
        -(right - kept),
        left - kept,
        track.length,
    )


def curvature_of(stations: Stations, offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return curvature (1/m, positive to the left) and length of the polygon (m) around each station."""
    _, _, speed, curvature = _differences(stations, offset)
    return curvature, speed


def _differences(stations: Stations, offset: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return first and second differences of the polygon around each station, length of the first, and curvature."""
    path = stations.points + offset[:, None] * stations.normals
    ahead, behind = np.roll(path, -1, axis=0), np.roll(path, 1, axis=0)
    first, second = 0.5 * (ahead - behind), ahead - 2.0 * path + behind
    speed = np.linalg.norm(first, axis=1)
    return first, second, speed, (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3


def curvature_jacobian(stations: Stations, offset: FloatArray) -> tuple[FloatArray, FloatArray, sparse.csc_matrix]:
    """Return curvature, lengths, and the derivative of curvature by the offsets (1/m^2), sparse, shape (n, n)."""
    first, second, speed, curvature = _differences(stations, offset)
    n = stations.count
    here = np.arange(n)
    rows, columns, values = [], [], []
    # A station's offset moves a neighbour's first difference by +-normal/2 and its second by the normal.
    for shift, in_first, in_second in ((-1, -0.5, 1.0), (0, 0.0, -2.0), (1, 0.5, 1.0)):
        normal = np.roll(stations.normals, -shift, axis=0)
        d_cross = in_first * (normal[:, 0] * second[:, 1] - normal[:, 1] * second[:, 0]) + in_second * (
            first[:, 0] * normal[:, 1] - first[:, 1] * normal[:, 0]
        )
        d_speed = in_first * np.sum(first * normal, axis=1) / speed
        rows.append(here)
        columns.append((here + shift) % n)
        values.append(d_cross / speed**3 - 3.0 * curvature * d_speed / speed)
    jacobian = sparse.csc_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (n, n))
    return curvature, speed, jacobian


def least_curvature(stations: Stations, start: FloatArray | None = None) -> FloatArray:
    """Return the offsets (m) of the line that bends least: the least integral of squared curvature.

    Args:
        stations: the circuit.
        start: offsets to begin with, m; the centre line if None.

    Raises:
        NoLineError: the solver finds no line.
    """
    offset = np.clip(np.zeros(stations.count) if start is None else start, stations.lowest, stations.highest)
    reach = 0.5 * float(np.max(stations.highest - stations.lowest))
    cost = _bending(stations, offset)
    for _ in range(MAX_ROUNDS):
        curvature, length, jacobian = curvature_jacobian(stations, offset)
        weight = sparse.diags(length)
        step = solve_step(
            jacobian.T @ weight @ jacobian,
            jacobian.T @ (length * curvature),
            np.maximum(stations.lowest - offset, -reach),
            np.minimum(stations.highest - offset, reach),
        )
        trial = np.clip(offset + step, stations.lowest, stations.highest)
        trial_cost = _bending(stations, trial)
        if trial_cost >= cost:
            # The linearisation does not hold that far.
            reach *= 0.3
            if reach < CONVERGED:
                break
            continue
        moved = float(np.abs(trial - offset).max())
        gained = cost - trial_cost
        offset, cost = trial, trial_cost
        if moved < CONVERGED or gained < _SIGNIFICANT * cost:
            break
    return offset


def _bending(stations: Stations, offset: FloatArray) -> float:
    curvature, length = curvature_of(stations, offset)
    return float(np.sum(length * curvature**2))


def solve_step(hessian: sparse.csc_matrix, gradient: FloatArray, lowest: FloatArray, highest: FloatArray) -> FloatArray:
    """Return the step that minimises 1/2 x'Hx + g'x within bounds.

    Args:
        hessian: H, sparse, symmetric, positive semidefinite.
        gradient: g.
        lowest: least step, of the shape of the gradient.
        highest: largest step.

    Raises:
        NoLineError: the solver does not find one.
    """
    n = len(gradient)
    scale = float(np.mean(hessian.diagonal()))
    upper = sparse.triu(hessian / scale + _STEP_PENALTY * sparse.identity(n), format="csc")
    solver = osqp.OSQP()
    solver.setup(
        upper,
        gradient / scale,
        sparse.identity(n, format="csc"),
        lowest,
        highest,
        verbose=False,
        eps_abs=1e-5,
        eps_rel=1e-5,
        max_iter=20_000,
        polishing=False,
        rho=1e-3,
    )
    result = solver.solve(raise_error=False)
    if result.x is None or not np.all(np.isfinite(result.x)):
        raise NoLineError(f"no line found between the limits: the solver says {result.info.status!r}")
    return np.clip(result.x, lowest, highest)


def at_samples(track: Track, stations: Stations, offset: FloatArray) -> FloatArray:
    """Return offsets of stations at the samples of the centre line, by a periodic cubic spline kept within limits."""
    spline = CubicSpline(
        np.append(stations.progress, stations.length), np.append(offset, offset[0]), bc_type="periodic"
    )
    return np.clip(spline(track.centre.s), -track.width_right, track.width_left)


def with_ideal_line(track: Track, spacing: float = STATION_SPACING, margin: float = MARGIN) -> Track:
    """Return the circuit with the line of least curvature as its ideal line.

    Args:
        track: the circuit.
        spacing: distance of the stations, m.
        margin: distance kept from the limits, m.

    Raises:
        NoLineError: the solver finds no line.
    """
    stations = stations_of(track, spacing, margin)
    return track.with_ideal(at_samples(track, stations, least_curvature(stations)))
