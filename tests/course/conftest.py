"""Queries of a course without its columns."""

import numpy as np
import pytest

from bike_sim.course import projection
from bike_sim.course.course import Course


class Queries:
    """The compiled functions, called with a course."""

    @staticmethod
    def project(course: Course, x: float, y: float, s_near: float, behind: float = 1.0, ahead: float = 3.0):
        return projection.project(
            course.x, course.y, course.heading, course.spacing, course.closed, x, y, s_near, behind, ahead
        )

    @staticmethod
    def point_at(course: Course, s: float):
        return projection.point_at(course.x, course.y, course.heading, course.spacing, course.closed, s)

    @staticmethod
    def curvature_at(course: Course, s: float) -> float:
        return projection.curvature_at(course.curvature, course.spacing, course.closed, s)

    @staticmethod
    def preview(course: Course, x: float, y: float, yaw: float, s: float, step: float, count: int):
        out_x, out_y = np.full(count, np.nan), np.full(count, np.nan)
        projection.preview(
            course.x, course.y, course.heading, course.spacing, course.closed, x, y, yaw, s, step, out_x, out_y
        )
        return out_x, out_y

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


@pytest.fixture(scope="session")
def ask() -> type[Queries]:
    return Queries
