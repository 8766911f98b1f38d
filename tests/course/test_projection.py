"""Nearest point, signed distance and heading: exact where they are known, continuous everywhere."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.course.course import Course
from bike_sim.course.elements import Arc, Line
from bike_sim.course.files import load_course
from bike_sim.course.projection import wrap_angle
from bike_sim.course.random_courses import CURRICULUM_PATHS, random_course, random_elements

SEEDS = st.integers(0, 2**32 - 1)
OFFSETS = st.floats(-3.0, 3.0)

LINE = Course.from_elements("line", [Line(50.0)], start=(2.0, 1.0, 0.5))
LEFT_CIRCLE = Course.from_elements("left", [Arc(10.0, 2.0 * math.pi)], closed=True)
RIGHT_CIRCLE = Course.from_elements("right", [Arc(10.0, -2.0 * math.pi)], closed=True)
EIGHT = Course.from_elements("eight", [Arc(8.0, 2.0 * math.pi), Arc(8.0, -2.0 * math.pi)], closed=True)
# Their length divided by the spacing of their samples is rounded to a little more than the number of pieces.
ROUNDED = [
    Course.from_elements("rounded", [Arc(radius, 2.0 * math.pi)], closed=True) for radius in (30.53, 57.17, 64.2)
]
# Crosses itself at right angles in (15, 0): straight on, then three quarters of a circle back over it.
CROSSING = Course.from_elements("crossing", [Line(30.0), Arc(15.0, 1.5 * math.pi), Line(30.0)])


@given(st.floats(0.0, 50.0), OFFSETS)
def test_line_is_exact(ask, s, offset):
    x, y = 2.0 + s * math.cos(0.5) - offset * math.sin(0.5), 1.0 + s * math.sin(0.5) + offset * math.cos(0.5)
    found = ask.project(LINE, x, y, s)
    assert found == pytest.approx((s, offset, 0.5), abs=1e-9)


@given(st.floats(0.0, 2.0 * math.pi), st.floats(-5.0, 5.0), st.booleans())
def test_circle_is_exact(ask, angle, offset, left):
    side = 1.0 if left else -1.0
    radius = 10.0 - side * offset  # left of the line is inside a left circle, outside a right one
    x, y = radius * math.sin(angle), side * (10.0 - radius * math.cos(angle))
    s, distance, heading = ask.project(LEFT_CIRCLE if left else RIGHT_CIRCLE, x, y, 10.0 * angle)
    assert s == pytest.approx(10.0 * angle, abs=1e-7)
    assert distance == pytest.approx(offset, abs=1e-8)
    assert wrap_angle(heading - side * angle) == pytest.approx(0.0, abs=1e-6)


@given(SEEDS, st.floats(5.0, 95.0), OFFSETS, st.floats(-0.9, 0.9), st.floats(-math.pi, math.pi))
def test_random_path_gives_back_what_was_put_beside_it(ask, seed, s, offset, slip, turn):
    # Wherever the path lies, on both sides. Offsets stay below the least radius of 8 m: the foot is the nearest point.
    course = random_course(np.random.default_rng(seed), CURRICULUM_PATHS[3], 100.0, start=(-7.0, 4.0, turn))
    x, y, tx, ty = ask.point_at(course, s)
    found, distance, heading = ask.project(course, x - offset * ty, y + offset * tx, s + slip)
    # In the 0.1 m piece that holds a step of curvature the interpolated line is 1e-4 m off at most.
    assert found == pytest.approx(s, abs=1e-3)
    assert distance == pytest.approx(offset, abs=1e-4)
    assert wrap_angle(heading - math.atan2(ty, tx)) == pytest.approx(0.0, abs=1e-3)


@given(SEEDS, st.floats(5.0, 95.0), st.floats(-3.4, 3.4), st.floats(-3.4, 3.4))
def test_no_point_of_the_window_is_nearer(ask, seed, s_near, dx, dy):
    course = random_course(np.random.default_rng(seed), CURRICULUM_PATHS[3], 100.0)
    x, y, _, _ = ask.point_at(course, s_near)
    x, y = x + dx, y + dy
    _, distance, _ = ask.project(course, x, y, s_near)
    window = np.arange(s_near - 1.0, s_near + 3.0, 0.005)
    points = np.array([ask.point_at(course, s)[:2] for s in window])
    brute = np.hypot(points[:, 0] - x, points[:, 1] - y).min()
    assert abs(distance) <= brute + 1e-6
    # And it is the distance of a real point: the search reaches at most two samples beyond the window.
    assert abs(distance) >= brute - 2.1 * course.spacing


@pytest.mark.parametrize(
    "course", [EIGHT, CROSSING, LEFT_CIRCLE, load_course("benchmark")], ids=lambda course: course.name
)
@pytest.mark.parametrize("step", [0.05, 0.35, 1.5], ids=lambda step: f"{step} m a step")
def test_progress_is_continuous_over_crossings_and_grows_over_laps(ask, course, step):
    # Up to 0.8 m beside the line, both sides; 1.5 m a step is 30 m/s at a control period of 50 ms.
    s = np.arange(0.0, (2.5 if course.closed else 1.0) * course.length, step)
    offset = 0.8 * np.sin(0.7 * s)
    found, distance = ask.walk(course, s, offset)
    np.testing.assert_allclose(found, s, atol=0.02)
    np.testing.assert_allclose(distance, offset, atol=1e-3)


def test_without_the_window_the_other_branch_of_a_crossing_would_win(ask):
    # The window is what the test above stands on: in (15, 0.2) a wide one sees the other branch, which is nearer.
    near, distance, _ = ask.project(CROSSING, 15.0, 0.2, 15.0)
    assert (near, distance) == pytest.approx((15.0, 0.2), abs=1e-9)
    far, nothing, _ = ask.project(CROSSING, 15.0, 0.2, 15.0, 1.0, 200.0)
    assert far == pytest.approx(30.0 + 22.5 * math.pi + 15.0 - 0.2, abs=1e-3)
    assert nothing == pytest.approx(0.0, abs=1e-6)


@given(st.floats(0.0, 4.0), OFFSETS)
def test_beyond_an_open_end_the_distance_is_that_of_the_end(ask, beyond, offset):
    x, y = ask.beside(LINE, 50.0 + beyond, offset)
    s, distance, heading = ask.project(LINE, x, y, 49.5)
    assert s == pytest.approx(50.0, abs=1e-9)
    assert abs(distance) == pytest.approx(math.hypot(beyond, offset), abs=1e-9)
    assert distance * offset >= 0.0 or abs(offset) < 1e-9
    assert heading == pytest.approx(0.5, abs=1e-9)


@given(st.floats(-30.0, 90.0), OFFSETS, st.floats(-1000.0, 1000.0))
def test_any_guess_gives_a_point_of_an_open_line(ask, s, offset, s_near):
    found, distance, _ = ask.project(LINE, *ask.beside(LINE, s, offset), s_near)
    assert 0.0 <= found <= LINE.length
    x, y = ask.beside(LINE, s, offset)
    fx, fy, _, _ = ask.point_at(LINE, found)
    assert abs(distance) == pytest.approx(math.hypot(x - fx, y - fy), abs=1e-9)


def test_open_line_goes_on_straight_beyond_its_ends(ask):
    cos, sin = math.cos(0.5), math.sin(0.5)
    assert ask.point_at(LINE, -3.0) == pytest.approx((2.0 - 3.0 * cos, 1.0 - 3.0 * sin, cos, sin), abs=1e-12)
    assert ask.point_at(LINE, 60.0) == pytest.approx((2.0 + 60.0 * cos, 1.0 + 60.0 * sin, cos, sin), abs=1e-12)


@given(st.floats(-200.0, 400.0))
def test_closed_line_repeats(ask, s):
    here, there = ask.point_at(EIGHT, s), ask.point_at(EIGHT, s + EIGHT.length)
    assert there == pytest.approx(here, abs=1e-9)


@given(st.integers(-3, 3), st.floats(-300.0, -3.0), st.booleans())
def test_a_closed_line_has_no_gap_where_it_closes(ask, lap, magnitude, before):
    """However little a point lies before the seam: the remainder of -1e-20 is rounded to the whole length."""
    beside = (-1.0 if before else 1.0) * 10.0**magnitude
    for course in (LEFT_CIRCLE, EIGHT, *ROUNDED):
        s = lap * course.length + beside
        assert ask.point_at(course, s) == pytest.approx(ask.point_at(course, 0.0), abs=3e-3)
        found, distance, _ = ask.project(course, float(course.x[0]) + beside, float(course.y[0]) - abs(beside), 0.0)
        assert abs(found) < 3e-3
        assert abs(distance) < 3e-3


@given(SEEDS)
def test_line_and_tangent_between_samples_are_those_of_the_elements(ask, seed):
    coarse = random_course(np.random.default_rng(seed), CURRICULUM_PATHS[3], 60.0)
    fine = Course.from_elements(
        "fine", random_elements(np.random.default_rng(seed), CURRICULUM_PATHS[3], 60.0), spacing=coarse.spacing / 8.0
    )
    for i in range(len(fine.s)):
        x, y, tx, ty = ask.point_at(coarse, fine.s[i])
        # 3e-5 m: what a step of curvature of 1/4 1/m (from 8 m left to 8 m right) does within a piece of 0.1 m.
        assert math.hypot(x - fine.x[i], y - fine.y[i]) < 1e-4
        assert math.hypot(tx - math.cos(fine.heading[i]), ty - math.sin(fine.heading[i])) < 7e-3


def test_curvature_keeps_its_steps(ask):
    course = Course.from_elements("step", [Line(10.0), Arc(8.0, 1.0), Arc(8.0, -1.0)])
    values = {ask.curvature_at(course, s) for s in np.linspace(0.0, course.length, 1000)}
    assert values == {0.0, 0.125, -0.125}
    assert ask.curvature_at(course, 9.8) == 0.0
    assert ask.curvature_at(course, 10.2) == 0.125
    assert ask.curvature_at(course, course.length) == -0.125


@given(st.floats(-100.0, 100.0))
def test_wrapped_angle_is_the_same_direction(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)
