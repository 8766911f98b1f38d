"""Messages written and read without message objects, held against rclpy's own serialisation."""

from __future__ import annotations

import math
import re
from array import array
from contextlib import suppress
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from bike_msgs.msg import BikeCommand, BikeState, Course, CoursePoints, LeanHistory, RideEvent, Telemetry
from diagnostic_msgs.msg import DiagnosticArray
from hypothesis import given, settings
from hypothesis import strategies as some
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Empty
from visualization_msgs.msg import MarkerArray

from bike_sim.ros.cdr import Codec

OWN = (BikeState, BikeCommand, Telemetry)
OTHERS = (
    Course, CoursePoints, LeanHistory, RideEvent,
    DiagnosticArray, Empty, JointState, MarkerArray, Odometry, PointCloud2,
)  # fmt: skip

WHOLE = {f"{sign}int{bits}": (bits, sign == "") for sign in ("", "u") for bits in (8, 16, 32, 64)}
NUMBERS = {"float": np.float32, "double": np.float64, **{kind: np.dtype(kind).type for kind in WHOLE}}
TEXTS = some.text(some.characters(exclude_characters="\0", codec="utf-8"), max_size=12)


def nested_types(kind: type) -> dict[str, dict[str, str]]:
    """Return the fields of all message types inside a type."""
    found: dict[str, dict[str, str]] = {}
    for field in kind.get_fields_and_field_types().values():
        name = re.sub(r"^sequence<|(, \d+)?>$|\[\d+\]$", "", field)
        if "/" in name and name not in found:
            inner = message_class(name)
            found |= {name: dict(inner.get_fields_and_field_types()), **nested_types(inner)}
    return found


def message_class(name: str) -> type:
    package, kind = name.split("/")
    return getattr(import_module(f"{package}.msg"), kind)


def codec_of(kind: type) -> Codec:
    return Codec(kind.get_fields_and_field_types(), nested_types(kind))


def value_of(field: str) -> some.SearchStrategy[Any]:
    """Return a strategy for the values of a field."""
    if found := re.fullmatch(r"sequence<(.+?)(, \d+)?>", field):
        return some.lists(value_of(found[1]), max_size=5)
    if found := re.fullmatch(r"(.+)\[(\d+)\]", field):
        return some.lists(value_of(found[1]), min_size=int(found[2]), max_size=int(found[2]))
    if field in WHOLE:
        bits, signed = WHOLE[field]
        return some.integers(-(2 ** (bits - 1)) * signed, 2 ** (bits - signed) - 1)
    simple = {
        "boolean": some.booleans(),
        "string": TEXTS,
        "octet": some.binary(min_size=1, max_size=1),
        "double": some.floats(),
        "float": some.floats(width=32),
    }
    return simple[field] if field in simple else message_of(message_class(field))


def message_of(kind: type) -> some.SearchStrategy[Any]:
    """Return a strategy for messages of a type."""
    fields = kind.get_fields_and_field_types()

    def fill(values: dict[str, Any]) -> Any:
        message = kind()
        for name, value in values.items():
            element = re.sub(r"^sequence<|>$|\[\d+\]$", "", fields[name])
            if isinstance(value, list) and element in NUMBERS and fields[name].endswith("]"):
                value = np.array(value, dtype=NUMBERS[element])
            setattr(message, name, value)
        return message

    return some.fixed_dictionaries({name: value_of(field) for name, field in fields.items()}).map(fill)


def flat(message: Any, prefix: str = "") -> dict[str, Any]:
    """Return the values of a message as a codec names them."""
    values: dict[str, Any] = {}
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            values |= flat(value, f"{prefix}{name}.")
        elif isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
            values[prefix + name] = [flat(entry) for entry in value]
        else:
            values[prefix + name] = value
    return values


def assert_same(found: Any, wanted: Any) -> None:
    """Numbers are the same bit for bit, NaN with NaN."""
    if isinstance(wanted, dict):
        assert list(found) == list(wanted)
        for name in wanted:
            assert_same(found[name], wanted[name])
    elif isinstance(found, np.ndarray | array):
        np.testing.assert_array_equal(found, np.asarray(wanted))
    elif isinstance(found, list):
        assert len(found) == len(wanted)
        for one, other in zip(found, wanted, strict=True):
            assert_same(one, other)
    elif isinstance(wanted, float) and math.isnan(wanted):
        assert math.isnan(found)
    else:
        assert found == wanted
        assert type(found) is type(wanted)


def empty_lists(values: dict[str, Any]) -> int:
    count = 0
    for value in values.values():
        if not isinstance(value, str | bytes) and hasattr(value, "__len__"):
            count += len(value) == 0
            count += sum(empty_lists(entry) for entry in value if isinstance(entry, dict))
    return count


def assert_codec_agrees(message: Any) -> None:
    """The codec reads what rclpy wrote, and rclpy reads what the codec wrote: the same values in as many bytes."""
    codec = codec_of(type(message))
    theirs = serialize_message(message)
    values = flat(message)
    assert_same(codec.decode(theirs), values)
    ours = codec.encode(values)
    assert codec.encode([values[name] for name in codec.names]) == ours
    assert_same(flat(deserialize_message(ours, type(message))), values)
    # rclpy rounds the length up, reckons with alignment before the numbers of an empty sequence, which has none, and
    # leaves in what only fills up whatever was in its memory.
    assert 0 <= len(theirs) - len(ours) <= 3 + 8 * empty_lists(values)
    filled = bytes(a if a == b else 0 for a, b in zip(ours, theirs, strict=False))
    assert filled == ours


@pytest.mark.parametrize("kind", OWN)
@settings(max_examples=100)
@given(data=some.data())
def test_own_messages_are_those_of_rclpy(kind: type, data: some.DataObject) -> None:
    assert_codec_agrees(data.draw(message_of(kind)))


@pytest.mark.parametrize("kind", OTHERS)
@settings(max_examples=15)
@given(data=some.data())
def test_other_messages_are_those_of_rclpy(kind: type, data: some.DataObject) -> None:
    assert_codec_agrees(data.draw(message_of(kind)))


def test_decoded_arrays_are_aligned_and_of_their_own() -> None:
    """Compiled functions take other arrays for other types and are compiled once more."""
    codec = codec_of(LeanHistory)
    data = serialize_message(LeanHistory(roll=[0.1, 0.2]))
    first, second = (codec.decode(data)["roll"] for _ in range(2))
    assert first.flags.aligned
    assert first.flags.writeable
    first[:] = 0.0
    assert list(second) == [0.1, 0.2]


@pytest.mark.parametrize("message", [BikeState(vehicle="whipple", preview_x=[1.0, 2.0]), DiagnosticArray()])
def test_a_message_that_was_cut_off_is_one_error(message: Any) -> None:
    codec = codec_of(type(message))
    data = codec.encode(flat(message))
    for length in range(len(data)):
        with pytest.raises(ValueError, match=r"^field|^a message in plain little-endian CDR begins with 00 01"):
            codec.decode(data[:length])


@given(some.binary(max_size=200))
def test_bytes_of_a_stranger_are_a_message_or_one_error(data: bytes) -> None:
    for kind in (BikeState, DiagnosticArray, JointState):
        with suppress(ValueError):
            codec_of(kind).decode(b"\x00\x01\x00\x00" + data)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"steering": "left"}, "field steering of type double cannot be 'left'"),
        ({"episode": -1}, "field episode of type uint32 cannot be -1"),
        ({"step": None}, "field step of type uint32 cannot be None"),
        ({"header.frame_id": 3}, "field header.frame_id of type string cannot be 3: it is no text"),
        ({"header.frame_id": "a\0b"}, "field header.frame_id of type string cannot be 'a\\x00b'"),
    ],
)
def test_a_value_that_cannot_be_is_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        codec_of(BikeCommand).encode(flat(BikeCommand()) | changes)


def test_what_is_missing_or_unknown_is_named() -> None:
    with pytest.raises(ValueError, match="field steering has no value"):
        codec_of(BikeCommand).encode({name: 0 for name in codec_of(BikeCommand).names if name != "steering"})
    with pytest.raises(ValueError, match="a message of 7 values was given 2"):
        codec_of(BikeCommand).encode([1, 2])
    with pytest.raises(ValueError, match="field pose has type 'a/Pose', whose fields are not known"):
        Codec({"pose": "a/Pose"})
    with pytest.raises(ValueError, match="its length is 3, not 2"):
        Codec({"axis": "double[3]"}).encode({"axis": [1.0, 2.0]})
    with pytest.raises(ValueError, match="its length is at most 2, not 3"):
        Codec({"axis": "sequence<double, 2>"}).encode({"axis": [1.0, 2.0, 3.0]})
    with pytest.raises(ValueError, match="begins with 00 01, this one with 00 00"):
        codec_of(BikeCommand).decode(bytes(100))
