"""Rides of a policy node through a simulator node, watched from a third process."""

from __future__ import annotations

from dataclasses import replace
from types import TracebackType
from typing import Final, Self

from bike_msgs.msg import BikeState

from bike_sim.ros.messages import snapshot_from_message
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import SimulatorConfig
from bike_training.envs.ros_client import RosClient
from bike_training.nodes.node_process import NodeLost, NodeProcess
from bike_training.nodes.patience import Patience
from bike_training.rollout.riding import Ride, is_completed

SILENCE: Final = 15.0
"""Wall-clock time without a state, and without a node at work, after which a ride counts as stuck, s."""


class NodeRides:
    """A simulator node and a policy node of one's own.

    A ride is begun with the reset service. From then on the policy answers the simulator's states; nothing is sent from
    here.
    """

    def __init__(self, policy: str, config: SimulatorConfig) -> None:
        """Start both nodes.

        Args:
            policy: name or folder of a bundle.
            config: simulator.

        Raises:
            NodeLost: the simulator did not start.
        """
        self._client = RosClient(config)
        try:
            self._drive = NodeProcess("bike_policy.drive", {"policy": policy}, self._client.domain_id)
        except BaseException:
            self._client.close()
            raise

    def __enter__(self) -> Self:
        """Return the nodes."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End both nodes."""
        self._drive.close()
        self._client.close()

    def ride(self, request: ResetRequest, longest: float) -> Ride:
        """Ride for at most a simulated time, s.

        Raises:
            ValueError: the simulator refused the request.
            NodeLost: a node ended, or no state came for long.
        """
        first = self._client.reset(replace(request, preview=Preview()))
        states: list[BikeState] = []
        patience, step = Patience(SILENCE, [self._drive]), first.step
        while not states or not _is_over(states[-1], longest):
            state = self._client.listen(0.2)
            if state is None or state.episode != first.episode or state.step <= step:
                self._drive.check()
                if patience.is_out():
                    raise NodeLost(f"no new state for {SILENCE:g} s; the ride is stuck at step {step}")
                continue
            states.append(state)
            patience.heard()
            step = state.step
        snapshots = [first, *(snapshot_from_message(state) for state in states)]
        lost = step - first.step - len(states)
        return replace(Ride.from_snapshots(snapshots, is_completed(snapshots[-1], request)), lost_states=lost)


def _is_over(state: BikeState, longest: float) -> bool:
    time_is_up = state.step * state.control_period > longest - 1e-9
    return bool(state.fallen or state.off_course or state.finished or time_is_up)
