"""Weave, wobble and capsize of a superbike in straight running, measured on the engine with the rider's hands off.

The machine is brought to a steady speed. Then each of its ten lateral states is pushed a little to either side and the
engine runs for a few steps. Central differences give the discrete transition matrix, whose eigenvalues give those in
continuous time. The steering damper works, the rider sits still in his slide but holds nothing.
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
from bike_sim.physics.pybullet_tree import bullet
from bike_sim.physics.superbike.records import MEMORY_NAMES
from bike_sim.physics.superbike_engine import SuperbikeEngine
from bike_sim.physics.tree import FORK, SLIDER
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

LATERAL_NAMES: Final = (
    "roll", "steer", "slide", "side_speed", "roll_rate", "yaw_rate", "steer_rate", "slide_rate", "rear_drift",
    "front_drift",
)  # fmt: skip
_PERIOD: Final = 0.006  # s; e^-4 of the fastest relaxation is left after it
_PUSH: Final = 1e-5
_SETTLE: Final = 2.0  # s
_LEAST_FREQUENCY: Final = 0.1  # Hz
_WOBBLE_FROM: Final = 5.5  # Hz


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


def measure_modes(vehicle: Superbike, speed: float, time_step: float = 0.0005) -> SuperbikeModes:
    """Return the modes at a speed (m/s), from an engine of its own with a fine step (s)."""
    eigenvalues = lateral_eigenvalues(vehicle, speed, time_step)
    frequency = eigenvalues.imag / (2.0 * math.pi)
    oscillating = eigenvalues[frequency > _LEAST_FREQUENCY]
    bands = frequency[frequency > _LEAST_FREQUENCY]
    real = eigenvalues[np.abs(frequency) <= _LEAST_FREQUENCY].real

    def least_damped(values: FloatArray) -> complex:
        return complex(values[np.argmax(values.real)]) if values.size else complex(math.nan, math.nan)

    weave = least_damped(oscillating[bands < _WOBBLE_FROM])
    wobble = least_damped(oscillating[(bands >= _WOBBLE_FROM) & (bands < 20.0)])
    return SuperbikeModes(speed, weave, wobble, float(real.max()) if real.size else math.nan)


def lateral_eigenvalues(vehicle: Superbike, speed: float, time_step: float) -> FloatArray:
    """Return the ten eigenvalues of the lateral states about straight running, 1/s."""
    engine = SuperbikeEngine(hands_off(vehicle), time_step)
    try:
        throttle = holding_throttle(vehicle, speed)
        engine.reset(st.upright_state(speed, vehicle.rF))
        engine.advance_commands(0.0, throttle, round(_SETTLE / time_step))
        steps = max(1, round(_PERIOD / time_step))
        start = _Snapshot(engine)
        matrix = np.empty((len(LATERAL_NAMES),) * 2)
        for column in range(len(LATERAL_NAMES)):
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

    def __init__(self, engine: SuperbikeEngine) -> None:
        self.engine = engine
        body, client = engine.body, engine.client
        self.pose = bullet.getBasePositionAndOrientation(body, client)
        self.twist = bullet.getBaseVelocity(body, client)
        self.joints = [joint[:2] for joint in bullet.getJointStates(body, range(4), client)]
        self.memory = engine.memory.copy()

    def restore(self, index: int, push: float) -> None:
        """Put the motion back with one of `LATERAL_NAMES` pushed (rad, m and s)."""
        name = LATERAL_NAMES[index]
        position, orientation = (np.array(part) for part in self.pose)
        velocity, omega = (np.array(part) for part in self.twist)
        joints = [list(joint) for joint in self.joints]
        self.engine.memory[:] = self.memory
        if name == "roll":
            orientation = mapping.multiply(mapping.axis_angle(np.array([1.0, 0.0, 0.0]), push), orientation)
        elif name in ("side_speed", "roll_rate", "yaw_rate"):
            velocity[1] += push * (name == "side_speed")
            omega[0] += push * (name == "roll_rate")
            omega[2] += push * (name == "yaw_rate")
        elif name in ("rear_drift", "front_drift"):
            self.engine.memory[MEMORY_NAMES.index(name)] += push
        else:
            joints[FORK if name.startswith("steer") else SLIDER][name.endswith("rate")] += push
        body, client = self.engine.body, self.engine.client
        bullet.resetBasePositionAndOrientation(body, position, orientation, client)
        bullet.resetBaseVelocity(body, velocity, omega, client)
        for link, (value, rate) in enumerate(joints):
            bullet.resetJointState(body, link, value, rate, client)

    def look(self) -> FloatArray:
        """Return the lateral states, in the order of `LATERAL_NAMES`."""
        body, client = self.engine.body, self.engine.client
        state = self.engine.state()
        velocity, omega = bullet.getBaseVelocity(body, client)
        slide = bullet.getJointState(body, SLIDER, client)
        yaw = state[st.YAW]
        side = math.cos(yaw) * velocity[1] - math.sin(yaw) * velocity[0]
        memory = self.engine.memory
        return np.array(
            [
                state[st.ROLL], state[st.STEER], slide[0], side, state[st.ROLL_RATE], omega[2], state[st.STEER_RATE],
                slide[1], *(memory[MEMORY_NAMES.index(name)] for name in ("rear_drift", "front_drift")),
            ]
        )  # fmt: skip
