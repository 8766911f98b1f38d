"""Queries of a course without its columns, and circuits made by formula."""

import dataclasses
import math

import numpy as np
import pytest

from bike_sim.course import projection
from bike_sim.course.course import Course
from bike_sim.course.elements import Arc, Line
from bike_sim.course.road import RunOff, wall_distances
from bike_sim.course.track import Track, find_corners


class Queries:
    """The compiled functions, called with a course."""

    @staticmethod
    def project(course: Course, x: float, y: float, s_near: float, behind: float = 1.0, ahead: float = 3.0):
        return projection.project(course.samples, x, y, s_near, behind, ahead)

    @staticmethod
    def point_at(course: Course, s: float):
        return projection.point_at(course.samples, s)

    @staticmethod
    def curvature_at(course: Course, s: float) -> float:
        return projection.curvature_at(course.samples, s)

    @staticmethod
    def preview(course: Course, x: float, y: float, yaw: float, s: float, step: float, count: int):
        points = np.full((2, count), np.nan)
        projection.preview(course.samples, (x, y, yaw), s, step, points)
        return points

    @classmethod
    def beside(cls, course: Course, s: float, offset: float) -> tuple[float, float]:
        """Return the point that lies offset to the left of the line at s."""
        x, y, tx, ty = cls.point_at(course, s)
        return x - offset * ty, y + offset * tx

    @classmethod
    def walk(cls, course: Course, s: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project the points beside the line at s one after the other, as a ride does; return s and distance."""
        near = s[0]
        found = np.empty((2, len(s)))
        for i in range(len(s)):
            near, distance, _ = cls.project(course, *cls.beside(course, s[i], offset[i]), near)
            found[:, i] = near, distance
        return found[0], found[1]


class Shapes:
    """Circuits made by formula."""

    @staticmethod
    def track_of(centre: Course, width: float = 12.0) -> Track:
        """Return a flat circuit of constant width."""
        half = np.full(len(centre.s), 0.5 * width)
        thirds = tuple((f"sector {i + 1}", i * centre.length / 3.0) for i in range(3))
        centre = dataclasses.replace(centre, closed=True, width_left=half, width_right=half.copy(), sections=thirds)
        left, right = wall_distances(centre, RunOff())
        return Track(centre, np.zeros(len(half)), left, right, find_corners(centre))

    @staticmethod
    def circle(radius: float = 100.0, width: float = 12.0) -> Track:
        return Shapes.track_of(Course.from_elements("circle", [Arc(radius, 2.0 * math.pi)], closed=True), width)

    @staticmethod
    def oval(radius: float = 50.0, straight: float = 300.0, width: float = 12.0) -> Track:
        half = [Line(straight), Arc(radius, math.pi)]
        return Shapes.track_of(Course.from_elements("oval", half + half, closed=True), width)

    @staticmethod
    def ring_points(count: int = 200, radius: float = 150.0, wave: float = 0.25, lobes: int = 3) -> np.ndarray:
        """Return points of a smooth closed line with bends both ways, counter-clockwise, the first not repeated."""
        angle = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
        r = radius * (1.0 + wave * np.cos(lobes * angle))
        return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)

    @staticmethod
    def csv_text(points: np.ndarray, right: float = 5.0, left: float = 6.0) -> str:
        rows = [f"{x!r},{y!r},{right},{left}" for x, y in points.tolist()]
        return "# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(rows) + "\n"


@pytest.fixture(scope="session")
def ask() -> type[Queries]:
    return Queries


@pytest.fixture(scope="session")
def shapes() -> type[Shapes]:
    return Shapes
