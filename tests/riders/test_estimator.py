"""Sensors of a bicycle and the estimator: what is measured, what is found of it, and rides on estimates."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bike_policy.riders.disturbed import DisturbedRider
from bike_policy.riders.estimator import FOUND, Estimator
from bike_policy.riders.lqr import LqrRider
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances, RawSensors, read_disturbances
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.sensors import GRAVITY, BicycleSensors, from_geodetic, to_geodetic
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.files import load_superbike, load_vehicle
from bike_training.rollout.rollout import rollout

CONFIG = SimulatorConfig(engine="whipple", time_step=0.01)
BICYCLE = load_vehicle("whipple")
KNOWN = load_disturbances("raw_sensors")


def ridden(disturbances: Disturbances, steps: int = 240, course: str = "benchmark", speed: float = 4.0):
    simulator = Simulator(CONFIG)
    rider = DisturbedRider(LqrRider(), disturbances)
    snapshots = rollout(simulator, rider, ResetRequest(course=course, speed_range=(speed, speed)))
    ride = [snapshot for snapshot, _ in zip(snapshots, range(steps), strict=False)]
    simulator.close()
    return ride, simulator.course, simulator.preview


def estimates(known: Disturbances, ride, course, preview):
    """Return the estimated states of a ride that is ridden on true ones."""
    assert known.raw_sensors is not None
    sensors = BicycleSensors(BICYCLE, known, CONFIG.control_period)
    estimator = Estimator(BICYCLE, course, CONFIG.control_period, preview, known.raw_sensors)
    sensors.begin(ride[0])
    return np.array([estimator.measure(sensors.measure(snapshot)) for snapshot in ride]), estimator


@pytest.mark.parametrize("place", [(0.0, 0.0), (250.0, -130.0), (-4e3, 5e3)])
def test_latitude_and_longitude_lead_back_to_the_place(place: tuple[float, float]) -> None:
    assert from_geodetic(*to_geodetic(*place)) == pytest.approx(place, abs=1e-6)
    # A degree of latitude at 47 deg is 111.17 km on the ellipsoid.
    assert to_geodetic(0.0, 111.17)[0] - 47.0 == pytest.approx(1e-3, rel=1e-4)


def test_a_steady_turn_shows_gravity_and_the_turn() -> None:
    """Of a bicycle that turns evenly the specific force lies in its plane but for what the lean is short of balance."""
    exact = Disturbances(raw_sensors=RawSensors())
    ride, _, _ = ridden(Disturbances(), 160, "circle")
    sensors = BicycleSensors(BICYCLE, exact, CONFIG.control_period)
    sensors.begin(ride[0])
    *_, last = (sensors.measure(snapshot) for snapshot in ride)
    state, look = ride[-1].state, ride[-1].look
    roll, yaw_rate, speed = state[st.ROLL], look[lk.YAW_RATE], look[lk.SPEED]
    left = speed * yaw_rate * math.cos(roll) + GRAVITY * math.sin(roll)
    assert last.force[1] == pytest.approx(left, abs=0.15)
    assert np.hypot(last.force[1], last.force[2]) == pytest.approx(np.hypot(GRAVITY, speed * yaw_rate), rel=0.02)
    assert last.gyro[1:] == pytest.approx([yaw_rate * math.sin(roll), yaw_rate * math.cos(roll)], abs=0.02)


def test_exact_sensors_give_the_state() -> None:
    ride, course, preview = ridden(Disturbances())
    found, _ = estimates(Disturbances(raw_sensors=RawSensors()), ride, course, preview)
    true = np.array([snapshot.state for snapshot in ride])
    places = [st.X, st.Y, st.YAW, st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]
    assert np.abs(found - true)[40:, places].max() < 2e-3


def test_biases_are_found_and_the_position_is_better_than_its_fixes() -> None:
    ride, course, preview = ridden(Disturbances())
    found, estimator = estimates(KNOWN, ride, course, preview)
    true, raw = np.array([snapshot.state for snapshot in ride]), KNOWN.raw_sensors
    assert raw is not None
    sensors = dict(zip(FOUND, estimator.found, strict=True))
    for axis in "xyz":
        assert sensors[f"gyro_bias_{axis}"] == pytest.approx(raw.gyro_bias, abs=1e-3)
    assert sensors["steer_offset"] == pytest.approx(raw.steer_bias, abs=1e-3)
    assert sensors["wheel_scale"] == pytest.approx(raw.wheel_scale - 1.0, abs=2e-3)
    error = (found - true)[120:]
    assert np.abs(error[:, [st.X, st.Y]]).mean() < 0.5 * raw.position
    assert np.abs(error[:, st.ROLL]).mean() < 2e-3


def test_a_late_position_is_as_good_as_one_at_once() -> None:
    ride, course, preview = ridden(Disturbances())
    true, raw = np.array([snapshot.state for snapshot in ride]), KNOWN.raw_sensors
    assert raw is not None
    errors = []
    for delay in (0.0, 0.5):
        late = replace(KNOWN, raw_sensors=replace(raw, position_delay_s=delay))
        found, _ = estimates(late, ride, course, preview)
        errors.append(np.abs((found - true)[120:, [st.X, st.Y]]).mean())
    assert errors[1] < 2.0 * errors[0]


def test_a_ride_on_estimates_repeats_and_stays_near_the_path() -> None:
    first, again = (ridden(KNOWN, 160)[0] for _ in range(2))
    np.testing.assert_array_equal([s.state for s in first], [s.state for s in again])
    assert not first[-1].fallen
    assert np.mean([snapshot.distance for snapshot in first[60:]]) < 0.05


def test_what_cannot_be_estimated_is_refused() -> None:
    text = KNOWN.to_text()
    assert read_disturbances(text, "again") == replace(KNOWN, name="raw_sensors")
    with pytest.raises(ValueError, match=r"raw_sensors has no entry .*gyroscope"):
        read_disturbances('{"format": "bike.disturbances/1", "raw_sensors": {"gyroscope": 1}}', "x")
    with pytest.raises(ValueError, match="noise and bias are of a state"):
        replace(KNOWN, noise={"roll": 0.01})
    with pytest.raises(ValueError, match=r"raw_sensors, which are a bicycle's, not 'r1'"):
        KNOWN.check_sensors(load_superbike("r1"))
    with pytest.raises(ValueError, match=r"position_hz of 15\.0 is not once in a whole number"):
        BicycleSensors(BICYCLE, replace(KNOWN, raw_sensors=RawSensors(position_hz=15.0)), 0.05)
