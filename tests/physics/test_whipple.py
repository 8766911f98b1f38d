"""The compiled nonlinear bicycle: published modes, conservation, symmetry, order, and its bad inputs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from numpy.typing import NDArray

from bike_sim.physics import bodies as bd
from bike_sim.physics import kinematics as kin
from bike_sim.physics import state as st
from bike_sim.physics.bicycle import linear, whipple
from bike_sim.physics.bicycle.whipple import WhippleEngine
from bike_sim.physics.multibody import vectors
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle

Array = NDArray[np.float64]
VEHICLE = load_vehicle("whipple")
FREE = replace(VEHICLE, P=0.0, D=0.0)
LATERAL = [st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE]

# Meijaard et al. (2007), Table 2: speed, weave (real, imaginary), capsize, castering.
PUBLISHED_MODES = [
    (4.0, 0.41325331521125, 3.07910818603206, -1.42944427361326, -12.15861426576447),
    (5.0, -0.77534188219585, 4.46486771378823, -0.32286642900409, -14.07838969279822),
    (6.0, -1.52644486584142, 5.87673060598709, -0.00406690076970, -16.08537123098026),
    (8.0, -2.69348683581097, 8.46037971396931, 0.14327879765713, -20.27940894394569),
]


def linearised(vehicle: Vehicle, speed: float) -> Array:
    """Return the lateral state matrix of the nonlinear model by central differences about straight riding.

    The step balances truncation, about step^2 times third derivatives of order 1e3, and rounding, 1e-16 / step.
    """
    step = 3e-6
    columns = []
    for index in LATERAL:
        shift = np.zeros(st.STATE_SIZE)
        shift[index] = step
        upright = st.upright_state(speed, vehicle.rF)
        ahead = whipple.derivative(upright + shift, 0.0, vehicle.parameters)
        behind = whipple.derivative(upright - shift, 0.0, vehicle.parameters)
        columns.append((ahead - behind)[LATERAL] / (2 * step))
    return np.stack(columns, axis=1)


def wobbling(speed: float = 4.6) -> Array:
    """Return the published nonlinear start: straight ahead with 0.5 rad/s of roll rate."""
    state = st.upright_state(speed, VEHICLE.rF)
    state[st.ROLL_RATE] = 0.5
    return state


def ride(state: Array, duration: float, time_step: float, vehicle: Vehicle, steer_set: float = 0.0) -> Array:
    """Return the state after a time with the set point held."""
    state = state.copy()
    assert whipple.advance(state, steer_set, time_step, round(duration / time_step), vehicle.parameters)
    return state


def test_closed_formulas_give_the_published_matrices() -> None:
    """Meijaard et al. (2007), Eqs. (6.1) to (6.4)."""
    matrices = linear.canonical_matrices(VEHICLE)
    mixed = 2.31941332208709
    np.testing.assert_allclose(matrices.M, [[80.81722, mixed], [mixed, 0.29784188199686]], rtol=1e-13)
    mixed = -2.59951685249872
    np.testing.assert_allclose(matrices.K0, [[-80.95, mixed], [mixed, -0.80329488458618]], rtol=1e-13)
    np.testing.assert_allclose(matrices.K2, [[0, 76.59734589573222], [0, 2.65431523794604]], rtol=1e-13)
    damping = [[0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]]
    np.testing.assert_allclose(matrices.C1, damping, rtol=1e-13)


@pytest.mark.parametrize("row", PUBLISHED_MODES)
def test_modes_are_the_published_ones(row: tuple[float, ...]) -> None:
    for modes, tolerance in (
        (linear.modes(VEHICLE, row[0]), 1e-11),
        (linear.modes_of(linearised(FREE, row[0])), 1e-6),
    ):
        figures = (modes.weave.real, modes.weave.imag, modes.capsize, modes.castering)
        assert figures == pytest.approx(row[1:], abs=tolerance)


def test_modes_at_rest_are_the_published_ones() -> None:
    """Two inverted pendula: eigenvalues in pairs of opposite sign."""
    eigenvalues = np.sort(np.linalg.eigvals(linearised(FREE, 0.0)).real)
    published = [-5.53094371765393, -3.13164324790656, 3.13164324790656, 5.53094371765393]
    np.testing.assert_allclose(eigenvalues, published, atol=1e-6)


def test_critical_speeds_are_the_published_ones() -> None:
    assert linear.weave_speed(VEHICLE) == pytest.approx(4.29238253634111, abs=1e-12)
    assert linear.capsize_speed(VEHICLE) == pytest.approx(6.02426201538837, abs=1e-12)


@pytest.mark.parametrize("speed", [0.5, 3.0, 7.0, 10.0])
@pytest.mark.parametrize("vehicle", [VEHICLE, FREE], ids=["driven", "free"])
def test_nonlinear_model_has_the_linear_one_as_its_limit(speed: float, vehicle: Vehicle) -> None:
    expected = linear.state_matrix(vehicle, speed)
    np.testing.assert_allclose(linearised(vehicle, speed), expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_other_bicycles_agree_with_the_published_formulas_too() -> None:
    """Nothing may be right for the benchmark's numbers only: vary every one of them by up to a tenth."""
    rng = np.random.default_rng(5)
    for _ in range(10):
        names = ("w", "c", "lam", "g", "rR", "mR", "xB", "zB", "mB", "IBxz", "xH", "zH", "mH", "rF", "mF")
        variant = replace(VEHICLE, **{name: getattr(VEHICLE, name) * rng.uniform(0.9, 1.1) for name in names})
        expected = linear.state_matrix(variant, 5.0)
        np.testing.assert_allclose(linearised(variant, 5.0), expected, atol=1e-6 * np.abs(expected).max())


def test_energy_is_conserved_to_the_order_of_the_integrator() -> None:
    """Nothing but the integrator changes the energy, so halving the step must divide the change by 16."""
    start = wobbling()
    total = sum(whipple.energy(start, FREE.parameters))
    errors = [abs(sum(whipple.energy(ride(start, 5.0, h, FREE), FREE.parameters)) - total) for h in (0.01, 0.005)]
    assert errors[1] < 1e-9 * total
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.2)


def test_violent_start_settles_to_the_speed_that_its_energy_gives() -> None:
    """Published nonlinear start (4.6 m/s, 0.5 rad/s of roll rate): the wobble ends and its energy is speed.

    By hand: (94 + 0.12 / 0.3^2 + 0.28 / 0.35^2) kg move straight at the end, and 80.81722 kg m2 rolled at the start.
    """
    final = ride(wobbling(), 40.0, 0.005, FREE)
    np.testing.assert_allclose(final[LATERAL], 0.0, atol=1e-4)
    moving = 94.0 + 0.12 / 0.3**2 + 0.28 / 0.35**2
    expected = math.sqrt(4.6**2 + 80.81722 * 0.5**2 / moving)
    assert kin.rear_speed(final, FREE.parameters) == pytest.approx(expected, rel=1e-7)


def test_straight_riding_stays_straight() -> None:
    final = ride(st.upright_state(5.0, VEHICLE.rF), 60.0, 0.005, VEHICLE)
    assert final[[st.Y, st.YAW, *LATERAL]].tolist() == [0.0] * 6
    assert final[st.X] == pytest.approx(300.0, rel=1e-12)
    assert final[st.REAR_WHEEL] == pytest.approx(300.0 / 0.3, rel=1e-12)


states = some.tuples(
    *(some.floats(-limit, limit) for limit in (9.0, 9.0, 3.0, 0.7, 1.0, 9.0, 9.0, 2.0, 2.0, 20.0))
).map(np.array)


@given(states, some.floats(-1.2, 1.2))
def test_mirror_image_is_exact(state: Array, steer_set: float) -> None:
    here, there = state.copy(), st.MIRROR_SIGNS * state
    assert whipple.advance(here, steer_set, 0.005, 10, VEHICLE.parameters) == whipple.advance(
        there, -steer_set, 0.005, 10, VEHICLE.parameters
    )
    np.testing.assert_array_equal(there, st.MIRROR_SIGNS * here)


@given(states)
def test_equations_and_kinematics_agree(state: Array) -> None:
    derivative = whipple.derivative(state, 0.0, VEHICLE.parameters)
    yaw_rate, speed, _ = kin.rates(state, VEHICLE.parameters)
    scale = 1.0 + np.abs(state[st.ROLL_RATE :]).max()
    assert derivative[st.YAW] == pytest.approx(yaw_rate, abs=1e-12 * scale)
    assert math.hypot(derivative[st.X], derivative[st.Y]) == pytest.approx(abs(speed), abs=1e-12 * scale)
    assert derivative[st.REAR_WHEEL] == pytest.approx(kin.rear_wheel_rate(state, VEHICLE.parameters), abs=1e-11 * scale)


@given(states, some.floats(-3.0, 3.0), some.floats(-20.0, 20.0), some.floats(-20.0, 20.0))
def test_place_and_heading_do_not_matter(state: Array, turn: float, dx: float, dy: float) -> None:
    moved = state.copy()
    moved[[st.X, st.Y, st.YAW]] += dx, dy, turn
    first = whipple.derivative(state, 0.1, VEHICLE.parameters)
    second = whipple.derivative(moved, 0.1, VEHICLE.parameters)
    np.testing.assert_array_equal(first[2:], second[2:])


def test_a_fallen_bicycle_stays_where_it_lies() -> None:
    engine = WhippleEngine(FREE, 0.005)
    state = st.upright_state(0.0, VEHICLE.rF)
    state[st.ROLL] = 0.1
    engine.reset(state)
    for _ in range(100):
        engine.hold(0.0, 10)
    assert engine.fall == "tip_over"
    lying = engine.state()
    assert np.isfinite(lying).all()
    assert math.radians(45.0) < abs(lying[st.ROLL]) <= whipple.LYING_ROLL
    engine.hold(0.0, 10)
    np.testing.assert_array_equal(engine.state(), lying)
    engine.reset(state)
    assert engine.fall == "none"


@given(states, some.floats(-1.0, 1.0))
def test_virtual_power_of_the_four_bodies(state: Array, steer_set: float) -> None:
    """Newton's and Euler's laws for each body, d'Alembert's forces by differences: a second derivation."""
    rate, h = whipple.derivative(state, steer_set, VEHICLE.parameters), 1e-5
    masses, tensors = (VEHICLE.mR, VEHICLE.mB, VEHICLE.mH, VEHICLE.mF), bd.inertia_tensors(VEHICLE)

    def momenta(at: Array) -> tuple[Array, Array]:
        motion = bd.redundant_from_minimal(at, VEHICLE)
        spins = []
        for tensor, turn, omega in zip(tensors, motion.orientations, motion.angular_velocities, strict=True):
            spins.append(vectors.rotate(turn, tensor @ vectors.rotate(vectors.conjugate(turn), omega)))
        return np.array(masses)[:, None] * motion.velocities, np.array(spins)

    change = [(b - a) / (2.0 * h) for a, b in zip(momenta(state - h * rate), momenta(state + h * rate), strict=True)]
    change[0][:, 2] += VEHICLE.g * np.array(masses)
    for index in (st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE):
        unit = state.copy()
        unit[[st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]] = 0.0
        unit[index] = 1.0
        motion = bd.redundant_from_minimal(unit, VEHICLE)
        powers = [change[0] * motion.velocities, change[1] * motion.angular_velocities]
        torque = -VEHICLE.P * (state[st.STEER] - steer_set) - VEHICLE.D * state[st.STEER_RATE]
        wanted = torque if index == st.STEER_RATE else 0.0
        assert np.sum(powers) == pytest.approx(wanted, abs=1e-6 * (1.0 + np.abs(powers).max()))
