"""A recording as rosbag2 writes it: an MCAP file, alone or in a directory."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from bike_sim.recording.definitions import MessageType, message_type
from bike_sim.recording.in_use import Claim
from bike_sim.recording.mcap_file import COMPRESSIONS, McapFile
from bike_sim.recording.metadata import (
    METADATA_FILE,
    NOTES_RECORD,
    Qos,
    bag_information,
    described_files,
    is_only_recording,
    to_yaml,
    write_metadata_file,
)

CHUNK_BYTES: Final = 256 * 1024
"""Uncompressed size of a chunk. Each has an index of its topics, which costs as much as the messages where many topics
share a small chunk. The loss of a killed recorder is bounded by `FLUSH_PERIOD_S`."""
FLUSH_PERIOD_S: Final = 0.5
"""Wall-clock time after which an open chunk is written even if it is not full."""

_CDR_HEADER_BYTES: Final = 4
_BLOCK_BYTES: Final = 4096
"""Usual allocation unit of a file system."""


@dataclass
class _Topic:
    """One recorded topic."""

    type: MessageType
    offered: tuple[Qos, ...]
    channel: int = 0
    count: int = 0


class RideRecorder(AbstractContextManager["RideRecorder"]):
    """Writes one recording. Use it as a context manager, or call `close`.

    The process may be killed at any time: complete chunks are written to disk as soon as they are full or
    `flush_period_s` old, and `bike_analysis` reads a truncated file up to its last complete chunk.

    Attributes:
        path: The MCAP file.
        message_count: Messages written so far.
        flush_period_s: Largest age of an open chunk, s of wall-clock time, checked at each message and `flush`.
    """

    flush_period_s: float = FLUSH_PERIOD_S

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        compression: str = "zstd",
        chunk_bytes: int = CHUNK_BYTES,
        notes: Mapping[str, str] | None = None,
        overwrite: bool = False,
        metadata_file: bool | None = None,
    ) -> None:
        """Open a new recording.

        Args:
            path: ``name.mcap`` for a single file, or a directory name for a rosbag2 directory (``name/name_0.mcap``
                and ``name/metadata.yaml``, as ``ros2 bag record -o name`` makes it). Parents are created.
            compression: Of chunks: ``zstd``, ``lz4`` or ``none``.
            chunk_bytes: Uncompressed size at which a chunk is closed, bytes.
            notes: Anything worth keeping about the ride (vehicle, policy, seed ...), text to text.
            overwrite: Replace an existing recording of this name.
            metadata_file: Write ``metadata.yaml`` next to the file. By default always for a directory, and for a single
                file where it is the only recording in its directory (``metadata.yaml`` describes a directory).

        Raises:
            FileExistsError: If the recording exists and `overwrite` is false.
            ValueError: If a setting is out of range.
            OSError: If the file cannot be created, or another process records to it.
        """
        if compression not in COMPRESSIONS:
            raise ValueError(f"compression must be one of {', '.join(COMPRESSIONS)}, not {compression!r}")
        if chunk_bytes <= 0:
            raise ValueError(f"chunk_bytes must be positive, got {chunk_bytes}")
        target = Path(path)
        if not target.name:
            raise ValueError(f"{os.fspath(path)!r} is no name for a recording")
        self._directory = None if target.suffix == ".mcap" else target
        self._claim = self._claimed(target, overwrite)
        self.message_count = 0
        self._notes = dict(notes or {})
        self._metadata_file = metadata_file
        self._topics: dict[str, _Topic] = {}
        self._longest_lag_s = 0.0
        self.path = target / f"{target.name}_0.mcap" if self._directory else target
        self._schemas: dict[str, int] = {}
        self._chunk_begun = time.monotonic()
        self._final_bytes = 0
        self._file: McapFile | None = None
        try:
            self._make_room(target, overwrite)
            with self._stopping_on_error():
                self._file = McapFile(self.path, chunk_bytes, compression)
                if self._notes:
                    self._file.add_metadata(NOTES_RECORD, self._notes)
        except BaseException:
            self._claim.close()
            raise

    def __exit__(self, *_: object) -> None:
        """Close the recording, also after an error: what was written so far is worth keeping."""
        self.close()

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics added so far."""
        return tuple(self._topics)

    @property
    def is_open(self) -> bool:
        """Whether messages can be written."""
        return self._file is not None

    @property
    def bytes_written(self) -> int:
        """Size of the file so far, bytes; the open chunk is not part of it."""
        return self._file.size if self._file else self._final_bytes

    def add_topic(self, topic: str, type_: str | MessageType, qos: Qos | Sequence[Qos] | None = None) -> None:
        """Announce a topic, or further publishers of one. A topic without messages is recorded as such.

        Args:
            topic: Full name, for example ``/bike/state``.
            type_: Full name of an installed type, or the type itself.
            qos: What its publisher offers, or each of them.

        Raises:
            ValueError: If the recorder is closed, or the topic was added before with another type.
            FileNotFoundError: If the type's definition is not installed.
        """
        file = self._open_file()
        name = type_ if isinstance(type_, str) else type_.name
        offered = (qos,) if isinstance(qos, Qos) else tuple(qos or (Qos(),))
        known = self._topics.get(topic)
        if known is None:
            described = message_type(type_) if isinstance(type_, str) else type_
            known = self._topics[topic] = _Topic(described, offered)
            self._announce(file, topic, known)
        elif known.type.name != name:
            raise ValueError(f"topic {topic} is recorded as {known.type.name}, not as {name}")

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None) -> None:
        """Record one message.

        Args:
            topic: A topic that was added.
            data: The message in CDR with its four-byte encapsulation header, as rclpy hands it over raw.
            log_time_ns: Time of the message, ns, not negative. Use one clock for all topics.
            publish_time_ns: Time of publication on the same clock, ns; `log_time_ns` where it is not known.

        Raises:
            ValueError: If the recorder is closed, the topic is unknown, or the data or the time is invalid.
            OSError: If the disk refuses it. The recording is closed then; the file on disk stays readable.
        """
        file = self._open_file()
        known = self._topics.get(topic)
        if known is None:
            raise ValueError(f"topic {topic} is not recorded; add_topic comes before write")
        if len(data) < _CDR_HEADER_BYTES:
            raise ValueError(f"a message on {topic} has {len(data)} bytes, fewer than the CDR header's four")
        if log_time_ns < 0:
            raise ValueError(f"log time of a message on {topic} is {log_time_ns} ns; it must not be negative")
        published = log_time_ns if publish_time_ns is None else publish_time_ns
        now = time.monotonic()
        if not file.has_open_chunk:
            self._chunk_begun = now
        try:
            file.add_message(known.channel, known.count, log_time_ns, published, data)
            if file.has_open_chunk and now - self._chunk_begun >= self.flush_period_s:
                file.flush()
        except OSError as error:
            self._stop(error)
        if not file.has_open_chunk:
            self._note_lag()
        known.count += 1
        self.message_count += 1

    def flush(self, older_than_s: float = 0.0) -> None:
        """Write the open chunk and hand everything to the operating system, so that a kill cannot lose it.

        Call it from a timer where messages may stop coming. It does nothing on a closed recorder.

        Args:
            older_than_s: Only if the chunk's first message came this long ago, s of wall-clock time.

        Raises:
            OSError: If the disk refuses it. The recording is closed then.
        """
        file = self._file
        if file is not None and file.has_open_chunk and time.monotonic() - self._chunk_begun >= older_than_s:
            with self._stopping_on_error():
                file.flush()
                self._note_lag()

    def take_longest_lag(self) -> float:
        """Return the longest time from a message to its write to disk since the last call, s."""
        longest, self._longest_lag_s = self._longest_lag_s, 0.0
        return longest

    def close(self) -> None:
        """Finish the file with its index and write ``metadata.yaml``. A second call does nothing.

        Raises:
            OSError: If the disk refuses it.
        """
        if self._file is None:
            return
        with self._stopping_on_error():
            file = self._open_file()
            file.flush()
            file.add_metadata("rosbag2", {"serialized_metadata": to_yaml(self._information(file))})
            file.finish()
            self._file, self._final_bytes = None, file.size
            self._write_metadata_file(file)
        self._claim.close()

    # ----------------------------------------------------------------------------------------------------------- files

    def _claimed(self, target: Path, overwrite: bool) -> Claim:
        """Claim the file, or the directory, before anything in it is touched; make it where it is missing.

        Raises:
            FileExistsError: If the file exists and may not be replaced.
            OSError: If another process records to it.
        """
        folder = self._directory or target.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OSError(error.errno, f"directory {folder} cannot be made: {error.strerror}") from error
        if self._directory is None:
            try:
                os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
            except FileExistsError:
                if not overwrite:
                    raise _exists(target) from None
        return Claim(target, "recording")

    def _make_room(self, target: Path, overwrite: bool) -> None:
        """See that nothing is in the way, nor a ``metadata.yaml`` of what is replaced.

        Raises:
            FileExistsError: If a file of the directory exists and may not be replaced.
        """
        own = re.compile(re.escape(target.name) + (r"_\d+\.mcap" if self._directory else ""))
        stale = []
        if self._directory:
            stale = [file for file in sorted(target.glob("*.mcap")) if own.fullmatch(file.name)]
        if stale and not overwrite:
            raise _exists(stale[0])
        folder = self._directory or target.parent
        described = described_files(folder)
        if stale or (described and all(own.fullmatch(name) for name in described)):
            stale.append(folder / METADATA_FILE)  # a kill would leave it next to files that it does not describe
        for file in stale:
            file.unlink(missing_ok=True)

    def _announce(self, file: McapFile, name: str, topic: _Topic) -> None:
        kind = topic.type
        if kind.name not in self._schemas:
            self._schemas[kind.name] = file.add_schema(kind.name, kind.definition)
        metadata = {"offered_qos_profiles": to_yaml([qos.profile() for qos in topic.offered])}
        if kind.type_hash:
            metadata["topic_type_hash"] = kind.type_hash
        topic.channel = file.add_channel(name, self._schemas[kind.name], metadata)

    def _note_lag(self) -> None:
        self._longest_lag_s = max(self._longest_lag_s, time.monotonic() - self._chunk_begun)

    # ---------------------------------------------------------------------------------------------------- what is wrong

    def _open_file(self) -> McapFile:
        if self._file is None:
            raise ValueError(f"recording {self.path} is closed")
        return self._file

    @contextmanager
    def _stopping_on_error(self) -> Iterator[None]:
        """Turn a failed write into the end of the recording and one clear error."""
        try:
            yield
        except OSError as error:
            self._stop(error)

    def _stop(self, error: OSError) -> None:
        """End the recording with the data on disk.

        Raises:
            OSError: Always.
        """
        file, self._file = self._file, None
        if file is not None:
            file.salvage(spare=len(to_yaml(self._information(file))) + _BLOCK_BYTES)
            self._final_bytes = file.size
            with suppress(OSError):
                self._write_metadata_file(file)
        self._claim.close()
        raise OSError(error.errno, f"recording {self.path} stopped: {error.strerror or error}") from error

    # -------------------------------------------------------------------------------------------------------- metadata

    def _write_metadata_file(self, file: McapFile) -> None:
        """Describe the finished file, where that is wanted."""
        wanted = self._metadata_file
        if wanted is None:
            wanted = self._directory is not None or is_only_recording(self.path)
        if wanted:
            write_metadata_file(self.path.parent, self._information(file))

    def _information(self, file: McapFile) -> dict[str, Any]:
        topics = {name: (topic.type, topic.offered, file.counts[topic.channel]) for name, topic in self._topics.items()}
        return bag_information(file.path.name, topics, file.start_ns, file.end_ns, self._notes)


def _exists(path: Path) -> FileExistsError:
    return FileExistsError(f"recording {path} exists already; choose another name or allow overwriting")
