"""The shipped racing policies: whole laps from anywhere, faster than the classical rider, on circuits new to them."""

from __future__ import annotations

import pytest

from bike_policy.contract.bundle import load_bundle, shipped_policies
from bike_policy.contract.race import RaceLayout
from bike_training.rollout.laps import ride_laps
from bike_training.rollout.races import ride_races

RACERS = [name for name in shipped_policies() if isinstance(load_bundle(name).layout, RaceLayout)]
UNSEEN = ("racer", "generalist")
"""Those that learned on random circuits alone."""


@pytest.mark.parametrize(
    ("name", "vehicle", "circuit"),
    [
        ("racer", "panigale_v4r", "barcelona"),
        ("racer", "r1", "phillip_island"),
        ("generalist", "zx10rr", "phillip_island"),
    ],
)
def test_it_laps_from_all_around_faster_than_the_classical_rider(name: str, vehicle: str, circuit: str) -> None:
    result = ride_races(load_bundle(name), vehicle, circuit, starts=16)
    assert result.whole == result.rides == 16
    assert result.off_track == 0.0
    assert result.line < 0.6
    classical = ride_laps(vehicle, circuit, laps=1, engine="compiled").best
    assert classical is not None
    assert result.times[0] < classical.duration


@pytest.mark.parametrize("name", RACERS)
def test_its_card_says_what_it_saw_and_how_it_was_made(name: str) -> None:
    bundle = load_bundle(name)
    assert isinstance(bundle.layout, RaceLayout)
    assert bundle.action.guided
    asked = bundle.training["preset"]["task"]
    parts = [column.scale / asked[name] for column, name in zip(bundle.action.columns, ("offset", "pace"), strict=True)]
    assert parts == pytest.approx(bundle.training["range"])
    assert not bundle.training["commit"].endswith("-dirty")
    assert {"seed", "steps", "updates", "seconds"} <= set(bundle.training)
    circuits = bundle.training["preset"]["curriculum"]["circuits"].split(",")
    assert all(circuit.startswith("random_circuit:") for circuit in circuits) == (name in UNSEEN)
    assert bundle.results["barcelona_panigale_v4r_rides"] == bundle.results["barcelona_panigale_v4r_whole"]


def test_the_generalist_is_told_which_machine_it_rides() -> None:
    bundle = load_bundle("generalist")
    assert isinstance(bundle.layout, RaceLayout)
    assert "machine" in bundle.layout.blocks
    assert len(bundle.training["vehicle"].split(",")) == 5
