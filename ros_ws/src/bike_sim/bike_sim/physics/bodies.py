"""The bodies of a single-track vehicle: where they are, their tree, and their motion from minimal coordinates and back.

The minimal state says all there is to know about a rolling bicycle (Weyrer et al. 2026, appendix A), but a multibody
engine, a renderer or an energy balance needs the pose and the velocity of each body, which `redundant_from_minimal`
gives exactly, in the project's axes (x forward, y left, z up, which are also those of that appendix). It differs from
the appendix in one thing: a wheel's own frame is that of its carrier turned about y, so its axle is y and not x.

Orientations are unit quaternions (x, y, z, w) that turn body coordinates into map coordinates, as in Bullet and ROS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.multibody.tree import Body, Joint
from bike_sim.physics.multibody.vectors import Vector, axis_angle, conjugate, multiply, rotate
from bike_sim.physics.state import StateVector
from bike_sim.vehicles.bicycle import Vehicle

REAR_WHEEL: Final = 0
REAR_FRAME: Final = 1
FORK: Final = 2
FRONT_WHEEL: Final = 3
BODY_NAMES: Final = ("rear_wheel", "rear_frame", "fork", "front_wheel")
"""Bodies in the order of the rows of `RedundantState`; the rear frame carries the rider."""

REAR_JOINT: Final = 0
FORK_JOINT: Final = 1
FRONT_JOINT: Final = 2
SLIDE_JOINT: Final = 3
"""Numbers of the joints: body `k + 1` of `vehicle_tree` hangs on joint `k`; a sliding rider comes last."""
JOINTS: Final = (REAR_JOINT, FORK_JOINT, FRONT_JOINT)
"""Joints of a vehicle whose rider is fixed."""

_Z: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class RedundantState:
    """Motion of the four bodies in the map frame; rows are `BODY_NAMES`.

    Attributes:
        positions: centres of mass, m, shape (4, 3).
        orientations: quaternions (x, y, z, w), shape (4, 4).
        velocities: of the centres of mass, m/s, shape (4, 3).
        angular_velocities: in map coordinates, rad/s, shape (4, 3).
    """

    positions: Vector
    orientations: Vector
    velocities: Vector
    angular_velocities: Vector


@dataclass(frozen=True, slots=True)
class Layout:
    """Points and axes of the upright reference configuration, z up, from the rear contact point, m.

    Attributes:
        centres: centres of mass of `BODY_NAMES`, shape (4, 3); a wheel's is on its axle.
        head: the point of the steering axis at the height where a perpendicular from the front hub meets it.
        steering_axis: unit vector along the steering axis, upwards.
    """

    centres: Vector
    head: Vector
    steering_axis: Vector


def layout(vehicle: Vehicle) -> Layout:
    """Return the reference geometry of a vehicle; the published z-down heights change their sign here."""
    centres = np.array(
        [
            [0.0, 0.0, vehicle.rR],
            [vehicle.xB, 0.0, -vehicle.zB],
            [vehicle.xH, 0.0, -vehicle.zH],
            [vehicle.w, 0.0, vehicle.rF],
        ]
    )
    axis = np.array([-math.sin(vehicle.lam), 0.0, math.cos(vehicle.lam)])
    ground = np.array([vehicle.w + vehicle.c, 0.0, 0.0])  # where the steering axis meets the ground
    head = ground + axis * ((centres[FRONT_WHEEL] - ground) @ axis)
    return Layout(centres, head, axis)


def redundant_from_minimal(state: StateVector, vehicle: Vehicle) -> RedundantState:
    """Return pose and velocity of the four bodies of a rolling bicycle (appendix A.2).

    Args:
        state: minimal state, shape (10,).
        vehicle: the vehicle's parameters.

    Raises:
        ValueError: wrong shape, a value that is not finite, or a roll and steer at which not both wheels can
            touch the ground.
    """
    state = st.checked_state(state)
    reference, p = layout(vehicle), vehicle.parameters
    pitch = kinematics.pitch(state[st.ROLL], state[st.STEER], p)
    if not math.isfinite(pitch):
        raise ValueError(
            f"no configuration with both wheels on the ground at roll {math.degrees(state[st.ROLL]):.1f} deg and "
            f"steer {math.degrees(state[st.STEER]):.1f} deg of vehicle '{vehicle.name}'"
        )
    lean = multiply(_turn(2, state[st.YAW]), _turn(0, state[st.ROLL]))  # the T1 frame of Eq. (A.3)
    frame = multiply(lean, _turn(1, pitch))  # Eq. (A.4)
    fork = multiply(frame, axis_angle(reference.steering_axis, state[st.STEER]))  # Eq. (A.6)
    orientations = np.array(
        [
            multiply(frame, _turn(1, state[st.REAR_WHEEL])),  # Eq. (A.5)
            frame,
            fork,
            multiply(fork, _turn(1, state[st.FRONT_WHEEL])),  # Eq. (A.7)
        ]
    )
    contact = np.array([state[st.X], state[st.Y], 0.0])
    axle = contact + vehicle.rR * rotate(lean, _Z)
    rear = reference.centres[REAR_WHEEL]
    head = axle + rotate(frame, reference.head - rear)
    positions = np.array(
        [
            axle,
            axle + rotate(frame, reference.centres[REAR_FRAME] - rear),
            head + rotate(fork, reference.centres[FORK] - reference.head),
            head + rotate(fork, reference.centres[FRONT_WHEEL] - reference.head),
        ]
    )

    yaw_rate, rear_speed, pitch_rate = kinematics.rates(state, p)
    rear_wheel_rate = rear_speed / vehicle.rR - pitch_rate
    lateral = rotate(frame, np.array([0.0, 1.0, 0.0]))  # both the rear axle and the T1 frame's y axis
    frame_rate = yaw_rate * _Z + state[st.ROLL_RATE] * rotate(lean, np.array([1.0, 0.0, 0.0])) + pitch_rate * lateral
    fork_rate = frame_rate + state[st.STEER_RATE] * rotate(frame, reference.steering_axis)  # Eq. (A.11), (A.12)
    angular_velocities = np.array(
        [
            frame_rate + rear_wheel_rate * lateral,  # Eq. (A.22)
            frame_rate,  # Eq. (A.8)
            fork_rate,
            fork_rate + state[st.FRONT_WHEEL_RATE] * rotate(fork, np.array([0.0, 1.0, 0.0])),  # Eq. (A.13)
        ]
    )
    # The rear wheel's material point at P is at rest, and every other velocity follows along the tree.
    axle_velocity = np.cross(angular_velocities[REAR_WHEEL], axle - contact)
    head_velocity = axle_velocity + np.cross(frame_rate, head - axle)
    velocities = np.array(
        [
            axle_velocity,
            axle_velocity + np.cross(frame_rate, positions[REAR_FRAME] - axle),
            head_velocity + np.cross(fork_rate, positions[FORK] - head),
            head_velocity + np.cross(fork_rate, positions[FRONT_WHEEL] - head),
        ]
    )
    return RedundantState(positions, orientations, velocities, angular_velocities)


@njit(cache=True)
def frame_coordinates(
    position: tuple[float, float, float],
    orientation: tuple[float, float, float, float],
    angular_velocity: tuple[float, float, float],
    axle_offset: tuple[float, float, float],
    rear_radius: float,
) -> tuple[float, float, float, float, float]:
    """Return ``(x, y, yaw, roll, roll_rate)`` of a vehicle from the motion of its rear frame.

    Only the frame's y axis matters for the angles, so any frame that shares it serves, for example the rear
    frame's principal axes of inertia.

    Args:
        position: of the frame's origin, m.
        orientation: of the frame, quaternion (x, y, z, w).
        angular_velocity: in map coordinates, rad/s.
        axle_offset: the rear axle seen from the frame's origin, in the frame's coordinates, m; its y is ignored as 0.
        rear_radius: radius of the rear wheel, m.
    """
    qx, qy, qz, qw = orientation
    # Second column of the rotation matrix: Rz(yaw) Rx(roll) e_y = (-sin yaw cos roll, cos yaw cos roll, sin roll)
    lateral_x = 2.0 * (qx * qy - qw * qz)
    lateral_y = 1.0 - 2.0 * (qx * qx + qz * qz)
    lateral_z = 2.0 * (qy * qz + qw * qx)
    cos_roll = math.hypot(lateral_x, lateral_y)
    roll = math.atan2(lateral_z, cos_roll)
    yaw = math.atan2(-lateral_x, lateral_y)
    sin_yaw, cos_yaw = -lateral_x / cos_roll, lateral_y / cos_roll
    ax, az = axle_offset[0], axle_offset[2]
    axle_x = position[0] + (1.0 - 2.0 * (qy * qy + qz * qz)) * ax + 2.0 * (qx * qz + qw * qy) * az
    axle_y = position[1] + 2.0 * (qx * qy + qw * qz) * ax + 2.0 * (qy * qz - qw * qx) * az
    # The contact lies one radius below the axle along the T1 frame's z axis, Eq. (A.3)
    x = axle_x - rear_radius * sin_yaw * lateral_z
    y = axle_y + rear_radius * cos_yaw * lateral_z
    roll_rate = cos_yaw * angular_velocity[0] + sin_yaw * angular_velocity[1]  # Eq. (A.2)
    return x, y, yaw, roll, roll_rate


def energy(state: StateVector, vehicle: Vehicle) -> float:
    """Return kinetic plus potential energy of a rolling bicycle, J; the ground is the zero of height.

    Without a steering drive it is a constant of the motion.
    """
    bodies = redundant_from_minimal(state, vehicle)
    masses = np.array([vehicle.mR, vehicle.mB, vehicle.mH, vehicle.mF])
    total = 0.5 * masses @ np.sum(bodies.velocities**2, axis=1) + vehicle.g * masses @ bodies.positions[:, 2]
    for tensor, orientation, rate in zip(
        inertia_tensors(vehicle), bodies.orientations, bodies.angular_velocities, strict=True
    ):
        local = rotate(conjugate(orientation), rate)
        total += 0.5 * local @ tensor @ local
    return float(total)


def inertia_tensors(vehicle: Vehicle) -> Vector:
    """Return the inertia tensors of `BODY_NAMES` about their centres of mass, z up, kg m2, shape (4, 3, 3)."""

    def symmetric(xx: float, xz: float, yy: float, zz: float) -> list[list[float]]:
        # Turning from z down to z up flips y and z, and with them the sign of the xz element.
        return [[xx, 0.0, -xz], [0.0, yy, 0.0], [-xz, 0.0, zz]]

    v = vehicle
    return np.array(
        [
            symmetric(v.IRxx, 0.0, v.IRyy, v.IRxx),
            symmetric(v.IBxx, v.IBxz, v.IByy, v.IBzz),
            symmetric(v.IHxx, v.IHxz, v.IHyy, v.IHzz),
            symmetric(v.IFxx, 0.0, v.IFyy, v.IFxx),
        ]
    )


def _turn(axis: int, angle: float) -> Vector:
    """Return the quaternion of a rotation about a coordinate axis (0 is x)."""
    quaternion = np.zeros(4)
    quaternion[axis] = math.sin(0.5 * angle)
    quaternion[3] = math.cos(0.5 * angle)
    return quaternion


def vehicle_tree(vehicle: Vehicle, *further: Body) -> tuple[Body, ...]:
    """Return the bodies of a vehicle, the rear frame first, in the order of the joints' numbers.

    Args:
        vehicle: masses, inertias and geometry.
        further: bodies besides, in order: a rider on a slide, a swingarm, a twisting head.
    """
    reference = layout(vehicle)
    centres = reference.centres
    tensors = inertia_tensors(vehicle)
    left = np.array([0.0, 1.0, 0.0])
    masses = (vehicle.mR, vehicle.mB, vehicle.mH, vehicle.mF)  # in the order of `BODY_NAMES`
    frame, head, axis = REAR_FRAME, reference.head, reference.steering_axis
    joints = (
        (frame, Joint.FREE, -1, centres[frame], left),
        (REAR_WHEEL, Joint.REVOLUTE, 0, centres[REAR_WHEEL], left),
        (FORK, Joint.REVOLUTE, 0, head, axis),
        (FRONT_WHEEL, Joint.REVOLUTE, FORK_JOINT + 1, centres[FRONT_WHEEL], left),
    )
    wheels = (REAR_WHEEL, FRONT_WHEEL)
    bodies = [
        Body(BODY_NAMES[i], masses[i], centres[i], tensors[i], joint, parent, point, along, i in wheels)
        for i, joint, parent, point, along in joints
    ]
    return (*bodies, *further)
