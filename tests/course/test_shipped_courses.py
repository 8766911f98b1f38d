"""Every shipped course is found here by itself; the benchmark path also holds what its source says of it."""

import math
from importlib import resources

import numpy as np
import pytest
import yaml

from bike_sim.course.files import load_course, shipped_courses
from bike_sim.course.random_courses import CURRICULUM_PATHS
from bike_sim.course.reading import PATH_FORMAT

A = 5.0  # m, the length unit of the benchmark path


@pytest.fixture(params=shipped_courses())
def course(request):
    return load_course(request.param)


def document(name):
    return yaml.safe_load((resources.files("bike_sim") / f"config/courses/{name}.yaml").read_text())


def test_a_shipped_course_says_what_it_is_and_has_its_sections_in_order(course):
    text = document(course.name)
    assert text["format"] == PATH_FORMAT
    assert len(text["description"]) > 20
    gap = math.hypot(course.x[-1] - course.x[0], course.y[-1] - course.y[0])
    turns = (course.heading[-1] - course.heading[0]) / (2.0 * math.pi)
    assert gap < 1e-9 if course.closed else gap > 1.0
    assert not course.closed or turns == pytest.approx(round(turns), abs=1e-12)
    begins = [begin for _, begin in course.sections]
    assert begins[0] == 0.0
    assert begins == sorted(set(begins))
    assert begins[-1] < course.length


@pytest.fixture(scope="module")
def benchmark():
    return load_course("benchmark")


@pytest.fixture(scope="module")
def sections(benchmark):
    """Curvature samples (1/m) well inside each section, and its length, m."""
    ends = [begin for _, begin in benchmark.sections[1:]] + [benchmark.length]
    return {
        name: (benchmark.curvature[(benchmark.s > begin + 0.1) & (benchmark.s < end - 0.1)], end - begin)
        for (name, begin), end in zip(benchmark.sections, ends, strict=True)
    }


def test_benchmark_is_about_as_long_as_drawn_and_has_its_parts_in_order(benchmark, sections):
    assert benchmark.closed
    assert 300.0 < benchmark.length < 400.0
    assert benchmark.off_course_limit == 3.5
    parts = [name for name in sections if "straight" not in name]
    assert parts == ["full circle", "slalom", "flat curve", "soft lane change", "hard lane change", "closing curve"]
    for name, (curvature, _) in sections.items():
        if "straight" in name:
            np.testing.assert_allclose(curvature, 0.0, atol=1e-12, err_msg=name)
    assert benchmark.sections[0][0] == "start straight"
    np.testing.assert_allclose(benchmark.curvature[:100], 0.0, atol=1e-12)
    # Fig. 12 plots the first 200 m; the text follows the circle, the slalom and the flat curve on it.
    for name, begin in benchmark.sections[:6]:
        assert begin < 190.0, name


def test_bends_of_the_benchmark_are_those_of_the_text(sections, benchmark):
    """A left turn of radius 2A entered with a step, bends equal to both sides, one flatter than all of training."""
    curvature, length = sections["full circle"]
    np.testing.assert_allclose(curvature, 1.0 / (2.0 * A), rtol=1e-12)
    assert length == pytest.approx(2.0 * math.pi * 2.0 * A, rel=1e-12)
    curvature, length = sections["slalom"]
    assert set(np.round(curvature, 12)) == {-0.1, 0.1}
    assert np.sum(curvature > 0.0) == pytest.approx(np.sum(curvature < 0.0), abs=6)
    changes = np.flatnonzero(np.diff(np.sign(curvature)))
    np.testing.assert_allclose(np.diff(changes) * benchmark.spacing, 0.5 * math.pi * 10.0, atol=0.2)
    begin = dict(benchmark.sections)["slalom"]
    headings = np.interp([begin, begin + length], benchmark.s, benchmark.heading)
    assert headings[1] == pytest.approx(headings[0], abs=1e-2)
    curvature, length = sections["flat curve"]
    np.testing.assert_allclose(curvature, 1.0 / (4.0 * A), rtol=1e-12)
    assert length * curvature[0] == pytest.approx(math.pi, rel=1e-12)
    assert 1.0 / curvature[0] > CURRICULUM_PATHS[3].radius_max
    sharpest = np.abs(sections["hard lane change"][0]).max()
    assert sharpest == pytest.approx(np.abs(benchmark.curvature).max(), rel=1e-12)
    assert math.atan(7.0**2 * sharpest / 9.81) > math.radians(45.0)


def test_soft_lane_change_is_in_the_training_family_and_the_hard_one_is_not():
    quintics = {
        element["section"]: element["quintic"] for element in document("benchmark")["elements"] if "quintic" in element
    }
    family = CURRICULUM_PATHS[3]
    soft, hard = quintics["soft lane change"], quintics["hard lane change"]
    assert family.quintic_length_min <= soft["length_m"] <= family.quintic_length_max
    assert family.quintic_width_min <= abs(soft["width_m"]) <= family.quintic_width_max
    assert hard == {"length_m": 2.0 * A, "width_m": -A}
    assert hard["length_m"] < family.quintic_length_min


def test_junction_turns_right_from_north_to_east():
    course = load_course("junction")
    assert course.heading[0] == pytest.approx(math.pi / 2.0)
    assert course.heading[-1] == pytest.approx(0.0, abs=1e-12)
    assert course.curvature.min() == pytest.approx(-1.0)
    assert course.curvature.max() == 0.0
