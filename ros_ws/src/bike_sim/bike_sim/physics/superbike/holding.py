"""The steering torque that holds a steady turn, in closed form: what the rider has learnt of his machine."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import mapping, tyres
from bike_sim.physics import state as st
from bike_sim.physics import superbike_statics as statics
from bike_sim.physics.superbike.contact import lowest_point
from bike_sim.physics.superbike.records import HOLDING_LEAN, HOLDING_SAMPLES
from bike_sim.vehicles.superbike import Record, Superbike

FloatArray = NDArray[np.float64]


HOLDING_SPEEDS: Final = (40.0, 12.0)
"""Speeds between which the torque by the load is linear in the inverse square of the speed, m/s."""


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
    return np.array([rows[0] - fast * slope, slope])


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
    reference = mapping.layout(vehicle)
    frame = mapping.axis_angle(np.array([1.0, 0.0, 0.0]), lean)
    fork = mapping.multiply(frame, mapping.axis_angle(reference.steering_axis, steer))
    axis = mapping.rotate(frame, reference.steering_axis)
    axle = mapping.rotate(fork, np.array([0.0, 1.0, 0.0]))
    hub, middle = (
        mapping.rotate(fork, reference.centres[i] - reference.head) for i in (mapping.FRONT_WHEEL, mapping.FORK)
    )
    tyre = vehicle.front_tyre
    level = math.hypot(axle[0], axle[1])
    point = np.array(lowest_point(tuple(hub), tuple(axle), vehicle.rF, tyre.crown, (0.0, 0.0, 1.0)))
    heading, left = np.array([axle[1], -axle[0], 0.0]) / level, np.array([axle[0], axle[1], 0.0]) / level
    thrust = statics.drag(vehicle, speed)
    _, load = statics.wheel_loads(vehicle, lean, speed, thrust)
    side = statics.side_forces(vehicle, lean, speed)[1]
    moment = _moment_at(side, math.asin(axle[2]), load, vehicle.tyres[1])
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
        drift = 0.5 * (low + high)
        low, high = (drift, high) if -tyres.forces(0.0, drift, camber, load, 1.0, tyre)[1] < side else (low, drift)
    return float(tyres.forces(0.0, 0.5 * (low + high), camber, load, 1.0, tyre)[2])
