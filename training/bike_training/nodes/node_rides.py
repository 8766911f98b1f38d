"""Rides of a policy node through a simulator node, watched from a third process and recorded by a fourth."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Final

from bike_msgs.msg import BikeState
from bike_msgs.srv import Pause
from diagnostic_msgs.msg import DiagnosticArray

from bike_policy.riders.classical import CLASSICAL
from bike_sim.physics.superbike.engine import TIME_STEP
from bike_sim.ros import node_tools
from bike_sim.ros.isolation import DomainLease
from bike_sim.ros.subscriptions import subscribe
from bike_training.envs.node_process import InactivityTimeout, NodeLost, NodeProcess
from bike_training.progress import progress_bar
from bike_training.rollout.laps import MAX_LAP_RATIO

SILENCE: Final = 15.0
"""Wall-clock time without a new state, and without a node at work, after which a ride counts as stuck, s."""

START_TIMEOUT: Final = 60.0
"""Wall-clock time without a node at work that the nodes get to find each other, s."""

LONG_START: Final = 5.0
"""Wall-clock time after which a slow start is explained, s."""

EXPLANATION: Final = (
    "the simulator is starting; its first start on a machine compiles the physics, which may take minutes"
)

NEEDED_TOPICS: Final = ("state", "command", "episode", "course")
"""Topics that a recorder must have written before a ride continues: nodes discover each other in pairs, some only after
seconds, and a short ride could be over by then."""


def has_ended(state: BikeState) -> bool:
    """Whether a ride is over: finished, fallen or off course."""
    return bool(state.finished or state.fallen or state.off_course)


def ride_recorded(
    domain: int,
    parameters: Mapping[str, Mapping[str, Any]],
    *,
    title: str,
    distance: float,
    longest: float,
    is_over: Callable[[BikeState], bool] = has_ended,
    needed: Sequence[str] = NEEDED_TOPICS,
) -> float:
    """Start recorder, simulator and policy, show the progress of the ride until it ends, and stop them.

    Args:
        domain: ROS domain of the nodes.
        parameters: of the nodes ``record``, ``sim_node`` and ``drive``, by their names.
        title: of the progress bar.
        distance: distance travelled, m.
        longest: longest ride, s of simulated time.
        is_over: whether a state ends the ride.
        needed: topics that must be in the recording before the ride continues.

    Returns:
        Wall-clock time of the ride, s.

    Raises:
        NodeLost: a node ended, no state came for long, or the recorder could not finish its file.
    """
    print(f"{title}: starting recorder, simulator and policy", file=sys.stderr, flush=True)
    with NodeProcess("bike_sim.ros.record", parameters["record"], domain) as recorder:
        simulator = NodeProcess("bike_sim.ros.sim_node", parameters["sim_node"], domain)
        with simulator as sim, RideMonitor(domain) as monitor:
            monitor.pause(True, START_TIMEOUT, [sim, recorder])
            with NodeProcess("bike_policy.drive", parameters["drive"], domain) as policy:
                # The simulator holds the first command until both it and the state are in the recording.
                monitor.wait_for_recorder(START_TIMEOUT, [sim, recorder, policy], needed)
                begun = time.monotonic()
                monitor.pause(False, START_TIMEOUT, [sim, recorder, policy])
                with progress_bar(title, "m", round(distance)) as bar:
                    monitor.watch(bar, longest, [sim, recorder, policy], is_over)
                wall = time.monotonic() - begun
        recorder.finish()
        return wall


class RideMonitor(AbstractContextManager["RideMonitor"]):
    """Listens to the state of a simulator in a ROS domain."""

    def __init__(self, domain_id: int) -> None:
        """Join the domain."""
        self._node = node_tools.GuestNode(f"ride_monitor_{os.getpid()}", domain_id)
        self._state: BikeState | None = None
        self._recorded: frozenset[str] = frozenset()
        self._recorder = f"{self._node.get_namespace()}/record".lstrip("/")
        # Before the subscriptions: a matched simulator knows where to send its answers; earlier ones are dropped.
        self._pause = self._node.create_client(Pause, "pause")
        subscribe(self._node, BikeState, "state", self._on_state, node_tools.STREAM_QOS)
        subscribe(self._node, DiagnosticArray, "/diagnostics", self._on_report, node_tools.EVENT_QOS)

    def __exit__(self, *_: object) -> None:
        """Leave the domain."""
        self._node.close()

    def _on_state(self, message: BikeState) -> None:
        self._state = message

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._recorder:
                figures = {value.key: value.value for value in status.values}
                self._recorded = frozenset(figures.get("topics_heard", "").split())

    def pause(self, paused: bool, timeout: float, needed: Sequence[NodeProcess]) -> None:
        """Pause the simulator as soon as it is available, or resume it.

        Args:
            paused: whether it shall hold the command that comes.
            timeout: wall-clock time to wait while none of the processes works, s.
            needed: processes that must not end meanwhile.

        Raises:
            NodeLost: a process ended, or the time is up.
        """
        found = self._spin_until(lambda: self._state is not None and self._pause.service_is_ready(), timeout, needed)
        if found:
            found = self._spin_until(self._pause.call_async(Pause.Request(paused=paused)).done, timeout, needed)
        if not found:
            raise NodeLost(f"the simulator did not answer within {timeout:g} s")

    def wait_for_recorder(
        self, timeout: float, needed: Sequence[NodeProcess], topics: Sequence[str] = NEEDED_TOPICS
    ) -> None:
        """Wait until the simulator has been discovered, and until the recorder has messages of some topics.

        Args:
            timeout: wall-clock time to wait while none of the processes works, s.
            needed: processes that must not end meanwhile.
            topics: names in the namespace.

        Raises:
            NodeLost: a process ended, or the time is up.
        """
        names = {self._node.resolve_topic_name(name) for name in topics}
        if not self._spin_until(lambda: self._state is not None and names <= self._recorded, timeout, needed):
            missing = ", ".join(sorted(names - self._recorded)) or "all"
            raise NodeLost(f"simulator and recorder did not find each other within {timeout:g} s; missing: {missing}")

    def _spin_until(self, condition: Callable[[], bool], timeout: float, needed: Sequence[NodeProcess]) -> bool:
        """Return whether a condition came to hold in time."""
        patience = InactivityTimeout(timeout, needed)
        explain_at = time.monotonic() + LONG_START
        while not condition():
            self._node.spin_once(0.05)
            for process in needed:
                process.check()
            if patience.is_out():
                return False
            if self._state is None and time.monotonic() > explain_at:
                explain_at = math.inf
                print(EXPLANATION, file=sys.stderr, flush=True)
        return True

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
            NodeLost: a process ended, or no new state came for SILENCE seconds in which none of them worked.
        """
        patience = InactivityTimeout(SILENCE, needed)
        step = -1
        while True:
            self._node.spin_once(0.05)
            state = self._state
            if state is not None and state.step != step:
                step = state.step
                patience.heard()
                bar.set_postfix_str(
                    f"{state.speed:.2f} m/s, error {state.lateral_error:+.3f} m, roll {state.roll * 57.29578:+.1f}°",
                    refresh=False,
                )
                bar.update(min(round(state.progress), bar.total) - bar.n)
                if is_over(state) or state.step * state.control_period > longest:
                    return
            elif patience.is_out():
                raise NodeLost(f"no new state for {SILENCE:g} s; the ride is stuck at step {step}")
            if step % 20 == 0:
                for process in needed:
                    process.check()


BEYOND: Final = 30.0
"""Distance that the ride continues beyond the last line, m."""


def ride_through_nodes(
    vehicle: str,
    circuit: str,
    length: float,
    laps: int,
    recording: Path,
    limit: float,
    rider: str = CLASSICAL,
    disturbances: str | None = None,
) -> float:
    """Ride an out-lap and flying laps and record them.

    Args:
        vehicle: name or file of a superbike.
        circuit: name or file of a circuit.
        length: of a lap of the followed line, m.
        laps: number of flying laps.
        recording: file to write.
        limit: theoretical lap, s.
        rider: name of a rider or folder of a policy.
        disturbances: name or file; None for none.

    Returns:
        Wall-clock time of the ride, s.

    Raises:
        NodeLost: a node ended, no state came for long, or the recorder could not finish its file.
    """
    with DomainLease() as lease:
        disturbed = {} if disturbances is None else {"disturbances": disturbances}
        simulator = {"vehicle": vehicle, "course": circuit, "time_step": TIME_STEP, **disturbed}
        notes = [f"policy={rider}", f"circuit={circuit}"]
        record = {"path": str(recording.resolve()), "overwrite": True, "notes": notes}
        pilot = {"policy": rider, **disturbed}
        if vehicle.endswith((".yaml", ".yml")):
            pilot["vehicle"] = vehicle
        end = (laps + 1) * length + BEYOND
        return ride_recorded(
            lease.domain_id,
            {"record": record, "sim_node": simulator, "drive": pilot},
            title=f"{vehicle}, {circuit}",
            needed=(*NEEDED_TOPICS, *disturbed),
            distance=end,
            longest=MAX_LAP_RATIO * limit * (laps + 1),
            is_over=lambda state: bool(state.fallen or state.progress >= end),
        )
