"""Rides beside open courses of known form, straight on behind their ends."""

from __future__ import annotations

import math

import numpy as np

from bike_sim.course.course import Course
from bike_sim.course.projection import project


def arc(length: float, radius: float = math.inf) -> Course:
    """A straight line along x, or a turn from the origin, to the left where the radius is positive."""
    s = np.linspace(0.0, length, round(length / 0.1) + 1)
    return Course("arc", s, *_line(s, length, radius), np.full(len(s), 1.0 / radius))


def _line(way: np.ndarray, length: float, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    base = np.clip(way, 0.0, length)
    heading = base / radius
    x, y = (base, 0.0 * base) if math.isinf(radius) else (radius * np.sin(heading), radius * (1.0 - np.cos(heading)))
    return x + (way - base) * np.cos(heading), y + (way - base) * np.sin(heading), heading


def beside(course: Course, way: np.ndarray, offset: float) -> dict[str, np.ndarray]:
    """Places at an offset to the left of a course, with what their projection says of them, and the heading there."""
    bend = float(course.curvature[0])
    x, y, heading = _line(way, course.length, 1.0 / bend if bend else math.inf)
    x, y = x - offset * np.sin(heading), y + offset * np.cos(heading)
    near = np.minimum(way, course.length)
    found = [project(course.samples, x[k], y[k], near[k], 1.0, 3.0) for k in range(len(way))]
    progress, lateral, _ = np.array(found).T
    return {"progress": progress, "lateral_error": lateral, "x": x, "y": y, "yaw": heading}
