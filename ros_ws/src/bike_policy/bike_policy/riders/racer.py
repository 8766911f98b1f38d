"""A racing policy on machines side by side: what it sees, what it decides, and what that commands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.race import ObservationBuilder, RaceLayout
from bike_policy.contract.rows import RowBlocks
from bike_policy.riders.race_guide import Planner, RaceGuide, commands_of
from bike_policy.riders.race_reference import References
from bike_policy.riders.vehicle_descriptor import vehicle_descriptor
from bike_sim.course.course import Course
from bike_sim.physics.superbike_forces import TELEMETRY_NAMES
from bike_sim.vehicles.bicycle import Vehicle


class Racer:
    """A racing policy that rides machines side by side.

    Attributes:
        layout: of its observations.
    """

    def __init__(
        self,
        bundle: Bundle,
        vehicle: Vehicle,
        period: float,
        count: int,
        plan: Planner | None = None,
        references: References | None = None,
    ) -> None:
        """Prepare for a number of machines.

        Args:
            bundle: the policy.
            vehicle: the machine.
            period: control period, s.
            count: number of machines.
            plan: plans the guide's laps; None for its own.
            references: of the machine, if there are any already.

        Raises:
            ValueError: a policy that does not race, or a vehicle that is no superbike.
        """
        layout = bundle.layout
        if not isinstance(layout, RaceLayout):
            raise ValueError(f"policy {bundle.name!r} follows paths; it cannot race")
        self.layout = layout
        self._actor, self._action, self._max_steer = bundle.actor, bundle.action, vehicle.max_steer
        self._references = References(vehicle) if references is None else references
        self._guide = RaceGuide(vehicle, period, count, plan) if bundle.action.guided else None
        self._eyes = ObservationBuilder(layout, count, TELEMETRY_NAMES, self._guide, vehicle_descriptor(vehicle))

    def prepare(self, line: Course) -> None:
        """Plan a lap, before the first ride that needs it.

        Raises:
            ValueError: the line is open.
        """
        self._references.of(line)
        if self._guide is not None:
            self._guide.begin(0, line)

    def begin(self, row: int, blocks: RowBlocks, line: Course) -> None:
        """Begin the ride of one machine, after its reset.

        Raises:
            ValueError: the line is open.
        """
        if self._guide is not None:
            self._guide.begin(row, line)
        self._eyes.begin(row, blocks, self._references.of(line))

    def observe(self, blocks: RowBlocks) -> NDArray[np.float32]:
        """Return the observations, shape (n, layout size)."""
        return self._eyes.observe(blocks)

    def decide(self, blocks: RowBlocks, seen: NDArray[np.float32]) -> None:
        """Decide anew for all machines.

        Args:
            blocks: of the machines.
            seen: the observations of them.
        """
        self._eyes.act(blocks, self._actor.act_batch(seen))

    def commands(self, blocks: RowBlocks) -> NDArray[np.float64]:
        """Return what the last decisions become in a control period: steering and throttle in [-1, 1], shape (n, 2)."""
        return commands_of(self._action, self._guide, self._eyes, blocks, self._max_steer)
