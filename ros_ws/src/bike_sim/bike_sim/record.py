"""The recorder as a ROS 2 node: takes messages as bytes and writes them down as rosbag2 would.

The log time of a message is simulated time: the stamp of its header where it has one, else the latest time of
``/clock`` or of a state. The file is closed on SIGINT and SIGTERM; after a kill it can be read up to its last whole
chunk.
"""

from __future__ import annotations

import importlib
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NoReturn

import rclpy.node
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bike_sim import node_tools
from bike_sim.messages import NANOSECONDS
from bike_sim.node_tools import CannotGoOn, ParameterSpec
from bike_sim.recording import Qos, RideRecorder

SPECS: Final = (
    ParameterSpec("path", "ride.mcap", "Recording: name.mcap, or a directory as rosbag2 makes it.", fixed=True),
    ParameterSpec("topics", (), "Topics to record; none: the namespace's, /clock, /diagnostics and /tf.", fixed=True),
    ParameterSpec("overwrite", False, "Whether an existing recording is replaced.", fixed=True),
    ParameterSpec("compression", "zstd", "Of the file's chunks.", fixed=True, choices=("zstd", "lz4", "none")),
    ParameterSpec("notes", (), "Notes for the recording, each as name=text.", fixed=True),
)

SHARED_TOPICS: Final = ("/clock", "/diagnostics", "/tf", "/tf_static")
LOOK_PERIOD: Final = 0.2
"""Wall-clock time between two looks for new topics and two writes of open chunks, s."""
REPORT_PERIOD: Final = 1.0
LINGER: Final = 0.3
"""Wall-clock time after a signal in which messages that were sent before it are still written, s."""
LONGEST_LEAD: Final = 60 * NANOSECONDS
"""A stamp that is farther than this ahead of the latest time is of another clock, ns."""
TIME_GIVERS: Final = ("rosgraph_msgs/msg/Clock", "bike_msgs/msg/BikeState")
"""Types that tell the present simulated time."""


class Record(rclpy.node.Node):
    """Subscribes to topics as they appear and writes what comes."""

    def __init__(self) -> None:
        """Open the recording.

        Raises:
            ValueError: a parameter that cannot be. OSError: the file exists already or cannot be written.
        """
        super().__init__("record", namespace=node_tools.NAMESPACE)
        values = node_tools.declare(self, SPECS)
        self._wanted: tuple[str, ...] = tuple(self.resolve_topic_name(name) for name in values["topics"])
        self._recorder = RideRecorder(
            Path(values["path"]).expanduser(),
            compression=values["compression"],
            overwrite=values["overwrite"],
            notes=_notes(values["notes"]),
        )
        self._time = 0
        self._known: set[str] = set()
        self._dropped = 0
        self._reported_at = time.monotonic()
        self._reported_dropped = 0
        self._diagnostics = node_tools.Diagnostics(self)
        node_tools.wall_timer(self, LOOK_PERIOD, self._look)
        self._look()
        self.get_logger().info(f"recording to {self._recorder.path}")

    def finish(self) -> None:
        """Close the file and report a last time."""
        self._recorder.close()
        self._report()
        written = f"{self._recorder.message_count} messages on {len(self._recorder.topics)} topics"
        self.get_logger().info(f"{written} in {self._recorder.path}, {self._dropped} dropped")

    # ---------------------------------------------------------------------------------------------------------- topics

    def _look(self) -> None:
        """Subscribe to new topics, and write down what waits in an open chunk."""
        for name, kinds in self.get_topic_names_and_types():
            if name not in self._known and self._is_wanted(name):
                self._subscribe(name, kinds)
        self._recorder.flush()
        if time.monotonic() - self._reported_at > REPORT_PERIOD - 0.5 * LOOK_PERIOD:
            self._report()

    def _is_wanted(self, name: str) -> bool:
        if self._wanted:
            return name in self._wanted
        return name.startswith(f"{self.get_namespace().rstrip('/')}/") or name in SHARED_TOPICS

    def _subscribe(self, name: str, kinds: list[str]) -> None:
        # A topic that is only listened to so far is waited for, so that its first message is not missed.
        ends = self.get_publishers_info_by_topic(name) or self.get_subscriptions_info_by_topic(name)
        if not ends:
            return
        self._known.add(name)
        try:
            message_class = _message_class(kinds[0])
            qos = _matching_qos(ends)
            self._recorder.add_topic(name, kinds[0], _described(ends[0], qos))
        except (ImportError, AttributeError, FileNotFoundError) as error:
            self.get_logger().warning(f"topic {name} is not recorded: {error}")
            return
        callback = self._writer(name, kinds[0], _begins_with_stamp(message_class))
        lost = SubscriptionEventCallbacks(message_lost=self._on_lost)
        self.create_subscription(message_class, name, callback, qos, raw=True, event_callbacks=lost)

    def _writer(self, name: str, kind: str, stamped: bool) -> Callable[[bytes], None]:
        gives_time = kind in TIME_GIVERS

        def write(data: bytes) -> None:
            stamp = _stamp(data) if stamped else self._time
            if gives_time:
                self._time = stamp
            elif self._time and stamp > self._time + LONGEST_LEAD:
                stamp = self._time
            try:
                self._recorder.write(name, data, stamp)
            except OSError as error:
                raise CannotGoOn(error) from error

        return write

    def _on_lost(self, event: Any) -> None:
        """Count messages that the middleware gave up before they could be taken."""
        self._dropped += event.total_count_change

    def _report(self) -> None:
        new = self._dropped - self._reported_dropped
        level = self._diagnostics.WARN if new else self._diagnostics.OK
        text = f"{new} messages dropped in the last second" if new else "recording"
        if new:
            self.get_logger().warning(text)
        figures = {
            "messages_written": self._recorder.message_count,
            "messages_dropped": self._dropped,
            "topics": len(self._recorder.topics),
            "path": str(self._recorder.path),
        }
        self._diagnostics.report(level, text, figures, self._time)
        self._reported_at, self._reported_dropped = time.monotonic(), self._dropped


def _notes(entries: tuple[str, ...]) -> dict[str, str]:
    notes = {}
    for entry in entries:
        name, separator, text = entry.partition("=")
        if not separator or not name.strip():
            raise ValueError(f"parameter notes: {entry!r} is not of the form name=text")
        notes[name.strip()] = text.strip()
    return notes


def _message_class(kind: str) -> type:
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _begins_with_stamp(message_class: Any) -> bool:
    """Whether a message begins with a stamp: in a header, or as the clock does."""
    first = next(iter(message_class.get_fields_and_field_types().items()), ("", ""))
    return first[1] == "std_msgs/Header" or first == ("clock", "builtin_interfaces/Time")


def _stamp(data: bytes) -> int:
    """Return the stamp at the beginning of a message in CDR, ns. The second byte of CDR tells the byte order."""
    order = "<" if data[1] & 1 else ">"
    seconds, rest = struct.unpack_from(f"{order}iI", data, 4)
    return max(seconds * NANOSECONDS + rest, 0)


def _matching_qos(ends: list[TopicEndpointInfo]) -> QoSProfile:
    """Return the strictest QoS that all publishers offer, or that all subscriptions ask for."""
    profiles = [end.qos_profile for end in ends]
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        # All is kept until it is written: what the middleware then gives up it reports as lost.
        history=HistoryPolicy.KEEP_ALL,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _described(end: TopicEndpointInfo, qos: QoSProfile) -> Qos:
    """Return a QoS in the words of a recording. Discovery does not carry the depth of a publisher's queue."""
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Qos(
        depth=end.qos_profile.depth or (1 if latched else 10),
        reliability="reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best_effort",
        durability="transient_local" if latched else "volatile",
    )


def main() -> NoReturn:
    """Run the node until a signal; the exit code is 2 if the file cannot be written."""
    node_tools.leave(node_tools.run_node("record", Record, linger=LINGER))


if __name__ == "__main__":
    main()
