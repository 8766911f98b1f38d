"""Columns out of CDR messages, many at a time.

It is our own for its speed alone (`bike bench analysis` against `rosbags`, docs/reference/results.md): decoding
message by message in Python costs tens of microseconds each, and an hour of states at 100 Hz is 360,000 of them. But
the messages of one topic mostly have one layout, because their strings and arrays keep their lengths. So the layout is
computed once for the first message that no known layout fits, from the type store of `rosbags`, and the fields of all
messages that share it are picked out of the recording with one NumPy expression each. Messages whose lengths differ get
their own layout; nothing is assumed that is not checked.

Encoding: classic CDR (XCDR1, OMG DDS-XTypes 1.3, 7.4.1): a four-byte header that names the byte order, then fields
aligned to their size from there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]

_HEADER_BYTES: Final = 4
_LONGEST_ARRAY: Final = 4096
"""Elements of an array of messages or strings of fixed length; the decoder makes code for each of them."""
_KEPT_LAYOUTS: Final = 8
"""Layouts that are tried before a new one is computed."""
_VARIABLE: Final = -1
"""Number of elements of a sequence, which each message states."""
_DTYPES: Final = {
    **{name: "u1" for name in ("bool", "byte", "octet", "char", "uint8")},
    **{f"{kind}int{bits}": f"{'u' if kind else 'i'}{bits // 8}" for kind in ("", "u") for bits in (8, 16, 32, 64)},
    **{"float32": "f4", "float64": "f8"},
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


class _Field(NamedTuple):
    """A field of a type: its name, whether it holds messages, their or its basic type, number of elements or None."""

    name: str
    nested: bool
    kind: str
    length: int | None


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
            SchemaError: If the text cannot be parsed, or describes messages of unlimited size.
        """
        self.name = name
        self._store = _typestore(name, definition)
        try:
            for field in (field for type_name in self._store.fielddefs for field in self._leaves(type_name, "")):
                if field.kind not in _DTYPES and (field.length or 0) > _LONGEST_ARRAY:
                    raise SchemaError(f"field {field.name} of {name} in the recording has {field.length} elements")
        except RecursionError:
            raise SchemaError(f"a type of {name} in the recording contains itself") from None

    def fields_of(self, type_name: str) -> Iterator[_Field]:
        """A type's own fields in the order of transmission.

        Raises:
            SchemaError: If the definition lacks the type.
        """
        if type_name not in self._store.fielddefs:
            raise SchemaError(f"the definition of {self.name} in the recording lacks the type {type_name}")
        for name, (kind, detail) in self._store.fielddefs[type_name][1]:
            count = None
            if kind not in (Nodetype.BASE, Nodetype.NAME):
                count = int(detail[1]) if kind == Nodetype.ARRAY else _VARIABLE
                kind, detail = detail[0]
            yield _Field(name, kind == Nodetype.NAME, detail if kind == Nodetype.NAME else detail[0], count)

    def _leaves(self, type_name: str, prefix: str) -> Iterator[_Field]:
        """Fields with nested messages resolved, by names with dots."""
        for field in self.fields_of(type_name):
            name = f"{prefix}{field.name}"
            if field.nested and field.length is None:
                yield from self._leaves(field.kind, f"{name}.")
            else:
                yield field._replace(name=name)

    def fields(self) -> set[str]:
        """Names of the fields of numbers and texts; nested ones with dots, as ``header.stamp.sec``."""
        return {f.name for f in self._leaves(self.name, "") if f.length is None or f.kind in _DTYPES}

    def scalars(self) -> set[str]:
        """Names of the fields that are one number or flag."""
        return {f.name for f in self._leaves(self.name, "") if f.length is None and f.kind in _DTYPES}

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
        little_endian = self.is_little_endian(data)
        try:
            definition = self._store.get_msgdef(self.name)
            decode = definition.deserialize_cdr_le if little_endian else definition.deserialize_cdr_be
            message, end = decode(data[_HEADER_BYTES:], 0, definition.cls, self._store)
        except Exception as error:  # what the generated code raises depends on the damage
            raise SchemaError(f"a {self.name} of {len(data)} bytes cannot be decoded: {error}") from error
        if end + _HEADER_BYTES > len(data):
            raise self.too_short(data)
        return message, end + _HEADER_BYTES

    def is_little_endian(self, data: bytes) -> bool:
        """Byte order of a message.

        Raises:
            SchemaError: If it does not begin with the header of plain CDR.
        """
        if len(data) < _HEADER_BYTES or data[0] != 0 or data[1] > 1:
            start = data[:_HEADER_BYTES]
            raise SchemaError(f"a {self.name} begins with {start!r}, which is not the header of plain CDR")
        return bool(data[1])

    def too_short(self, data: bytes) -> SchemaError:
        """The error of a message that is not whole."""
        return SchemaError(f"a {self.name} of {len(data)} bytes is shorter than its fields")


class MessageLayout:
    """Places of the fields of a message, which hold for every message with the same lengths.

    Attributes:
        places: Type and offset, bytes from the start of the message, of each field of numbers, by name.
        guards: The bytes that they depend on, and where these are.
        size: Length of the message, bytes.
    """

    def __init__(self, schema: MessageSchema, data: bytes) -> None:
        """Walk through a message.

        Args:
            schema: Its type.
            data: CDR bytes with header.

        Raises:
            SchemaError: If the message is not plain CDR, too short for the type, or has a field that cannot be read.
        """
        self._order = "<" if schema.is_little_endian(data) else ">"
        self._schema, self._data = schema, data
        self.places: dict[str, tuple[np.dtype[Any], int]] = {}
        self.guards: list[tuple[int, bytes]] = [(0, data[:2])]
        self.size = _HEADER_BYTES
        self._walk(schema.name, "")

    def _walk(self, type_name: str, prefix: str | None) -> None:
        """Pass the fields of a type; without a prefix they are not noted."""
        for field in self._schema.fields_of(type_name):
            name = None if prefix is None else f"{prefix}{field.name}"
            count = self._length() if field.length == _VARIABLE else field.length
            if count is not None and count > len(self._data):
                raise self._schema.too_short(self._data)
            if field.kind in _DTYPES:
                dtype = np.dtype("?" if field.kind == "bool" else self._order + _DTYPES[field.kind])
                dtype = dtype if count is None else np.dtype((dtype, (count,)))
                begin = self._pass(dtype.itemsize, dtype.base.itemsize if dtype.itemsize else 1)  # none: no padding
                if name is not None:
                    self.places[name] = dtype, begin
                continue
            inner = f"{name}." if name is not None and count is None else None
            for _ in range(1 if count is None else count):
                if field.nested:
                    self._walk(field.kind, inner)
                elif field.kind == "string":
                    self._pass(self._length())
                else:
                    raise SchemaError(f"{self._schema.name} has a field of type {field.kind}, which cannot be read")

    def _length(self) -> int:
        """Read the length of a string or sequence."""
        begin = self._pass(4, 4)
        raw = self._data[begin : begin + 4]
        self.guards.append((begin, raw))
        return int.from_bytes(raw, "little" if self._order == "<" else "big")

    def _pass(self, size: int, align: int = 1) -> int:
        """Pass bytes that are aligned to a multiple of `align` behind the header; where they begin."""
        begin = self.size + -(self.size - _HEADER_BYTES) % align
        self.size = begin + size
        if self.size > len(self._data):
            raise self._schema.too_short(self._data)
        return begin

    def fits(self, contents: Bytes, begin: Integers, end: Integers) -> NDArray[np.bool_]:
        """Which messages, between `begin` and `end` in the contents, have this layout; shape (messages,)."""
        mask = end - begin >= self.size
        for offset, value in self.guards:
            rows = np.flatnonzero(mask)
            mask[rows] = _records(contents, np.dtype(f"V{len(value)}"), begin[rows] + offset) == np.void(value)
        return mask

    def records(self, fields: Sequence[str], contents: Bytes, begin: Integers) -> NDArray[Any]:
        """Fields of messages of this layout, as records that share nothing with the contents."""
        formats, offsets = zip(*(self.places[name] for name in fields), strict=True)
        dtype = np.dtype({"names": list(fields), "formats": formats, "offsets": offsets})
        return _records(contents, dtype, begin)


def _records(contents: Bytes, dtype: np.dtype[Any], begin: Integers) -> NDArray[Any]:
    """Copy what lies at each place in `begin` of the contents."""
    if not len(begin):
        return np.empty(0, dtype)
    every: NDArray[Any] = np.ndarray((len(contents) - dtype.itemsize + 1,), dtype, contents, strides=(1,))
    return every[begin]


class ColumnReader:
    """Collects messages of one topic and turns them into columns.

    A wanted field is either a scalar, or an array of one length in all messages.

    Attributes:
        damage: The fault of the first message that could not be decoded; empty if none.
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
        self._blocks: list[NDArray[Any]] = []

    def add_block(self, contents: Bytes, begin: Integers, end: Integers) -> NDArray[np.bool_]:
        """Add messages.

        Args:
            contents: Bytes that they lie in.
            begin: Where each one begins.
            end: Where each one ends.

        Returns:
            Mask of the messages that fit their type; the others are left out.

        Raises:
            SchemaError: If an array has several lengths.
        """
        good = np.ones(len(begin), dtype=bool)
        records: NDArray[Any] | None = None
        remaining, untried = np.arange(len(begin)), list(self._layouts)
        while len(remaining):
            if not untried:
                first = remaining[0]
                try:
                    untried = [MessageLayout(self._schema, contents[begin[first] : end[first]].tobytes())]
                except (SchemaError, RecursionError) as error:
                    self.damage = self.damage or str(error)
                    good[first] = False
                    remaining = remaining[1:]
                    continue
                self._layouts = [*untried, *self._layouts[: _KEPT_LAYOUTS - 1]]
            layout = untried.pop(0)
            fits = layout.fits(contents, begin[remaining], end[remaining])
            if fits.any():
                found = layout.records(self._fields, contents, begin[remaining[fits]])
                if records is None:
                    records = np.empty(len(begin), repack_fields(found.dtype.newbyteorder("=")))
                for name in self._fields:
                    if records[name].shape[1:] != found[name].shape[1:]:
                        raise self._changed(name)
                    records[name][remaining[fits]] = found[name]
            remaining = remaining[~fits]
        if records is not None:
            self._blocks.append(records[good])
        return good

    def finish(self) -> dict[str, NDArray[Any]]:
        """Put all blocks together.

        Returns:
            For each wanted field an array with one row per message, in order.

        Raises:
            SchemaError: If an array has several lengths.
        """
        blocks, self._blocks = self._blocks, []
        columns = {}
        for name in self._fields:
            parts = [block[name] for block in blocks] or [np.empty(0)]
            if len({part.shape[1:] for part in parts}) > 1:
                raise self._changed(name)
            columns[name] = np.concatenate(parts)
        return columns

    def _changed(self, name: str) -> SchemaError:
        return SchemaError(f"array {name} of {self._schema.name} changes its length")
