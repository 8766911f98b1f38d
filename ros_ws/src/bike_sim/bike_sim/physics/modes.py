"""Lateral modes measured on an engine from outside: reset it, let it run, look at where it went.

The engine is a black box here. From upright straight riding each of the four lateral states is pushed a little to
either side. Central differences of where the engine is at one time and one period later give its discrete transition
matrix, whose logarithm is a state matrix in continuous time. What comes out are the modes of the engine as it
integrates, its step included, to compare with the closed formulas of `bike_sim.physics.linear`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from bike_sim.physics import state as st
from bike_sim.physics.engine import Engine
from bike_sim.physics.linear import Matrix, Modes, modes_of

LATERAL: Final = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)
"""The states that roll and steer about straight riding; yaw and position follow from them."""

_SETTLE: Final = 0.05
"""Time from push to first look, s. An engine that solves contacts by velocities carries velocities that roll on the
configuration of the step before; a reset gives it those of the present one, and the first step makes up for that."""
_PERIOD: Final = 0.1
"""Time from first to second look, s: long enough to be well above rounding, and the logarithm is unique up to 31
rad/s."""
_PUSH: Final = 1e-4
"""Size of the push, rad and rad/s: the error of central differences is of its square."""


def transition_matrix(engine: Engine, speed: float) -> tuple[Matrix, float]:
    """Return the discrete transition matrix of the lateral states, and the period it holds for.

    Args:
        engine: any engine; it is left in some other state.
        speed: forward speed, m/s.

    Returns:
        The matrix in the order of `LATERAL`, shape (4, 4), and its period, s.
    """
    settle, steps = max(1, round(_SETTLE / engine.time_step)), max(1, round(_PERIOD / engine.time_step))
    looks = np.zeros((2, 4, 4))
    for column, index in enumerate(LATERAL):
        for push in (_PUSH, -_PUSH):
            state = st.upright_state(speed, engine.vehicle.rF)
            state[index] = push
            engine.reset(state)
            for look, wait in enumerate((settle, steps)):
                engine.advance(0.0, wait)
                looks[look, :, column] += engine.state()[list(LATERAL)] / (2.0 * push)
    before, after = looks
    matrix = np.asarray(np.linalg.solve(before.T, after.T).T, dtype=np.float64)
    return matrix, steps * engine.time_step


def measured_state_matrix(engine: Engine, speed: float) -> Matrix:
    """Return the state matrix in continuous time that explains the measured transition matrix, 1/s, shape (4, 4)."""
    transition, period = transition_matrix(engine, speed)
    values, vectors = np.linalg.eig(transition)
    logarithm = vectors @ np.diag(np.log(values.astype(complex))) @ np.linalg.inv(vectors)
    return np.real(logarithm) / period


def measured_modes(engine: Engine, speed: float) -> Modes:
    """Return the engine's modes at a forward speed in m/s.

    Switch the steering drive off first, ``replace(vehicle, P=0.0, D=0.0)``, to get those of the free bicycle.

    Raises:
        ValueError: the eigenvalues are not those of a weave, a capsize and a castering mode.
    """
    return modes_of(measured_state_matrix(engine, speed))


def measured_weave_speed(engine: Engine, low: float, high: float, tolerance: float = 1e-5) -> float:
    """Return the speed between `low` and `high` at which the weave mode turns stable, m/s, by bisection.

    Raises:
        ValueError: the mode does not change its stability between the two.
    """
    return _root(lambda speed: measured_modes(engine, speed).weave.real, low, high, tolerance)


def measured_capsize_speed(engine: Engine, low: float, high: float, tolerance: float = 1e-5) -> float:
    """Return the speed between `low` and `high` at which the capsize mode turns unstable, m/s, by bisection.

    Raises:
        ValueError: the mode does not change its stability between the two.
    """
    return _root(lambda speed: measured_modes(engine, speed).capsize, low, high, tolerance)


def _root(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Halve a bracket until it is narrower than the tolerance, and return its middle."""
    at_low, at_high = function(low), function(high)
    if at_low * at_high > 0.0:
        raise ValueError(
            f"no change of stability between {low:g} and {high:g} m/s: the mode grows with {at_low:.4g} and "
            f"{at_high:.4g} 1/s there"
        )
    while high - low > tolerance:
        middle = 0.5 * (low + high)
        if function(middle) * at_low > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
