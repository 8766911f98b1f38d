"""Motion of a tree of bodies under given forces: the articulated-body algorithm, compiled.

Featherstone, R. (2008). Rigid Body Dynamics Algorithms, Springer, chapter 7, for a free base with joints of one degree
of freedom. All is computed about the base's centre of mass in the base's principal axes, seen by an observer who moves
with that point at this instant; there the base's own inertia and that of bodies which do not turn against it are
constants, and no large speeds cancel. Spatial vectors have the angular part first.

The step is semi-implicit Euler: velocities from the accelerations, then positions from the new velocities, orientation
by the exponential map. Nothing here knows what a vehicle is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.multibody.tree import Body, Joint, outward, principal_axes
from bike_sim.physics.multibody.vectors import Vec, conjugate, rotate

Record = Any
Array = NDArray[np.float64]

_REVOLUTE = int(Joint.REVOLUTE)


def motion_record(bodies: int) -> np.dtype[np.void]:
    """Return the record of a tree's motion.

    Fields: position of the base's centre of mass (m), orientation of its principal axes (x, y, z, w), its velocity
    (m/s) and angular velocity `omega` (rad/s) in map axes, and the joints' positions (rad or m) and rates.
    """
    joints = bodies - 1
    shapes = {"position": 3, "orientation": 4, "velocity": 3, "omega": 3, "joints": joints, "rates": joints}
    return np.dtype([(name, np.float64, (size,)) for name, size in shapes.items()])


def tree_record(tree: Sequence[Body], gravity: float, size: int = 0) -> NDArray[np.void]:
    """Return what the algorithm knows of a tree, in the base's principal axes, shape (1,).

    Args:
        tree: the bodies, a free base first, whose joints follow in order.
        gravity: m/s2.
        size: number of bodies that the record has room for, at least those of the tree.

    Raises:
        ValueError: see `tree.outward`.
    """
    order = outward(tree)
    count = max(len(tree), size)
    turn, _ = principal_axes(tree[0].inertia)
    to_principal = np.array([rotate(conjugate(turn), axis) for axis in np.eye(3)]).T
    kind = np.dtype(
        [
            ("gravity", np.float64),
            ("count", np.int64),
            ("mass", np.float64, (count,)),
            ("inertia", np.float64, (count, 3, 3)),
            ("offset", np.float64, (count, 3)),
            ("arm", np.float64, (count, 3)),
            ("axis", np.float64, (count, 3)),
            ("joint", np.int64, (count,)),
            ("parent", np.int64, (count,)),
            ("order", np.int64, (count,)),
            ("turns", np.int64, (count,)),
            ("spring", np.float64, (count,)),
            ("damper", np.float64, (count,)),
        ]
    )
    record = np.zeros(1, dtype=kind)
    record["gravity"], record["count"], record["order"][0, : len(tree)] = gravity, len(tree), order
    for i, body in enumerate(tree):
        origin = tree[0].centre if body.parent <= 0 else tree[body.parent].point
        start = body.point if i else body.centre
        values = {
            "mass": body.mass,
            "inertia": to_principal @ body.inertia @ to_principal.T,
            "offset": to_principal @ (start - origin),
            "arm": to_principal @ (body.centre - start),
            "axis": to_principal @ body.axis,
            "joint": int(body.joint),
            "parent": body.parent,
            # whatever hangs on a wheel or how far it has turned, its inertia is the same
            "turns": body.joint is Joint.REVOLUTE and not body.wheel,
            "spring": body.spring,
            "damper": body.damper,
        }
        for name, value in values.items():
            record[name][0, i] = value
    record.setflags(write=False)
    return record


def workspace(bodies: int) -> NDArray[np.void]:
    """Return scratch memory for a tree with this number of bodies, shape (1,); one serves many trees in turn."""
    n = bodies
    shapes: dict[str, tuple[int, ...]] = {
        "rotation": (n, 3, 3), "point": (n, 3), "velocity": (n, 6), "bias": (n, 6), "inertia": (n, 6, 6),
        "force": (n, 6), "axis": (n, 6), "push": (n, 6), "stiff": (n,), "left": (n,), "rates": (n - 1,),
        "loads": (n - 1,),
        "linear": (3,), "angular": (3,), "spatial": (n, 6), "base": (3, 3),
    }  # fmt: skip
    return np.zeros(1, dtype=np.dtype([(name, np.float64, shape) for name, shape in shapes.items()]))


@njit(cache=True)
def base_rotation(q: Array, rotation: Array) -> None:
    """Write the rotation matrix of a quaternion (x, y, z, w): columns are the base's axes in the map."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    rotation[0, 0], rotation[0, 1] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z)
    rotation[0, 2] = 2.0 * (x * z + w * y)
    rotation[1, 0], rotation[1, 1] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z)
    rotation[1, 2] = 2.0 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True)
def _place(i: int, motion: Record, tree: Record, work: Record) -> None:
    """Find a body's joint and orientation in the base's axes, its velocity, and the bias of its joint's motion."""
    parent, axis, rotation, carried = tree.parent[i], tree.axis, work.rotation, work.rotation
    q, rate = motion.joints[i - 1], motion.rates[i - 1]
    # the joint's axis and point turn with the parent
    a0 = carried[parent, 0, 0] * axis[i, 0] + carried[parent, 0, 1] * axis[i, 1] + carried[parent, 0, 2] * axis[i, 2]
    a1 = carried[parent, 1, 0] * axis[i, 0] + carried[parent, 1, 1] * axis[i, 1] + carried[parent, 1, 2] * axis[i, 2]
    a2 = carried[parent, 2, 0] * axis[i, 0] + carried[parent, 2, 1] * axis[i, 1] + carried[parent, 2, 2] * axis[i, 2]
    for k in range(3):
        work.point[i, k] = work.point[parent, k] + (
            carried[parent, k, 0] * tree.offset[i, 0]
            + carried[parent, k, 1] * tree.offset[i, 1]
            + carried[parent, k, 2] * tree.offset[i, 2]
        )
    s = work.axis[i]
    if tree.joint[i] == _REVOLUTE:
        p0, p1, p2 = work.point[i, 0], work.point[i, 1], work.point[i, 2]
        s[0], s[1], s[2] = a0, a1, a2
        s[3], s[4], s[5] = p1 * a2 - p2 * a1, p2 * a0 - p0 * a2, p0 * a1 - p1 * a0
    else:
        s[0] = s[1] = s[2] = 0.0
        s[3], s[4], s[5] = a0, a1, a2
        for k in range(3):
            work.point[i, k] += s[3 + k] * q
    if tree.turns[i]:
        _turn(i, parent, (a0, a1, a2), q, rotation)
    else:
        for k in range(3):
            for j in range(3):
                rotation[i, k, j] = rotation[parent, k, j]
    v, u, c = work.velocity[i], work.velocity[parent], work.bias[i]
    for k in range(6):
        v[k] = u[k] + s[k] * rate
    # bias acceleration v x S rate, as the axis moves with the parent
    c[0] = (u[1] * s[2] - u[2] * s[1]) * rate
    c[1] = (u[2] * s[0] - u[0] * s[2]) * rate
    c[2] = (u[0] * s[1] - u[1] * s[0]) * rate
    c[3] = (u[1] * s[5] - u[2] * s[4] + u[4] * s[2] - u[5] * s[1]) * rate
    c[4] = (u[2] * s[3] - u[0] * s[5] + u[5] * s[0] - u[3] * s[2]) * rate
    c[5] = (u[0] * s[4] - u[1] * s[3] + u[3] * s[1] - u[4] * s[0]) * rate


@njit(cache=True)
def _turn(i: int, parent: int, axis: Vec, angle: float, rotation: Array) -> None:
    """Write a body's orientation: its parent's, turned about an axis (Rodrigues)."""
    sin, cos = math.sin(angle), math.cos(angle)
    x, y, z = axis
    for k in range(3):
        r0, r1, r2 = rotation[parent, 0, k], rotation[parent, 1, k], rotation[parent, 2, k]
        along = (1.0 - cos) * (x * r0 + y * r1 + z * r2)
        rotation[i, 0, k] = cos * r0 + sin * (y * r2 - z * r1) + along * x
        rotation[i, 1, k] = cos * r1 + sin * (z * r0 - x * r2) + along * y
        rotation[i, 2, k] = cos * r2 + sin * (x * r1 - y * r0) + along * z


@njit(cache=True)
def _inertia(i: int, tree: Record, work: Record) -> None:
    """Write a body's spatial inertia (lower triangle) and its bias force ``v x* I v`` about the base's centre."""
    rotation, own, total, v = work.rotation[i], tree.inertia[i], work.inertia[i], work.velocity[i]
    mass = tree.mass[i]
    cx = (
        work.point[i, 0]
        + rotation[0, 0] * tree.arm[i, 0]
        + rotation[0, 1] * tree.arm[i, 1]
        + rotation[0, 2] * tree.arm[i, 2]
    )
    cy = (
        work.point[i, 1]
        + rotation[1, 0] * tree.arm[i, 0]
        + rotation[1, 1] * tree.arm[i, 1]
        + rotation[1, 2] * tree.arm[i, 2]
    )
    cz = (
        work.point[i, 2]
        + rotation[2, 0] * tree.arm[i, 0]
        + rotation[2, 1] * tree.arm[i, 1]
        + rotation[2, 2] * tree.arm[i, 2]
    )
    for a in range(3):
        t0 = rotation[a, 0] * own[0, 0] + rotation[a, 1] * own[1, 0] + rotation[a, 2] * own[2, 0]
        t1 = rotation[a, 0] * own[0, 1] + rotation[a, 1] * own[1, 1] + rotation[a, 2] * own[2, 1]
        t2 = rotation[a, 0] * own[0, 2] + rotation[a, 1] * own[1, 2] + rotation[a, 2] * own[2, 2]
        for b in range(a + 1):
            total[a, b] = t0 * rotation[b, 0] + t1 * rotation[b, 1] + t2 * rotation[b, 2]
    # about the centre of mass so far: the momentum's turning rate
    w0, w1, w2 = v[0], v[1], v[2]
    u0 = v[3] + w1 * cz - w2 * cy
    u1 = v[4] + w2 * cx - w0 * cz
    u2 = v[5] + w0 * cy - w1 * cx
    h0 = total[0, 0] * w0 + total[1, 0] * w1 + total[2, 0] * w2
    h1 = total[1, 0] * w0 + total[1, 1] * w1 + total[2, 1] * w2
    h2 = total[2, 0] * w0 + total[2, 1] * w1 + total[2, 2] * w2
    f0, f1, f2 = mass * (w1 * u2 - w2 * u1), mass * (w2 * u0 - w0 * u2), mass * (w0 * u1 - w1 * u0)
    force = work.force[i]
    force[0] = w1 * h2 - w2 * h1 + cy * f2 - cz * f1
    force[1] = w2 * h0 - w0 * h2 + cz * f0 - cx * f2
    force[2] = w0 * h1 - w1 * h0 + cx * f1 - cy * f0
    force[3], force[4], force[5] = f0, f1, f2
    total[0, 0] += mass * (cy * cy + cz * cz)
    total[1, 1] += mass * (cx * cx + cz * cz)
    total[2, 2] += mass * (cx * cx + cy * cy)
    total[1, 0] -= mass * cx * cy
    total[2, 0] -= mass * cx * cz
    total[2, 1] -= mass * cy * cz
    for a in range(3):
        for b in range(3):
            total[3 + a, b] = 0.0
            total[3 + a, 3 + b] = 0.0
        total[3 + a, 3 + a] = mass
    # linear momentum of a turn: -m c x w
    total[3, 1], total[3, 2] = mass * cz, -mass * cy
    total[4, 0], total[4, 2] = -mass * cz, mass * cx
    total[5, 0], total[5, 1] = mass * cy, -mass * cx


@njit(cache=True)
def _hand_over(i: int, torque: float, parent: int, work: Record) -> None:
    """Give a body's articulated inertia and force to its parent, freed along the joint's axis."""
    s, u, total, force, c = work.axis[i], work.push[i], work.inertia[i], work.force[i], work.bias[i]
    for a in range(6):
        value = 0.0
        for b in range(a + 1):
            value += total[a, b] * s[b]
        for b in range(a + 1, 6):
            value += total[b, a] * s[b]
        u[a] = value
    stiff, left = 0.0, torque
    for a in range(6):
        stiff += s[a] * u[a]
        left -= s[a] * force[a]
    work.stiff[i], work.left[i] = stiff, left
    onto, carried = work.inertia[parent], work.force[parent]
    for a in range(6):
        share = u[a] / stiff
        for b in range(a + 1):
            total[a, b] -= share * u[b]
            onto[a, b] += total[a, b]
    for a in range(6):
        value = force[a] + u[a] * left / stiff
        for b in range(a + 1):
            value += total[a, b] * c[b]
        for b in range(a + 1, 6):
            value += total[b, a] * c[b]
        carried[a] += value


@njit(cache=True)
def _solve(total: Array, right: Array) -> None:
    """Solve a symmetric positive definite system of six by Cholesky, in place; the lower triangle counts."""
    for j in range(6):
        pivot = total[j, j]
        for k in range(j):
            pivot -= total[j, k] * total[j, k]
        pivot = math.sqrt(pivot)
        total[j, j] = pivot
        for i in range(j + 1, 6):
            value = total[i, j]
            for k in range(j):
                value -= total[i, k] * total[j, k]
            total[i, j] = value / pivot
    for i in range(6):
        value = right[i]
        for k in range(i):
            value -= total[i, k] * right[k]
        right[i] = value / total[i, i]
    for i in range(5, -1, -1):
        value = right[i]
        for k in range(i + 1, 6):
            value -= total[k, i] * right[k]
        right[i] = value / total[i, i]


@njit(cache=True)
def accelerate(motion: Record, force: Vec, torque: Vec, joints: Any, tree: Record, work: Record) -> None:
    """Write the accelerations of base and joints into ``work``: `linear`, `angular` (map axes) and `rates`.

    Args:
        motion: a record of `motion_record`.
        force: on the base, N, map axes.
        torque: on the base about its centre of mass, N m.
        joints: moments (N m) or forces (N) on the first joints, beside their springs and dampers: array or tuple.
        tree: a record of `tree_record`.
        work: a record of `workspace`.
    """
    count = tree.count
    base, w = work.base, motion.omega
    base_rotation(motion.orientation, base)
    v = work.velocity[0]
    for k in range(3):
        work.point[0, k] = 0.0
        v[k] = base[0, k] * w[0] + base[1, k] * w[1] + base[2, k] * w[2]
        v[3 + k] = 0.0
        for j in range(3):
            work.rotation[0, k, j] = 1.0 if j == k else 0.0
    _inertia(0, tree, work)
    for k in range(1, count):
        i = tree.order[k]
        _place(i, motion, tree, work)
        _inertia(i, tree, work)
    for k in range(count - 1, 0, -1):
        i = tree.order[k]
        load = joints[i - 1] if i <= len(joints) else 0.0
        if tree.spring[i] != 0.0 or tree.damper[i] != 0.0:
            load -= tree.spring[i] * motion.joints[i - 1] + tree.damper[i] * motion.rates[i - 1]
        _hand_over(i, load, tree.parent[i], work)
    a = work.spatial[0]
    for k in range(3):
        a[k] = base[0, k] * torque[0] + base[1, k] * torque[1] + base[2, k] * torque[2] - work.force[0, k]
        a[3 + k] = base[0, k] * force[0] + base[1, k] * force[1] + base[2, k] * force[2] - work.force[0, 3 + k]
    _solve(work.inertia[0], a)
    for number in range(1, count):
        i = tree.order[number]
        own, up = work.spatial[i], work.spatial[tree.parent[i]]
        rate = work.left[i]
        for k in range(6):
            own[k] = up[k] + work.bias[i, k]
            rate -= work.push[i, k] * own[k]
        rate /= work.stiff[i]
        for k in range(6):
            own[k] += work.axis[i, k] * rate
        work.rates[i - 1] = rate
    work.rates[count - 1 :] = 0.0  # room that this tree does not need
    for k in range(3):
        work.angular[k] = base[k, 0] * a[0] + base[k, 1] * a[1] + base[k, 2] * a[2]
        work.linear[k] = base[k, 0] * a[3] + base[k, 1] * a[4] + base[k, 2] * a[5]
    work.linear[2] -= tree.gravity  # all bodies fall alike


@njit(cache=True)
def integrate(motion: Record, work: Record, dt: float) -> None:
    """Advance the motion by a step with the accelerations in `work`: velocities first, then positions with them."""
    for k in range(3):
        motion.velocity[k] += dt * work.linear[k]
        motion.omega[k] += dt * work.angular[k]
        motion.position[k] += dt * motion.velocity[k]
    for k in range(motion.rates.size):
        motion.rates[k] += dt * work.rates[k]
        motion.joints[k] += dt * motion.rates[k]
    # orientation: exp(omega dt / 2) q
    wx, wy, wz = motion.omega[0], motion.omega[1], motion.omega[2]
    size = math.sqrt(wx * wx + wy * wy + wz * wz)
    half = 0.5 * size * dt
    scale = 0.5 * dt * (1.0 - half * half / 6.0) if half < 1e-3 else math.sin(half) / size
    tx, ty, tz, tw = scale * wx, scale * wy, scale * wz, math.cos(half)
    x, y, z, w = motion.orientation[0], motion.orientation[1], motion.orientation[2], motion.orientation[3]
    nx = tw * x + tx * w + ty * z - tz * y
    ny = tw * y - tx * z + ty * w + tz * x
    nz = tw * z + tx * y - ty * x + tz * w
    nw = tw * w - tx * x - ty * y - tz * z
    unit = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz + nw * nw)
    motion.orientation[0], motion.orientation[1] = nx * unit, ny * unit
    motion.orientation[2], motion.orientation[3] = nz * unit, nw * unit
