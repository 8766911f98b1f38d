"""Circuits with a hole, with stretches twice or in zig-zag are refused; real ones, with their noise, are read."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bike_sim.course.csv_line import CourseFileError, parse_csv
from bike_sim.course.files import kind_of, load_course, load_track, shipped_courses, shipped_tracks
from bike_sim.course.reading import path_from_points, track_from_points


def measured(name: str, spacing: float = 5.0) -> np.ndarray:
    """Return the centre line of a circuit as the racing community gives it: points every 5 m or so, shape (n, 2)."""
    centre = load_course(name)
    s = np.linspace(0.0, centre.length, round(centre.length / spacing), endpoint=False)
    return np.stack([np.interp(s, centre.s, centre.x), np.interp(s, centre.s, centre.y)], axis=1)


@pytest.fixture(scope="module")
def barcelona() -> np.ndarray:
    return measured("barcelona")


def text_of(points: np.ndarray, widths: bool = True) -> str:
    return "\n".join(f"{x:.4f},{y:.4f}" + (",6.0,6.0" if widths else "") for x, y in points)


@settings(max_examples=4)
@given(
    name=st.sampled_from(["barcelona", "phillip_island", "cremona", "random_circuit:1", "random_circuit:4"]),
    spacing=st.floats(2.0, 12.0),
    noise=st.floats(0.0, 0.05),
    uneven=st.floats(0.0, 0.3),
    seed=st.integers(0, 2**32 - 1),
)
def test_measured_circuits_are_read_with_their_noise(name, spacing, noise, uneven, seed):
    rng = np.random.default_rng(seed)
    points = measured(name, spacing)
    steps = np.roll(points, -1, axis=0) - points
    points = points + rng.uniform(0.0, uneven, (len(points), 1)) * steps + rng.normal(0.0, noise, points.shape)
    points = np.roll(points, int(rng.integers(len(points))), axis=0)
    track = track_from_points("again", parse_csv(text_of(points)))
    assert track.length == pytest.approx(load_course(name).length, rel=0.01)


@given(begin=st.integers(0, 930), missing=st.integers(11, 300))
def test_a_hole_is_refused_wherever_it_is(barcelona, begin, missing):
    rolled = np.roll(barcelona, -begin, axis=0)
    points = np.roll(rolled[missing:], begin, axis=0) if begin % 2 else rolled[missing:]
    gap = math.dist(rolled[missing], rolled[-1])
    if gap < 52.0:  # the ends of a hairpin: short, and found only where the line turns
        return
    with pytest.raises(CourseFileError) as caught:
        track_from_points("hole", parse_csv(text_of(points)))
    said = re.search(r"([\d.]+) m apart|turns back", str(caught.value))
    assert said
    assert said[1] is None or float(said[1]) == pytest.approx(gap, rel=0.01)


def test_a_hole_names_its_rows_and_distance(barcelona):
    points = np.delete(barcelona, np.s_[20:110], axis=0)
    gap = math.dist(barcelona[19], barcelona[110])
    message = rf"rows 20 and 21 are {gap:.4g} m apart, where neighbours are 5 m apart; is a part missing"
    with pytest.raises(CourseFileError, match=message):
        parse_csv(text_of(points))


def test_a_hole_where_the_line_closes_is_named(barcelona, tmp_path):
    (tmp_path / "open.csv").write_text(text_of(np.roll(barcelona, -110, axis=0)[:-90]))
    with pytest.raises(CourseFileError, match=r"not closed: its ends at rows 1 and 841 are .* m apart"):
        load_track(tmp_path / "open.csv")
    (tmp_path / "closed.yaml").write_text("csv: open.csv\nclosed: true")
    with pytest.raises(CourseFileError, match=r"rows 841 and 1, where the line closes, are .* m apart"):
        load_course(tmp_path / "closed.yaml")


def test_a_missing_corner_is_a_hole_though_it_is_short(barcelona):
    # 40 m in the middle of a bend, on a line without widths as well.
    centre = load_course("barcelona")
    bend = int(np.argmax(np.abs(np.interp(np.arange(len(barcelona)) * 5.0, centre.s, centre.curvature))))
    points = np.delete(barcelona, np.s_[bend - 4 : bend + 4], axis=0)
    for widths in (True, False):
        with pytest.raises(CourseFileError, match=rf"rows {bend - 4} and {bend - 3} are .* m apart"):
            parse_csv(text_of(points, widths))


def test_a_circuit_of_a_few_points_is_no_measurement():
    square = 400.0 * np.array([[0, 0], [1, 0], [2, 0], [3, 0], [3, 1], [3, 2], [2, 2], [1, 2], [0, 2], [0, 1]])
    with pytest.raises(CourseFileError, match=r"400 m apart"):
        parse_csv(text_of(square), closed=True)
    assert path_from_points("square", parse_csv(text_of(square, widths=False), closed=True)).length > 3000.0


def test_a_path_drawn_by_hand_may_have_long_straights():
    rows = [
        (0.0, 0.0),
        (100.0, 0.0),
        *((100.0 + 10.0 * math.sin(a), 10.0 - 10.0 * math.cos(a)) for a in np.linspace(0.1, 3.0, 20)),
        (0.0, 20.5),
    ]
    assert path_from_points("u", parse_csv(text_of(np.array(rows), widths=False), closed=False)).length > 200.0


@given(begin=st.integers(5, 800), length=st.integers(3, 100), later=st.integers(0, 20), size=st.floats(1.5, 8.0))
def test_a_stretch_that_is_there_twice_and_zig_zag_are_refused(barcelona, begin, length, later, size):
    end = begin + length
    twice = np.vstack([barcelona[: end + later], barcelona[begin:end], barcelona[end + later :]])
    zig_zag = barcelona.copy()
    along = zig_zag[begin + 1] - zig_zag[begin - 1]
    aside = np.array([-along[1], along[0]]) / np.hypot(*along)
    zig_zag[begin : begin + 10] += size * aside * np.array([1.0, -1.0] * 5)[:, None]
    for points in (twice, zig_zag):
        with pytest.raises(ValueError, match=r"turns back by|are [\d.]+ m apart|limit crosses itself"):
            track_from_points("broken", parse_csv(text_of(points)))


def test_a_point_met_twice_is_a_crossing():
    t = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    eight = np.stack([300.0 * np.sin(t), 150.0 * np.sin(2.0 * t)], axis=1)
    assert np.hypot(*eight[0]) < 1e-9
    assert np.hypot(*eight[200]) < 1e-9
    assert parse_csv(text_of(eight)).closed


@pytest.mark.parametrize("swapped", [1, 2, 5])
def test_rows_that_are_swapped_are_refused(barcelona, swapped):
    points = barcelona.copy()
    points[[100, 100 + swapped]] = points[[100 + swapped, 100]]
    with pytest.raises(CourseFileError, match=r"row 10[0-9]|rows"):
        parse_csv(text_of(points))


def test_kind_is_told_without_building(barcelona, tmp_path):
    assert [kind_of(name) for name in shipped_courses()] == ["path"] * len(shipped_courses())
    assert [kind_of(name) for name in shipped_tracks()] == ["circuit"] * len(shipped_tracks())
    files = {
        "closed.csv": (text_of(barcelona), "circuit"),
        "bare.csv": (text_of(barcelona, widths=False), "path"),
        "open.csv": (text_of(barcelona[:400]), "path"),
        "table.yaml": ("format: bike.track/1", "circuit"),
        "path.yaml": ("format: bike.course/1", "path"),
        "plain.yml": ("elements: [{line: 5}]", "path"),
        "wrapped.yaml": ("csv: closed.csv", "path"),
    }
    for name, (text, kind) in files.items():
        (tmp_path / name).write_text(text)
        assert kind_of(tmp_path / name) == kind
        assert kind_of(str(tmp_path / name)) == kind
    (tmp_path / "broken.csv").write_text("1,2\n3,x\n")
    with pytest.raises(CourseFileError, match="row 2: y_m is 'x'"):
        kind_of(tmp_path / "broken.csv")
    with pytest.raises(FileNotFoundError, match=r"there is no course file .*missing\.yaml"):
        kind_of(tmp_path / "missing.yaml")
    with pytest.raises(FileNotFoundError, match="no shipped course is called 'monza'"):
        kind_of("monza")


def test_a_table_of_a_circuit_is_a_course_too_and_a_path_is_no_circuit(tmp_path):
    table = tmp_path / "own.yaml"
    table.write_text(
        "format: bike.track/1\nlength_m: 640\nwidth_m: 10\ntransition_m: 20\nelements:\n"
        "  - {straight_m: 160}\n  - {arc: {length_m: 157, angle_deg: 180}, corner: a}\n"
        "  - {straight_m: 163}\n  - {arc: {length_m: 157, angle_deg: 180}, corner: b}\n"
    )
    np.testing.assert_array_equal(load_course(table).x, load_track(table).centre.x)
    with pytest.raises(FileNotFoundError, match="random_circuit:<seed>"):
        load_track("monza")
    with pytest.raises(CourseFileError, match=r"is a path; a circuit has the format 'bike.track/1'"):
        load_track("benchmark")
