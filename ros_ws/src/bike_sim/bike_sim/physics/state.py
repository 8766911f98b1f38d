"""The minimal state of a single-track vehicle: one flat vector, whose places `bike_sim.schema.STATE` names.

The vector is Eq. (1) of Weyrer et al. (2026) in this project's signs, which follow
REP-103: x forward, y left, z up. Roll is positive when the vehicle leans to the right,
yaw and steer are positive to the left, and a wheel's angle grows when it rolls forward.

A plain ``float64`` vector is what numba, Bullet, the ROS messages and the recordings all
carry without conversion, which is why it is not a class.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.schema import STATE

X: Final = STATE.index("x")
Y: Final = STATE.index("y")
YAW: Final = STATE.index("yaw")
ROLL: Final = STATE.index("roll")
STEER: Final = STATE.index("steer")
REAR_WHEEL: Final = STATE.index("rear_wheel_angle")
FRONT_WHEEL: Final = STATE.index("front_wheel_angle")
ROLL_RATE: Final = STATE.index("roll_rate")
STEER_RATE: Final = STATE.index("steer_rate")
FRONT_WHEEL_RATE: Final = STATE.index("front_wheel_rate")

STATE_SIZE: Final = len(STATE)
STATE_NAMES: Final = STATE.columns
FIELDS: Final = STATE.names
MIRROR_SIGNS: Final = STATE.mirror_signs

StateVector = NDArray[np.float64]


def upright_state(speed: float, front_radius: float) -> StateVector:
    """Return the reference configuration rolling straight ahead.

    Args:
        speed: forward speed, m/s.
        front_radius: radius of the front wheel, m (Eq. 11 sets the wheel rate from it).
    """
    state = np.zeros(STATE_SIZE)
    state[FRONT_WHEEL_RATE] = speed / front_radius
    return state


def checked_state(state: StateVector) -> StateVector:
    """Return the state as a float64 vector.

    Raises:
        ValueError: it is not ten finite numbers, or its roll is not below 90 deg: the angles would not say one state.
    """
    vector = np.asarray(state, dtype=np.float64)
    if vector.shape != (STATE_SIZE,):
        raise ValueError(f"a state is a vector of {STATE_SIZE} numbers, got shape {vector.shape}")
    # finite where the sum of squares is, which takes a fraction of the time, and perhaps else
    if not math.isfinite(vector.dot(vector)) and not np.isfinite(vector).all():
        name = STATE_NAMES[int(np.argmin(np.isfinite(vector)))]
        raise ValueError(f"state is not finite: {name} = {vector[STATE_NAMES.index(name)]}")
    if abs(vector[ROLL]) >= 0.5 * math.pi:
        raise ValueError(f"roll {math.degrees(vector[ROLL]):.6g} deg: a state has a roll below 90 deg to either side")
    return vector


def nearest_turn(angle: float, near: float) -> float:
    """Return the angle plus the whole number of turns that brings it closest to `near`, rad."""
    return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))
