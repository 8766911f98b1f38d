"""The Magic Formula for motorcycle tyres: slip and camber in one sine, combined slip, aligning and twisting moments.

Pacejka, H. B. (2012). Tire and Vehicle Dynamics, 3rd ed., chapter 11, and

    Sharp, R. S., Evangelou, S., Limebeer, D. J. N. (2004). Advances in the modelling of motorcycle dynamics.
    Multibody System Dynamics 12, 251-283,

whose coefficients keep their names here. Overturning follows from the contact, which moves round the crown
(`bike_sim.physics.superbike.contact`), so there is no moment about x.

The formulas are in the axes of their authors (x forward, y to the right, z down), where side slip and camber to the
right both push to the right. `forces` speaks the project's: y to the left, z up, camber positive to the right.

The published fit of combined slip has an offset (rBy3) that treats left and right differently; here it counts from
either side alike, so that a mirrored ride is the same ride.
"""

from __future__ import annotations

import math

from numba import njit

from bike_sim.vehicles.superbike import Record


@njit(cache=True)
def _bent(stiffness: float, curvature: float, slip: float) -> float:
    """Return the argument of the arc tangent: ``B x - E (B x - atan(B x))`` with E at most 1."""
    x = stiffness * slip
    return x - min(curvature, 1.0) * (x - math.atan(x))


@njit(cache=True)
def cornering_stiffness(load: float, camber: float, t: Record) -> float:
    """Return the cornering stiffness, N/rad, at a load (N) and camber (rad)."""
    bend = (t.pKy3 + t.pKy4 * camber * camber) * t.Fz0
    return t.pKy1 * t.Fz0 * math.sin(t.pKy2 * math.atan(load / bend)) / (1.0 + t.pKy5 * camber * camber)


@njit(cache=True)
def camber_stiffness(load: float, t: Record) -> float:
    """Return the camber stiffness, N/rad, at a load, N."""
    return (t.pKy6 + t.pKy7 * (load - t.Fz0) / t.Fz0) * load


@njit(cache=True)
def slip_stiffness(load: float, t: Record) -> float:
    """Return the longitudinal slip stiffness, N, at a load, N."""
    d = (load - t.Fz0) / t.Fz0
    return load * (t.pKx1 + t.pKx2 * d) * math.exp(t.pKx3 * d)


@njit(cache=True)
def _side_force(slip: float, camber: float, load: float, peak: float, stiffness: float, t: Record) -> float:
    """Return the side force of pure slip and camber, N, positive to the right."""
    curvature = t.pEy1 + t.pEy2 * camber * camber + t.pEy4 * camber * math.copysign(1.0, slip)
    by_slip = t.pCy1 * math.atan(_bent(stiffness / (t.pCy1 * peak), curvature, slip))
    by_camber = t.pCy2 * math.atan(_bent(camber_stiffness(load, t) / (t.pCy2 * peak), t.pEy5, camber))
    return peak * math.sin(by_slip + by_camber)


@njit(cache=True)
def forces(
    slip: float, drift: float, camber: float, load: float, grip: float, t: Record
) -> tuple[float, float, float, float]:
    """Return ``(Fx, Fy, Mz, s)``: forces in N, aligning moment in N m about the vertical, and the normalised slip.

    Args:
        slip: longitudinal slip kappa, positive driving.
        drift: tangent of the side slip, positive moving to the left.
        camber: rad, positive leaning right.
        load: Fz, N; none or less gives no force.
        grip: factor on friction, 1 on the track.
        t: a record of `vehicles.superbike.MAGIC_FORMULA`.
    """
    if load <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    a, g, d = drift, camber, (load - t.Fz0) / t.Fz0
    peak_x = (t.pDx1 + t.pDx2 * d) * load * grip
    peak_y = load * t.pDy1 * math.exp(t.pDy2 * d) / (1.0 + t.pDy3 * g * g) * grip
    stiff_x, stiff_y, stiff_0 = (
        slip_stiffness(load, t),
        cornering_stiffness(load, g, t),
        cornering_stiffness(load, 0.0, t),
    )

    curvature = (t.pEx1 + (t.pEx2 + t.pEx3 * d) * d) * (1.0 - t.pEx4 * math.copysign(1.0, slip))
    pure_x = peak_x * math.sin(t.pCx1 * math.atan(_bent(stiff_x / (t.pCx1 * peak_x), curvature, slip)))
    pure_y = _side_force(a, g, load, peak_y, stiff_y, t)
    # combined slip takes from each what the other uses; the fits would turn negative beyond 23 deg
    share_x = max(math.cos(t.rCx1 * math.atan(t.rBx1 * math.cos(math.atan(t.rBx2 * slip)) * a)), 0.0)
    share_y = max(math.cos(t.rCy1 * math.atan(t.rBy1 * math.cos(math.atan(t.rBy2 * (abs(a) - t.rBy3))) * slip)), 0.0)

    moment = _moment(slip, a, g, load, (peak_y, stiff_x, stiff_y, stiff_0), share_y, t)
    use = math.hypot(stiff_x * slip / peak_x, (stiff_0 * a + camber_stiffness(load, t) * g) / peak_y)
    return share_x * pure_x, -share_y * pure_y, -moment, use


@njit(cache=True)
def _moment(
    slip: float, a: float, g: float, load: float, of: tuple[float, float, float, float], share: float, t: Record
) -> float:
    """Return the aligning moment in the authors' axes, N m: the side force's at the trail, and the camber's twist.

    Args:
        slip: longitudinal slip.
        a: tangent of the side slip.
        g: camber, rad.
        load: N.
        of: largest side force, N; stiffness of longitudinal slip, of side slip, and that upright, N/rad.
        share: of the side force that longitudinal slip leaves.
        t: a record of `vehicles.superbike.MAGIC_FORMULA`.
    """
    peak_y, stiff_x, stiff_y, stiff_0 = of
    d, cos = (load - t.Fz0) / t.Fz0, 1.0 / math.sqrt(1.0 + a * a)
    # longitudinal slip shifts the pressure as side slip does
    along = stiff_x * slip / stiff_0
    bend = (t.qBz1 + t.qBz2 * d) * (1.0 + t.qBz5 * abs(g) + t.qBz6 * g * g)
    trail = load * t.rc / t.Fz0 * (t.qDz1 + t.qDz2 * d) * (1.0 + t.qDz3 * abs(g) + t.qDz4 * g * g)
    curvature = (t.qEz1 + (t.qEz2 + t.qEz3 * d) * d) * (1.0 + t.qEz5 * g * 2.0 / math.pi * math.atan(bend * t.qCz1 * a))
    equal = math.copysign(math.hypot(a, along), a)
    trail *= math.cos(t.qCz1 * math.atan(_bent(bend, curvature, equal))) * cos
    upright = _side_force(a, 0.0, load, peak_y, stiff_0, t) * share
    shifted = a + (t.qHz3 + t.qHz4 * d) * g
    residual = load * t.rc * ((t.qDz8 + t.qDz9 * d) + (t.qDz10 + t.qDz11 * d) * abs(g)) * g * cos
    reach = (t.qBz9 + t.qBz10 * stiff_y / peak_y) * math.hypot(shifted, along)
    return -trail * upright + residual / math.sqrt(1.0 + reach * reach)


@njit(cache=True)
def relaxation_length(load: float, speed: float, t: Record) -> float:
    """Return the relaxation length of side slip, m: the upright cornering stiffness by a polynomial of the speed, m/s.

    Beyond the loads of the fit the stiffness would vanish, and with it the length: a tenth of that at Fz0 stays.
    """
    stiffness = max(cornering_stiffness(load, 0.0, t), 0.1 * cornering_stiffness(t.Fz0, 0.0, t))
    return stiffness * (t.c0 + (t.c1 + t.c2 * speed) * speed)
