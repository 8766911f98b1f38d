"""The three elements that paths are built from: line, circular arc and quintic transfer.

Source: Weyrer et al. (2026), Sect. 3.1 and Fig. 4. An element begins at the origin heading along
x; :func:`sample_elements` chains elements and returns points that are uniform in arc length.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_FINE_POINTS_PER_METRE = 10
"""Points at which a quintic's arc length is tabulated. Both the table and its reading are of fourth order: for every
transfer of the training families and for the hard lane change they are exact to 1e-8 m."""

MAX_QUINTIC_RATIO = 100.0
"""Largest width of a quintic transfer, in extents: beyond, its ends are steps that no sampling shows."""


@dataclass(frozen=True)
class Line:
    """Straight element.

    Attributes:
        length: length, m.
    """

    length: float

    def __post_init__(self) -> None:
        """Refuse lengths that are not positive and finite."""
        _require_positive("line length", self.length)

    def trace(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return x, y, heading and curvature at arc lengths s within the element (m, m, rad, 1/m)."""
        zero = np.zeros_like(s)
        return s.copy(), zero, zero.copy(), zero.copy()


@dataclass(frozen=True)
class Arc:
    """Circular element.

    Attributes:
        radius: radius, m.
        angle: turned angle, rad, positive to the left.
    """

    radius: float
    angle: float

    def __post_init__(self) -> None:
        """Refuse a radius that is not positive and an angle of zero."""
        _require_positive("arc radius", self.radius)
        if not math.isfinite(self.angle) or self.angle == 0.0:
            raise ValueError(f"arc angle must be finite and not zero, got {self.angle!r}")

    @property
    def length(self) -> float:
        """Arc length, m."""
        return self.radius * abs(self.angle)

    def trace(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return x, y, heading and curvature at arc lengths s within the element (m, m, rad, 1/m)."""
        curvature = math.copysign(1.0 / self.radius, self.angle)
        heading = curvature * s
        x = np.sin(heading) / curvature
        y = (1.0 - np.cos(heading)) / curvature
        return x, y, heading, np.full_like(s, curvature)


@dataclass(frozen=True)
class Quintic:
    """Polynomial element of degree five: a lateral transfer with zero slope and curvature at both ends.

    Attributes:
        extent: extent along the initial direction L_P, m.
        width: lateral offset W_P, m, positive to the left.
    """

    extent: float
    width: float

    def __post_init__(self) -> None:
        """Refuse an extent that is not positive, and a width that is not finite or makes a jump of the transfer."""
        _require_positive("quintic extent", self.extent)
        if not math.isfinite(self.width):
            raise ValueError(f"quintic width must be finite, got {self.width!r}")
        if abs(self.width) > MAX_QUINTIC_RATIO * self.extent:
            raise ValueError(
                f"quintic width must be at most {MAX_QUINTIC_RATIO:g} times its extent of {self.extent!r} m, "
                f"got {self.width!r} m"
            )

    @cached_property
    def _fine(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the parameter u in [0, 1], the arc length s there (m) and ds/du (m)."""
        count = max(16, round((self.extent + abs(self.width)) * _FINE_POINTS_PER_METRE)) + 1
        u = np.linspace(0.0, 1.0, count)
        ratio = self.width / self.extent
        slope = ratio * _QUINTIC_D1(u)
        stretch = np.sqrt(1.0 + slope**2)
        speed = self.extent * stretch
        step = 1.0 / (count - 1)
        s = np.concatenate(([0.0], np.cumsum(speed[1:] + speed[:-1]) * (0.5 * step)))
        # Euler-Maclaurin: the error of the trapezoid rule is the change of the integrand's slope times step^2 / 12.
        s -= step**2 / 12.0 * self.extent * slope * ratio * _QUINTIC_D2(u) / stretch
        return u, s, speed

    @property
    def length(self) -> float:
        """Arc length, m."""
        return float(self._fine[1][-1])

    def _parameter(self, s: FloatArray) -> FloatArray:
        """Return the parameter u at arc lengths s, by cubic Hermite pieces of the inverse of s(u)."""
        u_fine, s_fine, speed = self._fine
        i = np.clip(np.searchsorted(s_fine, s, side="right") - 1, 0, len(u_fine) - 2)
        width = s_fine[i + 1] - s_fine[i]
        v = (s - s_fine[i]) / width
        rise = u_fine[i + 1] - u_fine[i]
        a = width / speed[i] - rise
        b = rise - width / speed[i + 1]
        return u_fine[i] + v * rise + v * (1.0 - v) * (a * (1.0 - v) + b * v)

    def trace(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return x, y, heading and curvature at arc lengths s within the element (m, m, rad, 1/m)."""
        u = self._parameter(s)
        slope = self.width / self.extent * _QUINTIC_D1(u)
        second = self.width / self.extent**2 * _QUINTIC_D2(u)
        curvature = second / (1.0 + slope**2) ** 1.5
        return self.extent * u, self.width * _QUINTIC(u), np.arctan(slope), curvature


Element = Line | Arc | Quintic


def _QUINTIC(u: FloatArray) -> FloatArray:
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def _QUINTIC_D1(u: FloatArray) -> FloatArray:
    return 30.0 * u**2 * (1.0 - u) ** 2


def _QUINTIC_D2(u: FloatArray) -> FloatArray:
    return 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)


def _require_positive(name: str, value: float) -> None:
    if not math.isfinite(value) or value <= 0.0:
        raise ValueError(f"{name} must be positive and finite, got {value!r}")


def sample_elements(
    elements: Sequence[Element], spacing: float, start: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Sample a chain of elements uniformly in arc length.

    Args:
        elements: the chain, in order.
        spacing: wanted distance of samples, m. It is stretched so that the last sample is the end.
        start: x, y, heading of the beginning (m, m, rad).

    Returns:
        s, x, y, heading (not wrapped), curvature, and the arc length at which each element begins.

    Raises:
        ValueError: there is no element.
    """
    if not elements:
        raise ValueError("a course needs at least one element")
    lengths = np.array([element.length for element in elements])
    ends = np.cumsum(lengths)
    begins = ends - lengths
    count = max(2, round(ends[-1] / spacing) + 1)
    s = np.linspace(0.0, ends[-1], count)
    columns = np.empty((4, count))
    pose = np.array(start, dtype=np.float64)
    borders = np.searchsorted(s, begins)
    borders = np.append(borders, count)
    for i, element in enumerate(elements):
        inside = slice(borders[i], borders[i + 1])
        local = np.append(np.clip(s[inside] - begins[i], 0.0, lengths[i]), lengths[i])
        x, y, turn, curvature = element.trace(local)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        placed = np.stack([pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y, pose[2] + turn])
        columns[:3, inside] = placed[:, :-1]
        columns[3, inside] = curvature[:-1]
        pose = placed[:, -1]
    return s, columns[0], columns[1], columns[2], columns[3], begins
