"""Watches a ride of running nodes from outside."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Final, Self

from bike_msgs.msg import BikeState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from bike_sim import node_tools
from bike_training.node_process import NodeLost, NodeProcess

SILENCE: Final = 15.0
"""Wall-clock time without a new state after which a ride counts as stuck, s."""

LISTENERS: Final = 2
"""Subscriptions of the state once the recorder is there: the recorder's and this one's."""


class RideMonitor:
    """Listens to the state of a simulator in a ROS domain."""

    def __init__(self, domain_id: int, namespace: str = node_tools.NAMESPACE) -> None:
        """Join the domain."""
        self._context = Context()
        self._context.init(args=[], domain_id=domain_id)
        self._node = Node(
            f"ride_monitor_{os.getpid()}",
            context=self._context,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._state: BikeState | None = None
        self._node.create_subscription(BikeState, "state", self._on_state, node_tools.STREAM_QOS)

    def __enter__(self) -> Self:
        """Return the monitor."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _on_state(self, message: BikeState) -> None:
        self._state = message

    def wait_for_recorder(self, timeout: float, needed: Sequence[NodeProcess]) -> None:
        """Wait until the simulator is heard here and by the recorder.

        Args:
            timeout: wall-clock time to wait, s.
            needed: processes that must not end meanwhile.

        Raises:
            NodeLost: a process ended, or the time is up.
        """
        end = time.monotonic() + timeout
        while self._state is None or self._node.count_subscribers("state") < LISTENERS:
            self._executor.spin_once(0.05)
            for process in needed:
                process.check()
            if time.monotonic() > end:
                raise NodeLost(f"simulator and recorder did not find each other within {timeout:g} s")

    def watch(
        self,
        bar: Any,
        longest: float,
        needed: Sequence[NodeProcess],
        is_over: Callable[[BikeState], bool] = lambda state: state.finished or state.fallen or state.off_course,
    ) -> None:
        """Show progress until the ride ends: finished, fallen, off course or out of simulated time.

        Args:
            bar: a tqdm bar in m.
            longest: longest ride, s of simulated time.
            needed: processes that must not end meanwhile.
            is_over: whether a state ends the ride.

        Raises:
            NodeLost: a process ended, or no new state came for SILENCE seconds.
        """
        heard = time.monotonic()
        step = -1
        while True:
            self._executor.spin_once(0.05)
            now = time.monotonic()
            state = self._state
            if state is not None and state.step != step:
                step, heard = state.step, now
                bar.set_postfix_str(
                    f"{state.speed:.2f} m/s, error {state.lateral_error:+.3f} m, roll {state.roll * 57.29578:+.1f}°",
                    refresh=False,
                )
                bar.update(min(round(state.progress), bar.total) - bar.n)
                if is_over(state) or state.step * state.control_period > longest:
                    return
            elif now - heard > SILENCE:
                raise NodeLost(f"no new state for {SILENCE:g} s; the ride is stuck at step {step}")
            if step % 20 == 0:
                for process in needed:
                    process.check()
