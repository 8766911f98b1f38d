"""Shipped circuits against what is published of them, and the geometry of circuits."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from bike_sim.course.files import load_track, shipped_tracks
from bike_sim.course.lap_timing import outside
from bike_sim.course.layout import Piece, close_layout, curvature_profile, trace_layout
from bike_sim.course.track import Track, find_corners

# Official length, direction, and of each corner the direction, the least radius (m) and the turned angle (deg) as read
# from public maps of the circuits, independent of the files' tables.
CORNERS = {
    "barcelona": (
        4657.0,
        "clockwise",
        "RLRRLLLRRLLRRR",
        [65, 85, 120, 40, 36, 465, 75, 415, 125, 36, 200, 41, 180, 120],
        [77, 52, 166, 178, 138, 36, 82, 32, 77, 167, 29, 151, 96, 79],
    ),
    "phillip_island": (
        4445.0,
        "counter-clockwise",
        "RLLRRLLRLRLL",
        [190, 85, 300, 36, 365, 60, 390, 250, 130, 35, 85, 175],
        [78, 176, 57, 172, 22, 177, 36, 59, 129, 140, 111, 121],
    ),
    "cremona": (
        3702.0,
        "counter-clockwise",
        "LLLRRRRLRLLRL",
        [85, 21, 29, 55, 53, 58, 59, 28, 165, 50, 55, 32, 20],
        [71, 118, 83, 96, 74, 74, 110, 198, 97, 182, 103, 90, 147],
    ),
}


@pytest.fixture(params=sorted(CORNERS), scope="module")
def shipped(request) -> Track:
    return load_track(request.param)


def test_length_direction_and_corners_are_the_published_ones(shipped):
    assert set(shipped_tracks()) == set(CORNERS)
    length, direction, turns, radii, angles = CORNERS[shipped.name]
    # Of the drawn line, not of its parameter.
    drawn = np.sum(np.hypot(np.diff(shipped.centre.x), np.diff(shipped.centre.y)))
    assert drawn == pytest.approx(length, rel=0.005)
    assert shipped.direction == direction
    assert [corner.name for corner in shipped.corners] == [str(i + 1) for i in range(len(turns))]
    assert "".join(corner.direction[0].upper() for corner in shipped.corners) == turns
    assert [corner.radius for corner in shipped.corners] == pytest.approx(radii, rel=0.2)
    assert [abs(math.degrees(corner.angle)) for corner in shipped.corners] == pytest.approx(angles, abs=16.0)
    for before, after in itertools.pairwise(shipped.corners):
        assert before.begin < before.apex < before.end <= after.begin + 1e-9
    for corner in shipped.corners:
        bend = shipped.at(shipped.centre.curvature, corner.apex)
        # Short arcs between ramps reach their radius only nearly.
        assert float(bend) * corner.radius == pytest.approx(math.copysign(1.0, corner.angle), abs=0.3)


def test_line_is_closed_without_a_kink_and_its_curvature_continuous(shipped):
    centre = shipped.centre
    assert math.hypot(centre.x[-1] - centre.x[0], centre.y[-1] - centre.y[0]) < 1e-6
    assert abs(centre.heading[-1] - centre.heading[0]) == pytest.approx(2.0 * math.pi, abs=1e-9)
    assert centre.curvature[-1] == pytest.approx(centre.curvature[0], abs=1e-12)
    # The steepest ramp of all is 1/20 1/m in 12 m; a step would change by that within one sample.
    assert np.abs(np.diff(centre.curvature)).max() < 0.005 * centre.spacing
    # Heading is the direction of the line, curvature its change.
    chord = np.arctan2(np.diff(centre.y), np.diff(centre.x))
    middle = 0.5 * (centre.heading[1:] + centre.heading[:-1])
    assert np.abs(np.exp(1j * chord) - np.exp(1j * middle)).max() < 1e-5
    mean = 0.5 * (centre.curvature[1:] + centre.curvature[:-1])
    assert np.diff(centre.heading) / centre.spacing == pytest.approx(mean, abs=1e-4)
    assert shipped.elevation[-1] == pytest.approx(shipped.elevation[0], abs=1e-9)
    assert shipped.grade[-1] == pytest.approx(shipped.grade[0], abs=1e-9)
    assert np.abs(shipped.grade).max() < 0.08
    assert np.ptp(shipped.elevation) > 1.0


def test_walls_stand_behind_the_limits_and_off_the_road(shipped):
    left, right = shipped.walls()
    assert np.all(left > shipped.width_left + 1.0)
    assert np.all(right < -shipped.width_right - 1.0)
    s = shipped.centre.s[::50]
    road = np.stack([shipped.centre.x[::50], shipped.centre.y[::50]], axis=1)
    for wall in (left, right):
        points = shipped.points(s, wall[::50])[:, :2]
        nearest = np.min(np.linalg.norm(points[:, None] - road[None], axis=2), axis=1)
        assert nearest.min() > shipped.width_left.min()


def test_points_are_where_offset_and_height_say(shipped):
    s = np.array([0.0, 1234.5, shipped.length + 10.0])
    on, beside = shipped.points(s), shipped.points(s, 3.0)
    assert np.linalg.norm(beside - on, axis=1) == pytest.approx(3.0)
    assert beside[:, 2] == pytest.approx(shipped.at(shipped.elevation, s))
    assert on[2] == pytest.approx(shipped.points(np.array([10.0]))[0])


def test_outside_is_measured_from_the_nearer_limit(shapes):
    track = shapes.circle(width=12.0)
    for offset, expected in ((7.5, 1.5), (-7.5, 1.5), (0.0, -6.0)):
        assert outside(track.table, track.centre.spacing, track.length, 5.0, offset) == pytest.approx(expected)


def test_family_of_lines_goes_from_the_median_to_the_ideal_line(shapes):
    track = shapes.circle(100.0)
    track = track.with_ideal(np.full(len(track.centre.s), 4.0))
    assert track.line(0.0) is track.centre
    # Left of a left circle is inside.
    for lam in (0.25, 0.5, 1.0):
        line = track.line(lam)
        assert line.length == pytest.approx(2.0 * math.pi * (100.0 - 4.0 * lam), rel=1e-6)
        assert line.curvature == pytest.approx(1.0 / (100.0 - 4.0 * lam), rel=1e-3)
        assert line.width_left == pytest.approx(6.0 - 4.0 * lam, abs=1e-6)
        assert line.width_right == pytest.approx(6.0 + 4.0 * lam, abs=1e-6)


def test_broken_circuits_are_refused(shapes):
    track = shapes.circle()
    with pytest.raises(ValueError, match="not closed"):
        Track(dataclasses.replace(track.centre, closed=False), track.elevation, track.run_off_left, track.run_off_right)
    with pytest.raises(ValueError, match="no widths"):
        dataclasses.replace(track, centre=dataclasses.replace(track.centre, width_left=None))
    with pytest.raises(ValueError, match="on the road"):
        dataclasses.replace(track, run_off_left=-track.run_off_left)
    with pytest.raises(ValueError, match="leaves the limits"):
        track.with_ideal(np.full(len(track.centre.s), 6.5))
    height = track.elevation.copy()
    height[3] = math.nan
    with pytest.raises(ValueError, match="elevation is nan at sample 3"):
        dataclasses.replace(track, elevation=height)
    with pytest.raises(ValueError, match="no ideal line yet"):
        track.line(0.5)
    for lam in (-0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="0 \\(median\\) to 1"):
            track.with_ideal(np.zeros(len(track.centre.s))).line(lam)


def test_corners_of_an_oval_are_found(shapes):
    first, second = find_corners(shapes.oval(50.0, 300.0).centre)
    assert (first.begin, first.end) == pytest.approx((300.0, 300.0 + 50.0 * math.pi), abs=0.2)
    assert first.angle == pytest.approx(math.pi, abs=0.01)
    assert second.radius == pytest.approx(50.0, rel=1e-6)
    assert second.apex == pytest.approx(600.0 + 75.0 * math.pi, abs=0.5)


def test_sound_table_is_not_changed():
    # A square with rounded corners closes as it is.
    pieces = [Piece(100.0), Piece(30.0 * math.pi / 2.0, math.pi / 2.0)] * 4
    length = sum(piece.length for piece in pieces)
    for before, after in zip(pieces, close_layout(pieces, length, 20.0), strict=True):
        assert after.length == pytest.approx(before.length, abs=1e-6)
        assert after.angle == pytest.approx(before.angle, abs=1e-9)


def test_inexact_table_is_closed_at_the_wanted_length():
    rng = np.random.default_rng(1)
    pieces = [
        Piece(piece.length * rng.uniform(0.97, 1.03), piece.angle * rng.uniform(0.98, 1.02))
        for piece in [Piece(100.0), Piece(60.0, math.pi / 2.0)] * 4
    ]
    closed = close_layout(pieces, 650.0, 20.0)
    s, x, y, heading, _ = trace_layout(curvature_profile(closed, 20.0), 0.1, (5.0, -3.0, 0.7))
    assert s[-1] == pytest.approx(650.0, abs=1e-6)
    assert (x[-1], y[-1]) == pytest.approx((5.0, -3.0), abs=1e-6)
    assert heading[-1] == pytest.approx(0.7 + 2.0 * math.pi, abs=1e-8)
    assert max(abs(a.length / b.length - 1.0) for a, b in zip(closed, pieces, strict=True)) < 0.1


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([Piece(100.0), Piece(60.0, 1.0), Piece(60.0, -1.0)], "turns by 360 deg"),
        ([Piece(100.0), Piece(60.0, 2.0 * math.pi)], "at least two arcs"),
        ([Piece(500.0), Piece(60.0, math.pi), Piece(100.0), Piece(60.0, math.pi)], "cannot be closed"),
        ([Piece(0.001), Piece(60.0, math.pi), Piece(60.0, math.pi)], "element 1 is 0.001 m long"),
    ],
)
def test_table_of_another_shape_is_refused(pieces, message):
    with pytest.raises(ValueError, match=message):
        close_layout(pieces, sum(piece.length for piece in pieces), 10.0)


def test_ramps_change_neither_length_nor_angle():
    pieces = [Piece(100.0), Piece(60.0, math.pi / 2.0), Piece(10.0, -0.2), Piece(60.0, math.pi / 2.0 + 0.2)] * 2
    for transition in (0.1, 5.0, 40.0):
        profile = curvature_profile(pieces, transition)
        turned = np.sum(0.5 * np.diff(profile.s) * (profile.curvature[1:] + profile.curvature[:-1]))
        assert profile.s[-1] == pytest.approx(460.0)
        assert turned == pytest.approx(2.0 * math.pi)
    with pytest.raises(ValueError, match="longer than 0"):
        curvature_profile([Piece(10.0), Piece(10.0, 1.0)], 0.0)
