"""Lines within limits: where they must lie, that they are optimal, and that they are found in time."""

import math
import time

import numpy as np
import pytest

from bike_sim.course import racing_line
from bike_sim.course.csv_line import parse_csv
from bike_sim.course.files import load_track
from bike_sim.course.reading import track_from_points
from bike_sim.planning.envelope import point_mass_envelope
from bike_sim.planning.lap_limit import lap_limit
from bike_sim.planning.minimum_time import fastest_offsets, polygon_time, time_gradient, with_fastest_line

MACHINE = point_mass_envelope(1.4)


@pytest.fixture(scope="module")
def barcelona():
    return load_track("barcelona")


def test_curvature_of_a_circle_is_exact_at_any_offset(shapes):
    stations = racing_line.stations_of(shapes.circle(100.0), 1.0)
    for offset in (0.0, 4.0, -4.0):
        curvature, length = racing_line.curvature_of(stations, np.full(stations.count, offset))
        # Of a regular polygon's circumscribed circle, to second order in the step.
        assert curvature == pytest.approx(1.0 / (100.0 - offset), rel=1e-4)
        assert np.sum(length) == pytest.approx(2.0 * math.pi * (100.0 - offset), rel=1e-4)


def test_derivative_of_curvature_is_that_of_differences(shapes, barcelona):
    rng = np.random.default_rng(0)
    for track in (shapes.oval(), barcelona):
        stations = racing_line.stations_of(track)
        offset = rng.uniform(-1.0, 1.0, stations.count)
        _, _, jacobian = racing_line.curvature_jacobian(stations, offset)
        step = 1e-6 * rng.normal(size=stations.count)
        ahead, _ = racing_line.curvature_of(stations, offset + step)
        behind, _ = racing_line.curvature_of(stations, offset - step)
        assert jacobian @ step == pytest.approx(0.5 * (ahead - behind), rel=1e-4, abs=1e-12)


def test_line_of_least_curvature_on_a_ring_is_its_outer_edge(shapes):
    # The larger the circle the less it bends: 2 pi / R.
    track = racing_line.with_ideal_line(shapes.circle(100.0, 12.0), margin=0.5)
    assert track.ideal == pytest.approx(-5.5, abs=0.01)


def test_line_keeps_its_margin_and_uses_the_road(barcelona):
    track = racing_line.with_ideal_line(barcelona, margin=0.8)
    assert track.ideal.max() == pytest.approx(5.2, abs=0.02)
    assert track.ideal.min() == pytest.approx(-5.2, abs=0.02)


def test_no_change_of_the_line_bends_less(barcelona):
    stations = racing_line.stations_of(barcelona)
    best = racing_line.least_curvature(stations)

    def bending(offset):
        curvature, length = racing_line.curvature_of(stations, offset)
        return float(np.sum(length * curvature**2))

    assert bending(best) < 0.9 * bending(np.zeros(stations.count))
    rng = np.random.default_rng(5)
    for _ in range(30):
        # Smooth changes of some tens of metres; rough ones bend more without question.
        middle, width = rng.integers(stations.count), rng.uniform(5.0, 30.0)
        apart = (np.arange(stations.count) - middle + stations.count // 2) % stations.count - stations.count // 2
        bump = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 1.0) * np.exp(-((apart / width) ** 2))
        assert bending(np.clip(best + bump, stations.lowest, stations.highest)) > bending(best) * (1.0 - 5e-4)


def test_gradient_of_the_lap_time_is_that_of_differences(barcelona):
    stations = racing_line.stations_of(barcelona)
    tables = MACHINE.limits
    offset = 2.0 * np.sin(np.arange(stations.count) / 15.0)
    gradient, spent = time_gradient(stations, offset, tables)
    assert np.sum(spent) == pytest.approx(polygon_time(stations, offset, tables), rel=1e-9)
    rng = np.random.default_rng(2)
    agreed = 0
    for _ in range(40):
        middle = rng.integers(stations.count)
        apart = (np.arange(stations.count) - middle + stations.count // 2) % stations.count - stations.count // 2
        bump = 1e-5 * np.exp(-((apart / 4.0) ** 2))
        ahead, behind = (polygon_time(stations, offset + sign * bump, tables) for sign in (1.0, -1.0))
        agreed += gradient @ bump == pytest.approx(0.5 * (ahead - behind), rel=0.02, abs=1e-9)
    # Where the limit that binds changes within the bump there is no derivative.
    assert agreed >= 34


def test_fastest_line_on_a_ring_is_its_inner_edge(shapes):
    # Time is proportional to the root of the radius: the line that bends least is the slowest of all.
    track = shapes.circle(100.0, 12.0)
    fastest = with_fastest_line(track, MACHINE)
    assert np.mean(fastest.ideal) == pytest.approx(5.5, abs=0.1)
    gentle = racing_line.with_ideal_line(track)
    assert lap_limit(MACHINE, gentle.line(1.0)).lap_time > lap_limit(MACHINE, track.centre).lap_time
    assert lap_limit(MACHINE, fastest.line(1.0)).lap_time < lap_limit(MACHINE, track.centre).lap_time


RECORD = 99.49
"""WorldSBK's best lap in Barcelona (2024 and 2025), s, of machines that corner as this one."""


def test_ideal_line_is_found_in_time_is_faster_and_near_the_record(barcelona):
    track = barcelona
    lap_limit(MACHINE, track.centre)  # compiles
    began = time.process_time()
    track = with_fastest_line(track, MACHINE)
    assert time.process_time() - began < 10.0
    median, ideal = (lap_limit(MACHINE, line).lap_time for line in (track.centre, track.line(1.0)))
    gentle = lap_limit(MACHINE, racing_line.with_ideal_line(track).line(1.0)).lap_time
    assert ideal < gentle < median
    assert ideal < median - 3.0
    assert ideal == pytest.approx(RECORD, rel=0.03)
    # Between both ends the family is between both laps.
    assert ideal < lap_limit(MACHINE, track.line(0.5)).lap_time < median
    # A line to ride: curvature without jumps.
    line = track.line(1.0)
    assert np.abs(np.diff(line.curvature)).max() / line.spacing < 0.01


def test_mirrored_circuit_has_the_mirrored_line(shapes):
    ring = shapes.ring_points()
    texts = (shapes.csv_text(ring, 5.0, 6.0), shapes.csv_text(ring * [1.0, -1.0], 6.0, 5.0))
    stations, other = (racing_line.stations_of(track_from_points("ring", parse_csv(text))) for text in texts)
    line, image = racing_line.least_curvature(stations), racing_line.least_curvature(other)
    assert image == pytest.approx(-line, abs=0.02)


def test_descent_never_makes_a_lap_slower(shapes):
    stations = racing_line.stations_of(shapes.oval(60.0, 400.0))
    tables = MACHINE.limits
    start = racing_line.least_curvature(stations)
    found = fastest_offsets(stations, tables, start)
    assert np.all(found <= stations.highest + 1e-9)
    assert np.all(found >= stations.lowest - 1e-9)
    assert polygon_time(stations, found, tables) <= polygon_time(stations, start, tables)


def test_stations_need_a_distance(shapes):
    with pytest.raises(ValueError, match="station spacing"):
        racing_line.stations_of(shapes.circle(), 0.0)
