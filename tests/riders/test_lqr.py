"""The LQR rider: its closed loop, its preview, delays, symmetry, and that it rides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from bike_policy.riders.lqr import LqrSettings, design, lateral_model
from bike_policy.riders.rider import make_rider
from bike_sim.course.files import load_course
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.rollout.rollout import ride_through

PERIOD = 0.05
COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)


@pytest.fixture(scope="module")
def bicycle() -> Vehicle:
    return load_vehicle("whipple")


def held(bicycle: Vehicle, speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The model over a control period, by the exponential of the whole system."""
    a, b, e = lateral_model(bicycle, speed)
    big = np.zeros((8, 8))
    big[:6] = np.column_stack([a, b, e])
    big = expm(big * PERIOD)
    return big[:6, :6], big[:6, 6], big[:6, 7]


@pytest.mark.parametrize("speed", [2.0, 3.0, 4.5, 6.0, 7.0])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_closed_loop_is_stable_also_with_the_delay_that_it_knows(bicycle: Vehicle, speed: float, delay: int) -> None:
    gains = design(bicycle, speed, PERIOD, LqrSettings(delay=delay))
    a, b, _ = held(bicycle, speed)
    size = 6 + delay
    loop = np.zeros((size, size))
    loop[:6, :6] = a
    if delay:
        loop[:6, 6] = b
        loop[6 : size - 1, 7:] = np.eye(delay - 1)
        loop[-1] = -gains.state
    else:
        loop[:6, :6] -= np.outer(b, gains.state)
    assert np.abs(np.linalg.eigvals(loop)).max() < 0.999


def test_a_steady_turn_is_ridden_without_an_offset(bicycle: Vehicle) -> None:
    """In the linear model, where the preview sees the same curvature as far as it looks."""
    for speed in (3.0, 5.0):
        gains = design(bicycle, speed, PERIOD, LqrSettings(horizon=12.0))
        a, b, e = held(bicycle, speed)
        kappa = 0.02
        drive = -gains.preview.sum() * kappa
        x = np.linalg.solve(np.eye(6) - a + np.outer(b, gains.state), b * drive + e * kappa)
        assert abs(x[0]) < 2e-3  # m


@pytest.mark.parametrize("speed", [2.0, 7.0])
def test_rides_the_benchmark_path(speed: float) -> None:
    simulator = Simulator(COMPILED)
    request = ResetRequest(course="benchmark", speed_range=(speed, speed))
    ride = ride_through(simulator, make_rider("lqr"), request, 1.5 * load_course("benchmark").length / speed)
    simulator.close()
    assert ride.completed
    assert ride.figures()["mean_m"] < 0.05


def test_a_course_that_ends_elsewhere_is_evaluated_up_to_its_finish() -> None:
    """The last sample lies where the finish is crossed, 32 m beside the start; its error is no larger than others."""
    path = Path(__file__).parents[2] / "docs" / "data" / "paths" / "uturns_8_m.yaml"
    course, simulator = load_course(path), Simulator(COMPILED)
    request = ResetRequest(course=str(path), speed_range=(4.0, 4.0))
    ride = ride_through(simulator, make_rider("lqr"), request, 1.5 * course.length / 4.0)
    simulator.close()
    assert ride.completed
    assert ride.progress[-1] == pytest.approx(course.length)
    assert ride.figures()["max_m"] < 0.2
