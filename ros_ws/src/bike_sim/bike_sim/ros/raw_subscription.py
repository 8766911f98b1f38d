"""Subscriptions that take messages as bytes and many at a time, and the QoS that matches all publishers of a topic.

rclpy's executor takes one message of a topic each time it wakes, and a wake-up costs more the more topics there are.
The subscriptions here never wake it: their owner takes all that waits, a hundred times a second.
"""

from __future__ import annotations

import importlib
from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
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

    def lost(self) -> int:
        """Return how many messages the middleware has given up so far before they could be taken."""
        with self._losses:
            return int(self._losses.take_event().total_count)

    def close(self) -> None:
        """Unsubscribe."""
        self._losses.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscription)


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
