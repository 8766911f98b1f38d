"""Contact of a superbike's wheels with the ground: surface, geometry, slip and tyre forces.

A wheel stands on a patch (`bike_sim.physics.ground`): around its origin the surface is of second order along the road
and a plane across it, with a periodic profile of bumps on top that is the same over the whole width. On a level, smooth
patch all numbers are exactly those of flat ground.

Vectors are in map axes (z up). A contact's `heading` is the wheel's on the ground, `left` is left of it; both lie in
the surface. Geometry of the toroidal tyre: seen along the surface's normal, the lowest point lies one crown radius
straight below the lowest point of the ring through the middles of its cross-sections, and it has the velocity of the
wheel carrier's material there plus that of the wheel's rotation about its axle, ``-R_e spin`` along the heading, with
``R_e = R - crown (1 - cos camber)``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.ground import BUMP_SAMPLES, BUMP_SPACING
from bike_sim.physics.multibody.vectors import Quaternion, Vec, add, cross, dot, mix, scale
from bike_sim.physics.superbike import magic_formula, tyres
from bike_sim.physics.superbike.records import Motion
from bike_sim.vehicles.superbike import Record


@njit(cache=True)
def bump_at(arc: float, profile: NDArray) -> tuple[float, float]:
    """Return height (m) and slope of a profile of bumps at an arc length (m) of any lap.

    Cubic between samples (Catmull-Rom), so that the slope has no steps for a tyre to hammer on.
    """
    u = arc / BUMP_SPACING
    floor = math.floor(u)
    i, t = int(floor) % BUMP_SAMPLES, u - floor
    a, b = profile[i - 1], profile[i]
    c, d = profile[(i + 1) % BUMP_SAMPLES], profile[(i + 2) % BUMP_SAMPLES]
    first, second, third = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
    height = b + t * (first + t * (second + t * third))
    return height, (first + t * (2.0 * second + 3.0 * t * third)) / BUMP_SPACING


@njit(cache=True)
def surface_at(x: float, y: float, patch: Record, profile: NDArray) -> tuple[float, Vec, Vec]:
    """Return height (m), upward normal, and the normal as if there were no bumps, at a point of the map.

    Args:
        x: m.
        y: m.
        patch: a record of `ground.PATCH`.
        profile: of bumps, shape (BUMP_SAMPLES,).
    """
    dx, dy = x - patch.x, y - patch.y
    along, left = patch.cos * dx + patch.sin * dy, patch.cos * dy - patch.sin * dx
    height = patch.height + (patch.grade + 0.5 * patch.crest * along) * along + patch.bank * left
    slope = patch.grade + patch.crest * along
    smooth = normal = _normal(slope, patch)
    if patch.bumps != 0.0:
        bump, tilt = bump_at(patch.arc + patch.stretch * along, profile)
        height += patch.bumps * bump
        normal = _normal(slope + patch.bumps * patch.stretch * tilt, patch)
    return height, normal, smooth


@njit(cache=True)
def smooth_normal(x: float, y: float, patch: Record) -> Vec:
    """Return the normal at a point of the map (m) as if there were no bumps."""
    along = patch.cos * (x - patch.x) + patch.sin * (y - patch.y)
    return _normal(patch.grade + patch.crest * along, patch)


@njit(cache=True)
def _normal(slope: float, patch: Record) -> Vec:
    """Return the upward normal where the road rises by `slope` per m along and by the bank per m to the left."""
    east, north = slope * patch.cos - patch.bank * patch.sin, slope * patch.sin + patch.bank * patch.cos
    up = 1.0 / math.sqrt(1.0 + east * east + north * north)
    return -east * up, -north * up, up


class Axes(NamedTuple):
    """The bodies' axes and the arms from the frame's centre of mass, in map axes.

    Attributes:
        ex: of the frame, forward.
        ey: left, the rear axle.
        ez: up.
        axle: the front axle, to the left.
        steering: the steering axis, upward.
        rear_arm: to the rear axle, m.
        head_arm: to the head.
        hub_arm: from the head to the front axle.
        fork_omega: angular velocity of what carries the front wheel, rad/s.
        pivot_arm: to the swing arm's pivot, m.
        twist_arm: to the joint in which the steering head twists, m.
        bend_arm: to the joint in which the fork bends, m.
        ahead: axis of the head's twist.
        bending: axis of the fork's bending.
        sliding: along which the fork is pressed together, upward.
    """

    ex: Vec
    ey: Vec
    ez: Vec
    axle: Vec
    steering: Vec
    rear_arm: Vec
    head_arm: Vec
    hub_arm: Vec
    fork_omega: Vec
    pivot_arm: Vec
    twist_arm: Vec
    bend_arm: Vec
    ahead: Vec
    bending: Vec
    sliding: Vec


class Contact(NamedTuple):
    """A wheel at the ground.

    Attributes:
        point: lowest of the undeformed tyre, m.
        gap: its distance from the ground, m, negative when pressed in.
        heading: unit vector.
        left: unit vector.
        normal: of the ground, unit vector, upward.
        smooth: the same as if there were no bumps.
        lean: sine of the camber.
        radius: rolling radius R_e, m.
    """

    point: Vec
    gap: float
    heading: Vec
    left: Vec
    normal: Vec
    smooth: Vec
    lean: float
    radius: float


class Rolling(NamedTuple):
    """Motion of a wheel.

    Attributes:
        velocity: of the carrier's material at the lowest point, m/s.
        carrier: its angular velocity, rad/s.
        axle: unit vector to the left.
        rate: of the wheel relative to its carrier, rad/s.
    """

    velocity: Vec
    carrier: Vec
    axle: Vec
    rate: float


class TyreForce(NamedTuple):
    """Force of a tyre on its wheel.

    Attributes:
        fx: along the heading, N.
        fy: to the left.
        fz: along the normal, the load.
        mz: aligning moment about the normal, N m.
        normalised_slip: normalised slip, 1 is linear saturation.
        slip: longitudinal transient slip.
        tan_slip_angle: lateral transient slip.
    """

    fx: float
    fy: float
    fz: float
    mz: float
    normalised_slip: float
    slip: float
    tan_slip_angle: float


@njit(cache=True)
def frame_axes(q: Quaternion, geometry: Record) -> tuple[Vec, Vec, Vec]:
    """Return the rear frame's x, y and z axes in the map, from the orientation of its principal axes."""
    x, y, z, w = q
    px = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)
    ey = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)
    pz = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    c, s = geometry.cos_principal, geometry.sin_principal
    return mix(c, px, s, pz), ey, mix(-s, px, c, pz)


@njit(cache=True)
def fork_axes(ex: Vec, ey: Vec, ez: Vec, steer: float, geometry: Record) -> tuple[Vec, Vec, Vec]:
    """Return the fork's axes: across the steering axis forward, the front axle, and the steering axis upward."""
    c, s = geometry.cos_tilt, geometry.sin_tilt
    axis = mix(-s, ex, c, ez)
    ahead = mix(c, ex, s, ez)
    cs, ss = math.cos(steer), math.sin(steer)
    return mix(cs, ahead, ss, ey), mix(cs, ey, -ss, ahead), axis


@njit(cache=True)
def rear_axle(ex: Vec, ez: Vec, swing: float, geometry: Record, joints: Record) -> Vec:
    """Return the arm from the frame's centre of mass to the rear axle, m, with the swing arm at an angle, rad."""
    if joints.swing < 0:
        return mix(geometry.axle_x, ex, geometry.axle_z, ez)
    c, s = math.cos(swing), math.sin(swing)
    x, z = geometry.axle_x - joints.pivot_x, geometry.axle_z - joints.pivot_z
    return mix(joints.pivot_x + c * x + s * z, ex, joints.pivot_z + c * z - s * x, ez)


@njit(cache=True)
def axes_of(motion: Motion, geometry: Record, joints: Record) -> Axes:
    """Return axes and arms of the bodies.

    Args:
        motion: of the machine.
        geometry: a record of `records.GEOMETRY`.
        joints: a record of `records.JOINTS`.
    """
    ex, ey, ez = frame_axes(motion.orientation, geometry)
    rear_arm = rear_axle(ex, ez, motion.swing, geometry, joints)
    head_arm = mix(geometry.head_x, ex, geometry.head_z, ez)
    if not joints.any:
        ahead, axle, steering = fork_axes(ex, ey, ez, motion.steer, geometry)
        omega = mix(1.0, motion.omega, motion.steer_rate, steering)
        hub_arm = scale(geometry.hub, ahead)
        return Axes(
            ex, ey, ez, axle, steering, rear_arm, head_arm, hub_arm, omega, rear_arm, head_arm, head_arm, ahead, ahead,
            steering,
        )  # fmt: skip
    # the head twists about an axis square to the steering axis, the fork turns in it, bends and slides
    c, s = geometry.cos_tilt, geometry.sin_tilt
    ahead, up = mix(c, ex, s, ez), mix(-s, ex, c, ez)
    ct, st = math.cos(motion.head), math.sin(motion.head)
    left, steering = mix(ct, ey, st, up), mix(ct, up, -st, ey)
    cs, ss = math.cos(motion.steer), math.sin(motion.steer)
    bending, straight = mix(cs, ahead, ss, left), mix(cs, left, -ss, ahead)
    cb, sb = math.cos(motion.bend), math.sin(motion.bend)
    axle, sliding = mix(cb, straight, sb, steering), mix(cb, steering, -sb, straight)
    twist_arm = mix(1.0, head_arm, joints.head_up, up)
    bend_arm = mix(1.0, twist_arm, joints.bend_up - joints.head_up, steering)
    head = mix(1.0, bend_arm, motion.travel - joints.bend_up, sliding)
    omega = mix(1.0, motion.omega, motion.head_rate, ahead)
    omega = mix(1.0, mix(1.0, omega, motion.steer_rate, steering), motion.bend_rate, bending)
    return Axes(
        ex, ey, ez, axle, steering, rear_arm, head, scale(geometry.hub, bending), omega,
        mix(joints.pivot_x, ex, joints.pivot_z, ez), twist_arm, bend_arm, ahead, bending, sliding,
    )  # fmt: skip


@njit(cache=True)
def lean_of(axle: Vec, normal: Vec) -> tuple[float, float, float, float, float]:
    """Return ``(roll, camber, cos_yaw, sin_yaw, level)`` of a wheel; on level ground exactly those of its axle.

    The roll is the angle of the axle over the horizontal about the wheel's heading, rad, positive leaning right, the
    camber that over the ground; the yaw is that of the heading, seen from above, and `level` the cosine of its slope.

    Args:
        axle: unit vector to the left.
        normal: of the ground, unit vector, upward.
    """
    heading = cross(axle, normal)
    over = math.hypot(heading[0], heading[1])
    length = math.hypot(over, heading[2])
    level = over / length
    flat = math.hypot(axle[0], axle[1])
    # part of the axle along the heading as seen from above, which is none on level ground
    along = -axle[2] * heading[2] / over
    aside = flat * math.sqrt(max(0.0, 1.0 - (along / flat) * (along / flat)))
    roll = math.atan2(axle[2] / level, aside)
    return roll, math.atan2(dot(axle, normal), length), heading[0] / over, heading[1] / over, level


@njit(cache=True)
def lowest_point(centre: Vec, axle: Vec, radius: float, crown: float, normal: Vec) -> Vec:
    """Return the lowest point of a torus, seen along a normal, m.

    Args:
        centre: of the wheel, m.
        axle: unit vector to the left.
        radius: of the wheel with tyre, m.
        crown: radius of the tyre's cross-section, m.
        normal: unit vector, upward.
    """
    lean = dot(axle, normal)
    across = mix(1.0, axle, -lean, normal)
    k = math.sqrt(max(1e-12, across[0] * across[0] + across[1] * across[1] + across[2] * across[2]))
    ring = radius - crown
    # down in the wheel's plane: (lean axle - normal) / k
    return (
        centre[0] + ring * (lean * across[0] / k - k * normal[0]) - crown * normal[0],
        centre[1] + ring * (lean * across[1] / k - k * normal[1]) - crown * normal[1],
        centre[2] + ring * (lean * across[2] / k - k * normal[2]) - crown * normal[2],
    )


@njit(cache=True)
def wheel_contact(centre: Vec, axle: Vec, radius: float, crown: float, patch: Record, profile: Record) -> Contact:
    """Return where a torus meets the ground.

    Args:
        centre: of the wheel, m.
        axle: unit vector to the left.
        radius: of the wheel with tyre, m.
        crown: radius of the tyre's cross-section, m.
        patch: the ground, a record of `ground.PATCH`.
        profile: its bumps, shape (BUMP_SAMPLES,).
    """
    # where the tyre touches depends on the road's slope, what it feels there on the bumps too
    point = lowest_point(centre, axle, radius, crown, smooth_normal(centre[0], centre[1], patch))
    height, normal, smooth = surface_at(point[0], point[1], patch, profile)
    lean = dot(axle, normal)
    left = mix(1.0, axle, -lean, normal)
    k = math.sqrt(max(1e-12, left[0] * left[0] + left[1] * left[1] + left[2] * left[2]))
    left = left[0] / k, left[1] / k, left[2] / k
    heading = cross(left, normal)
    gap = (point[2] - height) * normal[2]
    return Contact(point, gap, heading, left, normal, smooth, lean, radius - crown + crown * k)


@njit(cache=True)
def rolling_wheels(
    motion: Motion, axes: Axes, rear: Contact, front: Contact, joints: Record
) -> tuple[Rolling, Rolling]:
    """Return how the rear and the front wheel move at their contacts."""
    omega = motion.omega
    rear_velocity = add(motion.velocity, cross(omega, mix(1.0, rear.point, -1.0, motion.position)))
    rear_omega = omega
    if joints.any:
        pivot = add(motion.position, axes.pivot_arm)
        rear_omega = mix(1.0, omega, motion.swing_rate, axes.ey)
        rear_velocity = mix(1.0, rear_velocity, motion.swing_rate, cross(axes.ey, mix(1.0, rear.point, -1.0, pivot)))
        twisting = mix(1.0, omega, motion.head_rate, axes.ahead)
        turning = mix(1.0, twisting, motion.steer_rate, axes.steering)
        bend = add(motion.position, axes.bend_arm)
        bend_velocity = add(motion.velocity, cross(omega, axes.twist_arm))
        bend_velocity = add(bend_velocity, cross(turning, mix(1.0, axes.bend_arm, -1.0, axes.twist_arm)))
        front_velocity = add(bend_velocity, cross(axes.fork_omega, mix(1.0, front.point, -1.0, bend)))
        front_velocity = mix(1.0, front_velocity, motion.travel_rate, axes.sliding)
    else:
        head_velocity = add(motion.velocity, cross(omega, axes.head_arm))
        head = add(motion.position, axes.head_arm)
        front_velocity = add(head_velocity, cross(axes.fork_omega, mix(1.0, front.point, -1.0, head)))
    return (
        Rolling(rear_velocity, rear_omega, axes.ey, motion.rear_rate),
        Rolling(front_velocity, axes.fork_omega, axes.axle, motion.front_rate),
    )


@njit(cache=True)
def tyre_force(
    slip: float, tan_slip_angle: float, contact: Contact, wheel: Rolling, grip: float, dt: float, tyre: Record
) -> TyreForce:
    """Return what a tyre does, with its transient slips after the step.

    Args:
        slip: longitudinal transient slip before the step.
        tan_slip_angle: lateral transient slip before the step.
        contact: of the wheel.
        wheel: its motion.
        grip: factor on friction.
        dt: time step, s.
        tyre: its parameters.
    """
    # In the machine the tyre's spring lies between the road and the suspension's damper, which so does not feel how
    # steep a short bump is; here both act side by side, and the damper knows the road without bumps.
    load = tyres.normal_load(contact.gap - tyre.sag, dot(wheel.velocity, contact.smooth), tyre)
    along = dot(wheel.velocity, contact.heading)
    # the contact wanders along the ground with the wheel's centre, whatever the pitch rate of its carrier
    speed = abs(along + dot(wheel.carrier, wheel.axle) * contact.radius)
    slip = tyres.relax(slip, wheel.rate * contact.radius - along, speed, tyre.slip_relaxation, dt)
    aside, length = dot(wheel.velocity, contact.left), tyre.relaxation
    if tyre.magic_formula.on != 0.0:
        # its fits take the side slip of the crown's centre
        aside += tyre.crown * dot(cross(wheel.carrier, contact.normal), contact.left)
        length = magic_formula.relaxation_length(max(load, 1.0), speed, tyre.magic_formula)
    camber = math.asin(min(max(contact.lean, -1.0), 1.0))
    if tyre.camber_lag != 0.0:
        # camber counts as the side slip of the same force
        aside += speed * tyre.camber / tyres.cornering_coefficient(load, tyre) * camber
        camber = 0.0
    tan_slip_angle = tyres.relax(tan_slip_angle, aside, speed, length, dt)
    if load <= 0.0:
        slip = tan_slip_angle = 0.0  # a tyre in the air forgets
    fx, fy, mz, normalised_slip = tyres.forces(slip, tan_slip_angle, camber, load, grip, tyre)
    return TyreForce(fx, fy, load, mz, normalised_slip, slip, tan_slip_angle)
