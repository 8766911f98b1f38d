"""From minimal to redundant coordinates: ideal rolling, the derivative of the poses, mirror images."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from bike_sim.physics import bodies as bd
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.multibody import vectors
from bike_sim.vehicles.files import load_vehicle

VEHICLE = load_vehicle("whipple")


def number(limit: float) -> some.SearchStrategy[float]:
    return some.floats(-limit, limit, allow_subnormal=False)


states = some.tuples(
    number(1e3),
    number(1e3),
    number(20.0),
    number(math.radians(60.0)),
    number(math.radians(75.0)),
    number(500.0),
    number(500.0),
    number(4.0),
    number(10.0),
    number(60.0),
).map(np.array)


@given(states)
def test_both_contacts_touch_the_ground_and_do_not_slip(state: np.ndarray) -> None:
    bodies = bd.redundant_from_minimal(state, VEHICLE)
    contacts = np.zeros((2, 3))
    contacts[0, :2] = state[: st.YAW]
    contacts[1, :2] = kinematics.front_contact(state, VEHICLE.parameters)
    for wheel, contact, radius in zip((bd.REAR_WHEEL, bd.FRONT_WHEEL), contacts, (VEHICLE.rR, VEHICLE.rF), strict=True):
        arm = contact - bodies.positions[wheel]
        axle = vectors.rotate(bodies.orientations[wheel], np.array([0.0, 1.0, 0.0]))
        assert np.linalg.norm(arm) == pytest.approx(radius)
        assert arm @ axle == pytest.approx(0.0, abs=1e-9)
        slip = bodies.velocities[wheel] + np.cross(bodies.angular_velocities[wheel], arm)
        assert slip == pytest.approx(np.zeros(3), abs=1e-9)


@given(states)
def test_velocities_are_the_derivative_of_the_positions(state: np.ndarray) -> None:
    yaw_rate, speed, _ = kinematics.rates(state, VEHICLE.parameters)
    rate = np.zeros(st.STATE_SIZE)
    rate[st.X], rate[st.Y] = speed * math.cos(state[st.YAW]), speed * math.sin(state[st.YAW])
    rate[st.YAW] = yaw_rate
    rate[[st.ROLL, st.STEER, st.FRONT_WHEEL]] = state[[st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]]
    rate[st.REAR_WHEEL] = kinematics.rear_wheel_rate(state, VEHICLE.parameters)
    h = 1e-5
    ahead = bd.redundant_from_minimal(state + h * rate, VEHICLE)
    behind = bd.redundant_from_minimal(state - h * rate, VEHICLE)
    now = bd.redundant_from_minimal(state, VEHICLE)
    difference = (ahead.positions - behind.positions) / (2.0 * h)
    # central difference: h^2 / 6 times a third derivative that grows with the cube of the rates
    assert difference == pytest.approx(now.velocities, abs=1e-4)
    for before, after, omega in zip(behind.orientations, ahead.orientations, now.angular_velocities, strict=True):
        turn = vectors.multiply(after, vectors.conjugate(before))
        assert turn[:3] * math.copysign(1.0, turn[3]) / h == pytest.approx(omega, abs=1e-4)


@given(states)
def test_mirror_image_of_the_state_is_the_mirror_image_of_the_bodies(state: np.ndarray) -> None:
    one = bd.redundant_from_minimal(state, VEHICLE)
    other = bd.redundant_from_minimal(state * st.MIRROR_SIGNS, VEHICLE)
    assert other.positions == pytest.approx(one.positions * [1, -1, 1], abs=1e-9)
    assert other.velocities == pytest.approx(one.velocities * [1, -1, 1], abs=1e-9)
    assert other.angular_velocities == pytest.approx(one.angular_velocities * [-1, 1, -1], abs=1e-9)


def test_upright_bicycle_stands_where_the_parameters_say() -> None:
    bodies = bd.redundant_from_minimal(st.upright_state(3.5, VEHICLE.rF), VEHICLE)
    assert bodies.positions[bd.REAR_FRAME] == pytest.approx([0.3, 0.0, 0.9])
    assert bodies.positions[bd.FORK] == pytest.approx([0.9, 0.0, 0.7])
    assert bodies.positions[bd.FRONT_WHEEL] == pytest.approx([1.02, 0.0, 0.35])
    assert bodies.velocities == pytest.approx(np.tile([3.5, 0.0, 0.0], (4, 1)))
    assert bodies.angular_velocities[:, 1] == pytest.approx([3.5 / 0.3, 0.0, 0.0, 10.0])


def test_energy_of_straight_riding_by_hand() -> None:
    # 94 kg and two rolling wheels at 3.5 m/s; heights 0.3, 0.9, 0.7, 0.35 m of 2, 85, 4 and 3 kg at 9.81 N/kg
    kinetic = 0.5 * 94.0 * 3.5**2 + 0.5 * 0.12 * (3.5 / 0.3) ** 2 + 0.5 * 0.28 * 10.0**2
    potential = 9.81 * (2 * 0.3 + 85 * 0.9 + 4 * 0.7 + 3 * 0.35)
    assert bd.energy(st.upright_state(3.5, 0.35), VEHICLE) == pytest.approx(kinetic + potential)
