"""Raw messages of a recording: its MCAP files, also those that were truncated or damaged at any byte.

A recording is one file, or several of a rosbag2 directory. The index at the end of an MCAP file is what a killed
recorder never wrote, so it is not needed: records are read in order from the beginning, chunk by chunk, until the
footer or until a record is incomplete. Chunks are checked against their CRC, and one that is damaged is left out. Only
chunks are decompressed; what the file declares about its lengths is believed only where it fits the file, so that a
damaged length cannot eat memory.

It is our own because the readers of the `mcap` library stop at the first damaged chunk, and because with it an hour is
read 2.6 times as fast as with `rosbags` (`bike bench analysis`, docs/reference/results.md).

Format: the MCAP specification, https://mcap.dev/spec. The `mcap` library decodes the small records.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Header, Metadata, Schema
from numba import njit
from numpy.typing import NDArray

from bike_sim.documents import escape

MAX_NAME: Final = 200
"""Characters of a name that are shown."""
MAX_SENTENCE: Final = 1000
"""Characters of a sentence that are shown on a page; it may hold a few names."""
MAX_FAULT: Final = 400
"""Characters of a fault that are shown in a line of a terminal."""


def shown(text: str, longest: int = MAX_NAME) -> str:
    r"""Make text out of a recording fit for a terminal, a page or a picture.

    Args:
        text: A name or a sentence, which is whatever a publisher put there.
        longest: Characters kept of it.

    Returns:
        One line: controls and the like as escapes (``\x1b``, ``\u202e``), overlong text cut with an ellipsis.
    """
    return escape(text if len(text) <= longest else f"{text[: longest - 1]}…")


RECORD_BYTES = 9
"""Opcode and length before each record of MCAP."""
MESSAGE_BYTES = 22
"""Channel, sequence number and two times before each message's data."""
_MESSAGE_RECORD = 0x05


@njit(cache=True)
def _number(contents: NDArray[np.uint8], position: int, size: int) -> np.int64:
    """A little-endian number; values beyond 63 bits become negative, and are refused as a length."""
    value = np.int64(0)
    for k in range(size):
        value |= np.int64(contents[position + k]) << np.int64(8 * k)
    return value


@njit(cache=True)
def scan(
    contents: NDArray[np.uint8], bounds: NDArray[np.int64], messages: NDArray[np.int64], others: NDArray[np.int64]
) -> tuple[int, int, int]:
    """Walk through the records of chunks that lie next to each other.

    Args:
        contents: The chunks' contents.
        bounds: Where each chunk begins, and at last where the last one ends.
        messages: Filled with channel, log time, begin and end of the data, one row per message.
        others: Filled with opcode, begin and end of the content of all other records.

    Returns:
        Numbers of messages, of other records, and of chunks with a record that is incomplete: what stands before it
        counts.
    """
    found, rest, broken = 0, 0, 0
    for chunk in range(len(bounds) - 1):
        position, end = bounds[chunk], bounds[chunk + 1]
        while position < end:
            if position + RECORD_BYTES > end:
                broken += 1
                break
            opcode = contents[position]
            length = _number(contents, position + 1, 8)
            start = position + RECORD_BYTES
            if length < 0 or length > end - start or (opcode == _MESSAGE_RECORD and length < MESSAGE_BYTES):
                broken += 1
                break
            position = start + length
            if opcode == _MESSAGE_RECORD:
                messages[found, 0] = _number(contents, start, 2)
                messages[found, 1] = _number(contents, start + 6, 8)
                messages[found, 2] = start + MESSAGE_BYTES
                messages[found, 3] = position
                found += 1
            else:
                others[rest, 0] = opcode
                others[rest, 1] = start
                others[rest, 2] = position
                rest += 1
    return found, rest, broken


MAGIC: Final = b"\x89MCAP0\r\n"
BLOCK_BYTES: Final = 8 * 1024 * 1024
"""Contents of chunks that are looked at together."""
LARGEST_RECORD: Final = 256 * 1024 * 1024
"""A record or a chunk's contents beyond this size are not read, bytes. Recorders make chunks of a few megabytes."""

_ZSTD: Final = zstandard.ZstdDecompressor()
_RECORD: Final = struct.Struct("<BQ")
_CHUNK_NAME: Final = 32
"""Bytes of a chunk before the name of its compression, which the compressed length follows."""
_KINDS: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}
_DAMAGE: Final = (McapError, EOFError, struct.error, UnicodeDecodeError, OverflowError, MemoryError, ValueError)


class RecordingError(ValueError):
    """The file is not a recording of a ride, or nothing of it can be read; one plain line, which may quote the file."""

    def __init__(self, fault: str) -> None:
        super().__init__(shown(fault, MAX_FAULT))


class RawMessage(NamedTuple):
    """One message as recorded: id of its channel in `Container.channels`, log time in ns, CDR bytes."""

    channel: int
    log_time_ns: int
    data: bytes


@dataclass(frozen=True)
class Block:
    """Messages of some chunks, in the order of recording.

    Attributes:
        contents: Bytes that they lie in.
        channel: Channel of each message.
        log_time_ns: Log time of each message, ns.
        begin: Where the CDR bytes of each message begin in `contents`.
        end: Where they end.
        first: Place of the first message in the recording, counted from 1 over all topics.
    """

    contents: NDArray[np.uint8]
    channel: NDArray[np.int64]
    log_time_ns: NDArray[np.int64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    first: int

    def __len__(self) -> int:
        return len(self.channel)

    def data(self, index: int) -> bytes:
        """CDR bytes of one message."""
        return self.contents[self.begin[index] : self.end[index]].tobytes()


@dataclass
class Container:
    """An MCAP file. Reading `blocks` or `messages` fills the other attributes.

    Attributes:
        path: The file.
        channels: Channels met so far, by id.
        schemas: Schemas met so far, by id.
        metadata: Metadata records met so far, by name.
        counts: Messages met so far, by channel.
        truncated: Whether reading ended before the file's own end.
        bytes_read: Length of the part that was whole, bytes.
        reason: Why reading ended early, in words; empty for a complete file.
        damaged_chunks: Chunks that were left out.
        damage: What was wrong with the first of them, in words.
    """

    path: Path
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    truncated: bool = False
    bytes_read: int = 0
    reason: str = ""
    damaged_chunks: int = 0
    damage: str = ""

    def messages(self) -> Iterator[RawMessage]:
        """Yield all messages in the order in which they were recorded.

        Yields:
            Messages of complete chunks (and of complete message records, where the file has no chunks).

        Raises:
            RecordingError: If the file is not MCAP at all.
            OSError: If the file cannot be read.
        """
        for block in self.blocks():
            for index in range(len(block)):
                yield RawMessage(int(block.channel[index]), int(block.log_time_ns[index]), block.data(index))

    def blocks(self) -> Iterator[Block]:
        """Yield all messages, many at a time; the same and in the same order as `messages`.

        Raises:
            RecordingError: If the file is not MCAP at all.
            OSError: If the file cannot be read.
        """
        self.counts.clear()
        self.truncated, self.damaged_chunks = False, 0
        waiting: list[bytes] = []
        count = 0
        for piece in self.pieces():
            waiting.append(piece)
            if sum(map(len, waiting)) >= BLOCK_BYTES:
                block = self._block(waiting, count + 1)
                count += len(block)
                yield block
                waiting = []
        if waiting:
            yield self._block(waiting, count + 1)

    def topics(self) -> dict[str, str]:
        """Topics met so far with their type names."""
        return {c.topic: self.schemas[c.schema_id].name for c in self.channels.values() if c.schema_id in self.schemas}

    def pieces(self) -> Iterator[bytes]:
        """Yield the contents of the chunks, and message records that stand outside of chunks.

        Raises:
            RecordingError: If the file is not MCAP at all.
            OSError: If the file cannot be read.
        """
        with open_regular(self.path, buffering=1024 * 1024) as file:
            size, opcode, in_data = os.fstat(file.fileno()).st_size, 0, True
            _check_magic(self.path, file.read(len(MAGIC)))
            file.seek(0)
            with suppress(OSError, *_DAMAGE):  # of topics without messages and of damaged chunks, this alone knows
                summary = SeekingReader(file, record_size_limit=LARGEST_RECORD).get_summary()
                if summary is not None:
                    self.schemas |= summary.schemas
                    self.channels |= summary.channels
            self.bytes_read = file.seek(len(MAGIC))
            try:
                while opcode != Opcode.FOOTER:
                    opcode, length = _next_record(file, size)
                    in_data = in_data and opcode != Opcode.DATA_END
                    piece = self._content(file, opcode, length) if in_data else b""
                    if opcode == Opcode.FOOTER and (length != 20 or not file.read().endswith(MAGIC)):
                        raise ValueError("the file's end is damaged")
                    self.bytes_read += RECORD_BYTES + length
                    file.seek(self.bytes_read)
                    if piece:
                        yield piece
            except RecordingError:
                raise
            except _DAMAGE as error:
                self.truncated = True
                self.reason = f"{self.bytes_read} of {size} bytes are whole ({_said(error)})"

    def _content(self, file: IO[bytes], opcode: int, length: int) -> bytes:
        """Records of a chunk, or a message with its record header; of anything else nothing, but it is noted."""
        if opcode == Opcode.MESSAGE_INDEX and (length < 6 or (length - 6) % 16):
            raise ValueError("a message index is damaged")
        if opcode not in (Opcode.CHUNK, Opcode.MESSAGE, *_KINDS):
            return b""
        if length > LARGEST_RECORD:
            raise ValueError(f"a record of {length} bytes is larger than the {LARGEST_RECORD} that are read")
        content = file.read(length)
        if opcode == Opcode.MESSAGE:
            return _RECORD.pack(opcode, length) + content
        if opcode != Opcode.CHUNK:
            self._note(opcode, content)
            return b""
        try:
            return _chunk_contents(content)
        except _DAMAGE as error:
            self.damaged_chunks += 1
            self.damage = self.damage or _said(error)
            return b""

    def _note(self, opcode: int, content: bytes) -> None:
        """Keep a schema, channel or metadata record.

        Raises:
            RecordingError: If the header is that of another kind of recording.
        """
        record = _KINDS[opcode].read(ReadDataStream(BytesIO(content)))
        if isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Metadata):
            self.metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Header) and record.profile not in ("ros2", ""):
            raise RecordingError(f"{self.path} is an MCAP file of profile {record.profile!r}, not of ROS 2")

    def _block(self, pieces: list[bytes], first: int) -> Block:
        """Find the messages in the contents of chunks; schemas and channels are noted."""
        contents = np.frombuffer(b"".join(pieces), np.uint8)
        bounds = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces])]).astype(np.int64)
        most = len(contents) // RECORD_BYTES + 1
        messages = np.empty((len(contents) // (RECORD_BYTES + MESSAGE_BYTES) + 1, 4), np.int64)
        others = np.empty((most, 3), np.int64)
        found, rest, broken = scan(contents, bounds, messages, others)
        if broken:
            self.damaged_chunks += broken
            self.damage = self.damage or "a record reaches beyond its chunk"
        for opcode, begin, end in others[:rest].tolist():
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                try:
                    self._note(opcode, contents[begin:end].tobytes())
                except _DAMAGE as error:
                    self.damage = self.damage or _said(error)
        channel, log_time, begins, ends = np.ascontiguousarray(messages[:found].T)
        for name, count in zip(*np.unique(channel, return_counts=True), strict=True):
            self.counts[int(name)] = self.counts.get(int(name), 0) + int(count)
        return Block(contents, channel, log_time, begins, ends, first)


def open_regular(path: Path, buffering: int = -1) -> IO[bytes]:
    """Open a regular file for reading; a pipe would wait for a writer, and a device may never end.

    Raises:
        RecordingError: If it is something else.
        OSError: If it cannot be opened.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise RecordingError(f"{path} is not a regular file")
    return os.fdopen(descriptor, "rb", buffering)


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


def _next_record(file: IO[bytes], size: int) -> tuple[int, int]:
    """Opcode and length of the next record of a file of this size.

    Raises:
        ValueError: If it does not fit the file.
    """
    head = file.read(RECORD_BYTES)
    if len(head) < RECORD_BYTES:
        raise ValueError("the file ends without its footer")
    opcode, length = _RECORD.unpack(head)
    if opcode == 0:
        raise ValueError("a record has no type")
    if length > size - file.tell():
        raise ValueError("a record is not whole")
    return opcode, length


def _chunk_contents(record: bytes) -> bytes:
    """Decompress a chunk and check it.

    Raises:
        ValueError, McapError: If the chunk is damaged, or with a compression that MCAP does not define.
    """
    chunk = Chunk.read(ReadDataStream(BytesIO(record)))
    size, name_end = chunk.uncompressed_size, _CHUNK_NAME + len(chunk.compression.encode())
    if int.from_bytes(record[name_end : name_end + 8], "little") != len(chunk.data):
        raise ValueError("a chunk's length is wrong")
    if size > LARGEST_RECORD:
        raise ValueError(f"a chunk declares {size} bytes, more than the {LARGEST_RECORD} that are read")
    contents = _decompressed(chunk.compression, chunk.data, size)
    if len(contents) != size:
        raise ValueError(f"a chunk holds {len(contents)} bytes and declares {size}")
    if chunk.uncompressed_crc and zlib.crc32(contents) != chunk.uncompressed_crc:
        raise ValueError("a chunk's checksum is wrong")
    return contents


def _decompressed(compression: str, data: bytes, size: int) -> bytes:
    """Contents of a chunk, `size` bytes if it is whole; never many more.

    Raises:
        ValueError: If it cannot be decompressed.
    """
    try:
        if compression == "zstd":
            declared = zstandard.frame_content_size(data)
            if declared not in (-1, size):  # -1: the frame does not state it
                raise ValueError(f"a chunk's frame declares {declared} bytes instead of {size}")
            return _ZSTD.decompress(data, max_output_size=size)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f"a chunk cannot be decompressed: {error}") from error
    if compression:
        raise ValueError(f"a chunk has the unknown compression {compression!r}")
    return data


def _said(error: BaseException) -> str:
    """Text of an error."""
    return str(error) or "a record is not whole"


METADATA_FILE: Final = "metadata.yaml"
LARGEST_METADATA: Final = 4 * 1024 * 1024
"""Beyond this size `METADATA_FILE` is not parsed, bytes. That of a thousand files has a tenth of it."""

_NUMBERED: Final = re.compile(r"(.+)_(\d+)\.mcap")


def find_files(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Files of a recording as `examine_files` finds them, without its warnings."""
    return examine_files(path)[0]


def examine_files(path: str | os.PathLike[str]) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Find the MCAP files of a recording.

    Args:
        path: An MCAP file, or a rosbag2 directory. One that was split while recording has several files, which its
            ``metadata.yaml`` lists, but for the last one of a killed recorder: it is found by its number.

    Returns:
        The files that can be read, in order, at least one; and what is missing or cannot be read, one sentence each.

    Raises:
        FileNotFoundError: If it does not exist.
        RecordingError: If the directory has several files and nothing says that they belong together, or if none of
            several can be read.
        OSError: If none of several can be opened.
    """
    target = Path(path)
    if not target.exists():
        raise FileNotFoundError(f"recording {target} does not exist")
    if not target.is_dir():
        return (target,), ()  # whether it is a regular file is seen when it is opened
    listed = _listed_files(target)
    warnings = [f"{file.name} is missing: {METADATA_FILE} lists it" for file in listed if not file.is_file()]
    files = [*filter(Path.is_file, listed), *_numbered_after(listed[-1])] if listed else []
    if not files:
        files = sorted(target.glob("*.mcap"))
        if not files:
            raise FileNotFoundError(f"directory {target} holds no .mcap file")
        if len(files) > 1:
            names = ", ".join(f.name for f in files[:5])
            raise RecordingError(f"directory {target} holds {len(files)} recordings ({names}); name one of them")
        return tuple(files), tuple(warnings)
    readable, errors = [], []
    for file in files:
        try:
            next(Container(file).pieces(), None)  # an empty file, for one, holds nothing
            readable.append(file)
        except (RecordingError, OSError) as error:
            errors.append(error)
    if not readable:
        raise errors[0]
    return tuple(readable), (*warnings, *(f"left out: {error}" for error in errors))


def _listed_files(directory: Path) -> list[Path]:
    """Files that the directory's metadata.yaml lists; they may be missing."""
    try:
        with open_regular(directory / METADATA_FILE) as file:
            text = file.read(LARGEST_METADATA + 1)
        if len(text) > LARGEST_METADATA:
            return []
        content = yaml.safe_load(text.decode("utf-8"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        return [directory / name for name in names if isinstance(name, str)]
    except (OSError, ValueError, KeyError, TypeError, RecursionError, yaml.YAMLError):
        return []


def _numbered_after(last: Path) -> list[Path]:
    """Files that follow the last listed one by their numbers: a killed recorder lists only those that it finished."""
    match = _NUMBERED.fullmatch(last.name)
    if match is None:
        return []
    found = [(_NUMBERED.fullmatch(file.name), file) for file in last.parent.glob("*.mcap")]
    numbers = {int(m[2]): file for m, file in found if m is not None and m[1] == match[1] and file.is_file()}
    return [numbers[number] for number in sorted(numbers) if number > int(match[2])]
