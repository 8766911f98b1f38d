"""A vehicle's tree of bodies in Bullet.

Importing this module is also the quiet way to import PyBullet.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

from bike_sim.physics import mapping
from bike_sim.physics.tree import Body, Joint, principal_axes


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

__all__ = ["AXLE_TO_Z", "build_tree", "bullet", "set_free"]

AXLE_TO_Z: Final = mapping.axis_angle(np.array([1.0, 0.0, 0.0]), -0.5 * math.pi)
"""From a wheel's own axes, axle along y, to those of its Bullet link, axle along z: a cylinder that needs no turning
inside its link is the cheapest shape."""
_STRAIGHT: Final = (0.0, 0.0, 0.0, 1.0)
_JOINT_TYPES: Final = {Joint.REVOLUTE: bullet.JOINT_REVOLUTE, Joint.PRISMATIC: bullet.JOINT_PRISMATIC}


def build_tree(client: int, tree: Sequence[Body], shapes: Mapping[int, int] | None = None) -> int:
    """Build a vehicle at rest in its upright reference configuration and return Bullet's number of it.

    Each link's frame sits in its joint; a wheel's z axis is its axle.

    Args:
        client: the Bullet world.
        tree: its bodies.
        shapes: collision shapes by number of the link; others have none.
    """
    base, *links = tree
    shapes = shapes or {}
    base_axes, base_moments = principal_axes(base.inertia)
    inertial = [_inertial_frame(link) for link in links]
    origins = [base.centre, *(link.point for link in links)]
    body: int = bullet.createMultiBody(
        baseMass=base.mass,
        basePosition=base.centre,
        baseInertialFrameOrientation=base_axes,
        linkMasses=[link.mass for link in links],
        linkCollisionShapeIndices=[shapes.get(number, -1) for number in range(len(links))],
        linkVisualShapeIndices=[-1] * len(links),
        linkPositions=[link.point - origins[link.parent] for link in links],
        linkOrientations=[AXLE_TO_Z if link.wheel else _STRAIGHT for link in links],
        linkInertialFramePositions=[link.centre - link.point for link in links],
        linkInertialFrameOrientations=[orientation for orientation, _ in inertial],
        linkParentIndices=[link.parent for link in links],
        linkJointTypes=[_JOINT_TYPES[link.joint] for link in links],
        linkJointAxis=[(0.0, 0.0, 1.0) if link.wheel else link.axis for link in links],
        physicsClientId=client,
    )
    # what createMultiBody guesses from the shapes is not the vehicle's
    for number, moments in enumerate((base_moments, *(moments for _, moments in inertial)), -1):
        bullet.changeDynamics(body, number, localInertiaDiagonal=moments, physicsClientId=client)
    return body


def _inertial_frame(link: Body) -> tuple[Any, Any]:
    """Return the orientation of a link's principal axes in its own and its moments about them."""
    diagonal = np.diag(link.inertia)
    if link.wheel:
        return _STRAIGHT, (diagonal[0], diagonal[2], diagonal[1])
    if link.inertia[0, 2] == 0.0:
        return _STRAIGHT, diagonal
    return principal_axes(link.inertia)


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
