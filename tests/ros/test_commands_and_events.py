"""What the node decides without ROS: which commands count, and what happened in a ride."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_sim.course.course import Course
from bike_sim.course.files import load_course
from bike_sim.physics.state import X, Y, upright_state
from bike_sim.ros.command_gate import Command, CommandGate, Verdict
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import Event, EventKind, PathEvents
from bike_sim.sim.request import Preview
from bike_sim.sim.scene import PathScene
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import NO_FALL, NO_SIGNALS, TIPPED

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
COMMANDS = st.builds(Command, st.integers(0, 4), st.integers(0, 6), NUMBERS, NUMBERS)


@given(st.booleans(), st.lists(COMMANDS, max_size=20))
def test_only_finite_commands_within_range_reach_the_physics(lockstep: bool, commands: list[Command]) -> None:
    gate = CommandGate(lockstep)
    for command in commands:
        verdict, passed = gate.judge(command, episode=2, step=3, oldest=1)
        if verdict is Verdict.TAKEN:
            assert -1.0 <= passed.steering <= 1.0
            assert -1.0 <= passed.throttle <= 1.0
            assert passed.steering == min(max(command.steering, -1.0), 1.0)
            assert (command.episode, command.step) == (2, 3) if lockstep else command.episode in (0, 2)
        if not (math.isfinite(command.steering) and math.isfinite(command.throttle)):
            assert verdict is Verdict.REFUSED
    counts = gate.counts
    assert counts.taken + counts.repeated + counts.stale + counts.refused == len(commands)
    assert counts.clipped <= counts.taken


@pytest.mark.parametrize(
    ("episode", "step", "verdict"),
    [
        (2, 3, Verdict.TAKEN),
        (2, 2, Verdict.REPEATED),
        (2, 1, Verdict.STALE),
        (2, 4, Verdict.STALE),
        (1, 3, Verdict.STALE),
        (3, 0, Verdict.STALE),
        (0, 3, Verdict.STALE),
    ],
)
def test_lockstep_takes_the_answer_to_the_last_state_only(episode: int, step: int, verdict: Verdict) -> None:
    assert CommandGate(lockstep=True).judge(Command(episode, step, 0.1), 2, 3)[0] is verdict


def test_free_mode_takes_recent_and_unaddressed_commands() -> None:
    gate = CommandGate(lockstep=False)
    verdicts = [gate.judge(Command(2, step, 0.1), 2, 10, oldest=6)[0] for step in (5, 6, 10, 11)]
    assert verdicts == [Verdict.STALE, Verdict.TAKEN, Verdict.TAKEN, Verdict.STALE]
    assert gate.judge(Command(0, 0, 0.1), 2, 10, oldest=6)[0] is Verdict.TAKEN


def ridden(course: Course, progress: list[float]) -> list[Event]:
    """Return what happens on the way over given arc lengths of a course, 0.05 s apart."""
    events = PathEvents(course, 0.0, progress[0])
    found = (events.look(0.05 * k, s, 4.0, 0.0, False, []) for k, s in enumerate(progress) if k)
    return [event for happened in found for event in happened]


@given(st.floats(2.0, 12.0), st.floats(0.0, 0.9))
def test_lap_times_are_interpolated(speed: float, start: float) -> None:
    circle = load_course("circle")
    count = math.ceil((2.2 * circle.length) / (0.05 * speed))
    happened = ridden(circle, [start + 0.05 * k * speed for k in range(count)])
    laps = [event for event in happened if event.kind is EventKind.LAP]
    assert [e.progress for e in laps] == [circle.length, 2 * circle.length]
    assert laps[0].time == pytest.approx((circle.length - start) / speed, abs=1e-9)
    assert laps[1].value == pytest.approx(circle.length / speed, abs=1e-9)


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=80), st.booleans())
def test_each_line_is_crossed_once_and_in_order(steps: list[float], closed: bool) -> None:
    course = load_course("benchmark" if closed else "line")
    start = course.length - 10.0
    progress = list(itertools.accumulate(steps, initial=start))
    if not course.closed:
        progress = [min(p, course.length) for p in progress]
    lines = [event.progress for event in ridden(course, progress)]
    assert lines == sorted(set(lines))
    marks = [s for _, s in course.sections if s > 0.0] + [course.length]
    laps = 3 if course.closed else 1
    expected = [lap * course.length + mark for lap in range(laps) for mark in marks]
    reached = max(progress) + (0.0 if course.closed else 1e-9)
    assert lines == pytest.approx([line for line in expected if start < line <= reached])


def test_a_fall_and_leaving_the_course_are_told_once() -> None:
    simulator = Simulator(SimulatorConfig(engine="whipple"))
    scene = PathScene(simulator.plant, load_course("line"), Preview())
    state = upright_state(4.0, simulator.vehicle.rF)
    kinds = []
    for step, (aside, fall) in enumerate([(0.0, NO_FALL), (0.0, TIPPED), (5.0, TIPPED), (6.0, TIPPED)]):
        state[X], state[Y] = 0.2 * step, aside
        kinds.append([event.kind for event in scene.look(state, NO_SIGNALS, 0.05 * step, fall).events])
    assert kinds == [[], [EventKind.FALL], [EventKind.OFF_COURSE], []]
