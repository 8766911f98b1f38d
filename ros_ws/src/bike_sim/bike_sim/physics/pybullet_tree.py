"""The tree of bodies every vehicle is in Bullet: rear frame, fork and two wheels on three hinges, maybe a rider.

Importing this module is also the quiet way to import PyBullet.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

import numpy as np

from bike_sim.physics import mapping
from bike_sim.vehicles.bicycle import Vehicle


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Silence the C level of standard error: Bullet greets with its build time at import."""
    try:
        saved = os.dup(2)
    except OSError:  # no standard error at all, as under some service managers
        yield
        return
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


with _quiet_stderr():
    import pybullet as bullet

__all__ = [
    "AXLE_TO_Z",
    "FORK",
    "FRONT_WHEEL",
    "LINKS",
    "REAR_WHEEL",
    "SLIDER",
    "Slider",
    "build_tree",
    "bullet",
    "principal_axes",
    "set_free",
]

REAR_WHEEL: Final = 0
FORK: Final = 1
FRONT_WHEEL: Final = 2
SLIDER: Final = 3
"""Link numbers; the rear frame is the base of the tree, and a sliding rider comes last."""
LINKS: Final = (REAR_WHEEL, FORK, FRONT_WHEEL)
AXLE_TO_Z: Final = mapping.axis_angle(np.array([1.0, 0.0, 0.0]), -0.5 * math.pi)
"""From a wheel's own axes, axle along y, to those of its Bullet link, axle along z: a cylinder that needs no turning
inside its link is the cheapest shape."""


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


def build_tree(client: int, vehicle: Vehicle, wheels: list[int], slider: Slider | None = None) -> int:
    """Build a vehicle at rest in its upright reference configuration and return Bullet's number of it.

    Each link's frame sits in its hinge; a wheel's z axis is its axle.

    Args:
        client: the Bullet world.
        vehicle: masses, inertias and geometry; its rear body is the base.
        wheels: collision shapes of the rear and the front wheel, -1 for none.
        slider: a rider besides, on a slide along y.
    """
    nowhere = (0.0, 0.0, 0.0)
    reference = mapping.layout(vehicle)
    rear, frame, fork, front = reference.centres
    tensors = mapping.inertia_tensors(vehicle)
    frame_axes, frame_moments = principal_axes(tensors[mapping.REAR_FRAME])
    fork_axes, fork_moments = principal_axes(tensors[mapping.FORK])
    straight = (0.0, 0.0, 0.0, 1.0)
    masses = [vehicle.mR, vehicle.mH, vehicle.mF]
    shapes = [wheels[0], -1, wheels[1]]
    positions = [rear - frame, reference.head - frame, front - reference.head]
    orientations = [AXLE_TO_Z, straight, AXLE_TO_Z]
    inertial_positions = [nowhere, fork - reference.head, nowhere]
    inertial_orientations = [straight, fork_axes, straight]
    parents, axes = [0, 0, FORK + 1], [(0.0, 0.0, 1.0), reference.steering_axis, (0.0, 0.0, 1.0)]
    types = [bullet.JOINT_REVOLUTE] * 3
    moments = {
        -1: frame_moments,
        REAR_WHEEL: (vehicle.IRxx, vehicle.IRxx, vehicle.IRyy),
        FORK: fork_moments,
        FRONT_WHEEL: (vehicle.IFxx, vehicle.IFxx, vehicle.IFyy),
    }
    if slider is not None:
        masses.append(slider.mass)
        shapes.append(-1)
        positions.append(np.array(slider.centre) - frame)
        orientations.append(straight)
        inertial_positions.append(nowhere)
        inertial_orientations.append(straight)
        parents.append(0)
        axes.append((0.0, 1.0, 0.0))
        types.append(bullet.JOINT_PRISMATIC)
        moments[SLIDER] = slider.moments
    body: int = bullet.createMultiBody(
        baseMass=vehicle.mB,
        basePosition=frame,
        baseInertialFrameOrientation=frame_axes,
        linkMasses=masses,
        linkCollisionShapeIndices=shapes,
        linkVisualShapeIndices=[-1] * len(masses),
        linkPositions=positions,
        linkOrientations=orientations,
        linkInertialFramePositions=inertial_positions,
        linkInertialFrameOrientations=inertial_orientations,
        linkParentIndices=parents,
        linkJointTypes=types,
        linkJointAxis=axes,
        physicsClientId=client,
    )
    for link, diagonal in moments.items():  # what createMultiBody guesses from the shapes is not the vehicle's
        bullet.changeDynamics(body, link, localInertiaDiagonal=diagonal, physicsClientId=client)
    return body


def set_free(client: int, body: int, friction: float = 0.0) -> None:
    """Switch off all losses but those of the vehicle's own, Bullet's motors and its sleep.

    Args:
        client: the Bullet world.
        body: Bullet's number of the vehicle.
        friction: lateral friction coefficient of all links.
    """
    links = range(bullet.getNumJoints(body, physicsClientId=client))
    for link in (-1, *links):
        # No loss but the drive's; and Bullet's default limit of 100 rad/s on joints is 35 m/s on the road.
        bullet.changeDynamics(
            body,
            link,
            lateralFriction=friction,
            rollingFriction=0.0,
            spinningFriction=0.0,
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            maxJointVelocity=1e6,
            activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
    for link in links:  # every new joint comes with a motor that brakes it
        bullet.setJointMotorControl2(body, link, bullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client)


def principal_axes(tensor: mapping.Vector) -> tuple[mapping.Vector, mapping.Vector]:
    """Return the turn about y (quaternion) from the body's to its principal axes, and the three moments there.

    Args:
        tensor: inertia of a body symmetric about its xz plane, kg m2, shape (3, 3).
    """
    xx, xz, zz = tensor[0, 0], tensor[0, 2], tensor[2, 2]
    angle = -0.5 * math.atan2(2.0 * xz, xx - zz)
    mean, radius = 0.5 * (xx + zz), math.hypot(0.5 * (xx - zz), xz)
    return mapping.axis_angle(np.array([0.0, 1.0, 0.0]), angle), np.array([mean + radius, tensor[1, 1], mean - radius])
