"""A vehicle's tree of bodies in Bullet.

Importing this module is also the quiet way to import PyBullet.
"""

from __future__ import annotations

import math
import os
import struct
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics.multibody.tree import Body, Joint, outward, principal_axes
from bike_sim.physics.multibody.vectors import Vec, axis_angle


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

__all__ = ["AXLE_TO_Z", "BulletTree", "build_tree", "bullet", "connect", "set_free"]


AXLE_TO_Z: Final = axis_angle(np.array([1.0, 0.0, 0.0]), -0.5 * math.pi)
"""From a wheel's own axes, axle along y, to those of its Bullet link, axle along z: a cylinder that needs no turning
inside its link is the cheapest shape."""
FASTEST_JOINT: Final = 1e6
"""Largest rate of a joint, rad/s: Bullet's default limit of 100 rad/s is 35 m/s on the road."""
_STRAIGHT: Final = (0.0, 0.0, 0.0, 1.0)
_JOINT_TYPES: Final = {Joint.REVOLUTE: bullet.JOINT_REVOLUTE, Joint.PRISMATIC: bullet.JOINT_PRISMATIC}


def build_tree(client: int, tree: Sequence[Body], shapes: Mapping[int, int] | None = None) -> int:
    """Build a tree at rest in its reference configuration and return Bullet's number of it.

    Each link's frame sits in its joint; a wheel's z axis is its axle.

    Args:
        client: the Bullet world.
        tree: its bodies, the base first.
        shapes: collision shapes by number of the link; others have none.
    """
    base, *links = tree
    shapes = shapes or {}
    axes, moments = principal_axes(base.inertia)
    origins = [base.centre, *(link.point for link in links)]
    frames = [_inertial_frame(link) for link in links]
    body: int = bullet.createMultiBody(
        baseMass=base.mass,
        basePosition=base.centre,
        baseInertialFrameOrientation=axes,
        linkMasses=[link.mass for link in links],
        linkCollisionShapeIndices=[shapes.get(number, -1) for number in range(len(links))],
        linkVisualShapeIndices=[-1] * len(links),
        linkPositions=[link.point - origins[link.parent] for link in links],
        linkOrientations=[AXLE_TO_Z if link.wheel else _STRAIGHT for link in links],
        linkInertialFramePositions=[link.centre - link.point for link in links],
        linkInertialFrameOrientations=[principal for principal, _ in frames],
        linkParentIndices=[link.parent for link in links],
        linkJointTypes=[_JOINT_TYPES[link.joint] for link in links],
        linkJointAxis=[(0.0, 0.0, 1.0) if link.wheel else link.axis for link in links],
        physicsClientId=client,
    )
    # what createMultiBody guesses from the shapes is not the bodies'
    for number, diagonal in enumerate([moments, *(moments for _, moments in frames)], -1):
        bullet.changeDynamics(body, number, localInertiaDiagonal=diagonal, physicsClientId=client)
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


class BulletTree:
    """A tree of bodies in a Bullet world of its own, without collision shapes, moved by given forces.

    Attributes:
        client: number of the Bullet world.
        body: Bullet's number of the tree.
    """

    def __init__(self, tree: Sequence[Body], gravity: float, time_step: float) -> None:
        """Build the world with the tree at rest in its reference configuration.

        Args:
            tree: the bodies, a free base first.
            gravity: m/s2.
            time_step: s.

        Raises:
            RuntimeError: this process holds as many Bullet worlds as Bullet allows.
        """
        self.client = connect()
        # A forgotten tree must not hold on to one of Bullet's limited number of worlds.
        self._disconnect = weakref.finalize(self, bullet.disconnect, self.client)
        bullet.setTimeStep(time_step, self.client)
        bullet.setGravity(0.0, 0.0, -gravity, self.client)
        order = outward(tree)
        sorted_tree = [replace(tree[i], parent=order.index(tree[i].parent) if i else -1) for i in order]
        self.body = build_tree(self.client, sorted_tree)
        set_free(self.client, self.body)
        self._joints = tuple(order.index(i) - 1 for i in range(1, len(tree)))
        self._pack: Callable[..., None] = struct.Struct(f"{13 + 2 * len(self._joints)}d").pack_into
        self._position = (0.0, 0.0, 0.0)
        self._passive = [(k, body) for k, body in enumerate(tree[1:]) if body.spring or body.damper]

    @property
    def is_open(self) -> bool:
        """Whether the world exists."""
        return self._disconnect.alive

    def close(self) -> None:
        """Give the world back; a second call does nothing."""
        self._disconnect()

    def place(self, motion: NDArray[np.void]) -> None:
        """Set the motion, and read back what Bullet holds of it.

        Args:
            motion: a record of `articulated.motion_record`, shape (1,).
        """
        body, client, now = self.body, self.client, motion[0]
        bullet.resetBasePositionAndOrientation(body, now["position"], now["orientation"], client)
        bullet.resetBaseVelocity(body, now["velocity"], now["omega"], client)
        for joint, angle, rate in zip(self._joints, now["joints"].tolist(), now["rates"].tolist(), strict=True):
            bullet.resetJointState(body, joint, angle, rate, client)
        self._read(motion)

    def step(self, motion: NDArray[np.void], force: Vec, torque: Vec, joints: Sequence[float]) -> None:
        """Integrate a step under given forces and read the motion after it.

        Args:
            motion: a record of `articulated.motion_record`, shape (1,), as the world has it; advanced.
            force: on the base, N, map axes.
            torque: on the base about its centre of mass, N m.
            joints: moments (N m) or forces (N) on the first joints, beside their springs and dampers.
        """
        body, client = self.body, self.client
        if self._passive:
            loads = np.zeros(len(self._joints))
            loads[: len(joints)] = joints
            for k, link in self._passive:
                loads[k] -= link.spring * motion["joints"][0, k] + link.damper * motion["rates"][0, k]
            joints = loads.tolist()
        bullet.applyExternalForce(body, -1, force, self._position, bullet.WORLD_FRAME, client)
        bullet.applyExternalTorque(body, -1, torque, bullet.WORLD_FRAME, client)
        driven = self._joints[: len(joints)]
        bullet.setJointMotorControlArray(body, driven, bullet.TORQUE_CONTROL, forces=joints, physicsClientId=client)
        bullet.stepSimulation(client)
        self._read(motion)

    def _read(self, motion: NDArray[np.void]) -> None:
        """Write the motion into a record of `articulated.motion_record`; numpy would take twice as long."""
        body, client = self.body, self.client
        self._position, orientation = bullet.getBasePositionAndOrientation(body, client)
        velocity, omega = bullet.getBaseVelocity(body, client)
        joints = bullet.getJointStates(body, self._joints, client)
        angles, rates = [joint[0] for joint in joints], [joint[1] for joint in joints]
        self._pack(motion, 0, *self._position, *orientation, *velocity, *omega, *angles, *rates)


def connect() -> int:
    """Return the number of a new Bullet world in this process.

    Raises:
        RuntimeError: this process holds as many Bullet worlds as Bullet allows.
    """
    client: int = bullet.connect(bullet.DIRECT)
    if client < 0:
        raise RuntimeError("no further Bullet world can be made in this process; close engines no longer used")
    return client
