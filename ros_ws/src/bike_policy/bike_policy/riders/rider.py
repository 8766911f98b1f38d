"""The protocol of a rider, which answers snapshots with commands in process and in the policy node."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Final, Protocol

from bike_policy.contract.bundle import load_bundle
from bike_policy.riders.learned import LearnedRider
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle


class Rider(Protocol):
    """Answers snapshots with commands.

    Attributes:
        name: for people and recordings.
        preview: the preview that it needs; None where it takes any.
    """

    name: str
    preview: Preview | None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare for an episode.

        Args:
            vehicle: to be ridden.
            course: the followed line.
            period: control period, s.
            preview: the preview that snapshots will hold.

        Raises:
            ValueError: this rider cannot ride that, naming the difference.
        """
        ...

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return steering and throttle in [-1, 1], or None for a snapshot that is not finite."""
        ...


RIDERS: Final[Mapping[str, tuple[str, str]]] = {
    "classical": ("bike_policy.riders.classical", "ClassicalRider"),
    "lqr": ("bike_policy.riders.lqr", "LqrRider"),
    "mpc": ("bike_policy.riders.mpc", "MpcRider"),
    "stanley": ("bike_policy.riders.stanley", "StanleyRider"),
}
"""Riders that are not learned, by name: module and class. They are loaded when they are asked for, because plans and
solvers take longer to load than all else that a learned rider needs."""


def make_rider(name: str) -> Rider:
    """Return the rider of a name.

    Args:
        name: a key of RIDERS, a shipped bundle, or the folder of one.

    Raises:
        ValueError: a bundle that cannot be used. FileNotFoundError: no such rider or bundle.
    """
    if name not in RIDERS:
        return LearnedRider(load_bundle(name))
    module, kind = RIDERS[name]
    rider: Rider = getattr(import_module(module), kind)()
    return rider
