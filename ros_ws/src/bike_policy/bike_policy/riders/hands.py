"""A rider whose wishes come from outside: a person at keys, screen or gamepad leans, the loop below balances.

A person cannot balance a bicycle by its steering angle at twenty commands a second through a screen. So the wish is a
lean: it becomes the curvature of the steady turn, and the balance loop of the Stanley rider leans the bicycle there,
counter-steering on the way. Without balance the wish is the set point of the steering angle itself. A superbike has a
virtual rider that balances; its wish goes through as it is.
"""

from __future__ import annotations

from typing import Final

from bike_policy.riders.stanley import StanleyRider
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

HANDS: Final = "hands"
"""Name of this rider in recordings."""


class HandRider(StanleyRider):
    """Does what it is told; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        steering: wish in [-1, 1], positive to the left.
        throttle: wish in [-1, 1].
        balances: whether a bicycle's wish is a lean; else it is the set point of the steering angle.
    """

    name = HANDS
    steering = 0.0
    throttle = 0.0
    balances = True

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Take vehicle and line; see `Rider`."""
        self._direct = isinstance(vehicle, Superbike)
        if not self._direct:
            super().begin(vehicle, course, period, preview)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the answer."""
        if self._direct or not self.balances:
            return self.steering, self.throttle
        return super().command(snapshot)

    def wanted(self, snapshot: Snapshot) -> float:
        """Return the curvature of the wish, 1/m."""
        return self.steering * self._loop_at(snapshot.speed).sharpest
