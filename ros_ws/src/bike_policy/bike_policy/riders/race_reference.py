"""The reference that riders of circuits are shown: a lap planned as the classical rider plans his."""

from __future__ import annotations

import math
from typing import Final

from bike_policy.contract.reference import Reference
from bike_policy.riders.lap_plan import RiderSettings, plan_lap, smooth_around
from bike_policy.riders.planned_lines import PlannedLines
from bike_sim.course.course import Course
from bike_sim.planning.lap_limit import LapLimit
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

REFERENCE: Final = RiderSettings(
    lateral=0.87,
    brake=0.92,
    drive_exponent=1.9,
    brake_exponent=1.9,
    lean_rate=0.9,
    smoothing=6.0,
    largest_lean=math.radians(58.0),
)
"""How the reference is planned: fixed, so that what a policy sees does not change when the classical rider is tuned."""


class References:
    """References of one machine."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Prepare to plan.

        Raises:
            ValueError: a vehicle that is no superbike.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"a race needs a superbike with tyres to plan a lap, and {vehicle.name!r} is none")
        self._planned = PlannedLines(lambda line: reference_of(plan_lap(vehicle, line, REFERENCE)))

    def of(self, line: Course) -> Reference:
        """Return the reference of a closed line.

        Raises:
            ValueError: the line is open.
        """
        return self._planned.of(line)


def reference_of(profile: LapLimit) -> Reference:
    """Return the reference of a planned lap."""
    spacing = float(profile.s[1])
    return Reference(
        spacing, smooth_around(profile.lateral / profile.speed**2, spacing, REFERENCE.smoothing), profile.speed
    )
