"""Simulator clients: the same two calls whether the simulator is in this process or behind ROS."""

from __future__ import annotations

from typing import Final, Protocol

from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator, SimulatorConfig, Snapshot

CLIENT_KINDS: Final = ("local", "ros")


class Client(Protocol):
    """What an environment needs of a simulator. :class:`~bike_sim.sim.simulator.Simulator` is one itself."""

    def reset(self, request: ResetRequest) -> Snapshot:
        """Begin an episode."""
        ...

    def step(self, steering: float, throttle: float = 0.0) -> Snapshot:
        """Hold a command in [-1, 1] for one control period."""
        ...

    def close(self) -> None:
        """Release the simulator."""
        ...


def make_client(kind: str, config: SimulatorConfig) -> Client:
    """Return a client with a simulator of its own.

    Args:
        kind: ``local`` rides in this process, ``ros`` starts a ``sim_node`` and rides it in lockstep.
        config: vehicle, engine and steps.

    Raises:
        ValueError: an unknown kind.
    """
    if kind == "local":
        return Simulator(config)
    if kind == "ros":
        from bike_training.envs.ros_client import RosClient

        return RosClient(config)
    raise ValueError(f"unknown client {kind!r}; choose one of {', '.join(CLIENT_KINDS)}")
