"""Events of rides on paths: laps, sections, the finish, falls and leaving the path, each once."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from numba import njit

from bike_sim.course import timing_account as acc
from bike_sim.course.course import Course
from bike_sim.course.files import load_course
from bike_sim.course.lap_timing import LapLog
from bike_sim.physics.state import ROLL, X, Y
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import Event, EventKind, events_of
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator


@njit
def feed(accounts: Any, lines: acc.Lines, place: acc.Place, rows: np.ndarray) -> int:
    return acc.feed(accounts[0], lines, place, rows)


def ridden(course: Course, progress: list[float]) -> list[Event]:
    """Return what happens on the way over given arc lengths of a course, 0.05 s apart at 4 m/s."""
    sections = [(name, start) for name, start in course.sections if 0.0 < start < course.length]
    kind = acc.CLOSED_PATH if course.closed else acc.OPEN_PATH
    lines = acc.Lines(np.array([start for _, start in sections], dtype=float), course.length, kind, False)
    accounts, rows = np.zeros(1, dtype=acc.ACCOUNT), np.empty((60, acc.ROW_SIZE))
    happened: list[Event] = []
    for k, s in enumerate(progress):
        count = feed(accounts, lines, acc.Place(0.05 * k, float(s), 0.0, 0.0, 0.2), rows)
        happened += events_of(rows[:count], LapLog(), [name for name, _ in sections])
    return happened


@given(some.floats(2.0, 12.0), some.floats(0.0, 0.9))
def test_lap_times_are_interpolated(speed: float, start: float) -> None:
    circle = load_course("circle")
    count = math.ceil((2.2 * circle.length) / (0.05 * speed))
    happened = ridden(circle, [start + 0.05 * k * speed for k in range(count)])
    laps = [event for event in happened if event.kind is EventKind.LAP]
    assert [e.progress for e in laps] == [circle.length, 2 * circle.length]
    assert laps[0].time == pytest.approx((circle.length - start) / speed, abs=1e-9)
    assert laps[1].value == pytest.approx(circle.length / speed, abs=1e-9)
    assert [e.text.split(" in ")[0] for e in laps] == ["lap 1", "lap 2"]


@given(some.lists(some.floats(-3.0, 3.0), min_size=1, max_size=80), some.booleans())
def test_each_line_is_crossed_once_and_in_order(steps: list[float], closed: bool) -> None:
    course = load_course("benchmark" if closed else "line")
    start = course.length - 10.0
    progress = list(itertools.accumulate(steps, initial=start))
    if not course.closed:
        progress = [min(p, course.length) for p in progress]
    happened = ridden(course, progress)
    lines = [event.progress for event in happened]
    assert lines == sorted(set(lines))
    names = {start: name for name, start in course.sections}
    marks = [s for _, s in course.sections if s > 0.0] + [course.length]
    laps = 3 if course.closed else 1
    expected = [lap * course.length + mark for lap in range(laps) for mark in marks]
    reached = max(progress) + (0.0 if course.closed else 1e-9)
    assert lines == pytest.approx([line for line in expected if start < line <= reached])
    for event in happened:
        if event.kind is EventKind.SECTOR:
            assert event.text == f"sector {names[event.progress % course.length]!r} begins"


def test_the_finish_is_crossed_where_speed_says_for_progress_stops_there() -> None:
    course = load_course("line")
    (finish,) = (e for e in ridden(course, [course.length - 0.05, course.length]) if e.kind is EventKind.FINISH)
    assert finish.time == pytest.approx(0.05 * 0.05 / 0.2)


def test_a_fall_and_leaving_the_path_are_reported_once() -> None:
    simulator = Simulator(SimulatorConfig(engine="whipple"))
    simulator.reset(ResetRequest(course="line"))
    kinds = []
    for step, (aside, roll) in enumerate([(0.0, 0.0), (0.0, 1.2), (5.0, 1.2), (6.0, 1.2)]):
        simulator.batch.state[0, [X, Y, ROLL]] = 0.2 * step, aside, roll
        kinds.append([event.kind for event in simulator.step(0.0).events])
    assert kinds == [[], [EventKind.FALL], [EventKind.OFF_COURSE], []]
    simulator.close()
