"""Random paths of the training families (Weyrer et al. 2026, Sect. 4.1, Tables 3 and 4)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from bike_sim.course.course import MAX_LENGTH, OFF_COURSE_LIMIT, SAMPLE_SPACING, Course
from bike_sim.course.elements import Arc, Element, Line, Quintic

LINE_LENGTH = (5.0, 15.0)
"""Length of straight elements, m (Table 3)."""
ARC_ANGLE = (math.pi / 4.0, math.pi / 2.0)
"""Angle of circular elements, rad (Table 3)."""
MIX = (0.4, 0.4, 0.2)
"""Shares of circular, quintic and straight elements (Sect. 4.1)."""


@dataclass(frozen=True)
class PathRanges:
    """Intervals of the elements that the curriculum widens (Table 4), all in m.

    Attributes:
        radius_min: least radius of circular elements. radius_max: largest.
        quintic_length_min: least extent of quintic elements. quintic_length_max: largest.
        quintic_width_min: least lateral offset. quintic_width_max: largest.
    """

    radius_min: float
    radius_max: float
    quintic_length_min: float
    quintic_length_max: float
    quintic_width_min: float
    quintic_width_max: float

    def __post_init__(self) -> None:
        """Refuse empty, negative or non-finite intervals, and elements longer than any course."""
        for spec in fields(self):
            value = getattr(self, spec.name)
            if not math.isfinite(value) or value <= 0.0:
                raise ValueError(f"path range {spec.name} must be positive and finite, got {value!r}")
            if value > MAX_LENGTH:
                raise ValueError(f"path range {spec.name} must be at most {MAX_LENGTH:g} m, got {value!r}")
        for name in ("radius", "quintic_length", "quintic_width"):
            low, high = getattr(self, f"{name}_min"), getattr(self, f"{name}_max")
            if low > high:
                raise ValueError(f"path range {name} is empty: {low} > {high}")


CURRICULUM_PATHS = (
    PathRanges(14.0, 14.0, 20.0, 22.0, 2.0, 2.0),
    PathRanges(12.0, 14.0, 18.0, 22.0, 2.0, 4.0),
    PathRanges(10.0, 14.0, 16.0, 22.0, 2.0, 6.0),
    PathRanges(8.0, 14.0, 14.0, 22.0, 2.0, 8.0),
)
"""Path ranges of the four parts of the curriculum (Table 4)."""


def random_elements(rng: np.random.Generator, ranges: PathRanges, length: float) -> list[Element]:
    """Draw elements until they are at least as long as wanted.

    The first element is never a circle, because a perturbed bicycle could not follow it (Sect. 4.1).

    Args:
        rng: random generator.
        ranges: intervals of the elements.
        length: wanted length, m.
    """
    elements: list[Element] = []
    total = 0.0
    while total < length:
        element = _draw_element(rng, ranges, first=not elements)
        elements.append(element)
        total += element.length
    return elements


def _draw_element(rng: np.random.Generator, ranges: PathRanges, first: bool) -> Element:
    circle, quintic, line = MIX
    if first:
        circle = 0.0
    choice = rng.uniform(0.0, circle + quintic + line)
    sign = 1.0 if rng.integers(2) else -1.0
    if choice < circle:
        return Arc(rng.uniform(ranges.radius_min, ranges.radius_max), sign * rng.uniform(*ARC_ANGLE))
    if choice < circle + quintic:
        extent = rng.uniform(ranges.quintic_length_min, ranges.quintic_length_max)
        return Quintic(extent, sign * rng.uniform(ranges.quintic_width_min, ranges.quintic_width_max))
    return Line(rng.uniform(*LINE_LENGTH))


def random_course(
    rng: np.random.Generator,
    ranges: PathRanges,
    length: float,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    off_course_limit: float = OFF_COURSE_LIMIT,
) -> Course:
    """Draw a random path.

    Args:
        rng: random generator; the same state gives the same path.
        ranges: intervals of the elements.
        length: the path is at least this long, m.
        start: x, y, heading of its beginning (m, m, rad).
        off_course_limit: m.

    Raises:
        ValueError: a length that is not positive, or beyond MAX_LENGTH.
    """
    if not 0.0 < length <= MAX_LENGTH:
        raise ValueError(f"length of a random path must be above 0 and at most {MAX_LENGTH:g} m, got {length!r} m")
    elements = random_elements(rng, ranges, length)
    return Course.from_elements(
        "random", elements, start=start, off_course_limit=off_course_limit, spacing=SAMPLE_SPACING
    )
