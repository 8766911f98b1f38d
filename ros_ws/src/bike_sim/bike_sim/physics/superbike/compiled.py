"""Steps of a superbike without PyBullet, for one machine or for rows of many: compiled, without Python objects.

One row is five records: minimal state (a vector), motion (`articulated.motion_record`), memory and telemetry (see
`bike_sim.physics.superbike_forces`), and what the machine is (`records.CONSTANTS`, `articulated.tree_record`). A row
rides bit for bit the same alone and among others.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import articulated
from bike_sim.physics import state as st
from bike_sim.physics.superbike.lags import held
from bike_sim.physics.superbike.poses import state_at
from bike_sim.physics.superbike.records import Command, Motion
from bike_sim.physics.superbike_forces import loads_at
from bike_sim.physics.tree import FORK, FRONT_WHEEL, REAR_WHEEL, SLIDER

Record = Any
Array = NDArray[np.float64]

_LONGEST: Final = 0.1
"""Longest time, s, between two readings of the yaw: far too short for half a turn, so that the yaw is never wrapped."""


@njit(cache=True)
def reading_interval(dt: float) -> int:
    """Return after how many steps of a length (s) the yaw must be read."""
    return max(1, int(_LONGEST / dt))


@njit(cache=True)
def felt(motion: Record) -> Motion:
    """Return the motion of frame and joints as the forces take it."""
    p, q, v, w = motion.position, motion.orientation, motion.velocity, motion.omega
    joints, rates = motion.joints, motion.rates
    return Motion(
        (p[0], p[1], p[2]),
        (q[0], q[1], q[2], q[3]),
        (v[0], v[1], v[2]),
        (w[0], w[1], w[2]),
        rates[REAR_WHEEL],
        joints[FORK],
        rates[FORK],
        rates[FRONT_WHEEL],
        joints[SLIDER],
        rates[SLIDER],
    )


@njit(cache=True)
def read(motion: Record, ground: Record, constants: Record, state: Array) -> None:
    """Write the minimal state, counting turns of yaw on from what stands there."""
    now = felt(motion)
    x, y, yaw, roll, roll_rate = state_at(now.position, now.orientation, now.omega, ground.rear, constants)
    turns = round((state[st.YAW] - yaw) / (2.0 * math.pi))
    state[st.X], state[st.Y], state[st.YAW], state[st.ROLL] = x, y, yaw + 2.0 * math.pi * turns, roll
    state[st.STEER], state[st.STEER_RATE] = now.steer, now.steer_rate
    state[st.REAR_WHEEL], state[st.FRONT_WHEEL] = motion.joints[REAR_WHEEL], motion.joints[FRONT_WHEEL]
    state[st.ROLL_RATE], state[st.FRONT_WHEEL_RATE] = roll_rate, now.front_rate


@njit(cache=True)
def advance(
    state: Array, motion: Record, memory: Record, telemetry: Record, constants: Record, tree: Record, work: Record,
    command: Command, ground: Record, bumps: Array, steps: int,
) -> int:  # fmt: skip
    """Step a machine until a fall or to the end, and return the fall, an index of `superbike_forces.FALL_NAMES`.

    Args:
        state: minimal state, written.
        motion: of the bodies, advanced.
        memory: of the forces, advanced.
        telemetry: of the last step, written.
        constants: of the machine.
        tree: its bodies.
        work: scratch memory.
        command: what is held, with the time step.
        ground: a record of `ground.GROUND`.
        bumps: profiles, see `ground.Ground`.
        steps: number of steps.
    """
    chunk = reading_interval(command.dt)
    for done in range(steps):
        if memory.fall != 0.0:
            break
        telling = done == steps - 1
        loads = loads_at(felt(motion), command, ground, bumps, memory, telemetry, constants, telling)
        if loads.fall != 0:
            break
        joints = (loads.rear, loads.steer, loads.front, loads.slide)
        articulated.accelerate(motion, loads.force, loads.torque, joints, tree, work)
        articulated.integrate(motion, work, command.dt)
        if (done + 1) % chunk == 0:
            read(motion, ground, constants, state)
    read(motion, ground, constants, state)
    return int(memory.fall)


@njit(cache=True)
def advance_one(
    state: Array, motions: Record, memories: Record, telemetries: Record, constants: Record, trees: Record,
    works: Record, command: tuple[float, float, float], grounds: Record, bumps: Array, steps: int,
) -> int:  # fmt: skip
    """Do as `advance` with arrays of one record each, which cost a caller in Python less than records."""
    return advance(
        state, motions[0], memories[0], telemetries[0], constants[0], trees[0], works[0], held(command, constants[0]),
        grounds[0], bumps, steps,
    )  # fmt: skip


@njit(cache=True)
def look_one(
    state: Array, motions: Record, memories: Record, telemetries: Record, constants: Record,
    command: tuple[float, float, float], grounds: Record, bumps: Array,
) -> None:  # fmt: skip
    """Fill minimal state and telemetry without moving anything; the memory is a copy that nobody needs afterwards."""
    read(motions[0], grounds[0], constants[0], state)
    now = felt(motions[0])
    loads_at(now, held(command, constants[0]), grounds[0], bumps, memories[0], telemetries[0], constants[0], True)


@njit(cache=True)
def advance_rows(
    states: Array, motions: Record, memories: Record, telemetries: Record, machines: NDArray[np.int64],
    constants: Record, trees: Record, works: Record, commands: Array, grounds: Record, bumps: Array, dt: float,
    steps: int,
) -> None:  # fmt: skip
    """Step rows of machines, each with its own command held; fallen ones stay where they are.

    Args:
        states: minimal states, shape (n, 10), written.
        motions: shape (n,), advanced.
        memories: shape (n,), advanced; their field `fall` tells who fell.
        telemetries: shape (n,), written.
        machines: which of the constants a row has, shape (n,).
        constants: one record a machine.
        trees: one record a machine.
        works: scratch memory, shape (1,).
        commands: steering and throttle, shape (n, 2).
        grounds: records of `ground.GROUND`, shape (n,); each says which of the profiles its road has.
        bumps: profiles, see `ground.Ground`.
        dt: time step, s.
        steps: number of steps.
    """
    for i in range(states.shape[0]):
        machine = machines[i]
        command = held((commands[i, 0], commands[i, 1], dt), constants[machine])
        advance(
            states[i], motions[i], memories[i], telemetries[i], constants[machine], trees[machine], works[0], command,
            grounds[i], bumps, steps,
        )  # fmt: skip
