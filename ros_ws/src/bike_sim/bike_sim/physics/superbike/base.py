"""What every engine of a superbike has in common: commands, memory, telemetry and falls."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import mapping
from bike_sim.physics import state as st
from bike_sim.physics import superbike_forces as sf
from bike_sim.physics.articulated import motion_record
from bike_sim.physics.ground import flat_ground
from bike_sim.physics.state import StateVector
from bike_sim.physics.superbike.compiled import look_one
from bike_sim.physics.superbike.constants import constants_of
from bike_sim.physics.superbike.deflection import deflect
from bike_sim.physics.superbike.records import MEMORY
from bike_sim.physics.superbike.start import begin, superbike_tree, without_rider
from bike_sim.physics.tree import principal_axes
from bike_sim.physics.vectors import Quaternion
from bike_sim.vehicles.superbike import Superbike


class SuperbikeBase(ABC):
    """A superbike that is stepped with a fixed integration step; implements `bike_sim.physics.engine.Engine`.

    The same reset and commands give the same states bit for bit, whatever the engine did before. Once the machine has
    fallen, time passes but nothing moves any more.

    Attributes:
        vehicle: its parameters.
        time_step: integration step, s.
        tree: its bodies and joints.
        motion: of the bodies, a record of `articulated.motion_record`, shape (1,).
        memory: what the forces remember, in the order of `superbike_forces.MEMORY_NAMES`.
        ground: what is under the wheels until it is replaced; level and dry at first.
    """

    def __init__(self, vehicle: Superbike, time_step: float) -> None:
        """Check the arguments and make the records; whoever inherits sets up its integrator and resets.

        Raises:
            ValueError: the vehicle is no superbike, or the time step is not positive and finite.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"vehicle '{vehicle.name}' is no superbike: it has no tyres")
        if not (math.isfinite(time_step) and time_step > 0.0):
            raise ValueError(f"time step must be positive and finite, got {time_step} s")
        self.vehicle = vehicle
        self.time_step = float(time_step)
        self.ground = flat_ground()
        self.tree = superbike_tree(vehicle)
        self._principal: Quaternion = tuple(principal_axes(self.tree[0].inertia)[0].tolist())
        self.motion = np.zeros(1, dtype=motion_record(len(self.tree)))
        self.memory = np.zeros(len(sf.MEMORY_NAMES))
        self._memory = self.memory.view(MEMORY)  # the same numbers, by name
        self._telemetry = np.zeros(1, dtype=sf.TELEMETRY)
        self._measured = self._telemetry.view(np.float64)
        self._constants = constants_of(vehicle, without_rider(vehicle))
        self._state = np.zeros(st.STATE_SIZE)

    def reset(self, state: StateVector) -> None:
        """Set any minimal state, with the tyres carrying the standing machine and the rider riding to this lean.

        The rear wheel rolls without slip; yaw rate and sideways velocity are those of ideal rolling, which the tyres
        correct within a few tenths of a second.

        Raises:
            ValueError: the state has the wrong shape, is not finite, or no such configuration exists.
        """
        state = mapping.checked_state(state)
        begin(self.vehicle, self._constants, self._principal, state, self.ground, self.motion, self._memory)
        self._state = state.copy()
        self.set_motion()
        look_one(
            self._state, self.motion, self._memory.copy(), self._telemetry, self._constants, (0.0, 0.0, self.time_step),
            *self.ground,
        )  # fmt: skip

    def advance(self, steer_set: float, steps: int) -> None:
        """Integrate with a steering set value in parts of `vehicle.max_steer`, without drive or brakes.

        The rider makes a lean of it: this is ``advance_commands(steer_set / vehicle.max_steer, 0, steps)``.
        """
        self.advance_commands(steer_set / self.vehicle.max_steer, 0.0, steps)

    def advance_commands(self, steering: float, throttle: float, steps: int) -> None:
        """Integrate with both commands held.

        Args:
            steering: in [-1, 1], positive to the left; the rider leans the machine that part of his largest lean.
            throttle: in [-1, 1]; above 0 part of the engine's torque, below 0 part of the brakes' force.
            steps: number of integration steps of `time_step`.

        Raises:
            ValueError: a command is not finite or out of range, or the number of steps is negative.
        """
        if not (-1.0 <= steering <= 1.0 and -1.0 <= throttle <= 1.0):
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        if steps < 0:
            raise ValueError(f"steps = {steps} must not be negative")
        self._run(float(steering), float(throttle), steps)

    def deflect(self, x: float, y: float, turn: float, share: float, dx: float, dy: float) -> None:
        """Turn the machine at a wall; see `superbike.deflection`. State and telemetry show it from the next step on."""
        deflect(self.motion, x, y, turn, share, dx, dy)
        self.set_motion()

    def state(self) -> StateVector:
        """Return the minimal state as a fresh vector; yaw and wheel angles are not wrapped."""
        return self._state.copy()

    def telemetry(self) -> NDArray[np.float64]:
        """Return what was measured at the last step, in the order of `superbike_forces.TELEMETRY_NAMES`."""
        return self._measured.copy()

    @property
    def constants(self) -> NDArray[np.void]:
        """What the forces know of the machine, a record of `records.CONSTANTS`, shape (1,), read-only."""
        return self._constants

    @property
    def memories(self) -> NDArray[np.void]:
        """The memory by name, a record of `records.MEMORY`, shape (1,)."""
        return self._memory

    @property
    def fall(self) -> int:
        """How the machine fell, an index of `superbike_forces.FALL_NAMES`; 0 while it rides."""
        return int(self._memory["fall"][0])

    @property
    def fall_name(self) -> str:
        """The same as a word."""
        return sf.FALL_NAMES[self.fall]

    @abstractmethod
    def close(self) -> None:
        """Release what the engine holds; a second call does nothing."""

    @abstractmethod
    def set_motion(self) -> None:
        """Have the integrator go on from `motion`, and write there what it makes of it."""

    @abstractmethod
    def _run(self, steering: float, throttle: float, steps: int) -> None:
        """Step until a fall or to the end, and fill the minimal state."""
