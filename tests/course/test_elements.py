"""Elements against closed forms: where they end, how long they are, how they bend."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from bike_sim.course.elements import Arc, Line, Quintic, sample_elements

RADII = st.floats(0.5, 100.0)
ANGLES = st.floats(-2.0 * math.pi, 2.0 * math.pi).filter(lambda angle: abs(angle) > 0.01)
EXTENTS = st.floats(8.0, 40.0)
WIDTHS = st.floats(-10.0, 10.0)

# Arcs shorter than the distance of samples would bend a line between samples that know nothing of it.
ARCS = st.builds(Arc, RADII, ANGLES).filter(lambda arc: arc.length > 0.2)
ELEMENTS = st.one_of(st.builds(Line, st.floats(0.5, 50.0)), ARCS, st.builds(Quintic, EXTENTS, WIDTHS))
CHAINS = st.lists(ELEMENTS, min_size=1, max_size=6)


def end_of(element) -> list[float]:
    return [float(column[-1]) for column in element.trace(np.array([element.length]))[:3]]


@given(RADII, ANGLES)
def test_arc_ends_where_trigonometry_says(radius, angle):
    element = Arc(radius, angle)
    side = math.copysign(1.0, angle)
    expected = [radius * math.sin(abs(angle)), side * radius * (1.0 - math.cos(angle)), angle]
    np.testing.assert_allclose(end_of(element), expected, atol=1e-12 * radius)
    assert element.length == pytest.approx(radius * abs(angle), rel=1e-14)
    assert element.trace(np.array([0.3 * element.length]))[3][0] == pytest.approx(side / radius, rel=1e-14)


@given(EXTENTS, WIDTHS)
def test_quintic_ends_straight_beside_its_beginning_and_is_odd_about_its_middle(extent, width):
    element = Quintic(extent, width)
    np.testing.assert_allclose(end_of(element), [extent, width, 0.0], atol=1e-12)
    s = np.linspace(0.0, element.length, 101)
    x, y, heading, curvature = element.trace(s)
    np.testing.assert_allclose(x + x[::-1], extent, atol=1e-9)
    np.testing.assert_allclose(y + y[::-1], width, atol=1e-9)
    np.testing.assert_allclose(heading, heading[::-1], atol=1e-8)
    np.testing.assert_allclose(curvature, -curvature[::-1], atol=1e-8)
    np.testing.assert_allclose(curvature[[0, -1]], 0.0, atol=1e-12)


@given(EXTENTS, WIDTHS, st.floats(0.0, 1.0))
def test_quintic_is_read_back_at_its_true_arc_length(extent, width, part):
    element = Quintic(extent, width)
    whole, _ = quad(lambda u: math.hypot(extent, width * 30.0 * u**2 * (1.0 - u) ** 2), 0.0, 1.0, epsabs=1e-11)
    assert element.length == pytest.approx(whole, abs=1e-8)
    s = part * element.length
    x, _, _, _ = element.trace(np.array([s]))
    slope = width / extent
    travelled, _ = quad(lambda v: math.hypot(1.0, slope * 30.0 * (v / extent * (1.0 - v / extent)) ** 2), 0.0, x[0])
    assert travelled == pytest.approx(s, abs=1e-7)


def test_quintic_peak_slope_is_that_of_the_smoothest_transfer():
    # y = W (10 u^3 - 15 u^4 + 6 u^5) has its greatest slope 15/8 W/L in the middle.
    element = Quintic(10.0, 5.0)
    heading = element.trace(np.linspace(0.0, element.length, 2001))[2]
    assert heading.max() == pytest.approx(math.atan(15.0 / 8.0 * 0.5), abs=1e-6)


@given(CHAINS)
def test_chain_is_continuous_and_uniform_in_arc_length(chain):
    s, x, y, heading, curvature, begins = sample_elements(chain, 0.05)
    spacing = s[1]
    assert s[-1] == pytest.approx(sum(element.length for element in chain), rel=1e-12)
    # A piece of constant curvature k and length h has the chord h (1 - (k h)^2 / 24).
    bend = np.maximum(np.abs(curvature[1:]), np.abs(curvature[:-1])) * spacing
    chords = np.hypot(np.diff(x), np.diff(y))
    assert np.all(chords <= spacing * (1.0 + 1e-6))
    assert np.all(chords >= spacing * (1.0 - 1e-6 - bend**2 / 20.0))
    # The heading turns by the integral of the curvature, and the chord points along the mean heading.
    turns = np.diff(heading)
    mean = 0.5 * (curvature[1:] + curvature[:-1]) * spacing
    across = -np.sin(heading[:-1] + 0.5 * turns) * np.diff(x) + np.cos(heading[:-1] + 0.5 * turns) * np.diff(y)
    # Curvature that changes evenly turns the chord aside by h^3 / 12 of its change a metre: each bound's first term.
    # In a piece with a step of curvature either changes by part of what the step could do over the whole piece, and
    # of what the slope of the curvature beside it adds to the step.
    step = np.zeros(len(turns))
    for begin in begins[1:]:
        near = slice(max(0, int(begin / spacing) - 1), int(begin / spacing) + 2)
        step[near] = np.abs(np.diff(curvature))[near] + 0.1
    assert np.all(np.abs(turns - mean) <= 5e-4 + 0.5 * step * spacing)
    assert np.all(np.abs(across) <= 3e-5 + 0.25 * step * spacing**2)


@given(CHAINS, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-math.pi, math.pi))
def test_start_pose_moves_the_chain_rigidly(chain, x0, y0, heading0):
    _, x, y, heading, curvature, _ = sample_elements(chain, 0.5)
    moved = sample_elements(chain, 0.5, (x0, y0, heading0))
    turned = (x + 1j * y) * np.exp(1j * heading0) + x0 + 1j * y0
    np.testing.assert_allclose(moved[1] + 1j * moved[2], turned, atol=1e-8)
    np.testing.assert_allclose(moved[3], heading + heading0, atol=1e-9)
    np.testing.assert_array_equal(moved[4], curvature)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize(
    "make", [Line, lambda v: Arc(v, 1.0), lambda v: Quintic(v, 1.0)], ids=["line", "arc", "quintic"]
)
def test_lengths_and_radii_must_be_positive(make, bad):
    with pytest.raises(ValueError, match="must be positive"):
        make(bad)


def test_an_arc_must_turn_and_a_course_has_an_element():
    for bad in (0.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="arc angle"):
            Arc(1.0, bad)
    with pytest.raises(ValueError, match="at least one element"):
        sample_elements([], 0.1)
