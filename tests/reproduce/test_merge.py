"""Results of several places: seeds that were shared out come together as if one place had done them all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_training.arguments import seeds_of
from bike_training.cli import main
from bike_training.reproduce.bicycle import BICYCLE, SETTINGS, BicycleExperiment
from bike_training.reproduce.bicycle_results import (
    Chance,
    Data,
    Direction,
    Impact,
    Instant,
    Rides,
    SteeringStep,
    Track,
    controller_1,
)
from bike_training.reproduce.data import Run, Validation, read_data, write_data
from bike_training.reproduce.paper import merge
from bike_training.reproduce.statement import verdict_table

Ended = Mapping[tuple[str, int], tuple[bool, float] | None]
"""Of each run: whether its controller rode to the end, and its largest distance, m; None where it has none."""


def tables(runs: Ended) -> Data:
    """Return what one place leaves that has done these runs; what it looks at closely tells the seed that it chose."""
    order = sorted(runs, key=lambda run: (run[1], SETTINGS.index(run[0])))
    rides = [
        Rides(name, seed, course, speed, found[0], 0.1, found[1] + (0.0 if course == "benchmark" else 9.0))
        for name, seed in order
        if (found := runs[name, seed]) is not None
        for course in ("benchmark", "random")
        for speed in (2.0, 7.0)
    ]
    data = Data(
        tuple(Run(name, seed, "finished", 1000, 900 if runs[name, seed] else -1, 10.0) for name, seed in order),
        tuple(Validation(name, seed, step, 1, 0.5) for name, seed in order for step in (100, 200)),
        tuple(rides),
        directions=(Direction(0.0, 60.0, 58.8, 58.8, 58.8, 58.79),),
        steering=(SteeringStep(0.01, 7.0, 7.0),),
        chances=(Chance(10_000, 120.0, 22),),
    )
    best = {name: seed for name in ("prop", "alt3") if (seed := controller_1(data, name)) is not None}
    tracks = [*best.items(), ("stanley", -1), ("lqr", -1)]
    seen = [(name, seed) for name, seed in best.items() if name == "prop"] + [("whipple", -1)]
    return replace(
        data,
        tracks=tuple(Track(name, 0.0, float(seed), 0.0, 0.0, 0.0, 0.0, 0.0, True) for name, seed in tracks),
        ride=(Instant(float(best["prop"]), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),) if "prop" in best else (),
        impacts=tuple(Impact(name, 0, "roll", float(seed), 0.1) for name, seed in seen),
    )


outcomes = st.none() | st.tuples(st.booleans(), st.floats(0.1, 2.0).map(lambda value: round(value, 2)))
shared_out = st.dictionaries(
    st.tuples(st.sampled_from(SETTINGS), st.integers(0, 4)), st.tuples(outcomes, st.integers(0, 2)), min_size=1
)


@given(shared_out)
def test_runs_that_were_shared_out_come_together_as_if_one_place_had_done_them(
    runs: dict[tuple[str, int], tuple[tuple[bool, float] | None, int]],
) -> None:
    whole = {run: found for run, (found, _) in runs.items()}
    places = sorted({place for _, place in runs.values()})
    parts = {str(place): tables({run: found for run, (found, at) in runs.items() if at == place}) for place in places}
    assert merge(BICYCLE, parts) == tables(whole)


@given(shared_out)
def test_the_order_of_the_places_does_not_matter(
    runs: dict[tuple[str, int], tuple[tuple[bool, float] | None, int]],
) -> None:
    parts = {
        str(place): tables({run: found for run, (found, at) in runs.items() if at == place})
        for place in sorted({place for _, place in runs.values()})
    }
    assert merge(BICYCLE, parts) == merge(BICYCLE, dict(reversed(parts.items())))


@given(st.integers(1, 20), st.integers(0, 20), st.integers(0, 20))
def test_seeds_are_a_number_of_them_or_a_range(count: int, first: int, more: int) -> None:
    assert seeds_of("--seeds", str(count)) == tuple(range(count))
    assert seeds_of("--seeds", f"{first}-{first + more}") == tuple(range(first, first + more + 1))
    with pytest.raises(ValueError, match=rf"--seeds {first + more + 1}-{first} holds no seed"):
        seeds_of("--seeds", f"{first + more + 1}-{first}")


def test_a_sweep_has_the_runs_of_its_seeds() -> None:
    runs = BicycleExperiment(settings=("prop", "alt2"), seeds=(2, 4)).sweep().runs
    found = [(run.entries["preset"], run.entries["seed"]) for run in runs]
    assert found == [("paper", 2), ("alt2", 2), ("paper", 4), ("alt2", 4)]


@pytest.mark.parametrize("text", ["", "0", "-1", "2-", "1.5", "two", "1-2-3", "²"])
def test_what_is_no_number_of_seeds_is_refused_by_name(text: str) -> None:
    with pytest.raises(ValueError, match=r"^--seeds"):
        seeds_of("--seeds", text)


def left(folder: Path, data: Data) -> str:
    """Leave tables in a folder, and return its name."""
    folder.mkdir()
    write_data(folder, data)
    return str(folder)


def test_folders_are_drawn_together_and_left_as_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shipped = read_data(Path(__file__).parents[2] / "docs" / "data" / "bicycle_paper", Data)
    seeds = sorted({run.seed for run in shipped.runs})
    assert len(seeds) > 1

    def some(chosen: list[int]) -> Data:
        runs, validations, rides = (
            tuple(row for row in rows if row.seed in chosen)
            for rows in (shipped.runs, shipped.validations, shipped.rides)
        )
        return replace(shipped, runs=runs, validations=validations, rides=rides)

    folders = [left(tmp_path / "late", some(seeds[1:])), left(tmp_path / "early", some(seeds[:1]))]
    words = ["reproduce", "bicycle", "--out", str(tmp_path / "all"), "--data", *folders, "--json"]
    assert main(words) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert (figures["runs"], figures["rides"]) == (len(shipped.runs), len(shipped.rides))
    assert read_data(tmp_path / "all" / "data", Data) == shipped
    assert (tmp_path / "all" / "statements.md").read_text(encoding="utf-8") == verdict_table(
        BICYCLE.statements, shipped
    )
    assert (tmp_path / "all" / "fig11.png").stat().st_size > 5_000


def test_what_cannot_be_put_together_is_told_in_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = left(tmp_path / "one", tables({("prop", 0): (True, 0.9), ("alt3", 1): None}))
    two = left(tmp_path / "two", tables({("alt3", 1): None, ("prop", 3): None}))
    (tmp_path / "out").mkdir()
    three = left(tmp_path / "out" / "data", tables({("prop", 4): None}))
    command = ["reproduce", "bicycle", "--out", str(tmp_path / "out"), "--data"]
    for words, complaint in (
        ([one, two], f"{one} and {two} both have seed 1 of alt3; a run may be in one of them"),
        ([one, one], f"{one} is named twice"),
        ([one, three], f"--out {tmp_path / 'out'} would write over the tables of --data {three}"),
        ([one, "--seeds", "2-4"], "--seeds is for learning"),
        ([one, str(tmp_path / "none")], "none"),
    ):
        assert main(command + words) == 2
        assert complaint in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*.png"))
