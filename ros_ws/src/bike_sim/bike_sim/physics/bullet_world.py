"""A tree of bodies in a Bullet world of its own, moved by compiled code through Bullet's C interface.

PyBullet's functions stand on this interface, which its library exports. From Python the motion takes three questions,
each of which has Bullet write down all of it, and forces one command a joint; with arguments and tuples of numbers this
costs as much as the integration. Compiled code asks once and calls nothing of Python in between. What Bullet computes
is the same, bit for bit.

In Bullet's vectors the base comes first: 7 numbers of a position (3 and a quaternion), 6 of a velocity.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from llvmlite import binding
from numba import njit, types
from numpy.typing import NDArray

from bike_sim.physics.pybullet_tree import FASTEST_JOINT, bullet, links_of
from bike_sim.physics.tree import Body
from bike_sim.physics.vectors import Vec

Record = Any
Array = NDArray[np.float64]

_BASE: Final = -1
_BASE_RATES: Final = 6
_TORQUE: Final = int(bullet.TORQUE_CONTROL)
_IN_MAP: Final = int(bullet.WORLD_FRAME)
_NUMBER: Final = 8
"""Bytes of a number in Bullet's vectors."""

_library = ctypes.CDLL(bullet.__file__)


def _address(name: str) -> int:
    """Return where a function of the C interface lies.

    Raises:
        ImportError: this build of PyBullet does not export it.
    """
    try:
        return ctypes.cast(getattr(_library, name), ctypes.c_void_p).value or 0
    except AttributeError:
        raise ImportError(
            f"{bullet.__file__} does not export {name} of Bullet's C interface; superbikes need a PyBullet that does, "
            "as the wheels and source packages of PyPI do"
        ) from None


# ------------------------------------------------------------------------------------------------------ from Python

_world, _command, _status, _number = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double
_index, _vector = ctypes.c_int, ctypes.POINTER(ctypes.c_double)


def _function(name: str, result: Any, *arguments: Any) -> Any:
    """Return a function of the C interface for callers in Python."""
    return ctypes.CFUNCTYPE(result, *arguments)(_address(name))


_connect = _function("b3ConnectPhysicsDirect", _world)
_disconnect = _function("b3DisconnectSharedMemory", None, _world)
_send_and_wait = _function("b3SubmitClientCommandAndWaitStatus", _status, _world, _command)
_settings = _function("b3InitPhysicsParamCommand", _command, _world)
_set_gravity = _function("b3PhysicsParamSetGravity", _index, _command, _number, _number, _number)
_set_time_step = _function("b3PhysicsParamSetTimeStep", _index, _command, _number)
_create = _function("b3CreateMultiBodyCommandInit", _command, _world)
_add_base = _function(
    "b3CreateMultiBodyBase", _index, _command, _number, _index, _index, _vector, _vector, _vector, _vector
)
_add_link = _function(
    "b3CreateMultiBodyLink", _index, _command, _number, _number, _number, _vector, _vector, _vector, _vector, _index,
    _index, _vector,
)  # fmt: skip
_body_of = _function("b3GetStatusBodyIndex", _index, _status)
_change = _function("b3InitChangeDynamicsInfo", _command, _world)
_set_moments = _function("b3ChangeDynamicsInfoSetLocalInertiaDiagonal", _index, _command, _index, _index, _vector)
_set_joint_damping = _function("b3ChangeDynamicsInfoSetJointDamping", _index, _command, _index, _index, _number)
_set_linear_damping = _function("b3ChangeDynamicsInfoSetLinearDamping", _index, _command, _index, _number)
_set_angular_damping = _function("b3ChangeDynamicsInfoSetAngularDamping", _index, _command, _index, _number)
_set_fastest_joint = _function("b3ChangeDynamicsInfoSetMaxJointVelocity", _index, _command, _index, _number)
_set_activation = _function("b3ChangeDynamicsInfoSetActivationState", _index, _command, _index, _index)
_control = _function("b3JointControlCommandInit2", _command, _world, _index, _index)
_set_desired_rate = _function("b3JointControlSetDesiredVelocity", _index, _command, _index, _number)
_set_most_torque = _function("b3JointControlSetMaximumForce", _index, _command, _index, _number)


def make_world(tree: Sequence[Body], gravity: float, time_step: float) -> tuple[int, int]:
    """Make a world with a tree at rest in its upright reference configuration, free of losses, motors and sleep.

    Args:
        tree: the bodies, a free base first.
        gravity: m/s2.
        time_step: s.

    Returns:
        The world, for the other functions of this module, and Bullet's number of the tree.

    Raises:
        RuntimeError: Bullet refuses the tree.
    """
    world: int = _connect()
    command = _settings(world)
    _set_time_step(command, time_step)
    _set_gravity(command, 0.0, 0.0, -gravity)
    _send_and_wait(world, command)
    body = _build(world, tree)
    if body < 0:
        close_world(world)
        raise RuntimeError(f"Bullet made no bodies of a tree of {len(tree)}")
    _free(world, body, len(tree) - 1)
    return world, body


def close_world(world: int) -> None:
    """Give a world back, once."""
    _disconnect(world)


def _build(world: int, tree: Sequence[Body]) -> int:
    """Build the tree and return Bullet's number of it, or less than 0."""
    base, *links = links_of(tree)
    command = _create(world)
    placed = (base.position, base.orientation, base.centre, base.principal)
    _add_base(command, base.mass, -1, -1, *map(_numbers, placed))
    for link in links:
        placed = (link.position, link.orientation, link.centre, link.principal)
        _add_link(command, link.mass, -1, -1, *map(_numbers, placed), link.parent, link.joint, _numbers(link.axis))
    body: int = _body_of(_send_and_wait(world, command))
    if body >= 0:
        for number, link in enumerate((base, *links), _BASE):
            command = _change(world)
            _set_moments(command, body, number, _numbers(link.moments))
            _send_and_wait(world, command)
    return body


def _free(world: int, body: int, joints: int) -> None:
    """Switch off Bullet's losses, its motors and its sleep."""
    for number in range(_BASE, joints):
        command = _change(world)
        _set_joint_damping(command, body, number, 0.0)
        _set_linear_damping(command, body, 0.0)
        _set_angular_damping(command, body, 0.0)
        _set_fastest_joint(command, body, FASTEST_JOINT)
        _set_activation(command, body, int(bullet.ACTIVATION_STATE_DISABLE_SLEEPING))
        _send_and_wait(world, command)
    command = _control(world, body, int(bullet.VELOCITY_CONTROL))
    for joint in range(joints):  # every new joint comes with a motor that brakes it
        _set_desired_rate(command, _BASE_RATES + joint, 0.0)
        _set_most_torque(command, _BASE_RATES + joint, 0.0)
    _send_and_wait(world, command)


def _numbers(values: Any) -> Any:
    """Return numbers as C takes them."""
    return (ctypes.c_double * len(values))(*map(float, values))


# ----------------------------------------------------------------------------------------------- from compiled code

_pointer, _int, _float = types.uintp, types.int32, types.float64


def _external(name: str, result: Any, *arguments: Any) -> Any:
    """Return a function of the C interface for callers in compiled code, which find it by its name."""
    binding.add_symbol(name, _address(name))
    return types.ExternalFunction(name, result(*arguments))


_submit = _external("b3SubmitClientCommand", _int, _pointer, _pointer)
_receive = _external("b3ProcessServerStatus", _pointer, _pointer)
_ask = _external("b3RequestActualStateCommandInit", _pointer, _pointer, _int)
_answer = _external("b3GetStatusActualState", _int, *(_pointer,) * 8)
_begin_push = _external("b3ApplyExternalForceCommandInit", _pointer, _pointer)
_push = _external("b3ApplyExternalForce", types.void, _pointer, _int, _int, _pointer, _pointer, _int)
_turn = _external("b3ApplyExternalTorque", types.void, _pointer, _int, _int, _pointer, _int)
_begin_joints = _external("b3JointControlCommandInit2", _pointer, _pointer, _int, _int)
_load_joint = _external("b3JointControlSetDesiredForceTorque", _int, _pointer, _int, _float)
_begin_step = _external("b3InitStepSimulationCommand", _pointer, _pointer)
_begin_pose = _external("b3CreatePoseCommandInit", _pointer, _pointer, _int)
_pose_position = _external("b3CreatePoseCommandSetBasePosition", _int, _pointer, _float, _float, _float)
_pose_turn = _external("b3CreatePoseCommandSetBaseOrientation", _int, _pointer, _float, _float, _float, _float)
_pose_velocity = _external("b3CreatePoseCommandSetBaseLinearVelocity", _int, _pointer, _pointer)
_pose_omega = _external("b3CreatePoseCommandSetBaseAngularVelocity", _int, _pointer, _pointer)
_pose_joint = _external("b3CreatePoseCommandSetJointPosition", _int, _pointer, _pointer, _int, _float)
_pose_rate = _external("b3CreatePoseCommandSetJointVelocity", _int, _pointer, _pointer, _int, _float)
_copy = types.ExternalFunction("memcpy", _pointer(_pointer, _pointer, _pointer))


@njit(cache=True)
def _send(world: int, command: int) -> int:
    """Have a command carried out, and return Bullet's status.

    A world in the own process answers at once; `b3SubmitClientCommandAndWaitStatus` would look at the clock.
    """
    _submit(world, command)
    return _receive(world)


@njit(cache=True)
def fetch(world: int, body: int, motion: Record) -> None:
    """Read the motion of a tree into a record of `articulated.motion_record`."""
    places = np.empty(2, dtype=np.uint64)
    status = _send(world, _ask(world, body))
    _answer(status, 0, 0, 0, 0, places.ctypes.data, places.ctypes.data + _NUMBER, 0)
    q, rates, joints = places[0], places[1], _NUMBER * motion.joints.size
    _copy(motion.position.ctypes.data, q, 3 * _NUMBER)
    _copy(motion.orientation.ctypes.data, q + 3 * _NUMBER, 4 * _NUMBER)
    _copy(motion.joints.ctypes.data, q + 7 * _NUMBER, joints)
    _copy(motion.velocity.ctypes.data, rates, 3 * _NUMBER)
    _copy(motion.omega.ctypes.data, rates + 3 * _NUMBER, 3 * _NUMBER)
    _copy(motion.rates.ctypes.data, rates + _BASE_RATES * _NUMBER, joints)


@njit(cache=True)
def place(world: int, body: int, motions: Record) -> None:
    """Set the motion of a tree, and read back what Bullet holds of it.

    Args:
        world: the world.
        body: Bullet's number of the tree.
        motions: a record of `articulated.motion_record`, shape (1,).
    """
    motion = motions[0]
    p, q = motion.position, motion.orientation
    command = _begin_pose(world, body)
    _pose_position(command, p[0], p[1], p[2])
    _pose_turn(command, q[0], q[1], q[2], q[3])
    _pose_velocity(command, motion.velocity.ctypes.data)
    _pose_omega(command, motion.omega.ctypes.data)
    for joint in range(motion.joints.size):
        _pose_joint(world, command, joint, motion.joints[joint])
        _pose_rate(world, command, joint, motion.rates[joint])
    _send(world, command)
    fetch(world, body, motion)


@njit(cache=True)
def step(world: int, body: int, motion: Record, force: Vec, torque: Vec, joints: tuple[float, ...]) -> None:
    """Integrate a step under given forces and read the motion after it.

    Args:
        world: the world.
        body: Bullet's number of the tree.
        motion: a record of `articulated.motion_record`, advanced.
        force: on the base, N, map axes.
        torque: on the base about its centre of mass, N m.
        joints: moments (N m) or forces (N) on the joints.
    """
    wrench = np.empty(6)
    for k in range(3):
        wrench[k], wrench[3 + k] = force[k], torque[k]
    # One command could hold both, but Bullet 3.2.7 writes the second of them over a part of the first.
    command = _begin_push(world)
    _push(command, body, _BASE, wrench.ctypes.data, motion.position.ctypes.data, _IN_MAP)
    _send(world, command)
    command = _begin_push(world)
    _turn(command, body, _BASE, wrench.ctypes.data + 3 * _NUMBER, _IN_MAP)
    _send(world, command)
    command = _begin_joints(world, body, _TORQUE)
    for joint in range(len(joints)):
        _load_joint(command, _BASE_RATES + joint, joints[joint])
    _send(world, command)
    _send(world, _begin_step(world))
    fetch(world, body, motion)
