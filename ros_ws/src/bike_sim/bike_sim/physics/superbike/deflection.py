"""A machine turned by a wall that it grazes: position, orientation and velocities at once, in any engine's motion."""

from __future__ import annotations

import math

from numba import njit

from bike_sim.physics.tree import FRONT_WHEEL, REAR_WHEEL
from bike_sim.vehicles.superbike import Record


@njit(cache=True)
def deflect(motions: Record, x: float, y: float, turn: float, share: float, dx: float, dy: float) -> None:
    """Turn a machine about the vertical through a point, slow it down and move it aside.

    Velocities turn with the machine and are scaled, and the wheels' spin with them, so that neither slip nor side slip
    of the tyres changes. Lean and joints stay.

    Args:
        motions: a record of `articulated.motion_record`, shape (1,), changed.
        x: of the point, m.
        y: the same, m.
        turn: rad, positive to the left.
        share: what is left of the velocity.
        dx: of the move, m.
        dy: the same, m.
    """
    motion = motions[0]
    c, s = math.cos(turn), math.sin(turn)
    p, q, v, w = motion.position, motion.orientation, motion.velocity, motion.omega
    p[0], p[1] = x + dx + c * (p[0] - x) - s * (p[1] - y), y + dy + s * (p[0] - x) + c * (p[1] - y)
    v[0], v[1] = share * (c * v[0] - s * v[1]), share * (s * v[0] + c * v[1])
    w[0], w[1] = c * w[0] - s * w[1], s * w[0] + c * w[1]
    half_c, half_s = math.cos(0.5 * turn), math.sin(0.5 * turn)
    qx, qy, qz, qw = q[0], q[1], q[2], q[3]
    q[0], q[1] = half_c * qx - half_s * qy, half_c * qy + half_s * qx
    q[2], q[3] = half_c * qz + half_s * qw, half_c * qw - half_s * qz
    motion.rates[REAR_WHEEL] *= share
    motion.rates[FRONT_WHEEL] *= share
