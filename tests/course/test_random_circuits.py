"""Circuits without end: every seed gives a circuit that is closed, nowhere crosses, and is like real ones."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from bike_sim.course.files import kind_of, load_course, load_track
from bike_sim.course.random_courses import CORNERS, LENGTH, MAX_SEED, RADIUS, STEEPEST, random_circuit
from bike_sim.course.track import Track, find_corners


def check_sound(track: Track) -> None:
    """Check all that is promised of a random circuit."""
    centre = track.centre
    assert math.hypot(centre.x[-1] - centre.x[0], centre.y[-1] - centre.y[0]) < 1e-6
    assert abs(centre.heading[-1] - centre.heading[0]) == pytest.approx(2.0 * math.pi, abs=1e-9)
    assert centre.curvature[-1] == pytest.approx(centre.curvature[0], abs=1e-12)
    assert LENGTH[0] <= track.length <= LENGTH[1]
    assert CORNERS[0] <= len(track.corners) <= CORNERS[1]
    assert all(RADIUS[0] <= corner.radius <= RADIUS[1] for corner in track.corners)
    assert np.abs(centre.curvature).max() <= 1.0 / RADIUS[0] + 1e-12
    # Curvature is continuous: no sample differs from the next by more than a ramp of a few metres may.
    assert np.abs(np.diff(centre.curvature)).max() < 0.02 * centre.spacing
    for before, after in itertools.pairwise(track.corners):
        assert before.begin < before.apex < before.end <= after.begin + 1e-9
    width = track.width_left + track.width_right
    assert 8.0 < width.min() <= width.max() < 16.0
    assert np.abs(np.diff(width)).max() < 0.02 * centre.spacing
    assert width[0] == width[-1]
    assert np.abs(track.grade).max() <= STEEPEST + 1e-9
    # Crests and dips of 660 m radius and more, beside what a bend makes of a slope across it.
    bent = np.abs(np.diff(track.elevation, 2)) / centre.spacing**2
    assert np.all(bent < 1.5e-3 + 0.2 * np.abs(centre.curvature[1:-1]))
    assert track.elevation[0] == track.elevation[-1] == 0.0
    assert 1.0 < np.ptp(track.elevation) < 60.0
    check_apart(track)


def check_apart(track: Track) -> None:
    """Check that limits keep off the road, and no two places that lie far along from each other are close."""
    rows = np.arange(0, len(track.centre.s) - 1, 40)
    s = track.centre.s[rows]
    middle = track.points(s)[:, :2]
    tree = cKDTree(middle)
    for offset in (track.width_left[rows], -track.width_right[rows]):
        limit = track.points(s, offset)[:, :2]
        distance, _ = tree.query(limit)
        # Nearer to its own centre line than to any other part of it, but for the stations' spacing.
        assert np.all(distance > np.abs(offset) - 0.8)
    pairs = tree.query_pairs(20.0, output_type="ndarray")
    along = np.abs(s[pairs[:, 0]] - s[pairs[:, 1]])
    assert np.minimum(along, track.length - along).max() < 100.0


@pytest.mark.long  # 200 circuits, which riders are tuned and judged on
@pytest.mark.parametrize("seeds", [range(0, 200, 2), range(1, 200, 2)], ids=["even", "odd"])
def test_all_seeds_for_tuning_and_judging_are_sound_and_like_real_circuits(seeds):
    radii, angles, gaps, sides = [], [], [], []
    for seed in seeds:
        track = random_circuit(seed)
        check_sound(track)
        found = find_corners(track.centre)
        sides.append(track.direction)
        radii += [corner.radius for corner in found]
        angles += [abs(math.degrees(corner.angle)) for corner in found]
        # With the main straight, over which the lap closes; where that lies in a corner, the gap is none.
        between = [(b.begin - a.end) % track.length for a, b in zip(found, [*found[1:], found[0]], strict=True)]
        gaps += [gap if gap < track.length - 50.0 else 0.0 for gap in between]
    # Of the three shipped circuits: 62 m and 117 deg in the middle, 42 % of straights below 60 m, 23 % above 300 m; of
    # 24 others 36 m and 77 deg, 43 % and 22 % (docs/reference/circuits.md).
    assert 36.0 < np.median(radii) < 70.0
    assert np.min(radii) < 16.0
    assert np.max(radii) > 300.0
    assert 77.0 < np.median(angles) < 117.0
    assert np.mean(np.array(gaps) < 60.0) == pytest.approx(0.42, abs=0.06)
    assert np.mean(np.array(gaps) > 300.0) == pytest.approx(0.22, abs=0.06)
    assert 0.3 < sides.count("clockwise") / len(sides) < 0.7


@settings(max_examples=10)
@given(st.integers(200, MAX_SEED))
def test_any_seed_is_sound(seed):
    check_sound(random_circuit(seed))


def test_a_seed_gives_one_circuit_and_another_seed_another():
    first, again, other = random_circuit(7), load_track("random_circuit:7"), random_circuit(8)
    for column in ("x", "y", "heading", "curvature", "width_left", "width_right"):
        np.testing.assert_array_equal(getattr(first.centre, column), getattr(again.centre, column))
    np.testing.assert_array_equal(first.elevation, again.elevation)
    assert first.corners == again.corners
    assert first.length != other.length


def test_circuits_stay_what_they_were():
    # Results are published for seeds, so a seed must mean the same circuit in every version.
    lengths = [random_circuit(seed).length for seed in (0, 1, 2, 100, 2**40)]
    assert lengths == pytest.approx(GOLDEN, abs=1e-3)


GOLDEN = [4601.575215, 4529.358386, 3632.818205, 5122.946309, 3687.232148]


def test_name_is_understood_wherever_courses_are():
    name = "random_circuit:3"
    assert kind_of(name) == "circuit"
    track, course = load_track(name), load_course(name)
    assert track.name == course.name == name
    np.testing.assert_array_equal(course.x, track.centre.x)


@pytest.mark.parametrize("load", [load_course, load_track, kind_of])
@pytest.mark.parametrize(
    "seed", ["", "x", "-1", "1.5", "1e3", " 1", "01", "+1", "1_0", "٣", str(MAX_SEED + 1), "9" * 5000, "1.yaml", "1\n"]
)
def test_seed_that_is_none_is_refused_by_name(load, seed):
    with pytest.raises(ValueError, match=r"a random circuit is called random_circuit:<seed>, with a whole number"):
        load(f"random_circuit:{seed}")
    with pytest.raises(ValueError, match="such as random_circuit:7"):
        load("random_circuit")


@pytest.mark.parametrize("seed", [-1, MAX_SEED + 1])
def test_seed_outside_its_range_is_refused(seed):
    with pytest.raises(ValueError, match=r"must be 0 to 4611686018427387904 \(2\^62\)"):
        random_circuit(seed)
