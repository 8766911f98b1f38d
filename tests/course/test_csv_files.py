"""Centre lines from CSV: formats, smoothing, widths, and one clear error for each way a file can be broken."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.course.csv_line import CourseFileError
from bike_sim.course.files import load_course

RADIUS = 50.0


def circle_rows(count, radius=RADIUS, separator=","):
    angles = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    return [
        separator.join(str(v) for v in (radius * math.cos(a), radius * math.sin(a), 5.0 + math.cos(a), 7.0))
        for a in angles
    ]


@pytest.fixture
def load(tmp_path):
    """Write a text (or bytes) to a file and load it as a course."""

    def load(content, name="track.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return load_course(path)

    return load


ROWS = circle_rows(60)
SAME_FILE = {
    "bare": "\n".join(ROWS),
    "header": "x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(ROWS),
    "commented header": "# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(ROWS),
    "spaces": "#  x_m, y_m , w_tr_right_m,w_tr_left_m\n" + "\n".join(f"  {row.replace(',', ' , ')} " for row in ROWS),
    "comments and empty lines": "# a track, made for a test\n\n"
    + "\n# half way, nearly\n\n".join(["\n".join(ROWS[:20]), "\n".join(ROWS[20:])]),
    "semicolons": "# s; x_m; y_m\n# x_m; y_m; w_tr_right_m; w_tr_left_m\n" + "\n".join(circle_rows(60, separator=";")),
    "tabs": "\n".join(circle_rows(60, separator="\t")),
    "carriage returns": "\r\n".join(ROWS) + "\r\n",
    "byte order mark": "\ufeff" + "\n".join(ROWS),
    "last point repeated": "\n".join([*ROWS, ROWS[0]]),
    "separator at the end": "\n".join(row + "," for row in ROWS),
    "other order, further columns": "y_m,speed,x_m,w_tr_left_m,w_tr_right_m\n"
    + "\n".join(f"{y},fast,{x},{left},{right}" for x, y, right, left in (row.split(",") for row in ROWS)),
}


@pytest.mark.parametrize("text", SAME_FILE.values(), ids=SAME_FILE.keys())
def test_every_spelling_gives_the_same_course(load, text):
    expected, course = load(SAME_FILE["bare"], "expected.csv"), load(text)
    assert course.closed
    assert course.name == "track"
    for column in ("s", "x", "y", "heading", "curvature", "width_left", "width_right"):
        np.testing.assert_allclose(getattr(course, column), getattr(expected, column), atol=1e-9, err_msg=column)


def test_circle_is_smoothed_to_a_circle_with_its_limits_on_their_sides(load):
    course = load(SAME_FILE["bare"])
    assert course.length == pytest.approx(2.0 * math.pi * RADIUS, rel=1e-6)
    np.testing.assert_allclose(np.hypot(course.x, course.y), RADIUS, atol=1e-3)
    np.testing.assert_allclose(course.curvature, 1.0 / RADIUS, rtol=2e-3)
    # The circle runs anticlockwise from (50, 0): heading 90 degrees and once around.
    assert course.heading[0] == pytest.approx(math.pi / 2.0, abs=1e-6)
    assert course.heading[-1] - course.heading[0] == pytest.approx(2.0 * math.pi, abs=1e-9)
    assert course.curvature[-1] == pytest.approx(course.curvature[0], abs=1e-12)
    np.testing.assert_allclose(course.width_left, 7.0, atol=1e-12)
    # The right width was 5 + cos(angle); linear between points 5.2 m apart.
    np.testing.assert_allclose(course.width_right, 5.0 + course.x / RADIUS, atol=2e-3)
    bare = load("x_m,y_m\n" + "\n".join(row.rsplit(",", 2)[0] for row in ROWS))
    assert (bare.width_left, bare.width_right) == (None, None)


def test_smoothing_is_of_fourth_order(load):
    coarse, fine = (abs(load("\n".join(circle_rows(n))).length - 2.0 * math.pi * RADIUS) for n in (30, 60))
    assert 12.0 < coarse / fine < 20.0


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_samples_are_uniform_and_consistent(tmp_path_factory, seed, closed):
    # A wobbly ring (or half of one) of unevenly spaced points, down to 6 m in radius.
    rng = np.random.default_rng(seed)
    angles = np.sort(np.linspace(0.0, 1.0, 40, endpoint=False) + rng.uniform(0.0, 0.015, 40))
    angles *= (2.0 if closed else 1.0) * math.pi
    radii = rng.uniform(6.0, 60.0) * (1.0 + 0.1 * np.sin(3.0 * angles + rng.uniform(0.0, 6.0)))
    path = tmp_path_factory.mktemp("csv") / "ring.csv"
    np.savetxt(path, np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]), delimiter=",")
    course = load_course(path)
    assert course.closed is closed
    chords = np.hypot(np.diff(course.x), np.diff(course.y))
    middle = 0.5 * (course.curvature[1:] + course.curvature[:-1])
    arcs = chords * (1.0 + (middle * course.spacing) ** 2 / 24.0)
    np.testing.assert_allclose(arcs, course.spacing, rtol=5e-6)
    np.testing.assert_allclose(np.diff(course.heading) / course.spacing, middle, atol=0.02)
    mean = 0.5 * (course.heading[1:] + course.heading[:-1])
    np.testing.assert_allclose(np.diff(course.x), chords * np.cos(mean), atol=1e-4)
    np.testing.assert_allclose(np.diff(course.y), chords * np.sin(mean), atol=1e-4)


@pytest.mark.parametrize("name", ["benchmark", "junction", "circle"])
@pytest.mark.parametrize("every", [2, 5])
def test_course_survives_the_way_through_a_csv_file(tmp_path, name, every):
    original = load_course(name)
    kept = np.unique(np.append(np.arange(0, len(original.s), every), len(original.s) - 1))
    path = tmp_path / "again.csv"
    np.savetxt(path, np.column_stack([original.x[kept], original.y[kept]]), delimiter=",", header="x_m,y_m")
    again = load_course(path)
    assert again.closed == original.closed
    assert again.length == pytest.approx(original.length, abs=0.01)
    s = original.s[kept] * again.length / original.length
    x, y = np.interp(s, again.s, again.x), np.interp(s, again.s, again.y)
    assert np.hypot(x - original.x[kept], y - original.y[kept]).max() < 0.02


def test_open_line_stays_open(load):
    course = load("\n".join(f"{10 * i},{i % 2}" for i in range(10)))
    assert not course.closed
    assert (course.x[0], course.y[0], course.x[-1], course.y[-1]) == pytest.approx((0.0, 0.0, 90.0, 1.0), abs=1e-9)
    assert course.curvature[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-9)
    course = load("0,0\n3,4\n6,8\n30,40\n60,80\n")
    assert course.length == pytest.approx(100.0, abs=1e-9)
    np.testing.assert_allclose(course.curvature, 0.0, atol=1e-12)
    np.testing.assert_allclose(course.y, course.x * 4.0 / 3.0, atol=1e-9)


HAIRPIN = "\n".join(
    ["0,0", "10,0", "20,0", "30,0", "40,0", "48,4", "50,10", "48,16", "40,20", "30,20", "20,20", "10,15", "0,10"]
)


def test_a_line_whose_ends_lie_side_by_side_must_say_what_it_is(load, tmp_path):
    with pytest.raises(CourseFileError, match=r"may be open or closed.*YAML"):
        load(HAIRPIN, "hairpin.csv")
    assert load("csv: hairpin.csv\nclosed: true", "closed.yaml").closed
    course = load("csv: hairpin.csv\nclosed: false\nname: pin\noff_course_limit_m: 2.5", "open.yaml")
    assert not course.closed
    assert course.name == "pin"
    assert course.off_course_limit == 2.5


BROKEN = {
    "empty": ("", "is empty"),
    "white space": (" \n\n", "is empty"),
    "comments only": ("# x_m,y_m\n", "has no points"),
    "header only": ("x_m,y_m\n", "has no points"),
    "binary": (b"\x89PNG\r\n\x1a\n\x00\x00", "is not a UTF-8 text file.*byte 0 is 0x89"),
    "zeros": (b"1,2\n\x00\x00\x00", "is a binary file"),
    "UTF-16": ("1,2\n".encode("utf-16"), "is not a UTF-8 text file"),
    "too few": ("0,0\n1,0\n2,0\n", "has 3 different points, at least 4"),
    "too few without the repeated": ("0,0\n1,0\n1,1\n0,0\n", "has 3 different points"),
    "not a number": ("0,0\n1,0\n2,zwei\n3,0\n", "row 3: y_m is 'zwei', a number is needed"),
    "missing number": ("0,0\n1,0\n,0\n3,0\n", "row 3: x_m is '', a number"),
    "nan": ("# x_m,y_m\n0,0\n1,nan\n2,0\n3,0\n", "row 3: y_m is 'nan', a finite number"),
    "infinite": ("0,0\n1,0\n2,0\ninf,0\n", "row 4: x_m is 'inf', a finite number"),
    "overflow": ("0,0\n1,0\n2,0\n1e999,0\n", "row 4: x_m is '1e999', a finite number"),
    "negative width": ("0,0,1,1\n1,0,1,1\n2,0,-1,1\n3,0,1,1\n", "row 3: w_tr_right_m is -1.0, a width"),
    "short row": ("0,0,1,1\n1,0,1,1\n2,0\n3,0,1,1\n", "row 3 has 2 columns instead of 4: '2,0'"),
    "three columns": ("0,0,1\n1,0,1\n2,0,1\n3,0,1\n", "row 1 has 3 columns; without a row of names"),
    "one column": ("0\n1\n2\n3\n", "row 1 has 1 columns"),
    "decimal commas": ("0,5;0,5\n1,5;0,5\n", "row 1: x_m is '0,5', a number"),
    "one width": ("x_m,y_m,w_tr_left_m\n0,0,1\n", "row 1 names w_tr_left_m alone"),
    "other names": ("lon,lat\n0,0\n1,1\n", "row 1 has names, but x_m is not among them: 'lon, lat'"),
    "same point": ("0,0\n1,0\n1,0\n2,0\n3,1\n", r"rows 2 and 3 are the same point \(1.0, 0.0\)"),
    "out of order": ("0,0\n1,0\n3,0\n2,0\n4,0\n", "row 3: the line turns back by 180 deg here; are the rows in order"),
    "kilometres": ("0,0\n1e5,0\n2e5,0\n3e5,0\n", "300 km long, at most 100 km"),
}


@pytest.mark.parametrize(("content", "message"), BROKEN.values(), ids=BROKEN.keys())
def test_broken_file_gets_one_clear_error(load, content, message):
    with pytest.raises(CourseFileError, match=message) as caught:
        load(content)
    assert "track.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_closed_line_that_repeats_its_first_point_cannot_be_called_open(load):
    load("\n".join([*ROWS, ROWS[0]]), "ring.csv")
    with pytest.raises(CourseFileError, match="called open, but its last point repeats its first"):
        load("csv: ring.csv\nclosed: false", "ring.yaml")
