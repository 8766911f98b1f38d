"""Rides of unknown worlds: the same in any company, judged against a rider that is told, and taken up again."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from bike_policy.planning.lap_plan import CAREFUL_SETTINGS, CLASSICAL_SETTINGS
from bike_sim.sim.disturbances import Disturbances, RoadChanges
from bike_sim.sim.worlds import JUDGED, MACHINES, PREFIX, WorldRide, draw_ride, load_rides
from bike_sim.vehicles.files import load_superbike
from bike_training.commands import evaluate_worlds
from bike_training.rollout.worlds import Ridden, ride_told, ride_worlds, summary, untold, wilson


@pytest.fixture(scope="module")
def rides(circuit: Path) -> list[WorldRide]:
    """Rides of a small circuit: as known, late on less grip, and on a patch that nobody can hold at full speed.

    The oracle finds its corrections within few rides: each more would be ridden twice.
    """
    worlds = [
        Disturbances(name="known"),
        Disturbances(name="late", command_delay_s=0.02, road=RoadChanges(0.95)),
        Disturbances(name="ice", road=RoadChanges(patches=((500.0, 600.0, 0.8),))),
    ]
    return [WorldRide(k, "panigale_v4r", str(circuit), 0.1 + 0.2 * k, 0.7, world) for k, world in enumerate(worlds)]


@pytest.fixture(scope="module")
def told(rides: list[WorldRide]) -> list[Ridden]:
    return ride_told(rides)


def test_a_ride_is_the_same_in_any_company(rides: list[WorldRide], told: list[Ridden]) -> None:
    classical = untold(CLASSICAL_SETTINGS)
    together = ride_worlds(rides, classical)
    assert ride_worlds(rides[1:2], classical)[0] == together[1]
    assert (together[0].cause, together[1].cause) == ("", "")
    assert together[2].cause, "the patch throws a rider down that does not know of it"
    assert ride_told(rides[2:]) == told[2:], "the corrections are kept"


def test_a_careful_rider_bears_a_patch_and_is_as_fast_where_it_has_been(circuit: Path) -> None:
    patch = Disturbances(name="patch", road=RoadChanges(patches=((525.0, 585.0, 0.9),)))
    rides = [
        WorldRide(k, "panigale_v4r", str(circuit), 0.5, 0.7, world) for k, world in enumerate((Disturbances(), patch))
    ]
    careful, fast = (ride_worlds(rides, untold(settings)) for settings in (CAREFUL_SETTINGS, CLASSICAL_SETTINGS))
    assert [ridden.cause for ridden in (*careful, *fast)] == ["", "", "", "low_side"]
    first, second = careful[0].laps_s
    assert second < 0.99 * first
    assert second == pytest.approx(fast[0].lap_s, rel=5e-3)
    assert careful[1].lap_s > second


def test_the_oracle_rides_what_it_is_told(told: list[Ridden]) -> None:
    assert [ridden.cause for ridden in told] == ["", "", ""]
    known, late, ice = (ridden.lap_s for ridden in told)
    assert known < late < ice
    assert [len(ridden.laps_s) for ridden in told] == [2, 2, 2]


def test_the_judged_worlds_are_apart_from_those_to_learn_on() -> None:
    judged, others = load_rides(["200"]), load_rides(["0-399"])
    assert [ride.number for ride in judged] == list(range(JUDGED, JUDGED + 200))
    assert judged[7] == draw_ride(JUDGED + 7)
    drawn = {ride.circuit for ride in judged if ride.circuit.startswith("random")}
    assert len(drawn) == 22
    assert not drawn & {ride.circuit for ride in others}
    assert {ride.vehicle.removesuffix("_suspended") for ride in judged} == set(MACHINES)
    assert len({(ride.vehicle, ride.circuit) for ride in judged}) == len({ride.circuit for ride in judged})
    for vehicle in {ride.vehicle for ride in (*judged, *others)}:
        machine = load_superbike(vehicle)
        assert judged[0].disturbances.wrong(machine).mass != machine.mass
    named = load_rides(["road_090"])
    assert len({ride.key for ride in named}) == len(named) == 32


def test_worlds_that_the_oracle_loses_do_not_count() -> None:
    def row(number: int, cause: str, lap: float | None) -> dict:
        return {"world": f"{PREFIX}{number}", "start": number, "cause": cause, "laps": 2 if lap else 0, "lap_s": lap}

    oracle = [row(0, "", 100.0), row(1, "", 100.0), row(2, "wall", None), row(3, "", 100.0)]
    rider = [row(0, "", 102.0), row(1, "", 104.0), row(2, "", 90.0), row(3, "high side", None)]
    figures = summary(rider, oracle)["worlds"]
    assert (figures["rides"], figures["counted"], figures["whole"]) == (4, 3, 2)
    assert (figures["lost_first"], figures["causes"]) == (1, {"high side": 1})
    assert figures["excess"] == pytest.approx(0.03)
    # Brown, Cai and DasGupta (2001), Interval estimation for a binomial proportion
    assert wilson(0, 10) == (0.0, pytest.approx(0.2775, abs=1e-4))
    assert wilson(5, 10) == (pytest.approx(0.2366, abs=1e-4), pytest.approx(0.7634, abs=1e-4))


def test_a_call_that_was_stopped_goes_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ridden: list[int] = []

    def ride(rides: list[WorldRide], *_: object) -> list[Ridden]:
        if ridden and rides[0].vehicle == "zx10rr":
            raise KeyboardInterrupt
        ridden.extend(each.number for each in rides)
        return [Ridden("", float("nan"), float("nan"), (90.0, 80.0 + each.number)) for each in rides]

    monkeypatch.setattr(evaluate_worlds, "ride_worlds", ride)
    names = ("r1", "zx10rr", "r1")
    rides = [WorldRide(k, name, "barcelona", 0.0, 0.5, Disturbances()) for k, name in enumerate(names)]
    monkeypatch.setattr(evaluate_worlds, "load_rides", lambda names: rides)
    args = argparse.Namespace(worlds=["3"], rider="classical", subject="classical", laps=1, out=tmp_path, json=True)
    with pytest.raises(KeyboardInterrupt):
        evaluate_worlds.run(args)
    assert ridden == [0, 2]
    ridden.clear()
    figures = evaluate_worlds.run(args)["figures"]
    assert ridden == [1]
    assert [row["lap_s"] for row in figures["worlds"]] == [80.0, 81.0, 82.0]
