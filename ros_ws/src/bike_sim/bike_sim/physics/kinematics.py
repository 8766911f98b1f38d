"""Kinematics of a bicycle with knife-edge wheels: what follows from the minimal state alone.

All functions are compiled (numba, nopython), take and return plain floats, and work in the project's signs:
x forward, y left, z up; roll positive leaning right, yaw and steer positive to the left, pitch positive nose
down. ``p`` is `bike_sim.vehicles.bicycle.Vehicle.parameters`; ``state`` is the vector of
`bike_sim.physics.state`. Angles in rad, lengths in m, rates in rad/s.

The ground constraint is appendix C of Weyrer et al. (2026), after Basu-Mandal, Chatterjee and Papadopoulos
(2007), and the motion of the front contact is appendix A there. The velocities here are exact: they solve the
rolling constraints of both wheels, whereas Eq. (A.9) of that paper holds for constant roll and steer only.

Vectors are written in the frame that sits at the rear contact P and turns with yaw only. With the pitch
``theta`` and the steering axis tilt ``lam``, everything depends on ``beta = theta - lam``: the rear body's axes
turned so that z lies along the steering axis.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.state import FRONT_WHEEL_RATE, ROLL, ROLL_RATE, STEER, STEER_RATE, YAW, StateVector, X, Y
from bike_sim.vehicles.bicycle import PARAMETER_NAMES

Parameters = NDArray[np.float64]

_W: Final = PARAMETER_NAMES.index("w")
_C: Final = PARAMETER_NAMES.index("c")
_LAM: Final = PARAMETER_NAMES.index("lam")
_RR: Final = PARAMETER_NAMES.index("rR")
_RF: Final = PARAMETER_NAMES.index("rF")

_MAX_ITERATIONS: Final = 60
_MAX_STEP: Final = 0.3  # rad; keeps Newton on the branch with the front wheel ahead when the bicycle lies low
_TOLERANCE: Final = 1e-14


@njit(cache=True)
def steering_geometry(p: Parameters) -> tuple[float, float, float, float, float]:
    """Return the lengths of the ground constraint and the tilt: ``(d1, fx, fz, rR, rF)``.

    ``d1`` is the distance of the rear hub from the steering axis; its foot S on that axis is the head point.
    ``(fx, 0, fz)`` points from S to the front hub along the fork's axes (z along the steering axis).
    """
    cos_tilt, sin_tilt = math.cos(p[_LAM]), math.sin(p[_LAM])
    rear_radius, front_radius = p[_RR], p[_RF]
    d1 = (p[_W] + p[_C]) * cos_tilt - rear_radius * sin_tilt
    fx = front_radius * sin_tilt - p[_C] * cos_tilt
    fz = (front_radius - rear_radius) * cos_tilt - p[_W] * sin_tilt
    return d1, fx, fz, rear_radius, front_radius


@njit(cache=True)
def _contact(
    roll: float, beta: float, steer: float, geometry: tuple[float, float, float, float, float]
) -> tuple[float, float, float, float, float]:
    """Return ``(qx, qy, qz, nx, ny)``: the lowest point Q of the front wheel and the horizontal part of its axle."""
    d1, fx, fz, rear_radius, front_radius = geometry
    sr, cr = math.sin(roll), math.cos(roll)
    sb, cb = math.sin(beta), math.cos(beta)
    ss, cs = math.sin(steer), math.cos(steer)
    nx = -cb * ss
    ny = cr * cs - sr * sb * ss
    nz = sr * cs + cr * sb * ss
    # sqrt(1 - nz^2), in a form that does not cancel when the wheel lies almost flat
    k = math.hypot(nx, ny)
    down = front_radius * nz / k
    along = d1 + fx * cs  # along the rear body's x axis, fx * ss along its y axis, fz along the steering axis
    qx = along * cb + fz * sb + down * nx
    qy = -rear_radius * sr + along * sr * sb + fx * ss * cr - fz * sr * cb + down * ny
    qz = rear_radius * cr - along * cr * sb + fx * ss * sr + fz * cr * cb - front_radius * k
    return qx, qy, qz, nx, ny


@njit(cache=True)
def solve_beta(roll: float, beta: float, steer: float, geometry: tuple[float, float, float, float, float]) -> float:
    """Return the ``beta`` at which the front wheel touches the ground, by Newton's method from a first guess.

    The height of Q has the derivative ``-cos(roll) qx`` by ``beta`` (the velocity of Q for a unit pitch rate).
    Returns nan when no solution is found.
    """
    for _ in range(_MAX_ITERATIONS):
        qx, _qy, qz, _nx, _ny = _contact(roll, beta, steer, geometry)
        step = qz / (math.cos(roll) * qx)
        if abs(step) <= _TOLERANCE:
            return beta + step
        beta += min(max(step, -_MAX_STEP), _MAX_STEP)
    return math.nan


@njit(cache=True)
def pitch(roll: float, steer: float, p: Parameters) -> float:
    """Return the pitch of the rear body, 0 in the upright reference configuration (Eq. C.7).

    It is found wherever it exists with the front contact ahead of the rear one, and nan elsewhere: the benchmark
    bicycle stands on both wheels at every steer within 75 deg up to a roll of 75 deg, and at 80 deg of roll only
    with at most 45 deg of steer into the lean or 35 deg out of it.
    """
    return solve_beta(roll, -p[_LAM], steer, steering_geometry(p)) + p[_LAM]


@njit(cache=True)
def velocities(
    roll: float,
    beta: float,
    steer: float,
    roll_rate: float,
    steer_rate: float,
    front_wheel_rate: float,
    geometry: tuple[float, float, float, float, float],
) -> tuple[float, float, float]:
    """Return ``(yaw_rate, rear_speed, pitch_rate)`` of the rolling bicycle.

    The material point of the front wheel at Q is at rest. Its velocity is a sum over the rates, each turning
    about an axis through a known point: yaw about P, roll about the x axis through P, pitch about the rear axle,
    steer about the steering axis, and the wheel's own rotation that moves Q against its heading e. The three
    components of that sum give the three dependent rates one after the other.
    """
    d1, _fx, _fz, rear_radius, front_radius = geometry
    qx, qy, _qz, nx, ny = _contact(roll, beta, steer, geometry)
    sr, cr = math.sin(roll), math.cos(roll)
    sb, cb = math.sin(beta), math.cos(beta)
    k = math.hypot(nx, ny)
    # from the head point S to Q, and the steering axis z_H
    bx = qx - d1 * cb
    by = qy + (rear_radius - d1 * sb) * sr
    bz = -(rear_radius - d1 * sb) * cr
    zx, zy, zz = sb, -sr * cb, cr * cb
    steer_x, steer_y, steer_z = zy * bz - zz * by, zz * bx - zx * bz, zx * by - zy * bx
    contact_speed = front_radius * front_wheel_rate
    pitch_rate = (roll_rate * qy + steer_rate * steer_z) / (cr * qx)
    yaw_rate = (-contact_speed * nx / k - steer_rate * steer_y) / qx - pitch_rate * sr
    rear_speed = contact_speed * ny / k + yaw_rate * qy + pitch_rate * (rear_radius + sr * qy) - steer_rate * steer_x
    return yaw_rate, rear_speed, pitch_rate


@njit(cache=True)
def rates(state: StateVector, p: Parameters) -> tuple[float, float, float]:
    """Return ``(yaw_rate, rear_speed, pitch_rate)`` of a minimal state; cheaper than one after the other."""
    geometry = steering_geometry(p)
    beta = solve_beta(state[ROLL], -p[_LAM], state[STEER], geometry)
    return velocities(
        state[ROLL], beta, state[STEER], state[ROLL_RATE], state[STEER_RATE], state[FRONT_WHEEL_RATE], geometry
    )


@njit(cache=True)
def yaw_rate(state: StateVector, p: Parameters) -> float:
    """Return the yaw rate, rad/s (Eq. A.9, here exact also while roll and steer change)."""
    return rates(state, p)[0]


@njit(cache=True)
def rear_speed(state: StateVector, p: Parameters) -> float:
    """Return the speed of the rear contact point along the rear wheel's heading, m/s (Eq. A.25)."""
    return rates(state, p)[1]


@njit(cache=True)
def pitch_rate(state: StateVector, p: Parameters) -> float:
    """Return the pitch rate, rad/s: the time derivative of the ground constraint (end of appendix C)."""
    return rates(state, p)[2]


@njit(cache=True)
def rear_wheel_rate(state: StateVector, p: Parameters) -> float:
    """Return the rotation rate of the rear wheel relative to the rear body, rad/s.

    The wheel rolls ``rear_speed`` by its total rotation about the axle, of which the body's pitch rate is a part.
    """
    _yaw_rate, speed, body_rate = rates(state, p)
    return speed / p[_RR] - body_rate


@njit(cache=True)
def front_contact_offset(roll: float, steer: float, p: Parameters) -> tuple[float, float]:
    """Return the front contact Q relative to the rear contact P, in the yaw frame, m (Eq. C.5)."""
    geometry = steering_geometry(p)
    beta = solve_beta(roll, -p[_LAM], steer, geometry)
    qx, qy, _qz, _nx, _ny = _contact(roll, beta, steer, geometry)
    return qx, qy


@njit(cache=True)
def front_contact(state: StateVector, p: Parameters) -> tuple[float, float]:
    """Return x and y of the front contact point Q in the map frame, m."""
    qx, qy = front_contact_offset(state[ROLL], state[STEER], p)
    cos_yaw, sin_yaw = math.cos(state[YAW]), math.sin(state[YAW])
    return state[X] + cos_yaw * qx - sin_yaw * qy, state[Y] + sin_yaw * qx + cos_yaw * qy


@njit(cache=True)
def front_direction(roll: float, steer: float, p: Parameters) -> float:
    """Return the heading of the front contact relative to the rear frame's yaw: mu_1 of Eq. (A.10), rad."""
    geometry = steering_geometry(p)
    beta = solve_beta(roll, -p[_LAM], steer, geometry)
    _qx, _qy, _qz, nx, ny = _contact(roll, beta, steer, geometry)
    return math.atan2(-nx, ny)
