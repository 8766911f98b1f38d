"""Random paths obey Tables 3 and 4 and Sect. 4.1 of Weyrer et al. (2026)."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.course.elements import Arc, Line, Quintic
from bike_sim.course.random_courses import CURRICULUM_PATHS, random_course, random_elements

SEEDS = st.integers(0, 2**32 - 1)
PARTS = st.sampled_from(CURRICULUM_PATHS)

TABLE_4 = [  # radius, polynomial length, polynomial width, each (a, b) in m
    ((14, 14), (20, 22), (2, 2)),
    ((12, 14), (18, 22), (2, 4)),
    ((10, 14), (16, 22), (2, 6)),
    ((8, 14), (14, 22), (2, 8)),
]


@pytest.mark.parametrize("part", range(4))
def test_elements_lie_in_the_intervals_and_fill_them(part):
    radius, length, width = TABLE_4[part]
    elements = random_elements(np.random.default_rng(part), CURRICULUM_PATHS[part], 20_000.0)
    arcs = [e for e in elements if isinstance(e, Arc)]
    quintics = [e for e in elements if isinstance(e, Quintic)]
    lines = [e for e in elements if isinstance(e, Line)]
    draws = {
        "radius": ([e.radius for e in arcs], radius),
        "angle": ([abs(e.angle) for e in arcs], (math.radians(45), math.radians(90))),
        "quintic length": ([e.extent for e in quintics], length),
        "quintic width": ([abs(e.width) for e in quintics], width),
        "line length": ([e.length for e in lines], (5, 15)),
    }
    for name, (values, (low, high)) in draws.items():
        assert low <= min(values), name
        assert max(values) <= high, name
        # Uniform: with hundreds of draws both ends are come near to, and the mean is the middle within 5 sigma.
        assert np.ptp(values) >= 0.9 * (high - low), name
        assert abs(np.mean(values) - 0.5 * (low + high)) <= 5.0 * (high - low) / math.sqrt(12.0 * len(values)), name


def test_mix_is_40_40_20_and_signs_are_even():
    elements = random_elements(np.random.default_rng(1), CURRICULUM_PATHS[3], 200_000.0)[1:]
    count = len(elements)
    for kind, share in ((Arc, 0.4), (Quintic, 0.4), (Line, 0.2)):
        found = sum(isinstance(e, kind) for e in elements)
        assert abs(found - share * count) < 4.0 * math.sqrt(count * share * (1.0 - share)), kind
    for signs in (
        [e.angle > 0.0 for e in elements if isinstance(e, Arc)],
        [e.width > 0.0 for e in elements if isinstance(e, Quintic)],
    ):
        assert abs(sum(signs) - 0.5 * len(signs)) < 2.0 * math.sqrt(len(signs))


def test_first_element_is_never_a_circle():
    first = [random_elements(np.random.default_rng(seed), CURRICULUM_PATHS[3], 1.0)[0] for seed in range(500)]
    assert not any(isinstance(e, Arc) for e in first)
    assert any(isinstance(e, Line) for e in first)
    assert any(isinstance(e, Quintic) for e in first)


def test_full_circles_are_as_rare_as_published():
    # Sect. 6: of 10^4 paths of 120 m from the last part, 20 have five circular elements in a row that bend the same
    # way (ours: 27, published count and ours are 1 sigma apart). Of 4000, 8 to 11 are expected.
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(4000):
        run, last = 0, 0.0
        for element in random_elements(rng, CURRICULUM_PATHS[3], 120.0):
            sign = math.copysign(1.0, element.angle) if isinstance(element, Arc) else 0.0
            run = run + 1 if sign and sign == last else int(sign != 0.0)
            last = sign
            if run == 5:
                found += 1
                break
    assert 1 <= found <= 25


@given(SEEDS, PARTS, st.floats(10.0, 600.0))
def test_path_is_just_long_enough(seed, ranges, length):
    elements = random_elements(np.random.default_rng(seed), ranges, length)
    lengths = [e.length for e in elements]
    assert sum(lengths) >= length > sum(lengths[:-1])


@given(SEEDS, PARTS)
def test_same_seed_same_path_and_another_another(seed, ranges):
    one, other, another = (random_course(np.random.default_rng(k), ranges, 100.0) for k in (seed, seed, seed + 1))
    np.testing.assert_array_equal(one.table, other.table)
    assert not np.array_equal(one.table, another.table)


@given(SEEDS, PARTS)
def test_path_begins_where_it_should_without_curvature(seed, ranges):
    course = random_course(np.random.default_rng(seed), ranges, 100.0, start=(4.0, -3.0, 2.0))
    assert (course.x[0], course.y[0], course.heading[0]) == pytest.approx((4.0, -3.0, 2.0), abs=1e-12)
    assert course.curvature[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(CURRICULUM_PATHS[0])])
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_ranges_must_be_positive_and_finite(field, bad):
    with pytest.raises(ValueError, match=f"{field} must be positive"):
        dataclasses.replace(CURRICULUM_PATHS[3], **{field: bad})


@pytest.mark.parametrize("name", ["radius", "quintic_length", "quintic_width"])
def test_empty_ranges_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} is empty"):
        dataclasses.replace(CURRICULUM_PATHS[3], **{f"{name}_min": 30.0})
