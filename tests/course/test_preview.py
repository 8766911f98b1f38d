"""Preview points lie at exact distances along the line (Weyrer et al. 2026, Eq. 5 and Fig. 6)."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.course.course import Course
from bike_sim.course.elements import Arc, Line
from bike_sim.course.files import load_course
from bike_sim.course.random_courses import CURRICULUM_PATHS, random_course

SEEDS = st.integers(0, 2**32 - 1)
STEPS = st.floats(0.05, 3.0)
CIRCLE = Course.from_elements("circle", [Arc(10.0, 2.0 * math.pi)], closed=True)


@given(STEPS, st.floats(0.0, 60.0))
def test_preview_of_a_circle_is_trigonometry(ask, step, s):
    # On the line and along it, the point at k steps stands where the circle says.
    x, y, tx, ty = ask.point_at(CIRCLE, s)
    ahead, left = ask.preview(CIRCLE, x, y, math.atan2(ty, tx), s, step, 5)
    angles = np.arange(5) * step / 10.0
    np.testing.assert_allclose(ahead, 10.0 * np.sin(angles), atol=1e-6)
    np.testing.assert_allclose(left, 10.0 * (1.0 - np.cos(angles)), atol=1e-6)


@given(st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), STEPS)
def test_preview_of_a_straight_line_is_seen_from_the_vehicle(ask, offset, yaw, step):
    # The vehicle stands `offset` left of the line, which therefore lies to its right: negative.
    line = Course.from_elements("line", [Line(100.0)])
    ahead, left = ask.preview(line, 20.0, offset, yaw, 20.0, step, 5)
    along = np.arange(5) * step
    np.testing.assert_allclose(ahead, along * math.cos(yaw) - offset * math.sin(yaw), atol=1e-9)
    np.testing.assert_allclose(left, -along * math.sin(yaw) - offset * math.cos(yaw), atol=1e-9)


@given(SEEDS, st.floats(0.0, 80.0), STEPS)
def test_points_are_one_step_of_arc_length_apart(ask, seed, s, step):
    course = random_course(np.random.default_rng(seed), CURRICULUM_PATHS[3], 100.0)
    ahead, left = ask.preview(course, 0.0, 0.0, 0.0, s, step, 5)
    for k in range(4):
        # The arc between two preview points, measured with a fine polygon between them.
        fine = np.array([ask.point_at(course, u)[:2] for u in np.linspace(s + k * step, s + (k + 1) * step, 400)])
        np.testing.assert_allclose(fine[0], [ahead[k], left[k]], atol=1e-12)
        assert np.hypot(*np.diff(fine, axis=0).T).sum() == pytest.approx(step, abs=2e-4)


@given(st.floats(0.0, 10.0))
def test_preview_runs_over_the_joint_of_a_closed_course(ask, before):
    course = load_course("benchmark")
    one = ask.preview(course, 0.0, 0.0, 0.0, course.length - before, 2.5, 8)
    other = ask.preview(course, 0.0, 0.0, 0.0, 2.0 * course.length - before, 2.5, 8)
    np.testing.assert_allclose(one, other, atol=1e-9)
    beyond = np.arange(8) * 2.5 - before
    # The start straight is 15 m of x axis; in its last sample piece the circle begins.
    on_start = (beyond >= 0.0) & (beyond <= 14.8)
    np.testing.assert_allclose(one[0][on_start], beyond[on_start], atol=1e-9)
    np.testing.assert_allclose(one[1][on_start], 0.0, atol=1e-9)


def test_preview_goes_on_straight_beyond_an_open_end(ask):
    course = Course.from_elements("hook", [Line(10.0), Arc(10.0, math.pi / 2.0)])
    ahead, left = ask.preview(course, 0.0, 0.0, 0.0, course.length - 1.0, 2.0, 4)
    np.testing.assert_allclose(ahead[1:], 20.0, atol=1e-9)
    np.testing.assert_allclose(left[1:], 10.0 + np.array([1.0, 3.0, 5.0]), atol=1e-9)
