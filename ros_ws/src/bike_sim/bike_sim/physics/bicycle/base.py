"""Common part of a bicycle's engines: commands, state and fall."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.engine import NO_FALL, TIP_OVER, check_commands, checked_time_step
from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.vehicles.bicycle import Vehicle


class BicycleBase(ABC):
    """A bicycle that is stepped with a fixed integration step; implements `bike_sim.physics.engine.BicycleEngine`.

    Attributes:
        vehicle: its parameters, the steering drive included.
        time_step: integration step, s.
    """

    def __init__(self, vehicle: Vehicle, time_step: float) -> None:
        """Stand at rest in the upright reference configuration at the origin.

        Raises:
            ValueError: the time step is not positive and finite.
        """
        self.vehicle = vehicle
        self.time_step = checked_time_step(time_step)
        self._state = np.zeros(st.STATE_SIZE)

    @property
    def fall(self) -> str:
        """Whether the roll is beyond the vehicle's limit, as the name of a fall."""
        return TIP_OVER if abs(float(self._state[st.ROLL])) > self.vehicle.fall_roll else NO_FALL

    def advance(self, steering: float, throttle: float, steps: int, ground: Ground = LEVEL) -> None:
        """Integrate with a part of the largest set point held; a bicycle has neither drive nor brakes."""
        check_commands(steering, throttle, steps)
        self.hold(steering * self.vehicle.max_steer, steps)

    @abstractmethod
    def hold(self, steer_set: float, steps: int) -> None:
        """Integrate with the steering drive's set point held, rad; see `engine.BicycleEngine`."""

    def state(self) -> st.StateVector:
        """Return the minimal state as a fresh vector; yaw and wheel angles are not wrapped."""
        return self._state.copy()

    def telemetry(self) -> NDArray[np.float64]:
        """Return no telemetry."""
        return np.zeros(0)

    def _check(self, steer_set: float, steps: int) -> None:
        if not math.isfinite(steer_set):
            raise ValueError(f"steer_set = {steer_set!r} is not a finite angle in rad")
        if steps < 0:
            raise ValueError(f"steps = {steps} must not be negative")
