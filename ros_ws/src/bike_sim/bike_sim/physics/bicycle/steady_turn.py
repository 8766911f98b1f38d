"""Steady turns of the nonlinear bicycle: the lean, steer and set value that a curvature needs at a speed.

All rates but those of the wheels and of yaw vanish, so that a turn is a root of three equations: no roll acceleration,
no steer acceleration, and the speed asked for. The unknowns are roll, set value and front wheel rate; steer is given.
Source: Basu-Mandal, Chatterjee and Papadopoulos (2007), Proc. R. Soc. A 463, Sect. 5, here with the steering drive.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import derivative
from bike_sim.physics.kinematics import rates
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

LARGEST_LEAN: Final = math.radians(60.0)
"""Lean up to which turns are looked for, rad."""
TURNS: Final = 24
"""Turns of a family, the straight ride included."""
LARGEST_STEER: Final = math.radians(40.0)
"""Steer of the sharpest turn of a family whose lean stays small, rad."""

_NEWTON: Final = 12
_STEP: Final = 1e-6
_CLOSE: Final = 1e-8


class SteadyTurns(NamedTuple):
    """Turns to the left at one speed, from the straight ride to the sharpest; arrays of equal length.

    Attributes:
        curvature: of the rear contact's path, 1/m.
        roll: rad, negative: the bicycle leans into the turn.
        steer: rad.
        steer_set: set value of the steering drive, rad.
    """

    curvature: FloatArray
    roll: FloatArray
    steer: FloatArray
    steer_set: FloatArray


def steady_turns(vehicle: Vehicle, speed: float) -> SteadyTurns:
    """Return the family of steady turns at a speed, evenly spaced in steer.

    It ends at LARGEST_LEAN, at LARGEST_STEER, or where a sharper turn does not lean further.

    Args:
        vehicle: bicycle with its steering drive.
        speed: of the rear contact, m/s.
    """
    # Half as much again as a point mass needs for that lean: a leaning bicycle turns with its wheels further in.
    sharpest = 1.5 * math.atan(vehicle.g * math.tan(LARGEST_LEAN) * vehicle.w / speed**2) * math.cos(LARGEST_LEAN)
    steers = np.linspace(0.0, min(sharpest, LARGEST_STEER), TURNS)
    found = [(0.0, 0.0, 0.0, 0.0)]
    root = before = np.array([0.0, 0.0, speed / vehicle.rF])
    for steer in steers[1:]:
        solved = _solve(vehicle, speed, float(steer), 2.0 * root - before)
        if solved is None or not -LARGEST_LEAN <= solved[0][0] < root[0]:
            break
        before, (root, curvature) = root, solved
        found.append((curvature, float(root[0]), float(steer), float(root[1])))
    return SteadyTurns(*np.array(found).T)


def _solve(vehicle: Vehicle, speed: float, steer: float, root: FloatArray) -> tuple[FloatArray, float] | None:
    """Return (roll, set value, front wheel rate) and curvature of one turn, or None where Newton's method fails."""

    def residual(unknown: FloatArray) -> tuple[FloatArray, float]:
        state = np.zeros(st.STATE_SIZE)
        state[st.ROLL], state[st.STEER], state[st.FRONT_WHEEL_RATE] = unknown[0], steer, unknown[2]
        change = derivative(state, float(unknown[1]), vehicle.parameters)
        yaw_rate, rolled, _ = rates(state, vehicle.parameters)
        error = np.array([change[st.ROLL_RATE], change[st.STEER_RATE], rolled - speed])
        return error, yaw_rate / rolled

    for _ in range(_NEWTON):
        error, curvature = residual(root)
        if not np.isfinite(error).all():
            return None
        if np.abs(error).max() < _CLOSE:
            return root, curvature
        slopes = np.array([(residual(root + _STEP * axis)[0] - error) / _STEP for axis in np.eye(3)]).T
        root = root - np.linalg.solve(slopes, error)
    return None
