"""Figures of repeated runs, and the report that shows them."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from bike_analysis.sweeps.report import label_of, report_sweep
from bike_analysis.sweeps.statistics import band, bootstrap, interquartile_mean, paired
from bike_analysis.sweeps.tables import CURVE_COLUMNS, CURVES_TABLE, RUN_COLUMNS, RUNS_TABLE, write_table
from bike_training.cli import main

FINITE = st.floats(-1e6, 1e6)
GROUPS = ("gamma=0.97", "<script>alert(1)</script>")


@settings(max_examples=50)
@given(st.lists(FINITE, min_size=1, max_size=40))
def test_the_interquartile_mean_is_a_mean_of_the_middle(values: list[float]) -> None:
    sample = np.array(values)
    found = float(interquartile_mean(sample))
    low, high = np.quantile(sample, [0.25, 0.75], method="lower")[0], np.quantile(sample, 0.75, method="higher")
    assert low - 1e-6 <= found <= high + 1e-6
    assert interquartile_mean(sample[::-1]) == pytest.approx(found)
    assert interquartile_mean(-3.0 * sample + 2.0) == pytest.approx(-3.0 * found + 2.0, abs=1e-4)
    if len(values) % 4 == 0:
        assert found == pytest.approx(stats.trim_mean(sample, 0.25), abs=1e-6)


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Of means of 30 normal values; a percentile interval of so few is a little too narrow, by about two percent."""
    rng = np.random.default_rng(5)
    held = 0
    for seed in range(200):
        interval = bootstrap(rng.normal(3.0, 2.0, 30), partial(np.mean, axis=-1), seed)
        held += interval.low <= 3.0 <= interval.high
    assert 0.90 <= held / 200 <= 0.97


def test_one_run_has_no_interval_and_none_is_refused() -> None:
    assert bootstrap([4.0]).value == 4.0
    assert np.isnan(bootstrap([4.0]).low)
    for values in ([], [1.0, np.nan]):
        with pytest.raises(ValueError, match="finite values"):
            bootstrap(values)


def test_pairs_are_compared_seed_by_seed() -> None:
    rng = np.random.default_rng(2)
    seeds = rng.normal(0.0, 100.0, 12)  # seeds differ far more than groups do
    first, second = seeds, seeds + rng.normal(1.0, 0.1, 12)
    difference, larger = paired(first, second)
    assert 0.8 < difference.low < difference.value < difference.high < 1.2
    assert larger == 1.0
    back, smaller = paired(second, first)
    assert back.value == pytest.approx(-difference.value)
    assert smaller == 0.0
    with pytest.raises(ValueError, match="same seeds"):
        paired(first, second[1:])


def test_a_band_covers_what_all_curves_know_and_holds_their_last_value() -> None:
    curves = [(np.array([0.0, 10.0, 20.0]), np.array([1.0, 2.0, 3.0])), (np.array([5.0, 15.0]), np.array([1.0, 4.0]))]
    found = band(curves, points=11)
    assert found is not None
    np.testing.assert_array_equal(found.x, np.linspace(5.0, 15.0, 11))
    assert found.value[0] == 1.0
    assert found.value[-1] == 3.0  # the first curve still has its 2, the second its 4
    assert (found.low <= found.value).all()
    assert (found.value <= found.high).all()
    assert band([curves[0], (np.array([30.0]), np.array([0.0]))]) is None


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """A sweep of two groups of five seeds, with a run that failed."""
    rng = np.random.default_rng(1)
    rows, points = [], []
    for place, group in enumerate(GROUPS):
        for seed in range(5):
            run, failed = f"{place}-{seed}", (place, seed) == (1, 4)
            rows.append(
                {"run": run, "digest": run, "task": "train", "group": group, "seed": seed, "entries": "{}"}
                | {"status": "failed" if failed else "finished", "error": "ValueError: <b>" if failed else None}
                | {"figure_finished_at_step": None if failed else 70_000 + 9_000 * place + rng.normal(0, 5_000)}
            )
            points.append((run, group, seed, "selection_rms_m", "step", 70_000 + seed, 0.1))  # no curve of one point
            for step in range(4_000, 80_000, 4_000):
                for quantity, value in (("mean_error_m", 2.0 * np.exp(-step / 2e4)), ("part", 1 + step // 20_000)):
                    points.append((run, group, seed, quantity, "step", step, value * (1 + 0.1 * rng.random())))
    runs = pd.DataFrame(rows).reindex(columns=[*RUN_COLUMNS, "figure_finished_at_step"])
    write_table(runs, tmp_path / RUNS_TABLE)
    write_table(pd.DataFrame(points, columns=list(CURVE_COLUMNS)), tmp_path / CURVES_TABLE)
    return tmp_path


def test_the_report_shows_every_group_and_needs_nothing_from_outside(sweep: Path) -> None:
    report = report_sweep(sweep, sweep / "report")
    page = Path(report["page"]).read_text()
    assert re.findall(r"\]\((.*?)\)", page) == ["curves.png"]
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert "ValueError: &lt;b&gt;" in page
    assert {Path(path).name for path in report["pictures"]} == {"curves.png"}
    assert all(Path(path).read_bytes().startswith(b"\x89PNG") for path in report["pictures"])


def test_units_of_columns_are_their_own() -> None:
    names = ("steer_rate_rms_deg_s", "speed_m_s", "mean_error_m", "finished_at_step")
    assert [label_of(name) for name in names] == [
        "steer rate rms, °/s",
        "speed, m/s",
        "mean error, m",
        "finished at step",
    ]


def test_figures_are_those_of_the_table_and_the_same_each_time(sweep: Path) -> None:
    report = report_sweep(sweep)
    entry = report["groups"][0]
    runs = pd.read_parquet(sweep / RUNS_TABLE)
    values = runs[runs["group"] == GROUPS[0]]["figure_finished_at_step"].to_numpy(float)
    assert (entry["runs"], entry["median"]) == (5, np.median(values))
    assert entry["low"] < entry["iqm"] < entry["high"]
    assert report["groups"][1]["runs"] == 4
    (compared,) = report["comparisons"]
    assert (compared["seeds"], compared["first"]) == (4, GROUPS[0])
    assert report_sweep(sweep) == report
    report_sweep(sweep, sweep / "report")
    written = pd.read_csv(sweep / "report" / "figures.csv")
    np.testing.assert_allclose(written["iqm"], [group["iqm"] for group in report["groups"]], rtol=1e-9)


def test_the_command_is_not_ok_while_a_run_is_missing(sweep: Path, capsys) -> None:
    assert main(["analyze", str(sweep), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert (answer["schema"], answer["ok"], answer["figures"]["finished"]) == ("bike.analyze_sweep/1", False, 9)


def test_duckdb_reads_the_tables(sweep: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    query = f"select status, count(*) from '{sweep / RUNS_TABLE}' group by 1 order by 1"
    assert duckdb.sql(query).fetchall() == [("failed", 1), ("finished", 9)]


@pytest.mark.parametrize(("name", "words"), [(None, "no .mcap file"), ("x", "cannot be read")])
def test_what_is_no_sweep_is_told_in_one_line(name, words: str, tmp_path: Path, capsys) -> None:
    if name:
        for table in (RUNS_TABLE, CURVES_TABLE):
            (tmp_path / table).write_text(name)
    assert main(["analyze", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1
