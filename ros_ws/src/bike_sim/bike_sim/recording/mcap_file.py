"""One MCAP file while it is written: messages gathered in chunks, and an index at the end.

The writer of the `mcap` library cannot end a file once a write has failed, and does not know what is complete on disk.
Here each chunk is written in one piece, and its end on disk is known. All records but messages and their indexes are
encoded by the library; messages are framed in one piece, which is quicker.

Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

MAGIC: Final = b"\x89MCAP0\r\n"
LIBRARY: Final = "two-wheeler-lab"

_MESSAGE: Final = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS: Final = 2 + 4 + 8 + 8
"""Bytes of a message record between its length and its data."""
_FOOTER_START: Final = struct.Struct("<BQQQ")
_FOOTER_LENGTH: Final = 8 + 8 + 4

COMPRESSIONS: Final[dict[str, Callable[[bytes], bytes]]] = {
    **{"zstd": zstandard.compress, "lz4": lz4.frame.compress, "none": bytes}
}


@dataclass
class _Chunk:
    """The open chunk: framed records, and for each channel log time and offset of its messages in turns."""

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    index: dict[int, list[int]] = field(default_factory=dict)


class McapFile:
    """Writes one file. Every write may raise OSError; call `salvage` then.

    Attributes:
        path: The file.
        size: Complete bytes on disk: up to the end of the last chunk or record.
        counts: Messages on disk by channel.
    """

    def __init__(self, path: Path, chunk_bytes: int, compression: str) -> None:
        """Create the file, or replace it.

        Args:
            path: The file.
            chunk_bytes: Uncompressed size at which a chunk is closed, bytes.
            compression: Of chunks, one of `COMPRESSIONS`.
        """
        self.path = path
        self.size = 0
        self.counts: Counter[int] = Counter()
        self._chunk_bytes = chunk_bytes
        self._compression = "" if compression == "none" else compression
        self._compress = COMPRESSIONS[compression]
        self._open = _Chunk()
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._chunks: list[tuple[records.ChunkIndex, Counter[int]]] = []
        """Chunks on disk, each with its messages by channel."""
        self._metadata: list[records.MetadataIndex] = []
        self._file = path.open("wb", buffering=0)
        try:
            self._write(MAGIC + _encoded(records.Header(profile="ros2", library=LIBRARY)))
        except OSError:
            self.salvage()
            raise

    @property
    def has_open_chunk(self) -> bool:
        """Whether messages wait in memory."""
        return bool(self._open.index)

    @property
    def start_ns(self) -> int:
        """Earliest log time on disk, ns; 0 without messages."""
        return min((entry.message_start_time for entry, _ in self._chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Latest log time on disk, ns; 0 without messages."""
        return max((entry.message_end_time for entry, _ in self._chunks), default=0)

    def add_schema(self, name: str, text: str) -> int:
        """Announce a message type in the ``ros2msg`` encoding; return its number."""
        schema = records.Schema(id=len(self._schemas) + 1, name=name, encoding="ros2msg", data=text.encode())
        self._schemas.append(schema)
        self._add(_encoded(schema))
        return schema.id

    def add_channel(self, topic: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Announce a topic with messages in CDR; return its number."""
        number = len(self._channels) + 1
        channel = records.Channel(
            id=number, topic=topic, message_encoding="cdr", schema_id=schema, metadata=dict(metadata)
        )
        self._channels.append(channel)
        self._add(_encoded(channel))
        return number

    def add_message(self, channel: int, sequence: int, log_time: int, publish_time: int, data: bytes) -> None:
        """Add a message to the open chunk, and write the chunk where it is full."""
        chunk = self._open
        head = _MESSAGE.pack(
            Opcode.MESSAGE, _MESSAGE_FIELDS + len(data), channel, sequence & 0xFFFFFFFF, log_time, publish_time
        )
        try:
            chunk.index[channel] += (log_time, chunk.size)
        except KeyError:
            chunk.index[channel] = [log_time, chunk.size]
        chunk.parts += (head, data)
        chunk.size += _MESSAGE.size + len(data)
        if chunk.size >= self._chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Write the open chunk, so that a killed process has lost nothing."""
        chunk = self._open
        if not chunk.index:
            return
        contents = b"".join(chunk.parts)
        data = self._compress(contents)
        start = min(min(entries[::2]) for entries in chunk.index.values())
        end = max(max(entries[::2]) for entries in chunk.index.values())
        record = _encoded(
            records.Chunk(
                compression=self._compression,
                data=data,
                message_start_time=start,
                message_end_time=end,
                uncompressed_crc=zlib.crc32(contents),
                uncompressed_size=len(contents),
            )
        )
        indexes = {channel: _message_index(channel, entries) for channel, entries in chunk.index.items()}
        offsets, position = {}, self.size + len(record)
        for channel, index in indexes.items():
            offsets[channel] = position
            position += len(index)
        entry = records.ChunkIndex(
            message_start_time=start,
            message_end_time=end,
            chunk_start_offset=self.size,
            chunk_length=len(record),
            message_index_offsets=offsets,
            message_index_length=position - self.size - len(record),
            compression=self._compression,
            compressed_size=len(data),
            uncompressed_size=len(contents),
        )
        self._open = _Chunk()
        self._write(b"".join((record, *indexes.values())))
        counts = Counter({channel: len(entries) // 2 for channel, entries in chunk.index.items()})
        self._chunks.append((entry, counts))
        self.counts += counts

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write texts by name outside the chunks; the open chunk is written first."""
        self.flush()
        record = _encoded(records.Metadata(name=name, metadata=dict(data)))
        self._metadata.append(records.MetadataIndex(offset=self.size, length=len(record), name=name))
        self._write(record)

    def finish(self) -> None:
        """Write the open chunk and the index, and close the file."""
        self.flush()
        self._write(self._ending())
        self._file.close()

    def salvage(self, spare: int = 0) -> None:
        """Complete the file on disk after a failed write, and close it.

        An incomplete chunk at the end is cut off. The index is written there, or if the space is too small, over the
        last complete chunks: most readers refuse a file without an index. If there is no space for any index, the
        file has none.

        Args:
            spare: Bytes of the disk that are to be free afterwards, for what else belongs to the recording.
        """
        self._open = _Chunk()
        with suppress(OSError):
            self._file.truncate(self.size)
            while not self._try_ending(spare) and self._chunks:
                self._give_up_chunk()
        with suppress(OSError):
            self._file.close()

    def _try_ending(self, spare: int) -> bool:
        whole, ending = self.size, self._ending()
        try:
            self._file.seek(whole)
            self._write(ending + bytes(spare))
        except OSError:
            self._file.truncate(whole)
            return False
        self.size = whole + len(ending)
        self._file.truncate(self.size)
        return True

    def _give_up_chunk(self) -> None:
        entry, counts = self._chunks.pop()
        self.counts -= counts
        self.size = entry.chunk_start_offset
        self._metadata = [entry for entry in self._metadata if entry.offset < self.size]
        self._file.truncate(self.size)

    def _add(self, record: bytes) -> None:
        self._open.parts.append(record)
        self._open.size += len(record)

    def _write(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            left = left[self._file.write(left) :]
        self.size += len(data)

    def _ending(self) -> bytes:
        """Return what follows the last record: end of data, summary, footer."""
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=self.counts.total(),
            message_start_time=self.start_ns,
            message_end_time=self.end_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        data_end = _encoded(records.DataEnd(data_section_crc=0))
        start = self.size + len(data_end)
        summary, offsets = b"", []
        entries = [entry for entry, _ in self._chunks]
        for group in (self._schemas, self._channels, [statistics], entries, self._metadata):
            if group:
                part = _encoded(*group)
                offsets.append(records.SummaryOffset(part[0], start + len(summary), len(part)))
                summary += part
        offset_start = start + len(summary)
        summary += _encoded(*offsets)
        footer_start = _FOOTER_START.pack(Opcode.FOOTER, _FOOTER_LENGTH, start, offset_start)
        footer = records.Footer(
            summary_start=start,
            summary_offset_start=offset_start,
            summary_crc=zlib.crc32(footer_start, zlib.crc32(summary)),
        )
        return data_end + summary + _encoded(footer) + MAGIC


def _encoded(*items: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    for item in items:
        item.write(builder)
    return builder.end()


def _message_index(channel: int, entries: list[int]) -> bytes:
    """Return the record that says where in its chunk the messages of a channel are."""
    size = 8 * len(entries)
    return struct.pack(f"<BQHI{len(entries)}Q", Opcode.MESSAGE_INDEX, 2 + 4 + size, channel, size, *entries)
