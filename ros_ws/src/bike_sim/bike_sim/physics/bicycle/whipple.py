"""The nonlinear Whipple bicycle in minimal coordinates: an oracle for the tests and the fast engine for training.

The equations of motion are those of `bike_sim.physics.bicycle.whipple_equations`; this module integrates them with the
classical Runge-Kutta method of fourth order. Pitch is carried along as one more integrated variable and put back
onto the ground constraint after every step, so the constraint holds to rounding and each step costs four
evaluations and one Newton correction.

The model: Meijaard, Papadopoulos, Ruina, Schwab (2007), Proc. R. Soc. A 463; nonlinear benchmark figures in
Basu-Mandal, Chatterjee, Papadopoulos (2007), Proc. R. Soc. A 463, 1983-2003.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple_equations import Angles, Constants, energies, motion
from bike_sim.physics.engine import TIP_OVER, BicycleEngine
from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.kinematics import Parameters, rates, solve_beta, steering_geometry
from bike_sim.physics.state import StateVector
from bike_sim.vehicles.bicycle import PARAMETER_NAMES, Vehicle

# Places of the parameters in the vector, by name; compiled code wants plain global integers.
(
    _LAM, _G, _MR, _IRXX, _IRYY, _XB, _ZB, _MB, _IBXX, _IBXZ, _IBYY, _IBZZ,
    _W, _XH, _ZH, _MH, _IHXX, _IHXZ, _IHYY, _IHZZ, _MF, _IFXX, _IFYY, _P, _D,
) = map(
    PARAMETER_NAMES.index,
    (
        "lam", "g", "mR", "IRxx", "IRyy", "xB", "zB", "mB", "IBxx", "IBxz", "IByy", "IBzz",
        "w", "xH", "zH", "mH", "IHxx", "IHxz", "IHyy", "IHzz", "mF", "IFxx", "IFyy", "P", "D",
    ),
)  # fmt: skip

LYING_ROLL: Final = math.radians(75.0)
"""Roll beyond which the model ends: up to here the benchmark stands on both wheels at every steer within 75 deg."""

# The integrated variables: the minimal state in its own order, then beta = pitch - lam.
_BETA: Final = st.STATE_SIZE
_SIZE: Final = st.STATE_SIZE + 1
_RATES: Final = (st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE)


class RigidBody(NamedTuple):
    """A rigid body symmetric about its xz plane, in axes of which z points up.

    Attributes:
        mass: kg.
        x: of the centre of mass, m.
        z: of the centre of mass, m.
        xx: inertia about the centre of mass, kg m2.
        xz: the same.
        yy: the same.
        zz: the same.
    """

    mass: float
    x: float
    z: float
    xx: float
    xz: float
    yy: float
    zz: float


@njit(cache=True)
def _two_body_assembly(body: RigidBody, wheel: RigidBody, cos_tilt: float, sin_tilt: float) -> RigidBody:
    """Join a body and a wheel, whose axial inertia is left out, and turn the axes onto the steering axis.

    Args:
        body: in the upright rear frame.
        wheel: in the upright rear frame.
        cos_tilt: of the steering axis.
        sin_tilt: of the steering axis.
    """
    m_a, x_a, z_a, xx_a, xz_a, yy_a, zz_a = body
    m_b, x_b, z_b, xx_b, _, _, zz_b = wheel
    m = m_a + m_b
    x, z = (m_a * x_a + m_b * x_b) / m, (m_a * z_a + m_b * z_b) / m
    dx, dz = x_a - x_b, z_a - z_b
    reduced = m_a * m_b / m
    xx = xx_a + xx_b + reduced * dz * dz
    xz = xz_a - reduced * dx * dz
    yy = yy_a + reduced * (dx * dx + dz * dz)
    zz = zz_a + zz_b + reduced * dx * dx
    c2, s2, cs = cos_tilt * cos_tilt, sin_tilt * sin_tilt, cos_tilt * sin_tilt
    return RigidBody(
        m,
        x * cos_tilt + z * sin_tilt,
        z * cos_tilt - x * sin_tilt,
        c2 * xx + 2.0 * cs * xz + s2 * zz,
        cs * (zz - xx) + (c2 - s2) * xz,
        yy,
        s2 * xx - 2.0 * cs * xz + c2 * zz,
    )


@njit(cache=True)
def constants(p: Parameters) -> Constants:
    """Return what the equations of motion need from the parameters: two rigid bodies with a rotor each.

    The rear body is given from the rear hub, the front body from the head point S, the foot of the rear hub on
    the steering axis; both in axes turned by the tilt. Published values are z-down, hence the sign changes.
    """
    cos_tilt, sin_tilt = math.cos(p[_LAM]), math.sin(p[_LAM])
    d1, fx, fz, rear_radius, front_radius = steering_geometry(p)
    frame = RigidBody(p[_MB], p[_XB], -p[_ZB] - rear_radius, p[_IBXX], -p[_IBXZ], p[_IBYY], p[_IBZZ])
    wheel = RigidBody(p[_MR], 0.0, 0.0, p[_IRXX], 0.0, 0.0, p[_IRXX])
    m1, x1, z1, xx1, xz1, yy1, zz1 = _two_body_assembly(frame, wheel, cos_tilt, sin_tilt)
    fork = RigidBody(p[_MH], p[_XH], -p[_ZH] - rear_radius, p[_IHXX], -p[_IHXZ], p[_IHYY], p[_IHZZ])
    wheel = RigidBody(p[_MF], p[_W], front_radius - rear_radius, p[_IFXX], 0.0, 0.0, p[_IFXX])
    m2, x2, z2, xx2, xz2, yy2, zz2 = _two_body_assembly(fork, wheel, cos_tilt, sin_tilt)
    return (
        rear_radius, front_radius, d1, fx, fz, p[_G],
        m1, x1, z1, xx1, xz1, yy1, zz1, p[_IRYY],
        m2, x2 - d1, z2, xx2, xz2, yy2, zz2, p[_IFYY],
    )  # fmt: skip


@njit(cache=True)
def _angles(roll: float, beta: float, steer: float) -> Angles:
    """Return sines and cosines of the angles, as the equations of motion take them."""
    return math.sin(roll), math.cos(roll), math.sin(beta), math.cos(beta), math.sin(steer), math.cos(steer)


@njit(cache=True)
def _derivative(
    z: NDArray[np.float64], steer_set: float, stiffness: float, damping: float, c: Constants, out: NDArray[np.float64]
) -> None:
    """Write the time derivative of the integrated variables; the steering drive is part of it."""
    roll_rate, steer_rate, front_wheel_rate = z[st.ROLL_RATE], z[st.STEER_RATE], z[st.FRONT_WHEEL_RATE]
    torque = -stiffness * (z[st.STEER] - steer_set) - damping * steer_rate
    yaw_rate, speed, pitch_rate, roll_acc, steer_acc, wheel_acc = motion(
        _angles(z[st.ROLL], z[_BETA], z[st.STEER]), (roll_rate, steer_rate, front_wheel_rate), torque, c
    )
    out[st.X] = speed * math.cos(z[st.YAW])
    out[st.Y] = speed * math.sin(z[st.YAW])
    out[st.YAW] = yaw_rate
    out[st.ROLL] = roll_rate
    out[st.STEER] = steer_rate
    out[st.REAR_WHEEL] = speed / c[0] - pitch_rate
    out[st.FRONT_WHEEL] = front_wheel_rate
    out[st.ROLL_RATE] = roll_acc
    out[st.STEER_RATE] = steer_acc
    out[st.FRONT_WHEEL_RATE] = wheel_acc
    out[_BETA] = pitch_rate


@njit(cache=True)
def advance(state: StateVector, steer_set: float, time_step: float, steps: int, p: Parameters) -> bool:
    """Advance a minimal state in place by `steps` Runge-Kutta steps with the drive's set point held.

    Args:
        state: minimal state, overwritten.
        steer_set: set point of the steering angle, rad.
        time_step: length of a step, s.
        steps: number of steps.
        p: `Vehicle.parameters`.

    Returns:
        True, or False when the bicycle has come to lie on the ground (roll beyond `LYING_ROLL`, or no pitch with
        both wheels on the ground): the state then keeps its last value on the wheels.
    """
    c = constants(p)
    geometry = steering_geometry(p)
    stiffness, damping = p[_P], p[_D]
    work = np.empty((6, _SIZE))
    now, trial, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4], work[5]
    now[: st.STATE_SIZE] = state
    now[_BETA] = solve_beta(state[st.ROLL], -p[_LAM], state[st.STEER], geometry)
    for _ in range(steps):
        _derivative(now, steer_set, stiffness, damping, c, k1)
        for i in range(_SIZE):
            trial[i] = now[i] + 0.5 * time_step * k1[i]
        _derivative(trial, steer_set, stiffness, damping, c, k2)
        for i in range(_SIZE):
            trial[i] = now[i] + 0.5 * time_step * k2[i]
        _derivative(trial, steer_set, stiffness, damping, c, k3)
        for i in range(_SIZE):
            trial[i] = now[i] + time_step * k3[i]
        _derivative(trial, steer_set, stiffness, damping, c, k4)
        for i in range(_SIZE):
            now[i] += time_step / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        now[_BETA] = solve_beta(now[st.ROLL], now[_BETA], now[st.STEER], geometry)
        # also false for nan
        if not (abs(now[st.ROLL]) <= LYING_ROLL and math.isfinite(now[_BETA]) and math.isfinite(now[st.STEER_RATE])):
            return False
        for i in range(st.STATE_SIZE):
            state[i] = now[i]
    return True


@njit(cache=True)
def derivative(state: StateVector, steer_set: float, p: Parameters) -> NDArray[np.float64]:
    """Return the time derivative of a minimal state, shape (10,), for analysis rather than for speed."""
    z = np.empty(_SIZE)
    z[: st.STATE_SIZE] = state
    z[_BETA] = solve_beta(state[st.ROLL], -p[_LAM], state[st.STEER], steering_geometry(p))
    out = np.empty(_SIZE)
    _derivative(z, steer_set, p[_P], p[_D], constants(p), out)
    return out[: st.STATE_SIZE]


@njit(cache=True)
def energy(state: StateVector, p: Parameters) -> tuple[float, float]:
    """Return kinetic energy and potential energy above the ground, J. The drive's spring is not included."""
    beta = solve_beta(state[st.ROLL], -p[_LAM], state[st.STEER], steering_geometry(p))
    rates = state[st.ROLL_RATE], state[st.STEER_RATE], state[st.FRONT_WHEEL_RATE]
    return energies(_angles(state[st.ROLL], beta, state[st.STEER]), rates, constants(p))


def mass_matrix(state: StateVector, p: Parameters) -> NDArray[np.float64]:
    """Return the mass matrix of the rates of roll, steer and front wheel, shape (3, 3), in kg m^2.

    The kinetic energy is a quadratic form of the three, so its values at six vectors of rates give all entries.
    """

    def kinetic(rates: NDArray[np.float64]) -> float:
        trial = state.copy()
        trial[list(_RATES)] = rates
        return energy(trial, p)[0]

    axes = np.eye(3)
    single = [kinetic(axis) for axis in axes]
    mass = np.diag(2.0 * np.array(single))
    for i, j in ((0, 1), (0, 2), (1, 2)):
        mass[i, j] = mass[j, i] = kinetic(axes[i] + axes[j]) - single[i] - single[j]
    return mass


def pushed(
    state: StateVector, along: float, left: float, ahead: float, height: float, p: Parameters
) -> NDArray[np.float64]:
    """Return how fast a force on the rear frame changes the rates of roll, steer and front wheel, rad/s^2.

    Args:
        state: minimal state.
        along: component along the bicycle's yaw, N.
        left: component to the left of it, level with the ground, N.
        ahead: place of the point ahead of the rear contact, m.
        height: of the point above the rear contact in the plane of the frame, m.
        p: `Vehicle.parameters`.
    """
    power = np.empty(3)  # of the force at a unit of each rate
    for k, place in enumerate(_RATES):
        unit = state.copy()
        unit[list(_RATES)] = 0.0
        unit[place] = 1.0
        yaw_rate, speed, _ = rates(unit, p)
        sideways = -height * math.sin(state[st.ROLL])
        point_along = speed - yaw_rate * sideways
        point_left = yaw_rate * ahead - height * math.cos(state[st.ROLL]) * (place == st.ROLL_RATE)
        power[k] = along * point_along + left * point_left
    return np.asarray(np.linalg.solve(mass_matrix(state, p), power), dtype=np.float64)


class WhippleEngine(BicycleEngine):
    """The compiled bicycle behind the engine interface; once it lies on the ground, it stays there until `reset`."""

    def __init__(self, vehicle: Vehicle, time_step: float) -> None:
        """Start at rest in the upright reference configuration at the origin."""
        super().__init__(vehicle, time_step)
        self._lying = False

    @property
    def fall(self) -> str:
        """Whether it lies or its roll is beyond the vehicle's limit, as the name of a fall."""
        return TIP_OVER if self._lying else super().fall

    def reset(self, state: StateVector, ground: Ground = LEVEL) -> None:
        """Set the minimal state exactly.

        Raises:
            ValueError: the state is not ten finite numbers, or no bicycle with both wheels on the ground has it.
        """
        state = np.array(state, dtype=np.float64)
        if state.shape != (st.STATE_SIZE,) or not np.isfinite(state).all():
            raise ValueError(f"a minimal state is {st.STATE_SIZE} finite numbers, got {state.tolist()}")
        geometry = steering_geometry(self.vehicle.parameters)
        beta = solve_beta(state[st.ROLL], -self.vehicle.lam, state[st.STEER], geometry)
        if abs(state[st.ROLL]) > LYING_ROLL or not math.isfinite(beta):
            raise ValueError(
                f"roll {math.degrees(state[st.ROLL]):.6g} deg with steer {math.degrees(state[st.STEER]):.6g} deg: "
                "the bicycle cannot stand on both wheels like this"
            )
        self._state = state
        self._lying = False

    def hold(self, steer_set: float, steps: int) -> None:
        """Integrate with the steering drive's set point held; see `engine.BicycleEngine`."""
        if not self._lying:
            self._lying = not advance(self._state, steer_set, self.time_step, steps, self.vehicle.parameters)

    def push(self, along: float, left: float, ahead: float, height: float) -> None:
        """Push the rear frame as during one step: the rates take up its momentum; see `engine.BicycleEngine`."""
        if not self._lying:
            force = (along, left, ahead, height)
            self._state[list(_RATES)] += self.time_step * pushed(self._state, *force, self.vehicle.parameters)
