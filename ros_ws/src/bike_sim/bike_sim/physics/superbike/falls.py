"""When a superbike falls, and the names of falls by what went before.

* low side: the machine lies on the side it was leaning to when a tyre slid, or slides broadside;
* high side: after a slide it is thrown over to the other side;
* stoppie, wheelie: it went over the front or the rear wheel, past the point of balance;
* tip over: it fell to a side with both tyres holding, as when it is too slow.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from numba import njit

from bike_sim.physics import tyres
from bike_sim.physics.superbike.contact import TyreForce
from bike_sim.physics.superbike.records import Attitude
from bike_sim.vehicles.superbike import Record

FALL_NAMES: Final = ("none", "low_side", "high_side", "tip_over", "stoppie", "wheelie")
NO_FALL: Final = FALL_NAMES.index("none")
LOW_SIDE: Final = FALL_NAMES.index("low_side")
HIGH_SIDE: Final = FALL_NAMES.index("high_side")
TIP_OVER: Final = FALL_NAMES.index("tip_over")
STOPPIE: Final = FALL_NAMES.index("stoppie")
WHEELIE: Final = FALL_NAMES.index("wheelie")

_SLIDING: Final = 1.15  # times the peak slip from which a tyre counts as sliding
_SLIDE_LEAN_MIN: Final = 0.15  # rad; upright a slide has no side
_SLIDE_MEMORY: Final = 1.5  # s a slide explains a fall
_THROWN_RATE: Final = 6.0  # rad/s of roll away from the slide at which nobody stays on
_SPUN: Final = math.cos(math.radians(60.0))  # of the angle between heading and velocity at which a slide is a crash
_SLIDE_SPEED: Final = 4.0  # m/s; what slips while falling over at a walk is no slide
_OVER: Final = math.sin(math.radians(55.0))  # pitch beyond every machine's point of balance


class Upset(NamedTuple):
    """What a fall is told from.

    Attributes:
        roll: to the normal of the ground, rad. roll_rate: rad/s.
        nose_up: part of the frame's forward axis along that normal.
        rear_load: N. front_load: N.
        sliding: a tyre slides. sideways: the machine moves broadside.
    """

    roll: float
    roll_rate: float
    nose_up: float
    rear_load: float
    front_load: float
    sliding: bool
    sideways: bool


@njit(cache=True)
def fall_indicators(attitude: Attitude, nose_up: float, rear: TyreForce, front: TyreForce, constants: Record) -> Upset:
    """Return what a fall is told from, out of the motion and what the tyres do."""
    size = math.sqrt(attitude.squared_speed)
    slip = max(rear.use / tyres.peak_slip(constants.rear_tyre), front.use / tyres.peak_slip(constants.front_tyre))
    sliding = size > _SLIDE_SPEED and slip > _SLIDING
    sideways = size > _SLIDE_SPEED and attitude.speed < _SPUN * size
    return Upset(attitude.camber, attitude.roll_rate, nose_up, rear.fz, front.fz, sliding, sideways)


@njit(cache=True)
def fall_of(upset: Upset, dt: float, fall_roll: float, memory: Record) -> int:
    """Return how the machine falls at this instant, or `NO_FALL`, and remember slides.

    Args:
        upset: what the machine does.
        dt: time step, s.
        fall_roll: rad, a larger roll is a fall.
        memory: of slides.
    """
    roll, roll_rate = upset.roll, upset.roll_rate
    if upset.sliding and abs(roll) > _SLIDE_LEAN_MIN:
        memory.slide_side, memory.slide_age = math.copysign(1.0, roll), 0.0
    else:
        memory.slide_age += dt
    slid = memory.slide_age < _SLIDE_MEMORY
    side = memory.slide_side
    if upset.nose_up < -_OVER and upset.rear_load <= 0.0:
        return STOPPIE
    if upset.nose_up > _OVER and upset.front_load <= 0.0:
        return WHEELIE
    if slid and roll_rate * side < -_THROWN_RATE:
        return HIGH_SIDE
    if upset.sideways:
        return LOW_SIDE
    if abs(roll) > fall_roll:
        if not slid:
            return TIP_OVER
        return LOW_SIDE if roll * side > 0.0 else HIGH_SIDE
    return NO_FALL
