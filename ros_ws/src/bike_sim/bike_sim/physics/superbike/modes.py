"""Weave, wobble and capsize of a superbike at any moment of a ride, hands on or off the bars, measured on an engine.

Chosen states are pushed a little to either side: the frame, the joints, the tyres' slips and what the rider remembers.
The machine then runs for a few steps with the commands held. Central differences of the states that it reaches are its
discrete transition matrix along that ride, whose eigenvalues give those in continuous time. At large lean the motions
in and across the machine's plane are one, so all states are pushed; nothing has to be steady: it works on the brake
too. On the straight the lateral states are enough, and the rider's own where his hands are on the bars.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.bodies import FORK_JOINT, FRONT_JOINT, REAR_JOINT, SLIDE_JOINT
from bike_sim.physics.multibody.vectors import axis_angle, multiply, rotate
from bike_sim.physics.superbike import statics
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine, SuperbikeEngine
from bike_sim.physics.superbike.records import FURTHER_JOINTS, MEMORY_NAMES
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

RIDER_STATES: Final = ("integral", "intent", "arms", "accustomed_steer", "torso_rate", "torso_turn")
"""States of the rider's sideways motion, of `records.MEMORY_NAMES`; his reference follows the command alone."""
LATERAL_STATES: Final = (
    "roll", "steer", "slide", "sideways", "roll_rate", "yaw_rate", "steer_rate", "slide_rate", "rear_tan_slip_angle",
    "front_tan_slip_angle",
)  # fmt: skip
STATES: Final = (
    "height", "roll", "pitch", "forward", "sideways", "upward", "roll_rate", "pitch_rate", "yaw_rate", "steer",
    "steer_rate", "slide", "slide_rate", "rear_spin", "front_spin", "rear_slip", "rear_tan_slip_angle", "front_slip",
    "front_tan_slip_angle", *RIDER_STATES, "drive", "brake", "measured_roll_rate", "front_load",
)  # fmt: skip
"""All states: of the frame along and about its heading, across it and the vertical, of the joints, of the forces."""

WEAVE_BAND: Final = (1.2, 5.0)
WOBBLE_BAND: Final = (5.0, 12.0)
"""Frequencies between which the least damped pair is taken in a turn, Hz; below lies how the rider answers lean."""
_STRAIGHT_WOBBLE_BAND: Final = (5.5, 20.0)  # Hz; below it lies the weave
_RIDER_UP_TO: Final = 1.0  # Hz; below it lies how a rider with his hands on answers lean
_LEAST_FREQUENCY: Final = 0.1  # Hz
_PERIOD: Final = 0.006  # s; e^-4 of the fastest relaxation is left after it
_SETTLE: Final = 2.0  # s
_PUSH: Final = 1e-6

_VECTORS: Final = {
    "forward": ("velocity", 0), "sideways": ("velocity", 1), "upward": ("velocity", 2),
    "roll_rate": ("omega", 0), "pitch_rate": ("omega", 1), "yaw_rate": ("omega", 2),
}  # fmt: skip
_JOINTS: Final = {
    "steer": ("joints", FORK_JOINT), "slide": ("joints", SLIDE_JOINT), "steer_rate": ("rates", FORK_JOINT),
    "slide_rate": ("rates", SLIDE_JOINT), "rear_spin": ("rates", REAR_JOINT), "front_spin": ("rates", FRONT_JOINT),
}  # fmt: skip


@dataclass(frozen=True)
class SuperbikeModes:
    """Eigenvalues at one speed, 1/s; nan where a mode does not oscillate or cannot be told.

    Attributes:
        speed: m/s.
        weave: the pair of low frequency.
        wobble: the pair of high frequency.
        capsize: the largest real eigenvalue.
    """

    speed: float
    weave: complex
    wobble: complex
    capsize: float


def hands_off(vehicle: Superbike) -> Superbike:
    """Return the machine with a rider who does not touch the bars."""
    rider = replace(vehicle.virtual_rider, torque=1e-12)
    return replace(vehicle, virtual_rider=rider)


def holding_throttle(vehicle: Superbike, speed: float) -> float:
    """Return the command that holds a speed on the straight (engine braking by the closed part included)."""
    need = statics.rolling_drag(vehicle, speed) + vehicle.motor.engine_brake
    return min(1.0, need / (statics.engine_force(vehicle, speed) + vehicle.motor.engine_brake))


def measure_modes(vehicle: Superbike, speed: float, time_step: float = 0.0005, hands: bool = False) -> SuperbikeModes:
    """Return the modes in straight running at a speed, from an engine of its own.

    The rider sits still in his slide. With the hands off he holds nothing; with the hands on he rides straight on.

    Args:
        vehicle: the machine.
        speed: m/s.
        time_step: of the engine, s; a fine one.
        hands: whether the rider holds the bars. Below 1 Hz then lies how he answers lean, which is no weave.
    """
    engine = CompiledSuperbikeEngine(vehicle if hands else hands_off(vehicle), time_step)
    command = 0.0, holding_throttle(vehicle, speed)
    engine.reset(st.upright_state(speed, vehicle.rF))
    engine.advance(*command, round(_SETTLE / time_step))
    names = lateral_states(engine) + (RIDER_STATES if hands else ())
    values = eigenvalues(engine, command, names, max(1, round(_PERIOD / time_step)))
    real = values[np.abs(values.imag) <= 2.0 * math.pi * _LEAST_FREQUENCY].real
    weave = least_damped(
        values, (_RIDER_UP_TO if hands or vehicle.joints is not None else _LEAST_FREQUENCY, _STRAIGHT_WOBBLE_BAND[0])
    )
    wobble = least_damped(values, _STRAIGHT_WOBBLE_BAND)
    return SuperbikeModes(speed, weave, wobble, float(real.max()) if real.size else math.nan)


def least_damped(values: NDArray[np.complex128], band: tuple[float, float]) -> complex:
    """Return the eigenvalue with the largest real part in a band of frequencies (Hz), or nan."""
    frequency = values.imag / (2.0 * math.pi)
    inside = values[(frequency > band[0]) & (frequency < band[1])]
    return complex(inside[np.argmax(inside.real)]) if inside.size else complex(math.nan, math.nan)


def eigenvalues(
    engine: SuperbikeEngine, command: tuple[float, float], names: tuple[str, ...] = STATES, steps: int = 3
) -> NDArray[np.complex128]:
    """Return eigenvalues of a ride at this moment, 1/s; see `transition_matrix`."""
    transition = transition_matrix(engine, command, names, steps)
    return np.asarray(np.log(np.linalg.eigvals(transition).astype(complex)) / (steps * engine.time_step))


def transition_matrix(
    engine: SuperbikeEngine, command: tuple[float, float], names: tuple[str, ...], steps: int
) -> FloatArray:
    """Return how states after some steps follow from those now; the engine is left as it was.

    Args:
        engine: in the middle of a ride.
        command: steering and throttle in [-1, 1], held.
        names: states that are pushed, of `STATES`.
        steps: integration steps over which they are watched.
    """
    kept = engine.motion.copy(), engine.memory.copy()
    starts, ends = (np.empty((len(names), len(names))) for _ in range(2))
    for column, name in enumerate(names):
        readings = []
        for push in (_PUSH, -_PUSH):
            engine.motion[:], engine.memory[:] = kept
            _push(engine, name, push)
            engine.set_motion()
            before = _read(engine, names)
            engine.advance(*command, steps)
            readings.append((before, _read(engine, names)))
        starts[:, column] = readings[0][0] - readings[1][0]
        ends[:, column] = readings[0][1] - readings[1][1]
    engine.motion[:], engine.memory[:] = kept
    engine.set_motion()
    engine.advance(*command, 0)
    return np.asarray(np.linalg.solve(starts.T, ends.T).T)


def lateral_states(engine: SuperbikeEngine) -> tuple[str, ...]:
    """Return the names of the lateral states on the straight, with those of what gives way sideways."""
    giving = joint_states(engine, ("head", "bend", "torso"))
    return LATERAL_STATES + tuple(name for name in giving if name not in _JOINTS)


def joint_states(engine: SuperbikeEngine, among: tuple[str, ...] = FURTHER_JOINTS) -> dict[str, tuple[str, int]]:
    """Return field and number in the motion of the joints' states by name, with those of `among` that give way."""
    numbers = {name: int(engine.constants["joints"][name][0]) for name in among}
    further = {name: ("joints", number) for name, number in numbers.items() if number >= 0}
    return _JOINTS | further | {f"{name}_rate": ("rates", number) for name, (_, number) in further.items()}


def _axes(engine: SuperbikeEngine) -> FloatArray:
    """Return heading, left and up as rows, from the rear axle."""
    axle = rotate(engine.motion[0]["orientation"], np.array([0.0, 1.0, 0.0]))
    level = math.hypot(axle[0], axle[1])
    cos, sin = axle[1] / level, -axle[0] / level
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _push(engine: SuperbikeEngine, name: str, push: float) -> None:
    """Push one state (m, rad, m/s, rad/s, and the memory's own units)."""
    motion, axes = engine.motion[0], _axes(engine)
    if name in _VECTORS:
        field, axis = _VECTORS[name]
        motion[field] += push * axes[axis]
    elif name in (joints := joint_states(engine)):
        field, joint = joints[name]
        motion[field][joint] += push
    elif name == "height":
        motion["position"][2] += push
    elif name in MEMORY_NAMES:
        engine.memory[name] += push
    else:
        turn = axis_angle(axes[("roll", "pitch").index(name)], push)
        motion["orientation"][:] = multiply(turn, motion["orientation"])


def _read(engine: SuperbikeEngine, names: tuple[str, ...]) -> FloatArray:
    """Return states in the order of their names; none of them knows where the machine is or heads."""
    motion, axes = engine.motion[0], _axes(engine)
    ahead, axle = (rotate(motion["orientation"], np.eye(3)[k]) for k in (0, 1))
    values = {"height": motion["position"][2], "roll": math.asin(axle[2]), "pitch": -math.asin(ahead[2])}
    values |= {name: axes[axis] @ motion[field] for name, (field, axis) in _VECTORS.items()}
    values |= {name: motion[field][joint] for name, (field, joint) in joint_states(engine).items()}
    return np.array([values[name] if name in values else engine.memory[name][0] for name in names])
