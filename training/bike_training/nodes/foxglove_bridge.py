"""The topics of a live ride for Foxglove's app, through its own WebSocket protocol, where the app needs no ROS.

A thread takes messages as bytes, as the recorder does, and hands them on unchanged: CDR with the definitions of a
recording, so the layouts that open a recording show the ride as well. Clients can only listen.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Final

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy

from bike_sim.recording import message_type
from bike_sim.ros import node_tools
from bike_sim.ros.isolation import prepare_discovery
from bike_sim.ros.raw_subscription import RawSubscription, class_of, matching_qos
from bike_sim.ros.record import LOOK_PERIOD, SHARED_TOPICS
from bike_training.nodes.live_server import HOST

PERIOD: Final = 0.01
"""Wall-clock time between two visits to the subscriptions, s."""
MOST_AT_ONCE: Final = 1000
"""Messages of a topic in one visit."""


@dataclass
class _Topic:
    subscription: RawSubscription
    channel: foxglove.Channel
    latched: bool
    last: bytes | None = None


class FoxgloveBridge(ServerListener):
    """Serves the topics of a namespace at 127.0.0.1 until `close`.

    Attributes:
        port: that it listens at.
    """

    port = 0

    def __init__(self, domain_id: int, port: int, namespace: str = node_tools.NAMESPACE) -> None:
        """Join a ROS domain and listen.

        Args:
            domain_id: of the ride.
            port: to listen at; 0 takes a free one.
            namespace: of the ride's topics.

        Raises:
            OSError: the port is taken.
        """
        self._namespace = f"/{namespace.strip('/')}/"
        self._topics: dict[str, _Topic] = {}
        self._refused: set[str] = set()
        self._joined: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._sinks = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="two-wheeler lab", host=HOST, port=port, server_listener=self, context=self._sinks
            )
        except Exception as error:
            raise OSError(f"port {port} cannot be opened for Foxglove: {error}") from None
        self.port = self._server.port
        prepare_discovery()
        self._ros = Context()
        self._ros.init(args=[], domain_id=domain_id)
        self._node = Node("foxglove_bridge", context=self._ros, enable_rosout=False, start_parameter_services=False)
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """What the app connects to."""
        return f"ws://{HOST}:{self.port}"

    def close(self) -> None:
        """Disconnect all clients and leave the domain."""
        self._ended.set()
        self._thread.join()
        self._server.stop()
        self._node.destroy_node()
        self._ros.try_shutdown()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Remember, in a thread of the server, who may have come too late for what was published once."""
        self._joined.put(channel.topic)

    # ------------------------------------------------------------------------------------------------ in its own thread

    def _run(self) -> None:
        look_at = 0.0
        while not self._ended.wait(PERIOD):
            if time.monotonic() >= look_at:
                look_at = time.monotonic() + LOOK_PERIOD
                self._look()
            self._pass_on()
            self._repeat()

    def _look(self) -> None:
        """Open a channel for each new topic that has a publisher."""
        for name, kinds in self._node.get_topic_names_and_types():
            ours = name.startswith(self._namespace) or name in SHARED_TOPICS
            if not ours or name in self._topics or name in self._refused:
                continue
            if ends := self._node.get_publishers_info_by_topic(name):
                try:
                    self._open(name, kinds[0], ends)
                except (ImportError, AttributeError, ValueError, FileNotFoundError):  # a type that is not installed
                    self._refused.add(name)

    def _open(self, name: str, kind: str, ends: list[Any]) -> None:
        described = message_type(kind)
        schema = foxglove.Schema(name=kind, encoding="ros2msg", data=described.definition.encode())
        channel = foxglove.Channel(name, message_encoding="cdr", schema=schema, context=self._sinks)
        qos = matching_qos(ends)
        subscription = RawSubscription(self._node, class_of(kind), name, qos)
        self._topics[name] = _Topic(subscription, channel, qos.durability == DurabilityPolicy.TRANSIENT_LOCAL)

    def _pass_on(self) -> None:
        batch: list[tuple[int, _Topic, bytes]] = []
        for topic in self._topics.values():
            topic.subscription.take(batch, topic, MOST_AT_ONCE)
        batch.sort(key=itemgetter(0))
        for sent, topic, data in batch:
            if topic.latched:
                topic.last = data
            topic.channel.log(data, log_time=sent)

    def _repeat(self) -> None:
        """Send again what was published once and somebody has subscribed to since; others get it twice."""
        while not self._joined.empty():
            topic = self._topics.get(self._joined.get())
            if topic is not None and topic.last is not None:
                topic.channel.log(topic.last, log_time=time.time_ns())
