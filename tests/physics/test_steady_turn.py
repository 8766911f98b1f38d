"""Steady turns: the engine stays in them, and shallow ones are those of the linear equations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.bicycle.linear import state_matrix
from bike_sim.physics.bicycle.steady_turn import LARGEST_LEAN, LARGEST_STEER, steady_turns
from bike_sim.physics.bicycle.whipple import WhippleEngine
from bike_sim.physics.kinematics import rates
from bike_sim.vehicles.files import load_vehicle

BICYCLE = load_vehicle("whipple")


@pytest.mark.parametrize("speed", [5.0, 7.0])
def test_the_engine_stays_in_a_turn(speed: float) -> None:
    """Where the bicycle is stable or unstable by little; half a second is long against the drive's reaction."""
    turns = steady_turns(BICYCLE, speed)
    for place in (1, len(turns.roll) // 2):
        state = np.zeros(st.STATE_SIZE)
        state[st.ROLL], state[st.STEER] = turns.roll[place], turns.steer[place]
        wheel = speed / BICYCLE.rF
        for _ in range(6):  # the front contact is faster than the rear one
            state[st.FRONT_WHEEL_RATE] = wheel
            wheel *= speed / rates(state, BICYCLE.parameters)[1]
        engine = WhippleEngine(BICYCLE, 0.001)
        engine.reset(state)
        engine.hold(float(turns.steer_set[place]), 500)
        after = engine.state()
        assert after[st.ROLL] == pytest.approx(turns.roll[place], abs=1e-6)
        assert after[st.STEER] == pytest.approx(turns.steer[place], abs=1e-6)
        assert after[st.YAW] == pytest.approx(turns.curvature[place] * speed * 0.5, abs=1e-6)


@pytest.mark.parametrize("speed", [2.0, 4.0, 7.0])
def test_shallow_turns_are_those_of_the_linear_equations(speed: float) -> None:
    turns = steady_turns(BICYCLE, speed)
    a = state_matrix(BICYCLE, speed)
    roll, steer, steer_set = turns.roll[1], turns.steer[1], turns.steer_set[1]
    # Rows of the accelerations; the drive's part is the stiffness that its P adds to the steer.
    without = state_matrix(replace(BICYCLE, P=0.0), speed)
    push = (without - a)[2:, 1] * steer_set
    error = a[2:, :2] @ np.array([roll, steer]) + push
    assert np.abs(error).max() < 0.01 * np.abs(push).max()  # at up to 3 deg of lean


def test_a_family_ends_at_its_limits() -> None:
    for speed in (1.0, 2.0, 5.0, 9.0):
        turns = steady_turns(BICYCLE, speed)
        assert len(turns.roll) > 10
        assert (np.diff(turns.curvature) > 0.0).all()
        assert (np.diff(turns.roll) < 0.0).all()
        assert -turns.roll[-1] <= LARGEST_LEAN
        assert turns.steer[-1] <= LARGEST_STEER + 1e-12
    # A point mass on the circle of the rear contact would lean further: the centre of mass runs on a smaller one.
    fast = steady_turns(BICYCLE, 7.0)
    assert -math.tan(fast.roll[-1]) < 49.0 * fast.curvature[-1] / BICYCLE.g
