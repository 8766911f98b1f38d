"""Disturbances between a bicycle and its rider: sensors that err, and delays on the way in and out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.rider import Rider
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.disturbances import CHANNELS, Disturbances
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

_SENSORS: Final = 1
"""Branch of the draws."""


class DisturbedRider:
    """A rider that sees late and with errors, and whose commands act late; implements `bike_policy.riders.rider.Rider`.

    Until the first command has arrived, the set point is straight ahead.

    Attributes:
        rider: the one that is disturbed.
    """

    def __init__(self, rider: Rider, disturbances: Disturbances) -> None:
        """Take a rider and what disturbs it."""
        self.rider, self._disturbances = rider, disturbances
        self._noise = np.array([disturbances.noise.get(name, 0.0) for name in CHANNELS])
        self._bias = np.array([disturbances.bias.get(name, 0.0) for name in CHANNELS])
        self.name, self.preview = rider.name, rider.preview

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Prepare the rider; see `Rider`.

        Raises:
            ValueError: a delay that is not a whole number of control periods, or errors of sensors on a superbike.
        """
        check_sensors(self._disturbances, vehicle)
        self.rider.begin(vehicle, course, period, preview)
        known = self._disturbances
        self._seen_late = known.periods(known.observation_delay_s, period)
        self._acts_late = known.periods(known.command_delay_s, period)
        self._seen: deque[Snapshot] = deque()
        self._sent: deque[tuple[int, tuple[float, float]]] = deque([(-self._acts_late, (0.0, 0.0))])
        self._draws: np.random.Generator | None = None
        self._answered: tuple[int, tuple[float, float] | None] | None = None

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the command that acts now; the same again for a snapshot that is shown again.

        Delays count control periods, not snapshots, so that one that was missed shifts nothing.
        """
        if self._answered is not None and self._answered[0] == snapshot.step:
            return self._answered[1]
        self._seen.append(measured(snapshot, self._errors(snapshot)))
        while len(self._seen) > 1 and self._seen[1].step <= snapshot.step - self._seen_late:
            self._seen.popleft()
        answer = self.rider.command(self._seen[0])
        if answer is not None:
            self._sent.append((snapshot.step, answer))
        while len(self._sent) > 1 and self._sent[1][0] <= snapshot.step - self._acts_late:
            self._sent.popleft()
        acting = None if answer is None else self._sent[0][1]
        self._answered = snapshot.step, acting
        return acting

    def _errors(self, snapshot: Snapshot) -> FloatArray:
        """Return the errors of the sensors at a snapshot; those of steps that were missed are drawn and passed over."""
        if self._draws is None:
            self._draws = self._disturbances.generator(snapshot.state, _SENSORS)
            self._drawn = snapshot.step - 1
        drawn = self._draws.standard_normal((max(snapshot.step - self._drawn, 1), len(CHANNELS)))
        self._drawn = snapshot.step
        errors: FloatArray = self._bias + self._noise * drawn[-1]
        return errors


def check_sensors(disturbances: Disturbances, vehicle: Vehicle) -> None:
    """Refuse errors of sensors on a superbike: `measured` does not know what its riders see.

    Raises:
        ValueError: naming the disturbances.
    """
    if isinstance(vehicle, Superbike) and disturbances.acts_on_sensors:
        raise ValueError(f"disturbances {disturbances.name!r} have errors of sensors, which are a bicycle's")


def measured(snapshot: Snapshot, errors: FloatArray) -> Snapshot:
    """Return a snapshot as sensors with errors show it; position, preview and front contact move with the rear contact.

    Args:
        snapshot: what is.
        errors: of CHANNELS.
    """
    roll, steer, roll_rate, steer_rate, lateral, heading, speed = errors
    state, look = snapshot.state.copy(), snapshot.look.copy()
    along = float(state[st.YAW] - look[lk.HEADING_ERROR])
    # The points of the path ahead lie as a bicycle sees them that is displaced and turned by the errors.
    turn, base = np.array([math.cos(heading), math.sin(heading)]), float(look[lk.HEADING_ERROR])
    x = snapshot.preview_x - lateral * math.sin(base)
    y = snapshot.preview_y - lateral * math.cos(base)
    ahead = math.hypot(look[lk.FRONT_X] - state[st.X], look[lk.FRONT_Y] - state[st.Y])
    state[[st.X, st.Y]] += lateral * np.array([-math.sin(along), math.cos(along)])
    state[[st.YAW, st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE]] += (heading, roll, steer, roll_rate, steer_rate)
    state[st.FRONT_WHEEL_RATE] *= 1.0 + speed / max(float(look[lk.SPEED]), 1e-6)
    look[[lk.LATERAL_ERROR, lk.HEADING_ERROR, lk.SPEED]] += (lateral, heading, speed)
    look[lk.FRONT_LATERAL_ERROR] += lateral + ahead * math.sin(heading)
    return replace(
        snapshot,
        state=state,
        look=look,
        preview_x=turn[0] * x + turn[1] * y,
        preview_y=turn[0] * y - turn[1] * x,
    )
