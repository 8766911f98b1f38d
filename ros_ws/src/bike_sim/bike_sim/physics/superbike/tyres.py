"""A motorcycle tyre: Magic Formula with camber thrust, combined slip, relaxation and a toroidal crown.

All functions are compiled (numba, nopython) and take one record of `TYRE` as ``t``. Signs are the project's:
x along the wheel's heading on the ground, y to the left, z up; camber and lean are positive to the right.

Steady state follows the similarity method with the Magic Formula of

    Pacejka, H. B. (2012). Tire and Vehicle Dynamics, 3rd ed., Butterworth-Heinemann, chapters 4 and 11,

reduced to what matters at large camber. Slips are normalised by friction, so that one curve serves all directions:

    s_x = C_k kappa / mu_x,   s_y = (k(Fz) alpha - d3 gamma) / mu_y,   s = |(s_x, s_y)|,
    (Fx, Fy) = Fz sin(C atan(s / C)) (mu_x s_x, mu_y s_y) / s,
    mu = mu_0 exp(-q (Fz / Fz0 - 1)) / (1 + d7 gamma^2).

The forces cannot leave the friction ellipse, and camber thrust and side slip share what there is.

Transient slip follows ``sigma ds'/dt + |u| s' = slip velocity`` (Pacejka 2012, chapter 7), integrated exactly over a
step with constant input, so that it holds at any speed, also at standstill where the tyre becomes a spring.
"""

from __future__ import annotations

import math
from typing import Final

from numba import njit

from bike_sim.physics.superbike import magic_formula
from bike_sim.vehicles.superbike import Record

_LEAST_CORNERING: Final = 0.3
"""Part of the nominal cornering coefficient that stays at any load."""
_TWIST_BEND: Final = 1.5
"""Decline of the twisting torque behind the camber: e6 of Pacejka (2012), chapter 11, 1/rad."""


@njit(cache=True)
def cornering_coefficient(load: float, t: Record) -> float:
    """Return cornering stiffness by load, 1/rad: value and slope of Pacejka's at the nominal load, linear elsewhere."""
    k = t.cornering - (t.cornering - t.cornering_slope) * (load / t.nominal_load - 1.0)
    return max(k, _LEAST_CORNERING * t.cornering)


@njit(cache=True)
def friction(camber: float, load: float, t: Record) -> float:
    """Return the largest lateral force by load at a camber (rad) and load, N."""
    mu = t.friction / (1.0 + t.camber_fade * camber * camber)
    if t.friction_slope == 0.0:
        return mu
    return mu * math.exp(-t.friction_slope * (load / t.nominal_load - 1.0))


@njit(cache=True)
def peak_slip(t: Record) -> float:
    """Return the normalised slip at which the force is largest: ``C tan(pi / 2 C)``; see `Tyre.peak`."""
    return t.peak


@njit(cache=True)
def forces(
    slip: float, tan_slip_angle: float, camber: float, load: float, grip: float, t: Record
) -> tuple[float, float, float, float]:
    """Return ``(Fx, Fy, Mz, s)``: forces in N, aligning moment in N m about the vertical, and the normalised slip.

    Args:
        slip: longitudinal slip kappa, positive driving.
        tan_slip_angle: sideways by forward velocity of the contact, positive moving to the left.
        camber: rad, positive leaning right.
        load: Fz, N; none or less gives no force.
        grip: factor on friction, 1 on the track.
        t: the tyre.
    """
    if load <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if t.magic_formula.on != 0.0:
        return magic_formula.forces(slip, tan_slip_angle, camber, load, grip, t.magic_formula)
    mu_y = friction(camber, load, t) * grip
    mu_x = mu_y * t.friction_ratio
    sx = t.slip_stiffness * slip / mu_x
    # Both the side slip and the lean push to the right, where they are positive
    side = cornering_coefficient(load, t) * tan_slip_angle
    s = math.hypot(sx, (side + t.camber * camber) / mu_y)
    scale = math.sin(t.shape * math.atan(s / t.shape)) / s if s > 1e-9 else 1.0
    adhering = max(0.0, 1.0 - s / peak_slip(t))
    # The side slip's part acts behind the middle of the contact, camber thrust in it; what camber adds is a twist.
    moment = adhering * (t.trail * scale * side - twist(camber, t))
    return mu_x * load * scale * sx, -load * scale * (side + t.camber * camber), load * moment, s


@njit(cache=True)
def twist(camber: float, t: Record) -> float:
    """Return the twisting torque of a tyre that adheres, by load, m: it turns the wheel towards its lean (rad).

    Where a leaning tyre touches the ground its tread would turn with the wheel's spin about the vertical, and the
    ground holds it (Pacejka 2012, chapter 11: ``C_Mgamma atan(e6 gamma) / e6``; Cossalter 2006, Motorcycle Dynamics,
    chapter 2).
    """
    return t.twist * math.atan(_TWIST_BEND * camber) / _TWIST_BEND


@njit(cache=True)
def relax(value: float, slip_velocity: float, speed: float, length: float, step: float) -> float:
    """Return the transient slip after a step, exactly for constant slip velocity and speed.

    Args:
        value: transient slip at the start of the step.
        slip_velocity: of the contact, m/s, in the sense of the slip; its steady state is ``slip_velocity / speed``.
        speed: rolling speed |u|, m/s, not negative.
        length: relaxation length, m.
        step: s.
    """
    x = speed * step / length
    # (1 - exp(-x)) / x, also where x vanishes
    gain = -math.expm1(-x) / x if x > 1e-8 else 1.0 - 0.5 * x
    return value * math.exp(-x) + slip_velocity * gain * step / length


@njit(cache=True)
def normal_load(height: float, height_rate: float, t: Record) -> float:
    """Return the load of a spring and damper that cannot pull, N.

    Args:
        height: of the undeformed tyre's lowest point above the ground, m; negative when pressed in.
        height_rate: m/s.
        t: the tyre.
    """
    if height >= 0.0:
        return 0.0
    return max(0.0, -t.stiffness * height - t.damping * height_rate)
