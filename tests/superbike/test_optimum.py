"""Best laps: the search of one, its files, and rides of those that are shipped."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_policy.planning.lap_plan import plan_line
from bike_policy.riders.optimum import KNOT_SPACING, SETTINGS, BestLap, OptimumRider, shipped_lap
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.commands.declarations import _rider_kind
from bike_training.rollout.optimum import LapSearch, Progress
from bike_training.rollout.rollout import rollout

SHIPPED = ("panigale_v4r", "cremona")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def search(oval: str) -> LapSearch:
    return LapSearch("panigale_v4r", oval)


@pytest.fixture(scope="module")
def found(search: LapSearch) -> Progress:
    plan = plan_line(search.machine, search.line, SETTINGS).profile
    count = round(search.line.length / KNOT_SPACING)
    s = np.arange(count) * search.line.length / count
    lap = BestLap(
        "panigale_v4r", "oval", search.line.length, math.inf, np.zeros(count), np.interp(s, plan.s, plan.speed)
    )
    progress = search.first(lap)
    search.improve(progress, 3)
    return progress


def test_a_search_finds_a_faster_lap_that_is_whole_from_any_start(search: LapSearch, found: Progress) -> None:
    first, *_, last = found.curve
    assert last.lap_time < first.lap_time - 0.05
    assert [point.lap_time for point in found.curve] == sorted((p.lap_time for p in found.curve), reverse=True)
    assert last.ridden > first.ridden
    judged = search.judge(found.best)
    assert judged.lap_time == found.best.lap_time == last.lap_time
    assert judged.lost_at is None
    assert abs(judged.change) < 0.05  # a lap that goes on as it began


def test_a_lap_that_cannot_be_ridden_is_slower_where_it_is_lost(search: LapSearch, found: Progress) -> None:
    too_fast = replace(found.best, speed=np.where(search.line.length / 4 > found.best.s, 1.05, 1.0) * found.best.speed)
    lost = search.judge(too_fast)
    assert lost.lost_at is not None
    assert math.isinf(lost.lap_time)
    begun = search.first(too_fast)
    assert math.isfinite(begun.best.lap_time)
    assert (begun.best.speed <= too_fast.speed + 1e-4).all()
    assert (begun.best.speed < too_fast.speed - 0.1).any()


def test_a_stored_search_goes_on_and_a_lap_is_read_as_it_was_ridden(
    search: LapSearch, found: Progress, tmp_path: Path
) -> None:
    assert search.stored(tmp_path) is None
    search.store(found, tmp_path)
    stored = search.stored(tmp_path)
    assert stored is not None
    np.testing.assert_array_equal(stored.best.offset, found.best.offset)
    np.testing.assert_array_equal(stored.best.speed, found.best.speed)
    assert stored.best.lap_time == found.best.lap_time
    assert len(stored.curve) == len(found.curve)
    before = found.best.lap_time
    search.improve(stored, len(found.curve) - 1)  # all rounds are ridden
    assert stored.best.lap_time == before


def test_files_that_are_no_laps_of_this_ride_are_refused(search: LapSearch, found: Progress, tmp_path: Path) -> None:
    path = tmp_path / "lap.csv"
    path.write_text("x,y\n1,2\n")
    with pytest.raises(ValueError, match=r"lap\.csv holds no lap"):
        BestLap.read(path)
    found.best.write(path)
    for text, other in ((".", "nan."), (",", ",-")):
        lines = path.read_text().splitlines()
        broken = tmp_path / "broken.csv"
        broken.write_text("\n".join([*lines[:-1], lines[-1].replace(text, other, 1)]))
        with pytest.raises(ValueError, match=r"broken\.csv holds"):
            BestLap.read(broken)
    vehicle, line, preview = search.machine, search.line, ResetRequest().preview
    for changed, words in (({"vehicle": "r1"}, "of r1 on oval"), ({"length": 1e3}, "along a line of 1000")):
        with pytest.raises(ValueError, match=words):
            OptimumRider(replace(found.best, **changed)).begin(vehicle, line, 0.02, preview)
    with pytest.raises(FileNotFoundError, match="no best lap of panigale_v4r on oval is shipped"):
        OptimumRider().begin(vehicle, line, 0.02, preview)
    assert _rider_kind(str(path)) == _rider_kind("optimum") == "a superbike"


def test_the_shipped_lap_rides_in_its_time_and_the_same_in_a_simulator() -> None:
    """Alone and in a simulator it is the same ride, bit for bit."""
    lap = BestLap.read(shipped_lap(*SHIPPED))
    search = LapSearch(*SHIPPED)
    judged = search.judge(lap)
    assert judged.lap_time == pytest.approx(lap.lap_time, abs=0.05)  # bit for bit on the machine that found it
    simulator = Simulator(replace(superbike_config(SHIPPED[0]), engine="compiled"))
    search._begin(lap)
    request = simulator.at_own_speed(ResetRequest(course=SHIPPED[1]))
    for snapshot in rollout(simulator, OptimumRider(), request):
        np.testing.assert_array_equal(snapshot.state, search._one.state[0])
        if snapshot.time > 10.0:
            break
        search._ride_until(lambda: True)
    simulator.close()
