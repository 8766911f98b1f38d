"""Simulator clients: the same calls whether the simulator is in this process or behind ROS."""

from __future__ import annotations

from typing import Final, Protocol

from bike_sim.course.course import Course
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle

CLIENT_KINDS: Final = ("local", "ros")


class Client(Protocol):
    """A simulator as environments and rollouts use it. :class:`~bike_sim.sim.simulator.Simulator` is one itself.

    Attributes:
        config: vehicle, engine and steps.
    """

    config: SimulatorConfig

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle."""
        ...

    @property
    def course(self) -> Course | None:
        """The followed line of the present episode, or None before the first."""
        ...

    @property
    def preview(self) -> Preview:
        """The preview of the present episode."""
        ...

    def reset(self, request: ResetRequest) -> Snapshot:
        """Begin an episode."""
        ...

    def step(self, steering: float, throttle: float = 0.0) -> Snapshot:
        """Hold commands in [-1, 1] for one control period."""
        ...

    def close(self) -> None:
        """Release the simulator."""
        ...


def make_client(kind: str, config: SimulatorConfig) -> Client:
    """Return a client with its own simulator.

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
