"""A vehicle as data: its bodies and the joints between them, in one list that every multibody engine reads.

The list is in the upright reference configuration, in map axes from the rear contact point (see `mapping.layout`). The
first body is free, every other one hangs on a joint at a body before it. A further joint (a fork leg, a swingarm, a
twist of the frame) is a further entry here; what acts on it is up to whoever computes the forces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from bike_sim.physics import mapping
from bike_sim.vehicles.bicycle import Vehicle

REAR_WHEEL: Final = 0
FORK: Final = 1
FRONT_WHEEL: Final = 2
SLIDER: Final = 3
"""Numbers of the joints: body `k + 1` of the list hangs on joint `k`; a sliding rider comes last."""
LINKS: Final = (REAR_WHEEL, FORK, FRONT_WHEEL)


class Joint(IntEnum):
    """How a body hangs on another."""

    FREE = 0
    REVOLUTE = 1
    PRISMATIC = 2


class Slider(NamedTuple):
    """A rider who slides sideways on the rear frame.

    Attributes:
        mass: kg.
        centre: of mass in the upright reference configuration, m.
        moments: of inertia about the coordinate axes, kg m2.
    """

    mass: float
    centre: tuple[float, float, float]
    moments: tuple[float, float, float]


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
    """

    name: str
    mass: float
    centre: mapping.Vector
    inertia: mapping.Vector
    joint: Joint
    parent: int
    point: mapping.Vector
    axis: mapping.Vector
    wheel: bool = False


def vehicle_tree(vehicle: Vehicle, slider: Slider | None = None) -> tuple[Body, ...]:
    """Return the bodies of a vehicle, the rear frame first, in the order of the joints' numbers.

    Args:
        vehicle: masses, inertias and geometry.
        slider: a rider besides, on a slide along y.
    """
    reference = mapping.layout(vehicle)
    centres = reference.centres
    tensors = mapping.inertia_tensors(vehicle)
    left = np.array([0.0, 1.0, 0.0])
    masses = (vehicle.mR, vehicle.mB, vehicle.mH, vehicle.mF)  # in the order of `mapping.BODY_NAMES`
    frame, head, axis = mapping.REAR_FRAME, reference.head, reference.steering_axis
    joints = (
        (frame, Joint.FREE, -1, centres[frame], left),
        (mapping.REAR_WHEEL, Joint.REVOLUTE, 0, centres[mapping.REAR_WHEEL], left),
        (mapping.FORK, Joint.REVOLUTE, 0, head, axis),
        (mapping.FRONT_WHEEL, Joint.REVOLUTE, FORK + 1, centres[mapping.FRONT_WHEEL], left),
    )
    wheels = (mapping.REAR_WHEEL, mapping.FRONT_WHEEL)
    bodies = [
        Body(mapping.BODY_NAMES[i], masses[i], centres[i], tensors[i], joint, parent, point, along, i in wheels)
        for i, joint, parent, point, along in joints
    ]
    if slider is not None:
        centre = np.array(slider.centre)
        inertia = np.diag(slider.moments)
        bodies.append(Body("rider", slider.mass, centre, inertia, Joint.PRISMATIC, 0, centre, left))
    return tuple(bodies)


def principal_axes(tensor: mapping.Vector) -> tuple[mapping.Vector, mapping.Vector]:
    """Return the turn about y (quaternion) from the body's to its principal axes, and the three moments there.

    Args:
        tensor: inertia of a body symmetric about its xz plane, kg m2, shape (3, 3).
    """
    xx, xz, zz = tensor[0, 0], tensor[0, 2], tensor[2, 2]
    angle = -0.5 * math.atan2(2.0 * xz, xx - zz)
    mean, radius = 0.5 * (xx + zz), math.hypot(0.5 * (xx - zz), xz)
    return mapping.axis_angle(np.array([0.0, 1.0, 0.0]), angle), np.array([mean + radius, tensor[1, 1], mean - radius])
