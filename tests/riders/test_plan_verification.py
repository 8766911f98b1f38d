"""Verified plans: the plan itself where its rides end well, slower where they do not, less granted to a bold policy."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from bike_policy.contract.action import PACE, ActionColumn, ActionLayout
from bike_policy.contract.bundle import Actor, Bundle, load_bundle
from bike_policy.planning import line_law
from bike_policy.planning.lap_plan import (
    CLASSICAL_SETTINGS,
    GUIDE,
    P_FASTER,
    P_SPEED,
    UNLIMITED,
    LinePlan,
    plan_line,
)
from bike_policy.planning.line_law import LineLaw
from bike_policy.planning.plan_verification import (
    BEFORE,
    LEAST_BEFORE,
    PATIENCE,
    ROUNDS,
    BatchRider,
    PlanFollower,
    Rollouts,
    verified_plan,
)
from bike_policy.riders.racing import PolicyBatch, verified_for
from bike_sim.course.course import Course
from bike_sim.sim.batch import Batch
from bike_sim.vehicles.superbike import Superbike
from tests.circuits import circle, over_a_crest

PERIOD = 0.02
pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def slower(panigale: Superbike, own_cache: None) -> LinePlan:
    """A plan over a crest that throws the machine."""
    return verified_plan(panigale, over_a_crest(3.0), CLASSICAL_SETTINGS, PERIOD)


def ends_of(rollouts: Rollouts, plan: LinePlan, rider: BatchRider) -> NDArray[np.float64]:
    """Return where three rides of a plan end that do not end well."""
    with rollouts.batch(3) as batch:
        return rollouts.ride(batch, plan, rider, 2)


def test_a_plan_that_rides_well_stays_as_it_is(panigale: Superbike, caplog: pytest.LogCaptureFixture) -> None:
    line = over_a_crest(0.3)
    plan = plan_line(panigale, line, CLASSICAL_SETTINGS)
    np.testing.assert_array_equal(verified_plan(panigale, line, CLASSICAL_SETTINGS, PERIOD).table, plan.table)
    assert not caplog.records


def test_a_plan_that_falls_is_slower_before_the_fall_until_it_does_not(panigale: Superbike, slower: LinePlan) -> None:
    line = over_a_crest(3.0)
    plan, rollouts = plan_line(panigale, line, CLASSICAL_SETTINGS), Rollouts(panigale, line, PERIOD)

    def ends(tried: LinePlan) -> NDArray[np.float64]:
        rider = PlanFollower(panigale, PERIOD, CLASSICAL_SETTINGS, tried, [0.0] * 3)
        return ends_of(rollouts, tried, rider)

    fallen = ends(plan)
    assert len(fallen)
    assert not len(ends(slower))
    ratio = slower.profile.speed / plan.profile.speed
    assert ratio.max() < 1.005  # a lean that is less deep elsewhere moves the path of the mass
    place, speed = fallen[0]
    before = (place - plan.profile.s > 0.0) & (place - plan.profile.s < max(BEFORE * speed, LEAST_BEFORE))
    assert ratio[before].max() < 0.99
    assert slower.profile.lap_time < 1.05 * plan.profile.lap_time


def test_a_place_that_no_lower_speed_helps_is_reached_slower_from_further_ahead(
    panigale: Superbike, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = circle(60.0, 1.0)
    plan = plan_line(panigale, line, CLASSICAL_SETTINGS)
    place, cause = 300.0, int(np.searchsorted(plan.profile.s, 140.0))
    reach = max(BEFORE * float(plan.profile.speed.max()), LEAST_BEFORE)
    assert place - reach > plan.profile.s[cause] > place - 3.0 * reach
    rounds = []

    def ride(_: Rollouts, batch: Batch, tried: LinePlan, *rest: object) -> NDArray[np.float64]:
        """End at one place as long as another, much further ahead, is ridden as planned."""
        rounds.append(tried)
        helped = tried.profile.speed[cause] < 0.97 * plan.profile.speed[cause]
        return np.empty((0, 2)) if helped else np.array([[place, tried.profile.speed.max()]])

    monkeypatch.setattr(Rollouts, "ride", ride)
    verified_plan(panigale, line, CLASSICAL_SETTINGS, PERIOD)
    assert 2 * PATIENCE < len(rounds) < ROUNDS


def test_a_plan_that_still_falls_in_the_end_is_named_each_time(
    panigale: Superbike, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    rounds = []

    def ride(*_: object) -> NDArray[np.float64]:
        rounds.append(1)
        return np.array([[100.0, 20.0], [100.0, 20.0]])

    monkeypatch.setattr(Rollouts, "ride", ride)
    for _ in range(2):
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            verified_plan(panigale, circle(55.0, 1.0), CLASSICAL_SETTINGS, PERIOD)
        (record,) = caplog.records
        words = record.getMessage()
        assert words == (
            "panigale_v4r on line 'circle': 2 of 5 rides of the plan still end early after 20 corrections; it is used "
            "as it is"
        )
    assert len(rounds) == ROUNDS, "the second time nothing is ridden"


def test_the_mirrored_line_gets_the_mirrored_plan(panigale: Superbike, slower: LinePlan) -> None:
    left = slower.profile
    right = verified_plan(panigale, over_a_crest(3.0, -1.0), CLASSICAL_SETTINGS, PERIOD).profile
    np.testing.assert_allclose(left.speed, right.speed, rtol=1e-9)
    np.testing.assert_allclose(left.lateral, -right.lateral, atol=1e-8)


def test_an_open_line_is_refused(panigale: Superbike) -> None:
    whole = circle(60.0, 1.0)
    half = len(whole.s) // 2
    columns = {name: getattr(whole, name)[:half] for name in ("s", "x", "y", "heading", "curvature")}
    with pytest.raises(ValueError, match="open; a lap needs a closed line"):
        verified_plan(panigale, replace(whole, **columns, closed=False), CLASSICAL_SETTINGS, PERIOD)


# ------------------------------------------------------------------------------------------------------------ policies


def always(pace: float) -> Bundle:
    """A policy that asks for the same change of the planned speed everywhere."""
    racer = load_bundle("racer")
    action = ActionLayout((racer.action.columns[0], ActionColumn(PACE, pace)))
    weights = np.zeros((2, racer.layout.size), dtype=np.float32)
    return replace(racer, actor=Actor([weights], [np.array([0.0, 9.0], dtype=np.float32)]), action=action)


@pytest.fixture(scope="module")
def line() -> Course:
    """A circle with a crest that the guide takes as planned, and not much faster."""
    return over_a_crest(2.0)


@pytest.fixture(scope="module")
def bold(panigale: Superbike, line: Course, own_cache: None) -> LinePlan:
    """The plan for a policy that asks for more than the crest bears."""
    return verified_for(always(0.12), panigale, line, PERIOD)


def test_a_policy_that_rides_well_is_granted_everything(panigale: Superbike, line: Course) -> None:
    plan = verified_for(always(0.002), panigale, line, PERIOD)
    np.testing.assert_array_equal(plan.table, verified_plan(panigale, line, GUIDE, PERIOD).table)


def test_a_policy_that_falls_is_granted_less_before_the_fall(panigale: Superbike, line: Course, bold: LinePlan) -> None:
    policy, own = always(0.12), verified_plan(panigale, line, GUIDE, PERIOD)

    def ends(plan: LinePlan) -> np.ndarray:
        rider = PolicyBatch(policy, panigale, PERIOD, 3, lambda _: plan)
        return ends_of(Rollouts(panigale, line, PERIOD), plan, rider)

    fallen = ends(own)
    assert len(fallen)
    assert not len(ends(bold))
    granted = bold.table[:, P_FASTER]
    assert set(granted) <= {0.0, 0.06, UNLIMITED}
    assert np.interp(fallen[0, 0] - 5.0, bold.profile.s, granted) <= 0.06
    assert granted.max() == UNLIMITED
    np.testing.assert_array_equal(bold.table[:, P_SPEED], own.table[:, P_SPEED])


def test_what_is_asked_beyond_the_room_is_not_ridden(panigale: Superbike, line: Course, bold: LinePlan) -> None:
    """In front of the crest the guide ends at what is granted, elsewhere at what is asked; less is always granted."""
    law = LineLaw(panigale, PERIOD, GUIDE, 2)
    granted = bold.table[:-1, P_FASTER]
    less, all_of_it = (int(np.argmin(granted)) + 1, int(np.argmax(granted)) + 1)
    for place, expected in ((bold.profile.s[less], min(granted[less], 0.1)), (bold.profile.s[all_of_it], 0.1)):
        for row in range(2):
            law.begin(row, bold)
        for step in range(200):
            seen = np.array([[20.0, -0.5, place, 1e-9 * step, 0.0, 0.0]] * 2)
            law.commands(seen, np.array([[0.0, 0.1], [0.0, -0.1]]))
        np.testing.assert_allclose(law.memory[:, line_law.PACE], [expected, -0.1], atol=1e-4)


def test_the_same_plan_and_the_same_policy_are_verified_once(
    panigale: Superbike, slower: LinePlan, line: Course, bold: LinePlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    rides: list[int] = []
    batch, crest = Rollouts.batch, over_a_crest(3.0)

    def counting(self: Rollouts, count: int) -> object:
        rides.append(count)
        return batch(self, count)

    monkeypatch.setattr(Rollouts, "batch", counting)
    np.testing.assert_array_equal(verified_plan(panigale, crest, CLASSICAL_SETTINGS, PERIOD).table, slower.table)
    np.testing.assert_array_equal(verified_for(always(0.12), panigale, line, PERIOD).table, bold.table)
    assert not rides
    verified_plan(panigale, crest, replace(CLASSICAL_SETTINGS, lateral=0.7), PERIOD)
    assert len(rides) == 1
    verified_for(always(0.001), panigale, line, PERIOD)
    assert len(rides) == 2


def test_a_bicycle_policy_does_not_race(panigale: Superbike) -> None:
    with pytest.raises(ValueError, match="'whipple' follows paths; it cannot race"):
        PolicyBatch(load_bundle("whipple"), panigale, PERIOD, 1)
