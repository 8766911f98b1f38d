"""Figures of rides whose motion is known in closed form."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bike_analysis import find_rides, read_recording, ride_figures
from bike_analysis.figures.metrics import Figures, latency_figures
from bike_analysis.figures.numbers import command_ages, rate
from bike_analysis.figures.rides import Ride
from bike_analysis.read.messages import Latency


@pytest.fixture
def ride_of(writer, tmp_path: Path):
    """Write synthetic rides, read them back and give the rides and their figures."""

    def make(*rides, **options) -> tuple[list[Ride], list[Figures]]:
        found = find_rides(read_recording(writer.write(tmp_path / "ride.mcap", rides, overwrite=True, **options)))
        return list(found), [ride_figures(ride) for ride in found]

    return make


def test_circle_at_constant_offset(ride_of, circle) -> None:
    """0.3 m inside a circle of 10 m, 399 steps of 0.05 s at 4 m/s of progress."""
    _, (figures,) = ride_of(circle(steps=400, radius=10.0, offset=0.3, speed=4.0))
    assert (figures.mean_error_m, figures.max_error_m, figures.rms_error_m) == pytest.approx((0.3,) * 3)
    assert figures.duration_s == pytest.approx(399 * 0.05)
    chord = 2 * 9.7 * np.sin(0.5 * 4.0 * 0.05 / 10.0)  # the driven circle has a radius of 9.7 m
    assert figures.distance_m == pytest.approx(399 * chord)
    assert (figures.speed_min_m_s, figures.speed_mean_m_s, figures.speed_max_m_s) == pytest.approx((4.0, 4.0, 4.0))
    assert figures.roll_min_deg == figures.roll_max_deg == pytest.approx(-np.degrees(np.arctan(16 / 98.1)))
    assert figures.steer_max_deg == pytest.approx(np.degrees(0.1))
    assert figures.laps == 1  # 79.8 m of 62.8 m
    assert (figures.ended_by, figures.completed, figures.falls, figures.off_course) == ("finished", True, 0, 0)
    assert (figures.steps, figures.lost_steps, figures.repeated_states, figures.unanswered_states) == (400, 0, 0, 0)


def test_offset_that_changes_sign_and_size(ride_of, circle) -> None:
    """+0.1, -0.2, +0.3, -0.4 over and over: mean 0.25, maximum 0.4, RMS sqrt(0.075)."""
    offset = np.tile([0.1, -0.2, 0.3, -0.4], 50)
    _, (figures,) = ride_of(circle(steps=200, offset=offset))
    errors = (figures.mean_error_m, figures.max_error_m, figures.rms_error_m, figures.max_error_at_m)
    assert errors == pytest.approx((0.25, 0.4, np.sqrt(0.075), 3 * 0.2))


def test_sections(ride_of, circle) -> None:
    """First half of the circle at 0.1 m, second half at 0.4 m, and 30 states of a second lap at 0.2 m."""
    progress = 0.2 * np.arange(345)
    lap, half = 20 * np.pi, 10 * np.pi
    offset = np.where(progress < half, 0.1, np.where(progress < lap, 0.4, 0.2))
    _, (figures,) = ride_of(circle(steps=345, offset=offset))
    first, second = figures.sections
    assert (first["name"], second["name"]) == ("first half", "second half")
    assert first["samples"] + second["samples"] == 345
    again = int(np.sum(progress >= lap))
    assert first["samples"] == int(np.sum(progress < half)) + again
    assert first["mean_error_m"] == pytest.approx((0.1 * (first["samples"] - again) + 0.2 * again) / first["samples"])
    assert first["max_error_m"] == pytest.approx(0.2)
    assert (second["mean_error_m"], second["rms_error_m"], second["max_error_m"]) == pytest.approx((0.4, 0.4, 0.4))


def test_fall_and_off_course(ride_of, circle) -> None:
    falling = circle(steps=50)
    falling.states["fallen"] = np.arange(50) >= 48
    falling.events = [{"step": 48, "kind": 1, "time": 2.4, "text": "fell"}]
    leaving = circle(steps=50, episode=2, start_s=9.0)
    leaving.states["off_course"] = np.arange(50) >= 49
    unseen = circle(steps=50, episode=3, start_s=19.0, events=[{"step": 49, "kind": 1}])  # flag not set
    _, figures = ride_of(falling, leaving, unseen)
    assert [f.ended_by for f in figures] == ["fell", "off_course", "fell"]
    assert [f.falls for f in figures] == [1, 0, 1]
    assert [f.off_course for f in figures] == [0, 1, 0]
    assert not any(f.completed for f in figures)
    ride = circle(steps=400)  # the lap is full after 315 steps
    ride.states["fallen"] = np.arange(400) >= 390
    _, (after,) = ride_of(ride)
    assert (after.ended_by, after.completed, after.falls) == ("finished", True, 1)


def test_rides_are_found_also_after_a_restart(ride_of, circle) -> None:
    """Episodes 1, 2, and 1 again from a simulator that was started anew; each keeps its own commands and course."""
    third = circle(steps=30, episode=1, start_s=20.0, offset=0.5)
    third.course["name"] = "another circle"
    rides, figures = ride_of(circle(steps=40), circle(steps=20, episode=2, start_s=10.0), third)
    assert [(f.ride, f.episode, f.steps) for f in figures] == [(1, 1, 40), (2, 2, 20), (3, 1, 30)]
    assert [len(ride.commands) for ride in rides] == [39, 19, 29]
    assert [f.course for f in figures] == ["circle", "circle", "another circle"]
    assert [f.mean_error_m for f in figures] == pytest.approx([0.3, 0.3, 0.5])
    # started anew within its first episode, right after a fall
    falling = circle(steps=30, events=[{"step": 0, "kind": 0}, {"step": 29, "kind": 1, "text": "fell"}])
    fresh = circle(steps=20, start_s=0.5, events=[{"step": 0, "kind": 0}])
    rides, figures = ride_of(falling, fresh)
    assert [[event.kind for event in ride.events] for ride in rides] == [["reset", "fall"], ["reset"]]
    assert [f.falls for f in figures] == [1, 0]


def test_lost_and_repeated_states(ride_of, circle) -> None:
    _, (figures,) = ride_of(circle(steps=40, skip_steps=frozenset({7, 8, 20})))
    assert (figures.steps, figures.lost_steps) == (37, 3)
    repeating = circle(steps=10)
    repeating.states = {name: np.repeat(column, 2) for name, column in repeating.states.items()}
    repeating.states["step"] = np.repeat(np.arange(10), 2)
    _, (figures,) = ride_of(repeating, topics=["/bike/state"])
    assert (figures.steps, figures.repeated_states, figures.lost_steps) == (10, 10, 0)
    assert figures.unanswered_states is None
    assert figures.command_delay_mean_steps is None


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_command_delay(delay: int, ride_of, circle) -> None:
    """The command that answers state k is applied in the step that begins with state k + delay."""
    _, (figures,) = ride_of(circle(steps=60, delay=delay))
    assert (figures.command_delay_mean_steps, figures.command_delay_max_steps) == pytest.approx((delay, delay))
    assert (figures.command_delay_mean_s, figures.command_delay_max_s) == pytest.approx((delay * 0.05,) * 2)
    assert figures.unanswered_states == delay


def test_latency_from_diagnostics(ride_of, circle) -> None:
    _, figures = ride_of(circle(steps=60, latency_ms=(0.06, 0.31)), circle(steps=60, episode=2, start_s=9.0))
    assert figures[0].latency_median_s == pytest.approx(6e-5)
    assert figures[0].latency_p99_s == pytest.approx(3.1e-4)
    assert figures[1].latency_median_s is None
    # Each report is over all answers so far; the first is over the slow very first answer alone.
    reports = [Latency(1, 0.567, 0.567), Latency(2, 1e-4, 0.02), Latency(3, 1.1e-4, 5.39e-3)]
    assert latency_figures(tuple(reports)) == (1.1e-4, 5.39e-3)
    assert latency_figures((*reports, Latency(4, np.nan, np.nan))) == (1.1e-4, 5.39e-3)
    assert latency_figures(()) == (None, None)


def test_accelerations_are_central_differences_over_two_steps(ride_of, circle) -> None:
    """The figure is the largest value of the table's column; beside a state stands the change at that state."""
    ride = circle(steps=200)
    time = 0.05 * np.arange(200)
    ride.states["speed"] = 4.0 + np.sin(time)
    (found,), (figures,) = ride_of(ride)
    speed = ride.states["speed"]
    change = rate(speed, found.states.time_s)
    np.testing.assert_allclose(change[1:-1], (speed[2:] - speed[:-2]) / 0.1, rtol=1e-6)
    assert np.abs(change - np.cos(time))[1:-1].max() < 0.1 * np.abs(np.diff(speed) / 0.05 - np.cos(time)[1:]).max()
    assert figures.acceleration_max_m_s2 == change.max()
    assert figures.braking_max_m_s2 == (-change).max()


def test_steering_activity(ride_of, circle) -> None:
    """A sine of amplitude a has the RMS a / sqrt 2 over whole periods."""
    ride = circle(steps=200)
    ride.states["steer_rate"] = 0.8 * np.sin(2 * np.pi * np.arange(200) / 20)
    ride.states["roll_rate"] = np.full(200, -0.5)
    ride.states["steering_command"] = np.where(np.arange(200) % 2, 0.1, -0.1)
    _, (figures,) = ride_of(ride)
    assert figures.steer_rate_rms_deg_s == pytest.approx(np.degrees(0.8) / np.sqrt(2))
    assert figures.roll_rate_rms_deg_s == pytest.approx(np.degrees(0.5))
    assert figures.command_change_mean == pytest.approx(0.2)


def test_line_is_recovered_where_no_course_was_recorded(ride_of, circle) -> None:
    ride = circle(steps=100, offset=np.linspace(-0.5, 0.5, 100))
    ride.states["heading_error"] = np.zeros(100)
    (read,), (figures,) = ride_of(ride, topics=["/bike/state", "/bike/command"])
    assert figures.course is None
    assert figures.sections == []
    assert json.loads(json.dumps(figures, allow_nan=False))["max_error_m"] == pytest.approx(0.5)
    x, y = read.reference_line()
    np.testing.assert_allclose(np.hypot(x, y - 10.0), 10.0, atol=1e-12)


@settings(max_examples=20)
@given(offsets=st.lists(st.integers(-3_000_000, 3_000_000).map(lambda x: 1e-6 * x), min_size=2, max_size=30))
def test_figures_of_any_errors(offsets: list[float], writer, circle, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = writer.write(
        tmp_path_factory.mktemp("any") / "a.mcap", [circle(steps=len(offsets), offset=np.array(offsets))]
    )
    (ride,) = find_rides(read_recording(path))
    figures = ride_figures(ride)
    magnitudes = [abs(x) for x in offsets]
    assert figures.max_error_m == max(magnitudes)
    assert figures.mean_error_m == pytest.approx(sum(magnitudes) / len(magnitudes))
    slack = 1 + 1e-12
    assert figures.mean_error_m <= figures.rms_error_m * slack
    assert figures.rms_error_m <= figures.max_error_m * slack


@given(data=st.data())
def test_command_delay_is_that_of_a_plain_search(circle_ride_of_ten: Ride, data: st.DataObject) -> None:
    """Held, repeated, late and unknown commands of few values, against a search written down as the docstring says."""
    ride = circle_ride_of_ten
    values = st.sampled_from([-1.0, -0.5, 0.0, 0.5, 1.0, 1.5])
    count = data.draw(st.integers(0, 14))
    steps = np.array(data.draw(st.lists(st.integers(0, 9), min_size=count, max_size=count)), dtype=np.int64)
    steering = np.array(data.draw(st.lists(values, min_size=count, max_size=count)))
    table = ride.commands.take(np.zeros(count, dtype=np.int64))
    commands = replace(table, step=steps, time_s=0.05 * steps).with_columns(steering=steering)
    applied = np.array(data.draw(st.lists(values, min_size=10, max_size=10)))
    ages, _ = command_ages(replace(ride, commands=commands, states=ride.states.with_columns(steering_command=applied)))
    wanted = {}
    for row in range(1, 10):
        same = [s for s, v in zip(steps, steering, strict=True) if np.clip(v, -1, 1) == applied[row] and s <= row - 1]
        if same:
            wanted[row] = row - 1 - max(same)
    assert {row: age for row, age in enumerate(ages) if np.isfinite(age)} == wanted


@pytest.fixture(scope="module")
def circle_ride_of_ten(writer, circle, tmp_path_factory: pytest.TempPathFactory) -> Ride:
    path = writer.write(tmp_path_factory.mktemp("ten") / "ride.mcap", [circle(steps=10)])
    return find_rides(read_recording(path))[0]
