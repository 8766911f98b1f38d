"""Identification of modes: on a bicycle whose modes are known exactly, and on both engines."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.physics.bicycle import linear
from bike_sim.physics.engines import make_engine
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.modes import (
    WEAVE_BAND,
    WOBBLE_BAND,
    eigenvalues,
    holding_throttle,
    least_damped,
    measure_modes,
)
from bike_sim.validation.superbike import at_speed
from bike_sim.vehicles.files import load_superbike, load_vehicle

VEHICLE = replace(load_vehicle("whipple"), P=0.0, D=0.0)


class LinearEngine:
    """An engine that is exactly linear about straight riding: the discrete transition matrix is a given one."""

    def __init__(self, time_step: float, memory: float = 0.0) -> None:
        self.vehicle, self.time_step, self._memory = VEHICLE, time_step, memory
        self._state = np.zeros(st.STATE_SIZE)

    def reset(self, state: np.ndarray) -> None:
        self._state = state.copy()
        speed = state[st.FRONT_WHEEL_RATE] * VEHICLE.rF
        values, vectors = np.linalg.eig(linear.state_matrix(VEHICLE, speed))
        self._step = np.real(vectors @ np.diag(np.exp(values * self.time_step)) @ np.linalg.inv(vectors))
        # what an engine may do only once, in its first step: here everything shrinks a little
        self._state[list(linear.LATERAL)] *= 1.0 - self._memory

    def advance(self, steering: float, throttle: float, steps: int) -> None:
        lateral = list(linear.LATERAL)
        self._state[lateral] = np.linalg.matrix_power(self._step, steps) @ self._state[lateral]

    def state(self) -> np.ndarray:
        return self._state.copy()

    def close(self) -> None:
        pass


@pytest.mark.parametrize("time_step", [0.001, 0.005, 0.007])
@pytest.mark.parametrize("memory", [0.0, 0.01])
def test_modes_of_a_linear_engine_are_found_exactly(time_step: float, memory: float) -> None:
    engine = LinearEngine(time_step, memory)
    for speed in (2.0, 5.0, 8.0):
        measured, known = linear.measured_modes(engine, speed), linear.modes(VEHICLE, speed)
        assert measured.weave == pytest.approx(known.weave, abs=1e-8)
        assert measured.capsize == pytest.approx(known.capsize, abs=1e-8)
        assert measured.castering == pytest.approx(known.castering, abs=1e-6)


def test_weave_and_capsize_speed_of_a_linear_engine_are_the_published_ones() -> None:
    engine = LinearEngine(0.005)
    # Meijaard et al. (2007), section 5: stable from 4.292 to 6.024 m/s
    assert linear.measured_speed(engine, "weave", 3.5, 5.0) == pytest.approx(4.292, abs=5e-4)
    assert linear.measured_speed(engine, "capsize", 5.5, 7.0) == pytest.approx(6.024, abs=5e-4)


def test_a_bracket_without_a_change_of_stability_is_refused() -> None:
    engine = LinearEngine(0.005)
    with pytest.raises(ValueError, match="no change of stability between 5 and 6 m/s"):
        linear.measured_speed(engine, "weave", 5.0, 6.0)


@pytest.mark.parametrize("kind", ["pybullet", "whipple"])
def test_transition_matrix_is_the_exponential_of_the_state_matrix(kind: str) -> None:
    engine = make_engine(kind, VEHICLE, 0.0005)
    matrix, period = linear.transition_matrix(engine, 5.0)
    values, vectors = np.linalg.eig(linear.state_matrix(VEHICLE, 5.0))
    expected = np.real(vectors @ np.diag(np.exp(values * period)) @ np.linalg.inv(vectors))
    # entries reach the size of one; first-order integration at 0.5 ms leaves a few thousandths in the steering column
    assert matrix == pytest.approx(expected, abs=5e-3 if kind == "pybullet" else 1e-6)
    engine.close()


def test_the_steering_drive_shows_in_the_modes() -> None:
    vehicle = load_vehicle("whipple")
    engine = make_engine("whipple", vehicle, 0.001)
    measured = np.sort_complex(np.linalg.eigvals(linear.measured_state_matrix(engine, 5.0)))
    assert measured == pytest.approx(np.sort_complex(np.linalg.eigvals(linear.state_matrix(vehicle, 5.0))), abs=1e-4)
    assert measured.real.max() > 0.0  # held steering cannot balance


def test_state_matrix_does_not_depend_on_the_direction_of_time_step_rounding() -> None:
    coarse, fine = (make_engine("whipple", VEHICLE, step) for step in (0.0301, 0.001))
    assert linear.measured_modes(coarse, 5.0).weave == pytest.approx(linear.measured_modes(fine, 5.0).weave, rel=1e-3)
    assert math.isfinite(linear.measured_modes(coarse, 5.0).castering)


@pytest.mark.parametrize("speed", [20.0, 45.0])
def test_modes_of_a_moment_are_those_of_straight_running(speed: float) -> None:
    """Pushed in all its states, and in the lateral ones alone, the machine has the same weave and wobble."""
    machine = load_superbike("panigale_v4r")
    engine = at_speed(CompiledSuperbikeEngine(machine, 0.0005), speed, 0.0, 2.0)
    before = engine.motion.copy(), engine.memory.copy()
    found = eigenvalues(engine, (0.0, holding_throttle(machine, speed)))
    np.testing.assert_array_equal(engine.motion, before[0])
    np.testing.assert_array_equal(engine.memory, before[1])
    expected = measure_modes(machine, speed, hands=True)
    assert least_damped(found, WEAVE_BAND) == pytest.approx(expected.weave, rel=0.02)
    assert least_damped(found, WOBBLE_BAND) == pytest.approx(expected.wobble, rel=0.01)


def test_weave_of_a_turn_loses_its_damping_where_the_tyres_are_used_up() -> None:
    """On the brake, which brake control therefore eases in a deep lean."""
    machine = load_superbike("panigale_v4r")
    bare = replace(machine, electronics=replace(machine.electronics, brake_control=0.0))
    growth = {}
    for vehicle, lean, brake in ((machine, 45.0, 0.2), (machine, 55.0, 0.2), (bare, 55.0, 0.2)):
        engine = at_speed(CompiledSuperbikeEngine(vehicle, 0.001), 50.0, lean, 2.0)
        command = (-lean / vehicle.virtual_rider.max_lean_deg, -brake)
        engine.advance(*command, 300)
        growth[vehicle is machine, lean] = least_damped(eigenvalues(engine, command), WEAVE_BAND)
    assert growth[True, 45.0].real < -0.5
    assert growth[True, 55.0].real < 0.0
    assert growth[False, 55.0].real > 0.3
    assert 1.8 < growth[False, 55.0].imag / (2.0 * math.pi) < 2.8
