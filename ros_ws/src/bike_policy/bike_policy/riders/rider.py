"""Riders, which answer snapshots with commands in process and in the policy node, and their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import DEFAULT_POLICY, DEFAULT_RACER, Bundle, load_bundle
from bike_policy.contract.observation import Rows, rows_of
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike


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


class GripEstimate(NamedTuple):
    """Grip of the road that a rider infers, as factors on the friction of the known tyres.

    Attributes:
        grip: here.
        expected: that is planned for, here and shortly ahead.
        deviation: standard deviation of the error of `grip`.
    """

    grip: float
    expected: float
    deviation: float


def grip_of(rider: Rider) -> GripEstimate | None:
    """Return the grip that a rider infers, also one that is observed or disturbed; None where it infers none."""
    memory = getattr(_innermost(rider), "grip_memory", None)
    if memory is None:
        return None
    return GripEstimate(float(memory.grip[0]), float(memory.expected[0]), float(memory.variance[0]) ** 0.5)


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
    if not seen and not isinstance(rider, SoloRider) and not getattr(_innermost(rider), "races", False):
        raise ValueError(blind_words(rider.name))


def blind_words(name: str) -> str:
    """Return what is said of a rider that cannot see others."""
    return f"policy {name!r} cannot see others, as a race asks for; {SOLO}{name} rides it as if it were alone"


def bundle_of(rider: Rider) -> Bundle | None:
    """Return the policy of a learned rider, also of one that is observed or disturbed; None where it is not learned."""
    return getattr(_innermost(rider), "bundle", None)


def infers_grip(rider: Rider) -> bool:
    """Whether a rider may infer the grip of the road, before it rides."""
    return hasattr(_innermost(rider), "grip_memory")


def _innermost(rider: Any) -> Any:
    """Return the rider that answers, without what observes or disturbs it."""
    while hasattr(rider, "rider"):
        rider = rider.rider
    return rider


class DefaultRider:
    """Rides each vehicle with the rider of `default_name`; implements `bike_policy.riders.rider.Rider`.

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
    """A rider that sees no others; implements `bike_policy.riders.rider.Rider`.

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


class LearnedRider:
    """A policy of paths as a rider, deciding at each snapshot; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        bundle: the policy.
        name: its name.
        preview: that it sees.
        seen: observation of the last decision, shape (layout size,); None before the first.
    """

    preview: Preview | None
    seen: NDArray[np.float32] | None = None

    def __init__(self, bundle: Bundle) -> None:
        """Take a policy, and act once on a made-up observation: the first action of a process takes longest."""
        layout = bundle.layout
        self.bundle, self.name = bundle, bundle.name
        self.preview = Preview(layout.preview_by_time, layout.preview_interval, layout.preview_count)
        self._picked: slice | np.ndarray = slice(None)
        self._max_steer = 1.0
        blank = Rows.of_path(np.zeros((1, 10)), np.zeros((1, 12)), np.zeros((1, layout.preview_count)))
        bundle.actor.act(layout.observe(blank)[0])

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Check that vehicle, control period and preview are those of the policy; see `Rider`."""
        self.bundle.check_fit(vehicle.name, period)
        self._max_steer = vehicle.max_steer
        picked = self.bundle.layout.pick_preview(preview.by_time, preview.interval, preview.count)
        self._picked = slice(None) if len(picked) == preview.count else picked

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the actor's command; None where the observation is not finite."""
        rows, bundle = rows_of(snapshot), self.bundle
        seen = bundle.layout.observe(rows._replace(preview_y=rows.preview_y[:, self._picked]))[0]
        if not np.isfinite(seen).all():
            return None
        self.seen = seen
        return bundle.action.to_command(bundle.actor.act(seen).tolist(), self._max_steer, snapshot.speed)


def learned_rider(bundle: Bundle) -> LearnedRider:
    """Return the rider of a policy of paths or of races."""
    if not bundle.layout.races:
        return LearnedRider(bundle)
    # Late: it takes tyres and lap plans, which the node of a bicycle is spared.
    from bike_policy.riders.racing import RacingRider

    return RacingRider(bundle)
