"""Riders of a race: the classical rider among others, the lone one that ignores them, and policies that see them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle, load_bundle
from bike_policy.contract.observation import Rows, VehicleRows
from bike_policy.planning.grip import AdaptiveLaw
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, LinePlan, Planner, plan_line
from bike_policy.planning.plan_verification import BatchRider
from bike_policy.planning.racecraft import Racecraft
from bike_policy.riders.racing import PolicyBatch
from bike_policy.riders.rider import RIDERS, SOLO, blind_words
from bike_sim.course.course import Course
from bike_sim.sim.race import Race, RaceEvent
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

MachinePlanner = Callable[[Superbike, Course], LinePlan]
"""Plans a lap of a closed line for a machine."""
CLASSICAL: Final = "classical"
UNVERIFIED: Final = 0.97
"""Part of a plan's speed that is ridden where plans of many circuits are not verified."""


def unverified_plan(vehicle: Superbike, line: Course) -> LinePlan:
    """Return a plan that is a little slower than the classical rider's, and has not been ridden."""
    plan = plan_line(vehicle, line, CLASSICAL_SETTINGS)
    return plan_line(vehicle, line, CLASSICAL_SETTINGS, UNVERIFIED * plan.profile.speed[:-1])


class RacecraftRider:
    """The classical law among others; implements `bike_policy.planning.plan_verification.BatchRider`.

    Attributes:
        shares: part of its speed that each rides, shape (n,).
    """

    def __init__(self, vehicle: Superbike, period: float, count: int, plan: Planner | None = None) -> None:
        """Prepare for a number of machines.

        Args:
            vehicle: the machine.
            period: control period, s.
            count: number of machines.
            plan: plans a lap of a line; None for a verified plan.
        """
        self._rider, self._period = AdaptiveLaw(vehicle, period, CLASSICAL_SETTINGS, count, plan), period
        self._craft = Racecraft(self._rider.law, count)
        self.shares = np.ones(count)

    def begin(self, row: int, rows: VehicleRows, line: Course) -> None:
        """Begin a ride where the machine is beside its line, after its reset."""
        self._rider.begin(row, rows, line)
        self._craft.begin(row, rows)

    def commands(self, rows: VehicleRows, step: int) -> FloatArray:
        """Return steering and throttle in [-1, 1], shape (n, 2)."""
        targets = self._craft.targets(rows, self._period)
        slower = self.shares != 1.0
        targets[slower, 1] = self.shares[slower] * (1.0 + targets[slower, 1]) - 1.0
        return self._rider.commands(rows, step, targets)


class RaceField:
    """All riders of a race; machines of the same kind and rider are ridden side by side."""

    def __init__(
        self,
        riders: Sequence[str | Bundle],
        vehicles: Sequence[Vehicle],
        period: float,
        plan: MachinePlanner | None = None,
    ) -> None:
        """Prepare the riders of each row.

        Args:
            riders: ``classical``, a policy or its name or folder; with SOLO in front as if it were alone. An empty
                name is a row that somebody else rides.
            vehicles: of the rows.
            period: control period, s.
            plan: plans the laps of riders that see others, and of lone classical ones; None for verified plans.

        Raises:
            ValueError: a rider that does not race, or a policy that cannot see others and is not to ride solo.
            FileNotFoundError: an unknown policy.
        """
        self.count = len(vehicles)
        parts: dict[tuple[int | str, str], list[int]] = {}
        known: dict[int | str, str | Bundle] = {}
        for row, (rider, vehicle) in enumerate(zip(riders, vehicles, strict=True)):
            if rider != "":
                key = rider if isinstance(rider, str) else id(rider)
                known[key] = rider
                parts.setdefault((key, vehicle.name), []).append(row)
        self._parts = [
            (np.array(rows), _rider(known[key], vehicles[rows[0]], period, len(rows), plan))
            for (key, _), rows in parts.items()
        ]

    @classmethod
    def of(
        cls, race: Race, plan: MachinePlanner | None = None, report: Callable[[str], None] = lambda step: None
    ) -> RaceField:
        """Prepare the riders of a race's entries, and begin their rides from its grid.

        Args:
            race: that has begun.
            plan: plans laps, as at the beginning of this class.
            report: told whose plan is made.

        Raises:
            ValueError, FileNotFoundError: as at the beginning of this class.
        """
        entries, batch = race.settings.entries, race.batch
        field = cls([entry.rider for entry in entries], batch.vehicles, batch.config.control_period, plan)
        for row, entry in enumerate(entries):
            report(f"plan of {entry.name}")
            field.begin(row, batch, batch.course(row))
        return field

    def set_share(self, row: int, share: float) -> None:
        """Let a classical rider among others ride a part of its speed from now on."""
        for index, rider in self._parts:
            if isinstance(rider, RacecraftRider):
                rider.shares[index == row] = share

    def begin(self, row: int, rows: VehicleRows, line: Course) -> None:
        """Begin the ride of one row, after its reset; nothing for a row that somebody else rides."""
        for index, rider in self._parts:
            place = np.flatnonzero(index == row)
            if len(place):
                rider.begin(int(place[0]), _some(rows, index), line)

    def commands(self, rows: VehicleRows, step: int) -> FloatArray:
        """Return steering and throttle of all rows, shape (n, 2); zeros where somebody else rides."""
        commands = np.zeros((self.count, 2))
        for index, rider in self._parts:
            commands[index] = np.nan_to_num(rider.commands(_some(rows, index), step))
        return commands

    def ride(self, race: Race) -> Iterator[tuple[FloatArray, list[RaceEvent]]]:
        """Ride a race to its end; yield the commands of each step and what it returned."""
        while not race.over:
            commands = self.commands(race.batch, race.step_number)
            yield commands, race.step(commands)


def _some(rows: VehicleRows, index: NDArray[np.intp]) -> Rows:
    return Rows(*(getattr(rows, name)[index] for name in Rows._fields))


def _rider(
    rider: str | Bundle, vehicle: Vehicle, period: float, count: int, planner: MachinePlanner | None
) -> BatchRider:
    """Return the rider of rows with the same machine."""
    if not isinstance(vehicle, Superbike):
        raise ValueError(
            f"riders of races ride superbikes, and {vehicle.name!r} is none; hand in its commands yourself"
        )
    plan = None if planner is None else lambda line: planner(vehicle, line)
    solo = isinstance(rider, str) and rider.startswith(SOLO)
    name = rider.removeprefix(SOLO) if isinstance(rider, str) else rider
    if name == CLASSICAL:
        if solo:
            return AdaptiveLaw(vehicle, period, CLASSICAL_SETTINGS, count, plan)
        return RacecraftRider(vehicle, period, count, plan)
    if isinstance(name, str) and name in RIDERS:
        raise ValueError(
            f"rider {name!r} does not race; there are {CLASSICAL}, {SOLO}{CLASSICAL} and policies that race"
        )
    bundle = load_bundle(name, RIDERS) if isinstance(name, str) else name
    if not bundle.layout.races:
        raise ValueError(f"policy {bundle.name!r} follows paths; it cannot race")
    if not solo and not bundle.layout.sees_others:
        raise ValueError(blind_words(bundle.name))
    bundle.check_fit(vehicle.name, period)
    return PolicyBatch(bundle, vehicle, period, count, None if solo else plan)
