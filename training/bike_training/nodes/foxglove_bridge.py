"""The topics of a live ride for Foxglove's app, through its own WebSocket protocol, where the app needs no ROS.

A thread takes messages as bytes, as the recorder does, and hands them on unchanged: CDR with the definitions of a
recording, so the layouts that open a recording show the ride as well. Clients can only listen.

All channels are opened before the server: to a client that is connected, foxglove-sdk 0.30.3 announces a new channel
before it accepts subscriptions to it (`advertise_channels` in `connected_client.rs`), and the app does not ask again.
"""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass
from operator import itemgetter
from typing import Final

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener
from rclpy.qos import DurabilityPolicy

from bike_sim.recording.definitions import message_type
from bike_sim.ros.node_tools import NAMESPACE, GuestNode, is_hidden
from bike_sim.ros.subscriptions import RawSubscription
from bike_sim.ros.topics import TOPICS, type_name
from bike_training.nodes.live_server import HOST

PERIOD: Final = 0.01
"""Wall-clock time between two visits to the subscriptions, s."""
MAX_AT_ONCE: Final = 1000
"""Messages of a topic in one visit."""


@dataclass
class _Topic:
    subscription: RawSubscription
    channel: foxglove.Channel
    latched: bool
    last: bytes | None = None
    passed_on_at: float = 0.0


class FoxgloveBridge(ServerListener):
    """Serves the topics of a namespace at 127.0.0.1 until `close`.

    Attributes:
        port: that it listens at.
    """

    def __init__(self, domain_id: int, port: int, namespace: str = NAMESPACE) -> None:
        """Join a ROS domain and listen.

        Args:
            domain_id: of the ride.
            port: to listen at; 0 takes a free one.
            namespace: of the ride's topics.

        Raises:
            OSError: the port is taken.
        """
        self._joined: queue.SimpleQueue[tuple[str, float]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._node = GuestNode("foxglove_bridge", domain_id, f"/{namespace.strip('/')}")
        self._sinks = foxglove.Context()
        self._topics: dict[str, _Topic] = {}
        for relative, topic in TOPICS.items():
            if not is_hidden(relative):
                name, kind = self._node.resolve_topic_name(relative), type_name(topic.kind)
                definition = message_type(kind).definition.encode()
                schema = foxglove.Schema(name=kind, encoding="ros2msg", data=definition)
                channel = foxglove.Channel(name, message_encoding="cdr", schema=schema, context=self._sinks)
                latched = topic.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
                self._topics[name] = _Topic(RawSubscription(self._node, topic.kind, name, topic.qos), channel, latched)
        try:
            self._server = foxglove.start_server(
                name="two-wheeler lab", host=HOST, port=port, server_listener=self, context=self._sinks
            )
        except Exception as error:
            self._leave()
            raise OSError(f"port {port} cannot be opened for Foxglove: {error}") from None
        self.port = self._server.port
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address that the app connects to."""
        return f"ws://{HOST}:{self.port}"

    def close(self) -> None:
        """Disconnect all clients and leave the domain."""
        self._ended.set()
        self._thread.join()
        self._server.stop()
        self._leave()

    def _leave(self) -> None:
        for topic in self._topics.values():
            topic.subscription.close()
        self._node.close()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Remember, in a thread of the server, who may have come too late for what was published once."""
        self._joined.put((channel.topic, time.monotonic()))

    def _run(self) -> None:
        """Pass on what comes, in the order in which it was sent, and repeat what was sent once to who comes late."""
        while not self._ended.wait(PERIOD):
            batch: list[tuple[int, _Topic, bytes]] = []
            for topic in self._topics.values():
                topic.subscription.take(batch, topic, MAX_AT_ONCE)
            batch.sort(key=itemgetter(0))
            for sent, topic, data in batch:
                if topic.latched:
                    topic.last, topic.passed_on_at = data, time.monotonic()
                topic.channel.log(data, log_time=sent)
            while not self._joined.empty():
                name, joined_at = self._joined.get()
                known = self._topics[name]
                if known.last is not None and known.passed_on_at < joined_at:
                    known.channel.log(known.last, log_time=time.time_ns())
