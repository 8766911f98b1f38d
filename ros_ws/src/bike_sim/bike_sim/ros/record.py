"""The recorder as a ROS 2 node: takes messages as bytes and writes them down as rosbag2 would.

The log time of a message is simulated time: the stamp of its header where it has one, else the latest time of
``/clock`` or of a state. The file is closed on SIGINT and SIGTERM; after a kill it can be read up to its last whole
chunk, and after a full disk it is a complete file.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, NoReturn

import rclpy.node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bike_sim.recording.definitions import MessageType, message_type
from bike_sim.recording.recorder import CHUNK_BYTES, FLUSH_PERIOD_S, RideRecorder
from bike_sim.ros import node_tools
from bike_sim.ros.node_tools import NANOSECONDS, CannotGoOn, ParameterSpec
from bike_sim.ros.subscriptions import RawSubscription, asks_too_much, class_of, described_qos, matching_qos

SIMULATED, WALL = "simulated", "wall"

SPECS: Final = (
    ParameterSpec("path", "ride.mcap", "Recording: name.mcap, or a directory as rosbag2 makes it.", fixed=True),
    ParameterSpec("topics", (), "Topics to record; none: the namespace's, /clock, /diagnostics and /tf.", fixed=True),
    ParameterSpec("all_topics", False, "Whether every topic is recorded that is not hidden.", fixed=True),
    ParameterSpec("overwrite", False, "Whether an existing recording is replaced.", fixed=True),
    ParameterSpec("compression", "zstd", "Of the file's chunks.", fixed=True, choices=("zstd", "lz4", "none")),
    ParameterSpec("chunk_size", CHUNK_BYTES, "Of a chunk before compression, bytes.", fixed=True),
    ParameterSpec(
        "clock",
        SIMULATED,
        "Log time: simulated (stamp of the header, else latest /clock) or wall (time of publication).",
        fixed=True,
        choices=(SIMULATED, WALL),
    ),
    ParameterSpec("notes", (), "Notes for the recording, each as name=text.", fixed=True),
)

SHARED_TOPICS: Final = ("/clock", "/diagnostics", "/tf", "/tf_static")
POLL_PERIOD: Final = 0.01
"""Wall-clock time between two visits to the subscriptions, s."""
MAX_AT_ONCE: Final = 10_000
"""Messages of all topics together in one visit, so that a signal and the diagnostics get their turn."""
LOOK_PERIOD: Final = 0.2
"""Wall-clock time between two looks for new topics and publishers, s."""
REPORT_PERIOD: Final = 1.0
MISSING_AFTER: Final = 3.0
"""Wall-clock time after which chosen topics that nobody has are named, s."""
MAX_FINISH: Final = 20.0
"""Wall-clock time after a signal that the file gets to be finished, s: a busy machine or a slow disk may need it."""

LINGER: Final = 0.3
"""Wall-clock time after a signal in which messages that were sent before it are still written, s."""
DRAIN_TIMEOUT_S: Final = 0.3
"""Wall-clock time after that for what still waits in the middleware, s."""
MAX_LEAD: Final = 60 * NANOSECONDS
"""A stamp that is farther than this ahead of the latest time is of another clock, ns. So is, while no time is known, a
stamp that is less than this from the wall clock's time of publication."""
CLOCK_SOURCE_TYPES: Final = ("rosgraph_msgs/msg/Clock", "bike_msgs/msg/BikeState")
"""Types that carry the present simulated time."""
LARGEST_CHUNK: Final = 1 << 30
STAMPED_SIZE: Final = 12
"""Least size of a message that begins with a stamp: head, seconds and nanoseconds, bytes."""


def writing_settings(values: Mapping[str, Any]) -> dict[str, Any]:
    """Check parameters; return the arguments of `RideRecorder` that they give.

    Raises:
        ValueError: an invalid value.
    """
    if values["all_topics"] and values["topics"]:
        raise ValueError("parameters all_topics and topics exclude each other: choose topics, or take all")
    if not 1 <= values["chunk_size"] <= LARGEST_CHUNK:
        raise ValueError(f"parameter chunk_size must be from 1 to {LARGEST_CHUNK}, got {values['chunk_size']}")
    notes = {"recorded": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())}
    for entry in values["notes"]:
        name, separator, text = entry.partition("=")
        if not separator or not name.strip():
            raise ValueError(f"parameter notes: {entry!r} is not of the form name=text")
        notes[name.strip()] = text.strip()
    return {
        "path": Path(values["path"]).expanduser(),
        "compression": values["compression"],
        "chunk_bytes": values["chunk_size"],
        "overwrite": values["overwrite"],
        "notes": notes,
    }


@dataclass
class _Topic:
    """A topic that is recorded."""

    name: str
    kind: MessageType
    message_class: type
    subscription: RawSubscription
    stamped: bool
    publishers: int
    heard: bool = False
    unreadable: int = 0

    @property
    def gives_time(self) -> bool:
        return self.kind.name in CLOCK_SOURCE_TYPES


class Record(rclpy.node.Node):
    """Subscribes to topics as they appear and writes their messages."""

    def __init__(self) -> None:
        """Open the recording.

        Raises:
            ValueError: an invalid parameter. OSError: the file exists already or cannot be written.
        """
        super().__init__("record", namespace=node_tools.NAMESPACE)
        self._values = node_tools.declare(self, SPECS)
        writing = writing_settings(self._values)
        self._wanted = frozenset(self._full_name(name) for name in self._values["topics"])
        self._recorder = RideRecorder(**writing)
        self._failure = ""
        self._time = 0
        self._warned_of_wall_clock = False
        self._topics: dict[str, _Topic] = {}
        self._refused: set[str] = set()
        self._heard: tuple[str, ...] = ()
        self._dropped_before = 0
        self._longest_wait = 0.0
        self._reported_dropped = 0
        self._begun_at: float | None = time.monotonic()
        self._diagnostics = node_tools.Diagnostics(self)
        node_tools.wall_timer(self, LOOK_PERIOD, self._look)
        node_tools.wall_timer(self, POLL_PERIOD, self._poll)
        node_tools.wall_timer(self, REPORT_PERIOD, self._report)
        self._look()
        self.get_logger().info(f"recording to {self._recorder.path}")

    def finish(self) -> None:
        """Write what still waits, close the file and report a last time.

        Raises:
            CannotGoOn: the file cannot be closed.
        """
        try:
            if self._recorder.is_open:
                self._write_rest()
                try:
                    self._recorder.close()
                except OSError as error:
                    self._give_up(error)
        finally:
            self._report()
            written = f"{self._recorder.message_count} messages on {len(self._topics)} topics"
            self.get_logger().info(f"{written} in {self._recorder.path}, {self._dropped} dropped")
            for topic in self._topics.values():
                topic.subscription.close()

    # ---------------------------------------------------------------------------------------------------------- topics

    def _full_name(self, name: str) -> str:
        try:
            return self.resolve_topic_name(name)
        except RuntimeError as error:
            raise ValueError(f"parameter topics: {name!r} is no name of a topic") from error

    def _look(self) -> None:
        """Subscribe to new topics, and see whether those that are known have other publishers.

        Who waits for the recorder learns at once from which topics messages have come.
        """
        for name, kinds in self.get_topic_names_and_types():
            if name in self._topics:
                self._follow(self._topics[name])
            elif name not in self._refused and self._is_wanted(name):
                self._subscribe(name, kinds)
        heard = tuple(sorted(name for name, topic in self._topics.items() if topic.heard))
        if heard != self._heard:
            self._heard = heard
            self._report()
        if self._begun_at is not None and time.monotonic() - self._begun_at > MISSING_AFTER:
            self._begun_at = None
            if missing := sorted(self._wanted - set(self._topics) - self._refused):
                self.get_logger().info(f"not there yet, recorded when they come: {', '.join(missing)}")

    def _is_wanted(self, name: str) -> bool:
        if self._wanted:
            return name in self._wanted
        if node_tools.is_hidden(name):
            return False
        if self._values["all_topics"]:
            return True
        return name.startswith(f"{self.get_namespace().rstrip('/')}/") or name in SHARED_TOPICS

    def _subscribe(self, name: str, kinds: list[str]) -> None:
        # A topic that is only listened to so far is waited for, so that its first message is not missed.
        publishers = self.get_publishers_info_by_topic(name)
        ends = publishers or self.get_subscriptions_info_by_topic(name)
        if not ends:
            return
        try:
            message_class = class_of(kinds[0])
            kind = message_type(kinds[0])
        except (ImportError, AttributeError, ValueError, FileNotFoundError) as error:
            self._refused.add(name)
            self.get_logger().warning(f"topic {name} of type {kinds[0]} is not recorded: {error}")
            return
        self._warn_of_other_types(name, kinds, kind, publishers)
        self._recorder.add_topic(name, kind, [described_qos(end) for end in ends])
        subscription = RawSubscription(self, message_class, name, matching_qos(ends))
        stamped = _begins_with_stamp(message_class)
        self._topics[name] = _Topic(name, kind, message_class, subscription, stamped, len(publishers))

    def _warn_of_other_types(
        self, name: str, kinds: list[str], kind: MessageType, publishers: list[TopicEndpointInfo]
    ) -> None:
        if len(kinds) > 1:
            self.get_logger().warning(f"topic {name} has several types, recorded is {kinds[0]} of {', '.join(kinds)}")
        hashes = {str(end.topic_type_hash) for end in publishers if end.topic_type == kind.name} - {"INVALID"}
        if kind.type_hash and hashes - {kind.type_hash}:
            self.get_logger().warning(
                f"topic {name}: a publisher has another version of {kind.name} than is installed here, "
                "so the definition in the recording may not fit its messages"
            )

    def _follow(self, topic: _Topic) -> None:
        """Match all publishers of a topic when others have joined, also those that offer less QoS."""
        count = self.count_publishers(topic.name)
        if count == topic.publishers:
            return
        topic.publishers = count
        ends = self.get_publishers_info_by_topic(topic.name)
        if not ends:
            return
        if asks_too_much(topic.subscription.qos, qos := matching_qos(ends)):
            self._poll()
            self._dropped_before += topic.subscription.lost()
            topic.subscription.close()
            topic.subscription = RawSubscription(self, topic.message_class, topic.name, qos)

    # -------------------------------------------------------------------------------------------------------- messages

    def _poll(self) -> int:
        """Write all that has come, in the order in which it was sent, and what waits in an open chunk for long.

        Returns:
            Number of messages.

        Raises:
            CannotGoOn: the disk refuses it.
        """
        batch: list[tuple[int, _Topic, bytes]] = []
        most = MAX_AT_ONCE // max(len(self._topics), 1) + 1
        oldest = None
        for topic in self._topics.values():
            received = topic.subscription.take(batch, topic, most)
            if received is not None:
                topic.heard = True
                oldest = min(oldest or received, received)
        batch.sort(key=itemgetter(0))
        if oldest is not None:
            self._longest_wait = max(self._longest_wait, 1e-9 * (time.time_ns() - oldest))
        write = self._recorder.write
        try:
            for sent, topic, data in batch:
                write(topic.name, data, self._log_time(sent, topic, data))
            self._recorder.flush(older_than_s=FLUSH_PERIOD_S)
        except OSError as error:
            self._give_up(error)
        return len(batch)

    def _write_rest(self) -> None:
        end = time.monotonic() + DRAIN_TIMEOUT_S
        while self._poll():
            if time.monotonic() > end:
                self.get_logger().warning(
                    "the recording ends while messages still wait: more came than could be written"
                )
                return

    def _log_time(self, sent: int, topic: _Topic, data: bytes) -> int:
        if self._values["clock"] == WALL:
            return sent
        # A stamp of 0 is what nodes write that do not know the time yet.
        stamp = self._time
        if topic.stamped and len(data) >= STAMPED_SIZE:
            stamp = _stamp(data) or self._time
        elif topic.stamped:
            if not topic.unreadable:
                self.get_logger().error(
                    f"{len(data)} bytes on {topic.name} are not of type {topic.kind.name}; they are recorded"
                )
            topic.unreadable += 1
        if topic.gives_time:
            self._time = stamp
        elif self._is_of_another_clock(stamp, sent):
            stamp = self._time
        return stamp

    def _is_of_another_clock(self, stamp: int, sent: int) -> bool:
        """Whether a stamp is far ahead of the time; while no time is known, whether it is the wall clock's."""
        if self._time:
            return stamp > self._time + MAX_LEAD
        wall = abs(stamp - sent) < MAX_LEAD
        if wall and not self._warned_of_wall_clock:
            self._warned_of_wall_clock = True
            self.get_logger().warning(
                "messages are stamped by the wall clock and no simulated time is known: they get time 0 until a state "
                "or /clock comes; clock:=wall records wall-clock time"
            )
        return wall

    def _give_up(self, error: OSError) -> NoReturn:
        self._failure = str(error.strerror)
        raise CannotGoOn(self._failure) from error

    # ----------------------------------------------------------------------------------------------------- diagnostics

    @property
    def _dropped(self) -> int:
        """Messages that the middleware gave up before they could be taken."""
        return self._dropped_before + sum(topic.subscription.lost() for topic in self._topics.values())

    def _report(self) -> None:
        dropped = self._dropped
        new = dropped - self._reported_dropped
        level, text = self._diagnostics.OK, "recording" if self._recorder.is_open else "recording closed"
        if new:
            level, text = self._diagnostics.WARN, f"{new} messages dropped since the last report"
            self.get_logger().warning(text)
        if self._failure:
            level, text = self._diagnostics.ERROR, self._failure
        figures = {
            "messages_written": self._recorder.message_count,
            "messages_dropped": dropped,
            "messages_unreadable": sum(topic.unreadable for topic in self._topics.values()),
            "bytes_written": self._recorder.bytes_written,
            "write_lag_ms": 1e3 * (self._longest_wait + self._recorder.take_longest_lag()),
            "topics": len(self._topics),
            "topics_heard": " ".join(self._heard),
            "file": str(self._recorder.path),
        }
        self._diagnostics.report(level, text, figures, self._time)
        self._longest_wait, self._reported_dropped = 0.0, dropped


def _begins_with_stamp(message_class: Any) -> bool:
    """Whether a message begins with a stamp: in a header, or as the clock does."""
    first = next(iter(message_class.get_fields_and_field_types().items()), ("", ""))
    return first[1] == "std_msgs/Header" or first == ("clock", "builtin_interfaces/Time")


def _stamp(data: bytes) -> int:
    """Return the stamp at the beginning of a message in CDR, ns. The second byte of CDR gives the byte order."""
    order = "<" if data[1] & 1 else ">"
    seconds, rest = struct.unpack_from(f"{order}iI", data, 4)
    return max(seconds * NANOSECONDS + rest, 0)


def main() -> NoReturn:
    """Run the node until a signal; the exit code is 2 if the file cannot be written."""
    node_tools.leave(node_tools.run_node("record", Record, linger=LINGER, farewell=MAX_FINISH))


if __name__ == "__main__":
    main()
