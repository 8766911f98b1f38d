"""The linearised bicycle about upright straight riding: from the published closed formulas, and measured on an engine.

The formulas are independent of both engines: they are what their modes are compared with. Equations (A1) to (A29) of

    Meijaard, Papadopoulos, Ruina, Schwab (2007). Linearized dynamics equations for the balance and steer of a
    bicycle: a benchmark and review. Proc. R. Soc. A 463, 1955-1982, Appendix A,

    M q'' + v C1 q' + (g K0 + v^2 K2) q = f,   q = (roll, steer), in the publication's signs (z down).

For the measurement the engine is a black box. From upright straight riding each of the four lateral states is pushed a
little to either side. Central differences of where the engine is at one time and one period later give its discrete
transition matrix, whose logarithm is a state matrix in continuous time: the modes of the engine as it integrates, its
step included.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.engine import Engine
from bike_sim.vehicles.bicycle import FourBodies, Vehicle

Matrix = NDArray[np.float64]

_IMAGINARY_FLOOR: Final = 1e-9


@dataclass(frozen=True)
class CanonicalMatrices:
    """The four 2x2 matrices of the linear equations, roll first, steer second, in the publication's signs.

    Attributes:
        M: mass matrix, kg m^2.
        C1: damping-like matrix per m/s of speed, kg m.
        K0: stiffness matrix per N/kg of gravity, kg m.
        K2: stiffness matrix per squared speed, kg.
    """

    M: Matrix
    C1: Matrix
    K0: Matrix
    K2: Matrix


@dataclass(frozen=True)
class Modes:
    """The four eigenvalues at one speed under their usual names, 1/s.

    Attributes:
        weave: the oscillating pair's member with positive imaginary part; where the pair is real (very low speed),
            the larger of the two with imaginary part zero.
        capsize: the slow real eigenvalue.
        castering: the fast real eigenvalue.
    """

    weave: complex
    capsize: float
    castering: float


def canonical_matrices(vehicle: FourBodies) -> CanonicalMatrices:
    """Return the matrices of the bicycle with the steering drive switched off."""
    v = vehicle
    sin_tilt, cos_tilt = math.sin(v.lam), math.cos(v.lam)
    # whole bicycle (A1 to A7)
    m_t = v.mR + v.mB + v.mH + v.mF
    x_t = (v.xB * v.mB + v.xH * v.mH + v.w * v.mF) / m_t
    z_t = (-v.rR * v.mR + v.zB * v.mB + v.zH * v.mH - v.rF * v.mF) / m_t
    i_txx = (
        v.IRxx + v.IBxx + v.IHxx + v.IFxx + v.mR * v.rR**2 + v.mB * v.zB**2 + v.mH * v.zH**2 + v.mF * v.rF**2
    )  # fmt: skip
    i_txz = v.IBxz + v.IHxz - v.mB * v.xB * v.zB - v.mH * v.xH * v.zH + v.mF * v.w * v.rF
    i_tzz = v.IRxx + v.IBzz + v.IHzz + v.IFxx + v.mB * v.xB**2 + v.mH * v.xH**2 + v.mF * v.w**2
    # front assembly (A8 to A13)
    m_a = v.mH + v.mF
    x_a = (v.xH * v.mH + v.w * v.mF) / m_a
    z_a = (v.zH * v.mH - v.rF * v.mF) / m_a
    i_axx = v.IHxx + v.IFxx + v.mH * (v.zH - z_a) ** 2 + v.mF * (v.rF + z_a) ** 2
    i_axz = v.IHxz - v.mH * (v.xH - x_a) * (v.zH - z_a) + v.mF * (v.w - x_a) * (v.rF + z_a)
    i_azz = v.IHzz + v.IFxx + v.mH * (v.xH - x_a) ** 2 + v.mF * (v.w - x_a) ** 2
    # front assembly about the steering axis, mechanical trail, spin momenta (A14 to A20)
    u_a = (x_a - v.w - v.c) * cos_tilt - z_a * sin_tilt
    i_all = m_a * u_a**2 + i_axx * sin_tilt**2 + 2.0 * i_axz * sin_tilt * cos_tilt + i_azz * cos_tilt**2
    i_alx = -m_a * u_a * z_a + i_axx * sin_tilt + i_axz * cos_tilt
    i_alz = m_a * u_a * x_a + i_axz * sin_tilt + i_azz * cos_tilt
    mu = v.c / v.w * cos_tilt
    s_r, s_f = (spin / radius if radius else 0.0 for spin, radius in ((v.IRyy, v.rR), (v.IFyy, v.rF)))  # or skates
    s_t = s_r + s_f
    s_a = m_a * u_a + mu * m_t * x_t
    # the matrices (A21 to A29)
    m_roll_steer = i_alx + mu * i_txz
    spin = mu * s_t + s_f * cos_tilt
    return CanonicalMatrices(
        M=np.array([[i_txx, m_roll_steer], [m_roll_steer, i_all + 2.0 * mu * i_alz + mu**2 * i_tzz]]),
        C1=np.array(
            [
                [0.0, spin + i_txz / v.w * cos_tilt - mu * m_t * z_t],
                [-spin, i_alz / v.w * cos_tilt + mu * (s_a + i_tzz / v.w * cos_tilt)],
            ]
        ),
        K0=np.array([[m_t * z_t, -s_a], [-s_a, -s_a * sin_tilt]]),
        K2=np.array([[0.0, (s_t - m_t * z_t) / v.w * cos_tilt], [0.0, (s_a + s_f * sin_tilt) / v.w * cos_tilt]]),
    )


def state_matrix(vehicle: FourBodies, speed: float) -> Matrix:
    """Return A of ``x' = A x`` with x = (roll, steer, roll rate, steer rate) in the project's signs.

    The steering drive holds a set point of zero; ``replace(vehicle, P=0.0, D=0.0)`` gives the free bicycle.

    Args:
        vehicle: the bicycle, or its four bodies, which have no drive.
        speed: forward speed, m/s.
    """
    matrices = canonical_matrices(vehicle)
    drive = (vehicle.P, vehicle.D) if isinstance(vehicle, Vehicle) else (0.0, 0.0)
    stiffness = vehicle.g * matrices.K0 + speed**2 * matrices.K2 + np.diag([0.0, drive[0]])
    damping = speed * matrices.C1 + np.diag([0.0, drive[1]])
    a = np.zeros((4, 4))
    a[:2, 2:] = np.eye(2)
    a[2:, :2] = -np.linalg.solve(matrices.M, stiffness)
    a[2:, 2:] = -np.linalg.solve(matrices.M, damping)
    signs = np.array([1.0, -1.0, 1.0, -1.0])  # published steer is positive to the right
    return signs[:, None] * a * signs[None, :]


def modes_of(matrix: Matrix) -> Modes:
    """Name the eigenvalues of a 4x4 lateral state matrix, whoever made it.

    Raises:
        ValueError: the eigenvalues are not one oscillating pair and two real ones, nor all real.
    """
    eigenvalues = np.linalg.eigvals(matrix)
    oscillating = [value for value in eigenvalues if value.imag > _IMAGINARY_FLOOR]
    real = sorted((float(value.real) for value in eigenvalues if abs(value.imag) <= _IMAGINARY_FLOOR), reverse=True)
    if len(oscillating) == 1 and len(real) == 2:
        return Modes(complex(oscillating[0]), real[0], real[1])
    if len(real) == 4:
        return Modes(complex(real[0]), real[2], real[3])
    raise ValueError(f"eigenvalues {eigenvalues.tolist()} are not those of weave, capsize and castering")


def modes(vehicle: Vehicle, speed: float) -> Modes:
    """Return the modes of the free bicycle (steering drive off) at a forward speed in m/s."""
    return modes_of(state_matrix(replace(vehicle, P=0.0, D=0.0), speed))


def capsize_speed(vehicle: Vehicle) -> float:
    """Return the speed at which the capsize mode turns unstable, m/s.

    An eigenvalue passes zero where ``det(g K0 + v^2 K2) = 0``, which is linear in v^2 as roll has no entry in K2.

    Raises:
        ValueError: this bicycle has no such speed.
    """
    matrices = canonical_matrices(vehicle)
    k0, k2 = vehicle.g * matrices.K0, matrices.K2
    slope = k0[0, 0] * k2[1, 1] - k0[1, 0] * k2[0, 1]
    squared = -float(np.linalg.det(k0)) / slope if slope else math.nan
    if not squared > 0.0:
        raise ValueError(f"vehicle '{vehicle.name}' has no capsize speed")
    return math.sqrt(squared)


def weave_speed(vehicle: Vehicle, highest: float = 30.0) -> float:
    """Return the highest speed at which the weave mode turns stable, m/s, by bisection to rounding.

    Args:
        vehicle: the bicycle.
        highest: speed up to which to look, m/s.

    Raises:
        ValueError: there is no such speed below `highest`.
    """

    def growth(speed: float) -> float:
        return modes(vehicle, speed).weave.real

    grid = np.linspace(0.0, highest, 301)
    values = [growth(speed) for speed in grid]
    crossings = [i for i in range(300) if values[i] > 0.0 >= values[i + 1]]
    if not crossings:
        raise ValueError(f"vehicle '{vehicle.name}' has no weave speed below {highest} m/s")
    low, high = float(grid[crossings[-1]]), float(grid[crossings[-1] + 1])
    while high - low > 4.0 * math.ulp(high):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if growth(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)


# Modes measured on an engine.

LATERAL: Final = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)
"""The states that roll and steer about straight riding; yaw and position follow from them."""

_SETTLE: Final = 0.05
"""Time from push to first look, s. An engine that solves contacts by velocities carries velocities that roll on the
configuration of the step before; a reset gives it those of the present one, and the first step makes up for that."""
_PERIOD: Final = 0.1
"""Time from first to second look, s: long enough to be well above rounding, and the logarithm is unique up to 31
rad/s."""
_PUSH: Final = 1e-4
"""Size of the push, rad and rad/s: the error of central differences is of its square."""


def transition_matrix(engine: Engine, speed: float) -> tuple[Matrix, float]:
    """Return the discrete transition matrix of the lateral states, and the period it holds for.

    Args:
        engine: any engine; it is left in some other state.
        speed: forward speed, m/s.

    Returns:
        The matrix in the order of `LATERAL`, shape (4, 4), and its period, s.
    """
    settle, steps = max(1, round(_SETTLE / engine.time_step)), max(1, round(_PERIOD / engine.time_step))
    looks = np.zeros((2, 4, 4))
    for column, index in enumerate(LATERAL):
        for push in (_PUSH, -_PUSH):
            state = st.upright_state(speed, engine.vehicle.rF)
            state[index] = push
            engine.reset(state)
            for look, wait in enumerate((settle, steps)):
                engine.advance(0.0, 0.0, wait)
                looks[look, :, column] += engine.state()[list(LATERAL)] / (2.0 * push)
    before, after = looks
    matrix = np.asarray(np.linalg.solve(before.T, after.T).T, dtype=np.float64)
    return matrix, steps * engine.time_step


def measured_state_matrix(engine: Engine, speed: float) -> Matrix:
    """Return the state matrix in continuous time that explains the measured transition matrix, 1/s, shape (4, 4)."""
    transition, period = transition_matrix(engine, speed)
    values, vectors = np.linalg.eig(transition)
    logarithm = vectors @ np.diag(np.log(values.astype(complex))) @ np.linalg.inv(vectors)
    return np.real(logarithm) / period


def measured_modes(engine: Engine, speed: float) -> Modes:
    """Return the engine's modes at a forward speed in m/s.

    Switch the steering drive off first, ``replace(vehicle, P=0.0, D=0.0)``, to get those of the free bicycle.

    Raises:
        ValueError: the eigenvalues are not those of a weave, a capsize and a castering mode.
    """
    return modes_of(measured_state_matrix(engine, speed))


def measured_speed(engine: Engine, mode: str, low: float, high: float, tolerance: float = 1e-5) -> float:
    """Return the speed between `low` and `high` at which a mode changes its stability, m/s, by bisection.

    Args:
        engine: with its drive off.
        mode: weave or capsize.
        low: m/s.
        high: m/s.
        tolerance: width of the last bracket, m/s.

    Raises:
        ValueError: the mode does not change its stability between the two.
    """

    def function(speed: float) -> float:
        return complex(getattr(measured_modes(engine, speed), mode)).real

    at_low, at_high = function(low), function(high)
    if at_low * at_high > 0.0:
        raise ValueError(
            f"no change of stability between {low:g} and {high:g} m/s: the mode grows with {at_low:.4g} and "
            f"{at_high:.4g} 1/s there"
        )
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        if function(middle) * at_low > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
