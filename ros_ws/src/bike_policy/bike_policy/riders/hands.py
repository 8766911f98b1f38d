"""A rider whose wishes come from outside: a person at keys, screen or gamepad leans, the loop below balances.

A person cannot balance a bicycle by its steering angle at twenty commands a second through a screen. So the wish is a
lean: it becomes the curvature of the steady turn, and the balance loop of the Stanley rider leans the bicycle there,
counter-steering on the way. Without balance the wish is the set point of the steering angle itself. A superbike has a
virtual rider that balances; its wish goes through as it is.
"""

from __future__ import annotations

import math
from typing import Final

from bike_policy.riders.stanley import StanleyRider
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.schema import GRAVITY
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

HANDS: Final = "hands"
"""Name of this rider in recordings."""


SHARE: Final = 0.55
"""Curvature of a whole wish, by that of the sharpest turn of the loop."""
RATE: Final = 0.7
"""Largest change of the curvature by that of the sharpest turn, 1/s. With both, a whole wish to one side after the
other, at any pace, throws nobody off from 2.5 to 6 m/s; without them it does at once, since the loop is linear."""


class ManualRider(StanleyRider):
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
        self._leant: float | None = None
        self._most = RATE * period
        if not self._direct:
            super().begin(vehicle, course, period, preview)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the answer."""
        if self._direct or not self.balances:
            return self.steering, self.throttle
        sharpest = self._loop_at(snapshot.speed).sharpest
        if self._leant is None:  # takes over a lean as it is
            now = -math.tan(float(snapshot.state[st.ROLL])) * GRAVITY / max(snapshot.speed, 1.0) ** 2
            self._leant = min(max(now / sharpest, -SHARE), SHARE)
        self._leant += min(max(SHARE * self.steering - self._leant, -self._most), self._most)
        return super().command(snapshot)

    def wanted(self, snapshot: Snapshot) -> float:
        """Return the curvature that is ridden towards the wish, 1/m."""
        return (self._leant or 0.0) * self._loop_at(snapshot.speed).sharpest
