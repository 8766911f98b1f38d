"""A course: the line to follow, sampled uniformly in arc length, with its limits and sections."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.elements import Element, sample_elements
from bike_sim.course.projection import SampledLine

FloatArray = NDArray[np.float64]

SAMPLE_SPACING = 0.1
"""Distance of samples, m. Cubic Hermite pieces between them are exact to 1e-9 m on an arc of 8 m radius."""

OFF_COURSE_LIMIT = 3.5
"""Default distance beyond which a ride counts as off course, m (eta_y of Weyrer et al. 2026, Sect. 3.3)."""

MAX_LENGTH = 100e3
"""Longest course, m. A longer one is a mistake of units, and would fill the memory with samples."""

SAME_LAP = 4.0
"""A position this close to the expected one on a closed line is of the same lap, m."""

HEIGHT_SPAN = 2.0
"""Reach over which heights become grades, m: far above the spacing of samples and far below that of hills."""

CLOSING_TOLERANCE = 1e-3
"""A course may call itself closed when its ends meet within this distance (m) and angle (rad)."""


def check_columns(owner: str, size: int, columns: Mapping[str, FloatArray | None]) -> None:
    """Refuse columns of another number of samples, or with values that are not finite; None is no column.

    Raises:
        ValueError: naming owner and column.
    """
    for label, column in columns.items():
        if column is None:
            continue
        if len(column) != size:
            raise ValueError(f"{owner}: {label} has {len(column)} samples, s has {size}")
        if not np.all(np.isfinite(column)):
            row = int(np.argmin(np.isfinite(column)))
            raise ValueError(f"{owner}: {label} is {column[row]} at sample {row}")


@dataclass(frozen=True, eq=False)
class Course:
    """Line in the map frame, uniform in arc length; equal to itself alone, so that plans of it can be looked up.

    Attributes:
        name: name for people and files.
        s: arc length of the samples, m, from 0 in equal steps.
        x: m.
        y: m.
        heading: rad, not wrapped.
        curvature: 1/m, positive turning left.
        closed: the last sample meets the first.
        off_course_limit: distance from the line that ends a ride, m.
        width_left: distance from the line to the left limit, m, or None without limits.
        width_right: distance from the line to the right limit, m, or None without limits.
        sections: name and first arc length (m) of each section, in order.
        height: of the road at the samples, m, or None on level ground.
        bank: slope of the road across the line at the samples, positive rising to the left (rise per m), or None where
            it is level across.
        grip: factor on friction at the samples, 1 on a dry road, or None where it is dry everywhere.
    """

    name: str
    s: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    curvature: FloatArray
    closed: bool = False
    off_course_limit: float = OFF_COURSE_LIMIT
    width_left: FloatArray | None = None
    width_right: FloatArray | None = None
    sections: tuple[tuple[str, float], ...] = field(default=())
    height: FloatArray | None = None
    bank: FloatArray | None = None
    grip: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check what every query relies on.

        Raises:
            ValueError: too few samples, unequal lengths, a value that is not finite, arc length that is not
                uniform, or a course that calls itself closed but is not.
        """
        size = len(self.s)
        if size < 2:
            raise ValueError(f"course {self.name!r} has {size} samples, at least 2 are needed")
        columns = {"x": self.x, "y": self.y, "heading": self.heading, "curvature": self.curvature}
        others = {"width_left": self.width_left, "width_right": self.width_right}
        road = {"height": self.height, "bank": self.bank, "grip": self.grip}
        check_columns(f"course {self.name!r}", size, {**columns, **others, **road})
        steps = np.diff(self.s)
        if self.s[0] != 0.0 or not np.allclose(steps, steps[0], rtol=1e-6, atol=1e-9) or steps[0] <= 0.0:
            raise ValueError(f"course {self.name!r}: arc length must begin at 0 and grow in equal steps")
        if not math.isfinite(self.off_course_limit) or self.off_course_limit <= 0.0:
            raise ValueError(f"course {self.name!r}: off-course limit must be positive, got {self.off_course_limit!r}")
        if not self.closed:
            return
        gap = math.hypot(self.x[-1] - self.x[0], self.y[-1] - self.y[0])
        turns = (self.heading[-1] - self.heading[0]) / (2.0 * math.pi)
        kink = abs(turns - round(turns)) * 2.0 * math.pi
        if gap > CLOSING_TOLERANCE or kink > CLOSING_TOLERANCE:
            raise ValueError(
                f"course {self.name!r} is called closed, but its ends are {gap:.4f} m and {kink:.4f} rad apart"
            )

    @property
    def length(self) -> float:
        """Length of the line, m."""
        return float(self.s[-1])

    @property
    def spacing(self) -> float:
        """Distance of samples, m."""
        return float(self.s[1] - self.s[0])

    @cached_property
    def grade(self) -> FloatArray:
        """Slope of the road along the line, positive uphill (rise per m), at the samples."""
        return np.zeros(len(self.s)) if self.height is None else self._slope(self.height)

    @property
    def slope_across(self) -> FloatArray:
        """Slope of the road across the line, positive rising to the left (rise per m), at the samples."""
        return np.zeros(len(self.s)) if self.bank is None else self.bank

    @cached_property
    def crest(self) -> FloatArray:
        """Vertical curvature of the road along the line, 1/m, negative over a crest, at the samples."""
        return self._slope(self.grade)

    def _slope(self, column: FloatArray) -> FloatArray:
        """Return the change of a column per m, over HEIGHT_SPAN to both sides of each sample."""
        reach = max(1, min(round(HEIGHT_SPAN / self.spacing), (len(self.s) - 1) // 2))
        if self.closed:
            around = np.concatenate([column[-1 - reach : -1], column, column[1 : 1 + reach]])
            return np.asarray((around[2 * reach :] - around[: -2 * reach]) / (2.0 * reach * self.spacing))
        rows = np.arange(len(column))
        ahead, behind = np.minimum(rows + reach, rows[-1]), np.maximum(rows - reach, 0)
        return np.asarray((column[ahead] - column[behind]) / (self.spacing * (ahead - behind)))

    @cached_property
    def samples(self) -> SampledLine:
        """The line as compiled functions take it."""
        return SampledLine(self.x, self.y, self.heading, self.curvature, self.spacing, self.closed)

    @cached_property
    def table(self) -> FloatArray:
        """x, y, heading and curvature of the samples in one array, shape (4, n), for compiled loops."""
        return np.ascontiguousarray([self.x, self.y, self.heading, self.curvature])

    def heading_at(self, s: float) -> float:
        """Return the direction of the line at an arc length, m; rad, not wrapped, linear between samples."""
        inside = s % self.length if self.closed else s
        return float(np.interp(inside, self.s, self.heading))

    def nearest(self, x: float, y: float, heading: float, asked: float = 0.0) -> float:
        """Return the arc length of the sample that is nearest to a pose, m, on the whole line.

        A heading that differs by a radian counts like a distance of a metre, so that at a crossing the branch is found
        that is ridden.

        Args:
            x: m.
            y: m.
            heading: rad.
            asked: arc length where it is expected, m. On a closed line a position close to it is of the same lap:
                just behind the start it is below 0.
        """
        away = (self.x - x) ** 2 + (self.y - y) ** 2 + 2.0 * (1.0 - np.cos(self.heading - heading))
        s = float(self.s[np.argmin(away)])
        if not self.closed:
            return s
        same_lap = s + self.length * round((asked - s) / self.length)
        return same_lap if abs(same_lap - asked) < SAME_LAP else s

    @classmethod
    def from_elements(
        cls,
        name: str,
        elements: Sequence[Element],
        *,
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        closed: bool = False,
        off_course_limit: float = OFF_COURSE_LIMIT,
        section_names: Sequence[str] | None = None,
        spacing: float = SAMPLE_SPACING,
    ) -> Course:
        """Build a course from elements.

        Args:
            name: name of the course.
            elements: elements in order.
            start: x, y, heading of the beginning (m, m, rad).
            closed: whether the end meets the beginning.
            off_course_limit: m.
            section_names: one name an element; neighbours with the same name form one section.
            spacing: distance of samples, m.

        Raises:
            ValueError: no element, or the number of names does not fit.
        """
        s, x, y, heading, curvature, begins = sample_elements(elements, spacing, start)
        sections: list[tuple[str, float]] = []
        if section_names is not None:
            if len(section_names) != len(elements):
                raise ValueError(f"course {name!r}: {len(section_names)} section names for {len(elements)} elements")
            for section, begin in zip(section_names, begins, strict=True):
                if not sections or sections[-1][0] != section:
                    sections.append((section, float(begin)))
        return cls(name, s, x, y, heading, curvature, closed, off_course_limit, sections=tuple(sections))
