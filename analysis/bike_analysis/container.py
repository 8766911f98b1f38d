"""The container: raw messages out of an MCAP file, also out of one that was torn off at any byte.

The index at the end of an MCAP file is what a killed recorder never wrote, so nothing here uses it: the records are
read in order from the beginning, chunk by chunk, until the footer or until a record is not whole. Chunks are checked
against their CRC. The `mcap` library decodes the records; only messages inside a chunk are cut here, because there are
many.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Final, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

MAGIC: Final = b"\x89MCAP0\r\n"

_RECORD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_DAMAGE: Final = (McapError, EOFError, struct.error, UnicodeDecodeError, OverflowError, MemoryError, ValueError)


class RecordingError(ValueError):
    """The file is not a recording of a ride, or nothing of it can be read."""


class RawMessage(NamedTuple):
    """One message as recorded.

    Attributes:
        channel: Id of its channel in `Container.channels`.
        log_time_ns: Time at which it was recorded, ns.
        data: Its CDR bytes.
    """

    channel: int
    log_time_ns: int
    data: bytes


@dataclass
class Container:
    """An MCAP file. Reading `messages` fills the other attributes.

    Attributes:
        path: The file.
        channels: Channels met so far, by id.
        schemas: Schemas met so far, by id.
        metadata: Metadata records met so far, by name.
        truncated: Whether reading ended before the file's own end.
        bytes_read: Length of the part that was whole, bytes.
        reason: Why reading ended early, in words; empty for a whole file.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: bool = False
    bytes_read: int = 0
    reason: str = ""

    def messages(self) -> Iterator[RawMessage]:
        """Yield all messages in the order in which they were recorded.

        Yields:
            Messages of whole chunks (and of whole message records, where the file has no chunks).

        Raises:
            RecordingError: If the file is not MCAP at all.
            OSError: If the file cannot be read.
        """
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            _check_magic(self.path, file.read(len(MAGIC)))
            file.seek(0)
            reader = StreamReader(file, emit_chunks=True, record_size_limit=size)
            records = reader.records
            while True:
                try:
                    record = next(records)
                    messages = self._messages_of(record)
                except StopIteration:
                    return  # the footer and the closing magic were there
                except _DAMAGE as error:
                    self.truncated = True
                    detail = str(error) or "a record is not whole"
                    self.reason = f"{self.bytes_read} of {size} bytes are whole ({type(error).__name__}: {detail})"
                    return
                self.bytes_read = file.tell()
                if isinstance(record, Header) and record.profile not in ("ros2", ""):
                    raise RecordingError(f"{self.path} is an MCAP file of profile {record.profile!r}, not of ROS 2")
                yield from messages

    def topics(self) -> dict[str, str]:
        """Topics met so far with their type names."""
        return {c.topic: self.schemas[c.schema_id].name for c in self.channels.values() if c.schema_id in self.schemas}

    def _messages_of(self, record: object) -> list[RawMessage]:
        """Messages of one top-level record; schemas, channels and metadata are noted."""
        if isinstance(record, Chunk):
            return self._cut(_chunk_contents(record))
        if isinstance(record, Message):
            return [RawMessage(record.channel_id, record.log_time, record.data)]
        if isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Metadata):
            self.metadata[record.name] = dict(record.metadata)
        return []

    def _cut(self, contents: bytes) -> list[RawMessage]:
        """Cut the contents of a chunk into messages; schemas and channels are noted.

        Raises:
            ValueError: If a record reaches beyond the chunk.
        """
        messages: list[RawMessage] = []
        position, end = 0, len(contents)
        while position < end:
            opcode, length = _RECORD.unpack_from(contents, position)
            start = position + _RECORD.size
            position = start + length
            if position > end:
                raise ValueError("a record reaches beyond its chunk")
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, _ = _MESSAGE.unpack_from(contents, start)
                messages.append(RawMessage(channel, log_time, contents[start + _MESSAGE.size : position]))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                kind = Schema if opcode == Opcode.SCHEMA else Channel
                self._messages_of(kind.read(ReadDataStream(BytesIO(contents[start:position]))))
        return messages


def find_file(path: str | os.PathLike[str]) -> Path:
    """Find the MCAP file of a recording.

    Args:
        path: An MCAP file, or a rosbag2 directory with one.

    Returns:
        The file.

    Raises:
        FileNotFoundError: If there is none.
        RecordingError: If the directory has several files.
    """
    target = Path(path)
    if not target.exists():
        raise FileNotFoundError(f"recording {target} does not exist")
    if target.is_file():
        return target
    files = _listed_files(target) or sorted(target.glob("*.mcap"))
    if not files:
        raise FileNotFoundError(f"directory {target} holds no .mcap file")
    if len(files) > 1:
        names = ", ".join(f.name for f in files[:5])
        raise RecordingError(f"directory {target} holds {len(files)} recordings ({names}); name one of them")
    return files[0]


def _listed_files(directory: Path) -> list[Path]:
    """Files that the directory's metadata.yaml lists and that exist."""
    try:
        content = yaml.safe_load((directory / "metadata.yaml").read_text(encoding="utf-8"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        return [directory / str(name) for name in names if (directory / str(name)).is_file()]
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        return []


def _check_magic(path: Path, start: bytes) -> None:
    if start == MAGIC:
        return
    if not start:
        raise RecordingError(f"{path} is empty; was its recorder killed at once?")
    if MAGIC.startswith(start):
        raise RecordingError(f"{path} ends within its first {len(MAGIC)} bytes; was its recorder killed at once?")
    hint = ""
    if start.startswith(b"SQLite"):
        hint = "; it is a SQLite file: convert it with `ros2 bag convert` or `rosbags-convert`"
    elif start.startswith(b"#ROSBAG"):
        hint = "; it is a ROS 1 bag: convert it with `rosbags-convert`"
    raise RecordingError(f"{path} is not an MCAP recording (it begins with {start!r}){hint}")


def _chunk_contents(chunk: Chunk) -> bytes:
    """Decompress a chunk and check it.

    Raises:
        ValueError: If the chunk is damaged, or compressed in a way that MCAP does not know.
    """
    try:
        if chunk.compression == "zstd":
            data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
        elif chunk.compression == "lz4":
            data = lz4.frame.decompress(chunk.data)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise ValueError(f"a chunk has the unknown compression {chunk.compression!r}")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f"a chunk cannot be decompressed: {error}") from error
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk's checksum is wrong")
    return data
