"""From the pose of a superbike's frame to the minimal state, and the pose in which it stands on its tyres."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

from bike_sim.physics.superbike.contact import fork_axes, frame_axes, lean_of, lowest_point
from bike_sim.physics.superbike.records import Quaternion
from bike_sim.physics.superbike.surface import smooth_normal, surface_at
from bike_sim.physics.vectors import Vec, add, cross, dot, mix, scale
from bike_sim.vehicles.superbike import Record


@njit(cache=True)
def state_at(
    position: Vec, orientation: Quaternion, omega: Vec, patch: Record, constants: Record
) -> tuple[float, float, float, float, float]:
    """Return ``(x, y, yaw, roll, roll_rate)``: the rear contact point and the frame's angles, seen from above.

    Args:
        position: of the frame's centre of mass, m.
        orientation: of its principal axes.
        omega: rad/s.
        patch: the ground under the rear wheel, a record of `ground.PATCH`.
        constants: a record of `CONSTANTS`.
    """
    geometry = constants.geometry
    ex, ey, ez = frame_axes(orientation, geometry)
    centre = add(position, mix(geometry.axle_x, ex, geometry.axle_z, ez))
    normal = smooth_normal(centre[0], centre[1], patch)
    point = lowest_point(centre, ey, constants.machine.rR, constants.rear_tyre.crown, normal)
    lean, ahead = lean_of(ey, normal), cross(ey, normal)
    size = math.sqrt(dot(ahead, ahead))
    heading = ahead[0] / size, ahead[1] / size
    roll_rate = (heading[0] * omega[0] + heading[1] * omega[1]) / (lean.level * lean.level)
    return point[0], point[1], math.atan2(heading[1], heading[0]), lean.roll, roll_rate


class Footing(NamedTuple):
    """The ground on which a machine is put down.

    Attributes:
        height: of the ground under the rear contact, m. normal: there, without bumps.
        rise: of the ground under the front contact over the plane through the rear contact, m.
        climb: slope of the road there along the heading over the plane's, without bumps.
    """

    height: float
    normal: Vec
    rise: float
    climb: float


@njit(cache=True)
def footing(x: float, y: float, yaw: float, wheelbase: float, grounds: Record, bumps: Record) -> Footing:
    """Return the ground under both wheels of a machine whose rear contact is at a point of the map.

    Args:
        x: m.
        y: m.
        yaw: rad.
        wheelbase: m.
        grounds: of `ground.GROUND`, shape (1,).
        bumps: profiles, see `ground.Ground`.
    """
    profile = bumps[grounds[0].profile]
    cos, sin = math.cos(yaw), math.sin(yaw)
    rear = surface_at(x, y, grounds[0].rear, profile)
    plane = -(cos * rear.smooth[0] + sin * rear.smooth[1]) / rear.smooth[2]
    reach = wheelbase / math.sqrt(1.0 + plane * plane)
    front = surface_at(x + reach * cos, y + reach * sin, grounds[0].front, profile)
    slope = -(cos * front.smooth[0] + sin * front.smooth[1]) / front.smooth[2]
    rise = (front.height - rear.height - reach * plane) * rear.smooth[2]
    return Footing(rear.height, rear.smooth, rise, slope - plane)


@njit(cache=True)
def offsets(orientation: Quaternion, normal: Vec, constants: Record) -> tuple[Vec, Vec]:
    """Return where the rear wheel's centre and its lowest point lie from the frame's centre of mass, m, in map axes.

    Args:
        orientation: of the frame's principal axes.
        normal: of the ground.
        constants: of the machine, shape (1,).
    """
    geometry = constants[0].geometry
    ex, ey, ez = frame_axes(orientation, geometry)
    centre = mix(geometry.axle_x, ex, geometry.axle_z, ez)
    return centre, lowest_point(centre, ey, constants[0].machine.rR, constants[0].rear_tyre.crown, normal)


@njit(cache=True)
def settle(roll: float, steer: float, rise: float, constants: Record) -> tuple[float, float]:
    """Return ``(pitch, height)`` of the frame at which both tyres carry the standing machine's loads.

    Both are relative to the plane of the ground: pitch in rad, positive nose down; height of the frame's centre of mass
    in m. Nan where there is no such pose.
    The loads of a steady turn are nearly these, so a ride that starts leaning starts without a bounce.

    Args:
        roll: to the plane's normal, rad.
        steer: rad.
        rise: of the ground under the front wheel over the plane, m.
        constants: of the machine, shape (1,).
    """
    geometry, machine = constants[0].geometry, constants[0].machine
    rear_crown, front_crown = constants[0].rear_tyre.crown, constants[0].front_tyre.crown
    sr, cr = math.sin(roll), math.cos(roll)
    ey, up = (0.0, cr, sr), (0.0, 0.0, 1.0)
    pitch = 0.0
    for _ in range(60):
        cp, sp = math.cos(pitch), math.sin(pitch)
        ex = cp, sr * sp, -cr * sp
        ez = sp, -sr * cp, cr * cp
        ahead, axle, _axis = fork_axes(ex, ey, ez, steer, geometry)
        rear = mix(geometry.axle_x, ex, geometry.axle_z, ez)
        front = add(mix(geometry.head_x, ex, geometry.head_z, ez), scale(geometry.hub, ahead))
        rear_low = lowest_point(rear, ey, machine.rR, rear_crown, up)
        front_low = lowest_point(front, axle, machine.rF, front_crown, up)
        height = -geometry.rear_static - rear_low[2]
        gap = height + front_low[2] - rise + geometry.front_static
        # the nose turns about the rear axle: a unit of pitch lowers the front contact by its distance ahead
        change = gap / (cr * (front_low[0] - rear_low[0]))
        pitch += change
        if abs(change) < 1e-14:
            return pitch, height
    return math.nan, math.nan
