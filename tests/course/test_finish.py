"""What lies behind the end of an open course is not judged."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.course.course import Course
from bike_sim.course.finish import Finish, FinishCut, find_finish, up_to_finish
from tests.beside import arc, beside

PERIOD = 0.05  # s


def ridden(course: Course, speed: float, offset: float, behind: int, start: float = 0.0) -> dict[str, np.ndarray]:
    """Ride beside a course at a constant offset, straight on behind its end, and project every sample."""
    count = math.ceil((course.length - start) / (speed * PERIOD)) + behind
    time = PERIOD * np.arange(count)
    found = beside(course, start + speed * time, offset)
    return {name: found[name] for name in ("progress", "lateral_error", "x", "y")} | {"time": time}


@pytest.mark.parametrize("radius", [math.inf, 20.0, -15.0])
@pytest.mark.parametrize("speed", [4.0, 7.0])
@pytest.mark.parametrize("behind", [1, 2, 5])
def test_the_distance_to_the_end_point_is_no_error(radius: float, speed: float, behind: int) -> None:
    course = arc(30.0, radius)
    ride = ridden(course, speed, offset=0.03, behind=behind, start=0.013)
    progress, lateral, _, _, time = up_to_finish(Finish.of(course), *ride.values())
    assert np.abs(lateral).max() == pytest.approx(0.03, abs=1e-6)
    assert progress[-1] == pytest.approx(30.0, abs=1e-9)
    assert np.all(np.diff(progress) > 0.0)
    assert time[-1] == pytest.approx((30.0 - 0.013) / speed, abs=2e-6)
    if behind > 1:
        assert np.abs(ride["lateral_error"]).max() > 0.1, "the projection itself tells the distance to the end point"


@given(extra=st.integers(1, 6), speed=st.sampled_from([4.0, 7.0]), offset=st.floats(-0.3, 0.3))
def test_a_ride_is_the_same_however_late_it_was_stopped(extra: int, speed: float, offset: float) -> None:
    course = arc(12.0, 20.0)
    first, later = (
        up_to_finish(Finish.of(course), *ridden(course, speed, offset, n, 0.007).values()) for n in (1, 1 + extra)
    )
    for a, b in zip(first, later, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_closed_course_has_no_finish() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 101)
    circle = Course("circle", 10.0 * angle, 10.0 * np.sin(angle), 10.0 - 10.0 * np.cos(angle), angle, angle * 0 + 0.1)
    closed = Course(**{**vars(circle), "closed": True})
    assert Finish.of(closed) is None
    columns = [np.array([61.0, 62.0, 63.5]), np.array([0.1, 0.2, 0.3]), np.zeros(3), np.ones(3)]
    for given_column, kept in zip(columns, up_to_finish(None, *columns), strict=True):
        np.testing.assert_array_equal(given_column, kept)


def test_a_ride_that_does_not_arrive_is_kept_whole() -> None:
    finish = Finish(10.0, 10.0, 0.0, 0.0)
    way = np.array([8.0, 9.0, 9.9])
    assert [len(column) for column in up_to_finish(finish, way, way * 0, way, way * 0)] == [3, 3, 3, 3]


def test_a_sample_on_the_finish_is_the_last_one_as_it_is() -> None:
    cut = find_finish(10.0, [9.0, 10.0, 11.0])
    assert cut == FinishCut(1, 1.0)
    np.testing.assert_array_equal(cut.interpolate([0.1, 0.2, 0.3]), [0.1, 0.2])
    assert len(cut.hold(np.array([1, 2, 3]))) == 2


@pytest.mark.parametrize("progress", [[], [10.5, 11.0], [np.nan, 10.5], [np.nan, np.nan]])
def test_without_a_sample_before_the_finish_nothing_is_cut(progress: list[float]) -> None:
    assert find_finish(10.0, progress) is None


def test_unknown_places_are_left_as_they_are() -> None:
    finish = Finish(10.0, 10.0, 0.0, 0.0)
    way, lateral = finish.extend([9.9, 10.0, 10.0], [0.1, 0.4, 0.5], [9.9, np.nan, 10.4], [0.1, 0.0, 0.1])
    np.testing.assert_allclose(way, [9.9, 10.0, 10.4])
    np.testing.assert_allclose(lateral, [0.1, 0.4, 0.1])
