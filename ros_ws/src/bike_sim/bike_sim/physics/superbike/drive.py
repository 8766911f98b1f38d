"""Engine, brakes and rolling resistance: torques on the wheels of a superbike."""

from __future__ import annotations

from typing import Final, NamedTuple

from numba import njit

from bike_sim.physics.superbike.aids import AidCuts, AidLimits, aid_cuts, aid_limits
from bike_sim.physics.superbike.contact import TyreForce
from bike_sim.physics.superbike.records import Attitude, Command
from bike_sim.vehicles.superbike import Record

_REQUEST_MIN: Final = 0.01  # part of full throttle or full brake below which an aid has nothing to hold back


class WheelState(NamedTuple):
    """A wheel as engine and brakes see it.

    Attributes:
        spin: about its axle, rad/s.
        radius: rolling radius, m.
        tyre: what the tyre does.
    """

    spin: float
    radius: float
    tyre: TyreForce


class DriveOutput(NamedTuple):
    """What engine and brakes do.

    Attributes:
        rear: torque on the rear wheel, N m. front: on the front wheel.
        brake_rate: rate of the front brake's force as lever and electronics set it, N/s.
        drive: torque of the engine on the rear wheel, N m. front_brake: of the brake, N m. rear_brake: the same.
        available: torque of the engine without electronics, N m. asked: force of the front brake without them, N.
        limits: of the electronics, ahead. cuts: by them, after the fact.
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
def _brake_torque(limit: float, spin: float, inertia: float, tyre_torque: float, dt: float) -> float:
    """Return the torque of a brake that can hold up to `limit`, N m: it stops a wheel but never turns it back."""
    return min(max(-(inertia * spin / dt + tyre_torque), -limit), limit)


@njit(cache=True)
def drive_and_brake(
    command: Command, attitude: Attitude, rear: WheelState, front: WheelState, memory: Record, constants: Record
) -> DriveOutput:
    """Return what engine and brakes do.

    Args:
        command: what is held.
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
    drive_torque = cuts.traction * cuts.wheelie * min(available, min(limits.wheelie, limits.traction) * rear.radius)
    held = cuts.rear * limits.rear
    rear_brake = (1.0 - brakes.front_share) * brake * held * brakes.force * machine.rR
    asked = brakes.front_share * brake * brakes.force
    allowed = min(limits.stoppie, limits.braking)
    brake_rate = (min(asked, allowed) - min(brakes.front_share * before * brakes.force, allowed)) / dt
    front_brake = cuts.front * cuts.stoppie * min(asked, allowed) * machine.rF
    # closed throttle drags like a brake, and is eased like one; so does rolling resistance
    engine_brake = held * (1.0 - drive) * motor.engine_brake * machine.rR
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
