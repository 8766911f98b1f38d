"""A rehearsed plan: the plan itself where its ride ends well, slower where it does not, the same mirrored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from bike_policy.riders import plan_verification
from bike_policy.riders.lap_plan import CLASSICAL_SETTINGS
from bike_policy.riders.line_law import LinePlan, plan_line
from bike_policy.riders.plan_verification import (
    BEFORE,
    LEAST_BEFORE,
    PATIENCE,
    ROUNDS,
    RideLaw,
    RolloutBatch,
    _AsPlanned,
    rehearsed,
)
from bike_sim.course.course import Course
from bike_sim.vehicles.superbike import Superbike
from tests.superbike.test_classical import circle

PERIOD = 0.02
pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def slower(panigale: Superbike, own_cache: None) -> LinePlan:
    """A plan over a crest that throws the machine."""
    return rehearsed(panigale, over_a_crest(3.0), CLASSICAL_SETTINGS, PERIOD)


def over_a_crest(height: float, turn: float = 1.0) -> Course:
    """A circle that turns to the left (1) or to the right (-1), with a crest (m) after a quarter of the lap."""
    level = circle(60.0, 1.0)
    hill = height * np.exp(-(((level.s - 0.25 * level.length) / 20.0) ** 2))
    return replace(level, y=turn * level.y, heading=turn * level.heading, curvature=turn * level.curvature, height=hill)


def test_a_plan_that_rides_well_stays_as_it_is(panigale: Superbike) -> None:
    line = over_a_crest(0.3)
    plan = plan_line(panigale, line, CLASSICAL_SETTINGS)
    np.testing.assert_array_equal(rehearsed(panigale, line, CLASSICAL_SETTINGS, PERIOD).table, plan.table)


def test_a_plan_that_falls_is_slower_before_the_fall_until_it_does_not(panigale: Superbike, slower: LinePlan) -> None:
    line = over_a_crest(3.0)
    plan = plan_line(panigale, line, CLASSICAL_SETTINGS)
    paces = np.zeros(3)

    def ends_of(plan: LinePlan) -> NDArray[np.float64]:
        with RolloutBatch(panigale, line, PERIOD, len(paces)) as stage:
            return stage.ride(plan, _AsPlanned(panigale, plan, CLASSICAL_SETTINGS, PERIOD, paces), 2)

    ends = ends_of(plan)
    assert len(ends)
    assert not len(ends_of(slower))
    ratio = slower.profile.speed / plan.profile.speed
    assert ratio.max() < 1.005  # a lean that is less deep elsewhere moves the path of the mass
    place, speed = ends[0]
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

    class Braking(RolloutBatch):
        """Rides end at one place as long as another, much further ahead, is ridden as planned."""

        def ride(self, plan_now: LinePlan, rider: RideLaw, starts: int) -> NDArray[np.float64]:
            rounds.append(plan_now)
            slower = plan_now.profile.speed[cause] < 0.97 * plan.profile.speed[cause]
            return np.empty((0, 2)) if slower else np.array([[place, plan_now.profile.speed.max()]])

    monkeypatch.setattr(plan_verification, "RolloutBatch", Braking)
    rehearsed(panigale, line, CLASSICAL_SETTINGS, PERIOD)
    assert 2 * PATIENCE < len(rounds) < ROUNDS


def test_the_same_is_rehearsed_once(panigale: Superbike, slower: LinePlan, monkeypatch: pytest.MonkeyPatch) -> None:
    line = over_a_crest(3.0)
    ridden: list[str] = []

    class Counting(RolloutBatch):
        def ride(self, plan: LinePlan, rides: RideLaw, starts: int) -> NDArray[np.float64]:
            ridden.append("again")
            return super().ride(plan, rides, starts)

    monkeypatch.setattr("bike_policy.riders.plan_verification.RolloutBatch", Counting)
    np.testing.assert_array_equal(rehearsed(panigale, line, CLASSICAL_SETTINGS, PERIOD).table, slower.table)
    assert not ridden
    rehearsed(panigale, line, replace(CLASSICAL_SETTINGS, lateral=0.7), PERIOD)
    assert ridden


def test_the_mirrored_line_gets_the_mirrored_plan(panigale: Superbike, slower: LinePlan) -> None:
    left = slower.profile
    right = rehearsed(panigale, over_a_crest(3.0, -1.0), CLASSICAL_SETTINGS, PERIOD).profile
    np.testing.assert_allclose(left.speed, right.speed, rtol=1e-9)
    np.testing.assert_allclose(left.lateral, -right.lateral, atol=1e-8)


def test_an_open_line_is_refused(panigale: Superbike) -> None:
    whole = circle(60.0, 1.0)
    half = len(whole.s) // 2
    columns = {name: getattr(whole, name)[:half] for name in ("s", "x", "y", "heading", "curvature")}
    with pytest.raises(ValueError, match="open; a lap needs a closed line"):
        rehearsed(panigale, replace(whole, **columns, closed=False), CLASSICAL_SETTINGS, PERIOD)
