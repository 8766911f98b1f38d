"""A rehearsed racing policy: the plan as it is where its ride ends well, less granted before places where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.riders.test_rehearsal import over_a_crest

from bike_policy.contract.action import PACE, ActionColumn, ActionLayout
from bike_policy.contract.actor import Actor
from bike_policy.contract.bundle import Bundle, load_bundle
from bike_policy.riders import race_plan_verification
from bike_policy.riders.line_law import P_FASTER, P_SPEED, UNLIMITED, LineLaw, LinePlan
from bike_policy.riders.line_law import PACE as PACED
from bike_policy.riders.plan_verification import RolloutBatch, rehearsed
from bike_policy.riders.race_guide import GUIDE
from bike_policy.riders.race_plan_verification import _Decided, _plan
from bike_policy.riders.race_reference import References
from bike_policy.riders.racer import Racer
from bike_sim.course.course import Course
from bike_sim.vehicles.superbike import Superbike

PERIOD = 0.02
pytestmark = pytest.mark.usefixtures("own_cache")


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
    return _plan(always(0.12), panigale, line, PERIOD, References(panigale))


def test_a_policy_that_rides_well_is_granted_everything(panigale: Superbike, line: Course) -> None:
    plan = _plan(always(0.002), panigale, line, PERIOD, References(panigale))
    np.testing.assert_array_equal(plan.table, rehearsed(panigale, line, GUIDE, PERIOD).table)


def test_a_policy_that_falls_is_granted_less_before_the_fall(panigale: Superbike, line: Course, bold: LinePlan) -> None:
    policy, own, references = always(0.12), rehearsed(panigale, line, GUIDE, PERIOD), References(panigale)

    def ends(plan: LinePlan) -> np.ndarray:
        with RolloutBatch(panigale, line, PERIOD, 3) as stage:
            return stage.ride(plan, _Decided(Racer(policy, panigale, PERIOD, 3, lambda _: plan, references), line), 2)

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
        np.testing.assert_allclose(law.memory[:, PACED], [expected, -0.1], atol=1e-4)


def test_the_same_is_rehearsed_once(
    panigale: Superbike, line: Course, bold: LinePlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    rides: list[int] = []

    class Counting(RolloutBatch):
        def __init__(self, vehicle: Superbike, line: Course, period: float, count: int) -> None:
            rides.append(count)
            super().__init__(vehicle, line, period, count)

    monkeypatch.setattr(race_plan_verification, "RolloutBatch", Counting)
    references = References(panigale)
    np.testing.assert_array_equal(_plan(always(0.12), panigale, line, PERIOD, references).table, bold.table)
    assert not rides
    _plan(always(0.001), panigale, line, PERIOD, references)
    assert rides


def test_a_bicycle_policy_does_not_race(panigale: Superbike) -> None:
    with pytest.raises(ValueError, match="'whipple' follows paths; it cannot race"):
        race_plan_verification.rehearsed_racer(load_bundle("whipple"), panigale, PERIOD, 1)
