"""The reward, the penalty timers and the rides of a race."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_policy.contract.observation import DESCRIPTOR, Rows, rows_of
from bike_sim.schema import SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.worlds import draw_world
from bike_sim.vehicles.files import load_vehicle
from bike_training.learning.presets import load_preset
from bike_training.tasks.base import batch_of, sum_of
from bike_training.tasks.race import (
    RACE_WEIGHTS,
    REWARD_TERMS,
    RaceContext,
    RaceTask,
    history_penalty,
    off_track,
)

signal = SIGNALS.index

COMPILED = replace(superbike_config("panigale_v4r"), engine="compiled")
ALL = dict.fromkeys(REWARD_TERMS, 1.0)
PERIOD = COMPILED.control_period
TASK = RaceTask(weights=ALL)
GUIDED_TASK = RaceTask(observation="guided", weights=ALL, guided=True)


@pytest.fixture(scope="module")
def start():
    """Return a ride on the main straight, its request and its line."""
    simulator = Simulator(COMPILED)
    request = ResetRequest(course="barcelona", speed_range=(40.0, 40.0), progress=200.0)
    snapshot = simulator.reset(request)
    assert simulator.course is not None
    yield rows_of(snapshot), request, simulator.course
    simulator.close()


def copied(row: Rows) -> Rows:
    return Rows(*(part.copy() for part in row))


def rides_of(start, task=TASK, context=None):
    row, request, course = start
    rides = task.make_state(1, load_vehicle("panigale_v4r"))
    rides.begin(0, row, replace(request, context=tuple(context or ())), course)
    return rides


def decide(rides, row, change, actions=(0.0, 0.0), periods=3):
    """Hold a decision while a row changes the same in each control period; return the result and the last row."""
    rides.act(row, np.array([actions]))
    for _ in range(periods):
        row = copied(row)
        change(row)
        rides.advance(row)
    return rides.evaluate(row), row


def forward(row, speed=40.0):
    row.look[:, lk.SPEED] = speed
    row.look[:, lk.PROGRESS] += speed * PERIOD


@pytest.mark.parametrize(
    ("heading", "speed", "way"), [(0.0, 40.0, 40.0), (2.0, 40.0, -40.0), (0.0, -20.0, -20.0), (3.0, -20.0, -20.0)]
)
def test_progress_is_the_way_along_the_line_and_negative_where_heading_or_motion_is_wrong(start, heading, speed, way):
    def move(row):
        row.look[:, lk.HEADING_ERROR] = heading
        forward(row, speed)

    result, _ = decide(rides_of(start), start[0], move)
    assert result.terms["progress"][0] == pytest.approx(way * 3 * PERIOD)
    assert result.terms["gain"][0] < 0.0 or way > 0.0
    assert not result.failed[0]


def test_motion_counts_vertical_and_sideways_speed(start):
    def move(row, vertical, angle):
        row.look[:, lk.SPEED] = 40.0
        row.signals[:, signal("vertical_velocity")] = vertical
        row.signals[:, signal("rear_slip_angle")] = angle

    for vertical, angle, speed in ((-0.5, 0.0, 0.5), (0.0, -0.1, 4.0), (0.5, 0.1, 4.5)):
        result, _ = decide(rides_of(start), start[0], lambda row, v=vertical, a=angle: move(row, v, a))
        assert result.terms["motion"][0] == pytest.approx(-speed * 3 * PERIOD)


def outside(row, rear=20.0, front=20.0):
    """Shift contact points to the left."""
    row.circuit[:, :4] += [-rear, rear, -front, front]


@given(rear=st.sampled_from([0.0, 20.0]), front=st.sampled_from([0.0, 20.0]))
def test_contact_points_outside(start, rear, front):
    row = copied(start[0])
    outside(row, rear, front)
    assert off_track(row.circuit[0]) == (max(rear, front) > 0.0, min(rear, front) > 0.0)


def test_off_track_counts_with_speed_for_any_tyre_and_masks_progress_for_both(start):
    def rear_only(row):
        row.circuit[:] = start[0].circuit
        outside(row, 20.0, 0.0)
        forward(row)

    def both(row):
        rear_only(row)
        row.circuit[:, 2:4] += [-20.0, 20.0]

    result, _ = decide(rides_of(start), start[0], rear_only)
    assert result.terms["off_track"][0] == pytest.approx(-40.0 * 3 * PERIOD)
    assert result.terms["progress"][0] > 0.0
    result, _ = decide(rides_of(start), start[0], both)
    assert result.terms["progress"][0] == 0.0
    unmasked = rides_of(start, replace(TASK, masked=False, any_tyre=False))
    result, _ = decide(unmasked, start[0], both)
    assert result.terms["progress"][0] > 0.0
    result, _ = decide(rides_of(start, replace(TASK, any_tyre=False)), start[0], rear_only)
    assert result.terms["off_track"][0] == 0.0


@pytest.mark.parametrize(("kind", "limit"), [("off_track", 1.0), ("wrong_way", 1.0), ("stalled", 2.0)])
def test_penalty_timers_end_an_episode(start, kind, limit):
    def change(row):
        if kind == "wrong_way":
            row.look[:, lk.HEADING_ERROR] = 3.0
        elif kind == "stalled":
            row.look[:, lk.SPEED] = 1.0
        else:
            row.circuit[:] = start[0].circuit
            outside(row)

    rides, row = rides_of(start), start[0]
    decisions = 0
    result = None
    while decisions < 60 and (result is None or not result.failed[0]):
        result, row = decide(rides, row, change)
        decisions += 1
    assert result is not None
    assert decisions * 3 * PERIOD == pytest.approx(limit, abs=3 * PERIOD + 1e-9)
    assert result.terms["failure"][0] == -1.0
    assert result.terms["fall"][0] == 0.0


def test_a_fall_and_a_wall_count_once(start):
    rides = rides_of(start)

    def hit(row):
        row.fallen[:] = True
        row.signals[:, signal("speed")] = 30.0

    result, row = decide(rides, start[0], hit)
    assert result.failed[0]
    assert result.terms["fall"][0] == -1.0
    assert result.terms["wall"][0] == pytest.approx(-0.5 * 30.0**2)
    again, _ = decide(rides, row, hit)
    assert again.terms["wall"][0] == again.terms["fall"][0] == again.terms["progress"][0] == 0.0


def test_stability_terms_by_hand(start):
    first = copied(start[0])
    first.look[:, lk.LATERAL_ERROR] = -2.0

    def lean(row):
        row.state[:, 3] = 1.1
        row.state[:, 4] = 0.05
        row.state[:, 7] = 3.0
        row.look[:, lk.YAW_RATE] = first.look[:, lk.YAW_RATE] + 4.0
        row.signals[:, [signal("rear_slip"), signal("front_slip")]] = [0.1, -3.0]
        row.signals[:, [signal("rear_slip_angle"), signal("front_slip_angle")]] = [0.2, -0.1]
        row.signals[:, [signal("rear_use"), signal("front_use")]] = [1.5, 0.3]

    before = start[0]
    rides = rides_of((first, *start[1:]))
    result, _ = decide(rides, first, lean, actions=(0.5, -0.2))
    terms = {name: float(term[0]) for name, term in result.terms.items()}
    time = 3 * PERIOD
    assert terms["lean_change"] == pytest.approx(-abs(1.1 - before.state[0, 3]))
    assert terms["steer_change"] == pytest.approx(-abs(0.05 - before.state[0, 4]))
    assert terms["rate_change"] == pytest.approx(-np.hypot(3.0 - before.state[0, 7], 4.0))
    assert terms["max_lean"] == pytest.approx(-(1.1 - np.radians(54.0)) * time)
    assert terms["slip_ratio"] == pytest.approx(-1.1 * time)  # a ratio counts 1 at most
    assert terms["slip_angle"] == pytest.approx(-0.3 * time)
    assert terms["tyre_use"] == pytest.approx(-0.5 * time)
    assert terms["line"] == pytest.approx(-2.0 * time)
    assert terms["steering_change"] == pytest.approx(-0.25)
    assert terms["throttle_change"] == pytest.approx(-0.04)


def test_overspeed_is_beyond_the_share_and_the_limit(start):
    terms = {}
    for name, context in (
        ("free", RaceContext()),
        ("capped", RaceContext(v_max=30.0)),
        ("slow", RaceContext(share=0.25)),
    ):
        result, _ = decide(rides_of(start, context=context), start[0], forward)
        terms[name] = float(result.terms["overspeed"][0])
    assert terms["free"] == 0.0
    assert terms["capped"] == pytest.approx(-10.0 * 3 * PERIOD)
    assert terms["slow"] < -10.0 * 3 * PERIOD


@pytest.mark.parametrize("preset", ["race_paper", "race_direct"])
def test_the_papers_agent_has_no_plan(start, preset):
    """Twice the planned speed changes neither observation nor reward; that of `race_direct` it does."""
    chosen = load_preset(preset)
    share = chosen.curriculum.share
    shown, terms = [], []
    for part in (share, 2.0 * share):
        rides = rides_of(start, chosen.task, RaceContext(v_max=30.0 if share > 1.0 else 90.0, share=part))
        shown.append(rides.observe(start[0]))
        result, _ = decide(rides, start[0], lambda row: forward(row, 80.0))
        terms.append(float(result.terms["overspeed"][0]))
    assert terms[0] < 0.0
    assert (terms[0] == terms[1]) == (preset == "race_paper")
    assert np.array_equal(*shown) or preset != "race_paper"


@given(a=st.floats(-0.3, 0.3), b=st.floats(-0.3, 0.3))
def test_the_history_penalty_counts_swings_only(a, b):
    penalty = float(history_penalty(np.array([[a, b]]))[0])
    assert 0.0 <= penalty <= 1.0
    assert penalty == float(history_penalty(np.array([[-a, -b]]))[0])
    if a * b >= 0.0 or min(abs(a), abs(b)) <= 0.0084:
        assert penalty == 0.0
    elif abs(a) + abs(b) > 0.1:
        assert penalty > 0.99


@pytest.mark.parametrize("repeat", [1, 3])
@pytest.mark.parametrize(
    ("term", "column", "motion", "punished"),
    [
        ("lean_history", 3, lambda t: 0.5 + np.radians(10.0) * np.sin(2.0 * np.pi * 4.0 * t), True),  # weave
        ("steer_history", 4, lambda t: np.radians(2.0) * np.sin(2.0 * np.pi * 9.0 * t), True),  # wobble
        ("steer_history", 4, lambda t: np.radians(2.0) * np.sin(2.0 * np.pi * 4.0 * t), True),
        ("lean_history", 3, lambda t: 0.9 * np.sin(np.pi * min(t / 1.6, 0.5)), False),  # into a corner
        ("lean_history", 3, lambda t: 0.9 * np.cos(np.pi * min(t / 1.2, 1.0)), False),  # from one to the other side
        ("steer_history", 4, lambda t: np.radians(3.0) * np.sin(np.pi * t), False),  # a turn of one second
    ],
)
def test_weave_and_wobble_are_punished_and_a_clean_turn_in_is_not(start, term, column, motion, punished, repeat):
    rides, row = rides_of(start), start[0]
    row = copied(row)
    time, total = 0.0, 0.0
    while time < 1.5:

        def move(row):
            nonlocal time
            time += PERIOD
            row.state[:, column] = motion(time)

        result, row = decide(rides, row, move, periods=repeat)
        total += result.terms[term][0] if time > 0.2 else 0.0  # what the ride was like before does not count
    assert -15.0 <= total <= 0.0  # a step of 0.1 s counts 1 at most
    assert total < -2.0 if punished else total == 0.0


def test_scraping_along_a_wall_costs_energy_in_each_period(start):
    def scrape(row):
        row.circuit[:, lk.WALL_ENERGY] += 10.0
        row.signals[:, signal("speed")] = 30.0

    result, _ = decide(rides_of(start), start[0], scrape)
    assert result.terms["wall"][0] == pytest.approx(-3 * 0.5 * 30.0**2)


@pytest.mark.parametrize("weights", [RACE_WEIGHTS, load_preset("race_paper").task.weights], ids=["race", "paper"])
def test_terms_have_their_weights(start, weights):
    plain, _ = decide(rides_of(start), start[0], forward, actions=(0.4, -0.4))
    result, _ = decide(rides_of(start, replace(TASK, weights=weights)), start[0], forward, actions=(0.4, -0.4))
    assert list(result.terms) == list(weights)
    for name, weight in weights.items():
        assert result.terms[name][0] == weight * plain.terms[name][0]
    assert sum_of(result.terms)[0] == pytest.approx(sum(term[0] for term in result.terms.values()))


def test_the_error_of_a_validation_is_time_over_the_planned_lap():
    assert TASK.validation_error(np.full(100, 0.2), True) == pytest.approx(0.25)  # 80 % of the speed
    assert TASK.validation_error(np.zeros(100), True) == 0.0
    assert TASK.validation_error(np.zeros(100), False) == 1.0
    track = np.zeros((10, 4))
    whole = np.array([True, True, False, True])
    assert TASK.selection_error(track, whole) > 1.0 > TASK.selection_error(track, np.ones(4, dtype=bool))


@pytest.mark.parametrize("task", [TASK, GUIDED_TASK], ids=["alone", "guided"])
def test_one_ride_is_shown_and_judged_as_in_a_batch(task, oval):
    """A simulator of its own and a compiled batch give the same observations and rewards, bit for bit."""
    requests = [ResetRequest(course=oval, speed_range=(v, v), progress=p) for v, p in ((30.0, 0.0), (25.0, 900.0))]
    batch = Batch(2, COMPILED, task.preview)
    simulator = Simulator(COMPILED)
    together = task.make_state(2, batch.vehicle)
    for row, request in enumerate(requests):
        batch.reset(row, request)
        together.begin(row, batch, request, batch.course(row))
    row = rows_of(simulator.reset(requests[1]))
    alone = task.make_state(1, simulator.vehicle)
    assert simulator.course is not None
    alone.begin(0, row, requests[1], simulator.course)
    rng = np.random.default_rng(1)
    for _ in range(12):
        actions = np.clip(0.2 * rng.normal(size=(2, 2)) + [0.0, 0.2], -1.0, 1.0)
        np.testing.assert_array_equal(together.observe(batch)[1], alone.observe(row)[0])
        together.act(batch, actions)
        alone.act(row, actions[1:])
        for _ in range(task.repeat):
            batch.step(together.commands(batch))
            together.advance(batch)
            row = rows_of(simulator.step(*alone.commands(row)[0].tolist()))
            alone.advance(row)
        many, one = together.evaluate(batch), alone.evaluate(row)
        for name, term in many.terms.items():
            assert term[1] == one.terms[name][0], name
    batch.close()
    simulator.close()


def test_machines_in_turn_are_shown_and_judged_as_each_alone(oval):
    """Rows that take two machines in turn give what one-machine batches of the same rides give, bit for bit."""
    task = replace(GUIDED_TASK, observation="conditioned", repeat=4)
    machines = ("panigale_v4r", "r1")
    requests = [
        ResetRequest(course=oval, speed_range=(v, v), progress=p)
        for v, p in ((30.0, 0.0), (25.0, 300.0), (20.0, 800.0))
    ]
    among = batch_of(task, 3, COMPILED, machines)
    alone = [batch_of(task, 1, replace(COMPILED, vehicle=machines[row % 2])) for row in range(3)]
    for row, request in enumerate(requests):
        for place, (batch, rides) in ((row, among), (0, alone[row])):
            batch.reset(place, request)
            rides.begin(place, batch, request, batch.course(place))
    rng = np.random.default_rng(1)
    for _ in range(4):
        actions = rng.uniform(-1.0, 1.0, (3, 2))
        seen = ride_decision(*among, actions, task.repeat)
        for row, (batch, rides) in enumerate(alone):
            observation, terms = ride_decision(batch, rides, actions[row : row + 1], task.repeat)
            np.testing.assert_array_equal(seen[0][row], observation[0])
            assert [term[row] for term in seen[1].values()] == [term[0] for term in terms.values()]
    facts = [place for place, name in enumerate(task.layout.names) if name.startswith("machine_")]
    assert len(facts) == len(DESCRIPTOR)
    np.testing.assert_array_equal(seen[0][0, facts], seen[0][2, facts])
    assert (seen[0][0, facts] != seen[0][1, facts]).sum() > 5
    stored = among[1].state_dict()
    again = among[1].observe(among[0])
    among[1].act(among[0], np.zeros((3, 2)))
    among[1].restore(stored)
    np.testing.assert_array_equal(among[1].observe(among[0]), again)
    for batch, _ in (among, *alone):
        batch.close()


def ride_decision(batch, rides, actions, repeat):
    """Return what was seen before a decision, and the terms of its reward."""
    seen = rides.observe(batch)
    rides.act(batch, actions)
    for _ in range(repeat):
        batch.step(rides.commands(batch))
        rides.advance(batch)
    return seen, rides.evaluate(batch).terms


def test_machines_of_every_engine_are_taken_in_turn_but_no_bicycle_among_them():
    batch, _ = batch_of(TASK, 3, replace(COMPILED, engine="pybullet"), ("panigale_v4r", "r1"))
    assert [vehicle.name for vehicle in batch.vehicles] == ["panigale_v4r", "r1", "panigale_v4r"]
    batch.close()
    with pytest.raises(ValueError, match="is for superbikes; for the bicycle 'whipple'"):
        batch_of(TASK, 2, COMPILED, ("panigale_v4r", "whipple"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": {"praise": 1.0}}, "weights='praise' is not known.*progress"),
        ({"task": "rally"}, "task='rally' is not known; there are race"),
        ({"observation": "told"}, "observation='told' is not known; there are compact"),
        ({"weights": {"line": -1.0}}, "weights.line=-1.0 must be at least 0"),
        ({"max_steps": 0}, "max_steps=0 must be at least 1"),
        ({"stalled_time": -1.0}, "stalled_time=-1.0 must be at least 0"),
    ],
)
def test_wrong_settings_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(TASK, **change)


def test_commands_act_as_late_as_each_row_s_world_says():
    worlds = [draw_world(number) for number in range(12)]
    late = [round(world.command_delay_s / PERIOD) for world in worlds]
    assert {0, 1, 2} == set(late)
    task = RaceTask(observation="adaptive", disturbances=("world:0-11",))
    batch, rides = batch_of(task, 12, COMPILED)
    for row in range(12):
        request = ResetRequest(course="barcelona", speed_range=(40.0, 40.0), progress=200.0)
        batch.reset(row, request)
        rides.begin(row, batch, request, batch.course(row))
    seen = rides.observe(batch)
    assert seen.shape == (12, task.layout.size)
    rides.act(batch, np.tile([0.0, 0.5], (12, 1)))
    acting = np.stack([rides.commands(batch)[:, 1] for _ in range(3)])
    for row, periods in enumerate(late):
        np.testing.assert_array_equal(acting[:, row], [0.5 * (k >= periods) for k in range(3)])
    for _ in range(50):
        batch.step(rides.commands(batch))
    other = task.make_state(12, load_vehicle("panigale_v4r"))
    for row in range(12):
        other.begin(row, batch, ResetRequest(course="barcelona"), batch.course(row))
    other.restore(rides.state_dict()["state"])
    np.testing.assert_array_equal(other.observe(batch), rides.observe(batch))
    assert len(np.unique(rides.observe(batch)[:, task.layout.places["grip"]])) > 3
    batch.close()
