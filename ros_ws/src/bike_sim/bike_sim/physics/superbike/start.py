"""How a superbike begins a ride: from a minimal state to the motion of all its bodies, and its memory."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.ground import Ground
from bike_sim.physics.state import StateVector
from bike_sim.physics.superbike.poses import Footing, footing, offsets, settle
from bike_sim.physics.superbike.records import MEMORY
from bike_sim.physics.superbike.virtual_rider import holding, unmeant_turn
from bike_sim.physics.tree import Body, Slider, vehicle_tree
from bike_sim.physics.vectors import Quaternion, Vec, add, after, cross, mix, scale, turn_about, turned
from bike_sim.vehicles.superbike import Record, Superbike

Array = NDArray[np.float64]

_FRESH: Final = 1e3
"""s since the last slide after a reset: long ago."""


NO_POSE: Final = 1
NO_ROLLING: Final = 2
"""Why there is no start: no configuration with both wheels on the ground, no rolling motion."""

_X: Final = (1.0, 0.0, 0.0)
_Y: Final = (0.0, 1.0, 0.0)
_Z: Final = (0.0, 0.0, 1.0)


class Start(NamedTuple):
    """Motion of the frame without rider and of the joints, in the order of `tree.LINKS` and then the rider's slide.

    Attributes:
        fault: why there is none, or 0.
        position: of the frame's centre of mass, m. orientation: of its principal axes, quaternion (x, y, z, w).
        velocity: m/s. omega: rad/s, in map axes.
        joints: rad and m. rates: rad/s and m/s.
        x: of the rear wheel's centre, m. y: the same, m.
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
    """Return the bodies of a machine: frame, wheels, fork and the rider on his slide."""
    rider = vehicle.rider
    slider = Slider(rider.mass, (rider.x, 0.0, rider.height), (rider.Ixx, rider.Iyy, rider.Izz))
    return vehicle_tree(without_rider(vehicle), slider)


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
    front_radius = machine.rF - constants[0].front_tyre.crown * (1.0 - math.cos(camber))
    rear_radius = machine.rR - constants[0].rear_tyre.crown * (1.0 - math.cos(camber))
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
    memory.front_load = constants.geometry.front_static * constants.front_tyre.stiffness
    memory.intent = memory.arms = memory.front_load * holding(roll, speed, constants.holding)
    memory.held_steer = state[st.STEER]
    turn = kinematics.yaw_rate(state, parameters) * math.cos(roll)
    memory.torso_turn = unmeant_turn(turn, roll, speed, constants.machine)
    memory.measured_roll_rate = state[st.ROLL_RATE]
    memory.slide_age = _FRESH
