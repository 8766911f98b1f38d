"""The virtual rider of a superbike: from a command to lean by steering torque, and his body across the machine.

Countersteering is in the sign: a torque to the left makes the machine lean to the right. What the front tyre does with
steering goes with its load, and so do the rider's hands. When the wheel is light he holds the bars straight, so that it
does not land across.

What the rider wants reaches the bars through his arms, a critically damped system of 3 Hz: no feedback passes them
faster. At once act only parts of his body that hold on to the bars: the arms' stiffness and damping (Cossalter et al.
2011, The effect of rider's passive steering impedance on motorcycle stability, Meccanica 46, 279-292) and the torso,
which a quick roll or turn leaves behind (that roll and steering torque are linked so was measured: Lot et al.
2018, The link between roll and steering torque in motorcycles; the size is an estimate). Sizes follow from the machine
by rules: `steering_effort`, and `holding` for the torque of a steady turn.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.superbike.drive import between
from bike_sim.physics.superbike.records import HOLDING_LEAN, HOLDING_SAMPLES, Attitude, Command, Lags, Motion
from bike_sim.vehicles.superbike import Record

Array = NDArray[np.float64]

_ARM_STIFFNESS: Final = 400.0  # N m/rad of arms that hold the bars straight while the front wheel is in the air
_ARM_DAMPING: Final = 4.0  # N m s/rad; more of it, like more of the steering damper, makes them weave at full drive
_LIGHT: Final = 0.5  # part of the standing machine's front load below which the wheel feels light
_SLOWEST: Final = 8.0  # m/s below which torque and rate of a steady turn are those at this speed
_TWIST_FROM: Final = 12.0  # m/s from which on a turn twists the torso
_TWIST_WHOLE: Final = 15.0  # m/s from which on it does wholly
_LIGHTEST_HAND: Final = 0.25  # part of the gains left when the front wheel is in the air
_STOP_STIFFNESS: Final = 4000.0  # N m/rad of the steering stop
_STOP_DAMPING: Final = 20.0  # N m s/rad


@njit(cache=True)
def feel_load(front_load: float, closed: float, memory: Record, constants: Record) -> float:
    """Return the front load that the rider feels by that of the standing machine, and advance the feeling."""
    memory.front_load += (front_load - memory.front_load) * closed
    return memory.front_load / (constants.geometry.front_static * constants.machine.front_tyre.stiffness)


@njit(cache=True)
def steering_effort(speed: float, machine: Record) -> tuple[float, float]:
    """Return the torque by lean rate that rolls the machine, N m s/rad, and the torque of the front load at the trail.

    The front wheel's spin resists the lean rate with ``IFyy / rF cos(caster) u``; the trail, at which the standing
    front load acts (N m), helps.
    """
    rider = machine.virtual_rider
    spin = machine.IFyy / machine.rF * math.cos(machine.lam) * abs(speed)
    trail = machine.c * machine.mass * machine.g * machine.com_x / machine.w
    return max(rider.spin_effort * spin - rider.trail_time * trail, 0.0), trail


@njit(cache=True)
def holding(lean: float, speed: float, table: Array) -> float:
    """Return the torque that holds a steady turn by the front load, m.

    Args:
        lean: rad.
        speed: m/s.
        table: of `holding.holding_table`.
    """
    spacing = HOLDING_LEAN / (HOLDING_SAMPLES - 1)
    slow = 1.0 / max(speed, _SLOWEST) ** 2
    at = min(abs(lean) / spacing, HOLDING_SAMPLES - 1.001)
    i = int(at)
    before, after = table[0, i] + slow * table[1, i], table[0, i + 1] + slow * table[1, i + 1]
    return math.copysign(1.0, lean) * (before + (at - i) * (after - before))


@njit(cache=True)
def _advance_reference(
    steering: float, effort: float, dt: float, memory: Record, rider: Record
) -> tuple[float, float, float]:
    """Return the reference lean (rad), its rate and acceleration after the step: critically damped.

    It is no faster than torque allows.
    """
    limit = min(rider.lean_rate, rider.gyro_share * rider.torque / max(effort, 1e-6))
    target = -steering * math.radians(rider.max_lean_deg)
    lean, before, wn = memory.lean_aim, memory.lean_aim_rate, rider.frequency
    change = wn * (wn * (target - lean) - 2.0 * before)
    rate = before + dt * min(max(change, -rider.lean_acceleration), rider.lean_acceleration)
    rate = min(max(rate, -limit), limit)
    lean += dt * rate
    memory.lean_aim, memory.lean_aim_rate = lean, rate
    return lean, rate, (rate - before) / dt


@njit(cache=True)
def through_arms(first: float, second: float, wanted: float, step: float, left: float) -> tuple[float, float]:
    """Return both states of a critically damped system after a step with constant input; exact for any step.

    Args:
        first: state.
        second: state, which follows the first.
        wanted: input.
        step: by the system's time constant.
        left: its negative exponential.
    """
    return wanted + left * (first - wanted), wanted + left * (second - wanted + step * (first - wanted))


@njit(cache=True)
def steering_torque(
    command: Command, attitude: Attitude, motion: Motion, turn: float, steady: float, load_share: float,
    memory: Record, constants: Record,
) -> float:  # fmt: skip
    """Advance reference, arms and torso and return the torque on the bars, N m, positive to the left.

    Args:
        command: of the step.
        attitude: of the machine.
        motion: of its joints.
        turn: rate of the frame about its own upward axis, rad/s.
        steady: torque of :func:`steady_torque`, N m.
        load_share: front load that he feels by that of the standing machine.
        memory: advanced.
        constants: of the machine.
    """
    machine, dt, lags = constants.machine, command.dt, command.lags
    rider = machine.virtual_rider
    effort, trail = steering_effort(attitude.speed, machine)
    aim, aim_rate, acceleration = _advance_reference(command.steering, effort, dt, memory, rider)
    # What he wants reaches the bars through the arms, so he looks for the lean that comes of it as much later
    memory.lean_eased, memory.lean_reference = through_arms(
        memory.lean_eased, memory.lean_reference, aim, lags.arms, lags.arms_left
    )
    error = memory.lean_reference - attitude.roll
    missing = rider.arm_frequency * (memory.lean_eased - memory.lean_reference) - attitude.roll_rate
    hand = min(max(load_share / _LIGHT, _LIGHTEST_HAND), 1.0)
    gain = hand * rider.lean_bandwidth * (effort + rider.lean_time * trail)
    bound = rider.integral_torque
    memory.integral = min(max(memory.integral + dt * rider.integral_rate * gain * error, -bound), bound)
    wanted = gain * error + hand * rider.rate_time * trail * missing + memory.integral
    wanted += hand * effort * aim_rate + rider.throw * acceleration + steady
    wanted = min(max(wanted, -rider.torque), rider.torque)
    memory.intent, memory.arms = through_arms(memory.intent, memory.arms, wanted, lags.arms, lags.arms_left)
    unmeant = unmeant_turn(turn, memory.lean_reference, attitude.speed, machine)
    torque = memory.arms + _passive_torque(hand, missing, unmeant, motion, lags, memory, machine)
    return min(max(torque, -rider.torque), rider.torque)


@njit(cache=True)
def steady_torque(attitude: Attitude, front_fx: float, brake_rate: float, memory: Record, constants: Record) -> float:
    """Return the torque that turning and braking take at this lean, as far ahead as the arms are late, N m.

    Args:
        attitude: of the machine.
        front_fx: force along the front wheel's heading, N.
        brake_rate: rate of the front brake's force, N/s.
        memory: of the ride.
        constants: of the machine.
    """
    machine = constants.machine
    late = 2.0 / machine.virtual_rider.arm_frequency
    lean = attitude.camber + late * attitude.roll_rate
    # his own hand pulls the brake, so he knows what it will do
    brake = late * brake_rate - min(front_fx, 0.0)
    load = memory.front_load + late * brake_rate * machine.com_height * math.cos(attitude.camber) / machine.w
    offset = constants.machine.front_tyre.crown * math.sin(attitude.camber) * math.cos(machine.lam)
    return load * holding(lean, attitude.speed, constants.holding) + brake * offset


@njit(cache=True)
def unmeant_turn(turn: float, lean: float, speed: float, machine: Record) -> float:
    """Return what of a turn (rad/s, about the frame's upward axis) does not go with a lean (rad) and twists the torso.

    Less of it counts at low speed: turns are quick there, and he steers by turning his torso as well.
    """
    meant = -machine.g * math.sin(lean) / max(speed, _SLOWEST)
    return (turn - meant) * between(speed, _TWIST_FROM, _TWIST_WHOLE)


@njit(cache=True)
def _passive_torque(
    hand: float, missing: float, unmeant: float, motion: Motion, lags: Lags, memory: Record, machine: Record
) -> float:
    """Return what arms and torso do to the bars without being asked, N m: at once, as they are parts of a body.

    The arms resist a steering angle that they are not used to, and more so when the front wheel is light. The torso
    does not follow a quick roll (`missing`, rad/s, against the reference), and its inertia follows a turn of the frame
    that he did not mean (`unmeant`, rad/s) late; in both it holds on to the bars. The latter is what keeps weave damped
    near the tyres' limit.
    """
    rider = machine.virtual_rider
    memory.accustomed_steer += (motion.steer - memory.accustomed_steer) * lags.grip
    memory.torso_rate += (missing - memory.torso_rate) * lags.torso
    memory.torso_turn += (unmeant - memory.torso_turn) * lags.twist
    twist = machine.rider.Izz / rider.twist_time * (unmeant - memory.torso_turn)
    stiffness = (
        rider.grip_stiffness * (motion.steer - memory.accustomed_steer) + (1.0 - hand) * _ARM_STIFFNESS * motion.steer
    )
    damping = (rider.grip_damping + (1.0 - hand) * _ARM_DAMPING) * motion.steer_rate
    return hand * (rider.torso_damping * (missing - memory.torso_rate) - twist) - stiffness - damping


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
