"""What every engine promises, whatever it simulates: states in and out, the same ride again, and no bad input."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from bike_sim.physics import state as st
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import make_engine
from bike_sim.vehicles.files import load_vehicle

EACH = pytest.mark.parametrize(
    ("kind", "vehicle"),
    [("pybullet", "whipple"), ("whipple", "whipple"), ("pybullet", "panigale_v4r"), ("compiled", "panigale_v4r")],
)
STEP = 0.002

states = some.builds(
    lambda speed, *rest: np.array([*rest, speed]),
    some.floats(0.0, 90.0),
    *(some.floats(-limit, limit) for limit in (1e3, 1e3, 3.0, 1.0, 0.3, 3.0, 3.0, 1.0, 1.0)),
)


@functools.cache
def engine_of(kind: str, vehicle: str, time_step: float = STEP, gravity: float = 9.81) -> Engine:
    """Return one engine for all examples."""
    return make_engine(kind, replace(load_vehicle(vehicle), g=gravity), time_step)


def ride(engine: Engine, start: np.ndarray, chunk: int, other: Engine | None = None) -> np.ndarray:
    """Return the last state of a second's weaving in chunks of the control period of 42 ms."""
    engine.reset(start)
    for k in range(24):
        for _ in range(21 // chunk):
            engine.advance(0.05 * math.sin(0.4 * k), 0.3 * math.cos(0.2 * k), chunk)
            if other is not None:
                other.advance(0.1, 0.0, 2)
    return engine.state()


@EACH
@given(state=states)
def test_any_state_is_set_and_read_back(kind: str, vehicle: str, state: np.ndarray) -> None:
    engine, given_state = engine_of(kind, vehicle), state.copy()
    engine.reset(given_state)
    given_state[:] = 7.0  # kept apart
    engine.state()[:] = 7.0  # a copy
    engine.advance(0.0, 0.0, 0)
    assert engine.state() == pytest.approx(state, rel=1e-9, abs=1e-9)


@EACH
def test_a_ride_is_the_same_whatever_came_before_or_is_beside_it_and_in_any_chunks(kind: str, vehicle: str) -> None:
    engine, neighbour = engine_of(kind, vehicle), engine_of(kind, vehicle, 0.001, 5.0)
    start, elsewhere = (st.upright_state(speed, engine.vehicle.rF) for speed in (6.0, 9.0))
    start[[st.ROLL, st.ROLL_RATE]] = 0.05, -0.1
    first = ride(engine, start, 21)
    elsewhere[[st.X, st.YAW]] = 3.0, 2.0
    assert not np.allclose(ride(engine, elsewhere, 21), first)
    neighbour.reset(elsewhere)
    np.testing.assert_array_equal(ride(engine, start, 21, neighbour), first)
    rounding = 1e-11 if kind == "whipple" else 0.0  # of the part of a step that is left
    for chunk in (7, 1):
        np.testing.assert_allclose(ride(engine, start, chunk), first, rtol=rounding)
    fresh = make_engine(kind, engine.vehicle, STEP)
    np.testing.assert_array_equal(ride(fresh, start, 21), first)
    fresh.close()
    fresh.close()


@EACH
def test_bad_input_is_refused_and_leaves_the_state_alone(kind: str, vehicle: str) -> None:
    engine = engine_of(kind, vehicle)
    engine.reset(st.upright_state(6.0, engine.vehicle.rF))
    before = engine.state()
    for steering, throttle in ((math.nan, 0.0), (1.1, 0.0)):
        with pytest.raises(ValueError, match=r"steer|commands"):
            engine.advance(steering, throttle, 10)
    with pytest.raises(ValueError, match="steps"):
        engine.advance(0.0, 0.0, -1)
    lying, unknown = before.copy(), before.copy()
    lying[st.ROLL], unknown[st.ROLL] = 2.0, math.nan
    for state, message in (
        (lying, "114.592 deg|cannot stand"), (unknown, "roll_rad|10 finite"), (before[:9], r"\(9,\)|10 finite")
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            engine.reset(state)
    np.testing.assert_array_equal(engine.state(), before)
    for step in (0.0, -0.001, math.nan, math.inf):
        with pytest.raises(ValueError, match="time step"):
            make_engine(kind, engine.vehicle, step)
