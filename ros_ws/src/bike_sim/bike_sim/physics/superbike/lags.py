"""What is held during a control period, and how far the lags of machine and rider close in one of its steps.

The lags are systems of first order with constant input over a step, so that the part of what is missing that a step
closes depends on the step alone. It is worked out once for all steps of a period.
"""

from __future__ import annotations

import math
from typing import Final

from numba import njit

from bike_sim.physics.superbike.records import Command, Lags
from bike_sim.vehicles.superbike import Record

# s by which the electronics' sensor of the roll rate is late. Without it the wheelie aid answers every swing of weave
# with drive, and keeps the swing alive where the front wheel is light.
_SENSOR_LAG: Final = 0.1
_FEELING_LAG: Final = 0.2  # s until the rider feels a change of the front wheel's load


@njit(cache=True)
def _closed(lag: float, dt: float) -> float:
    """Return the part of what is missing that a lag (s) closes in a step, s."""
    return -math.expm1(-dt / lag)


@njit(cache=True)
def held(command: tuple[float, float, float], constants: Record) -> Command:
    """Return what is held during the steps of a period.

    Args:
        command: steering and throttle in [-1, 1], time step, s.
        constants: a record of `CONSTANTS`.
    """
    steering, throttle, dt = command
    machine = constants.machine
    rider = machine.virtual_rider
    reach = rider.arm_frequency * dt
    lags = Lags(
        drive=_closed(machine.motor.lag, dt),
        brake=_closed(machine.brakes.lag, dt),
        sensor=_closed(_SENSOR_LAG, dt),
        feeling=_closed(_FEELING_LAG, dt),
        grip=_closed(rider.grip_memory, dt),
        torso=_closed(rider.torso_time, dt),
        twist=_closed(rider.twist_time, dt),
        arms=reach,
        arms_left=math.exp(-reach),
    )
    return Command(steering, throttle, dt, lags)
