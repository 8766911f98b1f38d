"""Columns out of CDR messages, many at a time.

Decoding message by message in Python costs tens of microseconds each; an hour of states at 100 Hz is 360,000 of them.
But the messages of one topic mostly have one size and one layout, because their strings and arrays keep their lengths.
So the layout is worked out once for the first message of each size, and the fields of all messages that share it are
read with one NumPy view. Messages whose lengths differ get their own layout; nothing is assumed that is not checked.

Encoding: classic CDR (XCDR1, OMG DDS-XTypes 1.3, 7.4.1): a four-byte header that names the byte order, then fields
aligned to their size from there.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

BATCH: Final = 4096
"""Messages decoded at once; bounds the memory that raw messages hold."""

_HEADER_BYTES: Final = 4
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
        """The decoded message and the length of its own bytes."""
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
        """Names of the fields that columns can be made of; nested ones with dots, as ``header.stamp.sec``."""
        return {name for name, _ in self._leaves(self.name, "")}

    def _leaves(self, type_name: str, prefix: str) -> Iterable[tuple[str, Any]]:
        """Fields in their order of transmission, nested messages resolved."""
        for field, descriptor in self._store.fielddefs[type_name][1]:
            kind, detail = descriptor
            if kind == Nodetype.NAME and detail not in self._store.fielddefs:
                raise SchemaError(f"the definition of {self.name} in the recording lacks the type {detail}")
            if kind == Nodetype.NAME:
                yield from self._leaves(detail, f"{prefix}{field}.")
            else:
                yield f"{prefix}{field}", descriptor

    def layout(self, data: bytes) -> Layout:
        """Work out where the fields of a message lie.

        Args:
            data: CDR bytes with header.

        Returns:
            Its layout, which holds for every message with the same lengths.

        Raises:
            SchemaError: If the type has fields that columns cannot hold, or the message is too short for it.
        """
        order = "<" if data[1] & 1 else ">"
        walker = _Walker(data, order)
        for name, (kind, detail) in self._leaves(self.name, ""):
            if kind == Nodetype.BASE:
                walker.base(name, detail[0])
            else:
                (inner_kind, inner), length = detail
                if inner_kind != Nodetype.BASE or inner[0] not in _DTYPES:
                    raise SchemaError(f"field {name} of {self.name} is an array of non-numbers; decode it by message")
                walker.array(name, inner[0], length if kind == Nodetype.ARRAY else None)
        if walker.position > len(data):
            raise SchemaError(f"a {self.name} of {len(data)} bytes is shorter than its fields")
        return Layout(tuple(walker.places), tuple(walker.guards))


@dataclass(frozen=True)
class _Place:
    """Where a field lies: `offset` in bytes from the message's begin; `count` is None for a scalar."""

    name: str
    dtype: str
    offset: int
    count: int | None


@dataclass(frozen=True)
class Layout:
    """Places of the fields of a message, and the lengths (offset, four bytes) that they depend on."""

    places: tuple[_Place, ...]
    guards: tuple[tuple[int, bytes], ...]

    def fits(self, rows: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Tell which messages of equal size have this layout.

        Args:
            rows: Messages, shape (messages, bytes).

        Returns:
            Mask of shape (messages,).
        """
        mask = np.ones(len(rows), dtype=bool)
        for offset, value in self.guards:
            mask &= (rows[:, offset : offset + 4] == np.frombuffer(value, np.uint8)).all(axis=1)
        return mask


class _Walker:
    """Walks through one message and notes places and lengths."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data = data
        self._order = order
        self.position = _HEADER_BYTES
        self.places: list[_Place] = []
        self.guards: list[tuple[int, bytes]] = []

    def _align(self, size: int) -> None:
        self.position += -(self.position - _HEADER_BYTES) % size

    def _length(self) -> int:
        self._align(4)
        raw = self._data[self.position : self.position + 4]
        if len(raw) < 4:
            raise SchemaError(f"a message of {len(self._data)} bytes ends before a length at byte {self.position}")
        self.guards.append((self.position, raw))
        self.position += 4
        return int(struct.unpack(f"{self._order}I", raw)[0])

    def base(self, name: str, kind: str) -> None:
        if kind == "string":
            length = self._length()
            self.position += length
            return
        if kind not in _DTYPES:
            raise SchemaError(f"field {name} has the type {kind}, which columns cannot hold")
        self._place(name, kind, None)

    def array(self, name: str, kind: str, length: int | None) -> None:
        count = self._length() if length is None else length
        self._place(name, kind, count)

    def _place(self, name: str, kind: str, count: int | None) -> None:
        dtype = self._order + _DTYPES[kind]
        size = np.dtype(dtype).itemsize
        if count != 0:  # an empty sequence is not followed by padding
            self._align(size)
        self.places.append(_Place(name, "?" if kind == "bool" else dtype, self.position, count))
        self.position += size * (1 if count is None else count)


class ColumnReader:
    """Collects messages of one topic and turns them into columns.

    A wanted field is either a scalar, or an array of one length in all messages.
    """

    def __init__(self, schema: MessageSchema, fields: Sequence[str]) -> None:
        """Prepare to read.

        Args:
            schema: Type of the messages.
            fields: Names of the wanted fields, as `MessageSchema.fields` gives them.
        """
        self._schema = schema
        self._fields = tuple(fields)
        self._pending: list[bytes] = []
        self._blocks: list[dict[str, NDArray[Any]]] = []

    def add(self, data: bytes) -> None:
        """Add one message.

        Args:
            data: CDR bytes with header.
        """
        self._pending.append(data)
        if len(self._pending) >= BATCH:
            self._decode_pending()

    def finish(self) -> dict[str, NDArray[Any]]:
        """Decode what is left.

        Returns:
            For each wanted field an array with one row a message, in order.

        Raises:
            SchemaError: If a message does not fit its type, or an array has several lengths.
        """
        self._decode_pending()
        if not self._blocks:
            return {name: np.empty(0) for name in self._fields}
        try:
            return {name: np.concatenate([block[name] for block in self._blocks]) for name in self._fields}
        except ValueError as error:
            raise SchemaError(f"an array of {self._schema.name} changes its length within the recording") from error

    def _decode_pending(self) -> None:
        if self._pending:
            self._blocks.append(decode_columns(self._schema, self._pending, self._fields))
            self._pending = []


def decode_columns(schema: MessageSchema, messages: Sequence[bytes], fields: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Decode fields of many messages.

    Args:
        schema: Type of the messages.
        messages: CDR bytes with header.
        fields: Names of the wanted fields.

    Returns:
        For each field an array of shape (messages,) or, for array fields, (messages, length).

    Raises:
        SchemaError: If a message does not fit the type, or an array field has several lengths.
    """
    groups: dict[tuple[int, bytes], list[int]] = {}
    for index, data in enumerate(messages):
        groups.setdefault((len(data), data[:_HEADER_BYTES]), []).append(index)
    columns: dict[str, NDArray[Any]] = {}
    for (size, _), indices in groups.items():
        remaining = np.array(indices)
        while len(remaining):
            layout = schema.layout(messages[remaining[0]])
            joined = b"".join(messages[i] for i in remaining)
            rows = np.frombuffer(joined, np.uint8).reshape(len(remaining), size)
            fits = layout.fits(rows)
            _extract(layout, rows[fits], remaining[fits], fields, columns, len(messages))
            remaining = remaining[~fits]
    return columns


def _extract(
    layout: Layout,
    rows: NDArray[np.uint8],
    indices: NDArray[np.int64],
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
        raw = np.ascontiguousarray(rows[:, place.offset : place.offset + width * dtype.itemsize])
        values = raw.view(dtype) if width else np.empty((len(rows), 0), dtype)
        shape = () if place.count is None else (place.count,)
        column = columns.setdefault(name, np.empty((total, *shape), dtype.newbyteorder("=")))
        if column.shape[1:] != shape:
            raise SchemaError(f"array {name} has {place.count} values in one message and {column.shape[1]} in another")
        column[indices] = values.reshape(len(rows), *shape)
