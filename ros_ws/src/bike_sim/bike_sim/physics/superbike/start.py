"""How a superbike begins a ride: from a minimal state to the motion of all its bodies, and its memory."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import kinematics, mapping
from bike_sim.physics import state as st
from bike_sim.physics.state import StateVector
from bike_sim.physics.superbike.poses import read_state, settle
from bike_sim.physics.tree import Body, Slider, principal_axes, vehicle_tree
from bike_sim.vehicles.superbike import Superbike

_FRESH: Final = 1e3
"""s since the last slide after a reset: long ago."""


class Start(NamedTuple):
    """Motion of the frame without rider and of the joints, in the order of `tree.LINKS` and then the rider's slide.

    Attributes:
        position: of the frame's centre of mass, m. orientation: of its principal axes, quaternion (x, y, z, w).
        velocity: m/s. omega: rad/s, in map axes.
        joints: rad and m, shape (4,). rates: rad/s and m/s, shape (4,).
    """

    position: mapping.Vector
    orientation: mapping.Vector
    velocity: mapping.Vector
    omega: mapping.Vector
    joints: tuple[float, ...]
    rates: tuple[float, ...]


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
    """Return the bodies of a machine: frame, wheels, fork and the rider on his slide."""
    rider = vehicle.rider
    slider = Slider(rider.mass, (rider.x, 0.0, rider.height), (rider.Ixx, rider.Iyy, rider.Izz))
    return vehicle_tree(without_rider(vehicle), slider)


def start_of(vehicle: Superbike, constants: NDArray[np.void], tree: tuple[Body, ...], state: StateVector) -> Start:
    """Return the motion that belongs to a minimal state, with the tyres carrying the standing machine.

    The rear wheel rolls without slip; yaw rate and sideways velocity are those of ideal rolling. The rider hangs off as
    he does at this lean.

    Args:
        vehicle: the machine.
        constants: from `records.constants_of`.
        tree: from `superbike_tree`.
        state: minimal state, shape (10,).

    Raises:
        ValueError: no such configuration or rolling motion exists.
    """
    roll, steer = state[st.ROLL], state[st.STEER]
    pitch, height = settle(roll, steer, constants)
    if not math.isfinite(pitch):
        raise ValueError(
            f"no configuration with both wheels on the ground at roll {math.degrees(roll):.1f} deg and "
            f"steer {math.degrees(steer):.1f} deg of vehicle '{vehicle.name}'"
        )
    yaw_rate, _, pitch_rate = kinematics.rates(state, vehicle.parameters)
    if not (math.isfinite(yaw_rate) and math.isfinite(pitch_rate)):
        raise ValueError(
            f"no rolling motion at roll {math.degrees(roll):.1f} deg and steer {math.degrees(steer):.1f} deg of "
            f"vehicle '{vehicle.name}'"
        )
    lean = mapping.multiply(
        mapping.axis_angle(np.array([0.0, 0.0, 1.0]), state[st.YAW]),
        mapping.axis_angle(np.array([1.0, 0.0, 0.0]), roll),
    )
    frame = mapping.multiply(lean, mapping.axis_angle(np.array([0.0, 1.0, 0.0]), pitch))
    orientation = mapping.multiply(frame, principal_axes(tree[0].inertia)[0])
    # Where the rear contact comes to lie with the frame at the origin says where the frame must be
    x, y, *_ = read_state((0.0, 0.0, height), tuple(orientation), (0.0, 0.0, 0.0), constants)
    position = np.array([state[st.X] - x, state[st.Y] - y, height])
    heading = np.array([math.cos(state[st.YAW]), math.sin(state[st.YAW]), 0.0])
    omega = state[st.ROLL_RATE] * heading + pitch_rate * mapping.rotate(frame, np.array([0.0, 1.0, 0.0]))
    omega[2] += yaw_rate
    front_radius = vehicle.rF - vehicle.front_tyre.crown * (1.0 - math.cos(roll))
    rear_radius = vehicle.rR - vehicle.rear_tyre.crown * (1.0 - math.cos(roll))
    speed = state[st.FRONT_WHEEL_RATE] * front_radius
    contact = np.array([state[st.X], state[st.Y], 0.0])
    velocity = speed * heading + np.cross(omega, position - contact)
    slide = -vehicle.rider.slide * max(-1.0, min(1.0, math.degrees(roll) / vehicle.rider.slide_lean_deg))
    return Start(
        position,
        orientation,
        velocity,
        omega,
        (state[st.REAR_WHEEL], steer, state[st.FRONT_WHEEL], slide),
        (speed / rear_radius - pitch_rate, state[st.STEER_RATE], state[st.FRONT_WHEEL_RATE], 0.0),
    )


def forget(vehicle: Superbike, constants: NDArray[np.void], roll: float, memory: NDArray[np.void]) -> None:
    """Set a memory, a record of `records.MEMORY` of shape (1,), to that of a ride beginning at a lean (rad)."""
    memory.view(np.float64)[:] = 0.0
    memory["lean_reference"] = roll
    memory["front_load"] = constants["geometry"]["front_static"] * vehicle.front_tyre.stiffness
    memory["slide_age"] = _FRESH
