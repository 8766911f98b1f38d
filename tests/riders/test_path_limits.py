"""The offline optimum: its derivatives are right, and it is never worse than what it starts from."""

from __future__ import annotations

import numpy as np
import pytest

from bench.path_limits import linearised, optimised, ride, whole_ride, window_of
from bike_sim.course.files import load_course
from bike_sim.vehicles.files import load_vehicle


@pytest.mark.parametrize("speed", [3.0, 6.0])
def test_the_optimum_rides_more_exactly_than_the_ride_it_starts_from(speed: float) -> None:
    course, vehicle = load_course("benchmark"), load_vehicle("whipple")
    snapshots = whole_ride("lqr", "benchmark", speed)
    bend = dict(course.sections)["hard lane change"]
    window = window_of(snapshots, course, vehicle, bend, bend + 5.0)
    before = ride(window, lambda k, _: float(window.commands[k]))
    # The window's own commands ride what the rider rode.
    first = next(k for k, each in enumerate(snapshots) if (each.state == window.state).all())
    np.testing.assert_allclose(
        before.states, [each.state for each in snapshots[first:][: len(before.states)]], atol=1e-6
    )
    after = optimised(window)
    assert after.cost < 0.9 * before.cost
    assert np.abs(after.commands).max() <= vehicle.max_steer


def test_the_linearisation_predicts_small_changes() -> None:
    course, vehicle = load_course("circle"), load_vehicle("whipple")
    window = window_of(whole_ride("lqr", "circle", 5.0), course, vehicle, 40.0, 42.0)
    base = ride(window, lambda k, _: float(window.commands[k]))
    a, b = linearised(window, base)
    change = 1e-4
    moved = ride(window, lambda k, _: float(window.commands[k]) + change * (k == 0))
    # Two periods on, through the effect of the command on the state and of the state on the next one.
    expected = a[1] @ b[0] * change
    np.testing.assert_allclose(moved.states[2] - base.states[2], expected, atol=2e-3 * np.abs(expected).max())
