"""Watches a ride of running nodes from outside."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Final, Self

from bike_msgs.msg import BikeState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from tqdm import tqdm

from bike_sim import node_tools
from bike_training.node_process import NodeLost, NodeProcess

SILENCE: Final = 15.0
"""Wall-clock time without a new state after which a ride counts as stuck, s."""

START_TIMEOUT: Final = 60.0
"""Wall-clock time that the nodes get to find each other, s; the first line of a machine takes some seconds."""

LISTENERS: Final = {"state": 2, "command": 2}
"""Subscriptions by topic once the recorder is there: its own, that of the state here, the simulator's of the command.

It finds topics one after the other: a short ride can be over before it hears the commands.
"""


def has_ended(state: BikeState) -> bool:
    """Whether a ride is over: finished, fallen or off course."""
    return bool(state.finished or state.fallen or state.off_course)


def ride_recorded(
    domain: int,
    record: Mapping[str, Any],
    simulator: Mapping[str, Any],
    drive: Mapping[str, Any],
    *,
    title: str,
    way: float,
    longest: float,
    is_over: Callable[[BikeState], bool] = has_ended,
) -> float:
    """Start recorder, simulator and policy, show the progress of the ride until it ends, and stop them.

    Args:
        domain: ROS domain of the nodes.
        record: parameters of the recorder.
        simulator: parameters of the simulator.
        drive: parameters of the policy.
        title: of the progress bar.
        way: of the ride, m.
        longest: longest ride, s of simulated time.
        is_over: whether a state ends the ride.

    Returns:
        Wall-clock time of the ride, s.

    Raises:
        NodeLost: a node ended, no state came for long, or the recorder could not finish its file.
    """
    with NodeProcess("bike_sim.record", record, domain) as recorder:
        with NodeProcess("bike_sim.sim_node", simulator, domain) as sim, RideMonitor(domain) as monitor:
            # The policy starts last, when the recorder hears the simulator: then no step is missed.
            monitor.wait_for_recorder(START_TIMEOUT, [sim, recorder])
            with NodeProcess("bike_policy.drive", drive, domain) as policy:
                begun = time.monotonic()
                with tqdm(total=round(way), unit="m", desc=title) as bar:
                    monitor.watch(bar, longest, [sim, recorder, policy], is_over)
                wall = time.monotonic() - begun
        recorder.finish()
        return wall


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
        while self._state is None or any(self._node.count_subscribers(name) < n for name, n in LISTENERS.items()):
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
        is_over: Callable[[BikeState], bool] = has_ended,
    ) -> None:
        """Show progress until the ride ends or is out of simulated time.

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
