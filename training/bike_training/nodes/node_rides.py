"""Rides of a policy node through a simulator node, watched from a third process."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Final

from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_training.envs.node_process import NodeLost, NodeProcess
from bike_training.envs.patience import InactivityTimeout
from bike_training.envs.ros_client import RosClient
from bike_training.rollout.riding import RideResult, is_completed, is_over

SILENCE: Final = 15.0
"""Wall-clock time without a state, and without a node at work, after which a ride counts as stuck, s."""


class NodeRides(AbstractContextManager["NodeRides"]):
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

    def __exit__(self, *_: object) -> None:
        """End both nodes."""
        self._drive.close()
        self._client.close()

    def ride(self, request: ResetRequest, longest: float) -> RideResult:
        """Ride for at most a simulated time, s.

        Raises:
            ValueError: the simulator refused the request.
            NodeLost: a node ended, or no state came for long.
        """
        first = self._client.reset(replace(request, preview=Preview()))
        snapshots = [first]
        patience, step = InactivityTimeout(SILENCE, [self._drive]), first.step
        while len(snapshots) == 1 or not is_over(snapshots[-1], longest):
            state = self._client.listen(0.2)
            if state is None or state.episode != first.episode or state.step <= step:
                self._drive.check()
                if patience.is_out():
                    raise NodeLost(f"no new state for {SILENCE:g} s; the ride is stuck at step {step}")
                continue
            snapshots.append(state)
            patience.heard()
            step = state.step
        course = self._client.course
        assert course is not None, "an episode was begun"
        lost = step - first.step - (len(snapshots) - 1)
        return replace(
            RideResult.from_snapshots(snapshots, course, is_completed(snapshots[-1], request)), lost_states=lost
        )
