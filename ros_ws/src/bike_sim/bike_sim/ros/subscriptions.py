"""Subscriptions that take messages as bytes, and the QoS that matches all publishers of a topic.

rclpy's executor makes a wait set of all that a node has for each message, wraps the callback into a task and wakes
itself up again: several times the cost of the message (``bike bench ros``). A `RawSubscription` never wakes it: its
owner takes all that waits, a hundred times a second, or waits for the next. It and a `StreamLoop` keep a wait set of
their own; wait sets are not part of rclpy's public interface. `subscribe` is for what comes seldom.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from bike_sim.recording.metadata import Qos

_MESSAGE_LOST: Final = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MESSAGE_LOST


class _NeverWoken(CallbackGroup):
    """A callback group that the executor does not wait for."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


class RawSubscription:
    """Takes the messages of one topic as bytes.

    Attributes:
        qos: That it requests.
    """

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile) -> None:
        """Subscribe.

        Args:
            node: Whose subscription it is.
            kind: Class of the messages.
            topic: Name of the topic.
            qos: That is requested, see `matching_qos`.
        """
        self.qos = qos
        self._node = node
        self._kind = kind
        self._subscription = node.create_subscription(
            kind,
            topic,
            lambda _: None,
            qos,
            raw=True,
            callback_group=_NeverWoken(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self._handle = self._subscription.handle
        with self._handle:
            self._losses = rclpy_implementation.EventHandle(self._handle, _MESSAGE_LOST)
        with node.context.handle:
            self._wait_set: Any = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)

    def take(self, into: list[tuple[int, Any, bytes]], mark: Any, most: int) -> int | None:
        """Take what waits, in the order in which it came.

        Args:
            into: Gets an entry for each message: wall-clock time of its publication, ns, then `mark` and its bytes.
            mark: Anything that identifies the topic.
            most: Messages that are taken at most.

        Returns:
            Wall-clock time at which the first of them was received, ns; None if there was none.
        """
        first = None
        with self._handle:
            take, kind = self._handle.take_message, self._kind
            for _ in range(most):
                taken = take(kind, True)
                if taken is None:
                    break
                data, info = taken
                if first is None:
                    first = info["received_timestamp"]
                into.append((info["source_timestamp"], mark, data))
        return first

    def wait(self, timeout: float) -> bytes | None:
        """Return the next message, or None after the time-out (s)."""
        with self._handle:
            taken = self._handle.take_message(self._kind, True)
            if taken is None:
                self._wait_set.clear_entities()
                self._wait_set.add_subscription(self._handle)
                self._wait_set.wait(max(int(timeout * 1e9), 0))
                taken = self._handle.take_message(self._kind, True)
        return None if taken is None else taken[0]

    def lost(self) -> int:
        """Return how many messages the middleware has given up so far before they could be taken."""
        with self._losses:
            return int(self._losses.take_event().total_count)

    def close(self) -> None:
        """Unsubscribe."""
        self._losses.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)


_OTHERS = ("service", "timer", "guard_condition", "client")


class StreamLoop:
    """Waits for a node and calls back, message by message for streams and through its executor for the rest."""

    def __init__(self, node: Node, executor: Executor, streams: Sequence[Subscription]) -> None:
        """Take over the waiting.

        Args:
            node: the only node of the executor.
            executor: what handles all but the streams.
            streams: raw subscriptions of the node.
        """
        self._node = node
        self._executor = executor
        self._streams = [(stream, stream.handle, stream.msg_type) for stream in streams]
        self._own = {stream.handle.pointer for stream in streams}
        self._make_wait_set()

    def spin_once(self, timeout_sec: float) -> None:
        """Wait for anything, at most for a time, s, and handle a message of each stream, or one thing else."""
        waiting = self._wait_set
        waiting.clear_entities()
        for add, handle in self._entities:
            add(handle)
        waiting.wait(int(timeout_sec * 1e9))
        ready = waiting.get_ready_entities("subscription")
        if any(waiting.get_ready_entities(kind) for kind in _OTHERS) or not self._own.issuperset(ready):
            self._executor.spin_once(timeout_sec=0.0)
            self._make_wait_set()
        for stream, handle, kind in self._streams if ready else ():
            with handle:
                taken = handle.take_message(kind, True)
            if taken is not None:
                stream.callback(taken[0])

    def _make_wait_set(self) -> None:
        """Make a wait set of what the node has now: a callback may have made or destroyed a timer."""
        node = self._node
        kinds = [
            list(entities) for entities in (node.subscriptions, node.guards, node.timers, node.clients, node.services)
        ]
        self._wait_set: Any = rclpy_implementation.WaitSet(*map(len, kinds), 0, node.context.handle)
        adders = ("add_subscription", "add_guard_condition", "add_timer", "add_client", "add_service")
        self._entities = [
            (getattr(self._wait_set, adder), entity.handle)
            for adder, entities in zip(adders, kinds, strict=True)
            for entity in entities
        ]


def subscribe(node: Node, kind: type, topic: str, callback: Callable[[Any], object], qos: QoSProfile) -> Subscription:
    """Subscribe to messages as objects; bytes that are not such a message are named once in the log.

    rclpy's own subscription raises in the executor then, which ends the node.

    Args:
        node: whose subscription it is.
        kind: class of the messages.
        topic: name of the topic.
        callback: gets each message. A ValueError from it counts as bytes that are not such a message.
        qos: that is requested.
    """
    refused: list[bytes] = []

    def take(data: bytes) -> None:
        try:
            callback(deserialize_message(data, kind))
        except (RuntimeError, ValueError) as error:
            if not refused:
                refused.append(data)
                node.get_logger().error(f"{len(data)} bytes on {topic} are not of type {kind.__name__}: {error}")

    return node.create_subscription(kind, topic, take, qos, raw=True)


def class_of(kind: str) -> type:
    """Return the class of a message type.

    Args:
        kind: Full name, ``package/msg/Type``.

    Raises:
        ImportError, AttributeError: It is not installed.
    """
    package, _, name = kind.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def matching_qos(ends: list[TopicEndpointInfo]) -> QoSProfile:
    """Return the strictest QoS that all publishers offer, or that all subscriptions request."""
    profiles = [end.qos_profile for end in ends]
    reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
    latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
    return QoSProfile(
        # Everything is kept until it is taken: messages that the middleware still discards are reported as lost.
        history=HistoryPolicy.KEEP_ALL,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def asks_too_much(asked: QoSProfile, offered: QoSProfile) -> bool:
    """Whether a subscription does not match publishers because it requests more than they offer."""
    return (asked.reliability == ReliabilityPolicy.RELIABLE and offered.reliability != ReliabilityPolicy.RELIABLE) or (
        asked.durability == DurabilityPolicy.TRANSIENT_LOCAL and offered.durability != DurabilityPolicy.TRANSIENT_LOCAL
    )


def described_qos(end: TopicEndpointInfo) -> Qos:
    """Return a QoS in the words of a recording. Discovery does not carry the depth of a publisher's queue."""
    profile = end.qos_profile
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Qos(
        depth=profile.depth or (1 if latched else 10),
        reliability="reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best_effort",
        durability="transient_local" if latched else "volatile",
        deadline_ns=profile.deadline.nanoseconds,
        lifespan_ns=profile.lifespan.nanoseconds,
    )
