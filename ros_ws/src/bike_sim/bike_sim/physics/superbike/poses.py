"""From the pose of a superbike's frame to the minimal state, and the pose in which it stands on its tyres."""

from __future__ import annotations

import math

from numba import njit

from bike_sim.physics.superbike.contact import fork_axes, frame_axes, wheel_contact
from bike_sim.physics.superbike.records import Quaternion
from bike_sim.physics.vectors import Vec, add, mix, scale
from bike_sim.vehicles.superbike import Record


@njit(cache=True)
def state_at(
    position: Vec, orientation: Quaternion, omega: Vec, constants: Record
) -> tuple[float, float, float, float, float]:
    """Return ``(x, y, yaw, roll, roll_rate)``: the rear contact point in the map and the frame's angles.

    Args:
        position: of the frame's centre of mass, m.
        orientation: of its principal axes.
        omega: rad/s.
        constants: a record of `CONSTANTS`.
    """
    geometry = constants.geometry
    ex, ey, ez = frame_axes(orientation, geometry)
    centre = add(position, mix(geometry.axle_x, ex, geometry.axle_z, ez))
    contact = wheel_contact(centre, ey, constants.machine.rR, constants.rear_tyre.crown)
    point, heading = contact.point, contact.heading
    roll = math.atan2(ey[2], math.hypot(ey[0], ey[1]))
    roll_rate = heading[0] * omega[0] + heading[1] * omega[1]
    return point[0], point[1], math.atan2(heading[1], heading[0]), roll, roll_rate


@njit(cache=True)
def read_state(
    position: Vec, orientation: Quaternion, omega: Vec, constants: Record
) -> tuple[float, float, float, float, float]:
    """Do as `state_at` with an array of one record, which costs a caller in Python less than a record."""
    return state_at(position, orientation, omega, constants[0])


@njit(cache=True)
def settle(roll: float, steer: float, constants: Record) -> tuple[float, float]:
    """Return ``(pitch, height)`` of the frame at which both tyres carry the standing machine's loads.

    Pitch in rad, positive nose down; height of the frame's centre of mass in m. Nan where there is no such pose.
    The loads of a steady turn are nearly these, so a ride that starts leaning starts without a bounce.

    Args:
        roll: rad.
        steer: rad.
        constants: of the machine, shape (1,).
    """
    geometry, machine = constants[0].geometry, constants[0].machine
    rear_crown, front_crown = constants[0].rear_tyre.crown, constants[0].front_tyre.crown
    sr, cr = math.sin(roll), math.cos(roll)
    ey = 0.0, cr, sr
    pitch = 0.0
    for _ in range(60):
        cp, sp = math.cos(pitch), math.sin(pitch)
        ex = cp, sr * sp, -cr * sp
        ez = sp, -sr * cp, cr * cp
        ahead, axle, _axis = fork_axes(ex, ey, ez, steer, geometry)
        rear = mix(geometry.axle_x, ex, geometry.axle_z, ez)
        front = add(mix(geometry.head_x, ex, geometry.head_z, ez), scale(geometry.hub, ahead))
        rear_low = wheel_contact(rear, ey, machine.rR, rear_crown).point
        front_low = wheel_contact(front, axle, machine.rF, front_crown).point
        height = -geometry.rear_static - rear_low[2]
        gap = height + front_low[2] + geometry.front_static
        # the nose turns about the rear axle: a unit of pitch lowers the front contact by its distance ahead
        change = gap / (cr * (front_low[0] - rear_low[0]))
        pitch += change
        if abs(change) < 1e-14:
            return pitch, height
    return math.nan, math.nan
