"""The minimal state of a single-track vehicle: one flat vector, whose places `bike_sim.schema.STATE` names.

The vector is Eq. (1) of Weyrer et al. (2026) in this project's signs, which follow
REP-103: x forward, y left, z up. Roll is positive when the vehicle leans to the right,
yaw and steer are positive to the left, and a wheel's angle grows when it rolls forward.

A plain ``float64`` vector is what numba, Bullet, the ROS messages and the recordings all
carry without conversion, which is why it is not a class.
"""

from __future__ import annotations

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
