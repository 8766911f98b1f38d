"""The topics of a live ride for Foxglove's app, through its own WebSocket protocol, where the app needs no ROS.

A thread takes messages as bytes, as the recorder does, and hands them on unchanged: CDR with the definitions of a
recording, so the layouts that open a recording show the ride as well. Clients can only listen.

Channels are opened only while no client is connected. To a client that is, foxglove-sdk 0.30.3 announces a new channel
before it accepts subscriptions to it (`advertise_channels` in `connected_client.rs`): a client that subscribes at once,
as the app does, may be refused, and the app does not ask again. To one that connects, it announces all channels before
it reads. So the server starts once the ride's topics are known, and starts again when another one appears.
"""

from __future__ import annotations

import queue
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter
from typing import Any, Final

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener, WebSocketServer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy

from bike_sim.recording.definitions import message_type
from bike_sim.ros import node_tools
from bike_sim.ros.record import LOOK_PERIOD, SHARED_TOPICS
from bike_sim.ros.subscriptions import RawSubscription, class_of, matching_qos
from bike_training.nodes.live_server import HOST

PERIOD: Final = 0.01
"""Wall-clock time between two visits to the subscriptions, s."""
MAX_AT_ONCE: Final = 1000
"""Messages of a topic in one visit."""
SETTLED: Final = 0.6
"""Wall-clock time without a new topic after which a ride's topics are taken to be known, s."""
MAX_SEARCH: Final = 10.0
"""Wall-clock time for that, s; what appears later makes the server start again."""


MAX_PAUSE: Final = 2.0
"""Wall-clock time that the port may stay taken when the server starts again, s."""


@dataclass
class _Topic:
    subscription: RawSubscription
    channel: foxglove.Channel
    latched: bool
    last: bytes | None = None
    passed_on_at: float = 0.0


@dataclass(frozen=True)
class _Found:
    name: str
    kind: str
    ends: list[Any]


class FoxgloveBridge(ServerListener):
    """Serves the topics of a namespace at 127.0.0.1 until `close`.

    Attributes:
        port: that it listens at.
    """

    port = 0

    def __init__(self, domain_id: int, port: int, namespace: str = node_tools.NAMESPACE) -> None:
        """Join a ROS domain, find the ride's topics (a second; at most `MAX_SEARCH`), and listen.

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
        self._joined: queue.SimpleQueue[tuple[str, float]] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._sinks = foxglove.Context()
        self._server: WebSocketServer | None = None
        self._serve(port)  # a port that is taken is told at once
        self._ros = node_tools.join(domain_id)
        self._node = Node("foxglove_bridge", context=self._ros, enable_rosout=False, start_parameter_services=False)
        self._open(self._search())
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
        self._pause()
        for topic in self._topics.values():
            topic.subscription.close()
        self._node.destroy_node()
        node_tools.leave_domain(self._ros)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Remember, in a thread of the server, who may have come too late for what was published once."""
        self._joined.put((channel.topic, time.monotonic()))

    def _serve(self, port: int) -> None:
        try:
            self._server = foxglove.start_server(
                name="two-wheeler lab", host=HOST, port=port, server_listener=self, context=self._sinks
            )
        except Exception as error:
            raise OSError(f"port {port} cannot be opened for Foxglove: {error}") from None
        self.port = self._server.port

    def _pause(self) -> None:
        if self._server is not None:
            self._server.stop()
            self._server = None

    def _search(self) -> list[_Found]:
        """Wait until the ride's topics are known; return them."""
        begun = changed = time.monotonic()
        found: list[_Found] = []
        while (now := time.monotonic()) < begun + MAX_SEARCH and not (found and now > changed + SETTLED):
            seen = self._new_topics()
            if len(seen) != len(found):
                found, changed = seen, now
            time.sleep(PERIOD)
        return found

    def _new_topics(self) -> list[_Found]:
        """Topics that have a publisher and no channel yet."""
        found: list[_Found] = []
        for name, kinds in self._node.get_topic_names_and_types():
            ours = name.startswith(self._namespace) or name in SHARED_TOPICS
            if not ours or node_tools.is_hidden(name) or name in self._topics or name in self._refused:
                continue
            if ends := self._node.get_publishers_info_by_topic(name):
                found.append(_Found(name, kinds[0], ends))
        return found

    def _open(self, found: list[_Found]) -> None:
        """Open channels while nobody is connected; clients are disconnected, and the app comes back by itself.

        Raises:
            OSError: somebody else has taken the port meanwhile.
        """
        heard: list[tuple[_Found, foxglove.Schema, RawSubscription]] = []
        for topic in found:
            try:
                heard.append((topic, *self._hear(topic)))
            except (ImportError, AttributeError, ValueError, FileNotFoundError):  # a type that is not installed
                self._refused.add(topic.name)
        self._pause()  # as late as possible: whoever comes now is refused
        for topic, schema, subscription in heard:
            channel = foxglove.Channel(topic.name, message_encoding="cdr", schema=schema, context=self._sinks)
            latched = matching_qos(topic.ends).durability == DurabilityPolicy.TRANSIENT_LOCAL
            self._topics[topic.name] = _Topic(subscription, channel, latched)
        self._serve_again()

    def _serve_again(self) -> None:
        """Listen at the same port, which a server that was stopped gives up in its own time."""
        end = time.monotonic() + MAX_PAUSE
        while True:
            try:
                self._serve(self.port)
                break
            except OSError:
                if time.monotonic() > end:
                    raise
            time.sleep(PERIOD)

    def _hear(self, found: _Found) -> tuple[foxglove.Schema, RawSubscription]:
        described = message_type(found.kind)
        schema = foxglove.Schema(name=found.kind, encoding="ros2msg", data=described.definition.encode())
        return schema, RawSubscription(self._node, class_of(found.kind), found.name, matching_qos(found.ends))

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
        """Open a channel for each topic that has appeared; try again where the port was lost for a moment."""
        found = self._new_topics()
        if found or self._server is None:
            with suppress(OSError):
                self._open(found)

    def _pass_on(self) -> None:
        batch: list[tuple[int, _Topic, bytes]] = []
        for topic in self._topics.values():
            topic.subscription.take(batch, topic, MAX_AT_ONCE)
        batch.sort(key=itemgetter(0))
        for sent, topic, data in batch:
            if topic.latched:
                topic.last, topic.passed_on_at = data, time.monotonic()
            topic.channel.log(data, log_time=sent)

    def _repeat(self) -> None:
        """Send again what was published before somebody subscribed, where nothing came since; others get it twice."""
        while not self._joined.empty():
            name, joined_at = self._joined.get()
            topic = self._topics.get(name)
            if topic is not None and topic.last is not None and topic.passed_on_at < joined_at:
                topic.channel.log(topic.last, log_time=time.time_ns())
