"""The only loop of rider and simulator, in process or behind ROS.

Evaluation, validation, laps, replay and recordings take their snapshots from here.
"""

from __future__ import annotations

from collections.abc import Iterator

from bike_policy.riders.rider import Rider
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.snapshot import Snapshot
from bike_training.envs.clients import Client


def rollout(client: Client, rider: Rider, request: ResetRequest) -> Iterator[Snapshot]:
    """Begin an episode and ride it step by step, as long as the caller takes snapshots.

    Args:
        client: simulator.
        rider: answers each snapshot with a command.
        request: how the episode begins.

    Yields:
        Each snapshot, from the one of the reset on. It ends after a fall and where the rider has no answer.

    Raises:
        ValueError: the request or the rider does not fit the simulator.
    """
    snapshot = client.reset(request)
    course = client.course
    assert course is not None, "an episode has begun"
    rider.begin(client.vehicle, course, client.config.control_period, client.preview)
    yield snapshot
    while not snapshot.fallen:
        command = rider.command(snapshot)
        if command is None:
            return
        snapshot = client.step(*command)
        yield snapshot
