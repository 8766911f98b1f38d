"""Riders, which answer snapshots with commands in process and in the policy node, and their names."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Final, Protocol

from bike_policy.contract.bundle import Bundle, load_bundle
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

OBSERVED: Final = ("lqr", "mpc")
"""Those of them that an observer helps (`bike_policy.riders.observer`); learned riders of bicycles are the others."""


def make_rider(name: str) -> Rider:
    """Return the rider of a name; on a bicycle with an observer, which changes no bit of a ride that is not disturbed.

    Args:
        name: a key of RIDERS, a shipped bundle, or the folder of one.

    Raises:
        ValueError: a bundle that cannot be used.
        FileNotFoundError: no such rider or bundle.
    """
    from bike_policy.riders.learned import learned_rider
    from bike_policy.riders.observer import ObservedRider

    if name in RIDERS:
        module, kind = RIDERS[name]
        rider: Rider = getattr(import_module(module), kind)()
        return ObservedRider(rider) if name in OBSERVED else rider
    rider = learned_rider(load_bundle(name, RIDERS))
    return rider if rider.preview is None else ObservedRider(rider)


def bundle_of(rider: Rider) -> Bundle | None:
    """Return the policy of a learned rider, also of one that is observed or disturbed; None where it is not learned."""
    inner = rider
    while hasattr(inner, "rider"):
        inner = inner.rider
    return getattr(inner, "bundle", None)
