"""How steady loads move the mass of a machine on springs, for quasi-steady limits: linear but for the stops.

A machine that sinks turns less at the same lean, and a fork that is pressed together brings the front wheel nearer. The
machine is seen in its own plane, in which it stands on the line through both contacts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.joints import UNIT_RANGE, UNIT_SAMPLES, Chain, Joints, Strut, SwingArm, turned

FloatArray = NDArray[np.float64]

_STEP: Final = 1e-3
"""Angle and travel over which the geometry is differenced, rad and m."""


@dataclass(frozen=True)
class Trim:
    """What the suspension of one wheel gives way, and what that moves; all 0 where it is rigid.

    Its travel is the arm's angle or that of the fork, 0 in the standing machine and positive pressed together. Load is
    what the wheel carries beyond the standing machine's, square to the line of contacts.

    Attributes:
        load: generalised force of the spring by the load: m for the arm, a number for the fork.
        drive: the same by a driving force at the contact.
        brake: the same by a braking force at the contact.
        soft: travel by generalised force, rad/(N m) or m/N.
        hard: the same beyond a stop.
        most: travel at the stop.
        least: travel at the other stop, negative.
        forward: way of the mass ahead of the rear contact, by the travel.
        sink: way of the mass down, by the travel.
        shorter: loss of the wheelbase, by the travel.
        tyre: deflection of the tyre by its load, m/N.
    """

    load: float = 0.0
    drive: float = 0.0
    brake: float = 0.0
    soft: float = 0.0
    hard: float = 0.0
    most: float = 0.0
    least: float = 0.0
    forward: float = 0.0
    sink: float = 0.0
    shorter: float = 0.0
    tyre: float = 0.0


@dataclass(frozen=True)
class TorsoTrim:
    """How the rider's torso rolls in a turn that does not press along the machine's plane; all 0 where it is rigid.

    Attributes:
        moment: its mass by the height over its joint, kg m.
        stiffness: of the joint, N m/rad.
    """

    moment: float = 0.0
    stiffness: float = 0.0


TORSO_TRIM: Final = np.dtype([(entry.name, np.float64) for entry in fields(TorsoTrim)])
"""Record of a `TorsoTrim`."""
TRIM: Final = np.dtype([(entry.name, np.float64) for entry in fields(Trim)])
"""Record of a `Trim`."""


def trims(vehicle: Vehicle, joints: Joints, tyres: tuple[float, float], rear_load: float) -> tuple[Trim, Trim]:
    """Return the trim of the rear and of the front wheel.

    Args:
        vehicle: the four bodies of the standing machine.
        joints: what gives way.
        tyres: vertical stiffness of the rear and of the front tyre, N/m.
        rear_load: of the standing machine, N.
    """
    rear, front = Trim(tyre=1.0 / tyres[0]), Trim(tyre=1.0 / tyres[1])
    if joints.swing_arm is not None:
        arm = joints.swing_arm
        x, z = arm.pivot
        chain = 0.0 if arm.chain is None else vehicle.rR * _chain_moment(arm.chain, vehicle.rR, arm.pivot)
        moment = (rear_load - vehicle.mR * vehicle.g) * x - arm.part.mass * vehicle.g * (x - arm.part.x)
        soft, ratio = _rear_softness(arm, moment)
        rear = Trim(x, chain - z, z, *_stops(soft, arm.strut, ratio), *_moved(vehicle, joints, swing=_STEP), rear.tyre)
    if joints.fork is not None:
        strut = joints.fork.strut
        cos, sin = math.cos(vehicle.lam), math.sin(vehicle.lam)
        stops = _stops(1.0 / strut.stiffness, strut, 1.0)
        front = Trim(cos, 0.0, sin, *stops, *_moved(vehicle, joints, travel=_STEP), front.tyre)
    return rear, front


def _stops(soft: float, strut: Strut, ratio: float) -> tuple[float, float, float, float]:
    """Return `Trim.soft` to `Trim.least` of a spring unit that is shortened by `ratio` times the travel."""
    hard = 1.0 / (1.0 / soft + strut.stop * ratio**2)
    return soft, hard, strut.compression / ratio, -strut.extension / ratio


def _rear_softness(arm: SwingArm, moment: float) -> tuple[float, float]:
    """Return angle of the arm by moment, rad/(N m), and shortening of its spring unit by angle, m/rad.

    Args:
        arm: with its spring unit.
        moment: on the arm of the standing machine, N m.
    """
    angles = np.linspace(-UNIT_RANGE, UNIT_RANGE, UNIT_SAMPLES)
    ratios = -np.gradient(arm.unit_lengths(), angles, edge_order=2)
    middle = UNIT_SAMPLES // 2
    ratio, curve = float(ratios[middle]), float(np.gradient(ratios, angles)[middle])
    return 1.0 / (arm.strut.stiffness * ratio**2 + moment / ratio * curve), ratio


def _chain_moment(chain: Chain, axle_height: float, pivot: tuple[float, float]) -> float:
    """Return the moment of the chain's upper run about the arm's pivot by the torque on the wheel; see `chain_load`."""
    axle = np.array([0.0, axle_height])
    line = np.array(chain.countershaft) - axle
    distance = math.hypot(*line)
    unit = line / distance
    upward = np.array([-unit[1], unit[0]])
    sine = (chain.rear_sprocket - chain.front_sprocket) / distance
    cosine = math.sqrt(1.0 - sine**2)
    pull = cosine * unit - sine * upward
    x, z = axle + chain.rear_sprocket * (cosine * upward + sine * unit) - np.array(pivot)
    return float(z * pull[0] - x * pull[1]) / chain.rear_sprocket


def _moved(vehicle: Vehicle, joints: Joints, swing: float = 0.0, travel: float = 0.0) -> tuple[float, float, float]:
    """Return what a travel of one suspension moves, by the travel: `Trim.forward`, `Trim.sink`, `Trim.shorter`."""
    x, height, wheelbase = _placed(vehicle, joints, swing, travel)
    x_0, height_0, wheelbase_0 = _placed(vehicle, joints, 0.0, 0.0)
    size = swing + travel
    return (x - x_0) / size, (height_0 - height) / size, (wheelbase_0 - wheelbase) / size


def _placed(vehicle: Vehicle, joints: Joints, swing: float, travel: float) -> tuple[float, float, float]:
    """Return the place of the mass ahead of the rear contact and above the line of contacts, and the wheelbase, m."""
    along = travel * np.array([-math.sin(vehicle.lam), math.cos(vehicle.lam)])
    rear, front = np.array([0.0, vehicle.rR]), np.array([vehicle.w, vehicle.rF])
    pieces = [
        (vehicle.mB, np.array([vehicle.xB, -vehicle.zB]), np.zeros(2)),
        (vehicle.mH, np.array([vehicle.xH, -vehicle.zH]), np.zeros(2)),
        (vehicle.mF, front, along),
    ]
    if joints.fork is not None:
        part = joints.fork.part
        pieces.append((part.mass, np.zeros(2), along))
    shift = np.zeros(2)
    if joints.swing_arm is not None:
        pivot, part = np.array(joints.swing_arm.pivot), joints.swing_arm.part
        shift = turned(rear - pivot, swing) + pivot - rear
        place = np.array([part.x, part.height])
        pieces.append((part.mass, np.zeros(2), turned(place - pivot, swing) + pivot - place))
    pieces.append((vehicle.mR, rear, shift))
    mass = vehicle.mB + vehicle.mH + vehicle.mF + vehicle.mR
    centre = sum((weight * (place + moved) for weight, place, moved in pieces), np.zeros(2)) / mass
    line = front + along - rear - shift
    length = math.hypot(*line)
    drop = (vehicle.rF - vehicle.rR) / length
    wheelbase = length * math.sqrt(1.0 - drop**2)
    ahead = (math.sqrt(1.0 - drop**2) * line + drop * np.array([line[1], -line[0]])) / length
    arm = centre - rear - shift
    return float(arm @ ahead), float(arm @ np.array([-ahead[1], ahead[0]])) + vehicle.rR, wheelbase
