"""Courses from YAML: what a file may say, and one clear error for everything else."""

import math
import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.course.course import Course
from bike_sim.course.csv_line import CourseFileError
from bike_sim.course.files import load_course


@pytest.fixture
def load(tmp_path):
    def load(content, name="own.yaml"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return load_course(path)

    return load


def test_all_that_a_file_may_say(load):
    course = load("""
        format: bike.course/1
        name: my course
        description: it has everything
        off_course_limit_m: 2.0
        start: {x_m: 1, y_m: -2.0, heading_deg: 90}
        elements:
          - line: 10
          - arc: {radius_m: 5.0, angle_deg: -90}
            section: corner
          - {line: 1e1}
          - {quintic: {length_m: 20.0, width_m: 4.0}, section: lane change}
    """)
    assert course.name == "my course"
    assert course.off_course_limit == 2.0
    assert not course.closed
    assert (course.x[0], course.y[0], course.heading[0]) == pytest.approx((1.0, -2.0, math.pi / 2.0))
    # 10 m north, a quarter to the right (5 m north, 5 m east), 10 m and 20 m east, 4 m to the left (north).
    assert (course.x[-1], course.y[-1], course.heading[-1]) == pytest.approx((36.0, 17.0, 0.0), abs=1e-9)
    bend = 2.5 * math.pi
    assert [name for name, _ in course.sections] == ["start", "corner", "lane change"]
    assert [begin for _, begin in course.sections] == pytest.approx([0.0, 10.0, 20.0 + bend])


def test_examples_of_the_documentation_are_courses(load):
    page = (Path(__file__).parents[2] / "docs" / "reference" / "courses.md").read_text(encoding="utf-8")
    elements, wrapper = re.findall(r"```yaml\n(.*?)```", page, flags=re.DOTALL)
    assert [name for name, _ in load(elements).sections] == ["start straight", "corner", "lane change"]
    (rows,) = re.findall(r"```\n(# x_m,y_m,.*?)\.\.\.\n```", page, flags=re.DOTALL)
    points = "9.8,0.9,4.5,5.0\n14.7,1.8,4.5,5.0\n"
    with pytest.raises(CourseFileError, match="has 2 different points"):
        load(rows, "my_track.csv")
    with pytest.raises(CourseFileError, match="is called closed"):
        load("closed: true\n" + elements.replace("closed: false", ""))
    assert load(rows + points, "my_track.csv").width_left[0] == 5.0
    assert load(wrapper).off_course_limit == 8.0


def test_file_without_a_name_is_called_after_itself(load):
    course = load("elements: [{line: 5}]", "short.yml")
    assert course.name == "short"
    assert course.sections == ()


def test_csv_is_found_beside_the_yaml_file(load, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path.parent)
    load("\n".join(f"{5 * i},{0.1 * i * i}" for i in range(20)), "points.csv")
    course = load("{csv: points.csv, name: wrapped, off_course_limit_m: 8}")
    assert course.name == "wrapped"
    assert course.off_course_limit == 8.0
    assert not course.closed


ARC = "{radius_m: 5, angle_deg: 90}"
BROKEN = {
    "empty": ("", "is empty"),
    "comment only": ("# nothing\n", "must be a mapping"),
    "list": ("[1, 2]", "must be a mapping with the keys"),
    "text": ("benchmark", "must be a mapping"),
    "binary": (b"\xff\xfe\x00", "is not a UTF-8 text file"),
    "zeros": (b"a: \x00", "is a binary file"),
    "control character": ("a: \x07", "is not valid YAML: unacceptable character #x0007"),
    "broken YAML": ("name: x\nelements: [\n", "row 3: "),
    "tab": ("name: x\n\telements: 3", "row 2: "),
    "deep nesting": ("[" * 5000, "nested too deeply"),
    "twice": ("name: a\nname: b\nelements: [{line: 1}]", "row 2: key 'name' is given twice"),
    "unknown key": ("elements: [{line: 1}]\nlenght: 3", "unknown key 'lenght'; known are format, name"),
    "other format": ("format: bike.course/2\nelements: [{line: 1}]", "format is 'bike.course/2', this version reads"),
    "nothing": ("name: x", "must have either 'elements' or 'csv'"),
    "both": ("csv: a.csv\nelements: [{line: 1}]", "must have either 'elements' or 'csv'"),
    "no elements": ("elements: []", "elements must be a list with at least one element"),
    "elements not a list": ("elements: {line: 1}", "elements must be a list"),
    "element not a mapping": ("elements: [line]", "element 1: must be a mapping with one of line, arc, quintic"),
    "unknown element": ("elements: [{line: 1}, {spiral: 2}]", "element 2: unknown key 'spiral'"),
    "two in one": (f"elements: [{{line: 1, arc: {ARC}}}]", "element 1: must have exactly one of .* has line and arc"),
    "none in one": ("elements: [{section: a}]", "element 1: must have exactly one of .* has none"),
    "no number": ("elements: [{line: long}]", "element 1: line is 'long', a number is needed"),
    "nan": ("elements: [{line: nan}]", "element 1: line is 'nan', a finite number"),
    "yaml infinity": ("elements: [{line: .inf}]", "element 1: line is '.inf', a number"),
    "list for a number": ("elements: [{line: [1]}]", "element 1: line is a list, a finite number"),
    "negative length": (
        "elements: [{line: 1}, {line: -1}]",
        "element 2: line: line length must be positive.* got -1.0",
    ),
    "negative radius": (
        "elements: [{arc: {radius_m: -5, angle_deg: 90}}]",
        "element 1: arc: arc radius must be positive.* got -5.0",
    ),
    "arc that does not turn": (
        "elements: [{arc: {radius_m: 5, angle_deg: 0}}]",
        "element 1: arc: arc angle must be .* not",
    ),
    "arc without angle": ("elements: [{arc: {radius_m: 5}}]", "element 1: arc: angle_deg is missing"),
    "arc in radians": ("elements: [{arc: {radius_m: 5, angle: 1}}]", "element 1: arc: unknown key 'angle'; known are"),
    "arc as a number": (
        "elements: [{arc: 5}]",
        "element 1: arc must be a mapping with radius_m and angle_deg, got '5'",
    ),
    "quintic without width": ("elements: [{quintic: {length_m: 5}}]", "element 1: quintic: width_m is missing"),
    "huge": ("elements: [{line: 1e9}]", "element 1: line is '1e9', more than 100000 m"),
    "huge width": ("elements: [{quintic: {length_m: 5, width_m: 1e300}}]", "element 1: quintic: width_m is '1e300'"),
    "long": ("elements: [{line: 9e4}, {line: 9e4}]", "element 2: the course grows longer than 100 km"),
    "many turns": ("elements: [{arc: {radius_m: 1e4, angle_deg: 1e9}}]", "element 1: the course grows longer"),
    "not closed": ("closed: true\nelements: [{line: 10}]", r"called closed, but its ends are 10.0000 m and 0.0000 rad"),
    "closed perhaps": ("closed: maybe\nelements: [{line: 10}]", "closed must be one of true, false, got 'maybe'"),
    "limit": ("off_course_limit_m: -1\nelements: [{line: 10}]", "off-course limit must be positive, got -1.0"),
    "limit text": ("off_course_limit_m: far\nelements: [{line: 10}]", "off_course_limit_m is 'far', a number"),
    "start": (
        "start: [0, 0, 0]\nelements: [{line: 10}]",
        "start must be a mapping with x_m and y_m and heading_deg",
    ),
    "start key": ("start: {x: 0}\nelements: [{line: 10}]", "start: unknown key 'x'; known are x_m"),
    "start value": ("start: {x_m: nan}\nelements: [{line: 10}]", "start: x_m is 'nan', a finite number"),
    "section": ("elements: [{line: 10, section: [1]}]", "element 1: section must be text, got a list"),
    "empty name": ("name: ''\nelements: [{line: 10}]", "name must be text, got ''"),
    "start of a csv": ("csv: a.csv\nstart: {x_m: 1}", "'start' belongs to 'elements'"),
}


@pytest.mark.parametrize(("content", "message"), BROKEN.values(), ids=BROKEN.keys())
def test_broken_file_gets_one_clear_error(load, content, message):
    with pytest.raises(CourseFileError, match=message) as caught:
        load(content)
    assert "own.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_wrapped_csv_file_is_named(load):
    with pytest.raises(FileNotFoundError, match=r"there is no course file .*points.csv"):
        load("csv: points.csv")


def test_broken_wrapped_csv_file_names_both_files(load, tmp_path):
    (tmp_path / "points.csv").write_text("0,0\n1,x\n")
    with pytest.raises(CourseFileError, match=r"own.yaml: its CSV file .*points.csv row 2: y_m is 'x'"):
        load("csv: points.csv")


@pytest.mark.parametrize("name", ["bench", "", "../secrets", "a" * 5000, "no\nsuch"])
def test_unknown_name_lists_the_shipped_ones(name):
    with pytest.raises(FileNotFoundError, match=r"[Tt]here are benchmark, circle, junction, line"):
        load_course(name)


def test_impossible_file_names_are_refused(load):
    with pytest.raises(FileNotFoundError, match=r"there is no course file missing.yaml"):
        load_course("missing.yaml")
    with pytest.raises(CourseFileError, match="cannot be read: File name too long"):
        load_course("a" * 5000 + ".csv")
    with pytest.raises(CourseFileError, match=r"own.yaml: its CSV file .* cannot be read: File name too long"):
        load(f"csv: {'a' * 5000}.csv")
    with pytest.raises(ValueError, match="null byte"):
        load_course("a\0.csv")


def test_unknown_ending_is_refused(tmp_path):
    path = tmp_path / "track.json"
    path.write_text("{}")
    with pytest.raises(CourseFileError, match=r"ending '.json' is not known"):
        load_course(path)


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
KEYS = st.sampled_from(
    ["name", "closed", "start", "elements", "csv", "line", "arc", "quintic", "section", "x_m", "radius_m", "angle_deg"]
)
JUNK = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS | st.text(max_size=3), inner, max_size=4)
)


@given(st.dictionaries(KEYS, JUNK, max_size=5))
def test_any_structure_gives_a_course_or_one_error(tmp_path_factory, document):
    path = tmp_path_factory.getbasetemp() / "structure.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    course, message = None, ""
    try:
        course = load_course(path)
    except (CourseFileError, FileNotFoundError) as error:
        message = str(error)
    assert 0 < len(message) < 1000 or isinstance(course, Course)


ROWS = "# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(
    f"{50.0 * math.cos(a)},{50.0 * math.sin(a)},6.0,7.0" for a in np.linspace(0.0, 6.0, 12)
)
SOUND = {
    "damaged.yaml": (resources.files("bike_sim") / "config/courses/junction.yaml").read_bytes(),
    "damaged.csv": ROWS.encode(),
}


@pytest.mark.parametrize("name", SOUND)
@given(st.data())
def test_damaged_file_gives_a_course_or_one_error(tmp_path_factory, name, data):
    text = bytearray(SOUND[name])
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(text) - 1))
        damage = bytes([data.draw(st.sampled_from(b"[]{}:;,-.&*!9e# \n\x00\xff"))]) + data.draw(st.binary(max_size=3))
        text[place : place + data.draw(st.integers(0, 3))] = damage
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(bytes(text))
    course, message = None, ""
    try:
        course = load_course(path)
    except CourseFileError as error:
        message = str(error)
    assert (name in message) == (course is None)
