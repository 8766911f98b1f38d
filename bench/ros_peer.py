"""Cost of ROS itself: two plain rclpy processes that pass the messages of a control step, empty, back and forth.

Nobody simulates, checks or fills a field here, so lockstep through the simulator node can at best be this quick. The
process that asks is `Peer`; the one that answers is this module as a program, on the domain of its environment.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import rclpy
from bike_msgs.msg import BikeCommand, BikeState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from bike_sim.ros.isolation import (
    DOMAIN_VARIABLE,
    DomainLease,
    end_with_this_process,
    parent_is_gone,
    prepare_discovery,
)

QOS: Final = QoSProfile(depth=10)
START_TIMEOUT_S: Final = 60.0
"""Wall-clock time in which the answering process must be found, s."""
RESEND_AFTER: Final = 0.5
"""Wall-clock time after which a message counts as lost and is sent again, s."""


class Peer:
    """The process that asks, and the other one as its child."""

    def __init__(self) -> None:
        """Start the process that answers, and wait until both hear each other.

        Raises:
            RuntimeError: they do not find each other.
        """
        prepare_discovery()
        self._lease = DomainLease()
        environment = {**os.environ, DOMAIN_VARIABLE: str(self._lease.domain_id)}
        prepare_discovery(environment)
        end_with_this_process(environment)
        root = Path(__file__).parents[1]
        self._process = subprocess.Popen([sys.executable, "-m", "bench.ros_peer"], env=environment, cwd=root)
        self._context = Context()
        self._context.init(args=[], domain_id=self._lease.domain_id)
        self._node = Node("peer", context=self._context, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._commands = self._node.create_publisher(BikeCommand, "command", QOS)
        self._node.create_subscription(BikeState, "state", self._on_state, QOS)
        self._answers = 0
        try:
            self._wait_for_answers()
        except BaseException:
            self.close()
            raise

    def _on_state(self, _: BikeState) -> None:
        self._answers += 1

    def _wait_for_answers(self) -> None:
        end = time.monotonic() + START_TIMEOUT_S
        while not self._answers:
            if time.monotonic() > end or self._process.poll() is not None:
                raise RuntimeError("the other rclpy process does not answer")
            self._commands.publish(BikeCommand())
            self._executor.spin_once(timeout_sec=0.1)
        self._listen(0.5)  # answers that are still under way

    def _listen(self, duration: float) -> None:
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def pass_messages(self, count: int) -> float:
        """Send a message and wait for its answer, so many times; return the wall-clock time, s."""
        self._listen(0.0)
        began = time.perf_counter()
        for _ in range(count):
            answers = self._answers
            self._commands.publish(BikeCommand())
            resend_at = time.monotonic() + RESEND_AFTER
            while self._answers == answers:
                self._executor.spin_once(timeout_sec=RESEND_AFTER)
                if self._answers == answers and time.monotonic() > resend_at:
                    self._commands.publish(BikeCommand())
                    resend_at = time.monotonic() + RESEND_AFTER
        return time.perf_counter() - began

    def close(self) -> None:
        """End both."""
        self._process.terminate()
        self._process.wait()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
        self._lease.close()

    def __enter__(self) -> Self:
        """Return the peer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End both."""
        self.close()


def main() -> None:
    """Answer every command with a state until the end of the program that asks."""
    prepare_discovery()
    # Without handlers SIGTERM ends the process at once; rclpy's would shut the context down under a waiting executor.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("answering_peer", start_parameter_services=False)
    states = node.create_publisher(BikeState, "state", QOS)
    node.create_subscription(BikeCommand, "command", lambda _: states.publish(BikeState()), QOS)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    with suppress(KeyboardInterrupt):
        while not parent_is_gone():
            executor.spin_once(timeout_sec=1.0)


if __name__ == "__main__":
    main()
