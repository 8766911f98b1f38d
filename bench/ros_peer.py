"""Cost of ROS itself: two plain rclpy nodes that pass the messages of a control step, empty, back and forth.

Nothing is simulated, checked or filled in here. `peers` opens the node that asks; the one that answers is this module
as a program.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Final

from bike_msgs.msg import BikeCommand, BikeState

from bike_sim.ros.isolation import DomainLease, end_with_this_process, parent_is_gone
from bike_sim.ros.node_tools import GuestNode

DEPTH: Final = 10
START_TIMEOUT_S: Final = 60.0
"""Wall-clock time in which the answering node must be found, s."""
RESEND_AFTER_S: Final = 0.5
"""Wall-clock time after which a message counts as lost and is sent again, s."""


@contextmanager
def peers() -> Iterator[Callable[[int], float]]:
    """Open both nodes; yield what passes a number of messages to and fro and returns the wall-clock time, s.

    Raises:
        RuntimeError: they do not find each other.
    """
    answers = [0]

    def answered(_: BikeState) -> None:
        answers[0] += 1

    with closing(DomainLease()) as lease, closing(GuestNode("asking", lease.domain_id)) as node:
        environment = dict(os.environ)
        end_with_this_process(environment)
        command = [sys.executable, "-m", "bench.ros_peer", str(lease.domain_id)]
        with subprocess.Popen(command, env=environment, cwd=Path(__file__).parents[1]) as other:
            commands = node.create_publisher(BikeCommand, "command", DEPTH)
            node.create_subscription(BikeState, "state", answered, DEPTH)

            def passed(count: int, patience: float = RESEND_AFTER_S) -> float:
                began = time.perf_counter()
                for _ in range(count):
                    before, resend_at = answers[0], 0.0
                    while answers[0] == before:
                        if time.monotonic() > resend_at:
                            commands.publish(BikeCommand())
                            resend_at = time.monotonic() + patience
                        node.spin_once(patience)
                        if other.poll() is not None or time.perf_counter() - began > START_TIMEOUT_S:
                            raise RuntimeError("the other rclpy node does not answer")
                return time.perf_counter() - began

            try:
                passed(3, 0.1)
                yield passed
            finally:
                other.terminate()


def main() -> None:
    """Answer every command with a state until the end of the program that asks."""
    node = GuestNode("answering", int(sys.argv[1]))
    states = node.create_publisher(BikeState, "state", DEPTH)
    node.create_subscription(BikeCommand, "command", lambda _: states.publish(BikeState()), DEPTH)
    while not parent_is_gone():
        node.spin_once(1.0)


if __name__ == "__main__":
    main()
