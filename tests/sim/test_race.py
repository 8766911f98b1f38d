"""Races from the grid to the flag, and what the stewards say of constructed situations."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, LinePlan, plan_line
from bike_policy.riders.wheel_to_wheel import RaceField
from bike_sim.course.course import Course
from bike_sim.sim.race import FELL, FINISHED, PASSED, Entry, Race, RaceSettings
from bike_sim.sim.stewards import ALONGSIDE, LONG_LAP, Stewards, at_fault
from bike_sim.vehicles.superbike import Superbike
from tests.circuits import OVAL, ridden


@pytest.fixture(scope="module")
def oval(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("race") / "oval.yaml"
    path.write_text(OVAL, encoding="utf-8")
    return str(path)


def settings(course: str, *riders: str, laps: int = 1) -> RaceSettings:
    entries = tuple(Entry(f"machine {k}", "panigale_v4r", rider) for k, rider in enumerate(riders))
    return RaceSettings(course, laps, entries, line=0.0)


def planner(machine: Superbike, line: Course) -> LinePlan:
    """Plan a lap that is not verified."""
    return plan_line(machine, line, CLASSICAL_SETTINGS)


@pytest.fixture(scope="module")
def race(oval: str) -> tuple[Race, list[np.ndarray]]:
    race = Race(settings(oval, "classical", "classical", "classical", laps=2))
    return race, ridden(race, planner)


def test_race_runs_from_the_grid_to_the_flag(race: tuple[Race, list[np.ndarray]]) -> None:
    """Machines start one behind the other with one speed, finish all laps, and are classified by time."""
    raced, _ = race
    fresh = Race(raced.settings)
    progress = fresh.batch.place[:, 0]
    assert np.diff(progress) == pytest.approx([-9.0, -9.0], abs=0.5)
    assert np.ptp(fresh.batch.look[:, 2]) < 0.1
    assert (np.sign(fresh.batch.place[:, 1]) == [1.0, -1.0, 1.0]).all()
    fresh.close()
    results = raced.classification()
    assert [result.end for result in results] == ["finished"] * 3
    assert [result.laps for result in results] == [2] * 3
    times = [result.time_s for result in results]
    assert times == sorted(times)  # type: ignore[type-var]
    assert sorted(result.position for result in results) == [1, 2, 3]
    assert sum(result.passes for result in results) == 0
    finishes = [event for event in raced.log if event.kind == FINISHED]
    assert len(finishes) == 3
    for result in results:
        clean = next(event for event in finishes if event.names == (result.name,))
        assert result.time_s == pytest.approx(float(clean.text.split()[-2]) + result.penalty_s, abs=1e-3)


def test_gaps_are_those_of_the_lines(race: tuple[Race, list[np.ndarray]]) -> None:
    """The first at each line has no gap; at the last line gaps are differences of finishing times."""
    raced, _ = race
    gaps = raced.gaps()
    last = max((lap, sector) for lap, sector, _, _ in gaps)
    at_end = {name: gap for lap, sector, name, gap in gaps if (lap, sector) == last}
    times = {r.name: (r.time_s or 0.0) - r.penalty_s for r in raced.classification()}
    assert at_end == pytest.approx({name: time - min(times.values()) for name, time in times.items()})


def test_race_replays_bit_for_bit_from_its_commands(race: tuple[Race, list[np.ndarray]]) -> None:
    """The same settings and commands give the same race, in a card that went through text as well."""
    raced, commands = race
    again = Race(RaceSettings.from_card(raced.settings.to_card()))
    for pair in commands:
        again.step(pair)
    assert again.batch.state.tobytes() == raced.batch.state.tobytes()
    assert again.log == raced.log
    assert again.energy == raced.energy
    again.close()


def test_faster_machine_passes_from_behind(oval: str) -> None:
    """A classical rider behind one with half the power comes by without touching it."""
    race = Race(settings(oval, "", "classical"))
    machine = race.batch.vehicles[0]
    assert isinstance(machine, Superbike)
    plan = plan_line(machine, race.batch.course(0), CLASSICAL_SETTINGS)
    field = RaceField(["classical", "classical"], race.batch.vehicles, 0.02, lambda machine, line: plan)
    slow = RaceField(
        ["solo:classical", "solo:classical"], race.batch.vehicles, 0.02,
        lambda machine, line: plan_line(machine, line, CLASSICAL_SETTINGS, 0.7 * plan.profile.speed[:-1]),
    )  # fmt: skip
    for row in range(2):
        field.begin(row, race.batch, race.batch.course(row))
        slow.begin(row, race.batch, race.batch.course(row))
    while not race.over and race.time < 60.0:
        fast, ahead = (riders.commands(race.batch, race.step_number) for riders in (field, slow))
        race.step(np.stack([ahead[0], fast[1]]))
    assert [event.names for event in race.log if event.kind == PASSED] == [("machine 1", "machine 0")]
    assert race.energy == 0.0
    assert not any(event.kind == FELL for event in race.log)
    race.close()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"entries": (Entry("a", "r1"), Entry("a", "r1"))}, "two machines of a race are called 'a'"),
        ({"entries": (Entry("a", "r1"),)}, "2 to 12 machines"),
        ({"laps": 0}, "at least 1 lap"),
        ({"entries": (Entry("a", "r1"), Entry("b", "whipple"))}, "do not race each other; 'whipple'"),
    ],
)
def test_what_is_no_race_is_refused(oval: str, change: dict[str, Any], words: str) -> None:
    """One clear error names the value."""
    with pytest.raises(ValueError, match=words):
        Race(RaceSettings(**{"course": oval, "laps": 1, "entries": (Entry("a", "r1"), Entry("b", "r1")), **change}))


def test_grid_longer_than_the_circuit_is_refused(tmp_path: Path) -> None:
    """The error names both lengths."""
    path = tmp_path / "tiny.yaml"
    path.write_text(
        "format: bike.track/1\nlength_m: 110\nwidth_m: 8\nelements:\n  - {straight_m: 20}\n  - {arc: {length_m: 35, "
        "angle_deg: 180}}\n  - {straight_m: 20}\n  - {arc: {length_m: 35, angle_deg: 180}}\n",
        encoding="utf-8",
    )
    with pytest.raises(ValueError, match="grid of 12 machines is 117 m long"):
        Race(settings(str(path), *[""] * 12))


@pytest.mark.parametrize(
    ("rider", "words"),
    [
        ("racer", "policy 'racer' cannot see others.*solo:racer"),
        ("whipple", "cannot race"),
        ("stanley", "does not race"),
    ],
)
def test_riders_that_cannot_race_are_refused(panigale: Superbike, rider: str, words: str) -> None:
    """A policy that cannot see others must be asked for as one that ignores them."""
    with pytest.raises(ValueError, match=words):
        RaceField([rider], [panigale], 0.02)


def touch(**changes: float) -> dict[str, float]:
    """Return a contact: machine 0 is ahead of machine 1 by 0.5 m, on its left, on a straight."""
    known = {
        "row": 0.0, "other": 1.0, "along": 0.5, "across": 0.7, "overlap": math.nan, "drift": 0.0, "other_drift": 0.0,
        "thrown": 0.0, "other_thrown": 0.0, "lying": 0.0,
    }  # fmt: skip
    return known | changes


@pytest.mark.parametrize(
    ("contact", "guilty"),
    [
        (touch(), None),
        (touch(along=2.0), 1),
        (touch(drift=-1.0), 0),
        (touch(other_drift=1.0), 1),
        (touch(drift=-1.0, other_drift=1.0), None),
        (touch(across=-0.7, drift=1.0), 0),
        (touch(overlap=ALONGSIDE + 0.5), 1),
        (touch(overlap=ALONGSIDE + 0.5, drift=-2.0), 1),
        (touch(overlap=ALONGSIDE - 0.5, drift=-2.0), 0),
        (touch(overlap=ALONGSIDE - 0.5, other_drift=2.0), 1),
        (touch(overlap=ALONGSIDE - 0.5), None),
        (touch(along=2.0, lying=1.0), None),
    ],
)
def test_fault_of_a_contact(contact: dict[str, float], guilty: int | None) -> None:
    """Overlap at turn-in gives the right to room; else the line belongs to who is ahead; who moves across must look."""
    found = at_fault(contact)
    assert (found and found[0]) == guilty


def test_penalties_of_contacts_and_limits() -> None:
    """Touches of a pair within a second are one incident; a fall of the other doubles it; infraction 5 costs."""
    stewards = Stewards()
    assert stewards.contact(1.0, touch(along=2.0))
    assert not stewards.contact(1.5, touch(along=2.0))
    assert stewards.seconds(1) == LONG_LAP
    assert stewards.contact(9.0, touch(along=2.0, thrown=1.0))
    assert stewards.seconds(1) == 3.0 * LONG_LAP
    for number in range(1, 7):
        stewards.off_track(10.0 * number, 0)
        assert stewards.seconds(0) == LONG_LAP * max(0, number - 4)
    assert [penalty.seconds for penalty in stewards.penalties if penalty.row == 0] == [0.0, LONG_LAP, LONG_LAP]
