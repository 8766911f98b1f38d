"""Inputs, constants and memory of the compiled forces of a superbike: records whose fields have names.

Compiled code reads ``memory.drive`` and ``constants.machine.brakes.force``: numba looks the names up when it compiles,
so nothing depends on the order of fields, and a name that does not exist is an error. From outside, memory and
telemetry are also plain vectors of floats in the order of their names.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from bike_sim.physics.multibody.vectors import Quaternion as Quaternion
from bike_sim.physics.multibody.vectors import Vec
from bike_sim.vehicles.joints import UNIT_SAMPLES
from bike_sim.vehicles.superbike import MACHINE, TORQUE_SAMPLES, Record

MEMORY_NAMES: Final = (
    "rear_slip", "rear_tan_slip_angle", "front_slip", "front_tan_slip_angle", "lean_aim", "lean_aim_rate",
    "lean_eased", "lean_reference", "integral",
    "intent", "arms", "accustomed_steer", "torso_rate", "torso_turn", "drive", "brake", "measured_roll_rate",
    "front_load", "slide_side", "slide_age", "fall", "gear", "shift",
)  # fmt: skip
"""Memory of the forces from step to step; `fall` is an index of `forces.FALL_NAMES`, `gear` counts from 1 (0: none
yet), and `shift` is the time until the gearbox has shifted, s."""

MEMORY: Final = np.dtype([(name, np.float64) for name in MEMORY_NAMES])

GEOMETRY: Final = np.dtype(
    [
        (name, np.float64)
        for name in (
            "cos_principal", "sin_principal", "axle_x", "axle_z", "head_x", "head_z", "hub", "cos_tilt", "sin_tilt",
            "air_x", "air_z", "rear_static", "front_static", "torque_spacing",
        )
    ]
)  # fmt: skip
"""Positions in the rear frame's principal axes from its centre of mass, m: the rear axle, the head (see
`mapping.Layout`) and the centre of pressure; `hub` is the front axle's distance ahead of the steering axis. The angle
is from the frame's axes to the principal ones, the tilt the steering axis'; static are the tyres' deflections of the
standing machine, m, and the spacing is that of the table of wheel torque, rad/s."""

FURTHER_JOINTS: Final = ("swing", "travel", "head", "bend", "torso")
"""Joints that a vehicle's file may give, in the order of their bodies: see `bike_sim.vehicles.joints`."""

STRUT: Final = np.dtype(
    [(name, np.float64) for name in ("preload", "stiffness", "bump", "rebound", "compression", "extension", "stop")]
)
"""A spring unit: its force in the design pose, N, and the fields of `joints.Strut`."""

JOINTS: Final = np.dtype(
    [
        ("any", np.int64),
        *((name, np.int64) for name in FURTHER_JOINTS),
        *((name, np.float64) for name in ("pivot_x", "pivot_z", "head_up", "bend_up", "chain_x", "chain_z")),
        *((name, np.float64) for name in ("front_sprocket", "rear_sprocket")),
        ("unit", STRUT),
        ("fork", STRUT),
        ("unit_length", np.float64, (UNIT_SAMPLES,)),
        ("unit_ratio", np.float64, (UNIT_SAMPLES,)),
    ]
)
"""Which joints give way, by number, -1 where rigid; the swing arm's pivot and the countershaft in the frame's axes from
its centre of mass, m; heights of the head's twist and the fork's bending over the head along the steering axis, m;
sprockets' radii, m; spring units; length of the rear one over the arm's angle, m, and its derivative, m/rad."""

HOLDING_SAMPLES: Final = 15
HOLDING_LEAN: Final = math.radians(70.0)
"""Leans at which the torque that holds a steady turn is tabulated: their number and the largest, rad."""

CONSTANTS: Final = np.dtype(
    [
        ("machine", MACHINE),
        ("geometry", GEOMETRY),
        ("joints", JOINTS),
        ("wheel_torque", np.float64, (TORQUE_SAMPLES,)),
        ("wheel_gear", np.float64, (TORQUE_SAMPLES,)),
        ("holding", np.float64, (2, HOLDING_SAMPLES)),
    ]
)
"""All that the forces know of a machine; `holding` is the torque that holds a steady turn by the front load, over lean
from 0 to `HOLDING_LEAN` (`holding.holding_table`)."""


class Motion(NamedTuple):
    """Motion of the frame without rider and of the joints.

    Attributes:
        position: of the frame's centre of mass, m.
        orientation: of its principal axes, quaternion (x, y, z, w).
        velocity: m/s.
        omega: angular velocity in map axes, rad/s.
        rear_rate: of the rear wheel relative to the frame, rad/s.
        steer: rad.
        steer_rate: rad/s.
        front_rate: of the front wheel relative to the fork, rad/s.
        slide: of the rider, m to the left.
        slide_rate: m/s.
        swing: of the swing arm, rad, positive with the wheel up.
        swing_rate: rad/s.
        travel: of the fork, m, positive pressed together.
        travel_rate: m/s.
        head: twist of the steering head, rad.
        head_rate: rad/s.
        bend: of the fork, rad.
        bend_rate: rad/s.
    """

    position: Vec
    orientation: Quaternion
    velocity: Vec
    omega: Vec
    rear_rate: float
    steer: float
    steer_rate: float
    front_rate: float
    slide: float
    slide_rate: float
    swing: float
    swing_rate: float
    travel: float
    travel_rate: float
    head: float
    head_rate: float
    bend: float
    bend_rate: float


class Lags(NamedTuple):
    """Progress of the lags in a step: the part of the difference that each closes.

    Attributes:
        drive: of the engine.
        brake: of the brakes.
        sensor: of the roll rate that the electronics measure.
        feeling: of the rider's feeling of the front load.
        grip: of the steering angle that his arms are used to.
        torso: of the roll that leaves it behind.
        twist: of the turn that does.
        arms: the step by the arms' time constant.
        arms_left: what a step leaves of one of their two lags.
    """

    drive: float
    brake: float
    sensor: float
    feeling: float
    grip: float
    torso: float
    twist: float
    arms: float
    arms_left: float


class Command(NamedTuple):
    """Command of a step; `discretise_command` makes it.

    Attributes:
        steering: in [-1, 1], positive to the left.
        throttle: drive above 0, brakes below.
        dt: time step, s.
        lags: how far lags come in it.
    """

    steering: float
    throttle: float
    dt: float
    lags: Lags


class Attitude(NamedTuple):
    """Motion as rider and electronics measure it.

    Attributes:
        roll: to the vertical about the rear wheel's heading, rad, positive to the right.
        roll_rate: rad/s.
        camber: the same to the normal of the ground, rad.
        cos_yaw: of the heading, seen from above.
        sin_yaw: of the heading.
        speed: forward, m/s.
        squared_speed: of the whole velocity, m2/s2.
    """

    roll: float
    roll_rate: float
    camber: float
    cos_yaw: float
    sin_yaw: float
    speed: float
    squared_speed: float


# s by which the electronics' sensor of the roll rate is late. Without it the wheelie aid answers every swing of weave
# with drive, and keeps the swing alive where the front wheel is light.
_SENSOR_LAG: Final = 0.1
_FEELING_LAG: Final = 0.2  # s until the rider feels a change of the front wheel's load


@njit(cache=True)
def _closed(lag: float, dt: float) -> float:
    """Return the part of what is missing that a lag (s) closes in a step, s."""
    return -math.expm1(-dt / lag)


@njit(cache=True)
def discretise_command(command: tuple[float, float, float], constants: Record) -> Command:
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
