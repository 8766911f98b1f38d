"""Circuits from centre lines with widths: every way they are written, smoothed and checked."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bike_sim.course.csv_line import CourseFileError, parse_csv
from bike_sim.course.files import load_track
from bike_sim.course.reading import track_from_points
from bike_sim.course.spline import smooth_closed, smooth_line


def _load(tmp_path, text: str):
    path = tmp_path / "circuit.csv"
    path.write_text(text)
    return load_track(path)


@settings(max_examples=10)
@given(
    count=st.integers(60, 400),
    radius=st.floats(40.0, 800.0),
    wave=st.floats(0.0, 0.2),
    lobes=st.integers(2, 4),
    clockwise=st.booleans(),
    repeated=st.booleans(),
    shift=st.integers(0, 59),
    separator=st.sampled_from([",", ", ", " ; ", "\t"]),
    header=st.sampled_from(
        ["", "# x_m,y_m,w_tr_right_m,w_tr_left_m\n", "# made by hand\n\n# x_m, y_m, w_tr_right_m, w_tr_left_m\n"]
    ),
)
def test_way_of_writing_does_not_matter(
    shapes, count, radius, wave, lobes, clockwise, repeated, shift, separator, header
):
    points = np.roll(shapes.ring_points(count, radius, wave, lobes), shift, axis=0)
    if clockwise:
        points = points[::-1]
    given_points = np.vstack([points, points[:1]]) if repeated else points
    rows = [separator.join(repr(float(v)) for v in (x, y, 3.0, 4.0)) for x, y in given_points]
    track = track_from_points("ring", parse_csv(header + "\n".join(rows) + "\n# end\n"))
    assert track.direction == ("clockwise" if clockwise else "counter-clockwise")
    assert track.centre.closed
    angle = np.linspace(0.0, 2.0 * math.pi, 20001)
    r = radius * (1.0 + wave * np.cos(lobes * angle))
    slope = -radius * wave * lobes * np.sin(lobes * angle)
    assert track.length == pytest.approx(np.trapezoid(np.hypot(r, slope), angle), rel=5e-3)
    # Smoothing may move the line a little; the road stays as wide as it was.
    assert track.width_left + track.width_right == pytest.approx(7.0, abs=1e-6)
    assert np.hypot(track.centre.x, track.centre.y).max() == pytest.approx(radius * (1.0 + wave), abs=0.7)


def test_limits_stay_where_they_were_while_noise_is_smoothed_away(shapes):
    clean = shapes.ring_points(300, 200.0, 0.15, 3)
    noise = np.random.default_rng(3).normal(0.0, 0.1, clean.shape)
    track = track_from_points("noisy", parse_csv(shapes.csv_text(clean + noise)))
    reference = track_from_points("clean", parse_csv(shapes.csv_text(clean)))
    worst = np.abs(reference.centre.curvature).max()
    assert np.abs(track.centre.curvature).max() < 1.25 * worst
    # What the noise would have done without.
    (*_, curvature), _ = smooth_line(np.vstack([clean + noise, (clean + noise)[:1]]), True, 0.5)
    assert np.abs(curvature).max() > 2.0 * worst
    assert np.abs(track.length - reference.length) < 1.0


def test_smoothing_moves_a_line_no_farther_than_it_may(shapes):
    clean = shapes.ring_points(300, 60.0, 0.25, 5)
    noisy = clean + np.random.default_rng(4).normal(0.0, 0.3, clean.shape)
    for tolerance in (0.02, 0.1, 0.3):
        _, _, moved = smooth_closed(np.vstack([noisy, noisy[:1]]), tolerance)
        assert np.sqrt(np.mean(moved**2)) <= tolerance + 1e-12
        assert np.abs(moved).max() <= 4.0 * tolerance + 1e-12


def test_small_circuits_of_model_cars_are_read(tmp_path, shapes):
    points = shapes.ring_points(120, 4.0, 0.2, 3)
    track = _load(tmp_path, shapes.csv_text(points, 1.0, 1.1))
    assert 20.0 < track.length < 35.0
    assert np.hypot(track.centre.x, track.centre.y).max() == pytest.approx(4.8, abs=0.1)


def test_widths_keep_their_sides(tmp_path, shapes):
    # Counter-clockwise: left is inside.
    track = _load(tmp_path, shapes.csv_text(shapes.ring_points(200, 150.0, 0.0), right=5.0, left=2.0))
    inside, outside = track.points(track.centre.s, track.width_left), track.points(track.centre.s, -track.width_right)
    assert np.hypot(inside[:, 0], inside[:, 1]) == pytest.approx(148.0, abs=0.05)
    assert np.hypot(outside[:, 0], outside[:, 1]) == pytest.approx(155.0, abs=0.05)


def test_line_that_crosses_itself_is_a_bridge(shapes):
    t = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    eight = np.stack([300.0 * np.sin(t), 150.0 * np.sin(2.0 * t)], axis=1)
    track = track_from_points("eight", parse_csv(shapes.csv_text(eight, 6.0, 6.0)))
    assert track.length > 1000.0


@pytest.mark.parametrize("shift", [0.0, 0.5, 3.0])
def test_two_laps_are_no_circuit(tmp_path, shapes, shift):
    laps = np.vstack([shapes.ring_points(200, radius, 0.05) for radius in (100.0, 100.0 + shift)])
    text = shapes.csv_text(laps + np.linspace(0.0, 1e-6, len(laps))[:, None], 4.0, 4.0)
    with pytest.raises(CourseFileError, match=r"lies on the road at .*more than one lap"):
        _load(tmp_path, text)


def test_roads_side_by_side_the_same_way_are_a_circuit(shapes):
    # Twice round, inside out, over a bridge.
    t = np.linspace(0.0, 4.0 * math.pi, 800, endpoint=False)
    radius = 110.0 + 10.0 * np.cos(0.5 * t)
    points = np.stack([radius * np.cos(t), radius * np.sin(t)], axis=1)
    with pytest.raises(ValueError, match="lies on the road"):  # it crosses itself too flatly for a bridge
        track_from_points("flat", parse_csv(shapes.csv_text(points, 4.0, 4.0)))
    radius = 110.0 + 60.0 * np.cos(0.5 * t)
    points = np.stack([radius * np.cos(t), radius * np.sin(t)], axis=1)
    assert track_from_points("twice", parse_csv(shapes.csv_text(points, 4.0, 4.0))).length > 1300.0


def _without(points):
    return points[: len(points) // 2]


@pytest.mark.parametrize(
    ("change", "right", "left", "message"),
    [
        (lambda p: p[:6], 5.0, 6.0, "may be open or closed|has 6 points|not closed"),
        (_without, 5.0, 6.0, "not closed: its ends at rows 2 and 101 are 300 m apart"),
        (lambda p: p[::29], 5.0, 6.0, "has 7 points, a circuit needs at least 8"),
        (lambda p: p, 5.0, 200.0, "limit crosses itself"),
        (lambda p: p, 0.1, 0.2, "road is at least 0.5 m wide"),
        (lambda p: p * [1.0, 0.06], 12.0, 12.0, "limit crosses itself|the limits cross"),
    ],
)
def test_broken_lines_get_one_clear_error(tmp_path, shapes, change, right, left, message):
    text = shapes.csv_text(change(shapes.ring_points(200, 150.0, 0.05)), right, left)
    with pytest.raises(CourseFileError, match=message) as caught:
        _load(tmp_path, text)
    assert "circuit.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_roads_that_run_into_each_other_are_refused(shapes):
    # Two long legs 20 m apart with 24 m of road each, and bends wide enough for the limits.
    y = np.linspace(0.0, 400.0, 81)
    leg = np.stack([np.full_like(y, 10.0), y], axis=1)
    bow = np.linspace(0.0, math.pi, 60)[1:-1]
    top = np.stack([40.0 * np.cos(bow), 435.0 + 40.0 * np.sin(bow)], axis=1)
    points = np.vstack([leg, top, leg[::-1] * [-1.0, 1.0], top[::-1] * [1.0, -1.0] + [0.0, 400.0]])
    with pytest.raises(ValueError, match=r"the limits cross|limit crosses itself"):
        track_from_points("pinch", parse_csv(shapes.csv_text(points, 13.0, 13.0)))


def test_circuit_needs_widths(tmp_path, shapes):
    points = shapes.ring_points()
    text = "\n".join(f"{x},{y}" for x, y in points)
    with pytest.raises(CourseFileError, match="has no widths"):
        _load(tmp_path, text)


_YAML = """
format: bike.track/1
length_m: 640
width_m: 10
transition_m: 20
elements:
  - {straight_m: 160}
  - {arc: {length_m: 157, angle_deg: 180}, corner: "1"}
  - {straight_m: 163}
  - {arc: {length_m: 157, angle_deg: 180}, corner: "2"}
elevation_m: [[0, 1], [200, 5], [400, 2]]
"""


def test_table_from_a_file_is_a_circuit(tmp_path):
    path = tmp_path / "own.yaml"
    path.write_text(_YAML)
    track = load_track(path)
    assert track.length == pytest.approx(640.0)
    assert [corner.name for corner in track.corners] == ["1", "2"]
    assert track.at(track.elevation, 200.0) == pytest.approx(5.0, abs=1e-6)
    assert [name for name, _ in track.sectors] == ["sector 1", "sector 2", "sector 3"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bike.track/1", "bike.track/9", "format is 'bike.track/9'"),
        ("width_m: 10", "width_m: 0.1", "at least 0.5 m"),
        ("width_m: 10", "", "width_m is missing"),
        ("transition_m: 20", "transition_m: 0", "longer than 0"),
        ('angle_deg: 180}, corner: "2"', 'angle_deg: -180}, corner: "2"', "turns by 360 deg"),
        ('angle_deg: 180}, corner: "2"', 'angle_deg: 0}, corner: "2"', "element 4: .*must not be 0"),
        ("- {straight_m: 163}", "- {straight_m: -163}", "element 3: .*positive"),
        ("- {straight_m: 163}", "- {straight: 163}", "element 3: must have either"),
        ("length_m: 640", "length_m: 900", "cannot be closed"),
        ('corner: "2"', 'corner: "1"', "corner '1' has pieces in two places"),
        ("[200, 5]", "[200, nan]", "elevation_m: entry 2"),
        ("[400, 2]", "[100, 2]", "distances must grow"),
        ("width_m: 10", "width_m: 10\nrun_off_m: {straight: 0, inside: 1, outside: 1}", "run-off straight"),
        ("width_m: 10", 'width_m: 10\nsectors_after: ["7"]', "corner names among 1, 2"),
        ("width_m: 10", "width_m: 10\nspeed: 3", "unknown key 'speed'"),
    ],
)
def test_broken_table_gets_one_clear_error(tmp_path, old, new, message):
    assert old in _YAML
    path = tmp_path / "own.yaml"
    path.write_text(_YAML.replace(old, new, 1))
    with pytest.raises(CourseFileError, match=message) as caught:
        load_track(path)
    assert "own.yaml" in str(caught.value)
