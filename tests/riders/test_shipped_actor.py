"""Rides of riders of bicycles: the shipped actor as exact as its card says, and closer to the path than the LQR."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from bike_policy.contract.bundle import DEFAULT_POLICY, load_bundle
from bike_policy.riders.rider import make_rider
from bike_sim.course.files import load_course
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import RANDOM_COURSE, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.rollout.rollout import RideResult, ride_through, time_for

EXACT = "whipple_exact"
MEAN, LARGEST = 0.015, 0.15
"""Goals of any ride on the benchmark path at 2 to 7 m/s, m."""


def ridden(name: str, speed: float, course: str = "benchmark") -> RideResult:
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.01))
    request = ResetRequest(course=course, speed_range=(speed, speed))
    result = ride_through(simulator, make_rider(name), request, time_for(load_course(course), speed))
    simulator.close()
    return result


@pytest.mark.parametrize(
    ("name", "speed", "mean", "largest"),
    [
        *((EXACT, speed, MEAN, LARGEST) for speed in (2.0, 4.5, 7.0)),
        *((DEFAULT_POLICY, speed, MEAN, LARGEST) for speed in (1.5, 4.5, 7.0)),
        (DEFAULT_POLICY, 9.0, 0.1, 1.0),  # beyond what it learned by reward
        *(("lqr", speed, 0.05, math.inf) for speed in (2.0, 7.0)),
        *(("stanley", speed, math.inf, most) for speed, most in ((2.0, 0.3), (4.0, 1.0))),  # without preview
    ],
)
def test_the_benchmark_path_is_ridden_exactly(name: str, speed: float, mean: float, largest: float) -> None:
    figures = ridden(name, speed).figures()
    assert figures["completed"]
    assert figures["mean_m"] < mean
    assert figures["max_m"] < largest


def test_a_course_that_ends_elsewhere_is_evaluated_up_to_its_finish() -> None:
    """The last sample lies where the finish is crossed, 32 m beside the start; its error is no larger than others."""
    path = Path(__file__).parents[2] / "docs" / "data" / "paths" / "uturns_8_m.yaml"
    ride = ridden("lqr", 4.0, str(path))
    assert ride.completed
    assert ride.progress[-1] == pytest.approx(load_course(path).length)
    assert ride.figures()["max_m"] < 0.2


def test_at_7_m_s_they_stay_closer_to_the_path_than_the_lqr() -> None:
    actor, exact, lqr = (ridden(name, 7.0).figures() for name in (DEFAULT_POLICY, EXACT, "lqr"))
    assert actor["mean_m"] < 0.8 * lqr["mean_m"]
    assert exact["max_m"] < 0.8 * lqr["max_m"]


@pytest.mark.parametrize("seed", [100, 1100, 2100])
def test_it_rides_a_path_that_bends_before_it_can_lean(seed: int) -> None:
    """Upright starts at 6 m/s; the first bends with 1/5.4 m after 2.4 m. The limits of the set point are for these."""
    simulator = Simulator(SimulatorConfig(time_step=0.001))
    request = ResetRequest(seed=seed, course=RANDOM_COURSE, speed_range=(6.0, 6.0), path_length=236.0)
    figures = ride_through(simulator, make_rider(DEFAULT_POLICY), request, 6.0).figures()
    simulator.close()
    assert figures["completed"]
    assert figures["max_m"] < 2.0


@pytest.mark.parametrize(("name", "own"), [(EXACT, "begins_with"), (DEFAULT_POLICY, "finished_at_step")])
def test_its_card_says_what_it_rides_and_how_it_was_made(name: str, own: str) -> None:
    bundle = load_bundle(name)
    assert bundle.results["completed_count"] == bundle.results["rides_count"] == 21
    assert bundle.results["random_completed_count"] == bundle.results["random_rides_count"] == 105
    assert bundle.results["worst_mean_m"] < MEAN
    assert bundle.results["worst_max_m"] < LARGEST
    assert bundle.results["worst_spectral_radius_upright"] < 0.99
    assert not bundle.training["commit"].endswith("-dirty")
    assert {"seed", "steps", "updates", "seconds", own} <= set(bundle.training)
