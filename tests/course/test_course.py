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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda course: {"width_left": np.ones(3)}, "width_left has 3 samples"),
        (lambda course: {"s": course.s**2}, "equal steps"),
        (lambda course: {"closed": True}, r"ends are .* m and .* rad apart"),
        *((lambda _, limit=limit: {"off_course_limit": limit}, "off-course limit") for limit in (0.0, -1.0, math.nan)),
    ],
)
def test_what_is_no_course_is_refused(course, change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(course, **change(course))


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
    with pytest.raises(ValueError, match="1 section names for 2 elements"):
        Course.from_elements("test", [Line(1.0), Line(1.0)], section_names=["one"])
