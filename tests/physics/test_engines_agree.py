"""Two independent engines, one bicycle: they must agree the better the smaller the step."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from bike_sim.physics import bodies as bd
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.bullet import PyBulletEngine
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import BICYCLE_ENGINES, make_engine
from bike_sim.physics.multibody import vectors
from bike_sim.vehicles.files import load_vehicle

VEHICLE = load_vehicle("whipple")
WATCHED = [st.X, st.Y, st.YAW, st.ROLL, st.STEER]


def slalom(engine: Engine, start: np.ndarray, periods: int) -> np.ndarray:
    """Ride with a set point that depends on time only, so that an engine's error is not steered away."""
    steps = round(0.05 / engine.time_step)
    engine.reset(start)
    states = [engine.state()]
    for k in range(periods):
        engine.hold(0.3 * math.sin(1.5 * k), steps)
        states.append(engine.state())
    return np.array(states)


def differences(start: np.ndarray, wanted: np.ndarray, steps: tuple[float, ...]) -> list[np.ndarray]:
    found = []
    for step in steps:
        engine = make_engine("pybullet", VEHICLE, step)
        found.append((slalom(engine, start, len(wanted) - 1) - wanted)[:, WATCHED])
        engine.close()
    return found


@settings(max_examples=15)
@given(
    speed=some.floats(2.0, 7.0),
    roll=some.floats(-0.3, 0.3),
    steer=some.floats(-0.4, 0.4),
    roll_rate=some.floats(-0.5, 0.5),
    steer_rate=some.floats(-1.0, 1.0),
    yaw=some.floats(-3.0, 3.0),
)
def test_from_any_state_bullet_converges_to_the_compiled_bicycle(
    speed: float, roll: float, steer: float, roll_rate: float, steer_rate: float, yaw: float
) -> None:
    start = st.upright_state(speed, VEHICLE.rF)
    start[[st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE, st.YAW]] = roll, steer, roll_rate, steer_rate, yaw
    oracle = make_engine("whipple", VEHICLE, 0.001)
    wanted = slalom(oracle, start, 8)
    # Falling fast, a wheel leaves the ground, which Bullet shows and the ideal bicycle cannot. Compare the time before.
    riding = np.abs(wanted[:, st.ROLL]) < VEHICLE.fall_roll
    coarse, fine = (difference[riding] for difference in differences(start, wanted, (0.001, 0.0005)))
    # halving the step halves the error: what is left of the extrapolation is far below either
    assert np.abs(fine).max() < 0.02
    assert np.abs(2.0 * fine - coarse).max() < 0.1 * np.abs(coarse).max() + 1e-5


def test_a_wheel_without_load_leaves_the_ground_in_bullet_only() -> None:
    # Thrown over at 3 m/s with the steering turning in: ideal constraints would pull, contacts do not.
    start = st.upright_state(3.0, VEHICLE.rF)
    start[[st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE]] = 0.25, 0.5, 1.0, 2.0
    engine = PyBulletEngine(VEHICLE, 0.001)
    engine.reset(start)
    gaps = []
    for _ in range(400):
        engine.hold(0.0, 1)
        bodies = engine.bodies()
        axle = vectors.rotate(bodies.orientations[bd.FRONT_WHEEL], np.array([0.0, 1.0, 0.0]))
        lowest = bodies.positions[bd.FRONT_WHEEL, 2] - VEHICLE.rF * math.hypot(axle[0], axle[1])
        gaps.append(lowest)
    engine.close()
    assert max(gaps) > 5e-4
    assert np.abs(gaps[:50]).max() < 1e-5  # at first it rolls


@pytest.mark.parametrize("kind", BICYCLE_ENGINES)
def test_a_ride_does_not_depend_on_where_and_where_to_it_goes(kind: str) -> None:
    engine = make_engine(kind, VEHICLE, 0.005)
    start = st.upright_state(4.0, VEHICLE.rF)
    start[st.ROLL_RATE] = 0.3
    moved = start.copy()
    moved[[st.X, st.Y, st.YAW, st.REAR_WHEEL, st.FRONT_WHEEL]] = 120.0, -45.0, 2.0, 7.0, -3.0
    here, there = slalom(engine, start, 20), slalom(engine, moved, 20)
    engine.close()
    invariant = [st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]
    # Bullet finds friction's directions in the map frame; ten solver sweeps leave a trace of them
    assert there[:, invariant] == pytest.approx(here[:, invariant], abs=2e-3)
    turn = np.array([[math.cos(2.0), -math.sin(2.0)], [math.sin(2.0), math.cos(2.0)]])
    assert there[:, : st.YAW] == pytest.approx(here[:, : st.YAW] @ turn.T + [120.0, -45.0], abs=2e-3)


def test_energy_of_both_engines_is_the_same_function() -> None:
    from bike_sim.physics.bicycle import whipple as whipple_engine

    rng = np.random.default_rng(4)
    for _ in range(20):
        state = rng.uniform(-1.0, 1.0, st.STATE_SIZE) * [9, 9, 3, 0.7, 1.0, 9, 9, 2, 5, 20]
        assert bd.energy(state, VEHICLE) == pytest.approx(sum(whipple_engine.energy(state, VEHICLE.parameters)))


def test_a_third_code_agrees() -> None:
    pytest.importorskip("exudyn")
    path = Path(__file__).parents[2] / "bench" / "exudyn_bicycle.py"
    spec = importlib.util.spec_from_file_location("exudyn_bicycle", path)
    assert spec is not None
    assert spec.loader is not None
    exudyn_bicycle = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(exudyn_bicycle)
    start = st.upright_state(4.6, VEHICLE.rF)
    start[[st.ROLL_RATE, st.STEER, st.YAW]] = 0.3, 0.2, 1.0
    other = exudyn_bicycle.ExudynBicycle(VEHICLE, 0.001)
    oracle = make_engine("whipple", VEHICLE, 0.005)
    found, wanted = slalom(other, start, 10), slalom(oracle, start, 10)
    assert found[0] == pytest.approx(start, abs=1e-12)
    assert np.abs(wanted[:, st.STEER]).max() > 0.1
    assert found == pytest.approx(wanted, abs=5e-5)


def test_unknown_engine_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="'bullet'; choose one of pybullet, whipple"):
        make_engine("bullet", VEHICLE, 0.005)
