"""A circuit's centre line from a table of straights and arcs: curvature ramps between them, ends closed.

Tables of corners read from a map never close exactly. :func:`close_layout` changes them as little as their accuracy
allows until they do, and :func:`trace_layout` joins them with curvature that grows linearly, as a clothoid's does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ANGLE_ACCURACY = math.radians(3.0)
"""Accuracy of the angle of an arc, rad: the scale on which the closing may change it."""
RADIUS_ACCURACY = 0.10
"""Relative accuracy of a radius."""
STRAIGHT_ACCURACY = (5.0, 0.02)
"""Accuracy of the length of a straight: m, and relative to its length."""

LEAST_LENGTH = 0.1
"""Shortest piece of a table, m: the distance of samples, and far below the accuracy of any length."""

MAX_CHANGE = 4.0
"""A table that would have to change by more than this many accuracies to close describes another shape."""

_CLOSED = 1e-9
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(24)
# A ramp may take up to half of a piece at either end.
_SHARE = 0.5


@dataclass(frozen=True)
class Piece:
    """A straight or an arc of a layout.

    Attributes:
        length: m.
        angle: turned angle, rad, positive to the left; 0 for a straight.
        corner: name of the corner it belongs to, or "".
    """

    length: float
    angle: float = 0.0
    corner: str = ""

    def __post_init__(self) -> None:
        """Refuse lengths that are not positive and angles that are not finite."""
        if not math.isfinite(self.length) or self.length <= 0.0:
            raise ValueError(f"length of a piece must be positive and finite, got {self.length!r} m")
        if not math.isfinite(self.angle):
            raise ValueError(f"angle of a piece must be finite, got {self.angle!r} rad")

    @property
    def curvature(self) -> float:
        """1/m, positive to the left."""
        return self.angle / self.length


@dataclass(frozen=True)
class Profile:
    """Curvature that is linear between knots.

    Attributes:
        s: arc length of the knots, m, from 0.
        curvature: at the knots, 1/m.
        begins: arc length at which each piece begins, m, in the middle of the ramp to it.
    """

    s: FloatArray
    curvature: FloatArray
    begins: FloatArray


def curvature_profile(pieces: Sequence[Piece], transition: float) -> Profile:
    """Return the curvature of a closed chain of pieces with linear ramps between them.

    A ramp is centred on the joint of two pieces, so it changes neither the length nor the angle of the whole. It is as
    long as ``transition``, or shorter where a piece has no room for it.

    Args:
        pieces: in order; the last joins the first in curvature as well.
        transition: wanted length of the ramps, m.

    Raises:
        ValueError: the transition is not positive; curvature would jump.
    """
    if not transition > 0.0:
        raise ValueError(f"transition between pieces must be longer than 0, got {transition!r} m")
    lengths = np.array([piece.length for piece in pieces])
    bends = np.array([piece.curvature for piece in pieces])
    ends = np.cumsum(lengths)
    half = np.minimum(0.5 * transition, _SHARE * np.minimum(lengths, np.roll(lengths, -1)))
    half[bends == np.roll(bends, -1)] = 0.0
    # The ramp over the start line is cut there, at the mean curvature.
    joint = 0.5 * (bends[-1] + bends[0])
    s, curvature = [0.0, half[-1]], [joint, bends[0]]
    for i in range(len(pieces) - 1):
        s += [ends[i] - half[i], ends[i] + half[i]]
        curvature += [bends[i], bends[i + 1]]
    s += [ends[-1] - half[-1], ends[-1]]
    curvature += [bends[-1], joint]
    keep = np.concatenate(([True], np.diff(s) > 1e-12))
    return Profile(np.array(s)[keep], np.array(curvature)[keep], ends - lengths)


def _end(profile: Profile) -> tuple[float, float, float]:
    """Return x, y, heading at the end of a line that begins at the origin along x (m, m, rad)."""
    length = np.diff(profile.s)
    bend = profile.curvature[:-1]
    growth = np.diff(profile.curvature) / length
    turned = np.concatenate(([0.0], np.cumsum(0.5 * length * (bend + profile.curvature[1:]))))
    u = 0.5 * length[:, None] * (1.0 + _GAUSS_NODES)
    heading = turned[:-1, None] + u * (bend[:, None] + 0.5 * growth[:, None] * u)
    x = float(np.sum(0.5 * length * (np.cos(heading) @ _GAUSS_WEIGHTS)))
    y = float(np.sum(0.5 * length * (np.sin(heading) @ _GAUSS_WEIGHTS)))
    return x, y, float(turned[-1])


def trace_layout(
    profile: Profile, spacing: float, start: tuple[float, float, float]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Sample a line of given curvature uniformly in arc length.

    Args:
        profile: its curvature.
        spacing: wanted distance of samples, m; stretched so that the last sample is the end.
        start: x, y, heading of the beginning (m, m, rad).

    Returns:
        s, x, y, heading (not wrapped) and curvature of the samples.
    """
    s = np.linspace(0.0, profile.s[-1], max(2, round(profile.s[-1] / spacing) + 1))
    length = np.diff(profile.s)
    growth = np.diff(profile.curvature) / length
    turned = np.concatenate(([0.0], np.cumsum(0.5 * length * (profile.curvature[:-1] + profile.curvature[1:]))))

    def heading_at(at: FloatArray) -> FloatArray:
        piece = np.clip(np.searchsorted(profile.s, at, side="right") - 1, 0, len(length) - 1)
        u = at - profile.s[piece]
        return start[2] + turned[piece] + u * (profile.curvature[piece] + 0.5 * growth[piece] * u)

    # Gauss's rule of three nodes between neighbours: exact to rounding at the 0.1 m of a course.
    nodes, weights = np.polynomial.legendre.leggauss(3)
    step = s[1] - s[0]
    x, y = np.full(len(s), float(start[0])), np.full(len(s), float(start[1]))
    for node, weight in zip(nodes, weights, strict=True):
        heading = heading_at(s[:-1] + 0.5 * step * (1.0 + node))
        x[1:] += np.cumsum(0.5 * step * weight * np.cos(heading))
        y[1:] += np.cumsum(0.5 * step * weight * np.sin(heading))
    return s, x, y, heading_at(s), np.interp(s, profile.s, profile.curvature)


def close_layout(pieces: Sequence[Piece], length: float, transition: float) -> tuple[Piece, ...]:
    """Change a table of pieces as little as possible so that it closes, at a given length.

    The least sum of squared changes of radii, angles and straights, each in units of its accuracy, subject to the end
    meeting the beginning in position and direction and to the length (Gauss-Newton on the Lagrange conditions).

    Args:
        pieces: in order, at least two of them arcs.
        length: length of the closed line, m.
        transition: length of the curvature ramps, m.

    Returns:
        The changed pieces, in the same order and with the same names.

    Raises:
        ValueError: the pieces cannot be closed without changing them beyond recognition.
    """
    for number, piece in enumerate(pieces, start=1):
        if piece.length < LEAST_LENGTH:
            raise ValueError(f"element {number} is {piece.length:g} m long, at least {LEAST_LENGTH} m are needed")
    if sum(piece.angle != 0.0 for piece in pieces) < 2:
        raise ValueError("a closed layout needs at least two arcs")
    total = sum(piece.angle for piece in pieces)
    turns = round(total / (2.0 * math.pi))
    if turns == 0:
        raise ValueError(
            f"the angles add up to {math.degrees(total):.0f} deg; a circuit turns by 360 deg, left or right"
        )

    def violation(parameters: FloatArray) -> FloatArray:
        profile = curvature_profile(_changed(pieces, parameters), transition)
        x, y, heading = _end(profile)
        # In comparable units: a radian displaces a point by its radius.
        return np.array([x, y, 100.0 * (heading - 2.0 * math.pi * turns), profile.s[-1] - length])

    parameters: FloatArray = np.zeros(sum(2 if piece.angle else 1 for piece in pieces))
    for _ in range(40):
        error = violation(parameters)
        if float(np.abs(error).max()) < _CLOSED:
            return _changed(pieces, parameters)
        probe = 1e-5
        jacobian = np.stack(
            [(violation(parameters + probe * unit) - error) / probe for unit in np.eye(len(parameters))], axis=1
        )
        # The smallest parameters, not the smallest step, that remove the linearised violation.
        target = jacobian @ parameters - error
        parameters = np.asarray(np.linalg.lstsq(jacobian, target, rcond=None)[0], dtype=np.float64)
        if not np.all(np.isfinite(parameters)) or float(np.abs(parameters).max()) > MAX_CHANGE:
            break
    worst = float(np.abs(parameters).max())
    raise ValueError(
        f"the pieces cannot be closed at {length:g} m: one would have to change by {worst:.1f} times its accuracy; "
        "is an angle's sign or a length wrong?"
    )


def _changed(pieces: Sequence[Piece], parameters: FloatArray) -> tuple[Piece, ...]:
    """Return the pieces with their changes, given in units of their accuracy: a length, or an angle and a radius."""
    changed = []
    values = iter(parameters)
    for piece in pieces:
        if piece.angle == 0.0:
            accuracy = STRAIGHT_ACCURACY[0] + STRAIGHT_ACCURACY[1] * piece.length
            # The exponential keeps a short straight positive.
            changed.append(Piece(piece.length * math.exp(next(values) * accuracy / piece.length), 0.0, piece.corner))
            continue
        ratio = math.exp(next(values) * min(ANGLE_ACCURACY / abs(piece.angle), 0.3))
        angle = piece.angle * ratio
        radius = piece.length / piece.angle * math.exp(next(values) * RADIUS_ACCURACY)
        changed.append(Piece(angle * radius, angle, piece.corner))
    return tuple(changed)
