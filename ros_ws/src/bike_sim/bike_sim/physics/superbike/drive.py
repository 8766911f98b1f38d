"""Engine, brakes, rolling resistance and electronics: torques on the wheels of a superbike.

The electronics say how much drive and brake they allow, ahead by statics and after the fact by a cut.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from numba import njit

from bike_sim.physics.superbike import tyres
from bike_sim.physics.superbike.contact import TyreForce
from bike_sim.physics.superbike.records import Attitude, Command
from bike_sim.vehicles.superbike import Record

_THROW_RATE: Final = 1.0  # rad/s of roll at which the electronics keep a wheel as loaded as lying flat
_ROUNDS: Final = 3  # in which friction and the load that it brings to the wheel are found
_LEANING: Final = math.sin(math.radians(45.0))  # sine of the lean from which the brake control is most careful
# Part of a tyre's friction that a turn may take before brakes and engine braking are eased, and from which on they get
# none. Near its limit a tyre has little side stiffness left, and what a brake takes of that makes weave grow.
_EASED_FROM: Final = 0.62
BRAKE_RELEASE_FULL: Final = 0.90


class AidLimits(NamedTuple):
    """Largest forces that the electronics allow, N; infinite without it.

    Attributes:
        traction: drive by traction control.
        wheelie: drive by wheelie control.
        braking: front brake by brake control.
        stoppie: front brake by stoppie control.
        rear: part of rear brake and engine braking that brake control leaves in this turn.
    """

    traction: float
    wheelie: float
    braking: float
    stoppie: float
    rear: float


class AidCuts(NamedTuple):
    """Parts of drive and brakes that the electronics leave by slips and loads: 1 is all, 0 none.

    Attributes:
        traction: of the drive.
        wheelie: of the drive.
        front: of the front brake by its slip.
        rear: of the rear brake.
        stoppie: of the front brake by the rear load.
    """

    traction: float
    wheelie: float
    front: float
    rear: float
    stoppie: float


@njit(cache=True)
def between(value: float, low: float, high: float) -> float:
    """Return 0 at and below `low`, 1 at and above `high`, linear between."""
    return min(max((value - low) / (high - low), 0.0), 1.0)


@njit(cache=True)
def aid_limits(roll: float, roll_rate: float, squared_speed: float, machine: Record) -> AidLimits:
    """Return what each of the electronics allows at this lean and roll rate.

    Statics of the machine as a mass on two wheels, with its centre of mass lowered by the lean, drag and downforce;
    the turn takes its part of the friction ellipse, and `traction_share` of the rest is free; for the front brake
    `brake_share` upright and `brake_share_lean` from 45 deg of lean on, less again where the turn takes most of it.
    """
    air, aids, rear_tyre, front_tyre = machine.air, machine.electronics, machine.rear_tyre, machine.front_tyre
    sin_lean, cos_lean = abs(math.sin(roll)), max(math.cos(roll), 0.2)
    pressure = 0.5 * air.density * squared_speed
    drag, down = pressure * air.drag_area, pressure * air.down_area * cos_lean
    height, air_height = machine.com_height * cos_lean, air.height * cos_lean
    weight = machine.mass * machine.g
    # With thrust T the machine accelerates by (T - drag) / mass, and the front load is front - T height / w
    front = (weight * machine.com_x + down * air.x - drag * (air_height - height)) / machine.w
    rear = weight + down - front
    traction, wheelie, braking, stoppie, hold = math.inf, math.inf, math.inf, math.inf, 1.0
    # a front wheel must also steer and a rear wheel follow, most of all when the machine is thrown over
    thrown = min(1.0, sin_lean + abs(roll_rate) / _THROW_RATE)
    if aids.wheelie_control > 0.0:
        keep = aids.wheelie_load + aids.wheelie_load_lean * thrown
        wheelie = max(0.0, (front - keep) * machine.w / height)
    if aids.stoppie_control > 0.0:
        keep = aids.stoppie_load + aids.stoppie_load_lean * thrown
        stoppie = max(0.0, (rear - keep) * machine.w / height)
    turn = sin_lean / cos_lean
    if aids.traction_control > 0.0:
        traction = _grip_limit(roll, turn, aids.traction_share, rear, height, machine.w, rear_tyre)
    if aids.brake_control > 0.0:
        # beyond half of what the lean leaves a front tyre gives up so much of its side stiffness that the machine hops
        share = aids.brake_share + (aids.brake_share_lean - aids.brake_share) * min(1.0, sin_lean / _LEANING)
        share *= _left_by(turn, roll, front, front_tyre)
        braking = _grip_limit(roll, turn, share, front, height, machine.w, front_tyre)
        hold = _left_by(turn, roll, rear, rear_tyre)
    return AidLimits(traction, wheelie, braking, stoppie, hold)


@njit(cache=True)
def _left_by(turn: float, roll: float, load: float, tyre: Record) -> float:
    """Return the part of its brake that a tyre is left in a turn, whose lateral force by load is given."""
    return 1.0 - between(turn / tyres.friction(roll, load, tyre), _EASED_FROM, BRAKE_RELEASE_FULL)


@njit(cache=True)
def _grip_limit(
    roll: float, turn: float, share: float, load: float, height: float, wheelbase: float, tyre: Record
) -> float:
    """Return the force that a share of the friction left by a turn allows, N; the force itself loads the wheel."""
    reached = load
    for _ in range(1 if tyre.friction_slope == 0.0 else _ROUNDS):
        mu = tyres.friction(roll, reached, tyre)
        left = share * mu * tyre.friction_ratio * math.sqrt(max(0.0, 1.0 - (turn / mu) ** 2))
        # no more than all of the weight can come to the wheel
        transfer = left * height / wheelbase
        if transfer >= 1.0:
            return math.inf
        reached = load / (1.0 - transfer)
    return left * load / (1.0 - transfer)


@njit(cache=True)
def aid_cuts(
    rear_slip: float,
    rear_normalised_slip: float,
    rear_load: float,
    front_normalised_slip: float,
    front_load: float,
    aids: Record,
) -> AidCuts:
    """Return what the electronics leave after the fact.

    Args:
        rear_slip: longitudinal slip of the rear tyre.
        rear_normalised_slip: its normalised slip.
        rear_load: N.
        front_normalised_slip: normalised slip of the front tyre.
        front_load: N.
        aids: the machine's electronics.
    """
    traction = wheelie = front = rear = stoppie = 1.0
    if aids.traction_control > 0.0 and rear_slip > 0.0:
        traction = 1.0 - between(rear_normalised_slip, aids.traction_slip_on, aids.traction_slip_off)
    if aids.wheelie_control > 0.0:
        wheelie = between(front_load, aids.wheelie_load_off, aids.wheelie_load_on)
    if aids.brake_control > 0.0:
        front = 1.0 - between(front_normalised_slip, aids.brake_slip_on, aids.brake_slip_off)
        rear = 1.0 - between(rear_normalised_slip, aids.brake_slip_on, aids.brake_slip_off)
    if aids.stoppie_control > 0.0:
        stoppie = between(rear_load, aids.stoppie_load_off, aids.stoppie_load_on)
    return AidCuts(traction, wheelie, front, rear, stoppie)


_HYSTERESIS: Final = 1.2  # between the wheel speeds of a shift up and of that back; slip falls by as much as 10 %
_REQUEST_MIN: Final = 0.01  # part of full throttle or full brake below which an aid has nothing to hold back


class WheelState(NamedTuple):
    """A wheel as engine and brakes see it.

    Attributes:
        spin: about its axle, rad/s.
        radius: rolling radius, m.
        tyre: its state.
    """

    spin: float
    radius: float
    tyre: TyreForce


class DriveOutput(NamedTuple):
    """Torques of engine and brakes.

    Attributes:
        rear: torque on the rear wheel, N m.
        front: on the front wheel.
        brake_rate: rate of the front brake's force as lever and electronics set it, N/s.
        drive: torque of the engine on the rear wheel, N m.
        front_brake: of the brake, N m.
        rear_brake: the same.
        available: torque of the engine without electronics, N m.
        asked: force of the front brake without them, N.
        limits: of the electronics, ahead.
        cuts: by them, after the fact.
    """

    rear: float
    front: float
    brake_rate: float
    drive: float
    front_brake: float
    rear_brake: float
    available: float
    asked: float
    limits: AidLimits
    cuts: AidCuts


@njit(cache=True)
def _lookup(table: Record, position: float) -> float:
    """Return a table at a fractional index, 0 beyond its end."""
    if position <= 0.0:
        return table[0]
    i = int(position)
    if i >= table.size - 1:
        return 0.0
    return table[i] + (position - i) * (table[i + 1] - table[i])


@njit(cache=True)
def _shifting(position: float, dt: float, memory: Record, constants: Record) -> bool:
    """Return whether the gearbox is between two gears, and advance the gear in the memory.

    It shifts up where another gear begins to pull better, without drive for the motor's `shift_time`, and down at once,
    at an engine speed that is lower by `_HYSTERESIS`.

    Args:
        position: of the wheel's speed in the tables of torque and gear.
        dt: time step, s.
        memory: advanced.
        constants: of the machine.
    """
    last = constants.wheel_gear.size - 1
    gear = constants.wheel_gear[min(max(int(position), 0), last)]
    if memory.gear == 0.0:
        memory.gear = gear  # a ride begins in gear
    elif gear > memory.gear:
        memory.gear, memory.shift = gear, constants.machine.motor.shift_time
    else:
        memory.gear = min(memory.gear, constants.wheel_gear[min(max(int(position * _HYSTERESIS), 0), last)])
    memory.shift = max(memory.shift - dt, 0.0)
    return memory.shift > 0.0


@njit(cache=True)
def _brake_torque(limit: float, spin: float, inertia: float, tyre_torque: float, dt: float) -> float:
    """Return the torque of a brake that can hold up to `limit`, N m: it stops a wheel but never turns it back."""
    return min(max(-(inertia * spin / dt + tyre_torque), -limit), limit)


@njit(cache=True)
def drive_and_brake(
    command: Command, attitude: Attitude, rear: WheelState, front: WheelState, memory: Record, constants: Record
) -> DriveOutput:
    """Return what engine and brakes do.

    Args:
        command: of the step.
        attitude: of the machine.
        rear: rear wheel.
        front: front wheel.
        memory: its lags are advanced.
        constants: of the machine.
    """
    throttle, dt = command.throttle, command.dt
    machine = constants.machine
    motor, brakes = machine.motor, machine.brakes
    memory.drive += (max(throttle, 0.0) - memory.drive) * command.lags.drive
    before = memory.brake
    memory.brake += (max(-throttle, 0.0) - memory.brake) * command.lags.brake
    drive, brake = memory.drive, memory.brake
    memory.measured_roll_rate += (attitude.roll_rate - memory.measured_roll_rate) * command.lags.sensor
    limits = aid_limits(
        attitude.camber, memory.measured_roll_rate, attitude.squared_speed,
        machine,
    )  # fmt: skip
    cuts = aid_cuts(
        rear.tyre.slip,
        rear.tyre.normalised_slip,
        rear.tyre.fz,
        front.tyre.normalised_slip,
        front.tyre.fz,
        machine.electronics,
    )

    available = drive * _lookup(constants.wheel_torque, rear.spin / constants.geometry.torque_spacing)
    if motor.shift_time > 0.0 and _shifting(rear.spin / constants.geometry.torque_spacing, dt, memory, constants):
        available = 0.0
    drive_torque = cuts.traction * cuts.wheelie * min(available, min(limits.wheelie, limits.traction) * rear.radius)
    released = cuts.rear * limits.rear
    rear_brake = (1.0 - brakes.front_share) * brake * released * brakes.force * machine.rR
    asked = brakes.front_share * brake * brakes.force
    allowed = min(limits.stoppie, limits.braking)
    brake_rate = (min(asked, allowed) - min(brakes.front_share * before * brakes.force, allowed)) / dt
    front_brake = cuts.front * cuts.stoppie * min(asked, allowed) * machine.rF
    # closed throttle drags like a brake, and is eased like one; so does rolling resistance
    engine_brake = released * (1.0 - drive) * motor.engine_brake * machine.rR
    rear_hold = rear_brake + engine_brake + constants.machine.rear_tyre.rolling * rear.tyre.fz * rear.radius
    front_hold = front_brake + constants.machine.front_tyre.rolling * front.tyre.fz * front.radius
    rear_torque = drive_torque + _brake_torque(
        rear_hold, rear.spin, machine.IRyy, drive_torque - rear.tyre.fx * rear.radius, dt
    )
    front_torque = _brake_torque(front_hold, front.spin, machine.IFyy, -front.tyre.fx * front.radius, dt)

    return DriveOutput(
        rear_torque, front_torque, brake_rate, drive_torque, front_brake, rear_brake, available, asked, limits, cuts
    )


@njit(cache=True)
def write_drive_telemetry(
    driven: DriveOutput, rear: WheelState, memory: Record, telemetry: Record, constants: Record
) -> None:
    """Write the telemetry of engine, brakes and electronics.

    Args:
        driven: what they did.
        rear: rear wheel.
        memory: with the lags of this step.
        telemetry: written.
        constants: of the machine.
    """
    limits, cuts, available, asked = driven.limits, driven.cuts, driven.available, driven.asked
    drive, brake, rear_radius = memory.drive, memory.brake, rear.radius
    telemetry.drive_torque_nm = driven.drive
    telemetry.engine_power_w = driven.drive * rear.spin / constants.machine.motor.efficiency
    telemetry.front_brake_nm, telemetry.rear_brake_nm = driven.front_brake, driven.rear_brake
    telemetry.traction_cut, telemetry.wheelie_cut = cuts.traction, cuts.wheelie
    telemetry.front_brake_cut, telemetry.rear_brake_cut = cuts.front * cuts.stoppie, cuts.rear
    drives, brakes = drive > _REQUEST_MIN, brake > _REQUEST_MIN
    telemetry.traction_active = drives and (cuts.traction < 1.0 or available > limits.traction * rear_radius)
    telemetry.wheelie_active = drives and (cuts.wheelie < 1.0 or available > limits.wheelie * rear_radius)
    telemetry.brake_active = brakes and (min(cuts.front, cuts.rear, limits.rear) < 1.0 or asked > limits.braking)
    telemetry.stoppie_active = brakes and (cuts.stoppie < 1.0 or asked > limits.stoppie)
