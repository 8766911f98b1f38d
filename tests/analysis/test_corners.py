"""Figures of the lap page against known values: corners, histograms, grip, gears, limits."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_analysis.figures.circuit import Machine, corner_figures
from bike_analysis.figures.numbers import PEAK_USE, grip_used, time_shares
from bike_sim.course.track import Corner
from bike_sim.planning.envelope import envelope
from bike_sim.vehicles.files import load_vehicle
from bike_training.commands.ride import described

CORNERS = (
    Corner("1", begin=300.0, apex=350.0, end=400.0, angle=-1.0, radius=50.0),
    Corner("2", begin=600.0, apex=700.0, end=780.0, angle=1.0, radius=80.0),
)


def trace(slower_from: float = np.inf, slower_to: float = np.inf) -> dict[str, np.ndarray]:
    """1 km at 50 m/s, at 25 m/s in between; the brake is on from 250 to 330 m and from 500 to 520 m."""
    distance = np.linspace(0.0, 1000.0, 10_001)
    speed = np.where((distance >= slower_from) & (distance < slower_to), 25.0, 50.0)
    time = np.concatenate([[0.0], np.cumsum(np.diff(distance) / speed[:-1])])
    brake = np.where((distance >= 250.0) & (distance <= 330.0), 80.0, 0.0)
    brake[(distance >= 505.0) & (distance <= 520.0)] = 4.0  # less than counts
    lean = 60.0 * np.sin(2.0 * np.pi * distance / 1000.0)
    return {"distance": distance, "time": time, "speed": speed, "roll": lean, "brake": brake}


def test_a_corner_tells_braking_speeds_lean_and_what_was_lost() -> None:
    """Half the speed from 340 to 380 m costs 0.8 s: 0.2 s before the apex, 0.6 s from there on."""
    first, second = corner_figures(CORNERS, 1000.0, trace(340.0, 380.0), trace())
    assert (first.name, first.direction, second.direction) == ("1", "right", "left")
    assert first.braking_m == pytest.approx(250.0, abs=0.1)
    assert first.before_apex_m == pytest.approx(100.0, abs=0.1)
    assert second.braking_m is None
    assert (first.entry_speed, first.least_speed, first.exit_speed) == pytest.approx((50.0, 25.0, 50.0))
    assert first.lean_deg == pytest.approx(60.0 * np.sin(2.0 * np.pi * 0.3))
    assert second.lean_deg == pytest.approx(60.0)  # at 750 m
    assert first.lost_s == pytest.approx(0.8, abs=1e-3)
    assert first.lost_in == "exit"
    assert second.lost_s == pytest.approx(0.0, abs=1e-9)
    assert second.lost_in == ""


@given(begin=st.floats(0.0, 900.0), width=st.floats(1.0, 500.0))
def test_corners_together_make_up_the_lap(begin: float, width: float) -> None:
    lap, reference = trace(begin, begin + width), trace()
    lost = sum(corner.lost_s for corner in corner_figures(CORNERS, 1000.0, lap, reference))
    assert lost == pytest.approx(lap["time"][-1] - reference["time"][-1], abs=1e-9)
    assert lost > 0.0


def test_a_corner_on_the_line_ends_with_the_lap() -> None:
    corner = Corner("last", begin=950.0, apex=990.0, end=1040.0, angle=1.0, radius=30.0)
    (found,) = corner_figures((corner,), 1000.0, trace(970.0, 1001.0), trace())
    assert found.exit_speed == 25.0
    assert found.lost_s == pytest.approx(30.0 / 25.0 - 30.0 / 50.0, abs=1e-3)


def test_shares_of_time_are_weighted_by_how_long_a_value_lasts() -> None:
    values, time = np.array([5.0, 15.0, 99.0, np.nan, 5.0]), np.array([0.0, 1.0, 4.0, 5.0, 9.0])
    assert time_shares(values, time, (0.0, 10.0, 20.0)) == pytest.approx((20.0, 80.0))
    assert time_shares(np.full(3, np.nan), np.arange(3.0), (0.0, 1.0)) == (0.0,)


@given(st.lists(st.floats(-50.0, 200.0), min_size=2, max_size=50))
def test_shares_make_up_all_of_the_time(values: list[float]) -> None:
    assert sum(time_shares(np.array(values), np.arange(float(len(values))), (0.0, 10.0, 60.0))) == pytest.approx(100.0)


def test_grip_rises_with_slip_to_its_peak_and_beyond() -> None:
    use = np.linspace(0.0, 6.0, 500)
    grip = grip_used(use)
    assert np.all(np.diff(grip) > 0.0)
    assert grip_used(np.array([0.0, PEAK_USE])) == pytest.approx([0.0, 100.0])
    assert grip_used(np.array([2.0 * PEAK_USE])) == pytest.approx([200.0])
    assert 60.0 < grip_used(np.array([1.0]))[0] < 85.0  # less than linear, as a tyre saturates


@pytest.fixture(scope="module")
def machine() -> Machine:
    bike = load_vehicle("panigale_v4r")
    return described(bike, envelope(bike))


def test_gears_follow_the_wheel_and_the_crank_stays_below_its_limiter(machine: Machine) -> None:
    bike: Any = load_vehicle("panigale_v4r")
    top = bike.top_gear_speed / bike.rR
    spin = np.linspace(0.0, 0.999 * top, 400)
    gear = machine.gear(spin)
    assert np.all(np.diff(gear) >= 0.0)
    assert (gear[0], gear[-1]) == (1.0, 6.0)
    assert np.all(machine.crank_rpm(spin) <= bike.motor.limiter_rpm * 1.02)
    assert machine.crank_rpm(np.array([top]))[0] == pytest.approx(bike.motor.limiter_rpm)
    assert np.isnan(machine.gear(np.array([np.nan]))[0])
    torque = bike._torque_by_gear()
    assert torque[np.arange(len(torque)), bike.wheel_gear - 1] == pytest.approx(bike.wheel_torque)


def test_limits_are_closed_curves_about_the_origin(machine: Machine) -> None:
    bike = load_vehicle("panigale_v4r")
    limits = envelope(bike)
    slow = int(np.argmin(np.abs(machine.speeds - 30.0)))
    x, y = machine.lateral[slow], machine.along[slow]
    assert (x[0], y[0]) == (x[-1], y[-1])
    assert x.max() == pytest.approx(limits.lateral_max[slow])
    assert y.max() == pytest.approx(limits.drive(limits.speeds[slow]), abs=0.3)
    assert y.min() <= -limits.brake(limits.speeds[slow]) + 1e-9
    turns = [np.cross([*a, 0.0], [*b, 0.0])[2] for a, b in pairwise(zip(x, y, strict=True))]
    # clockwise, but for a notch on each side: near the tyres' limit brakes are eased, and only the tyres' drift slows
    assert sum(turn < 1e-9 for turn in turns) > 0.8 * len(turns)


def test_an_old_recording_without_telemetry_still_makes_a_lap_page(writer: Any, circle: Any, tmp_path: Path) -> None:
    """Panels of what was not recorded are left out, those of what was are there."""
    from bike_analysis import open_ride
    from bike_analysis.page.ride_view import ride_view

    ride = circle(steps=300, speed=20.0)
    data = ride_view(open_ride(writer.write(tmp_path / "old.mcap", [ride])).rides[0], "old", "old").data()
    keys = [panel["key"] for panel in data["panels"]]
    assert not {"grip", "slip", "throttle"} & set(keys)
    assert {"error", "lean", "speed", "roll_rate", "torque"} <= set(keys)
    assert data["bands"] == []
