"""The interface of all engines: one vehicle, stepped with its commands held."""

from __future__ import annotations

import math
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from numba import typeof
from numpy.typing import NDArray

from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.state import StateVector
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


class Engine(Protocol):
    """One vehicle, stepped with a fixed integration step.

    Attributes:
        time_step: integration step, s.
    """

    time_step: float

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle's parameters, the steering drive included."""
        ...

    @property
    def fall(self) -> str:
        """Kind of the fall, `NO_FALL` while it rides."""
        ...

    def reset(self, state: StateVector, ground: Ground = LEVEL) -> None:
        """Set any minimal state exactly, positions and velocities; nothing of the earlier ride remains.

        Args:
            state: minimal state, shape (10,).
            ground: under the wheels; ignored by an engine that rolls on a level plane.

        Raises:
            ValueError: the state has the wrong shape, is not finite, or no such configuration exists.
        """
        ...

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
        ...

    def state(self) -> StateVector:
        """Return the minimal state as a fresh vector of ten (see `bike_sim.physics.state`)."""
        ...

    def telemetry(self) -> NDArray[np.float64]:
        """Return the signals of the last step as a fresh vector; empty where the engine has none."""
        ...

    def close(self) -> None:
        """Release the engine's resources; a second call does nothing."""
        ...


@runtime_checkable
class BicycleEngine(Engine, Protocol):
    """An engine of bicycles, which takes set points in rad and can be pushed."""

    def hold(self, steer_set: float, steps: int) -> None:
        """Integrate with the steering drive's set point held.

        The drive's torque, ``-P (steer - steer_set) - D steer_rate`` on the fork and its opposite on
        the rear frame, is evaluated anew at every step (Weyrer et al. 2026, Eq. 2).

        Args:
            steer_set: set point of the steering angle, rad, positive to the left.
            steps: number of integration steps of `time_step`.

        Raises:
            ValueError: the set point is not finite or the number of steps is negative.
        """
        ...

    def push(self, along: float, left: float, ahead: float, height: float) -> None:
        """Push the rear frame with a horizontal force during the next step only.

        Args:
            along: component along its yaw, N.
            left: component to the left of it, N.
            ahead: place of the point ahead of the rear contact, m.
            height: of the point above the rear contact, in the plane of the frame, m.
        """
        ...


def check_commands(steering: float, throttle: float, steps: int) -> None:
    """Check both commands and a number of steps.

    Raises:
        ValueError: a command is not finite or out of range, or the number of steps is negative.
    """
    if not (-1.0 <= steering <= 1.0 and -1.0 <= throttle <= 1.0):
        raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
    if steps < 0:
        raise ValueError(f"steps = {steps} must not be negative")


def checked_time_step(time_step: float) -> float:
    """Return a time step, s.

    Raises:
        ValueError: it is not positive and finite.
    """
    if not (math.isfinite(time_step) and time_step > 0.0):
        raise ValueError(f"time step must be positive and finite, got {time_step} s")
    return float(time_step)
