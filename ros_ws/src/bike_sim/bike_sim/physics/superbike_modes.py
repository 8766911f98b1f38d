"""Weave, wobble and capsize of a superbike in straight running, measured on the engine with hands off and on the bars.

The machine is brought to a steady speed. Then each of its ten lateral states is pushed a little to either side and the
engine runs for a few steps. Central differences give the discrete transition matrix, whose eigenvalues give those in
continuous time. The steering damper works and the rider sits still in his slide. With the hands off he holds nothing;
with the hands on he rides straight on, and the six states of arms and torso are pushed too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import mapping
from bike_sim.physics import state as st
from bike_sim.physics import superbike_statics as statics
from bike_sim.physics.superbike.records import MEMORY_NAMES
from bike_sim.physics.superbike_engine import SuperbikeEngine
from bike_sim.physics.tree import FORK, SLIDER
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

LATERAL_NAMES: Final = (
    "roll", "steer", "slide", "side_speed", "roll_rate", "yaw_rate", "steer_rate", "slide_rate", "rear_drift",
    "front_drift",
)  # fmt: skip
RIDER_NAMES: Final = ("integral", "intent", "arms", "held_steer", "torso_rate", "torso_turn")
"""What the rider remembers of the sideways motion, of `records.MEMORY_NAMES`; his reference rests on a straight."""
_PERIOD: Final = 0.006  # s; e^-4 of the fastest relaxation is left after it
_PUSH: Final = 1e-5
_SETTLE: Final = 2.0  # s
_LEAST_FREQUENCY: Final = 0.1  # Hz
_WOBBLE_FROM: Final = 5.5  # Hz
_RIDER_UP_TO: Final = 1.0  # Hz; below it lies how a rider with his hands on answers lean


@dataclass(frozen=True)
class SuperbikeModes:
    """Eigenvalues at one speed, 1/s; nan where a mode does not oscillate or cannot be told.

    Attributes:
        speed: m/s.
        weave: the pair below 5.5 Hz. wobble: the pair above.
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
    """Return the modes at a speed, from an engine of its own.

    Args:
        vehicle: the machine.
        speed: m/s.
        time_step: of the engine, s; a fine one.
        hands: whether the rider holds the bars. Below 1 Hz then lies how he answers lean, which is no weave.
    """
    eigenvalues = lateral_eigenvalues(vehicle, speed, time_step, hands)
    frequency = eigenvalues.imag / (2.0 * math.pi)
    oscillating = eigenvalues[frequency > _LEAST_FREQUENCY]
    bands = frequency[frequency > _LEAST_FREQUENCY]
    real = eigenvalues[np.abs(frequency) <= _LEAST_FREQUENCY].real

    def least_damped(values: FloatArray) -> complex:
        return complex(values[np.argmax(values.real)]) if values.size else complex(math.nan, math.nan)

    weave = least_damped(oscillating[(bands < _WOBBLE_FROM) & (bands > (_RIDER_UP_TO if hands else 0.0))])
    wobble = least_damped(oscillating[(bands >= _WOBBLE_FROM) & (bands < 20.0)])
    return SuperbikeModes(speed, weave, wobble, float(real.max()) if real.size else math.nan)


def lateral_eigenvalues(vehicle: Superbike, speed: float, time_step: float, hands: bool = False) -> FloatArray:
    """Return the eigenvalues of the lateral states, and with the hands on of the rider's, in straight running, 1/s."""
    engine = SuperbikeEngine(vehicle if hands else hands_off(vehicle), time_step)
    names = LATERAL_NAMES + (RIDER_NAMES if hands else ())
    try:
        throttle = holding_throttle(vehicle, speed)
        engine.reset(st.upright_state(speed, vehicle.rF))
        engine.advance_commands(0.0, throttle, round(_SETTLE / time_step))
        steps = max(1, round(_PERIOD / time_step))
        start = _Snapshot(engine, names)
        matrix = np.empty((len(names),) * 2)
        for column in range(len(names)):
            ends = []
            for push in (_PUSH, -_PUSH):
                start.restore(column, push)
                engine.advance_commands(0.0, throttle, steps)
                ends.append(start.look())
            matrix[:, column] = (ends[0] - ends[1]) / (2.0 * _PUSH)
        return np.asarray(np.log(np.linalg.eigvals(matrix).astype(complex)) / (steps * time_step))
    finally:
        engine.close()


class _Snapshot:
    """The whole motion of an engine, to put back with one lateral state pushed, and to look at."""

    def __init__(self, engine: SuperbikeEngine, names: tuple[str, ...]) -> None:
        self.engine, self.names = engine, names
        self.kept = engine.motion.copy(), engine.memory.copy()

    def restore(self, index: int, push: float) -> None:
        """Put the motion back with one of the states pushed (rad, m, s and N m)."""
        name, engine = self.names[index], self.engine
        engine.motion[:], engine.memory[:] = self.kept
        motion = engine.motion[0]
        if name == "roll":
            turn = mapping.axis_angle(np.array([1.0, 0.0, 0.0]), push)
            motion["orientation"][:] = mapping.multiply(turn, motion["orientation"])
        elif name == "side_speed":
            motion["velocity"][1] += push
        elif name in ("roll_rate", "yaw_rate"):
            motion["omega"][0 if name == "roll_rate" else 2] += push
        elif name in MEMORY_NAMES:
            engine.memory[MEMORY_NAMES.index(name)] += push
        else:
            joints = motion["rates" if name.endswith("rate") else "joints"]
            joints[FORK if name.startswith("steer") else SLIDER] += push
        engine.set_motion()

    def look(self) -> FloatArray:
        """Return the states, in the order of their names."""
        state, motion, memory = self.engine.state(), self.engine.motion[0], self.engine.memory
        velocity, omega = motion["velocity"], motion["omega"]
        slide, slide_rate, yaw = motion["joints"][SLIDER], motion["rates"][SLIDER], state[st.YAW]
        side = math.cos(yaw) * velocity[1] - math.sin(yaw) * velocity[0]
        return np.array(
            [
                state[st.ROLL], state[st.STEER], slide, side, state[st.ROLL_RATE], omega[2], state[st.STEER_RATE],
                slide_rate, *(memory[MEMORY_NAMES.index(name)] for name in self.names if name in MEMORY_NAMES),
            ]
        )  # fmt: skip
