"""The virtual rider of a superbike: from a command to lean by steering torque, and his body across the machine.

Countersteering is in the sign: a torque to the left makes the machine lean to the right. What the front tyre does with
steering goes with its load, and so do the rider's hands. When the wheel is light he holds the bars straight, so that it
does not land across.
"""

from __future__ import annotations

import math
from typing import Final

from numba import njit

from bike_sim.physics.superbike.aids import between
from bike_sim.physics.superbike.records import Attitude, Motion
from bike_sim.vehicles.superbike import Record

_FEELING_LAG: Final = 0.2  # s until the rider feels a change of the front wheel's load
_ARM_STIFFNESS: Final = 300.0  # N m/rad of arms that hold the bars straight while the front wheel is in the air
_ARM_DAMPING: Final = 20.0  # N m s/rad
_LIGHT: Final = 0.5  # part of the standing machine's front load below which the wheel feels light
_LIGHTEST_HAND: Final = 0.25  # part of the gains left when the front wheel is in the air
_STOP_STIFFNESS: Final = 4000.0  # N m/rad of the steering stop
_STOP_DAMPING: Final = 20.0  # N m s/rad


@njit(cache=True)
def feel_load(front_load: float, dt: float, memory: Record, constants: Record) -> float:
    """Return the front load that the rider feels by that of the standing machine, and advance the feeling."""
    memory.front_load += (front_load - memory.front_load) * -math.expm1(-dt / _FEELING_LAG)
    return memory.front_load / (constants.geometry.front_static * constants.front_tyre.stiffness)


@njit(cache=True)
def _advance_reference(steering: float, gyro: float, dt: float, memory: Record, rider: Record) -> tuple[float, float]:
    """Return the reference lean (rad) and its rate after the step: critically damped, no faster than torque allows."""
    limit = min(rider.lean_rate, rider.gyro_share * rider.torque / max(gyro, 1e-6))
    target = -steering * math.radians(rider.max_lean_deg)
    lean, rate, wn = memory.lean_reference, memory.lean_reference_rate, rider.frequency
    change = wn * (wn * (target - lean) - 2.0 * rate)
    rate += dt * min(max(change, -rider.lean_acceleration), rider.lean_acceleration)
    rate = min(max(rate, -limit), limit)
    lean += dt * rate
    memory.lean_reference, memory.lean_reference_rate = lean, rate
    return lean, rate


@njit(cache=True)
def steering_torque(
    steering: float, attitude: Attitude, motion: Motion, front_fx: float, load_share: float, dt: float, memory: Record,
    machine: Record, front_crown: float,
) -> float:  # fmt: skip
    """Advance the rider's reference and return his steering torque, N m, positive to the left.

    Args:
        steering: command in [-1, 1], positive to the left.
        attitude: of the machine.
        motion: of its joints.
        front_fx: force along the front wheel's heading, N.
        load_share: front load that the rider feels by that of the standing machine.
        dt: time step, s.
        memory: advanced.
        machine: its constants.
        front_crown: m.
    """
    rider = machine.virtual_rider
    fast = between(attitude.speed, machine.steering.slow, machine.steering.fast)
    gyro = machine.IFyy / machine.rF * math.cos(machine.lam) * abs(attitude.speed)
    lean, rate = _advance_reference(steering, gyro, dt, memory, rider)
    error = lean - attitude.roll
    bound = rider.integral_torque
    integral = min(max(memory.integral + dt * rider.integral_gain * error, -bound), bound)
    memory.integral = integral
    damping = rider.rate_gain_slow + fast * (rider.rate_gain_fast - rider.rate_gain_slow)
    braking = -min(front_fx, 0.0) * front_crown * math.sin(attitude.roll) * math.cos(machine.lam)
    hand = min(max(load_share / _LIGHT, _LIGHTEST_HAND), 1.0)
    ahead = hand * gyro * rate + braking - load_share * rider.hold_torque * math.sin(lean)
    arms = (1.0 - hand) * (_ARM_STIFFNESS * motion.steer + _ARM_DAMPING * motion.steer_rate)
    torque = hand * (rider.lean_gain * error + damping * (rate - attitude.roll_rate) + integral) + ahead - arms
    return min(max(torque, -rider.torque), rider.torque)


@njit(cache=True)
def damper_and_stop(steer: float, steer_rate: float, speed: float, machine: Record) -> float:
    """Return the torque of the steering damper and, beyond the largest angle, of the stop, N m."""
    steering = machine.steering
    fast = between(speed, steering.slow, steering.fast)
    torque = -(steering.damper_slow + fast * (steering.damper_fast - steering.damper_slow)) * steer_rate
    if abs(steer) > machine.max_steer:
        torque -= _STOP_STIFFNESS * (steer - math.copysign(machine.max_steer, steer)) + _STOP_DAMPING * steer_rate
    return torque


@njit(cache=True)
def slide_force(motion: Motion, lean_reference: float, rider: Record) -> float:
    """Return the force on the rider's slide, N to the left: he leads with the lean that he rides to."""
    lean_share = min(max(lean_reference / math.radians(rider.slide_lean_deg), -1.0), 1.0)
    ws = rider.slide_frequency
    return rider.mass * ws * (ws * (-rider.slide * lean_share - motion.slide) - 2.0 * motion.slide_rate)
