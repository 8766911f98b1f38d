"""Recordings as rosbag2 (Jazzy) writes them to MCAP, without rosbag2 and without rclpy.

`RideRecorder` takes messages as the middleware hands them over, as raw CDR bytes, and never decodes them. What makes
the file a rosbag2 recording, which ``ros2 bag``, Foxglove and the ``rosbags`` library open, is around the messages:

* the MCAP profile ``ros2`` and one ``ros2msg`` schema a type, which holds the type's ``.msg`` text and that of every
  nested type once (`message_type`);
* for each channel the offered QoS and, where the installed package has it, the type hash;
* rosbag2's own metadata as an MCAP metadata record, and as ``metadata.yaml`` beside the file.

Formats: the MCAP specification (https://mcap.dev/spec, registry: https://mcap.dev/spec/registry) and the sources of
rosbag2 Jazzy (rosbag2_storage_mcap, rosbag2_cpp/message_definitions, rosbag2_storage/metadata_io).

All times are nanoseconds of one clock, the simulated time of the message.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self

import yaml
from mcap.writer import CompressionType, Writer

ShareResolver = Callable[[str], Path]
"""Maps the name of a ROS package to its share directory, the one that contains ``msg/``."""

CHUNK_BYTES: Final = 64 * 1024
"""Uncompressed size of a chunk. A killed recorder loses the open chunk, so small chunks lose little."""
FLUSH_PERIOD_S: Final = 0.5
"""Wall-clock time after which an open chunk is written even if it is not full."""
NOTES_RECORD: Final = "ride_notes"
"""Name of the MCAP metadata record with the notes, which stands before the first chunk and so survives a kill."""

_COMPRESSIONS: Final = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
_METADATA_VERSION: Final = 9
_CDR_HEADER_BYTES: Final = 4
_PRIMITIVE: Final = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_FIELD_TYPE: Final = re.compile(r"^[ \t]*([A-Za-z][A-Za-z0-9_/]*)", re.MULTILINE)


# --------------------------------------------------------------------------------------------- message definitions


@dataclass(frozen=True)
class MessageType:
    """A message type as a recording describes it.

    Attributes:
        name: Full name, ``package/msg/Type``.
        definition: Text in the ``ros2msg`` encoding: the type's own ``.msg``, then each nested type once.
        type_hash: REP-2011 hash (``RIHS01_...``), or empty where the package was not built.
    """

    name: str
    definition: str
    type_hash: str = ""


def ament_share(package: str) -> Path:
    """Find the share directory of an installed package through the ament index.

    Args:
        package: Name of a ROS package.

    Returns:
        Its share directory, from the first prefix in ``AMENT_PREFIX_PATH`` (or else this Python's prefix) that has it.

    Raises:
        FileNotFoundError: If no prefix has the package.
    """
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p] or [Path(sys.prefix)]
    for prefix in prefixes:
        share = prefix / "share" / package
        marker = prefix / "share" / "ament_index" / "resource_index" / "packages" / package
        if marker.exists() and share.is_dir():
            return share
    searched = ", ".join(str(p) for p in prefixes)
    raise FileNotFoundError(f"ROS package {package!r} is not installed under {searched}; is the workspace built?")


def source_share(*roots: str | os.PathLike[str]) -> ShareResolver:
    """Make a resolver that finds packages in source directories, such as ``ros_ws/src``.

    Args:
        roots: Directories whose children are ROS packages with a ``msg`` directory, searched in order.

    Returns:
        A resolver that raises FileNotFoundError for a package that no root has.
    """
    directories = [Path(root) for root in roots]

    def resolve(package: str) -> Path:
        for directory in directories:
            if (directory / package / "msg").is_dir():
                return directory / package
        searched = ", ".join(str(d) for d in directories)
        raise FileNotFoundError(f"no messages of package {package!r} in {searched}")

    return resolve


def first_share(*resolvers: ShareResolver) -> ShareResolver:
    """Make a resolver that asks several in order and takes the first answer."""

    def resolve(package: str) -> Path:
        failures = []
        for resolver in resolvers:
            try:
                return resolver(package)
            except FileNotFoundError as error:
                failures.append(str(error))
        raise FileNotFoundError("; ".join(failures))

    return resolve


def message_type(name: str, share: ShareResolver = ament_share) -> MessageType:
    """Describe a message type from its installed or source ``.msg`` files.

    Args:
        name: Full name, ``package/msg/Type``.
        share: Where packages are.

    Returns:
        The type with its self-contained definition.

    Raises:
        ValueError: If `name` is not of the form ``package/msg/Type``.
        FileNotFoundError: If the package or the type does not exist.
    """
    _split(name)
    texts: dict[str, str] = {}
    _collect(name, share, texts)
    parts = [texts[name]]
    parts += [f"{'=' * 80}\nMSG: {_short(other)}\n{text}" for other, text in texts.items() if other != name]
    return MessageType(name, "\n".join(parts), _type_hash(name, share))


def _split(name: str) -> tuple[str, str]:
    package, separator, kind = name.partition("/msg/")
    if not separator or not package or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", kind):
        raise ValueError(f"message type {name!r} is not of the form package/msg/Type")
    return package, kind


def _short(name: str) -> str:
    return "/".join(_split(name))


def _collect(name: str, share: ShareResolver, texts: dict[str, str]) -> None:
    """Add the text of `name` and of its nested types to `texts`, depth first and in sorted order as rosbag2 does."""
    package, kind = _split(name)
    path = share(package) / "msg" / f"{kind}.msg"
    if not path.is_file():
        raise FileNotFoundError(f"package {package!r} has no message {kind!r} ({path} does not exist)")
    texts[name] = path.read_text(encoding="utf-8")
    for nested in sorted(_nested_types(texts[name], package)):
        if nested not in texts:
            _collect(nested, share, texts)


def _nested_types(text: str, package: str) -> set[str]:
    """Full names of the message types that the fields of a ``.msg`` text use."""
    names = set()
    for field_type in _FIELD_TYPE.findall(text):
        if _PRIMITIVE.fullmatch(field_type):
            continue
        owner, _, kind = field_type.rpartition("/")
        names.add(f"{owner.removesuffix('/msg') or package}/msg/{kind}")
    return names


def _type_hash(name: str, share: ShareResolver) -> str:
    package, kind = _split(name)
    path = share(package) / "msg" / f"{kind}.json"
    if not path.is_file():  # a source directory: hashes are made by the build
        return ""
    hashes = json.loads(path.read_text(encoding="utf-8")).get("type_hashes", [])
    return next((str(entry["hash_string"]) for entry in hashes if entry["type_name"] == name), "")


# ------------------------------------------------------------------------------------------------ quality of service


@dataclass(frozen=True)
class Qos:
    """Quality of service that a publisher offers, in rosbag2's words. Deadlines and lifespans are unlimited.

    Attributes:
        depth: Length of the publisher's queue.
        reliability: ``reliable`` or ``best_effort``.
        durability: ``volatile`` or ``transient_local``.
        history: ``keep_last`` or ``keep_all``.
    """

    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"

    def __post_init__(self) -> None:
        """Refuse words that rosbag2 does not know.

        Raises:
            ValueError: If a value is unknown or the depth is negative.
        """
        allowed = {
            "reliability": ("reliable", "best_effort"),
            "durability": ("volatile", "transient_local"),
            "history": ("keep_last", "keep_all"),
        }
        for name, values in allowed.items():
            if getattr(self, name) not in values:
                raise ValueError(f"QoS {name} must be one of {', '.join(values)}, not {getattr(self, name)!r}")
        if self.depth < 0:
            raise ValueError(f"QoS depth must not be negative, got {self.depth}")

    def profile(self) -> dict[str, Any]:
        """The profile as rosbag2's metadata version 9 spells it."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _unlimited(),
            "lifespan": _unlimited(),
            "liveliness": "automatic",
            "liveliness_lease_duration": _unlimited(),
            "avoid_ros_namespace_conventions": False,
        }


LATCHED: Final = Qos(depth=1, durability="transient_local")
"""Of static data such as the course: a late subscriber still gets the last message."""


def _unlimited() -> dict[str, int]:
    return {"sec": 9223372036, "nsec": 854775807}  # rmw's infinite duration, the largest int64 in ns


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors, which rosbag2's reader of QoS profiles does not follow."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _dump(data: Any) -> str:
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False, default_flow_style=False)


# ---------------------------------------------------------------------------------------------------------- recorder


@dataclass
class _Channel:
    """One recorded topic."""

    id: int
    type: MessageType
    qos: Qos
    count: int = 0


class RideRecorder:
    """Writes one recording. Use it as a context manager, or call `close`.

    The process may be killed at any time: whole chunks are on their way to the disk as soon as they are full or
    `flush_period_s` old, and `bike_analysis` reads a torn file up to its last whole chunk.

    Attributes:
        path: The MCAP file being written.
        message_count: Messages written so far.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        share: ShareResolver = ament_share,
        compression: str = "zstd",
        chunk_bytes: int = CHUNK_BYTES,
        flush_period_s: float = FLUSH_PERIOD_S,
        notes: Mapping[str, str] | None = None,
        overwrite: bool = False,
        metadata_file: bool | None = None,
    ) -> None:
        """Open a new recording.

        Args:
            path: ``name.mcap`` for a single file, or a directory name for a rosbag2 directory (``name/name_0.mcap``
                and ``name/metadata.yaml``, as ``ros2 bag record -o name`` makes it). Parents are created.
            share: Where message packages are, for the schemas of `add_topic`.
            compression: Of chunks: ``zstd``, ``lz4`` or ``none``.
            chunk_bytes: Uncompressed size at which a chunk is closed, bytes.
            flush_period_s: Largest age of an open chunk, s of wall-clock time, checked at each message.
            notes: Anything worth keeping about the ride (vehicle, policy, seed ...), text to text.
            overwrite: Replace an existing recording of this name.
            metadata_file: Write ``metadata.yaml`` beside the file. By default always for a directory, and for a single
                file where it is the only recording in its directory (``metadata.yaml`` describes a directory).

        Raises:
            FileExistsError: If the recording exists and `overwrite` is false.
            ValueError: If a setting is out of range.
            OSError: If the file cannot be created.
        """
        if compression not in _COMPRESSIONS:
            raise ValueError(f"compression must be one of {', '.join(_COMPRESSIONS)}, not {compression!r}")
        if chunk_bytes <= 0 or flush_period_s <= 0.0:
            raise ValueError(f"chunk_bytes and flush_period_s must be positive, got {chunk_bytes} and {flush_period_s}")
        target = Path(path)
        self._is_directory = target.suffix != ".mcap"
        self.path = target / f"{target.name}_0.mcap" if self._is_directory else target
        if self.path.exists() and not overwrite:
            raise FileExistsError(f"recording {self.path} exists already; choose another name or allow overwriting")
        self.path.parent.mkdir(parents=True, exist_ok=True)

        self.message_count = 0
        self._share = share
        self._notes = dict(notes or {})
        self._metadata_file = metadata_file
        self._flush_period_s = flush_period_s
        self._flushed_at = time.monotonic()
        self._channels: dict[str, _Channel] = {}
        self._schema_ids: dict[str, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self._file: IO[bytes] | None = open(self.path, "wb")  # noqa: SIM115 - closed by close()
        self._writer = Writer(self._file, chunk_size=chunk_bytes, compression=_COMPRESSIONS[compression])
        with self._stopping_on_error(self._file):
            self._writer.start(profile="ros2", library="two-wheeler-lab")
            if self._notes:
                self._writer.add_metadata(NOTES_RECORD, self._notes)
            self._writer.flush()

    def __enter__(self) -> Self:
        """Return the open recorder."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the recording, also after an error: what was written so far is worth keeping."""
        self.close()

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics added so far."""
        return tuple(self._channels)

    def add_topic(self, topic: str, type_: str | MessageType, qos: Qos | None = None) -> None:
        """Announce a topic. A topic without messages is recorded as such.

        Args:
            topic: Full name, for example ``/bike/state``.
            type_: Full type name, whose definition the resolver finds, or the type itself.
            qos: What its publisher offers.

        Raises:
            ValueError: If the recorder is closed, or the topic was added before with another type.
            FileNotFoundError: If the type's definition is not installed.
        """
        self._open_file()
        known = self._channels.get(topic)
        name = type_ if isinstance(type_, str) else type_.name
        if known:
            if known.type.name != name:
                raise ValueError(f"topic {topic} is recorded as {known.type.name}, not as {name}")
            return
        described = message_type(type_, self._share) if isinstance(type_, str) else type_
        offered = qos or Qos()
        if described.name not in self._schema_ids:
            self._schema_ids[described.name] = self._writer.register_schema(
                described.name, "ros2msg", described.definition.encode()
            )
        metadata = {"offered_qos_profiles": _dump([offered.profile()])}
        if described.type_hash:
            metadata["topic_type_hash"] = described.type_hash
        channel_id = self._writer.register_channel(topic, "cdr", self._schema_ids[described.name], metadata)
        self._channels[topic] = _Channel(channel_id, described, offered)

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int | None = None) -> None:
        """Record one message.

        Args:
            topic: A topic that was added.
            data: The message in CDR with its four-byte encapsulation header, as rclpy hands it over raw.
            log_time_ns: Simulated time of the message, ns, not negative. Use one kind of time for all topics.
            publish_time_ns: Time of publication on the same clock, ns; `log_time_ns` where it is not known.

        Raises:
            ValueError: If the recorder is closed, the topic is unknown, or the data or the time cannot be right.
            OSError: If the disk refuses it. The recording is closed then; what is on disk stays readable.
        """
        file = self._open_file()
        channel = self._channels.get(topic)
        if channel is None:
            raise ValueError(f"topic {topic} is not recorded; add_topic comes before write")
        if len(data) < _CDR_HEADER_BYTES:
            raise ValueError(f"a message on {topic} has {len(data)} bytes, fewer than the CDR header's four")
        if log_time_ns < 0:
            raise ValueError(f"log time of a message on {topic} is {log_time_ns} ns; it must not be negative")
        published = log_time_ns if publish_time_ns is None else publish_time_ns
        with self._stopping_on_error(file):
            self._writer.add_message(channel.id, log_time_ns, data, published, sequence=channel.count)
            if time.monotonic() - self._flushed_at >= self._flush_period_s:
                self._flush()
        channel.count += 1
        self.message_count += 1
        self._start_ns = log_time_ns if self._start_ns is None else min(self._start_ns, log_time_ns)
        self._end_ns = max(self._end_ns, log_time_ns)

    def flush(self) -> None:
        """Close the open chunk and hand everything to the operating system, so that a kill cannot lose it.

        Call it from a timer where messages may stop coming. It does nothing on a closed recorder.

        Raises:
            OSError: If the disk refuses it. The recording is closed then.
        """
        if self._file is not None:
            with self._stopping_on_error(self._file):
                self._flush()

    def close(self) -> None:
        """Finish the file with its index and write ``metadata.yaml``. A second call does nothing.

        Raises:
            OSError: If the disk refuses it.
        """
        file = self._file
        if file is None:
            return
        information = self._bag_information()
        with self._stopping_on_error(file):
            self._writer.flush()  # the metadata record belongs after the last chunk
            self._writer.add_metadata("rosbag2", {"serialized_metadata": _dump(information)})
            self._writer.finish()
            file.flush()
        self._file = None
        file.close()
        if self._wants_metadata_file():
            text = _dump({"rosbag2_bagfile_information": information})
            temporary = self.path.parent / "metadata.yaml.tmp"
            temporary.write_text(text, encoding="utf-8")
            temporary.replace(self.path.parent / "metadata.yaml")

    def _open_file(self) -> IO[bytes]:
        if self._file is None:
            raise ValueError(f"recording {self.path} is closed")
        return self._file

    def _flush(self) -> None:
        self._writer.flush()
        self._flushed_at = time.monotonic()

    @contextmanager
    def _stopping_on_error(self, file: IO[bytes]) -> Iterator[None]:
        """Turn a failed write into the end of the recording and one clear error."""
        try:
            yield
        except OSError as error:
            self._file = None
            with suppress(OSError):  # closing writes what is buffered, and fails for the same reason
                file.close()
            raise OSError(error.errno, f"recording {self.path} stopped: {error.strerror or error}") from error

    def _wants_metadata_file(self) -> bool:
        if self._metadata_file is not None:
            return self._metadata_file
        return self._is_directory or _only_recording(self.path)

    def _bag_information(self) -> dict[str, Any]:
        """The content of ``metadata.yaml`` (rosbag2 metadata version 9)."""
        start = self._start_ns if self._start_ns is not None else 0
        span = {"duration": {"nanoseconds": max(0, self._end_ns - start)}}
        begin = {"starting_time": {"nanoseconds_since_epoch": start}}
        return {
            "version": _METADATA_VERSION,
            "storage_identifier": "mcap",
            **span,
            **begin,
            "message_count": self.message_count,
            "topics_with_message_count": [_topic_information(t, c) for t, c in self._channels.items()],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.path.name],
            "files": [{"path": self.path.name, **begin, **span, "message_count": self.message_count}],
            "custom_data": self._notes or None,
            "ros_distro": "jazzy",
        }


def _topic_information(topic: str, channel: _Channel) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic,
            "type": channel.type.name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [channel.qos.profile()],
            "type_description_hash": channel.type.type_hash,
        },
        "message_count": channel.count,
    }


def _only_recording(path: Path) -> bool:
    """Whether the directory holds no other recording and no metadata of another one."""
    if any(other != path for other in path.parent.glob("*.mcap")):
        return False
    metadata = path.parent / "metadata.yaml"
    if not metadata.exists():
        return True
    try:
        content = yaml.safe_load(metadata.read_text(encoding="utf-8"))
        described: Iterable[Any] = content["rosbag2_bagfile_information"]["relative_file_paths"]
        return list(described) == [path.name]
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        return False  # somebody else's file of the same name
