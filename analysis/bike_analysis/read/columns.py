"""Columns out of CDR messages, many at a time.

It is our own for its speed alone (`bike bench analysis` against `rosbags`, docs/results.md): decoding message by
message in Python costs tens of microseconds each, and an hour of states at 100 Hz is 360,000 of them. But the
messages of one topic mostly have one layout, because their strings and arrays keep their lengths. So the layout is
computed once for the first message that no known layout fits, and the fields of all messages that share it are
picked out of the recording with one NumPy expression each. Messages whose lengths differ get their own layout;
nothing is assumed that is not checked.

Encoding: classic CDR (XCDR1, OMG DDS-XTypes 1.3, 7.4.1): a four-byte header that names the byte order, then fields
aligned to their size from there.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]

BATCH: Final = 4096
"""Messages decoded at once; bounds the memory that raw messages hold."""

_HEADER_BYTES: Final = 4
_DEEPEST: Final = 32
"""Largest nesting of messages; deeper definitions are recursive."""
_LONGEST_ARRAY: Final = 4096
"""Elements of an array of messages or strings of fixed length; the decoder makes code for each of them."""
_KEPT_LAYOUTS: Final = 8
"""Layouts that are tried before a new one is computed."""
_DTYPES: Final = {
    "bool": "u1",
    "byte": "u1",
    "octet": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}


class SchemaError(ValueError):
    """A message definition cannot be understood, or a message does not fit it."""


@lru_cache(maxsize=64)
def _typestore(name: str, definition: str) -> Typestore:
    """Store of a type and its nested types; cached, because parsing takes tens of milliseconds."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(definition, name))
    except Exception as error:  # the parser has no common error class
        raise SchemaError(f"the definition of {name} in the recording cannot be parsed: {error}") from error
    return store


class MessageSchema:
    """A message type as the recording describes it; knows how to decode its messages.

    Attributes:
        name: Full type name, ``package/msg/Type``.
    """

    def __init__(self, name: str, definition: str) -> None:
        """Parse a definition in the ``ros2msg`` encoding.

        Args:
            name: Full type name.
            definition: The type's ``.msg`` text and those of its nested types.

        Raises:
            SchemaError: If the text cannot be parsed.
        """
        self.name = name
        self._store = _typestore(name, definition)
        self._refuse_what_never_ends()

    def _refuse_what_never_ends(self) -> None:
        """No type may contain itself; nor may there be arrays of nothing, whose number no bytes would bound."""
        for type_name in self._store.fielddefs:
            self._refuse_itself(type_name, ())
            for field, kind, detail in self._fields_of(type_name, 0):
                if kind in (Nodetype.BASE, Nodetype.NAME):
                    continue
                (inner_kind, inner), length = detail
                number = inner_kind == Nodetype.BASE and inner[0] in _DTYPES
                if kind == Nodetype.ARRAY and not number and int(length) > _LONGEST_ARRAY:
                    raise SchemaError(f"field {field} of {type_name} in the recording has {length} elements")
                if inner_kind == Nodetype.NAME and self._is_empty(inner, 0):
                    raise SchemaError(f"field {field} of {type_name} in the recording is an array of nothing")

    def _refuse_itself(self, type_name: str, within: tuple[str, ...]) -> None:
        for _, kind, detail in self._fields_of(type_name, len(within)):
            inner_kind, inner = (kind, detail) if kind in (Nodetype.BASE, Nodetype.NAME) else detail[0]
            if inner_kind == Nodetype.NAME:
                if inner in (type_name, *within):
                    raise SchemaError(f"type {inner} in the recording contains itself")
                self._refuse_itself(inner, (*within, type_name))

    def _is_empty(self, type_name: str, depth: int) -> bool:
        return all(
            kind == Nodetype.NAME and self._is_empty(detail, depth + 1)
            for _, kind, detail in self._fields_of(type_name, depth)
        )

    def decode(self, data: bytes) -> Any:
        """Decode one message of any type into an object with an attribute for each field.

        Args:
            data: CDR bytes with header.

        Returns:
            The message; numeric arrays are NumPy arrays.

        Raises:
            SchemaError: If the bytes do not fit the type.
        """
        return self._decode(data)[0]

    def trim(self, data: bytes) -> bytes:
        """Cut off what follows a message.

        ``rclpy.serialization.serialize_message`` reserves room for alignment that empty arrays do not need and hands
        the whole buffer over (rmw_fastrtps 8.4), so that some arbitrary bytes may follow the message. Messages that
        came over DDS have their exact length. Strict readers refuse the excess.

        Args:
            data: CDR bytes with header, and possibly more.

        Returns:
            The message's own bytes.

        Raises:
            SchemaError: If the bytes do not fit the type.
        """
        return data[: self._decode(data)[1]]

    def _decode(self, data: bytes) -> tuple[Any, int]:
        """The decoded message and its length in bytes."""
        if len(data) < _HEADER_BYTES or data[0] != 0 or data[1] > 1:
            raise SchemaError(
                f"a {self.name} begins with {data[:_HEADER_BYTES]!r}, which is not the header of plain CDR"
            )
        definition = self._store.get_msgdef(self.name)
        decode = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
        try:
            message, end = decode(data[_HEADER_BYTES:], 0, definition.cls, self._store)
        except Exception as error:  # what the generated code raises depends on the damage
            raise SchemaError(f"a {self.name} of {len(data)} bytes cannot be decoded: {error}") from error
        if end + _HEADER_BYTES > len(data):
            raise SchemaError(f"a {self.name} of {len(data)} bytes is shorter than its fields")
        return message, end + _HEADER_BYTES

    def fields(self) -> set[str]:
        """Names of the fields that can become columns; nested ones with dots, as ``header.stamp.sec``."""
        return {name for name, kind, _ in self._leaves(self.name, "", 0) if kind is not None}

    def scalars(self) -> set[str]:
        """Names of the fields that are one number or flag."""
        return {name for name, kind, many in self._leaves(self.name, "", 0) if kind in _DTYPES and not many}

    def _leaves(self, type_name: str, prefix: str, depth: int) -> Iterator[tuple[str, str | None, bool]]:
        """Fields, nested messages resolved: name, basic type (None for an array of others) and whether it is an array.

        Strings count as a separate basic type.
        """
        for field, kind, detail in self._fields_of(type_name, depth):
            name = f"{prefix}{field}"
            if kind == Nodetype.NAME:
                yield from self._leaves(detail, f"{name}.", depth + 1)
            elif kind == Nodetype.BASE:
                yield name, detail[0], False
            else:
                (inner_kind, inner), _ = detail
                number = inner_kind == Nodetype.BASE and inner[0] in _DTYPES
                yield name, inner[0] if number else None, True

    def _fields_of(self, type_name: str, depth: int) -> Iterator[tuple[str, Any, Any]]:
        """Name, kind and detail of a type's own fields, in the order of transmission."""
        if depth > _DEEPEST:
            raise SchemaError(f"the definition of {self.name} in the recording contains itself")
        if type_name not in self._store.fielddefs:
            raise SchemaError(f"the definition of {self.name} in the recording lacks the type {type_name}")
        for field, (kind, detail) in self._store.fielddefs[type_name][1]:
            yield field, kind, detail

    def layout(self, data: bytes) -> MessageLayout:
        """Compute the offsets of the fields of a message.

        Args:
            data: CDR bytes with header.

        Returns:
            Its layout, which holds for every message with the same lengths.

        Raises:
            SchemaError: If the message is not plain CDR or too short for the type.
        """
        if len(data) < _HEADER_BYTES or data[0] != 0 or data[1] > 1:
            raise SchemaError(f"a {self.name} begins with {data[:_HEADER_BYTES]!r}, which is no header of plain CDR")
        walker = _Walker(self.name, data)
        self._walk(walker, self.name, "", 0)
        return MessageLayout(tuple(walker.places), tuple(walker.guards), walker.position)

    def _walk(self, walker: _Walker, type_name: str, prefix: str | None, depth: int) -> None:
        """Walk over the fields of a type; without a prefix they are passed and not noted."""
        for field, kind, detail in self._fields_of(type_name, depth):
            name = None if prefix is None else f"{prefix}{field}"
            if kind == Nodetype.NAME:
                self._walk(walker, detail, None if name is None else f"{name}.", depth + 1)
            elif kind == Nodetype.BASE:
                walker.base(name, detail[0])
            else:
                (inner_kind, inner), length = detail
                count = int(length) if kind == Nodetype.ARRAY else walker.length()
                if inner_kind == Nodetype.BASE and inner[0] in _DTYPES:
                    walker.array(name, inner[0], count)
                else:
                    self._walk_each(walker, inner_kind, inner, count, depth)

    def _walk_each(self, walker: _Walker, kind: Any, detail: Any, count: int, depth: int) -> None:
        """Walk over an array of strings or messages; the walker stops where the message ends."""
        for _ in range(count):
            if kind == Nodetype.NAME:
                self._walk(walker, detail, None, depth + 1)
            else:
                walker.base(None, detail[0])


@dataclass(frozen=True)
class _Place:
    """Location of a field: `offset` in bytes from the start of the message; `count` is None for a scalar."""

    name: str
    dtype: str
    offset: int
    count: int | None


@dataclass(frozen=True)
class MessageLayout:
    """Places of the fields of a message, the bytes (offset, value) that they depend on, and the message's length."""

    places: tuple[_Place, ...]
    guards: tuple[tuple[int, bytes], ...]
    size: int

    def fits(self, contents: Bytes, begin: Integers, end: Integers) -> NDArray[np.bool_]:
        """Tell which messages have this layout.

        Args:
            contents: Bytes that the messages lie in.
            begin: Where each one begins.
            end: Where each one ends.

        Returns:
            Mask of shape (messages,).
        """
        mask = end - begin >= self.size
        for offset, value in self.guards:
            rows = np.flatnonzero(mask)
            found = windows(contents, begin[rows] + offset, len(value))
            mask[rows] = (found == np.frombuffer(value, np.uint8)).all(axis=1)
        return mask


def windows(contents: Bytes, begin: Integers, width: int) -> Bytes:
    """Copy stretches of bytes.

    Args:
        contents: Bytes.
        begin: Start of each range; it must end within the contents.
        width: Its length.

    Returns:
        Shape (stretches, width).
    """
    if not len(begin) or not width:
        return np.empty((len(begin), width), np.uint8)
    return np.lib.stride_tricks.sliding_window_view(contents, width)[begin]


class _Walker:
    """Walks through one message and notes offsets and lengths."""

    def __init__(self, name: str, data: bytes) -> None:
        self._name = name
        self._data = data
        self._order = "<" if data[1] & 1 else ">"
        self.position = _HEADER_BYTES
        self.places: list[_Place] = []
        self.guards: list[tuple[int, bytes]] = [(0, data[:2])]

    def _align(self, size: int) -> None:
        self.position += -(self.position - _HEADER_BYTES) % size

    def _pass(self, size: int) -> None:
        self.position += size
        if self.position > len(self._data):
            raise SchemaError(f"a {self._name} of {len(self._data)} bytes is shorter than its fields")

    def length(self) -> int:
        """Read the length of a string or sequence."""
        self._align(4)
        begin = self.position
        self._pass(4)
        raw = self._data[begin : begin + 4]
        self.guards.append((begin, raw))
        return int(struct.unpack(f"{self._order}I", raw)[0])

    def base(self, name: str | None, kind: str) -> None:
        if kind == "string":
            self._pass(self.length())
        elif kind in _DTYPES:
            self._place(name, kind, None)
        else:
            raise SchemaError(f"{self._name} has a field of type {kind}, which cannot be read")

    def array(self, name: str | None, kind: str, count: int) -> None:
        self._place(name, kind, count)

    def _place(self, name: str | None, kind: str, count: int | None) -> None:
        dtype = self._order + _DTYPES[kind]
        size = np.dtype(dtype).itemsize
        if count != 0:  # an empty sequence is not followed by padding
            self._align(size)
        if name is not None:
            self.places.append(_Place(name, "?" if kind == "bool" else dtype, self.position, count))
        self._pass(size * (1 if count is None else count))


class ColumnReader:
    """Collects messages of one topic and turns them into columns.

    A wanted field is either a scalar, or an array of one length in all messages.

    Attributes:
        damage: What was wrong with the first message that could not be decoded, in words; empty if none.
    """

    def __init__(self, schema: MessageSchema, fields: Sequence[str]) -> None:
        """Prepare to read.

        Args:
            schema: Type of the messages.
            fields: Names of the wanted fields, as `MessageSchema.fields` gives them.
        """
        self.damage = ""
        self._schema = schema
        self._fields = tuple(fields)
        self._layouts: list[MessageLayout] = []
        self._pending: list[bytes] = []
        self._blocks: list[dict[str, NDArray[Any]]] = []

    def add(self, data: bytes) -> None:
        """Add one message. One that does not fit its type makes `finish` fail.

        Args:
            data: CDR bytes with header.
        """
        self._pending.append(data)
        if len(self._pending) >= BATCH:
            self._decode_pending()

    def add_block(self, contents: Bytes, begin: Integers, end: Integers) -> NDArray[np.bool_]:
        """Add many messages.

        Args:
            contents: Bytes that they lie in.
            begin: Where each one begins.
            end: Where each one ends.

        Returns:
            Mask of the messages that fit their type; the others are left out.
        """
        good = np.ones(len(begin), dtype=bool)
        columns: dict[str, NDArray[Any]] = {}
        remaining = np.arange(len(begin))
        for layout in self._layouts:
            remaining = self._take(layout, contents, begin, end, remaining, columns)
        while len(remaining):
            first = remaining[0]
            try:
                layout = self._schema.layout(contents[begin[first] : end[first]].tobytes())
            except SchemaError as error:
                self.damage = self.damage or str(error)
                good[first] = False
                remaining = remaining[1:]
                continue
            self._layouts = [layout, *self._layouts[: _KEPT_LAYOUTS - 1]]
            remaining = self._take(layout, contents, begin, end, remaining, columns)
        self._blocks.append(columns if good.all() else {name: values[good] for name, values in columns.items()})
        return good

    def _take(
        self,
        layout: MessageLayout,
        contents: Bytes,
        begin: Integers,
        end: Integers,
        remaining: Integers,
        columns: dict[str, NDArray[Any]],
    ) -> Integers:
        """Read the messages of one layout and return the others."""
        if not len(remaining):
            return remaining
        fits = layout.fits(contents, begin[remaining], end[remaining])
        if fits.any():
            mine = remaining[fits]
            _extract(layout, contents, begin[mine], mine, self._fields, columns, len(begin))
        return remaining[~fits]

    def finish(self) -> dict[str, NDArray[Any]]:
        """Decode the rest.

        Returns:
            For each wanted field an array with one row per message, in order.

        Raises:
            SchemaError: If a message does not fit its type, or an array has several lengths.
        """
        self._decode_pending()
        blocks, self._blocks = [block for block in self._blocks if block], []
        if not blocks:
            return {name: np.empty(0) for name in self._fields}
        columns = {}
        for name in self._fields:
            try:
                columns[name] = np.concatenate([block.pop(name) for block in blocks])
            except ValueError as error:
                raise SchemaError(f"array {name} of {self._schema.name} changes its length") from error
        return columns

    def _decode_pending(self) -> None:
        if self._pending:
            ends = np.cumsum([len(data) for data in self._pending])
            begins = np.concatenate([[0], ends[:-1]])
            good = self.add_block(np.frombuffer(b"".join(self._pending), np.uint8), begins, ends)
            self._pending = []
            if not good.all():
                raise SchemaError(self.damage)


def _extract(
    layout: MessageLayout,
    contents: Bytes,
    begin: Integers,
    rows: Integers,
    fields: Sequence[str],
    columns: dict[str, NDArray[Any]],
    total: int,
) -> None:
    """Write the wanted fields of messages of one layout into their rows of `columns`."""
    places = {place.name: place for place in layout.places}
    for name in fields:
        place = places[name]
        dtype = np.dtype(place.dtype)
        width = 1 if place.count is None else place.count
        raw = windows(contents, begin + place.offset, width * dtype.itemsize)
        values = raw.view(dtype) if width else np.empty((len(rows), 0), dtype)
        shape = () if place.count is None else (place.count,)
        column = columns.setdefault(name, np.empty((total, *shape), dtype.newbyteorder("=")))
        if column.shape[1:] != shape:
            raise SchemaError(f"array {name} has {place.count} values in one message and {column.shape[1]} in another")
        column[rows] = values.reshape(len(rows), *shape)
