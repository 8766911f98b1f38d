"""The guide of racing policies: the classical law for many machines, the same for one; mirrored rides, mirrored."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bike_policy.contract.action import LINE_OFFSET, PACE, ActionColumn, ActionLayout
from bike_policy.contract.bundle import Actor, Bundle
from bike_policy.contract.observation import RACE_LAYOUTS
from bike_policy.planning.grip import AdaptiveLaw
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, CLEARANCE, GUIDE, P_FASTER, plan_line
from bike_policy.planning.line_law import OFFSET, STEERING, LineLaw
from bike_policy.planning.racecraft import CORNER_RATE
from bike_policy.riders.racing import PASSING_ROOM, PolicyBatch, with_passing_room
from bike_sim.course.course import Course
from bike_sim.physics import state as ps
from bike_sim.schema import SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim.batch import SUPERBIKE_ENGINE, Batch
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.superbike import Superbike
from bike_training.curricula.race import CircuitSet
from tests.circuits import LineController, circle


@pytest.fixture(scope="module")
def law(panigale: Superbike) -> LineLaw:
    return LineLaw(panigale, 0.02, GUIDE, 4)


def oval(turn: float) -> Course:
    """A circle that turns to the left (1) or to the right (-1)."""
    left = circle(60.0, 1.0)
    return replace(left, y=turn * left.y, heading=turn * left.heading, curvature=turn * left.curvature)


@pytest.fixture(scope="module")
def pair(panigale: Superbike) -> tuple[LineController, LineController]:
    """Who rides a circle to the left, and who rides it to the right."""
    left, right = (LineController(panigale, oval(turn), 0.02, GUIDE) for turn in (1.0, -1.0))
    return left, right


@given(seed=st.integers(0, 2**32 - 1))
def test_one_is_answered_as_among_others(law: LineLaw, pair: tuple[LineController, LineController], seed: int) -> None:
    rng = np.random.default_rng(seed)
    alone = pair[0]
    alone.reset()
    for row in range(4):
        law.begin(row, alone.plan)
    for step in range(5):
        seen = np.stack(
            (
                rng.uniform(5.0, 60.0, 4), rng.uniform(-1.0, 1.0, 4), 30.0 + step + rng.uniform(0.0, 0.3, 4),
                rng.normal(size=4), 0.1 * rng.normal(size=4), rng.normal(size=4),
            ),
            axis=1,
        )  # fmt: skip
        answers = law.commands(seen)
        assert np.all(np.abs(answers) <= 1.0)
        np.testing.assert_array_equal(law.commands(seen), answers)
        assert alone.command(*seen[2].tolist()) == tuple(answers[2].tolist())


@given(seed=st.integers(0, 2**32 - 1))
def test_the_mirrored_ride_gets_the_mirrored_answer(pair: tuple[LineController, LineController], seed: int) -> None:
    rng = np.random.default_rng(seed)
    left, right = pair
    left.reset()
    right.reset()
    for step in range(3):
        speed, roll, error, heading, rate = rng.uniform(10.0, 50.0), *rng.uniform(-0.5, 0.5, 4)
        way = 40.0 + 0.5 * step
        steering, throttle = left.command(speed, roll, way, error, heading, rate)
        other = right.command(speed, -roll, way, -error, -heading, -rate)
        assert other == pytest.approx((-steering, throttle), abs=1e-9)


def test_a_guide_answers_again_the_same_and_goes_on_from_its_memory(panigale: Superbike) -> None:
    class Rows:
        state, look, signals = np.zeros((2, 10)), np.zeros((2, 12)), np.zeros((2, len(SIGNALS)))
        preview_xy, circuit, points = np.zeros((2, 2, 20)), np.zeros((2, 8)), np.zeros((2, 3, 20, 3))
        fallen, opponents = np.zeros(2, dtype=np.bool_), np.zeros((2, 0, 0))

    def ride(guide: AdaptiveLaw, steps: range) -> list[np.ndarray]:
        answers = []
        for step in steps:
            Rows.look[:, lk.SPEED], Rows.look[:, lk.PROGRESS] = 30.0, 0.6 * step
            Rows.look[:, lk.LATERAL_ERROR] = [math.sin(0.3 * step), 0.2]
            Rows.state[:, ps.ROLL] = -0.4
            targets = np.array([[0.5, 0.02], [-0.1 * step, 0.0]])
            answers.append(guide.commands(Rows, targets=targets))
            np.testing.assert_array_equal(guide.commands(Rows, targets=targets), answers[-1])
            np.testing.assert_array_equal(guide.law.memory[:, STEERING:OFFSET], answers[-1])
        return answers

    line = circle(60.0, 1.0)
    plan = plan_line(panigale, line, GUIDE)
    whole, first, second = (AdaptiveLaw(panigale, 0.02, GUIDE, 2, lambda _: plan) for _ in range(3))
    for guide in (whole, first, second):
        for row in range(2):
            guide.begin(row, None, line)
    ride(first, range(5))
    second.restore(first.state_dict())
    np.testing.assert_array_equal(ride(whole, range(10))[5:], ride(second, range(5, 10)))


def test_targets_are_reached() -> None:
    """Where the throttle is not all open, a machine rides beside the line, and as fast, as it is told to."""
    config = replace(superbike_config("panigale_v4r"), engine=SUPERBIKE_ENGINE)
    targets = np.array([[0.8, -0.1], [-0.8, -0.1], [0.0, -0.05]])
    batch = Batch(3, config)
    for row in range(3):
        batch.reset(row, ResetRequest(course="barcelona", progress=4000.0, speed_range=(25.0, 25.0)))
    line = replace(batch.course(0), width_left=None, width_right=None)  # targets beyond the limits are cut
    plan = plan_line(batch.vehicle, line, GUIDE)
    guide = AdaptiveLaw(batch.vehicle, config.control_period, GUIDE, 3, lambda _: plan)
    for row in range(3):
        guide.begin(row, batch, line)
    errors: list[list[float]] = [[], [], []]
    paces: list[list[float]] = [[], [], []]
    for step in range(700):
        commands = guide.commands(batch, targets=targets)
        batch.step(commands)
        for row in np.flatnonzero(commands[:, 1] < 1.0) if step > 200 else ():
            errors[row].append(batch.look[row, lk.LATERAL_ERROR])
            planned = float(plan.profile.speed_at(batch.look[row, lk.PROGRESS]))
            paces[row].append(batch.look[row, lk.SPEED] / planned - 1.0)
    assert not batch.fallen.any()
    batch.close()
    assert min(map(len, errors)) > 100
    np.testing.assert_allclose([np.mean(error) for error in errors], targets[:, 0], atol=0.15)
    np.testing.assert_allclose([np.mean(pace) for pace in paces], targets[:, 1], atol=0.01)


@settings(max_examples=10)
@given(width=st.floats(0.2, 4.0), target=st.floats(-3.0, 3.0))
def test_targets_stay_clear_of_the_limits(panigale: Superbike, width: float, target: float) -> None:
    """Beside a line that lies near one limit, what is ridden to ends before it; on the other side nothing changes."""
    line = circle(60.0, 1.0)
    near, far = np.full(len(line.s), width), np.full(len(line.s), 9.0)
    law = LineLaw(panigale, 0.02, GUIDE, 2)
    law.begin(0, plan_line(panigale, replace(line, width_left=near, width_right=far), GUIDE))
    law.begin(1, plan_line(panigale, replace(line, width_left=far, width_right=near), GUIDE))
    for step in range(200):
        seen = np.array([[20.0, -0.5, 0.4 * step, 0.0, 0.0, 0.0]] * 2)
        law.commands(seen, np.array([[target, 0.0], [-target, 0.0]]))
    room = max(width - CLEARANCE, 0.0)
    expected = min(target, room)
    np.testing.assert_allclose(law.memory[:, OFFSET], [expected, -expected], atol=0.01)


def test_a_slow_machine_leans_for_the_speed_that_it_will_have(panigale: Superbike, law: LineLaw) -> None:
    """As it catches up it asks for more lean than at the same speed held, but not for a speed beyond the planned."""
    plan = plan_line(panigale, circle(60.0, 1.0), GUIDE)
    fast = float(plan.profile.speed_at(30.0))

    def asked(speed: float, gain: float) -> float:
        law.begin(0, plan)
        for step in range(20):
            now = speed - gain * 0.02 * (19 - step)
            seen = np.zeros((4, 6))
            seen[:, 0], seen[:, 1], seen[:, 2] = now, -0.7, 30.0 + now * 0.02 * step
            answer = law.commands(seen)
        return float(answer[0, 0])

    held, catching = asked(0.85 * fast, 0.0), asked(0.85 * fast, 3.0)
    assert catching > held + 0.005
    assert asked(fast + 0.01, 3.0) < asked(fast + 0.01, 0.0) + 0.002


def test_a_machine_that_leans_as_far_as_it_may_does_not_catch_up(panigale: Superbike, law: LineLaw) -> None:
    plan = plan_line(panigale, circle(60.0, 1.0), GUIDE)
    fast = float(plan.profile.speed_at(30.0))

    def throttle(error: float) -> float:
        law.begin(0, plan)
        seen = np.zeros((4, 6))
        seen[:, 0], seen[:, 1], seen[:, 2], seen[:, 3] = 0.9 * fast, -0.8, 30.0, error
        return float(law.commands(seen)[0, 1])

    outside, inside = throttle(-3.0), throttle(0.5)  # the circle turns to the left, its outside is to the right
    assert inside > outside + 0.1
    assert abs(outside) < 0.35  # what holds the speed


def test_few_slow_starts_throw_the_guide_down(panigale: Superbike) -> None:
    """Starts at half to nine tenths of the theoretical speed, where a machine that only speeds up runs wide."""
    config = replace(superbike_config("panigale_v4r"), engine=SUPERBIKE_ENGINE)
    count = 64
    batch = Batch(count, config)
    guide = AdaptiveLaw(
        batch.vehicle, config.control_period, GUIDE, count, lambda line: plan_line(panigale, line, GUIDE)
    )
    ground = CircuitSet(batch.vehicle, ["barcelona"])
    for row in range(count):
        progress, share = (row + 0.5) / count * ground.length("barcelona"), 0.5 + 0.4 * ((row * 0.6180339887) % 1.0)
        speed = ground.start("barcelona", 1.0, progress, share)
        batch.reset(row, ResetRequest(course="barcelona", progress=progress, speed_range=(speed, speed), perturb=True))
        guide.begin(row, batch, batch.course(row))
    for _ in range(500):
        commands = guide.commands(batch)
        batch.step(np.where(batch.fallen[:, None], 0.0, commands))
    fallen = int(batch.fallen.sum())
    batch.close()
    assert fallen <= 1


def test_who_sees_others_and_holds_still_rides_as_the_lone_classical_rider(panigale: Superbike) -> None:
    """The same plan and law; a target beside the line moves slowly in a corner, and faster is granted on straights."""
    line = circle(60.0, 1.0)
    plan = plan_line(panigale, line, CLASSICAL_SETTINGS)
    for room in (PASSING_ROOM, 0.0):
        assert (with_passing_room(plan, room).table[:, P_FASTER] == room).all()  # a circle has no straight
    action = ActionLayout((ActionColumn(LINE_OFFSET, 3.0, rate=2.0), ActionColumn(PACE, 0.08)))
    size = RACE_LAYOUTS["wheel_to_wheel"].size
    still = Actor([np.zeros((2, size), dtype=np.float32)], [np.zeros(2, dtype=np.float32)])
    left = Actor([np.zeros((2, size), dtype=np.float32)], [np.array([9.0, 0.0], dtype=np.float32)])
    states = []
    for actor in (still, left, None):
        batch = Batch(1, replace(superbike_config(panigale.name), engine=SUPERBIKE_ENGINE))
        speed = float(plan.profile.speed[0])
        batch.reset(0, ResetRequest(course="barcelona", line=0.0, speed_range=(speed, speed)))
        rider = AdaptiveLaw(panigale, 0.02, CLASSICAL_SETTINGS, 1, lambda _: plan)
        policy = None
        if actor is not None:
            bundle = Bundle("p", actor, RACE_LAYOUTS["wheel_to_wheel"], action, panigale.name, 0.02)
            policy = PolicyBatch(bundle, panigale, 0.02, 1, lambda _: plan)
        (policy or rider).begin(0, batch, line)
        targets = []
        for step in range(40):
            batch.step((policy or rider).commands(batch, step))
            law = rider.law if policy is None else policy.interface.law
            targets.append(float(law.memory[0, OFFSET]))
        states.append(batch.state[0].copy())
        if actor is left:
            assert 0.0 < targets[-1] < CORNER_RATE * 0.8
            assert np.diff(targets).max() < 1.3 * CORNER_RATE * 0.02
        batch.close()
    np.testing.assert_allclose(states[0], states[2], atol=1e-6)
