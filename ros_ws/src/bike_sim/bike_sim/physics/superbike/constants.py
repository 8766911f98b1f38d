"""All that compiled code knows of a machine: its numbers, its geometry, and the torque that holds a steady turn.

The torque is in closed form: what the rider has learnt of his machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import bodies
from bike_sim.physics import state as st
from bike_sim.physics.multibody.tree import Body, principal_axes
from bike_sim.physics.multibody.vectors import axis_angle, multiply, rotate
from bike_sim.physics.superbike import statics, tyres
from bike_sim.physics.superbike.contact import lowest_point
from bike_sim.physics.superbike.pose import design_load, joint_numbers
from bike_sim.physics.superbike.records import CONSTANTS, HOLDING_LEAN, HOLDING_SAMPLES, STRUT
from bike_sim.vehicles.joints import UNIT_RANGE, UNIT_SAMPLES, Strut
from bike_sim.vehicles.superbike import Record, Superbike

FloatArray = NDArray[np.float64]


def constants_of(vehicle: Superbike, tree: Sequence[Body]) -> NDArray[np.void]:
    """Return the constants of a machine, one record of `CONSTANTS`, shape (1,).

    Args:
        vehicle: the machine.
        tree: its bodies; the frame's centre of mass is the origin of the geometry.
    """
    reference = bodies.layout(vehicle)
    origin = tree[0].centre
    axle, head = reference.centres[bodies.REAR_WHEEL] - origin, reference.head - origin
    hub = reference.centres[bodies.FRONT_WHEEL] - reference.head
    cos_tilt, sin_tilt = math.cos(vehicle.lam), math.sin(vehicle.lam)
    quaternion, _ = principal_axes(tree[0].inertia)
    angle = 2.0 * math.atan2(quaternion[1], quaternion[3])
    x, _ = vehicle.centre_of_mass
    weight = vehicle.mass * vehicle.g
    front = weight * x / vehicle.w
    geometry = {
        "cos_principal": math.cos(angle),
        "sin_principal": math.sin(angle),
        "axle_x": axle[0],
        "axle_z": axle[2],
        "head_x": head[0],
        "head_z": head[2],
        "hub": hub[0] * cos_tilt + hub[2] * sin_tilt,
        "cos_tilt": cos_tilt,
        "sin_tilt": sin_tilt,
        "air_x": vehicle.air.x - origin[0],
        "air_z": vehicle.air.height - origin[2],
        "rear_static": (weight - front) / vehicle.rear_tyre.stiffness,
        "front_static": front / vehicle.front_tyre.stiffness,
        "torque_spacing": vehicle.wheel_torque_spacing,
    }
    constants = np.zeros(1, dtype=CONSTANTS)
    record = constants[0]
    record["machine"] = vehicle.machine
    record["wheel_torque"], record["wheel_gear"] = vehicle.wheel_torque, vehicle.wheel_gear
    record["holding"] = holding_table(vehicle)
    for name, value in geometry.items():
        record["geometry"][name] = value
    loads = {bodies.REAR_JOINT + 1: (0.0, weight - front), bodies.FRONT_JOINT + 1: (vehicle.w, front)}
    _fill_joints(record["joints"], vehicle, tree, loads)
    if vehicle.joints is not None:  # radii and geometry are those of the loaded machine
        for tyre in ("rear", "front"):
            record["machine"][f"{tyre}_tyre"]["sag"] = geometry[f"{tyre}_static"]
    constants.setflags(write=False)
    return constants


def _fill_joints(
    record: Record, vehicle: Superbike, tree: Sequence[Body], loads: Mapping[int, tuple[float, float]]
) -> None:
    """Write what gives way, with the spring forces that hold the design pose.

    Args:
        record: of `records.JOINTS`.
        vehicle: the machine.
        tree: its bodies.
        loads: see `pose.design_load`.
    """
    joints, numbers = vehicle.joints, joint_numbers(tree)
    for name, number in numbers.items():
        record[name] = number
    if joints is None:
        return
    record["any"] = 1
    reference, origin, cosine = bodies.layout(vehicle), tree[0].centre, math.cos(vehicle.lam)
    for name, flexure in (("head_up", joints.head), ("bend_up", joints.fork_bending)):
        record[name] = 0.0 if flexure is None else (flexure.height - reference.head[2]) / cosine
    if joints.fork is not None:
        _fill_strut(record["fork"], joints.fork.strut, design_load(tree, numbers["travel"], loads, vehicle.g))
    if joints.swing_arm is not None:
        arm = joints.swing_arm
        lengths = arm.unit_lengths()
        angles = np.linspace(-UNIT_RANGE, UNIT_RANGE, UNIT_SAMPLES)
        record["unit_length"], record["unit_ratio"] = lengths, np.gradient(lengths, angles, edge_order=2)
        moment = design_load(tree, numbers["swing"], loads, vehicle.g)
        _fill_strut(record["unit"], arm.strut, -moment / float(record["unit_ratio"][(UNIT_SAMPLES - 1) // 2]))
        record["pivot_x"], record["pivot_z"] = arm.pivot[0] - origin[0], arm.pivot[1] - origin[2]
        if arm.chain is not None:
            x, z = arm.chain.countershaft
            record["chain_x"], record["chain_z"] = x - origin[0], z - origin[2]
            record["front_sprocket"], record["rear_sprocket"] = arm.chain.front_sprocket, arm.chain.rear_sprocket


def _fill_strut(record: Record, strut: Strut, preload: float) -> None:
    """Write a spring unit with its force in the design pose, N."""
    record["preload"] = preload
    for name in (STRUT.names or ())[1:]:
        record[name] = getattr(strut, name)


HOLDING_SPEEDS: Final = (40.0, 12.0)
"""Speeds between which the torque by the load is linear in the inverse square of the speed, m/s."""


@lru_cache(maxsize=64)  # most of what an engine takes to be made
def holding_table(vehicle: Superbike) -> FloatArray:
    """Return the torque that holds a steady turn by the front load, shape (2, HOLDING_SAMPLES), over lean.

    The torque, m, is the first row plus the second, m3/s2, by the square of the speed: the slower the turn, the more
    the wheel is steered.
    """
    rows = []
    for speed in HOLDING_SPEEDS:
        row = []
        for lean in np.linspace(0.0, HOLDING_LEAN, HOLDING_SAMPLES):
            load = statics.wheel_loads(vehicle, lean, speed, statics.drag(vehicle, speed))[1]
            row.append(holding_torque(vehicle, float(lean), speed) / load)
        rows.append(np.array(row))
    fast, slow = (1.0 / speed**2 for speed in HOLDING_SPEEDS)
    slope = (rows[1] - rows[0]) / (slow - fast)
    table = np.array([rows[0] - fast * slope, slope])
    table.setflags(write=False)
    return table


def holding_torque(vehicle: Superbike, lean: float, speed: float) -> float:
    """Return the steering torque of a steady turn to the right, N m, positive to the left.

    Balance of moments about the steering axis: the front tyre's forces and moment at the contact, which the torus moves
    towards the lean; weight and centrifugal force of fork and wheel; the wheel's spin that turns with the machine.

    Args:
        vehicle: the machine.
        lean: rad, not negative.
        speed: m/s.
    """
    lateral = statics.steady_lateral(vehicle, lean, speed)
    yaw_rate = -lateral / speed
    steer = float(statics.turning_state(vehicle, speed, lean, yaw_rate)[st.STEER]) if lean else 0.0
    reference = bodies.layout(vehicle)
    frame = axis_angle(np.array([1.0, 0.0, 0.0]), lean)
    fork = multiply(frame, axis_angle(reference.steering_axis, steer))
    axis = rotate(frame, reference.steering_axis)
    axle = rotate(fork, np.array([0.0, 1.0, 0.0]))
    hub, middle = (rotate(fork, reference.centres[i] - reference.head) for i in (bodies.FRONT_WHEEL, bodies.FORK))
    tyre = vehicle.front_tyre
    level = math.hypot(axle[0], axle[1])
    point = np.array(lowest_point(tuple(hub), tuple(axle), vehicle.rF, tyre.crown, (0.0, 0.0, 1.0)))
    heading, left = np.array([axle[1], -axle[0], 0.0]) / level, np.array([axle[0], axle[1], 0.0]) / level
    thrust = statics.drag(vehicle, speed)
    _, load = statics.wheel_loads(vehicle, lean, speed, thrust)
    side = statics.side_forces(vehicle, lean, speed)[1]
    moment = _moment_at(side, math.asin(axle[2]), load, vehicle.machine["front_tyre"])
    force = -tyre.rolling * load * heading - side * left + np.array([0.0, 0.0, load])
    turning = np.cross(point, force) + np.array([0.0, 0.0, moment])
    for mass, arm in ((vehicle.mF, hub), (vehicle.mH, middle)):
        turning += mass * np.cross(arm, [0.0, lateral, -vehicle.g])
    spin = vehicle.IFyy * speed / (vehicle.rF - tyre.crown * (1.0 - level)) * axle
    turning -= np.cross([0.0, 0.0, yaw_rate], spin)
    return float(-turning @ axis)


def _moment_at(side: float, camber: float, load: float, tyre: Record) -> float:
    """Return a tyre's moment, N m, where it pushes to the right with a force (N): at the side slip that this needs."""
    low, high = -1.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if -tyres.forces(0.0, middle, camber, load, 1.0, tyre)[1] < side else (low, middle)
    return float(tyres.forces(0.0, 0.5 * (low + high), camber, load, 1.0, tyre)[2])
