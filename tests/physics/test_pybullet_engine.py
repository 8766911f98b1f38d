"""The four-body bicycle on Bullet's contacts: set and read back, ride, repeat."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from bike_sim.physics import bodies as bd
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


def test_the_drive_works_against_the_frame_and_not_against_the_world() -> None:
    # Far above the ground and without gravity, the steering drive must not change the angular momentum.
    engine = PyBulletEngine(replace(VEHICLE, g=0.0), 0.0002)
    bullet.resetBasePositionAndOrientation(engine.body, (0.0, 0.0, 50.0), (0.0, 0.0, 0.0, 1.0), engine.client)
    engine.hold(0.5, 500)
    _, frame_rate = bullet.getBaseVelocity(engine.body, engine.client)
    assert engine.state()[st.STEER] > 0.05
    assert frame_rate[2] < -1e-4
    engine.close()


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
