"""The mean wind, inferred from how much the air holds a known machine back.

Mass times acceleration, the forces of the tyres and the grade of the road leave the drag. On straights of several
directions it shows both parts of the wind, and how far the mass is off. A rider who knows the wind leans into it before
it has pushed the machine aside, and plans for what it takes: a tailwind lengthens braking, and a crosswind pushes out
of bends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.contract.observation import VehicleRows
from bike_policy.planning.reference import KEPT, LineTable, LineTables, Plans, plan_at
from bike_sim.course.course import Course
from bike_sim.schema import LOOK, SIGNALS, STATE
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

CALM: Final = 1.0
"""Wind that counts as none, m/s: the filter errs by about as much."""
MOST: Final = 16.0
"""Largest wind that is believed, m/s."""
FIRST: Final = (4.0, 4.0, 0.03)
"""Standard deviations at the beginning: of both parts of the wind, m/s, and of the mass, as a part of it."""
WANDERING: Final = 0.01
"""Standard deviation by which each part of the wind changes in a control period, m/s."""
ERRORS: Final = (0.05, 0.02, 0.02)
"""Standard deviation of the drag by the mass, m/s^2, and parts of the acceleration along and across that add to it."""
ERROR_TIME: Final = 1.0
"""Time for which these errors last, s."""
LARGEST_ROLL: Final = 0.5
"""rad; tyres that turn a machine hold it back as well."""
LEAST_SPEED: Final = 15.0
"""m/s."""
LOST: Final = 0.006
"""Grip that plans keep in reserve for each m/s of wind beyond `CALM`."""

_SPEED, _PROGRESS, _ROLL, _YAW = (*map(LOOK.index, ("speed", "progress")), *map(STATE.index, ("roll", "yaw")))
_LONG, _REAR, _FRONT = map(SIGNALS.index, ("acceleration_long", "rear_force_long", "front_force_long"))


class WindObserver:
    """The wind that machines side by side ride in, by an extended Kalman filter of the drag.

    Attributes:
        push: lateral acceleration by the wind, as the lean that holds against it shows it, m/s^2 to the left, shape
            (n,).
        lost: grip that plans keep in reserve for the wind, shape (n,).
    """

    def __init__(self, vehicle: Superbike, period: float, count: int = 1) -> None:
        """Prepare for a number of machines.

        Args:
            vehicle: the machine as its rider knows it.
            period: control period, s.
            count: number of machines.
        """
        air, drag = vehicle.air, 0.5 * vehicle.air.density * vehicle.air.drag_area / vehicle.mass
        self._facts = drag, vehicle.mass, vehicle.g, drag * air.height / vehicle.com_height, period
        self._lines = LineTables(count, (0.0,))
        self._line = lru_cache(maxsize=KEPT)(lambda line: LineTable(float(line.s[1]), line.grade[:, None]))
        self.push, self.lost = np.zeros(count), np.zeros(count)
        self._found = np.zeros((count, 3))
        self._covariance = np.tile(np.diag(np.square(FIRST)), (count, 1, 1))
        self._seen = np.full((count, 2), np.nan)

    def begin(self, row: int, line: Course) -> None:
        """Begin a ride of a closed line, knowing nothing of the wind."""
        self._lines.begin(row, self._line(line))
        self.push[row] = self.lost[row] = 0.0
        self._found[row], self._covariance[row], self._seen[row] = 0.0, np.diag(np.square(FIRST)), np.nan

    def update(self, rows: VehicleRows) -> None:
        """Take in a control instant as it is measured; the same rows again change nothing."""
        _update(
            rows.state, rows.look, rows.signals, self._lines.plans, self._found, self._covariance, self._seen,
            self.push, self.lost, self._facts,
        )  # fmt: skip

    def state_dict(self) -> dict[str, FloatArray]:
        """Return all of it, as arrays."""
        return {name: getattr(self, name).copy() for name in _STORED}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Continue from what :meth:`state_dict` returned, after each row has begun again."""
        for name in _STORED:
            getattr(self, name)[...] = stored[name]


_STORED: Final = ("push", "lost", "_found", "_covariance", "_seen")


@njit(cache=True)
def _update(
    state: FloatArray, look: FloatArray, signals: FloatArray, grades: Plans, found: FloatArray,
    covariances: FloatArray, seen: FloatArray, push: FloatArray, lost: FloatArray,
    facts: tuple[float, float, float, float, float],
) -> None:  # fmt: skip
    """Update what is known of each ride.

    Args:
        state: minimal states.
        look: looks.
        signals: telemetry; without tyre forces nothing is learned.
        grades: of their lines.
        found: wind in the map (m/s) and error of the mass, as a part of it.
        covariances: of their errors.
        seen: speed and roll of the instant before.
        push: see `WindObserver`.
        lost: see there.
        facts: drag by mass and squared speed (1/m), mass (kg), gravity (m/s^2), the first one by the lever with which
            air leans a machine, and the control period (s).
    """
    drag, mass, gravity, leaning, period = facts
    slope, gain = np.empty(3), np.empty(3)
    for row in range(len(state)):
        speed, roll, yaw = look[row, _SPEED], state[row, _ROLL], state[row, _YAW]
        if not math.isfinite(speed + roll + yaw) or (seen[row, 0] == speed and seen[row, 1] == roll):
            continue
        seen[row, 0], seen[row, 1] = speed, roll
        wind, covariance, cos, sin = found[row], covariances[row], math.cos(yaw), math.sin(yaw)
        along, acceleration = wind[0] * cos + wind[1] * sin, signals[row, _LONG]
        held = acceleration - (signals[row, _REAR] + signals[row, _FRONT]) / mass + drag * speed * speed
        held += gravity * plan_at(grades, row, 0, look[row, _PROGRESS])
        missed = held - (drag * (2.0 * speed - along) * along - wind[2] * acceleration)
        if speed > LEAST_SPEED and abs(roll) < LARGEST_ROLL and math.isfinite(missed):
            slope[:] = 2.0 * drag * (speed - along) * cos, 2.0 * drag * (speed - along) * sin, -acceleration
            error = ERRORS[0] + ERRORS[1] * abs(acceleration) + ERRORS[2] * gravity * abs(math.tan(roll))
            spread = error * error * ERROR_TIME / period
            for i in range(3):
                covariance[i, i] += WANDERING**2 if i < 2 else 0.0
            for i in range(3):
                gain[i] = covariance[i, 0] * slope[0] + covariance[i, 1] * slope[1] + covariance[i, 2] * slope[2]
                spread += slope[i] * gain[i]
            for i in range(3):
                wind[i] += gain[i] / spread * missed
                for j in range(3):
                    covariance[i, j] -= gain[i] * gain[j] / spread
        size = math.hypot(wind[0], wind[1])
        more = max(min(size, MOST) - CALM, 0.0)
        push[row] = leaning * speed * more / max(size, CALM) * (wind[1] * cos - wind[0] * sin)
        lost[row] = LOST * more
