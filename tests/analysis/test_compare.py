"""Comparisons of rides at known speeds: times and sectors follow from v and s."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bike_analysis import compare, open_ride
from bike_analysis.figures.compare import Comparison, CourseError
from bike_analysis.figures.recorded import folder_prefixes
from bike_analysis.report import analyze, write_table

LENGTH = 20.0 * np.pi


@pytest.fixture(scope="module")
def slow(writer, circle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return writer.write(tmp_path_factory.mktemp("slow") / "ride.mcap", [circle(steps=400, speed=4.0)])


@pytest.fixture(scope="module")
def fast(writer, circle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return writer.write(tmp_path_factory.mktemp("fast") / "ride.mcap", [circle(steps=400, speed=5.0, offset=-0.1)])


def test_files_of_one_name_are_told_apart_by_their_folders(slow: Path) -> None:
    assert folder_prefixes([Path("a/x.mcap"), Path("b/x.mcap"), Path("a/y.mcap")]) == ["a/", "b/", ""]
    assert folder_prefixes([Path("a/1/x.mcap"), Path("b/1/x.mcap")]) == ["a/1/", "b/1/"]
    assert folder_prefixes([Path("/x.mcap"), Path("/b/x.mcap")]) == ["/", "b/"]
    assert folder_prefixes([Path("a/x.mcap")] * 2) == ["", ""]
    assert [run.label for run in compare([slow, slow]).runs] == ["ride, lap 1", "ride, lap 1 (2)"]


def test_riders_name_the_runs_where_each_recording_has_its_own(writer, circle, tmp_path: Path) -> None:
    def ridden(name: str, policy: str) -> Path:
        notes = {"policy": policy} if policy else {}
        return writer.write(tmp_path / f"{name}.mcap", [circle(steps=400)], notes=notes, metadata_file=False)

    first, second, again, unknown = ridden("a", "lqr"), ridden("b", "mpc"), ridden("c", "lqr"), ridden("d", "")
    assert [run.label for run in compare([first, second]).runs] == ["lqr, lap 1", "mpc, lap 1"]
    assert [run.label for run in compare([first, again]).runs] == ["a, lap 1", "c, lap 1"]
    assert [run.label for run in compare([first, unknown]).runs] == ["a, lap 1", "d, lap 1"]
    assert [run.label for run in compare([first, first]).runs] == ["a, lap 1", "a, lap 1 (2)"]


@given(
    paths=st.lists(st.lists(st.sampled_from("abc"), min_size=1, max_size=4).map(lambda parts: Path(*parts)), min_size=1)
)
def test_prefixes_tell_all_files_apart(paths: list[Path]) -> None:
    named = {path: prefix + path.name for path, prefix in zip(paths, folder_prefixes(paths), strict=True)}
    assert len(set(named.values())) == len(named)
    assert all(str(path.resolve()).endswith(name) for path, name in named.items())


def test_prefixes_of_many_rides_are_worked_out_once_a_file(slow: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, resolve = [], Path.resolve

    def counted(path: Path) -> Path:
        asked.append(path)
        return resolve(path)

    monkeypatch.setattr(Path, "resolve", counted)
    assert folder_prefixes([slow, Path("other/ride.mcap")] * 500) == [f"{slow.parent.name}/", "other/"] * 500
    assert len(asked) == 2


def test_time_lost_grows_with_the_way(slow: Path, fast: Path) -> None:
    both = compare([slow, fast])
    assert [run.label for run in both.runs] == [f"{path.parent.name}/ride, lap 1" for path in (slow, fast)]
    assert both.reference == 1
    s = both.station_m
    known = np.isfinite(both.column("time_s")).all(axis=0)
    assert known[s < LENGTH - 0.5].all()
    np.testing.assert_allclose(both.column("delta_s")[0][known], s[known] * (1 / 4 - 1 / 5), atol=1e-9)
    np.testing.assert_array_equal(both.column("delta_s")[1][known], 0.0)
    np.testing.assert_allclose(both.column("speed_m_s")[:, known], np.array([[4.0], [5.0]]) * np.ones(known.sum()))
    with pytest.raises(KeyError, match="nothing"):
        both.column("nothing")


def test_best_sectors_make_the_theoretical_lap(writer, circle, tmp_path: Path) -> None:
    """One is fast in the first half, the other in the second; together they would be faster than both."""
    paths = []
    for name, speeds in (("a", (5.0, 4.0)), ("b", (3.0, 6.0))):
        ride = circle(steps=400)
        times = np.array([0.0, 0.5 * LENGTH / speeds[0], 0.5 * LENGTH * (1 / speeds[0] + 1 / speeds[1]), 1000.0])
        places = np.array([0.0, 0.5 * LENGTH, LENGTH, LENGTH + 4.0 * (1000.0 - times[2])])
        ride.states["progress"] = np.interp(0.05 * np.arange(400), times, places)
        paths.append(writer.write(tmp_path / f"{name}.mcap", [ride], metadata_file=False))
    both = compare(paths)
    half = 0.5 * LENGTH
    assert [s.times_s for s in both.sectors] == [
        pytest.approx((half / 5, half / 3), abs=0.02),  # the step in speed lies within a control period
        pytest.approx((half / 4, half / 6), abs=0.02),
    ]
    assert [s.best_run for s in both.sectors] == [run.label for run in both.runs]
    assert both.best_sectors_s == pytest.approx(half / 5 + half / 6, abs=0.02)
    assert both.best_sectors_s < min(run.duration_s for run in both.runs)


def test_open_rides_are_compared_by_their_sections(writer, circle, tmp_path: Path) -> None:
    paths = []
    for name, speed in (("a", 3.0), ("b", 3.5)):
        ride = circle(steps=450, speed=speed)
        ride.states["course_closed"] = np.full(450, False)
        ride.course["closed"] = False
        paths.append(writer.write(tmp_path / f"{name}.mcap", [ride], metadata_file=False))
    both = compare(paths)
    assert [run.lap for run in both.runs] == [None, None]
    first, second = both.sectors
    assert first.times_s == pytest.approx((0.5 * LENGTH / 3.0, 0.5 * LENGTH / 3.5), rel=1e-2)
    assert second.best_run == both.runs[1].label


@pytest.mark.parametrize("late", [0, 1, 100])
def test_a_ride_recorded_late_wins_nothing(writer, circle, tmp_path: Path, late: int) -> None:
    """The same open ride twice; the second recorder missed the first states. Times count from the reset."""
    paths = []
    for name, missed in (("late", range(late)), ("whole", range(0))):
        ride = circle(steps=320, skip_steps=frozenset(missed))
        ride.states |= {"course_closed": np.full(320, False), "finished": np.arange(320) >= 315}
        s = np.linspace(0.0, LENGTH, 629)
        x, y = 10.0 * np.sin(s / 10.0), 10.0 * (1.0 - np.cos(s / 10.0))
        ride.course |= {"closed": False, "s": s, "x": x, "y": y, "curvature": np.full(629, 0.1)}
        paths.append(writer.write(tmp_path / f"{name}.mcap", [ride], metadata_file=False))
    both = compare(paths)
    assert [run.complete for run in both.runs] == [late == 0, True]
    assert [run.duration_s for run in both.runs] == pytest.approx([LENGTH / 4.0] * 2, abs=0.01)
    assert both.runs[both.reference].label == ("whole" if late else "late")
    lost = both.column("delta_s")
    known = np.isfinite(lost)
    np.testing.assert_allclose(lost[known], 0.0, atol=1e-9)
    assert known[0, -1]
    assert known[0].sum() == pytest.approx(known[1].sum() * (1 - late / 314), rel=0.01)
    assert np.nanmin(both.column("time_s")[0]) == pytest.approx(0.05 * late)


def test_rides_without_a_course_are_not_stretched_onto_each_other(writer, circle, tmp_path: Path) -> None:
    """One goes four times as far as the other at the same speed: where both were, nothing was lost."""
    paths = []
    for name, steps in (("short", 101), ("long", 401)):
        ride = circle(steps=steps)
        ride.states |= {"course_closed": np.full(steps, False), "progress": np.full(steps, np.nan)}
        ride.states["course_length"] = np.full(steps, np.nan)
        paths.append(writer.write(tmp_path / f"{name}.mcap", [ride], topics=["/bike/state"], metadata_file=False))
    both = compare(paths)
    assert both.scales == (1.0, 1.0)
    known = np.isfinite(both.column("delta_s")[0])
    assert known.sum() == pytest.approx(0.25 * len(known), abs=2)
    np.testing.assert_allclose(both.column("delta_s")[0][known], 0.0, atol=1e-9)


def test_rides_that_begin_with_unknown_numbers_are_compared_in_silence(
    writer, circle, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    ride = circle(steps=320)
    for name in ("progress", "x", "y", "speed", "lateral_error", "course_length"):
        ride.states[name][:20] = np.nan
    both = compare([writer.write(tmp_path / f"{n}.mcap", [ride], metadata_file=False) for n in "ab"])
    assert np.isfinite(both.column("delta_s")).any()
    assert [str(warning.message) for warning in recwarn] == []


@settings(max_examples=6)
@given(order=st.permutations([0, 1, 2]), station=st.floats(0.05, 20.0))
def test_order_does_not_matter(writer, circle, tmp_path_factory, order: list[int], station: float) -> None:
    """The same runs in any order, at any distance of stations: the same times at the same places, 0 for the fastest."""
    folder = tmp_path_factory.mktemp("order")
    speeds = (4.0, 4.4, 5.1)
    paths = [
        writer.write(folder / f"r{k}.mcap", [circle(steps=350, speed=v)], metadata_file=False)
        for k, v in enumerate(speeds)
    ]
    found = compare([paths[k] for k in order], station_m=station)
    assert found.runs[found.reference].ride.states.speed[0] == 5.1
    for place, k in enumerate(order):
        delta = found.column("delta_s")[place]
        known = np.isfinite(delta)
        wanted = found.station_m[known] * (1 / speeds[k] - 1 / 5.1)
        np.testing.assert_allclose(delta[known], wanted, atol=1e-9)


def test_courses_that_differ_are_refused(writer, circle, slow: Path, tmp_path: Path) -> None:
    other = writer.write(tmp_path / "other.mcap", [circle(steps=700, radius=14.0)])
    with pytest.raises(CourseError, match=r"different courses .*lap 1: 63 m, other, lap 1: 88 m"):
        compare([slow, other])
    nameless = [circle(steps=500, radius=r) for r in (10.0, 14.0)]
    paths = [
        writer.write(tmp_path / f"{k}.mcap", [ride], topics=["/bike/state"], metadata_file=False)
        for k, ride in enumerate(nameless)
    ]
    with pytest.raises(CourseError, match="different courses"):
        compare(paths)
    with pytest.raises(ValueError, match="nothing to compare"):
        compare([])
    for station in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="positive"):
            compare([slow], station_m=station)


def test_the_fastest_are_kept(writer, circle, tmp_path: Path) -> None:
    rides = [circle(steps=400, speed=4.0 + 0.1 * n, episode=n + 1, start_s=1.0 + 30.0 * n) for n in range(5)]
    all_of_them = compare([writer.write(tmp_path / "ride.mcap", rides)])
    kept = all_of_them.fastest(2)
    assert [run.ride.index for run in kept.runs] == [4, 5]
    assert kept.runs[kept.reference].ride.index == 5
    np.testing.assert_array_equal(kept.column("delta_s")[0], all_of_them.column("delta_s")[3])
    assert kept.sectors[0].times_s == all_of_them.sectors[0].times_s[3:]
    assert all_of_them.fastest(9) is all_of_them


def test_motion_is_put_on_stations_only_for_a_table(writer, circle, tmp_path: Path, monkeypatch) -> None:
    """A thousand rides would need gigabytes; figures and page need the times alone."""
    rides = [circle(steps=320, speed=4.0 + 0.1 * n, episode=n + 1, start_s=1.0 + 30.0 * n) for n in range(3)]
    path = writer.write(tmp_path / "ride.mcap", rides)
    lost = compare([path]).column("delta_s")
    asked = []
    monkeypatch.setattr(Comparison, "values", property(lambda comparison: asked.append(comparison)))
    runs = analyze(path, tmp_path / "out")["comparisons"][0]["runs"]
    assert asked == []
    assert [run["delta_s"] for run in runs] == [row[np.isfinite(row)][-1] for row in lost]


def test_tables_of_rides_and_laps(slow: Path) -> None:
    ride = open_ride(slow).rides[0]
    table, lap = ride.table(), ride.laps[0].table()
    assert len(table) == 400
    assert table.time_s.iloc[-1] == pytest.approx(399 * 0.05)
    assert table.distance_m.is_monotonic_increasing
    assert set(table[table.lap == 1].section) == {"first half", "second half"}
    assert lap.time_s.iloc[0] >= 0.0
    assert lap.time_s.iloc[-1] <= ride.laps[0].duration_s
    assert len(lap) == (table.lap == 1).sum()
    np.testing.assert_allclose(table.station_m, np.mod(table.progress_m, LENGTH))
    assert set(table.command_age_steps.dropna()) == {0.0}


def test_exports_hold_the_aligned_table(slow: Path, fast: Path, tmp_path: Path) -> None:
    both = compare([slow, fast])
    csv, parquet = tmp_path / "new" / "t.csv", tmp_path / "new" / "t.parquet"
    one = pd.read_parquet(write_table([both], parquet, parquet=True))
    assert list(one.columns[:8]) == ["course", "run", "source", "ride", "lap", "station_m", "time_s", "delta_s"]
    pd.testing.assert_frame_equal(
        one[one.columns[1:]], both.table, check_categorical=False, check_dtype=False, check_names=False
    )
    read = pd.read_csv(write_table([both, both], csv))
    assert list(read.columns) == list(one.columns)
    np.testing.assert_allclose(read.time_s[len(one) :], one.time_s, rtol=1e-9, atol=1e-12)
    assert read.run.tolist() == 2 * one.run.tolist()
