"""Riders by name, which answer snapshots with commands in process and in the policy node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Final

from bike_policy.contract.bundle import DEFAULT_POLICY, DEFAULT_RACER, Bundle, load_bundle
from bike_policy.riders.base import LearnedRider, Rider, bundle_of, innermost
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

RIDERS: Final[Mapping[str, tuple[str, str]]] = {
    "careful": ("bike_policy.riders.classical", "CarefulRider"),
    "classical": ("bike_policy.riders.classical", "ClassicalRider"),
    "lqr": ("bike_policy.riders.lqr", "LqrRider"),
    "mpc": ("bike_policy.riders.mpc", "MpcRider"),
    "optimum": ("bike_policy.riders.optimum", "OptimumRider"),
    "stanley": ("bike_policy.riders.stanley", "StanleyRider"),
}
"""Riders that are not learned, by name: module and class. They are loaded when they are asked for, because plans and
solvers take longer to load than all else that a learned rider needs."""

LAP_SUFFIX: Final = ".csv"
"""End of the name of a best lap's file."""
OBSERVED: Final = ("lqr", "mpc")
"""Those of them that an observer helps (`bike_policy.riders.observer`); learned riders of bicycles are the others."""


SOLO: Final = "solo:"
"""Before the name of a rider: in a race it rides as if it were alone."""
DEFAULT: Final = "default"
"""Name of the rider that rides any vehicle, see `default_name`; a bundle is not found by it."""
OTHER_BICYCLES: Final = "lqr"
"""Rider of bicycles that no shipped policy was trained for: it is designed for each."""


def default_name(vehicle: Vehicle) -> str:
    """Return the name of the rider that rides a vehicle where none is chosen."""
    if isinstance(vehicle, Superbike):
        return DEFAULT_RACER
    return DEFAULT_POLICY if load_bundle(DEFAULT_POLICY).vehicle == vehicle.name else OTHER_BICYCLES


def make_rider(name: str) -> Rider:
    """Return the rider of a name; on a bicycle with an observer, which changes no bit of a ride that is not disturbed.

    Args:
        name: a key of RIDERS, a shipped bundle, the folder of one, the file of a best lap, or DEFAULT; with SOLO in
            front it sees no others.

    Raises:
        ValueError: a bundle or a lap that cannot be used.
        FileNotFoundError: no such rider, bundle or lap.
    """
    from bike_policy.riders.observer import ObservedRider

    if name.startswith(SOLO):
        return SoloRider(make_rider(name.removeprefix(SOLO)))
    if name == DEFAULT:
        return DefaultRider()
    if name.endswith(LAP_SUFFIX):
        from bike_policy.riders.optimum import BestLap, OptimumRider

        return OptimumRider(BestLap.read(Path(name)))
    if name in RIDERS:
        module, kind = RIDERS[name]
        rider: Rider = getattr(import_module(module), kind)()
        return ObservedRider(rider) if name in OBSERVED else rider
    rider = learned_rider(load_bundle(name, RIDERS))
    return rider if rider.preview is None else ObservedRider(rider)


def check_race(rider: Rider, vehicle: Vehicle) -> None:
    """Refuse a rider that cannot see others, before it plans.

    Args:
        rider: the rider.
        vehicle: that it is to ride, by which the default rider chooses.

    Raises:
        ValueError: naming it.
    """
    if isinstance(rider, DefaultRider):
        rider = make_rider(default_name(vehicle))
    bundle = bundle_of(rider)
    seen = bundle is not None and bundle.layout.sees_others
    if not seen and not isinstance(rider, SoloRider) and not getattr(innermost(rider), "races", False):
        raise ValueError(blind_words(rider.name))


def blind_words(name: str) -> str:
    """Return what is said of a rider that cannot see others."""
    return f"policy {name!r} cannot see others, as a race asks for; {SOLO}{name} rides it as if it were alone"


class DefaultRider:
    """Rides each vehicle with the rider of `default_name`; implements `Rider`.

    Attributes:
        rider: of the present ride; None before the first.
        name: its name.
        preview: none in particular: policies of paths pick theirs out of the simulator's.
    """

    rider: Rider | None = None
    name = DEFAULT
    preview: Preview | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Choose the rider of a vehicle, and prepare it; see `Rider`."""
        chosen = default_name(vehicle)
        if self.rider is None or self.name != chosen:
            self.rider, self.name = make_rider(chosen), chosen
        self.rider.begin(vehicle, course, period, preview)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the command of the chosen policy."""
        return None if self.rider is None else self.rider.command(snapshot)


class SoloRider:
    """A rider that sees no others; implements `Rider`.

    Attributes:
        rider: that rides.
        name: its name, with SOLO in front.
        preview: that it needs.
    """

    def __init__(self, rider: Rider) -> None:
        """Take a rider."""
        self.rider, self.preview, self.name = rider, rider.preview, f"{SOLO}{rider.name}"

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare it; see `Rider`."""
        self.rider.begin(vehicle, course, period, preview)
        self.name = f"{SOLO}{self.rider.name}"  # that of the default rider is known only now

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return its command; see `Rider`."""
        return self.rider.command(replace(snapshot, opponents=None))


def learned_rider(bundle: Bundle) -> LearnedRider:
    """Return the rider of a policy of paths or of races."""
    if not bundle.layout.races:
        return LearnedRider(bundle)
    # Late: it takes tyres and lap plans, which the node of a bicycle is spared.
    from bike_policy.riders.racing import RacingRider

    return RacingRider(bundle)
