"""The minimal state of a single-track vehicle: one flat vector, one set of indices.

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

X: Final = 0
"""x of the rear contact point P in the map frame, m."""
Y: Final = 1
"""y of the rear contact point P in the map frame, m."""
YAW: Final = 2
"""Yaw of the rear frame, rad, positive to the left. It is not wrapped."""
ROLL: Final = 3
"""Roll of the rear frame, rad, positive leaning right."""
STEER: Final = 4
"""Steering angle about the steering axis, rad, positive to the left."""
REAR_WHEEL: Final = 5
"""Rotation angle of the rear wheel, rad, positive rolling forward."""
FRONT_WHEEL: Final = 6
"""Rotation angle of the front wheel, rad, positive rolling forward."""
ROLL_RATE: Final = 7
"""Roll rate, rad/s."""
STEER_RATE: Final = 8
"""Steering rate, rad/s."""
FRONT_WHEEL_RATE: Final = 9
"""Rotation rate of the front wheel relative to the fork, rad/s."""

STATE_SIZE: Final = 10
STATE_NAMES: Final = (
    "x_m",
    "y_m",
    "yaw_rad",
    "roll_rad",
    "steer_rad",
    "rear_wheel_rad",
    "front_wheel_rad",
    "roll_rate_rad_s",
    "steer_rate_rad_s",
    "front_wheel_rate_rad_s",
)
FIELDS: Final = (
    "x",
    "y",
    "yaw",
    "roll",
    "steer",
    "rear_wheel_angle",
    "front_wheel_angle",
    "roll_rate",
    "steer_rate",
    "front_wheel_rate",
)
"""What the coordinates are called in messages and recordings, in the same order."""

StateVector = NDArray[np.float64]

MIRROR_SIGNS: Final = np.array([1, -1, -1, -1, -1, 1, 1, -1, -1, 1], dtype=np.float64)
"""Signs that turn a state into its left/right mirror image about the map's x axis."""


def upright_state(speed: float, front_radius: float) -> StateVector:
    """Return the reference configuration rolling straight ahead.

    Args:
        speed: forward speed, m/s.
        front_radius: radius of the front wheel, m (Eq. 11 sets the wheel rate from it).
    """
    state = np.zeros(STATE_SIZE)
    state[FRONT_WHEEL_RATE] = speed / front_radius
    return state
