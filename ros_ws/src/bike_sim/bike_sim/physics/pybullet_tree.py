"""A vehicle's tree of bodies in Bullet.

Importing this module is also the quiet way to import PyBullet.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

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

__all__ = ["AXLE_TO_Z", "FASTEST_JOINT", "Link", "build_tree", "bullet", "links_of", "set_free"]

AXLE_TO_Z: Final = mapping.axis_angle(np.array([1.0, 0.0, 0.0]), -0.5 * math.pi)
"""From a wheel's own axes, axle along y, to those of its Bullet link, axle along z: a cylinder that needs no turning
inside its link is the cheapest shape."""
FASTEST_JOINT: Final = 1e6
"""Largest rate of a joint, rad/s: Bullet's default limit of 100 rad/s is 35 m/s on the road."""
_STRAIGHT: Final = (0.0, 0.0, 0.0, 1.0)
_JOINT_TYPES: Final = {Joint.REVOLUTE: bullet.JOINT_REVOLUTE, Joint.PRISMATIC: bullet.JOINT_PRISMATIC}


class Link(NamedTuple):
    """A body as Bullet is told of it; the base has no parent, and its axis means nothing.

    Attributes:
        mass: kg. moments: principal moments of inertia, kg m2.
        position: of its frame in its parent's (m), of the base in the map. orientation: quaternion (x, y, z, w).
        centre: of mass in its frame, m. principal: orientation of its principal axes there.
        parent: number of the link that carries it, 0 for the base. joint: Bullet's type. axis: of it, in its frame.
    """

    mass: float
    moments: Any
    position: Any
    orientation: Any
    centre: Any
    principal: Any
    parent: int
    joint: int
    axis: Any


def links_of(tree: Sequence[Body]) -> tuple[Link, ...]:
    """Return the bodies of a vehicle in its upright reference configuration, the base first.

    Each link's frame sits in its joint; a wheel's z axis is its axle.
    """
    base, *links = tree
    axes, moments = principal_axes(base.inertia)
    origins = [base.centre, *(link.point for link in links)]
    told = [Link(base.mass, moments, base.centre, _STRAIGHT, (0.0, 0.0, 0.0), axes, -1, -1, (0.0, 0.0, 0.0))]
    for link in links:
        principal, moments = _inertial_frame(link)
        position, centre = link.point - origins[link.parent], link.centre - link.point
        turned, axis = (AXLE_TO_Z, (0.0, 0.0, 1.0)) if link.wheel else (_STRAIGHT, link.axis)
        joint = _JOINT_TYPES[link.joint]
        told.append(Link(link.mass, moments, position, turned, centre, principal, link.parent, joint, axis))
    return tuple(told)


def build_tree(client: int, tree: Sequence[Body], shapes: Mapping[int, int] | None = None) -> int:
    """Build a vehicle at rest in its upright reference configuration and return Bullet's number of it.

    Args:
        client: the Bullet world.
        tree: its bodies.
        shapes: collision shapes by number of the link; others have none.
    """
    base, *links = links_of(tree)
    shapes = shapes or {}
    body: int = bullet.createMultiBody(
        baseMass=base.mass,
        basePosition=base.position,
        baseInertialFrameOrientation=base.principal,
        linkMasses=[link.mass for link in links],
        linkCollisionShapeIndices=[shapes.get(number, -1) for number in range(len(links))],
        linkVisualShapeIndices=[-1] * len(links),
        linkPositions=[link.position for link in links],
        linkOrientations=[link.orientation for link in links],
        linkInertialFramePositions=[link.centre for link in links],
        linkInertialFrameOrientations=[link.principal for link in links],
        linkParentIndices=[link.parent for link in links],
        linkJointTypes=[link.joint for link in links],
        linkJointAxis=[link.axis for link in links],
        physicsClientId=client,
    )
    # what createMultiBody guesses from the shapes is not the vehicle's
    for number, link in enumerate((base, *links), -1):
        bullet.changeDynamics(body, number, localInertiaDiagonal=link.moments, physicsClientId=client)
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
        # no loss but the drive's
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
            maxJointVelocity=FASTEST_JOINT,
            activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
    for link in links:  # every new joint comes with a motor that brakes it
        bullet.setJointMotorControl2(body, link, bullet.VELOCITY_CONTROL, force=0.0, physicsClientId=client)
