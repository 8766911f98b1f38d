"""What a course refuses, and its sections."""

import dataclasses
import math

import numpy as np
import pytest

from bike_sim.course.course import Course
from bike_sim.course.elements import Arc, Line


@pytest.fixture
def course():
    return Course.from_elements("test", [Line(10.0), Arc(5.0, 1.0)])


@pytest.mark.parametrize("column", ["x", "y", "heading", "curvature"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_value_that_is_not_finite_is_named_with_its_sample(course, column, value):
    broken = getattr(course, column).copy()
    broken[7] = value
    with pytest.raises(ValueError, match=f"{column} is {value} at sample 7"):
        dataclasses.replace(course, **{column: broken})


def test_columns_must_be_equally_long(course):
    with pytest.raises(ValueError, match="width_left has 3 samples"):
        dataclasses.replace(course, width_left=np.ones(3))


def test_arc_length_must_be_uniform(course):
    with pytest.raises(ValueError, match="equal steps"):
        dataclasses.replace(course, s=course.s**2)


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, math.inf])
def test_off_course_limit_must_be_positive(course, limit):
    with pytest.raises(ValueError, match="off-course limit"):
        dataclasses.replace(course, off_course_limit=limit)


def test_open_line_cannot_be_called_closed(course):
    with pytest.raises(ValueError, match=r"ends are .* m and .* rad apart"):
        dataclasses.replace(course, closed=True)


def test_joint_with_a_kink_is_not_closed():
    # A teardrop: back at its beginning, but heading elsewhere.
    legs = [Line(10.0), Arc(10.0, 1.5 * math.pi), Line(10.0)]
    assert Course.from_elements("teardrop", legs).x[-1] == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(ValueError, match="rad apart"):
        Course.from_elements("teardrop", legs, closed=True)


def test_neighbours_of_the_same_name_form_one_section():
    elements = [Line(10.0), Arc(5.0, 1.0), Arc(5.0, -1.0), Line(3.0)]
    course = Course.from_elements("test", elements, section_names=["in", "bends", "bends", "out"])
    assert course.sections == (("in", 0.0), ("bends", 10.0), ("out", 20.0))


def test_section_names_must_fit_the_elements():
    with pytest.raises(ValueError, match="1 section names for 2 elements"):
        Course.from_elements("test", [Line(1.0), Line(1.0)], section_names=["one"])
