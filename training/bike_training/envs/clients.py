"""Simulator clients: the same calls whether the simulator is in this process or behind ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.simulator import Simulator

if TYPE_CHECKING:
    from bike_training.envs.ros_client import RosClient

CLIENT_KINDS: Final = ("local", "ros")

Client: TypeAlias = "Simulator | RosClient"
"""A simulator as environments and rollouts use it."""


def make_client(kind: str, config: SimulatorConfig) -> Client:
    """Return a client with its own simulator: ``local`` in this process, ``ros`` in a node that is ridden in lockstep.

    Raises:
        ValueError: an unknown kind.
    """
    if kind not in CLIENT_KINDS:
        raise ValueError(f"unknown client {kind!r}; choose one of {', '.join(CLIENT_KINDS)}")
    if kind == "local":
        return Simulator(config)
    from bike_training.envs.ros_client import RosClient

    return RosClient(config)
