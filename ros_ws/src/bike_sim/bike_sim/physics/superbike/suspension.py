"""Forces of what gives way: spring units of fork and swing arm, and the chain's on the swing arm.

A joint's load is generalised: a moment about its axis or a force along it. What head, fork bending and torso have, a
linear spring and damper each, belongs to the tree of bodies.
"""

from __future__ import annotations

from numba import njit

from bike_sim.physics.multibody.vectors import Vec, add, cross, dot, mix
from bike_sim.physics.superbike.contact import Axes
from bike_sim.physics.superbike.records import Motion
from bike_sim.vehicles.joints import UNIT_RANGE, UNIT_SAMPLES
from bike_sim.vehicles.superbike import Record


@njit(cache=True)
def strut_force(pressed: float, rate: float, strut: Record) -> float:
    """Return the force with which a spring unit pushes its ends apart, N.

    Args:
        pressed: by how much it is shorter than in the design pose, m.
        rate: of that, m/s, positive while it is pressed together.
        strut: a record of `records.STRUT`.
    """
    force = strut.preload + strut.stiffness * pressed + (strut.bump if rate > 0.0 else strut.rebound) * rate
    if pressed > strut.compression:
        force += strut.stop * (pressed - strut.compression)
    elif pressed < -strut.extension:
        force += strut.stop * (pressed + strut.extension)
    return force


@njit(cache=True)
def unit_at(swing: float, joints: Record) -> tuple[float, float]:
    """Return length (m) and derivative of it (m/rad) of the rear spring unit at an angle of the swing arm, rad."""
    at = min(max((swing + UNIT_RANGE) / (2.0 * UNIT_RANGE) * (UNIT_SAMPLES - 1), 0.0), UNIT_SAMPLES - 1.001)
    i = int(at)
    u = at - i
    ratio = joints.unit_ratio[i] + u * (joints.unit_ratio[i + 1] - joints.unit_ratio[i])
    return joints.unit_length[i] + u * (joints.unit_length[i + 1] - joints.unit_length[i]), ratio


@njit(cache=True)
def rear_unit_load(motion: Motion, joints: Record) -> float:
    """Return the moment of the spring unit on the swing arm, N m, positive lifting the wheel."""
    length, ratio = unit_at(motion.swing, joints)
    middle = joints.unit_length[(UNIT_SAMPLES - 1) // 2]
    return strut_force(middle - length, -ratio * motion.swing_rate, joints.unit) * ratio


@njit(cache=True)
def write_suspension(motion: Motion, torque: float, telemetry: Record, joints: Record) -> None:
    """Write the telemetry of what gives way.

    Args:
        motion: of the joints.
        torque: of the engine on the rear wheel, N m.
        telemetry: written.
        joints: a record of `records.JOINTS`.
    """
    telemetry.fork_travel_m, telemetry.fork_speed_m_s = motion.travel, motion.travel_rate
    telemetry.head_twist_rad = motion.head
    if joints.swing >= 0:
        length, ratio = unit_at(motion.swing, joints)
        telemetry.shock_travel_m = joints.unit_length[(UNIT_SAMPLES - 1) // 2] - length
        telemetry.shock_speed_m_s = -ratio * motion.swing_rate
    if joints.rear_sprocket > 0.0:
        telemetry.chain_force_n = torque / joints.rear_sprocket


@njit(cache=True)
def chain_load(torque: float, axes: Axes, joints: Record) -> float:
    """Return the chain's moment about the swing arm's pivot, N m: its pull along the run that is tight.

    The upper run pulls while the engine drives, the lower one while it brakes. A chain in line with the pivot has none,
    like a motor in the hub, which acts on the wheel against the arm.

    Args:
        torque: of the engine on the rear wheel, N m.
        axes: of the bodies.
        joints: a record of `records.JOINTS`.
    """
    if joints.rear_sprocket == 0.0 or joints.swing < 0:
        return 0.0
    # in the frame's plane: from the wheel's axle to the countershaft
    shaft = mix(joints.chain_x, axes.ex, joints.chain_z, axes.ez)
    line = mix(1.0, shaft, -1.0, axes.rear_arm)
    distance = dot(line, line) ** 0.5
    side = 1.0 if torque >= 0.0 else -1.0
    # the tangent to both sprockets leans against the line of centres by the difference of their radii
    sine = side * (joints.rear_sprocket - joints.front_sprocket) / distance
    cosine = (1.0 - sine * sine) ** 0.5
    unit = mix(1.0 / distance, line, 0.0, line)
    across = cross(unit, axes.ey)  # upward
    pull = mix(cosine, unit, -sine, across)
    top = mix(side * cosine, across, side * abs(sine), unit)
    point = mix(1.0, axes.rear_arm, joints.rear_sprocket, top)
    arm = mix(1.0, point, -1.0, axes.pivot_arm)
    return abs(torque) / joints.rear_sprocket * dot(axes.ey, cross(arm, pull))


@njit(cache=True)
def moment_about(axis: Vec, point: Vec, arm: Vec, force: Vec, moment: Vec) -> float:
    """Return the moment of a wheel's force and moment about a joint's axis, N m.

    Args:
        axis: unit vector.
        point: on the axis, as an arm from the frame's centre of mass, m.
        arm: to the wheel's centre, m.
        force: on the wheel, N.
        moment: about its centre, N m.
    """
    return dot(axis, add(moment, cross(mix(1.0, arm, -1.0, point), force)))
