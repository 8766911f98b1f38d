"""All forces on a superbike at one instant, in one compiled function: tyres, air, engine, brakes, rider.

The engine hands in the motion of the rear frame and the joints, and gets forces and torques back; who integrates the
bodies does not matter here. Everything that has a memory (transient slips, lags, the rider's reference, the history
of slides) lives in one record and is advanced by one step in the same call. The parts are in
`bike_sim.physics.superbike`, one subject a module; vectors are in map axes (z up).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.multibody.vectors import Vec, add, cross, dot, mix, scale
from bike_sim.physics.superbike import tyres
from bike_sim.physics.superbike.contact import (
    Axes,
    Contact,
    Rolling,
    TyreForce,
    axes_of,
    lean_of,
    rolling_wheels,
    tyre_force,
    wheel_contact,
)
from bike_sim.physics.superbike.drive import DriveOutput, WheelState, drive_and_brake, write_drive_telemetry
from bike_sim.physics.superbike.records import Attitude, Command, Motion
from bike_sim.physics.superbike.rider import damper_and_stop, feel_load, slide_force, steady_torque, steering_torque
from bike_sim.physics.superbike.suspension import (
    chain_load,
    moment_about,
    rear_unit_load,
    strut_force,
    write_suspension,
)
from bike_sim.schema import SIGNALS
from bike_sim.vehicles.superbike import Record

Array = NDArray[np.float64]


FALL_NAMES: Final = ("none", "low_side", "high_side", "tip_over", "stoppie", "wheelie")
NO_FALL: Final = FALL_NAMES.index("none")
LOW_SIDE: Final = FALL_NAMES.index("low_side")
HIGH_SIDE: Final = FALL_NAMES.index("high_side")
TIP_OVER: Final = FALL_NAMES.index("tip_over")
STOPPIE: Final = FALL_NAMES.index("stoppie")
WHEELIE: Final = FALL_NAMES.index("wheelie")

_SLIDING: Final = 1.15  # times the peak slip from which a tyre counts as sliding
_SLIDE_LEAN_MIN: Final = 0.15  # rad; upright a slide has no side
_SLIDE_MEMORY: Final = 1.5  # s a slide explains a fall
_THROWN_RATE: Final = 6.0  # rad/s of roll away from the slide at which nobody stays on
_SPUN: Final = math.cos(math.radians(60.0))  # of the angle between heading and velocity at which a slide is a crash
_SLIDE_SPEED: Final = 4.0  # m/s; what slips while falling over at a walk is no slide
_OVER: Final = math.sin(math.radians(55.0))  # pitch beyond every machine's point of balance

TELEMETRY_NAMES: Final = SIGNALS.columns
"""Columns of the telemetry; `bike_sim.schema.SIGNALS` describes each."""

TELEMETRY: Final = np.dtype([(name, np.float64) for name in TELEMETRY_NAMES])

_CREEP: Final = 0.1
"""Speed, m/s, below which the resistance of loose ground fades, so that it never pushes a standing wheel."""


@njit(cache=True)
def fall_of(
    attitude: Attitude, nose_up: float, slip: float, rear_load: float, front_load: float, dt: float, fall_roll: float,
    memory: Record,
) -> int:  # fmt: skip
    """Return how the machine falls at this instant, or `NO_FALL`, and remember slides.

    Args:
        attitude: of the machine; its camber is the roll to the normal of the ground.
        nose_up: part of the frame's forward axis along that normal.
        slip: the larger normalised slip of the tyres, by that of their peak.
        rear_load: N.
        front_load: N.
        dt: time step, s.
        fall_roll: rad, a larger roll is a fall.
        memory: of slides.
    """
    size, roll = math.sqrt(attitude.squared_speed), attitude.camber
    if size > _SLIDE_SPEED and slip > _SLIDING and abs(roll) > _SLIDE_LEAN_MIN:
        memory.slide_side, memory.slide_age = math.copysign(1.0, roll), 0.0
    else:
        memory.slide_age += dt
    slid = memory.slide_age < _SLIDE_MEMORY
    side = memory.slide_side
    if nose_up < -_OVER and rear_load <= 0.0:
        return STOPPIE
    if nose_up > _OVER and front_load <= 0.0:
        return WHEELIE
    if slid and attitude.roll_rate * side < -_THROWN_RATE:
        return HIGH_SIDE
    if size > _SLIDE_SPEED and attitude.speed < _SPUN * size:
        return LOW_SIDE
    if abs(roll) > fall_roll:
        if not slid:
            return TIP_OVER
        return LOW_SIDE if roll * side > 0.0 else HIGH_SIDE
    return NO_FALL


class Loads(NamedTuple):
    """Generalised forces on the tree of bodies.

    Whatever acts on a link acts on the frame as if the joints were locked, and on each joint on the way by its moment
    about that joint's axis. What two bodies do to each other shows on their joint only. So nobody needs the links'
    poses but this module.

    Attributes:
        force: on the whole machine, N.
        torque: about the frame's centre of mass, N m; both in map axes.
        rear: moment on the joint of the rear wheel, N m.
        steer: on the steering.
        front: on that of the front wheel.
        slide: force on the rider's slide, N.
        swing: moment on the swing arm's joint, N m.
        travel: force along the fork, N, positive pressing it together.
        head: moment on the joint in which the head twists, N m.
        bend: on that in which the fork bends.
        fall: index of `FALL_NAMES`.
    """

    force: Vec
    torque: Vec
    rear: float
    steer: float
    front: float
    slide: float
    swing: float
    travel: float
    head: float
    bend: float
    fall: int


class Acting(NamedTuple):
    """All that acts on a machine at one instant, part by part.

    Attributes:
        axes: of the bodies.
        rear_contact: of the rear wheel with the ground.
        front_contact: of the front wheel.
        rear_wheel: motion of the rear wheel.
        front_wheel: of the front wheel.
        rear: force of the rear tyre.
        front: of the front tyre.
        rear_centre: of the rear wheel, m.
        front_centre: of the front wheel, m.
        attitude: of the machine.
        rear_spin: state of the rear wheel for engine and brakes.
        front_spin: of the front wheel.
        driven: torques of engine and brakes.
        steer_torque: of the rider on the bars, N m.
        fork_torque: the same with damper and stop, N m.
        rider_force: on the rider's slide, N.
        wind: velocity in the moving air, m/s.
    """

    axes: Axes
    rear_contact: Contact
    front_contact: Contact
    rear_wheel: Rolling
    front_wheel: Rolling
    rear: TyreForce
    front: TyreForce
    rear_centre: Vec
    front_centre: Vec
    attitude: Attitude
    rear_spin: WheelState
    front_spin: WheelState
    driven: DriveOutput
    steer_torque: float
    fork_torque: float
    rider_force: float
    wind: Vec


@njit(cache=True)
def acting_at(
    motion: Motion, command: Command, ground: Record, bumps: Array, memory: Record, constants: Record
) -> Acting:
    """Return what acts at this instant and advance the memory by one step; arguments as of `loads_at`."""
    machine, dt = constants.machine, command.dt
    joints = constants.joints
    axes = axes_of(motion, constants.geometry, joints)
    rear_centre = add(motion.position, axes.rear_arm)
    front_centre = add(add(motion.position, axes.head_arm), axes.hub_arm)
    profile = bumps[ground.profile]
    rear_contact = wheel_contact(
        rear_centre, axes.ey, machine.rR, constants.machine.rear_tyre.crown, ground.rear, profile
    )
    front_contact = wheel_contact(
        front_centre, axes.axle, machine.rF, constants.machine.front_tyre.crown, ground.front, profile
    )
    rear_wheel, front_wheel = rolling_wheels(motion, axes, rear_contact, front_contact, joints)
    rear = tyre_force(
        memory.rear_slip,
        memory.rear_tan_slip_angle,
        rear_contact,
        rear_wheel,
        ground.rear.grip,
        dt,
        constants.machine.rear_tyre,
    )
    front = tyre_force(
        memory.front_slip,
        memory.front_tan_slip_angle,
        front_contact,
        front_wheel,
        ground.front.grip,
        dt,
        constants.machine.front_tyre,
    )
    memory.rear_slip, memory.rear_tan_slip_angle = rear.slip, rear.tan_slip_angle
    memory.front_slip, memory.front_tan_slip_angle = front.slip, front.tan_slip_angle

    attitude = attitude_of(motion, axes.ey, rear_contact.normal)
    rear_spin = WheelState(dot(rear_wheel.carrier, axes.ey) + motion.rear_rate, rear_contact.radius, rear)
    front_spin = WheelState(dot(axes.fork_omega, axes.axle) + motion.front_rate, front_contact.radius, front)
    driven = drive_and_brake(command, attitude, rear_spin, front_spin, memory, constants)
    share = feel_load(front.fz, command.lags.feeling, memory, constants)
    turn = dot(motion.omega, axes.ez)
    steady = steady_torque(attitude, front.fx, driven.brake_rate, memory, constants)
    steer_torque = steering_torque(command, attitude, motion, turn, steady, share, memory, constants)
    fork_torque = steer_torque + damper_and_stop(motion.steer, motion.steer_rate, attitude.speed, machine)
    return Acting(
        axes, rear_contact, front_contact, rear_wheel, front_wheel, rear, front, rear_centre, front_centre, attitude,
        rear_spin, front_spin, driven, steer_torque, fork_torque,
        slide_force(motion, memory.lean_reference, machine.rider), air_speed(motion.velocity, ground),
    )  # fmt: skip


@njit(cache=True)
def loads_at(
    motion: Motion, command: Command, ground: Record, bumps: Array, memory: Record, telemetry: Record,
    constants: Record, log_telemetry: bool,
) -> Loads:  # fmt: skip
    """Return all forces at this instant and advance the memory by one step.

    Args:
        motion: of frame and joints.
        command: of the step.
        ground: a record of `ground.GROUND`.
        bumps: profiles, see `ground.Ground`.
        memory: a record of `MEMORY`, advanced.
        telemetry: a record of `TELEMETRY`, written.
        constants: a record of `CONSTANTS`.
        log_telemetry: whether the telemetry of this step is wanted; that of a fall is written always.
    """
    machine, joints = constants.machine, constants.joints
    acting = acting_at(motion, command, ground, bumps, memory, constants)
    axes, driven, rear, front, wind = acting.axes, acting.driven, acting.rear, acting.front, acting.wind
    rear_force, rear_moment = at_wheel(
        acting.rear_contact, rear, acting.rear_wheel, acting.rear_centre, ground.rear.drag
    )
    front_force, front_moment = at_wheel(
        acting.front_contact, front, acting.front_wheel, acting.front_centre, ground.front.drag
    )
    force, torque = total_wrench(motion, axes, wind, rear_force, rear_moment, front_force, front_moment, constants)
    rear_joint = driven.rear + dot(axes.ey, rear_moment)
    front_joint = driven.front + dot(axes.axle, front_moment)
    swing = travel = head = bend = 0.0
    if joints.any:
        arm = add(axes.head_arm, axes.hub_arm)
        steer_joint = acting.fork_torque + moment_about(axes.steering, axes.twist_arm, arm, front_force, front_moment)
        head = moment_about(axes.ahead, axes.twist_arm, arm, front_force, front_moment)
        bend = moment_about(axes.bending, axes.bend_arm, arm, front_force, front_moment)
        travel = dot(axes.sliding, front_force)
        if joints.travel >= 0:
            travel -= strut_force(motion.travel, motion.travel_rate, joints.fork)
        if joints.swing >= 0:
            swing = moment_about(axes.ey, axes.pivot_arm, axes.rear_arm, rear_force, rear_moment)
            swing += rear_unit_load(motion, joints) + chain_load(driven.drive, axes, joints)
    else:
        steer_joint = acting.fork_torque + dot(axes.steering, add(front_moment, cross(axes.hub_arm, front_force)))

    if memory.fall == NO_FALL:
        upward = dot(axes.ex, acting.rear_contact.normal)
        slip = max(
            rear.normalised_slip / tyres.peak_slip(machine.rear_tyre),
            front.normalised_slip / tyres.peak_slip(machine.front_tyre),
        )
        memory.fall = fall_of(acting.attitude, upward, slip, rear.fz, front.fz, command.dt, machine.fall_roll, memory)
    if log_telemetry or memory.fall != NO_FALL:
        write_drive_telemetry(driven, acting.rear_spin, memory, telemetry, constants)
        telemetry.steer_torque_nm = acting.steer_torque
        telemetry.front_camber_rad = math.asin(min(max(acting.front_contact.lean, -1.0), 1.0))
        size = math.sqrt(dot(wind, wind))
        telemetry.drag_n = 0.5 * machine.air.density * machine.air.drag_area * size * size
        write_telemetry(motion, axes, acting.attitude, (rear, front), force, memory, telemetry, machine)
        if joints.any:
            write_suspension(motion, driven.drive, telemetry, joints)
    return Loads(
        force, torque, rear_joint, steer_joint, front_joint, acting.rider_force, swing, travel, head, bend,
        int(memory.fall),
    )  # fmt: skip


@njit(cache=True)
def attitude_of(motion: Motion, ey: Vec, normal: Vec) -> Attitude:
    """Return what rider and electronics feel; `ey` is the frame's axis to the left, `normal` the ground's."""
    roll, camber, cos_yaw, sin_yaw, level = lean_of(ey, normal)
    velocity, omega = motion.velocity, motion.omega
    return Attitude(
        roll,
        (cos_yaw * omega[0] + sin_yaw * omega[1]) / level,
        camber,
        cos_yaw,
        sin_yaw,
        cos_yaw * velocity[0] + sin_yaw * velocity[1],
        dot(velocity, velocity),
    )


@njit(cache=True)
def at_wheel(contact: Contact, tyre: TyreForce, wheel: Rolling, centre: Vec, drag: float) -> tuple[Vec, Vec]:
    """Return the ground's force on a wheel, N, and its moment about the wheel's centre, N m.

    Loose ground resists with a part `drag` of the load, against the motion of the contact. The resultant of the
    pressure in the furrow goes through the axle of a rolling wheel, so it does not turn the wheel.
    """
    normal, arm = contact.normal, mix(1.0, contact.point, -1.0, centre)
    force = add(mix(tyre.fx, contact.heading, tyre.fy, contact.left), scale(tyre.fz, normal))
    moment = add(cross(arm, force), scale(tyre.mz, normal))
    if drag == 0.0:
        return force, moment
    along = mix(1.0, wheel.velocity, -dot(wheel.velocity, normal), normal)
    furrow = scale(-drag * tyre.fz / math.sqrt(dot(along, along) + _CREEP * _CREEP), along)
    turn = cross(arm, furrow)
    return add(force, furrow), add(moment, mix(1.0, turn, -dot(turn, wheel.axle), wheel.axle))


@njit(cache=True)
def air_speed(velocity: Vec, ground: Record) -> Vec:
    """Return the velocity of the machine in the moving air, m/s."""
    return velocity[0] - ground.wind_x, velocity[1] - ground.wind_y, velocity[2]


@njit(cache=True)
def air_force(velocity: Vec, up: Vec, air: Record) -> Vec:
    """Return drag against the velocity and downforce in the machine's own plane, N."""
    squared = dot(velocity, velocity)
    against = -0.5 * air.density * air.drag_area * math.sqrt(squared)
    return mix(against, velocity, -0.5 * air.density * air.down_area * squared, up)


@njit(cache=True)
def total_wrench(
    motion: Motion, axes: Axes, wind: Vec, rear_force: Vec, rear_moment: Vec, front_force: Vec, front_moment: Vec,
    constants: Record,
) -> tuple[Vec, Vec]:  # fmt: skip
    """Return force and torque on the whole machine about the frame's centre of mass: tyres, air and crankshaft."""
    geometry, machine = constants.geometry, constants.machine
    air = air_force(wind, axes.ez, machine.air)
    air_point = add(motion.position, mix(geometry.air_x, axes.ex, geometry.air_z, axes.ez))
    # the crankshaft's spin momentum turns with the frame
    crank = scale(machine.motor.crank_momentum, cross(axes.ey, motion.omega))
    total = add(add(rear_force, front_force), air)
    torque = add(
        add(rear_moment, cross(axes.rear_arm, rear_force)), cross(mix(1.0, air_point, -1.0, motion.position), air)
    )
    torque = add(torque, add(front_moment, cross(add(axes.head_arm, axes.hub_arm), front_force)))
    return total, add(torque, crank)


@njit(cache=True)
def write_telemetry(
    motion: Motion, axes: Axes, attitude: Attitude, tyre_forces: tuple[TyreForce, TyreForce], force: Vec,
    memory: Record, telemetry: Record, machine: Record,
) -> None:  # fmt: skip
    """Write the telemetry of motion, tyres and rider."""
    rear, front = tyre_forces
    cos_yaw, sin_yaw = attitude.cos_yaw, attitude.sin_yaw
    telemetry.speed_m_s, telemetry.yaw_rate_rad_s = attitude.speed, motion.omega[2]
    telemetry.pitch_rad = -math.asin(min(max(axes.ex[2], -1.0), 1.0))
    velocity, omega, ex = motion.velocity, motion.omega, axes.ex
    telemetry.lateral_velocity_m_s = cos_yaw * velocity[1] - sin_yaw * velocity[0]
    telemetry.vertical_velocity_m_s = velocity[2]
    # the frame's forward axis turns with omega; its vertical part is the sine of the pitch, nose up
    telemetry.pitch_rate_rad_s = (omega[1] * ex[0] - omega[0] * ex[1]) / max(math.hypot(ex[0], ex[1]), 1e-9)
    # acceleration by the forces on the whole machine, along and to the left of its heading
    telemetry.acceleration_long_m_s2 = (cos_yaw * force[0] + sin_yaw * force[1]) / machine.mass
    telemetry.acceleration_lat_m_s2 = (cos_yaw * force[1] - sin_yaw * force[0]) / machine.mass
    telemetry.rear_load_n, telemetry.front_load_n = rear.fz, front.fz
    telemetry.rear_slip, telemetry.front_slip = rear.slip, front.slip
    telemetry.rear_slip_angle_rad = math.atan(rear.tan_slip_angle)
    telemetry.front_slip_angle_rad = math.atan(front.tan_slip_angle)
    telemetry.rear_camber_rad = attitude.camber
    telemetry.rear_force_long_n, telemetry.rear_force_lat_n = rear.fx, rear.fy
    telemetry.front_force_long_n, telemetry.front_force_lat_n = front.fx, front.fy
    telemetry.rear_use, telemetry.front_use = rear.normalised_slip, front.normalised_slip
    telemetry.lean_reference_rad = memory.lean_reference
    rate = machine.virtual_rider.arm_frequency * (memory.lean_eased - memory.lean_reference)
    telemetry.lean_reference_rate_rad_s, telemetry.rider_integral_nm = rate, memory.integral
    telemetry.drive_share, telemetry.brake_share = memory.drive, memory.brake
    telemetry.rider_slide_m, telemetry.fall = motion.slide, memory.fall
