"""Weave and wobble of a superbike at any moment of a ride, hands on the bars, measured on the compiled engine.

At large lean the motions in and across the machine's plane are one, so all of them are pushed a little to either side:
the frame, the joints, the tyres' slips and what the rider remembers. The machine then runs for a few steps with the
commands held. Central differences of where it gets to are its discrete transition matrix along that ride, whose
eigenvalues give those in continuous time. Nothing has to be steady: it works on the brake too, where the speed falls.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import mapping
from bike_sim.physics.compiled_superbike_engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.records import MEMORY_NAMES
from bike_sim.physics.tree import FORK, FRONT_WHEEL, REAR_WHEEL, SLIDER

FloatArray = NDArray[np.float64]

REMEMBERED: Final = (
    "rear_slip", "rear_drift", "front_slip", "front_drift", "integral", "intent", "arms", "held_steer", "torso_rate",
    "torso_turn", "drive", "brake", "measured_roll_rate", "front_load",
)  # fmt: skip
"""States of the forces, of `records.MEMORY_NAMES`; the rider's reference follows the command alone."""
MOTIONS: Final = (
    "height", "roll", "pitch", "forward", "sideways", "upward", "roll_rate", "pitch_rate", "yaw_rate", "steer",
    "steer_rate", "slide", "slide_rate", "rear_spin", "front_spin",
)  # fmt: skip
"""States of the bodies: of the frame along and about its heading, across it and the vertical, then of the joints."""
STATES: Final = MOTIONS + REMEMBERED
_PUSH: Final = 1e-6
_STEPS: Final = 3
WEAVE_BAND: Final = (1.2, 5.0)
WOBBLE_BAND: Final = (5.0, 12.0)
"""Frequencies between which the least damped pair is taken, Hz; below lies how the rider answers lean."""


class TurnModes(NamedTuple):
    """Eigenvalues at one moment, 1/s; nan where there is no pair in the band.

    Attributes:
        weave: least damped pair between 1.2 and 5 Hz. wobble: between 5 and 12 Hz.
    """

    weave: complex
    wobble: complex


def modes_now(engine: CompiledSuperbikeEngine, command: tuple[float, float]) -> TurnModes:
    """Return weave and wobble of a machine where it is, with a command held; the engine is left as it was.

    Args:
        engine: in the middle of a ride.
        command: steering and throttle in [-1, 1].
    """
    values = eigenvalues_now(engine, command)
    return TurnModes(least_damped(values, WEAVE_BAND), least_damped(values, WOBBLE_BAND))


def least_damped(values: NDArray[np.complex128], band: tuple[float, float]) -> complex:
    """Return the eigenvalue with the largest real part in a band of frequencies (Hz), or nan."""
    frequency = values.imag / (2.0 * math.pi)
    inside = values[(frequency > band[0]) & (frequency < band[1])]
    return complex(inside[np.argmax(inside.real)]) if inside.size else complex(math.nan, math.nan)


def eigenvalues_now(engine: CompiledSuperbikeEngine, command: tuple[float, float]) -> NDArray[np.complex128]:
    """Return all eigenvalues of the ride at this moment, 1/s; see `modes_now`."""
    kept = engine.motion.copy(), engine.memory.copy()
    starts, ends = (np.empty((len(STATES), len(STATES))) for _ in range(2))
    for column, name in enumerate(STATES):
        looks = []
        for push in (_PUSH, -_PUSH):
            engine.motion[:], engine.memory[:] = kept
            _push(engine, name, push)
            before = _look(engine)
            engine.advance_commands(*command, _STEPS)
            looks.append((before, _look(engine)))
        starts[:, column] = looks[0][0] - looks[1][0]
        ends[:, column] = looks[0][1] - looks[1][1]
    engine.motion[:], engine.memory[:] = kept
    engine.advance_commands(*command, 0)
    transition = np.linalg.solve(starts.T, ends.T).T
    return np.asarray(np.log(np.linalg.eigvals(transition).astype(complex)) / (_STEPS * engine.time_step))


def _axes(engine: CompiledSuperbikeEngine) -> FloatArray:
    """Return heading, left and up as rows, from the rear axle."""
    axle = mapping.rotate(engine.motion[0]["orientation"], np.array([0.0, 1.0, 0.0]))
    level = math.hypot(axle[0], axle[1])
    cos, sin = axle[1] / level, -axle[0] / level
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _push(engine: CompiledSuperbikeEngine, name: str, push: float) -> None:
    """Push one state (m, rad, m/s, rad/s, and the memory's own units)."""
    motion, axes = engine.motion[0], _axes(engine)
    if name in REMEMBERED:
        engine.memory[MEMORY_NAMES.index(name)] += push
    elif name == "height":
        motion["position"][2] += push
    elif name in ("roll", "pitch"):
        turn = mapping.axis_angle(axes[("roll", "pitch").index(name)], push)
        motion["orientation"][:] = mapping.multiply(turn, motion["orientation"])
    elif name in ("forward", "sideways", "upward"):
        motion["velocity"] += push * axes[("forward", "sideways", "upward").index(name)]
    elif name in ("roll_rate", "pitch_rate", "yaw_rate"):
        motion["omega"] += push * axes[("roll_rate", "pitch_rate", "yaw_rate").index(name)]
    elif name in ("steer", "slide"):
        motion["joints"][FORK if name == "steer" else SLIDER] += push
    else:
        joints = {"steer_rate": FORK, "slide_rate": SLIDER, "rear_spin": REAR_WHEEL, "front_spin": FRONT_WHEEL}
        motion["rates"][joints[name]] += push


def _look(engine: CompiledSuperbikeEngine) -> FloatArray:
    """Return the states, in the order of their names; none of them knows where the machine is or heads."""
    motion, axes = engine.motion[0], _axes(engine)
    joints, rates = motion["joints"], motion["rates"]
    ahead, axle = (mapping.rotate(motion["orientation"], np.eye(3)[k]) for k in (0, 1))
    remembered = [engine.memory[MEMORY_NAMES.index(name)] for name in REMEMBERED]
    return np.array(
        [
            motion["position"][2], math.asin(axle[2]), -math.asin(ahead[2]), *(axes @ motion["velocity"]),
            *(axes @ motion["omega"]), joints[FORK], rates[FORK], joints[SLIDER], rates[SLIDER], rates[REAR_WHEEL],
            rates[FRONT_WHEEL], *remembered,
        ]
    )  # fmt: skip
