"""The loop of a node that lives on one stream of raw messages, without the executor's cost for each of them.

For each message, rclpy's executor makes a wait set of all that the node has, wraps the callback into a task, and wakes
itself up again to look for more: several times the cost of the message (``bike bench ros``). Here the wait set stays,
and a message goes from the middleware to its callback. All else, timers, services and parameters, is left to the
executor as soon as it is ready.

Wait sets are not part of rclpy's public interface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

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
        self._look_again()

    def spin_once(self, timeout_sec: float) -> None:
        """Wait for anything, at most for a time, s, and handle a message of each stream, or one thing else."""
        waiting = self._waiting
        waiting.clear_entities()
        for add, handle in self._entities:
            add(handle)
        waiting.wait(int(timeout_sec * 1e9))
        ready = waiting.get_ready_entities("subscription")
        if any(waiting.get_ready_entities(kind) for kind in _OTHERS) or not self._own.issuperset(ready):
            self._executor.spin_once(timeout_sec=0.0)
            self._look_again()
        for stream, handle, kind in self._streams if ready else ():
            with handle:
                taken = handle.take_message(kind, True)
            if taken is not None:
                stream.callback(taken[0])

    def _look_again(self) -> None:
        """Make a wait set of what the node has now: a callback may have made or destroyed a timer."""
        node = self._node
        kinds = [
            list(entities) for entities in (node.subscriptions, node.guards, node.timers, node.clients, node.services)
        ]
        self._waiting: Any = rclpy_implementation.WaitSet(*map(len, kinds), 0, node.context.handle)
        adders = ("add_subscription", "add_guard_condition", "add_timer", "add_client", "add_service")
        self._entities = [
            (getattr(self._waiting, adder), entity.handle)
            for adder, entities in zip(adders, kinds, strict=True)
            for entity in entities
        ]
