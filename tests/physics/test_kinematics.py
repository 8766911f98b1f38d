"""Closed-form kinematics against the published table and against finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from bike_sim.physics import kinematics as kin
from bike_sim.physics import state as st
from bike_sim.vehicles.files import load_vehicle

VEHICLE = load_vehicle("whipple")
P = VEHICLE.parameters

angles = some.tuples(some.floats(-75.0, 75.0), some.floats(-75.0, 75.0)).map(np.radians)
states = some.tuples(
    *(some.floats(-limit, limit) for limit in (50.0, 50.0, 6.0, 1.2, 1.2, 9.0, 9.0, 3.0, 4.0, 25.0))
).map(np.array)


def test_reference_configuration() -> None:
    state = st.upright_state(4.0, VEHICLE.rF)
    assert kin.pitch(0.0, 0.0, P) == pytest.approx(0.0, abs=1e-15)
    assert kin.front_contact(state, P) == pytest.approx((1.02, 0.0), abs=1e-14)
    assert kin.rear_speed(state, P) == pytest.approx(4.0, rel=1e-14)
    assert kin.rear_wheel_rate(state, P) == pytest.approx(4.0 / 0.3, rel=1e-14)
    assert kin.yaw_rate(state, P) == 0.0
    assert kin.pitch_rate(state, P) == 0.0


@given(angles)
def test_front_wheel_touches_the_ground_ahead_of_the_rear_one(angle: np.ndarray) -> None:
    roll, steer = angle
    geometry = kin.steering_geometry(P)
    qx, _qy, qz, _nx, _ny = kin._contact(roll, kin.pitch(roll, steer, P) - VEHICLE.lam, steer, geometry)
    assert abs(qz) < 1e-13
    assert qx > 0.1


@given(angles)
def test_pitch_is_continuous_from_upright(angle: np.ndarray) -> None:
    """Newton's start at zero pitch and following the solution from upright in small steps end at the same root."""
    roll, steer = angle
    geometry = kin.steering_geometry(P)
    beta = kin.pitch(0.0, steer, P) - VEHICLE.lam
    for part in np.linspace(0.0, 1.0, 60)[1:]:
        beta = kin.solve_beta(part * roll, beta, steer, geometry)
    assert beta + VEHICLE.lam == pytest.approx(kin.pitch(roll, steer, P), abs=1e-10)


def test_pitch_is_nan_where_no_bicycle_can_stand() -> None:
    assert math.isnan(kin.pitch(math.radians(80.0), math.radians(70.0), P))


@given(some.floats(-1.0, 1.0), some.floats(-1.2, 1.2), some.floats(-20.0, 20.0))
def test_steady_turning_follows_the_published_yaw_rate(roll: float, steer: float, wheel_rate: float) -> None:
    """Eq. (A.9) at constant roll and steer, with the wheel base's part along the rear wheel's heading.

    Dividing by the whole distance of the contacts, as printed, leaves out that Q is not straight ahead of P.
    """
    state = np.zeros(st.STATE_SIZE)
    state[[st.ROLL, st.STEER, st.FRONT_WHEEL_RATE]] = roll, steer, wheel_rate
    ahead, _ = kin.front_contact_offset(roll, steer, P)
    expected = math.sin(kin.front_direction(roll, steer, P)) * VEHICLE.rF * wheel_rate / ahead
    assert kin.yaw_rate(state, P) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(states)
def test_mirror_image(state: np.ndarray) -> None:
    """Reflection about the map's x axis is exact: every sum has the same terms with the same or the other sign."""
    mirrored = st.MIRROR_SIGNS * state
    assert kin.pitch(mirrored[st.ROLL], mirrored[st.STEER], P) == kin.pitch(state[st.ROLL], state[st.STEER], P)
    yaw_rate, speed, pitch_rate = kin.rates(state, P)
    assert kin.rates(mirrored, P) == (-yaw_rate, speed, pitch_rate)
    x, y = kin.front_contact(state, P)
    assert kin.front_contact(mirrored, P) == (x, -y)
