"""Pose of a superbike: its minimal state, the pose in which it stands, the start of a ride, and a turn at a wall."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import bodies, kinematics
from bike_sim.physics import state as st
from bike_sim.physics.bodies import FORK_JOINT, FRONT_JOINT, REAR_JOINT, SLIDE_JOINT, vehicle_tree
from bike_sim.physics.ground import Ground
from bike_sim.physics.multibody.tree import Body, Joint, outward
from bike_sim.physics.multibody.vectors import (
    Quaternion,
    Vec,
    add,
    after,
    cross,
    dot,
    mix,
    scale,
    turn_about,
    turned,
)
from bike_sim.physics.state import StateVector
from bike_sim.physics.superbike.contact import (
    fork_axes,
    frame_axes,
    lean_of,
    lowest_point,
    rear_axle,
    smooth_normal,
    surface_at,
)
from bike_sim.physics.superbike.records import FURTHER_JOINTS, MEMORY
from bike_sim.physics.superbike.rider import holding, unmeant_turn
from bike_sim.vehicles.joints import Flexure, Part
from bike_sim.vehicles.superbike import Record, RiderBody, Superbike

Array = NDArray[np.float64]

_FRESH: Final = 1e3
"""s since the last slide after a reset: long ago."""


LARGEST_TREE: Final = 5 + len(FURTHER_JOINTS)
"""Number of bodies of a machine in which all gives way that can."""
_PIECE: Final = 0.05
"""Mass of the piece of the fork between two of its joints, kg; Bullet wants one."""
_PIECE_INERTIA: Final = 1e-4  # kg m2

NO_POSE: Final = 1
NO_ROLLING: Final = 2
"""Faults of a start: no configuration with both wheels on the ground, no rolling motion."""

_X: Final = (1.0, 0.0, 0.0)
_Y: Final = (0.0, 1.0, 0.0)
_Z: Final = (0.0, 0.0, 1.0)


@njit(cache=True)
def state_at(
    position: Vec, orientation: Quaternion, omega: Vec, swing: float, patch: Record, constants: Record
) -> tuple[float, float, float, float, float]:
    """Return ``(x, y, yaw, roll, roll_rate)``: the rear contact point and the frame's angles, seen from above.

    Args:
        position: of the frame's centre of mass, m.
        orientation: of its principal axes.
        omega: rad/s.
        swing: angle of the swing arm, rad.
        patch: the ground under the rear wheel, a record of `ground.PATCH`.
        constants: a record of `CONSTANTS`.
    """
    geometry = constants.geometry
    ex, ey, ez = frame_axes(orientation, geometry)
    centre = add(position, rear_axle(ex, ez, swing, geometry, constants.joints))
    normal = smooth_normal(centre[0], centre[1], patch)
    point = lowest_point(centre, ey, constants.machine.rR, constants.machine.rear_tyre.crown, normal)
    (roll, _, _, _, level), ahead = lean_of(ey, normal), cross(ey, normal)
    size = math.sqrt(dot(ahead, ahead))
    heading = ahead[0] / size, ahead[1] / size
    roll_rate = (heading[0] * omega[0] + heading[1] * omega[1]) / (level * level)
    return point[0], point[1], math.atan2(heading[1], heading[0]), roll, roll_rate


class Footing(NamedTuple):
    """The ground on which a machine is put down.

    Attributes:
        height: of the ground under the rear contact, m.
        normal: there, without bumps.
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
    height, _, normal = surface_at(x, y, grounds[0].rear, profile)
    plane = -(cos * normal[0] + sin * normal[1]) / normal[2]
    reach = wheelbase / math.sqrt(1.0 + plane * plane)
    front_height, _, front = surface_at(x + reach * cos, y + reach * sin, grounds[0].front, profile)
    slope = -(cos * front[0] + sin * front[1]) / front[2]
    return Footing(height, normal, (front_height - height - reach * plane) * normal[2], slope - plane)


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
    return centre, lowest_point(centre, ey, constants[0].machine.rR, constants[0].machine.rear_tyre.crown, normal)


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
    rear_crown, front_crown = constants[0].machine.rear_tyre.crown, constants[0].machine.front_tyre.crown
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
        height = machine.rear_tyre.sag - geometry.rear_static - rear_low[2]
        gap = height + front_low[2] - rise + geometry.front_static - machine.front_tyre.sag
        # the nose turns about the rear axle: a unit of pitch lowers the front contact by its distance ahead
        change = gap / (cr * (front_low[0] - rear_low[0]))
        pitch += change
        if abs(change) < 1e-14:
            return pitch, height
    return math.nan, math.nan


class Start(NamedTuple):
    """Motion of the frame without rider and of the joints, in the order of `bodies.JOINTS` and then the rider's slide.

    Attributes:
        fault: why there is none, or 0.
        position: of the frame's centre of mass, m.
        orientation: of its principal axes, quaternion (x, y, z, w).
        velocity: m/s.
        omega: rad/s, in map axes.
        joints: rad and m.
        rates: rad/s and m/s.
        x: of the rear wheel's centre, m.
        y: the same, m.
    """

    fault: int
    position: Vec
    orientation: Quaternion
    velocity: Vec
    omega: Vec
    joints: Quaternion
    rates: Quaternion
    x: float
    y: float


def without_rider(vehicle: Superbike) -> Superbike:
    """Return the machine whose rear body is the frame alone, for building trees in which the rider is a body."""
    frame = vehicle.frame
    return replace(
        vehicle,
        mB=frame.mass,
        xB=frame.x,
        zB=-frame.height,
        IBxx=frame.Ixx,
        IBxz=-frame.Ixz,
        IByy=frame.Iyy,
        IBzz=frame.Izz,
    )


def superbike_tree(vehicle: Superbike) -> tuple[Body, ...]:
    """Return the bodies of a machine: frame, wheels, fork and the rider on his slide, then what gives way.

    A part that hangs on a further joint is taken out of the body that holds it in the rigid machine.
    """
    rider, joints = vehicle.rider, vehicle.joints
    centre = np.array([rider.x, 0.0, rider.height])
    left = np.array([0.0, 1.0, 0.0])
    slide = Body("rider", rider.mass, centre, _tensor(rider), Joint.PRISMATIC, 0, centre, left)
    tree = list(vehicle_tree(without_rider(vehicle), slide))
    if joints is None:
        return tuple(tree)
    reference = bodies.layout(vehicle)
    steering, ahead = reference.steering_axis, np.array([math.cos(vehicle.lam), 0.0, math.sin(vehicle.lam)])
    frame, rear, fork, front, seat = 0, REAR_JOINT + 1, FORK_JOINT + 1, FRONT_JOINT + 1, SLIDE_JOINT + 1

    def hang(name: str, part: Part, out_of: int, joint: Joint, parent: int, point: Any, axis: Any) -> int:
        """Take a part out of a body and hang it on another; return its number."""
        tree[out_of] = _without(tree[out_of], part)
        mass_centre = np.array([part.x, 0.0, part.height])
        tree.append(Body(name, part.mass, mass_centre, _tensor(part), joint, parent, np.asarray(point), axis))
        return len(tree) - 1

    def flexure(name: str, joint: Flexure, parent: int) -> int:
        """Hang a small piece of the fork on a joint that gives way sideways; return its number."""
        point = reference.head + steering * ((joint.height - reference.head[2]) / steering[2])
        piece = Part(_PIECE, point[0], point[2], *(_PIECE_INERTIA,) * 3, 0.0)
        number = hang(name, piece, fork, Joint.REVOLUTE, parent, point, ahead)
        tree[number] = replace(tree[number], spring=joint.stiffness, damper=joint.damping)
        return number

    carrier = fork
    if joints.swing_arm is not None:
        x, z = joints.swing_arm.pivot
        arm = hang("swing_arm", joints.swing_arm.part, frame, Joint.REVOLUTE, frame, (x, 0.0, z), left)
        tree[rear] = replace(tree[rear], parent=arm)
    if joints.fork_bending is not None:
        carrier = flexure("fork_bending", joints.fork_bending, carrier)
    if joints.fork is not None:
        carrier = hang("fork_slider", joints.fork.part, fork, Joint.PRISMATIC, carrier, reference.head, steering)
    if joints.head is not None:
        head = flexure("head", joints.head, frame)
        tree[fork] = replace(tree[fork], parent=head)
    tree[front] = replace(tree[front], parent=carrier)
    if joints.torso is not None:
        point, along = np.array([joints.torso.x, 0.0, joints.torso.height]), np.array([1.0, 0.0, 0.0])
        torso = hang("torso", joints.torso.part, seat, Joint.REVOLUTE, seat, point, along)
        tree[torso] = replace(tree[torso], spring=joints.torso.stiffness, damper=joints.torso.damping)
    return tuple(tree)


def _without(body: Body, part: Part) -> Body:
    """Return what is left of a body without a part (parallel axes)."""
    mass, centre = body.mass - part.mass, np.array([part.x, 0.0, part.height])
    rest = (body.mass * body.centre - part.mass * centre) / mass
    inertia = body.inertia - _tensor(part) + _offset(body.mass, body.centre) - _offset(part.mass, centre)
    return replace(body, mass=mass, centre=rest, inertia=inertia - _offset(mass, rest))


def _tensor(part: Part | RiderBody) -> Any:
    """Return the inertia tensor of a body about its centre of mass, kg m2, shape (3, 3)."""
    return np.array([[part.Ixx, 0.0, part.Ixz], [0.0, part.Iyy, 0.0], [part.Ixz, 0.0, part.Izz]])


def _offset(mass: float, arm: Any) -> Any:
    """Return the inertia of a point mass (kg) at an arm, m, kg m2, shape (3, 3)."""
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def joint_numbers(tree: Sequence[Body]) -> dict[str, int]:
    """Return the numbers of the joints that give way by their names in `records.FURTHER_JOINTS`, -1 where rigid."""
    numbers = {body.name: number - 1 for number, body in enumerate(tree)}
    names = ("swing_arm", "fork_slider", "head", "fork_bending", "torso")
    return {joint: numbers.get(name, -1) for joint, name in zip(FURTHER_JOINTS, names, strict=True)}


def design_load(tree: Sequence[Body], joint: int, wheels: Mapping[int, tuple[float, float]], gravity: float) -> float:
    """Return the load on a joint of the machine standing in its design pose, N or N m: weight and tyres.

    Args:
        tree: the bodies.
        joint: number of the joint.
        wheels: distance of a wheel's contact ahead of the rear one (m) and its load (N), by number of the wheel's body.
        gravity: m/s2.
    """
    carried = {joint + 1}
    for i in outward(tree):
        if tree[i].parent in carried:
            carried.add(i)
    root, total = tree[joint + 1], 0.0
    forces = [(tree[i].centre, -tree[i].mass * gravity) for i in carried]
    forces += [(np.array([x, 0.0, 0.0]), load) for i, (x, load) in wheels.items() if i in carried]
    for point, force in forces:
        up = np.array([0.0, 0.0, force])
        total += float(root.axis @ (up if root.joint is Joint.PRISMATIC else np.cross(point - root.point, up)))
    return total


def begin(
    vehicle: Superbike, constants: NDArray[np.void], principal: Quaternion, state: StateVector, ground: Ground,
    motion: NDArray[np.void], memory: NDArray[np.void],
) -> None:  # fmt: skip
    """Set motion and memory to those that belong to a minimal state, with the tyres carrying the standing machine.

    The rear wheel rolls without slip; yaw rate and sideways velocity are those of ideal rolling on the plane of the
    ground. Both wheels stand on the bumps, crest or dip that they are on. The rider hangs off as he does at this lean,
    and his arms hold the steady turn of this lean and speed.

    Args:
        vehicle: the machine.
        constants: from `constants.constants_of`.
        principal: turn from the frame's axes to its principal ones, see `tree.principal_axes`.
        state: minimal state, shape (10,).
        ground: under the wheels.
        motion: a record of `articulated.motion_record`, shape (1,), written.
        memory: a record of `records.MEMORY`, shape (1,), written.

    Raises:
        ValueError: no such configuration or rolling motion exists; nothing is written.
    """
    fault = _begin(state, vehicle.parameters, principal, constants, *ground, motion, memory)
    if fault == 0:
        return
    roll, steer = math.degrees(state[st.ROLL]), math.degrees(state[st.STEER])
    if fault == NO_POSE:
        raise ValueError(
            f"no configuration with both wheels on the ground at roll {roll:.1f} deg and steer {steer:.1f} deg of "
            f"vehicle '{vehicle.name}'"
        )
    raise ValueError(f"no rolling motion at roll {roll:.1f} deg and steer {steer:.1f} deg of vehicle '{vehicle.name}'")


@njit(cache=True)
def _begin(
    state: StateVector, parameters: Array, principal: Quaternion, constants: Record, grounds: Record, bumps: Array,
    motions: Record, memories: Record,
) -> int:  # fmt: skip
    """Do as `begin`, and return why there is no start, or 0."""
    x, y, yaw, wheelbase = state[st.X], state[st.Y], state[st.YAW], constants[0].machine.w
    below = footing(x, y, yaw, wheelbase, grounds, bumps)
    start = _start_on(state, parameters, principal, constants, below)
    if start.fault == 0:
        # The road's slope counts where the wheel's centre is, which is not above the contact where the machine leans.
        there = footing(start.x, start.y, yaw, wheelbase, grounds, bumps).normal
        if there != below.normal:
            slope = Footing(below.height, there, below.rise, below.climb)
            start = _start_on(state, parameters, principal, constants, slope)
    if start.fault == 0:
        motion = motions[0]
        for k in range(3):
            motion.position[k], motion.velocity[k], motion.omega[k] = (
                start.position[k],
                start.velocity[k],
                start.omega[k],
            )
        for k in range(4):
            motion.orientation[k], motion.joints[k], motion.rates[k] = (
                start.orientation[k],
                start.joints[k],
                start.rates[k],
            )
        motion.joints[4:] = 0.0
        motion.rates[4:] = 0.0
        _forget(state, parameters, constants[0], memories)
    return start.fault


@njit(cache=True)
def _no_start(fault: int) -> Start:
    three, four = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
    return Start(fault, three, four, three, three, four, four, 0.0, 0.0)


@njit(cache=True)
def _start_on(
    state: StateVector, parameters: Array, principal: Quaternion, constants: Record, ground: Footing
) -> Start:
    """Return the start on the ground under both wheels."""
    machine, normal = constants[0].machine, ground.normal
    roll, steer, yaw = state[st.ROLL], state[st.STEER], state[st.YAW]
    heading, bank = _along(yaw, normal)
    plane = state.copy()
    plane[st.ROLL] = camber = roll - bank
    pitch, above = settle(camber, steer, ground.rise, constants)
    if not math.isfinite(pitch):
        return _no_start(NO_POSE)
    yaw_rate, _, pitch_rate = kinematics.rates(plane, parameters)
    if not (math.isfinite(yaw_rate) and math.isfinite(pitch_rate)):
        return _no_start(NO_ROLLING)
    frame = after(turn_about(_Z, yaw), turn_about(_Y, -math.asin(heading[2])))
    frame = after(after(frame, turn_about(_X, roll)), turn_about(_Y, pitch))
    orientation = after(frame, principal)
    # Where the rear contact lies from the frame says where the frame must be: `above` the plane through the contact
    centre, low = offsets(orientation, normal, constants)
    aside = low[0] * normal[0] + low[1] * normal[1]
    contact = state[st.X], state[st.Y], ground.height
    position = contact[0] - low[0], contact[1] - low[1], ground.height + (above + aside) / normal[2]
    left = turned(frame, _Y)
    front_radius = machine.rF - constants[0].machine.front_tyre.crown * (1.0 - math.cos(camber))
    rear_radius = machine.rR - constants[0].machine.rear_tyre.crown * (1.0 - math.cos(camber))
    speed = state[st.FRONT_WHEEL_RATE] * front_radius
    # it turns with the road into the crest or the dip that it is on
    pitch_rate -= speed * ground.climb / machine.w
    # of the frame about the heading, so that the roll to the vertical has the rate of the state
    steady = heading[2] * (pitch_rate * left[2] + yaw_rate * normal[2]) / (1.0 - heading[2] ** 2)
    omega = add(mix(state[st.ROLL_RATE] + steady, heading, pitch_rate, left), scale(yaw_rate, normal))
    velocity = add(scale(speed, heading), cross(omega, mix(1.0, position, -1.0, contact)))
    rider = machine.rider
    slide = -rider.slide * max(-1.0, min(1.0, math.degrees(roll) / rider.slide_lean_deg))
    joints = state[st.REAR_WHEEL], steer, state[st.FRONT_WHEEL], slide
    rates = speed / rear_radius - pitch_rate, state[st.STEER_RATE], state[st.FRONT_WHEEL_RATE], 0.0
    x, y = position[0] + centre[0], position[1] + centre[1]
    return Start(0, position, orientation, velocity, omega, joints, rates, x, y)


@njit(cache=True)
def _along(yaw: float, normal: Vec) -> tuple[Vec, float]:
    """Return the direction on the ground that has a yaw (rad) from above, and the ground's rise to its left, rad."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    climb = -(cos * normal[0] + sin * normal[1]) / normal[2]
    level = 1.0 / math.sqrt(1.0 + climb * climb)
    over = normal[2] / level  # of the normal along the upward axis across the heading
    return (cos * level, sin * level, climb * level), math.atan2(sin * normal[0] - cos * normal[1], over)


@njit(cache=True)
def _forget(state: StateVector, parameters: Array, constants: Record, memories: Record) -> None:
    """Set a memory to that of a ride beginning in a state, whose steady turn the arms hold."""
    memories[0] = np.zeros(1, dtype=MEMORY)[0]
    memory, roll, speed = memories[0], state[st.ROLL], state[st.FRONT_WHEEL_RATE] * constants.machine.rF
    memory.lean_aim = memory.lean_eased = memory.lean_reference = roll
    memory.front_load = constants.geometry.front_static * constants.machine.front_tyre.stiffness
    memory.intent = memory.arms = memory.front_load * holding(roll, speed, constants.holding)
    memory.accustomed_steer = state[st.STEER]
    turn = kinematics.yaw_rate(state, parameters) * math.cos(roll)
    memory.torso_turn = unmeant_turn(turn, roll, speed, constants.machine)
    memory.measured_roll_rate = state[st.ROLL_RATE]
    memory.slide_age = _FRESH


@njit(cache=True)
def deflect(motions: Record, x: float, y: float, turn: float, share: float, dx: float, dy: float) -> None:
    """Turn a machine about the vertical through a point, slow it down and move it aside.

    Velocities turn with the machine and are scaled, and the wheels' spin with them, so that neither slip nor side slip
    of the tyres changes. Lean and joints stay.

    Args:
        motions: a record of `articulated.motion_record`, shape (1,), changed.
        x: of the point, m.
        y: the same, m.
        turn: rad, positive to the left.
        share: what is left of the velocity.
        dx: of the move, m.
        dy: the same, m.
    """
    motion = motions[0]
    c, s = math.cos(turn), math.sin(turn)
    p, q, v, w = motion.position, motion.orientation, motion.velocity, motion.omega
    p[0], p[1] = x + dx + c * (p[0] - x) - s * (p[1] - y), y + dy + s * (p[0] - x) + c * (p[1] - y)
    v[0], v[1] = share * (c * v[0] - s * v[1]), share * (s * v[0] + c * v[1])
    w[0], w[1] = c * w[0] - s * w[1], s * w[0] + c * w[1]
    half_c, half_s = math.cos(0.5 * turn), math.sin(0.5 * turn)
    qx, qy, qz, qw = q[0], q[1], q[2], q[3]
    q[0], q[1] = half_c * qx - half_s * qy, half_c * qy + half_s * qx
    q[2], q[3] = half_c * qz + half_s * qw, half_c * qw - half_s * qz
    motion.rates[REAR_JOINT] *= share
    motion.rates[FRONT_JOINT] *= share
