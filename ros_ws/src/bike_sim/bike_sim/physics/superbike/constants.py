"""All that compiled code knows of a machine: its numbers, where things are, and what follows from them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import mapping
from bike_sim.physics.superbike.holding import holding_table
from bike_sim.physics.superbike.records import CONSTANTS
from bike_sim.physics.tree import principal_axes
from bike_sim.vehicles.superbike import Superbike


def constants_of(vehicle: Superbike, bare: Superbike) -> NDArray[np.void]:
    """Return the constants of a machine, one record of `CONSTANTS`, shape (1,).

    Args:
        vehicle: the machine.
        bare: the same whose rear body is the frame without rider; its centre of mass is the origin of the geometry.
    """
    reference = mapping.layout(bare)
    origin = reference.centres[mapping.REAR_FRAME]
    axle, head = reference.centres[mapping.REAR_WHEEL] - origin, reference.head - origin
    hub = reference.centres[mapping.FRONT_WHEEL] - reference.head
    cos_tilt, sin_tilt = math.cos(vehicle.lam), math.sin(vehicle.lam)
    quaternion, _ = principal_axes(mapping.inertia_tensors(bare)[mapping.REAR_FRAME])
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
    record["rear_tyre"], record["front_tyre"] = vehicle.tyres
    record["wheel_torque"] = vehicle.wheel_torque
    record["holding"] = holding_table(vehicle)
    for name, value in geometry.items():
        record["geometry"][name] = value
    constants.setflags(write=False)
    return constants
