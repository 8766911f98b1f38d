"""The shipped racing policies: whole laps from anywhere, faster than the classical rider, on circuits new to them."""

from __future__ import annotations

from pathlib import Path

import pytest

from bike_policy.contract.bundle import load_bundle, shipped_policies
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_policy.riders.rider import DEFAULT, make_rider
from bike_policy.riders.wheel_to_wheel import CLASSICAL, unverified_plan
from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.sim.race import Entry, Race, RaceSettings
from bike_sim.sim.worlds import load_disturbances
from bike_training.rollout.laps import ride_laps
from bike_training.rollout.races import ride_races
from tests.circuits import ridden

RACERS = [name for name in shipped_policies() if load_bundle(name).layout.races]
AMONG_OTHERS = "overtaker"
"""The one that sees others."""
GUIDED = ("racer", "generalist", AMONG_OTHERS)
"""Those that lead a guide; they learned on random circuits alone."""
DIRECT = "spdl_barcelona"
"""The one that gives lean and throttle itself, as published; it learned in Barcelona."""
ADAPTIVE = "adaptive"
"""The one that does so in worlds and on circuits that nobody told it of; it learned on random circuits."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "vehicle"), [("racer", "r1"), ("generalist", "zx10rr")])
def test_it_laps_from_all_around_faster_than_the_classical_rider(name: str, vehicle: str, kidney: Path) -> None:
    result = ride_races(load_bundle(name), vehicle, str(kidney), starts=4)
    assert result["whole"] == result["rides"] == 4
    assert result["off_track_s"] == 0.0
    assert result["line_distance_m"] < 0.6
    assert result["best_s"] < ride_races(CLASSICAL_SETTINGS, vehicle, str(kidney), starts=1)["best_s"]


@pytest.mark.slow
def test_without_a_guide_it_laps_whole_from_all_around() -> None:
    bundle = load_bundle(DIRECT)
    assert not bundle.action.guided
    assert bundle.training["preset"]["curriculum"]["curriculum"] == "spdl"
    result = ride_races(bundle, "panigale_v4r", "barcelona", starts=3)
    assert result["whole"] == result["rides"] == 3
    assert result["off_track_s"] == 0.0
    assert result["slowest_s"] < 1.06 * result["theory_s"]


@pytest.mark.slow
def test_without_a_guide_it_laps_in_worlds_that_nobody_told_it_of(kidney: Path) -> None:
    """A tenth of the grip is missing from the first metre on, on a circuit that it did not learn on.

    The first lap keeps grip in reserve, the later one less.
    """
    bundle = load_bundle(ADAPTIVE)
    assert not bundle.action.guided
    result = ride_races(bundle, "r1", str(kidney), starts=3, laps=2, disturbances=load_disturbances("road_090"))
    assert result["whole"] == result["rides"] == 3
    assert result["times_s"][0] <= result["later_s"] < 0.99 * result["slowest_s"]


@pytest.mark.slow
def test_where_no_rider_is_named_one_rides_that_less_grip_slows_and_does_not_throw_down(kidney: Path) -> None:
    laps = []
    for disturbances in (None, load_disturbances("grip_090")):
        rider = make_rider(DEFAULT)
        ride, _ = ride_laps("r1", kidney, 1, rider=rider, engine=SUPERBIKE_ENGINE, disturbances=disturbances)
        assert ride["end"] == "finished"
        laps.append(ride["lap_s"])
    assert laps[1] > 1.01 * laps[0]


@pytest.mark.slow
def test_among_others_it_gains_a_place_where_the_classical_rider_gains_none(kidney: Path) -> None:
    """From the back of a grid of four, behind slightly slower ones, on a circuit that it did not learn on.

    Nobody falls or is touched.
    """
    assert load_bundle(AMONG_OTHERS).layout.sees_others
    gained = []
    for name in (CLASSICAL, AMONG_OTHERS):
        riders = [CLASSICAL] * 3 + [name]
        entries = tuple(Entry(f"bike_{k}", "r1", rider) for k, rider in enumerate(riders))
        race = Race(RaceSettings(str(kidney), 1, entries))
        ridden(race, unverified_plan, shares=(0.95, 0.95, 0.95))
        results = race.classification()
        assert {(result.end, result.contacts) for result in results} == {("finished", 0)}
        gained += [result.grid - result.position for result in results if result.name == "bike_3"]
        race.close()
    assert gained[0] == 0
    assert gained[1] >= 1


@pytest.mark.parametrize("name", RACERS)
def test_its_card_says_what_it_saw_and_how_it_was_made(name: str) -> None:
    bundle = load_bundle(name)
    assert bundle.action.guided == (name in GUIDED)
    asked = bundle.training["preset"]["task"]
    scales = ("offset", "pace") if bundle.action.guided else ("lean_scale",)
    parts = [column.scale / asked[scale] for column, scale in zip(bundle.action.columns, scales, strict=False)]
    assert parts == pytest.approx(bundle.training["range"][: len(parts)])
    assert not bundle.training["commit"].endswith("-dirty")
    assert {"seed", "steps", "updates", "seconds"} <= set(bundle.training)
    circuits = bundle.training["preset"]["curriculum"]["circuits"]
    circuits = circuits.split(",") if isinstance(circuits, str) else circuits
    assert all(circuit.startswith("random_circuit:") for circuit in circuits) == (name != DIRECT)
    assert bundle.results["barcelona_panigale_v4r_rides"] == bundle.results["barcelona_panigale_v4r_whole"]


def test_the_generalist_sees_which_machine_it_rides() -> None:
    bundle = load_bundle("generalist")
    assert "machine" in bundle.layout.terms
    assert len(bundle.training["vehicle"].split(",")) == 5
