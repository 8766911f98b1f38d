"""The LQR rider: its closed loop, its preview, delays and symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from bike_policy.riders.lqr import LqrSettings, design, lateral_model
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle

PERIOD = 0.05


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
