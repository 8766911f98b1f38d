"""Files that users write are read within bounds, and refused in one short line that a terminal can show."""

import os
import string
import time
import unicodedata
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from bike_sim import documents
from bike_sim.course.files import kind_of, load_course, load_track
from bike_sim.documents import DocumentError, check_name, parse_yaml, read_text, shorten, show
from bike_sim.recording.definitions import message_type
from bike_sim.vehicles.files import SHIPPED, load_vehicle
from tests.odd_files import ODD, put_odd_file

LOADERS = [load_course, load_track, kind_of, load_vehicle]

PATIENCE = 5.0
"""No refusal takes longer, s; most take milliseconds."""


def refusal(load, path) -> str:
    """Return the message with which a file is refused in time."""
    begin = time.process_time()
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        load(path)
    assert time.process_time() - begin < PATIENCE
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 1000
    return message


def refused(function, *arguments) -> str:
    """Return the message with which something is refused, or nothing where it is not."""
    try:
        function(*arguments)
    except DocumentError as error:
        return str(error)
    return ""


@pytest.mark.timeout(30)
@pytest.mark.parametrize("load", LOADERS)
@pytest.mark.parametrize("kind", ODD)
def test_what_is_no_regular_file_is_refused_at_once(load, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = put_odd_file(Path("odd.yaml"), kind)
    message = refusal(load, "odd.yaml")
    assert "odd.yaml" in message
    assert said in message
    os.mkfifo("points.csv")
    Path("own.yaml").write_text("csv: points.csv")
    assert "points.csv is no file but a pipe" in refusal(load_course, "own.yaml")


@pytest.mark.parametrize("load", LOADERS)
@pytest.mark.parametrize(
    "content", [b"#" * 20_000_000, b"a: [" + b"1," * 400_000 + b"]", b"[" * 249_000, b"- " * 120_000, b"? " * 120_000]
)
def test_large_and_deep_files_are_refused_before_they_cost_anything(load, content, tmp_path):
    path = tmp_path / "large.yaml"
    path.write_bytes(content)
    assert "large.yaml" in refusal(load, path)


def bomb(levels: int, width: int) -> str:
    """Return a small YAML document that stands for width^levels values."""
    lines = ["a0: &a0 [" + ",".join("1" * width) + "]"]
    lines += [f"a{i}: &a{i} [" + ",".join([f"*a{i - 1}"] * width) + "]" for i in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize("load", LOADERS)
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (bomb(9, 9), "more than 100000 values at row 6"),
        (bomb(15, 2) + "\nb: " + "[" * 10 + "*a14" + "]" * 10, "nested too deeply: more than 20 levels"),
        ("name: &a [*a]", "contains itself, by an alias at row 1"),
        ("a: &a {b: *a}", "contains itself, by an alias at row 1"),
        ("a: &a 1\nb: &a 2", "found duplicate anchor 'a'"),
    ],
)
def test_aliases_that_multiply_or_contain_themselves_are_refused(load, text, message, tmp_path):
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    assert message in refusal(load, path)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(string.ascii_letters, max_size=5), inner),
    max_leaves=20,
)


@given(VALUES)
@example("0\x85").via("a line break that PyYAML writes as it is, and reads as a space")
def test_a_document_comes_back_as_it_was_written(value):
    assert parse_yaml(yaml.safe_dump(value)) == value
    plain = yaml.safe_dump(value, allow_unicode=True)
    assert parse_yaml(plain) == yaml.safe_load(plain)
    assert parse_yaml("a: &a [1, 2]\nb: *a\nc: {<<: {d: 3}}") == {"a": [1, 2], "b": [1, 2], "c": {"d": 3}}


@given(st.text(max_size=200) | st.text("{}[]&*!|>?:-,#'\"%@ab1 \n\t", max_size=100))
def test_any_text_is_a_document_or_one_short_line(text):
    for as_text in (True, False):
        message = refused(parse_yaml, text, as_text)
        assert message.isprintable()
        assert len(message) < 400


@given(st.binary(max_size=50))
def test_any_bytes_are_text_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.txt"
    path.write_bytes(data)
    message = refused(read_text, path, 40)
    assert message.isprintable()
    assert message or data.decode("utf-8-sig") == read_text(path, 40)


@given(st.text())
def test_a_name_is_short_and_can_be_shown_or_is_refused(name):
    message = refused(check_name, name, "name")
    shown = not {"Cc", "Cf", "Cs", "Zl", "Zp"} & {unicodedata.category(c) for c in name}
    assert (not message) == (shown and bool(name.strip()) and len(name) <= 200)
    assert message.isprintable()
    assert len(message) < 300


@given(st.text(max_size=2000), st.integers(20, 300))
def test_what_a_message_repeats_is_short_and_can_be_shown(text, limit):
    short = shorten(text, limit)
    assert len(short) <= limit
    assert documents.escape(short) == short
    assert "\n" not in short
    assert len(show(text)) <= 4 * 60 + 200


EVIL = {
    "screen cleared": "a\x1b[2J",
    "line end": "a\nb",
    "right to left": "a\u202eb",
    "nothing": "",
    "long": "a" * 201,
}


@pytest.mark.parametrize("name", EVIL.values(), ids=EVIL.keys())
@pytest.mark.parametrize(
    ("load", "document"),
    [
        (load_course, {"name": None, "elements": [{"line": 10}]}),
        (load_course, {"elements": [{"line": 10, "section": None}]}),
        (load_track, {"format": "bike.track/1", "length_m": 9, "width_m": 5, "elements": [], "name": None}),
        (load_track, {"format": "bike.track/1", "length_m": 9, "width_m": 5, "elements": [{"corner": None}]}),
    ],
)
def test_evil_names_in_courses_are_refused(load, document, name, tmp_path):
    def put(value):
        if isinstance(value, dict):
            return {key: put(inner) if inner is not None else name for key, inner in value.items()}
        return [put(inner) for inner in value] if isinstance(value, list) else value

    if document.get("elements") and "corner" in document["elements"][0]:
        document = {**document, "elements": [{"arc": {"length_m": 5, "angle_deg": 9}, "corner": None}]}
    path = tmp_path / "evil.yaml"
    path.write_text(yaml.safe_dump(put(document)))
    assert any(word in refusal(load, path) for word in ("name", "section", "corner"))


@pytest.mark.parametrize("name", EVIL.values(), ids=EVIL.keys())
@pytest.mark.parametrize("key", ["name", "description"])
def test_evil_names_in_vehicles_are_refused(name, key, tmp_path):
    if key == "description" and name in ("a\nb", "a" * 201):
        name = "a" * 4001  # a description may be longer, and of several lines
    document = yaml.safe_load((SHIPPED / "whipple.yaml").read_text(encoding="utf-8"))
    path = tmp_path / "evil.yaml"
    path.write_text(yaml.safe_dump({**document, key: name}))
    assert key in refusal(load_vehicle, path)


def test_a_file_with_an_evil_name_gives_no_evil_course(tmp_path):
    path = tmp_path / "a\x1b[2Jb.yaml"
    path.write_text("elements: [{line: 10}]")
    assert "U+001B" in refusal(load_course, path)
    path.write_text("name: tame\nelements: [{line: 10}]")
    assert load_course(path).name == "tame"


@pytest.mark.parametrize("load", LOADERS)
@pytest.mark.parametrize(
    "name", ["x" * 100_000, "\x1b[31m", "a\0b", "no\nsuch", "\udcff", "x" * 5000 + ".yaml", "\0.yaml"]
)
def test_evil_names_that_are_asked_for_are_shown_tame(load, name):
    refusal(load, name)


@pytest.mark.parametrize("value", ["x" * 200_000, ["x"] * 4_000, {"x" * 900: 1}, {str(i): i for i in range(900)}])
def test_huge_values_are_not_repeated(value, tmp_path):
    document = yaml.safe_load((SHIPPED / "whipple.yaml").read_text(encoding="utf-8"))
    for change in ({"format": value}, {"bicycle": value}, {"limits": {"fall_roll_deg": value}}, {"type": value}):
        path = tmp_path / "huge.yaml"
        path.write_text(yaml.safe_dump({**document, **change}))
        refusal(load_vehicle, path)


def test_definitions_are_read_within_bounds(tmp_path, monkeypatch):
    folder, index = tmp_path / "share/evil_msgs/msg", tmp_path / "share/ament_index/resource_index/packages"
    folder.mkdir(parents=True)
    index.mkdir(parents=True)
    (index / "evil_msgs").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    os.mkfifo(folder / "Pipe.msg")
    (folder / "Huge.msg").write_bytes(b"#" * 2_000_000)
    (folder / "Hash.msg").write_text("int8 a\n")
    (folder / "Hash.json").write_text("[" * 100_000)
    with pytest.raises((ValueError, FileNotFoundError), match=r"Pipe"):
        message_type("evil_msgs/msg/Pipe")
    with pytest.raises(ValueError, match=r"Huge.msg is larger than 1 MB"):
        message_type("evil_msgs/msg/Huge")
    with pytest.raises(ValueError, match=r"Hash.json does not list type hashes"):
        message_type("evil_msgs/msg/Hash")
