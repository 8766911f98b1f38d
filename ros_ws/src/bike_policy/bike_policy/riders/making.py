"""Riders by name."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Final

from bike_policy.contract.bundle import Bundle, load_bundle
from bike_policy.riders.learned import LearnedRider
from bike_policy.riders.observed import ObservedRider
from bike_policy.riders.rider import Rider

RIDERS: Final[Mapping[str, tuple[str, str]]] = {
    "classical": ("bike_policy.riders.classical", "ClassicalRider"),
    "lqr": ("bike_policy.riders.lqr", "LqrRider"),
    "mpc": ("bike_policy.riders.mpc", "MpcRider"),
    "stanley": ("bike_policy.riders.stanley", "StanleyRider"),
}
"""Riders that are not learned, by name: module and class. They are loaded when they are asked for, because plans and
solvers take longer to load than all else that a learned rider needs."""


OBSERVED: Final = ("lqr", "mpc")
"""Those of them that an observer helps (`bike_policy.riders.observed`); learned riders of bicycles are the others."""


def make_rider(name: str) -> Rider:
    """Return the rider of a name; on a bicycle with an observer, which changes no bit of a ride that is not disturbed.

    Args:
        name: a key of RIDERS, a shipped bundle, or the folder of one.

    Raises:
        ValueError: a bundle that cannot be used. FileNotFoundError: no such rider or bundle.
    """
    rider: Rider
    if name in RIDERS:
        module, kind = RIDERS[name]
        rider = getattr(import_module(module), kind)()
        return ObservedRider(rider) if name in OBSERVED else rider
    rider = LearnedRider(load_bundle(name))
    return rider if rider.preview is None else ObservedRider(rider)


def bundle_of(rider: Rider) -> Bundle | None:
    """Return the policy of a learned rider, also of one that is observed or disturbed; None where it is not learned."""
    while not isinstance(rider, LearnedRider) and hasattr(rider, "rider"):
        rider = rider.rider
    return rider.bundle if isinstance(rider, LearnedRider) else None
