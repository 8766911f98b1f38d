"""How a superbike begins a ride: from a minimal state to the motion of all its bodies, and its memory."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import kinematics, mapping
from bike_sim.physics import state as st
from bike_sim.physics.ground import Ground
from bike_sim.physics.state import StateVector
from bike_sim.physics.superbike.poses import Footing, footing, offsets, settle
from bike_sim.physics.superbike.virtual_rider import holding, turn_of
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


def start_of(
    vehicle: Superbike, constants: NDArray[np.void], tree: tuple[Body, ...], state: StateVector, ground: Ground
) -> Start:
    """Return the motion that belongs to a minimal state, with the tyres carrying the standing machine.

    The rear wheel rolls without slip; yaw rate and sideways velocity are those of ideal rolling on the plane of the
    ground. Both wheels stand on the bumps, crest or dip that they are on. The rider hangs off as he does at this lean.

    Args:
        vehicle: the machine.
        constants: from `constants.constants_of`.
        tree: from `superbike_tree`.
        state: minimal state, shape (10,).
        ground: under the wheels.

    Raises:
        ValueError: no such configuration or rolling motion exists.
    """
    x, y, yaw = (float(state[k]) for k in (st.X, st.Y, st.YAW))
    below = footing(x, y, yaw, vehicle.w, *ground)
    start, (x, y) = _start_on(vehicle, constants, tree, state, below)
    # The road's slope counts where the wheel's centre is, which is not above the contact where the machine leans.
    there = footing(x, y, yaw, vehicle.w, *ground).normal
    if there == below.normal:
        return start
    return _start_on(vehicle, constants, tree, state, below._replace(normal=there))[0]


def _start_on(
    vehicle: Superbike, constants: NDArray[np.void], tree: tuple[Body, ...], state: StateVector, ground: Footing
) -> tuple[Start, tuple[float, float]]:
    """Return the start on the ground under both wheels, and where the rear wheel's centre is."""
    roll, steer, yaw = state[st.ROLL], state[st.STEER], state[st.YAW]
    normal = np.array(ground.normal)
    heading, bank = _along(yaw, normal)
    plane = state.copy()
    plane[st.ROLL] = camber = roll - bank
    pitch, above = settle(camber, steer, ground.rise, constants)
    if not math.isfinite(pitch):
        raise ValueError(
            f"no configuration with both wheels on the ground at roll {math.degrees(roll):.1f} deg and "
            f"steer {math.degrees(steer):.1f} deg of vehicle '{vehicle.name}'"
        )
    yaw_rate, _, pitch_rate = kinematics.rates(plane, vehicle.parameters)
    if not (math.isfinite(yaw_rate) and math.isfinite(pitch_rate)):
        raise ValueError(
            f"no rolling motion at roll {math.degrees(roll):.1f} deg and steer {math.degrees(steer):.1f} deg of "
            f"vehicle '{vehicle.name}'"
        )
    frame = mapping.axis_angle(np.array([0.0, 0.0, 1.0]), yaw)
    for axis, angle in (([0.0, 1.0, 0.0], -math.asin(heading[2])), ([1.0, 0.0, 0.0], roll), ([0.0, 1.0, 0.0], pitch)):
        frame = mapping.multiply(frame, mapping.axis_angle(np.array(axis), angle))
    orientation = mapping.multiply(frame, principal_axes(tree[0].inertia)[0])
    # Where the rear contact lies from the frame says where the frame must be: `above` the plane through the contact
    centre, low = offsets(tuple(orientation), tuple(normal), constants)
    aside = low[0] * normal[0] + low[1] * normal[1]
    contact = np.array([state[st.X], state[st.Y], ground.height])
    position = np.array([contact[0] - low[0], contact[1] - low[1], ground.height + (above + aside) / normal[2]])
    left = mapping.rotate(frame, np.array([0.0, 1.0, 0.0]))
    front_radius = vehicle.rF - vehicle.front_tyre.crown * (1.0 - math.cos(camber))
    rear_radius = vehicle.rR - vehicle.rear_tyre.crown * (1.0 - math.cos(camber))
    speed = state[st.FRONT_WHEEL_RATE] * front_radius
    # it turns with the road into the crest or the dip that it is on
    pitch_rate -= speed * ground.climb / vehicle.w
    # of the frame about the heading, so that the roll to the vertical has the rate of the state
    steady = heading[2] * (pitch_rate * left[2] + yaw_rate * normal[2]) / (1.0 - heading[2] ** 2)
    omega = (state[st.ROLL_RATE] + steady) * heading + pitch_rate * left
    omega = omega + yaw_rate * normal
    velocity = speed * heading + mapping.cross(omega, position - contact)
    slide = -vehicle.rider.slide * max(-1.0, min(1.0, math.degrees(roll) / vehicle.rider.slide_lean_deg))
    start = Start(
        position,
        orientation,
        velocity,
        omega,
        (state[st.REAR_WHEEL], steer, state[st.FRONT_WHEEL], slide),
        (speed / rear_radius - pitch_rate, state[st.STEER_RATE], state[st.FRONT_WHEEL_RATE], 0.0),
    )
    return start, (position[0] + centre[0], position[1] + centre[1])


def _along(yaw: float, normal: mapping.Vector) -> tuple[mapping.Vector, float]:
    """Return the direction on the ground that has a yaw (rad) from above, and the ground's rise to its left, rad."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    climb = -(cos * normal[0] + sin * normal[1]) / normal[2]
    level = 1.0 / math.sqrt(1.0 + climb * climb)
    heading = np.array([cos * level, sin * level, climb * level])
    over = normal[2] / level  # of the normal along the upward axis across the heading
    return heading, math.atan2(sin * normal[0] - cos * normal[1], over)


def forget(vehicle: Superbike, constants: NDArray[np.void], state: StateVector, memory: NDArray[np.void]) -> None:
    """Set a memory to that of a ride beginning in a state, with arms that hold the steady turn of its lean and speed.

    Args:
        vehicle: the machine.
        constants: from `constants.constants_of`.
        state: minimal state, shape (10,).
        memory: a record of `records.MEMORY`, shape (1,), written.
    """
    roll, speed = float(state[st.ROLL]), float(state[st.FRONT_WHEEL_RATE]) * vehicle.rF
    memory.view(np.float64)[:] = 0.0
    memory["lean_aim"] = memory["lean_eased"] = memory["lean_reference"] = roll
    memory["front_load"] = constants["geometry"]["front_static"] * vehicle.front_tyre.stiffness
    memory["intent"] = memory["arms"] = memory["front_load"] * holding(roll, speed, constants["holding"][0])
    memory["held_steer"] = state[st.STEER]
    turn = kinematics.yaw_rate(state, vehicle.parameters) * math.cos(roll)
    memory["torso_turn"] = turn - turn_of(roll, speed, constants["machine"][0])
    memory["slide_age"] = _FRESH
