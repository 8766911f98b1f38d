"""A tree of rigid bodies as data: bodies and the joints between them, in one list that every multibody engine reads.

The list is in a reference configuration, in map axes. The first body is free, every other one hangs on a joint at
another. A further joint (a fork leg, a swingarm, a twist of the frame) is a further entry, with its spring and
damper.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from bike_sim.physics.multibody.vectors import Vector, axis_angle


class Joint(IntEnum):
    """Kind of joint between a body and its parent."""

    FREE = 0
    REVOLUTE = 1
    PRISMATIC = 2


@dataclass(frozen=True, slots=True)
class Body:
    """A rigid body and the joint on which it hangs, in the reference configuration.

    Attributes:
        name: what it is.
        mass: kg.
        centre: of mass, m, shape (3,).
        inertia: tensor about the centre of mass in map axes, kg m2, shape (3, 3).
        joint: how it hangs.
        parent: index of the body that carries it; -1 for the free one.
        point: on the joint's axis, m, shape (3,).
        axis: of the joint, unit vector, shape (3,).
        wheel: whether it is a wheel, which is symmetric about the joint's axis and carries nothing.
        spring: stiffness that pulls the joint back to the reference configuration, N/m or N m/rad.
        damper: damping of the joint, N s/m or N m s/rad.
    """

    name: str
    mass: float
    centre: Vector
    inertia: Vector
    joint: Joint
    parent: int
    point: Vector
    axis: Vector
    wheel: bool = False
    spring: float = 0.0
    damper: float = 0.0


def outward(tree: Sequence[Body]) -> list[int]:
    """Return the numbers of the bodies, each before what it carries and that before its next neighbour, as Bullet does.

    Raises:
        ValueError: the first body is not free, or another one is, or hangs on no body or on itself.
    """
    order: list[int] = []
    waiting = [0]
    while waiting:
        number = waiting.pop()
        order.append(number)
        waiting += [i for i in range(len(tree) - 1, 0, -1) if tree[i].parent == number and i not in order]
    loose = [i for i, body in enumerate(tree) if (body.joint is Joint.FREE) != (i == 0) or i not in order]
    if loose or tree[0].parent != -1:
        body = tree[loose[0] if loose else 0]
        raise ValueError(f"body '{body.name}' must hang by a joint on another body, the first on none")
    return order


def principal_axes(tensor: Vector) -> tuple[Vector, Vector]:
    """Return the turn about y (quaternion) from the body's to its principal axes, and the three moments there.

    Args:
        tensor: inertia of a body symmetric about its xz plane, kg m2, shape (3, 3).
    """
    xx, xz, zz = tensor[0, 0], tensor[0, 2], tensor[2, 2]
    angle = -0.5 * math.atan2(2.0 * xz, xx - zz)
    mean, radius = 0.5 * (xx + zz), math.hypot(0.5 * (xx - zz), xz)
    return axis_angle(np.array([0.0, 1.0, 0.0]), angle), np.array([mean + radius, tensor[1, 1], mean - radius])
