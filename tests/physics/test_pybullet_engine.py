"""The four-body bicycle on Bullet's contacts: set and read back, ride, repeat."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from bike_sim.physics import bodies as bd
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.bullet import PyBulletEngine
from bike_sim.physics.bodies import FORK_JOINT, FRONT_JOINT, REAR_JOINT
from bike_sim.physics.multibody.bullet import bullet
from bike_sim.vehicles.files import load_vehicle

from .test_mapping import states

VEHICLE = load_vehicle("whipple")
COAST = replace(VEHICLE, P=0.0, D=0.0)


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    engine = PyBulletEngine(VEHICLE, 0.005)
    yield engine
    engine.close()


def ride(engine: PyBulletEngine, start: np.ndarray, periods: int = 40, phase: float = 0.0) -> np.ndarray:
    """Weave about: steer into the fall plus a slow swing, in control periods of 50 ms."""
    steps = round(0.05 / engine.time_step)
    engine.reset(start)
    states = [engine.state()]
    for k in range(periods):
        state = states[-1]
        engine.hold(-3.0 * state[st.ROLL] - state[st.ROLL_RATE] + 0.4 * math.sin(0.15 * k + phase), steps)
        states.append(engine.state())
    return np.array(states)


def start(speed: float, roll_rate: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    state = st.upright_state(speed, VEHICLE.rF)
    state[st.ROLL_RATE], state[st.YAW] = roll_rate, yaw
    return state


SHARED = PyBulletEngine(VEHICLE, 0.005)
"""One engine for all examples."""


@given(states)
def test_bullet_places_every_body_where_the_mapping_does(state: np.ndarray) -> None:
    SHARED.reset(state)
    bodies = bd.redundant_from_minimal(state, VEHICLE)
    for link, row in ((REAR_JOINT, bd.REAR_WHEEL), (FORK_JOINT, bd.FORK), (FRONT_JOINT, bd.FRONT_WHEEL)):
        # without computeForwardKinematics Bullet answers with poses of the last step
        found = bullet.getLinkState(
            SHARED.body, link, computeLinkVelocity=1, computeForwardKinematics=1, physicsClientId=SHARED.client
        )
        assert found[0] == pytest.approx(bodies.positions[row], abs=1e-9)
        assert found[6] == pytest.approx(bodies.velocities[row], abs=1e-9)
        assert found[7] == pytest.approx(bodies.angular_velocities[row], abs=1e-9)


def test_a_reset_in_place_forgets_the_contacts(engine: PyBulletEngine) -> None:
    # The nearly same place: what Bullet remembers of the contacts would still fit and be used.
    engine.reset(start(4.0))
    engine.hold(0.3, 1)
    engine.reset(start(4.0))
    engine.hold(0.0, 20)
    fresh = PyBulletEngine(VEHICLE, 0.005)
    fresh.reset(start(4.0))
    fresh.hold(0.0, 20)
    np.testing.assert_array_equal(engine.state(), fresh.state())
    fresh.close()


def test_yaw_and_wheel_angles_are_counted_beyond_a_turn(engine: PyBulletEngine) -> None:
    # Circles to the left, leaning left: tan(0.3 rad) g / v is a turn in about eight seconds.
    engine.reset(start(4.0))
    yaw, turned = [0.0], 0.0
    for _ in range(500):
        state = engine.state()
        engine.hold(0.2 - 3.0 * (state[st.ROLL] + 0.3) - state[st.ROLL_RATE], 10)
        yaw.append(engine.state()[st.YAW])
        turned += kinematics.yaw_rate(engine.state(), VEHICLE.parameters) * 0.05
    assert yaw[-1] > 4.0 * math.pi
    assert np.abs(np.diff(yaw)).max() < 0.1
    assert yaw[-1] == pytest.approx(turned, rel=0.01)
    assert engine.state()[st.FRONT_WHEEL] * VEHICLE.rF == pytest.approx(25.0 * 4.0, rel=0.1)


def test_yaw_is_counted_within_one_long_advance() -> None:
    # A little above the capsize speed the bicycle coasts through a turn and tightens it slowly.
    engine = PyBulletEngine(COAST, 0.005)
    begin = start(6.2)
    begin[st.ROLL], begin[st.STEER] = -0.3, 0.06
    engine.reset(begin)
    engine.hold(0.0, 2400)
    once = engine.state()
    engine.reset(begin)
    for _ in range(2400):
        engine.hold(0.0, 1)
    np.testing.assert_array_equal(engine.state(), once)
    assert once[st.YAW] > math.pi
    engine.close()


def test_coasting_straight_keeps_the_speed() -> None:
    engine = PyBulletEngine(COAST, 0.005)
    engine.reset(start(5.0))
    engine.hold(0.0, 2000)
    state = engine.state()
    assert state[st.FRONT_WHEEL_RATE] * VEHICLE.rF == pytest.approx(5.0, rel=1e-9)
    assert state[st.X] == pytest.approx(50.0, rel=1e-6)
    engine.close()


def test_wheels_roll_without_slip_in_a_slalom(engine: PyBulletEngine) -> None:
    states = ride(engine, start(4.0, 0.3), periods=80)
    rolled = np.diff(states[:, st.REAR_WHEEL]) * VEHICLE.rR
    travelled = np.hypot(*np.diff(states[:, : st.YAW], axis=0).T)
    # between a chord and its arc lies (yaw rate * dt)^2 / 24, and the pitch rate moves the wheel in its frame
    assert rolled == pytest.approx(travelled, rel=5e-3)


def test_the_drive_works_against_the_frame_and_not_against_the_world() -> None:
    # Far above the ground and without gravity, the steering drive must not change the angular momentum.
    engine = PyBulletEngine(replace(VEHICLE, g=0.0), 0.0002)
    bullet.resetBasePositionAndOrientation(engine.body, (0.0, 0.0, 50.0), (0.0, 0.0, 0.0, 1.0), engine.client)
    engine.hold(0.5, 500)
    _, frame_rate = bullet.getBaseVelocity(engine.body, engine.client)
    assert engine.state()[st.STEER] > 0.05
    assert frame_rate[2] < -1e-4
    engine.close()


def test_steer_set_positive_turns_the_fork_and_the_path_to_the_left(engine: PyBulletEngine) -> None:
    engine.reset(start(3.0))
    engine.hold(0.2, 30)
    assert engine.state()[st.STEER] > 0.02
    assert engine.state()[st.YAW] > 0.0
    assert engine.state()[st.ROLL] > 0.0  # steered to the left it falls to the right


def test_closing_gives_the_world_back() -> None:
    engines = [PyBulletEngine(VEHICLE, 0.005) for _ in range(3)]
    clients = [engine.client for engine in engines]
    for engine in engines:
        engine.close()
        engine.close()
    assert all(not bullet.isConnected(client) for client in clients)
    forgotten = PyBulletEngine(VEHICLE, 0.005)
    client = forgotten.client
    del forgotten
    assert not bullet.isConnected(client)
