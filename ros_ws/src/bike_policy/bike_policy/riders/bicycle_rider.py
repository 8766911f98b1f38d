"""What riders that know their bicycle share: the machine, the line, and what was computed for one machine."""

from __future__ import annotations

from typing import Any

from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike


class BicycleRider:
    """Part of `bike_policy.riders.rider.Rider`: begins rides on bicycles, and keeps tables as long as they hold."""

    name: str
    preview: Preview | None = None

    def __init__(self, *tables: dict[int, Any]) -> None:
        """Take the tables by speed that hold for one bicycle and one control period; a ride on another empties them."""
        self._tables = tables
        self._machine: tuple[Vehicle, float] | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Take bicycle and line; see `Rider`.

        Raises:
            ValueError: a superbike, whose command is a lean and not a steering angle.
        """
        if isinstance(vehicle, Superbike):
            raise ValueError(f"rider {self.name!r} steers bicycles by set point, and {vehicle.name!r} is a superbike")
        if self._machine != (vehicle, period):
            for table in self._tables:
                table.clear()
        self._machine = (vehicle, period)
        self._vehicle, self._course, self._period = vehicle, course, period
