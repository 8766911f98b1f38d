"""The superbike paper's experiments: verdicts that can go both ways, and the whole way in seconds."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_policy.contract.observation import RACE_LAYOUTS
from bike_sim.course.files import load_track
from bike_training.cli import main
from bike_training.curricula.spdl import TARGET_MEAN, TARGET_STD, Gaussian, divergence
from bike_training.learning.presets import load_preset
from bike_training.reproduce.data import Tables, read_data, table, tables, write_data
from bike_training.reproduce.figures import learning
from bike_training.reproduce.paper import all_tables
from bike_training.reproduce.statement import verdict_table
from bike_training.reproduce.superbike import CURRICULA, SUPERBIKE, SuperbikeExperiment
from bike_training.reproduce.superbike_results import (
    ABLATIONS,
    CIRCUITS,
    KINDS,
    MACHINES,
    PAPER,
    STATEMENTS,
    TABLES,
    best_run,
    circuit_of,
    overshoots,
    setting_of,
)

FOUND = {
    ("spdl", "early"): (0, 92.85, 2.99, 1.74),
    ("sac", "early"): (8, -1.0, 4.59, 9.22),
    ("spdl", "late"): (0, 90.75, 3.15, 1.17),
    ("sac", "late"): (0, 91.32, 2.89, 2.15),
}
"""Falls, lap time, distance to the line and time off the track of Table I."""


def laps(setting: str, seed: int, actor: str) -> tuple[object, ...]:
    """Rides as in the paper, a little different for each seed."""
    kind = setting.partition("_")[0]
    falls, mean, line, outside = FOUND.get((kind, actor), FOUND[kind, "late"])
    if setting == "sac_cremona":
        falls, mean = 0, 89.14
    more = 0.01 * seed
    whole = 8 - falls
    time, line, outside = (round(value + more, 4) for value in (mean, line, outside))
    time = time if whole else -1.0
    return (setting, seed, actor, 1000, 8, whole, falls, 0, 3 * whole, time, time, line, outside)


def paper_like() -> Tables:
    """Tables in which all comes out as in the paper."""
    experiment = SuperbikeExperiment()
    runs, rides, transfers, contexts = [], [], [], []
    for setting, seed in experiment.named():
        if setting.partition("_")[0] not in KINDS:
            continue
        soon = 100_000 if setting.startswith("spdl") else 200_000
        runs.append((setting, seed, "finished", 300_000, soon + 1_000 * seed, 300.0))
        rides += [laps(setting, seed, actor) for actor in ("early", "late", "best")]
        for place, machine in enumerate(MACHINES):
            fell = (setting, machine) == ("spdl_phillip_island", "m1000rr")
            circuit = setting.partition("_")[2] or "barcelona"
            quicker = circuit == "phillip_island" and machine in ("cbr1000rr_r", "r1")
            time = -1.0 if fell else 90.0 + (-1.0 if quicker else 1.0) * place
            transfers.append((setting, seed, circuit, machine, 4, 0 if fell else 4, time, time))
        if setting.startswith("spdl"):
            contexts += [context(setting, seed, number) for number in (1, 2, 3)]
    return tables(
        PAPER,
        runs=runs,
        validations=[("spdl", 0, 10_000, 1, 1.0), ("spdl", 0, 20_000, 1, 0.1)],
        laps=rides,
        transfers=transfers,
        contexts=contexts,
        episodes=[("spdl", 0, step, 200.0, 0.01 * step) for step in (1_000, 2_000)],
        moments=lap_that_runs_wide(),
    )


def context(setting: str, seed: int, number: int) -> tuple[object, ...]:
    kl = 600.0 / 10.0**number
    share = round(0.3 * number, 2)
    figures = (share, round(1.0 - share, 2), 25.0 + 65.0 * share, 0.1, 0.1, 6.0, 0.2, kl, 310.0)
    return (setting, seed, number, 5_000 * number, "towards the target", *figures)


@functools.cache
def lap_that_runs_wide(error: float = 3.0, slow: str = "sac") -> list[tuple[object, ...]]:
    """Laps on the median of Barcelona, so far outside of the ideal line in each corner to the left.

    One setting is slower, most of all in the first third.
    """
    track = load_track("barcelona")
    left = [corner for corner in track.corners if corner.angle > 0.0]
    rows = []
    for k in range(800):
        progress = track.length * k / 800
        inside = any(corner.begin <= progress <= corner.end for corner in left)
        x, y, _ = map(float, track.points(np.array([progress]))[0])
        for kind in KINDS:
            late = min(0.01 * k, 2.0) + 0.0001 * k if kind == slow else 0.0
            beside = -error if inside else 0.0
            rows += [(kind, seed, 0.1 * k + late + 0.01 * seed, progress, x, y, 50.0, beside) for seed in range(5)]
    return rows


def verdicts(data: Tables) -> dict[str, str]:
    """What the rules say, whether or not the test is like the paper's."""
    return {f"{each.source}: {each.paper}": replace(each, unlike=False).find(data).agrees for each in STATEMENTS}


def test_what_is_as_in_the_paper_agrees_and_what_is_not_does_not() -> None:
    data = paper_like()
    assert set(verdicts(data).values()) == {"yes"}
    other = {"spdl": "sac", "sac": "spdl"}

    def swapped(setting: str) -> str:
        kind, _, circuit = setting.partition("_")
        return f"{other[kind]}_{circuit}" if circuit else other[kind]

    runs, rides, transfers, contexts = (data[name] for name in ("runs", "laps", "transfers", "contexts"))
    rides = rides[(rides["whole"] > 0) | (rides["actor"] == "early")]
    changed = data | {
        "runs": runs.assign(setting=runs["setting"].map(swapped)),
        "laps": rides.assign(
            setting=rides["setting"].map(swapped), walls=1, whole=rides["whole"] - (rides["actor"] == "late")
        ),
        "transfers": transfers.assign(whole=transfers["whole"].mask(transfers["machine"].isin(["r1", "zx10rr"]), 0)),
        "moments": table(PAPER, "moments", lap_that_runs_wide(0.5, "spdl")),
        "contexts": contexts.assign(kl=600.0 + contexts["iteration"]),
    }
    found = verdicts(changed)
    # The other machines that are left are slower all the same, and what is missing of two denies nothing.
    assert {paper.partition(": ")[2] for paper, verdict in found.items() if verdict != "no"} == {
        "in Barcelona the other machines are slower, by 0.87 to 2.89 s",
        "the Kawasaki transfers best, 0.87 s slower in Barcelona",
        "Honda and Yamaha lap Phillip Island faster than the trained machine",
    }
    quick = data | {"transfers": transfers.assign(best=transfers["best"].mask(transfers["machine"] == "r1", 80.0))}
    assert "no" in verdicts(quick).values()
    # A test that is unlike the paper's in a way that could cause it denies nothing.
    kept = {each.paper for each in STATEMENTS if each.find(changed).agrees == "no"}
    assert kept == {"SPDL moves the distribution towards the ideal line at full speed"}


def test_a_flying_lap_is_behind_the_start_line() -> None:
    """Its progress goes on from the lap before."""
    data, length = paper_like(), load_track("barcelona").length
    later = data | {"moments": data["moments"].assign(progress=lambda rows: rows["progress"] + length)}
    assert overshoots(later, "spdl") == overshoots(data, "spdl")
    assert max(overshoots(data, "spdl").values()) == 3.0


def test_nothing_is_said_of_what_was_not_done() -> None:
    assert set(verdicts(tables(PAPER)).values()) == {"open"}
    few = paper_like()
    few |= {"laps": few["laps"][few["laps"]["seed"] < 2], "runs": few["runs"][:12]}
    found = verdicts(few)
    assert found["Sect. VI-B: SPDL converges faster than SAC"] == "open"
    assert found["Table I, late: SPDL laps faster, 1:30.75 against 1:31.32"] == "open"
    assert found["Table I, early: SPDL finishes all laps without a fall"] == "open"


def test_a_run_without_a_whole_validation_counts_as_late() -> None:
    data = paper_like()
    data["runs"].loc[data["runs"]["setting"] == "spdl", "finished_at"] = -1
    assert verdicts(data)["Sect. VI-B: SPDL converges faster than SAC"] == "no"


def test_the_best_run_is_whole_first_and_quick_second() -> None:
    data = paper_like()
    assert best_run(data, "spdl") == 0
    data["laps"].loc[(data["laps"]["seed"] == 0) & (data["laps"]["actor"] == "best"), "whole"] = 7
    assert best_run(data, "spdl") == 1
    assert best_run(tables(PAPER), "spdl") is None


def test_outside_is_to_the_right_of_a_corner_to_the_left() -> None:
    found = overshoots(paper_like(), "spdl")
    corners = {corner.name: corner for corner in load_track("barcelona").corners}
    assert all(found[name] == (3.0 if corner.angle > 0.0 else 0.0) for name, corner in corners.items() if name in found)
    assert {corners[name].direction for name in found} == {"left", "right"}


def test_both_settings_differ_in_their_curriculum_alone() -> None:
    pairs = tuple(setting_of(kind, circuit) for circuit in CIRCUITS for kind in KINDS)
    experiment = SuperbikeExperiment(seeds=(0, 1), settings=pairs, steps=9_500_000)
    runs = [run.job().settings for run in experiment.sweep().runs]  # type: ignore[attr-defined]
    assert len(runs) == 2 * 2 * len(CIRCUITS)
    for spdl, sac in zip(runs[::2], runs[1::2], strict=True):
        assert spdl.preset.task == sac.preset.task == load_preset("race_direct").task
        assert (spdl.preset.curriculum.curriculum, sac.preset.curriculum.curriculum) == ("spdl", "target")
        mine, other = (preset.to_plain()["curriculum"] for preset in (spdl.preset, sac.preset))
        assert {name for name in mine if mine[name] != other.get(name)} == {"curriculum", "threshold", "kl"}
        assert set(other) < set(mine)
        assert replace(spdl, preset=sac.preset) == sac
        assert (spdl.compiled, spdl.keep_every) == (True, experiment.early)
        assert mine["iteration"] == other["iteration"] == 5_000  # decisions, as published, of a run of any length
    assert [run.seed for run in runs] == [0] * 6 + [1] * 6


def test_who_always_starts_at_the_line_has_time_for_a_slow_lap() -> None:
    """In shorter episodes the rest of the lap, on which actors are judged, is never seen."""
    kinds = [kind for kind in CURRICULA if kind.startswith(("plain", "published"))]
    for run in SuperbikeExperiment(seeds=(0,), settings=tuple(kinds)).sweep().runs:
        preset = run.job().settings.preset  # type: ignore[attr-defined]
        assert preset.curriculum.start_line
        assert preset.task.max_steps * preset.task.repeat * 0.02 > 1.3 * 102.0


def test_ablations_are_sac_with_one_thing_changed() -> None:
    experiment = SuperbikeExperiment(seeds=(0,))
    runs = [run.job().settings.preset for run in experiment.sweep().runs]  # type: ignore[attr-defined]
    presets = dict(zip(experiment.settings, runs, strict=True))
    sac = presets["sac"].to_plain()
    changed = {
        name: {
            f"{place}.{key}"
            for place in ("task", "curriculum", "learner")
            for key, value in presets[name].to_plain()[place].items()
            if sac[place].get(key) != value
        }
        for name in ABLATIONS
    }
    assert list(changed.values()) == [
        {"task.weights"},
        {"task.weights"},
        {"task.observation"},
        {"task.observation"},
        {"task.observation"},
        {"curriculum.failure_share"},
        {"learner.mirror"},
    ]
    assert presets["stages"].curriculum == replace(presets["schedule"].curriculum, stages=4)


def test_the_points_ahead_stand_in_for_the_plan_alone() -> None:
    points, compact = (set(RACE_LAYOUTS[name].terms) for name in ("points_ahead", "compact"))
    assert compact - points == {"speed_margin", "stations"}
    assert points - compact == {"course_points"}


def test_an_ablation_stands_beside_sac_and_a_curriculum_beside_the_schedule() -> None:
    names = ("sac", "schedule", "no-mirror")
    runs = [(name, seed) for name in names for seed in range(5)]
    data = tables(
        PAPER,
        runs=[(*run, "finished", 300_000, -1, 300.0) for run in runs],
        validations=[(*run, 10_000, 1, 1.0 if run[0] == "no-mirror" else 0.1) for run in runs],
        laps=[(*run, *laps("sac", run[1], "late")[2:]) for run in runs],
    )
    same = "100 (100 to 100) | +0 to +0 | 100 (100 to 100) | +0 to +0"
    base = "100 (100 to 100) | | 100 (100 to 100) |"
    none = "0 (0 to 0) | -100 to -100 | 100 (100 to 100) | +0 to +0"
    expected = {"Ablations": {"sac": base, "no-mirror": none}, "Curricula": {"sac": same, "schedule": base}}
    for table_name, rows in expected.items():
        text = TABLES[f"{table_name}: Panigale, Barcelona"](data)
        assert [line.rpartition(" | ")[0] for line in text.strip().splitlines()[2:]] == [
            f"| {name} | 5 | {cells}" for name, cells in rows.items()
        ]


def test_who_rides_no_episode_to_its_end_is_judged_by_the_last_episodes() -> None:
    names = ("plain-spdl", "plain-sac")
    runs = [(name, seed) for name in names for seed in range(5)]
    far = {"plain-spdl": (1_500.0, 1_000.0), "plain-sac": (250.0, 400.0)}
    data = tables(
        PAPER,
        runs=[(*run, "finished", 2_000, -1, 300.0) for run in runs],
        episodes=[
            (*run, step, *(far[run[0]] if step == 2_000 else (10.0, 5.0))) for run in runs for step in (9, 2_000)
        ],
        laps=[(*run, *laps("sac", run[1], "late")[2:]) for run in runs],
    )
    spdl, sac = TABLES["Without a plan: Panigale, Barcelona"](data).strip().splitlines()[2:]
    assert "| 1000 (1000 to 1000) | +600 to +600 | 1500 (1500 to 1500) | +1250 to +1250 |" in spdl
    assert "| 400 (400 to 400) | | 250 (250 to 250) | |" in sac


def test_tables_come_back_and_are_drawn_without_learning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, folder = paper_like(), tmp_path / "data"
    folder.mkdir()
    write_data(PAPER, folder, data)
    back = read_data(PAPER, folder)
    assert all(back[name].equals(data[name]) for name in ("runs", "laps", "contexts"))
    assert main(["reproduce", "superbike", "--out", str(tmp_path / "drawn"), "--data", str(folder), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["statements"] == {"yes": len(STATEMENTS), "no": 0, "open": 0}
    assert len(figures["files"]) == 4
    assert all(Path(path).stat().st_size > 5_000 for path in figures["files"])
    text = (tmp_path / "drawn" / "tables.md").read_text()
    assert "| rides whole | 40 of 40 | 0 of 40 | 40 of 40 | 40 of 40 | 40 of 40 | 40 of 40 |" in text
    assert "| | found | 1:34.000 (4 of 4) | 1:34.000 (4 of 4) | - (0 of 4) |" in text
    assert verdict_table(STATEMENTS, data) == (tmp_path / "drawn" / "statements.md").read_text()
    assert all_tables(SUPERBIKE, data) == text


def test_learning_is_drawn_for_each_circuit_that_was_learned_on() -> None:
    from matplotlib import pyplot as plt

    episodes = [("sac_cremona", 1, step, 200.0, 0.01 * step) for step in (1_000, 2_000)]
    whole, nothing = paper_like() | {"episodes": table(PAPER, "episodes", episodes)}, tables(PAPER)
    cremona = whole | {"runs": whole["runs"][whole["runs"]["setting"].map(circuit_of) == "cremona"]}
    for data, circuits in ((whole, list(CIRCUITS)), (cremona, ["cremona"]), (nothing, ["barcelona"])):
        figure = learning(data, plt)
        top = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
        assert list(top) == circuits
        lines = [(circuit, list(line.get_xdata())) for circuit, axes in top.items() for line in axes.lines]
        assert (("cremona", [1_000, 2_000]) in lines) == (data is not nothing)
        assert sum(steps == [1_000, 2_000] for _, steps in lines) <= 1
        plt.close(figure)


def test_a_setting_that_the_paper_does_not_have_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "superbike", "--out", str(tmp_path), "--settings", "prop"]) == 2
    assert "--settings prop: the superbike paper has spdl, sac, " in capsys.readouterr().err


@pytest.mark.long
def test_the_whole_way_and_again(tmp_path: Path, whole_way) -> None:
    words = ["reproduce", "superbike", "--out", str(tmp_path), "--quick", "--cores", "1", "--json"]
    figures = whole_way(words)
    assert (figures["runs"], figures["runs_finished"], figures["rides"]) == (2, 2, 12)
    data = read_data(PAPER, tmp_path / "data")
    assert set(data["laps"][["setting", "actor"]].itertuples(index=False, name=None)) == {
        (setting, actor) for setting in ("spdl", "sac") for actor in ("early", "late", "best")
    }
    assert set(data["laps"][data["laps"]["actor"] == "early"]["step"]) == {244}
    assert set(data["transfers"]["machine"]) == {"panigale_v4r", "r1"}
    contexts = dict(list(data["contexts"].groupby("setting")))
    assert set(contexts) == {"spdl", "sac"}
    assert contexts["sac"]["kl"].max() < 1e-6  # SAC draws from the target all along
    last = contexts["spdl"].loc[contexts["spdl"]["iteration"].idxmax()]
    assert last.stage == "waits for the agent"  # who has learned nothing
    # What is written is the divergence of the distribution that is written.
    mean = [last.d_median, last.d_ideal, (last.v_max - 25.0) / 65.0]
    std = [last.std_d_median, last.std_d_ideal, last.std_v_max / 65.0]
    target = Gaussian.with_std(TARGET_MEAN, TARGET_STD)
    assert last.kl == pytest.approx(divergence(Gaussian.with_std(mean, std), target), rel=0.02)
    assert math.isfinite(last.value)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/*.csv")}
    assert main(words) == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/*.csv")} == before
    again = read_data(PAPER, tmp_path / "data")
    assert again.keys() == data.keys()
    assert all(again[name].equals(rows) for name, rows in data.items())
