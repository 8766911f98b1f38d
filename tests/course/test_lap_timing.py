"""Lap timing against rides whose times are known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bike_sim.course.lap_timing import EventKind
from tests.lap_times import Sample, time_laps

WHEELBASE = 1.4


def ride(times, progress, offset=None, front_offset=None) -> list[Sample]:
    """Return samples of a ride; both contact points at the same offset unless told otherwise."""
    offset = np.zeros(len(times)) if offset is None else np.asarray(offset, dtype=float)
    front = offset if front_offset is None else np.asarray(front_offset, dtype=float)
    rows = zip(times, progress, offset, front, strict=True)
    return [Sample(float(t), float(s), float(o), float(s) + WHEELBASE, float(f)) for t, s, o, f in rows]


@pytest.fixture(scope="module")
def track(shapes):
    return shapes.oval(50.0, 300.0)


@settings(max_examples=20)
@given(speed=st.floats(5.0, 90.0), step=st.floats(0.05, 0.3), before=st.floats(30.0, 370.0), phase=st.floats(0.0, 1.0))
def test_steady_ride_has_the_same_lap_every_time_at_any_step(shapes, speed, step, before, phase):
    track = shapes.circle(60.0)
    duration = track.length / speed
    times = np.arange(phase * step, 3.2 * duration + before / speed, step)
    timing, events = time_laps(track, ride(times, speed * times - before))
    assert len(timing.laps) == 3
    for number, lap in enumerate(timing.laps, start=1):
        assert lap.number == number
        assert lap.valid
        # Progress is linear in time here, so interpolation is exact.
        assert lap.duration == pytest.approx(duration, rel=1e-9)
        assert lap.began == pytest.approx((before + (number - 1) * track.length) / speed, rel=1e-9)
        assert lap.sectors == pytest.approx([duration / 3.0] * 3, rel=1e-6)
        assert sum(lap.sectors) == pytest.approx(lap.duration, rel=1e-12)
    assert [e.kind for e in events].count(EventKind.SECTOR) >= 9
    assert [e.time for e in events] == sorted(e.time for e in events)


def test_crossing_is_timed_below_the_step_while_speed_changes(track):
    # s = 1/2 a t^2 - 100; the interpolation's error is a step^2 / 8 v at most.
    acceleration, step = 4.0, 0.02
    times = np.arange(0.0, 40.0, step)
    timing, _ = time_laps(track, ride(times, 0.5 * acceleration * times**2 - 100.0))
    first = math.sqrt(2.0 * 100.0 / acceleration)
    second = math.sqrt(2.0 * (100.0 + track.length) / acceleration)
    assert timing.laps[0].began == pytest.approx(first, abs=acceleration * step**2 / (8.0 * acceleration * first))
    assert timing.laps[0].duration == pytest.approx(second - first, abs=2e-5)


def test_laps_have_their_times_and_validity(track):
    # Laps of 30, 20, 25 s; the second leaves the track.
    durations = [30.0, 20.0, 25.0]
    ends = np.concatenate(([0.0], np.cumsum(durations)))
    times = np.arange(0.0, 75.5, 0.05)
    progress = np.interp(times, ends, track.length * np.arange(4))
    offset = np.where((times > 35.0) & (times < 37.0), 8.0, 0.0)
    timing, events = time_laps(track, ride(times, progress, offset))
    assert [lap.duration for lap in timing.laps] == pytest.approx(durations, abs=1e-6)
    assert [lap.valid for lap in timing.laps] == [True, False, True]
    laps = [event for event in events if event.kind is EventKind.LAP]
    assert [event.value for event in laps] == [lap.duration for lap in timing.laps]
    assert "invalid" in laps[1].text
    assert laps[0].text == "lap 1 in 0:30.000"


def test_time_off_the_track_is_interpolated_at_the_limits(track):
    # Out and back in a triangle of 12 m height: the limit is at 6 m, so half of it lies outside.
    times = np.arange(0.0, 10.0, 0.3)
    offset = np.interp(times, [2.0, 4.0, 6.0], [0.0, 12.0, 0.0])
    fine = np.arange(0.0, 10.0, 0.001)
    exact = np.interp(fine, times, offset) > 6.0
    timing, events = time_laps(track, ride(times, 5.0 + 10.0 * times, offset))
    assert timing.off_track == pytest.approx(np.sum(exact) * 0.001, abs=2e-3)
    left, back = (e for e in events if e.kind in (EventKind.OFF_COURSE, EventKind.BACK_ON_COURSE))
    assert back.time - left.time == pytest.approx(timing.off_track)
    assert back.value == pytest.approx(timing.off_track)


def test_one_wheel_on_the_track_is_on_the_track(track):
    times = np.arange(0.0, 40.0, 0.1)
    outside = np.full(len(times), 7.0)
    timing, _ = time_laps(track, ride(times, 40.0 * times, outside, np.zeros(len(times))))
    assert timing.off_track == 0.0
    assert timing.laps[0].valid


def test_time_off_the_track_belongs_to_the_lap_in_which_it_happens(track):
    speed, step = 40.0, 0.07
    times = np.arange(0.0, 3.1 * track.length / speed, step)
    line = track.length / speed  # the first lap ends; off the track from 1 s before to 2 s after
    offset = np.where((times > line - 1.0) & (times < line + 2.0), 9.0, 0.0)
    timing, _ = time_laps(track, ride(times, speed * times, offset))
    assert timing.laps[0].off_track == pytest.approx(1.0, abs=step)
    assert timing.laps[1].off_track == pytest.approx(2.0, abs=step)
    assert timing.laps[2].valid
    assert sum(lap.off_track for lap in timing.laps) == pytest.approx(timing.off_track)


def test_distance_to_the_ideal_line(track):
    ideal = track.with_ideal(np.full(len(track.centre.s), 2.0))
    times = np.arange(0.0, 60.0, 0.1)
    timing, _ = time_laps(ideal, ride(times, 40.0 * times, np.where(times < 30.0, -1.0, 3.0)))
    assert timing.laps[0].ideal_distance == pytest.approx(3.0)
    assert timing.laps[1].ideal_distance < 3.0
    assert timing.ideal_distance == pytest.approx(2.0, abs=0.01)
    assert timing.farthest == pytest.approx(3.0)
    without, _ = time_laps(track, ride(times, 40.0 * times))
    assert without.laps[0].began == 0.0, "it starts on the line"
    assert without.laps[0].duration == pytest.approx(track.length / 40.0)
    assert math.isnan(without.ideal_distance)
    assert math.isnan(without.laps[0].ideal_distance)


def test_riding_back_over_the_line_counts_nothing_twice(track):
    times = np.arange(0.0, 90.0, 0.1)
    knots = [0.0, 30.0, 35.0, 40.0, 80.0]
    length = track.length
    progress = np.interp(times, knots, [-50.0, length + 5.0, length - 60.0, length + 5.0, 2.1 * length])
    timing, events = time_laps(track, ride(times, progress))
    assert len(timing.laps) == 2
    assert timing.laps[0].began + timing.laps[0].duration < 30.0
    assert [e.kind for e in events].count(EventKind.LAP) == 2


@given(seed=st.integers(0, 2**32 - 1))
def test_whatever_happens_the_account_adds_up(shapes, seed):
    track = shapes.circle(40.0)
    track = track.with_ideal(np.full(len(track.centre.s), 1.5))
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.01, 0.1, 400))
    progress = np.cumsum(rng.uniform(-0.5, 4.0, 400)) - 100.0
    offset = np.cumsum(rng.normal(0.0, 1.0, 400))
    timing, _ = time_laps(track, ride(times, progress, offset, offset + rng.normal(0.0, 0.5, 400)))
    assert 0.0 <= timing.off_track <= times[-1] - times[0]
    for lap in timing.laps:
        assert sum(lap.sectors) == pytest.approx(lap.duration)
        assert lap.off_track <= lap.duration + 1e-9
