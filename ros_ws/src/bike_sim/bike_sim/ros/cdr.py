"""Messages to CDR bytes and back, without a message object between. Imports no ROS.

rclpy fills a message field by field, checks each value, copies the fields into a C structure and writes that down,
which costs several times as much as the bytes do. A `Codec` is made once for a type, from what
``Message.get_fields_and_field_types()`` returns. Neighbouring fields of fixed size are written by one precompiled
`struct`, arrays of numbers by numpy in one piece. The bytes are what ``publisher.publish(bytes)`` sends and what a
subscription with ``raw=True`` receives.

Written is plain CDR of version 1 with little-endian numbers, as Fast DDS does on x86: each number begins at a multiple
of its size, counted from the end of the four bytes that name the encoding. A sequence is its length (uint32) and its
elements; a text the same, with a zero at its end.

Source: OMG DDS-XTypes 1.3 (formal/2020-02-04), 7.4.1 and 7.4.3.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import Any, Final

import numpy as np

ENCODING: Final = b"\x00\x01\x00\x00"
"""Head of a message: CDR, little-endian, no options."""

Fields = Mapping[str, str]
"""Types by field, as ``get_fields_and_field_types()`` of a message class returns them."""

HEADER: Final = "std_msgs/Header"
KNOWN: Final[Mapping[str, Fields]] = {
    "builtin_interfaces/Time": {"sec": "int32", "nanosec": "uint32"},
    "builtin_interfaces/Duration": {"sec": "int32", "nanosec": "uint32"},
    HEADER: {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
}
"""Nested types that every codec knows."""

_NUMBERS: Final = {
    "boolean": "?", "octet": "c", "char": "B", "float": "f", "double": "d", "int8": "b", "uint8": "B", "int16": "h",
    "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q",
}  # fmt: skip
"""Codes of `struct` for the types of fixed size."""

_SEQUENCE: Final = re.compile(r"sequence<(.+?)(?:, (\d+))?>")
_ARRAY: Final = re.compile(r"(.+)\[(\d+)\]")
_TEXT: Final = re.compile(r"string(?:<(\d+)>)?")
_LARGEST: Final = 8
"""Largest size of a number, bytes. What is aligned to it is aligned to all."""


class Codec:
    """Writes and reads messages of one type.

    A nested message counts as its own fields, under names with dots, such as ``header.stamp.sec``; elements of a
    sequence of messages are mappings in turn.

    Attributes:
        names: names of the values, in the order in which a message has them.
    """

    def __init__(self, fields: Fields | Sequence[tuple[str, str]], nested: Mapping[str, Fields] | None = None) -> None:
        """Compile a type.

        Args:
            fields: names and types of its fields, in order.
            nested: fields of the message types it contains, by their names (``package/Type``), in addition to `KNOWN`.

        Raises:
            ValueError: a type that is not known, or cannot be written.
        """
        self._steps = _steps(dict(fields), {**KNOWN, **(nested or {})})
        self.names: tuple[str, ...] = tuple(name for step in self._steps for name in step.names)
        self._pick = itemgetter(*self.names) if len(self.names) > 1 else None

    def encode(self, values: Mapping[str, Any] | Sequence[Any]) -> bytes:
        """Write a message.

        Args:
            values: by name, or in the order of `names`. Arrays of numbers may be anything that numpy takes.

        Returns:
            The message with its head, as ``publisher.publish`` takes it.

        Raises:
            ValueError: a value is missing or does not fit its field.
        """
        out = bytearray(ENCODING)
        row = self._row(values)
        at = 0
        for step in self._steps:
            end = at + step.count
            try:
                step.write(out, row[at:end])
            except (struct.error, TypeError, ValueError, OverflowError) as error:
                raise step.complaint(row[at:end], error) from error
            at = end
        return bytes(out)

    def decode(self, data: bytes | bytearray | memoryview) -> dict[str, Any]:
        """Read a message.

        Args:
            data: a message with its head; bytes after its last field are ignored.

        Returns:
            Its values by name, in the order of `names`. Arrays of numbers are numpy arrays of this call's own.

        Raises:
            ValueError: the bytes are another encoding, or end too soon.
        """
        return dict(zip(self.names, self.unpack(data), strict=True))

    def unpack(self, data: bytes | bytearray | memoryview) -> list[Any]:
        """Read a message as `decode` does, and return its values in the order of `names`."""
        if bytes(data[:2]) != ENCODING[:2]:
            raise ValueError(f"a message in plain little-endian CDR begins with 00 01, this one with {_shown(data)}")
        body = bytearray(memoryview(data)[len(ENCODING) :])  # a copy, in which arrays of numbers are aligned
        values: list[Any] = []
        offset = 0
        for step in self._steps:
            try:
                offset = step.read(body, offset, values)
            except (struct.error, ValueError) as error:
                raise ValueError(f"field {step.names[0] if step.names else ''}: {error}") from error
        return values

    def _row(self, values: Mapping[str, Any] | Sequence[Any]) -> Sequence[Any]:
        if isinstance(values, Mapping):
            try:
                return self._pick(values) if self._pick else [values[name] for name in self.names]
            except KeyError as error:
                raise ValueError(f"field {error.args[0]} has no value") from error
        if len(values) != len(self.names):
            raise ValueError(f"a message of {len(self.names)} values was given {len(values)}")
        return values


# ---------------------------------------------------------------------------------------------------------------- steps


class _Step:
    """Part of a message: some values that are written and read together.

    Attributes:
        names: of its values. types: of its values. count: their number.
    """

    def __init__(self, names: Sequence[str], types: Sequence[str]) -> None:
        self.names = tuple(names)
        self.types = tuple(types)
        self.count = len(self.names)

    def write(self, out: bytearray, values: Sequence[Any]) -> None:
        """Append values to a message that begins with its head."""
        raise NotImplementedError

    def read(self, body: bytearray, offset: int, values: list[Any]) -> int:
        """Append the values that begin at an offset in a message without its head; return where they end."""
        raise NotImplementedError

    def complaint(self, values: Sequence[Any], error: Exception) -> ValueError:
        """Return the fault of values that could not be written."""
        return ValueError(f"field {self.names[0]} of type {self.types[0]} cannot be {_shown(values[0])}: {error}")


class _Run(_Step):
    """Neighbouring numbers, with one `struct` for each offset from a multiple of eight at which they may begin."""

    def __init__(self, names: Sequence[str], types: Sequence[str]) -> None:
        super().__init__(names, types)
        self._codes = "".join(_NUMBERS[kind] for kind in types)
        self._structs = [struct.Struct(_aligned(self._codes or "x", start)) for start in range(_LARGEST)]

    def write(self, out: bytearray, values: Sequence[Any]) -> None:
        out += self._structs[(len(out) - len(ENCODING)) % _LARGEST].pack(*values)

    def read(self, body: bytearray, offset: int, values: list[Any]) -> int:
        layout = self._structs[offset % _LARGEST]
        values += layout.unpack_from(body, offset)
        return offset + layout.size

    def complaint(self, values: Sequence[Any], error: Exception) -> ValueError:
        for name, kind, code, value in zip(self.names, self.types, self._codes, values, strict=True):
            try:
                struct.pack(f"<{code}", value)
            except (struct.error, TypeError, OverflowError) as reason:
                return ValueError(f"field {name} of type {kind} cannot be {_shown(value)}: {reason}")
        return ValueError(str(error))


class _Text(_Step):
    """A text."""

    def __init__(self, name: str, kind: str) -> None:
        super().__init__([name], [kind])
        self._longest = _bound(_TEXT, kind, 1)

    def write(self, out: bytearray, values: Sequence[Any]) -> None:
        _write_text(out, values[0], self._longest)

    def read(self, body: bytearray, offset: int, values: list[Any]) -> int:
        text, end = _read_text(body, offset)
        values.append(text)
        return end


class _Numbers(_Step):
    """An array or a sequence of numbers, as a numpy array."""

    def __init__(self, name: str, kind: str, element: str, length: int | None, longest: int | None) -> None:
        super().__init__([name], [kind])
        self._type = np.dtype(f"<{_NUMBERS[element]}")
        self._size = self._type.itemsize
        self._length, self._longest = length, longest
        # The length of a sequence, and the alignment before and after it.
        self._heads = [struct.Struct(_aligned(f"I{_NUMBERS[element]}", start)[:-1]) for start in range(_LARGEST)]

    def write(self, out: bytearray, values: Sequence[Any]) -> None:
        array = np.asarray(values[0], dtype=self._type)
        if array.ndim != 1:
            raise ValueError(f"it has {array.ndim} axes instead of one")
        length = array.size
        _check_length(length, self._length, self._longest)
        if self._length is not None:
            _pad(out, self._size)
        elif length:
            out += self._heads[(len(out) - len(ENCODING)) % _LARGEST].pack(length)
        else:  # nothing follows that would have to be aligned
            _write_length(out, 0)
        out += array.tobytes()

    def read(self, body: bytearray, offset: int, values: list[Any]) -> int:
        length = self._length
        if length is None:
            length, offset = _read_length(body, offset)
        if length:
            offset += -offset % self._size
        end = offset + length * self._size
        if end > len(body):
            raise ValueError(f"{length} numbers are announced, and the message ends before")
        values.append(np.frombuffer(body, self._type, length, offset if length else 0))
        return end


class _List(_Step):
    """An array or a sequence of texts or messages, as a list."""

    def __init__(self, name: str, kind: str, element: Codec | None, length: int | None, longest: int | None) -> None:
        """Compile it. `element` is the codec of the messages, or None for texts."""
        super().__init__([name], [kind])
        self._element = element
        self._length, self._longest = length, longest

    def write(self, out: bytearray, values: Sequence[Any]) -> None:
        entries = values[0]
        if isinstance(entries, str):
            raise ValueError("a list is needed")
        _check_length(len(entries), self._length, self._longest)
        if self._length is None:
            _write_length(out, len(entries))
        for entry in entries:
            if self._element is None:
                _write_text(out, entry, None)
                continue
            row, at = self._element._row(entry), 0
            for step in self._element._steps:
                step.write(out, row[at : at + step.count])
                at += step.count

    def read(self, body: bytearray, offset: int, values: list[Any]) -> int:
        length = self._length
        if length is None:
            length, offset = _read_length(body, offset)
        if length > len(body) - offset:  # each element has a byte at least
            raise ValueError(f"{length} elements are announced, and the message ends before")
        entries: list[Any] = []
        for _ in range(length):
            if self._element is None:
                text, offset = _read_text(body, offset)
                entries.append(text)
                continue
            row: list[Any] = []
            for step in self._element._steps:
                offset = step.read(body, offset, row)
            entries.append(dict(zip(self._element.names, row, strict=True)))
        values.append(entries)
        return offset


# ---------------------------------------------------------------------------------------------------------- compilation


def _steps(fields: Fields, known: Mapping[str, Fields]) -> list[_Step]:
    """Return the steps of a type: runs of numbers as long as possible, and one for each other field."""
    steps: list[_Step] = []
    run: dict[str, str] = {}
    for name, kind in _flat(fields, known):
        if kind in _NUMBERS:
            run[name] = kind
            continue
        if run:
            steps.append(_Run(list(run), list(run.values())))
            run = {}
        steps.append(_Run([], []) if not kind else _step(name, kind, known))
    if run:
        steps.append(_Run(list(run), list(run.values())))
    return steps


def _flat(fields: Fields, known: Mapping[str, Fields], prefix: str = "") -> list[tuple[str, str]]:
    """Return names and types with nested messages flattened. One without fields is a byte, marked by an empty type."""
    if not fields:
        return [(prefix, "")]
    flat: list[tuple[str, str]] = []
    for name, kind in fields.items():
        if kind in known:
            flat += _flat(known[kind], known, f"{prefix}{name}.")
        else:
            flat.append((prefix + name, kind))
    return flat


def _step(name: str, kind: str, known: Mapping[str, Fields]) -> _Step:
    if _TEXT.fullmatch(kind):
        return _Text(name, kind)
    length = longest = None
    if found := _SEQUENCE.fullmatch(kind):
        element, longest = found[1], int(found[2]) if found[2] else None
    elif found := _ARRAY.fullmatch(kind):
        element, length = found[1], int(found[2])
    else:
        raise ValueError(f"field {name} has type {kind!r}, whose fields are not known")
    if element in _NUMBERS and element != "octet":
        return _Numbers(name, kind, element, length, longest)
    if element in known:
        return _List(name, kind, Codec(known[element], known), length, longest)
    if _TEXT.fullmatch(element):
        return _List(name, kind, None, length, longest)
    raise ValueError(f"field {name} has type {kind!r}, whose elements are not known")


def _aligned(codes: str, start: int) -> str:
    """Return the format of numbers that begin at an offset, with the padding that alignment requires."""
    parts, offset = ["<"], start
    for code in codes:
        size = struct.calcsize(f"<{code}")
        gap = -offset % size
        parts.append("x" * gap + code)
        offset += gap + size
    return "".join(parts)


def _bound(pattern: re.Pattern[str], kind: str, group: int) -> int | None:
    found = pattern.fullmatch(kind)
    return int(found[group]) if found and found[group] else None


# --------------------------------------------------------------------------------------------------------- small pieces

_LENGTHS: Final = [struct.Struct(_aligned("I", start)) for start in range(4)]


def _write_length(out: bytearray, length: int) -> None:
    out += _LENGTHS[len(out) % 4].pack(length)


def _read_length(body: bytearray, offset: int) -> tuple[int, int]:
    layout = _LENGTHS[offset % 4]
    return layout.unpack_from(body, offset)[0], offset + layout.size


def _write_text(out: bytearray, text: str, longest: int | None) -> None:
    data = _text_bytes(text)
    _check_length(len(data) - 5, None, longest)
    out += bytes(-len(out) % 4)
    out += data


@lru_cache(maxsize=256)
def _text_bytes(text: str) -> bytes:
    """Return a text with its length before it. Most come again and again: names of frames and vehicles."""
    if not isinstance(text, str):
        raise TypeError("it is no text")
    data = text.encode()
    if 0 in data:
        raise ValueError("a text cannot contain a zero character")
    return struct.pack("<I", len(data) + 1) + data + b"\0"


def _read_text(body: bytearray, offset: int) -> tuple[str, int]:
    length, offset = _read_length(body, offset)
    end = offset + length
    if end > len(body):
        raise ValueError(f"a text of {length} bytes is announced, and the message ends before")
    return body[offset : max(end - 1, offset)].decode(), end


def _pad(out: bytearray, size: int) -> None:
    gap = -(len(out) - len(ENCODING)) % size
    if gap:
        out += bytes(gap)


def _check_length(length: int, exact: int | None, longest: int | None) -> None:
    if exact is not None and length != exact:
        raise ValueError(f"its length is {exact}, not {length}")
    if longest is not None and length > longest:
        raise ValueError(f"its length is at most {longest}, not {length}")


def _shown(value: Any) -> str:
    """Return a value for an error, cut where it is long."""
    text = value[:8].hex(" ") if isinstance(value, bytes | bytearray | memoryview) else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
