"""The electronics of a superbike: how much drive and brake they allow, ahead by statics and after the fact by a cut."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from numba import njit

from bike_sim.physics.superbike import tyres
from bike_sim.vehicles.superbike import Record

_THROW_RATE: Final = 1.0  # rad/s of roll at which the electronics keep a wheel as loaded as lying flat
_LEANING: Final = math.sin(math.radians(45.0))  # sine of the lean from which the brake control is most careful
# Part of a tyre's friction that a turn may take before brakes and engine braking are eased, and from which on they get
# none. Near its limit a tyre has little side stiffness left, and what a brake takes of that makes weave grow.
_EASED_FROM: Final = 0.62
BRAKE_RELEASE_FULL: Final = 0.90


class AidLimits(NamedTuple):
    """What each of the electronics allows, N; infinite without it.

    Attributes:
        traction: drive by traction control. wheelie: drive by wheelie control.
        braking: front brake by brake control. stoppie: front brake by stoppie control.
        rear: part of rear brake and engine braking that brake control leaves in this turn.
    """

    traction: float
    wheelie: float
    braking: float
    stoppie: float
    rear: float


class AidCuts(NamedTuple):
    """What is left of drive and brakes after each of the electronics has answered slips and loads: 1 is all, 0 none.

    Attributes:
        traction: of the drive. wheelie: of the drive.
        front: of the front brake by its slip. rear: of the rear brake. stoppie: of the front brake by the rear load.
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
        share *= _left_by(turn, roll, front_tyre)
        braking = _grip_limit(roll, turn, share, front, height, machine.w, front_tyre)
        hold = _left_by(turn, roll, rear_tyre)
    return AidLimits(traction, wheelie, braking, stoppie, hold)


@njit(cache=True)
def _left_by(turn: float, roll: float, tyre: Record) -> float:
    """Return the part of its brake that a tyre is left in a turn, whose lateral force by load is given."""
    return 1.0 - between(turn / tyres.friction(roll, tyre), _EASED_FROM, BRAKE_RELEASE_FULL)


@njit(cache=True)
def _grip_limit(
    roll: float, turn: float, share: float, load: float, height: float, wheelbase: float, tyre: Record
) -> float:
    """Return the force that a share of the friction left by a turn allows, N; the force itself loads the wheel."""
    mu = tyres.friction(roll, tyre)
    left = share * mu * tyre.friction_ratio * math.sqrt(max(0.0, 1.0 - (turn / mu) ** 2))
    # no more than all of the weight can come to the wheel
    transfer = left * height / wheelbase
    return left * load / (1.0 - transfer) if transfer < 1.0 else math.inf


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
