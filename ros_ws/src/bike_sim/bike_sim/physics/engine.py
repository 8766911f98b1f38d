"""The interface of all engines: one vehicle, stepped with its commands held."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, Final

import numpy as np
from numba import typeof
from numpy.typing import NDArray

from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.state import ROLL, STATE_SIZE, StateVector
from bike_sim.vehicles.bicycle import Vehicle

NO_FALL: Final = "none"
TIP_OVER: Final = "tip_over"


def compiled_entry(function: Any, *args: Any) -> Any:
    """Return the machine code of a compiled function for arguments of these types, layouts of arrays included.

    Numba's own call looks at the type of every argument first, which for records costs as much as a good part of a
    control step.
    """
    kinds = tuple(typeof(value) for value in args)
    function.compile(kinds)
    return function.get_overload(kinds)


class Engine(ABC):
    """One vehicle, stepped with a fixed integration step.

    Attributes:
        vehicle: its parameters, the steering drive included.
        time_step: integration step, s.
    """

    def __init__(self, vehicle: Vehicle, time_step: float) -> None:
        """Take the vehicle; a subclass sets up its integrator and resets.

        Raises:
            ValueError: the time step is not positive and finite.
        """
        if not (math.isfinite(time_step) and time_step > 0.0):
            raise ValueError(f"time step must be positive and finite, got {time_step} s")
        self.vehicle = vehicle
        self.time_step = float(time_step)
        self._state = np.zeros(STATE_SIZE)

    @property
    @abstractmethod
    def fall(self) -> str:
        """Kind of the fall, `NO_FALL` while it rides."""

    @abstractmethod
    def reset(self, state: StateVector, ground: Ground = LEVEL) -> None:
        """Set any minimal state exactly, positions and velocities; nothing of the earlier ride remains.

        Args:
            state: minimal state, shape (10,).
            ground: under the wheels; ignored by an engine that rolls on a level plane.

        Raises:
            ValueError: the state has the wrong shape, is not finite, or no such configuration exists.
        """

    def advance(self, steering: float, throttle: float, steps: int, ground: Ground = LEVEL) -> None:
        """Integrate with both commands held.

        Args:
            steering: in [-1, 1], positive to the left: of a bicycle's largest set point, or of a rider's largest lean.
            throttle: in [-1, 1]: part of the drive's torque, or below 0 of the brakes' force; a bicycle has neither.
            steps: number of integration steps of `time_step`.
            ground: under the wheels; ignored by an engine that rolls on a level plane.

        Raises:
            ValueError: a command is not finite or out of range, or the number of steps is negative.
        """
        if not (-1.0 <= steering <= 1.0 and -1.0 <= throttle <= 1.0):
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        if steps < 0:
            raise ValueError(f"steps = {steps} must not be negative")
        self._run(float(steering), float(throttle), steps, ground)

    @abstractmethod
    def _run(self, steering: float, throttle: float, steps: int, ground: Ground) -> None:
        """Integrate with valid commands."""

    def state(self) -> StateVector:
        """Return the minimal state as a fresh vector of ten; yaw and wheel angles are not wrapped."""
        return self._state.copy()

    def telemetry(self) -> NDArray[np.float64]:
        """Return the signals of the last step as a fresh vector; empty where the engine has none."""
        return np.zeros(0)

    def close(self) -> None:  # noqa: B027
        """Release the engine's resources; a second call does nothing."""


class BicycleEngine(Engine):
    """An engine of bicycles, which takes set points in rad and can be pushed."""

    @property
    def fall(self) -> str:
        """Whether the roll is beyond the vehicle's limit, as the name of a fall."""
        return TIP_OVER if abs(float(self._state[ROLL])) > self.vehicle.fall_roll else NO_FALL

    def _run(self, steering: float, throttle: float, steps: int, ground: Ground) -> None:
        """Integrate with a part of the largest set point held; a bicycle has neither drive nor brakes."""
        self.hold(steering * self.vehicle.max_steer, steps)

    @abstractmethod
    def hold(self, steer_set: float, steps: int) -> None:
        """Integrate with the steering drive's set point held.

        The drive's torque, ``-P (steer - steer_set) - D steer_rate`` on the fork and its opposite on
        the rear frame, is evaluated anew at every step (Weyrer et al. 2026, Eq. 2).

        Args:
            steer_set: set point of the steering angle, rad, positive to the left.
            steps: number of integration steps of `time_step`.
        """

    def push(self, along: float, left: float, ahead: float, height: float) -> None:
        """Push the rear frame with a horizontal force during the next step only.

        Args:
            along: component along its yaw, N.
            left: component to the left of it, N.
            ahead: place of the point ahead of the rear contact, m.
            height: of the point above the rear contact, in the plane of the frame, m.
        """
        raise NotImplementedError
