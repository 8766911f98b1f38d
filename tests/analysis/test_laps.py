"""Laps, sectors and time beyond the limits of rides whose motion is known in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bike_analysis import compare, open_ride
from bike_analysis.figures.circuit import Theory
from bike_analysis.figures.laps import time_outside
from bike_analysis.figures.numbers import best_sectors_together, lap_text
from bike_analysis.page.ride_page import time_table
from bike_analysis.report import analyze, analyze_laps
from bike_sim.course.course import Course
from bike_sim.course.elements import Arc
from bike_sim.course.track import Track
from bike_training.commands.analyze import text_of

LENGTH = 20.0 * np.pi


@pytest.fixture
def ride_of(writer, tmp_path: Path):
    def make(ride, **options):
        return open_ride(writer.write(tmp_path / "ride.mcap", [ride], overwrite=True, **options)).rides[0]

    return make


@pytest.mark.parametrize("speed", [4.0, 3.37, 11.1])
def test_lap_times_are_interpolated_below_the_step(ride_of, circle, speed: float) -> None:
    ride = ride_of(circle(steps=1000, speed=speed))
    assert len(ride.laps) == int(speed * 0.05 * 999 / LENGTH)
    for number, lap in enumerate(ride.laps):
        assert lap.duration_s == pytest.approx(LENGTH / speed, abs=1e-9)
        assert lap.begin_s == pytest.approx(number * LENGTH / speed, abs=1e-9)
        assert lap.sectors_s == pytest.approx((0.5 * LENGTH / speed,) * 2, abs=1e-9)
    assert ride.best_lap.duration_s == ride.figures.best_lap_s == min(lap.duration_s for lap in ride.laps)


@given(start=st.floats(-3.0, 200.0), noise=st.floats(0.0, 0.3), seed=st.integers(0, 99))
def test_lines_count_once_and_only_whole_laps(
    writer, circle, tmp_path_factory: pytest.TempPathFactory, start: float, noise: float, seed: int
) -> None:
    """A ride that begins anywhere and goes back and forth a little: a lap for each two lines, each beginning on one."""
    ride = circle(steps=600)
    shake = noise * np.random.default_rng(seed).normal(size=600)
    progress = start + ride.states["progress"] + shake
    ride.states["progress"] = progress
    found = open_ride(writer.write(tmp_path_factory.mktemp("laps") / "ride.mcap", [ride])).rides[0]
    farthest = np.maximum.accumulate(progress)
    lines = np.arange(-1, 20) * LENGTH
    near = (lines >= progress[0] - 0.05) & (lines <= farthest[-1])
    assert len(found.laps) == max(int(near.sum()) - 1, 0)
    for lap, begin in zip(found.laps, lines[near], strict=False):
        assert lap.begin_m == pytest.approx(begin)
        assert sum(lap.sectors_s) == pytest.approx(lap.duration_s)


def test_recorded_events_are_preferred(ride_of, circle) -> None:
    """The timing's own times are told, though the states say a little else."""
    lap_s, half_s = LENGTH / 4.0, 0.5 * LENGTH / 4.0
    kinds = [(6, half_s + 0.001, half_s + 0.001), (6, lap_s + 0.003, half_s + 0.002), (4, lap_s + 0.003, lap_s + 0.003)]
    events = [
        {"step": int(time / 0.05) + 1, "kind": kind, "time": time, "progress": time * 4.0, "value": value}
        for kind, time, value in kinds
    ]
    first, second = ride_of(circle(steps=800, events=events)).laps
    assert first.from_events
    assert first.duration_s == lap_s + 0.003
    assert first.sectors_s == (half_s + 0.001, half_s + 0.002)
    assert not second.from_events
    assert second.duration_s == pytest.approx(lap_s)


def test_no_laps_on_an_open_course_or_without_progress(ride_of, circle) -> None:
    ride = circle(steps=500)
    ride.states["course_closed"] = np.full(500, False)
    assert ride_of(ride).laps == ()
    ride = circle(steps=500)
    ride.states["progress"] = np.full(500, np.nan)
    assert ride_of(ride).laps == ()


def test_an_unknown_number_in_the_last_state_takes_no_lap_away(ride_of, circle) -> None:
    ride = circle(steps=700)
    whole = ride_of(ride)
    for name in ("course_length", "progress", "x", "y", "speed", "lateral_error"):
        ride.states[name][-1] = np.nan
    found = ride_of(ride)
    assert [lap.duration_s for lap in found.laps] == [lap.duration_s for lap in whole.laps]
    assert len(found.laps) == found.figures.laps == whole.figures.laps == 2
    np.testing.assert_array_equal(found.table().station_m[:-1], whole.table().station_m[:-1])
    assert len(compare([found]).station_m) == len(compare([whole]).station_m)


@pytest.mark.parametrize("length", [1e-3, 0.0, -60.0, np.nan])
def test_a_length_that_no_course_has_is_unknown(ride_of, circle, length: float) -> None:
    ride = circle(steps=400)
    ride.states["course_length"] = np.full(400, length)
    found = ride_of(ride)
    assert (found.laps, found.figures.laps) == ((), None)
    np.testing.assert_array_equal(found.table().station_m, ride.states["progress"])
    assert compare([found]).station_m[-1] == pytest.approx(ride.states["progress"][-1], rel=0.01)


@example(seconds=59.9996)
@example(seconds=119.9996)
@given(seconds=st.floats(0.0, 1e5) | st.integers(0, 10_000).map(lambda n: 60.0 * n - 0.0004))
def test_lap_times_are_never_sixty_seconds(seconds: float) -> None:
    """What is read back is the time to half a millisecond, and the seconds of a minute are below 60."""
    minutes, _, rest = lap_text(abs(seconds)).rpartition(":")
    assert len(rest.split(".")[1]) == 3
    assert float(rest) < 60.0
    assert abs(60 * int(minutes or 0) + float(rest) - abs(seconds)) <= 0.0005 + 1e-9
    assert (minutes != "") == (abs(seconds) >= 59.9995)


@given(st.lists(st.tuples(*[st.floats(1.0, 200.0)] * 3), min_size=1, max_size=6))
def test_the_best_sectors_are_added_as_they_are(laps: list[tuple[float, float, float]]) -> None:
    """Rounding each sector first would differ by up to a millisecond and a half."""
    together = best_sectors_together(laps)
    assert together == sum(min(column) for column in zip(*laps, strict=True))
    assert together <= min(map(sum, laps)) * (1.0 + 1e-12)
    assert best_sectors_together([*laps, (None, None, None)]) == together
    assert best_sectors_together([(None, 1.0, 1.0)]) is None
    assert best_sectors_together([]) is None


def test_one_time_is_written_in_one_way(writer, circle, tmp_path: Path) -> None:
    """Laps of more than a minute: the table of the page, that of the terminal and the function say the same."""
    paths = [
        writer.write(tmp_path / f"{name}.mcap", [circle(steps=2200, speed=speed)], metadata_file=False)
        for name, speed in (("slow", 0.61), ("fast", 0.6543))
    ]
    figures = analyze(paths)
    (comparison,) = figures["comparisons"]
    page, text = time_table(compare(paths)), text_of(figures)
    times = [run["duration_s"] for run in comparison["runs"]]
    times += [time for sector in comparison["sectors"] for time in sector["times_s"]]
    assert len(times) == 6
    assert min(times[:2]) > 60.0
    for time in (*times, comparison["theoretical_lap_s"]):
        assert f">{lap_text(time)}<" in page
        assert f" {lap_text(time)}" in text


def test_the_terminal_tells_a_best_lap_of_several_and_sectors_that_fit(writer, circle, tmp_path: Path) -> None:
    figures = analyze(writer.write(tmp_path / "laps.mcap", [circle(steps=2200, speed=2.0)], metadata_file=False))
    (ride,) = figures["rides"]
    assert len(ride["complete_laps"]) > 1
    assert "best lap" in text_of(figures)
    assert "best sectors together" in text_of(figures)
    ride["complete_laps"], figures["comparisons"] = ride["complete_laps"][:1], []
    assert "best lap" not in text_of(figures)
    assert "sector 2" in text_of(figures)
    (lap,) = ride["complete_laps"]
    lap["sectors_s"] = lap["sectors_s"] * 6
    assert "sector 2" not in text_of(figures)
    assert lap_text(lap["lap_s"]) in text_of(figures)


@pytest.fixture
def ring() -> Track:
    """The circle of the rides, 3 m wide to both sides."""
    centre = Course.from_elements("circle", [Arc(10.0, 2.0 * np.pi)], closed=True)
    wide = np.full(len(centre.s), 3.0)
    sections = (("first half", 0.0), ("second half", 0.5 * centre.length))
    line = (centre.name, centre.s, centre.x, centre.y, centre.heading, centre.curvature, True)
    centre = Course(*line, width_left=wide, width_right=wide, sections=sections)
    return Track(centre, 0.0 * wide, wide, wide)


def test_laps_have_the_numbers_of_the_events_in_all_reports(writer, circle, ring: Track, tmp_path: Path) -> None:
    """The out-lap is lap 1. Here it is the fastest, and counts neither as the best lap nor for the best sectors."""
    ride = circle(steps=1200, offset=0.0)
    time = 0.05 * np.arange(1200)
    ride.states["progress"] = np.where(time < LENGTH / 5.0, 5.0 * time, LENGTH + 4.0 * (time - LENGTH / 5.0))
    for prefix, ahead in (("", 0.0), ("front_", 1.0)):
        angle = (ride.states["progress"] + ahead) / 10.0
        ride.states |= {f"{prefix}x": 10.0 * np.sin(angle), f"{prefix}y": 10.0 - 10.0 * np.cos(angle)}
    path = writer.write(tmp_path / "lap.mcap", [ride])
    found = open_ride(path).rides[0].laps
    s = np.linspace(0.0, LENGTH, 50)
    theory = Theory(ring, s, np.full(50, 6.0), 0.0 * s, 0.0 * s, LENGTH / 6.0, (0.5 * LENGTH / 6.0,) * 2)
    lap = analyze_laps(path, theory, tmp_path)
    assert lap["laps_s"] == pytest.approx([LENGTH / 4.0] * 3, abs=1e-2)
    assert lap["lap_s"] == min(lap["laps_s"])
    assert lap["out_lap_s"] == pytest.approx(found[0].duration_s, abs=1e-3)
    page = Path(lap["page"]).read_text()
    words = page.split("<noscript>")[0].split("</style>")[1]
    assert "whipple on circle" in words
    assert "two-wheeler-lab" in words
    rows = [row.split("</td>") for row in page.split("<tr><td>")[1:7]]
    assert [row[0] for row in rows] == ["lap 1", "lap 2", "lap 3", "lap 4", "best sectors", "theoretical"]
    assert [row[1].removeprefix("<td class=text>") for row in rows[:2]] == ["rolling start", "flying"]
    together = rows[4][2].removeprefix('<td class="best">').removeprefix("<td>").partition("<small>")[0]
    assert float(together) == pytest.approx(LENGTH / 4.0, abs=1e-2)
    assert together == lap_text(best_sectors_together(lap.sectors_s for lap in found[1:]))
    figures = open_ride(path).rides[0].figures
    assert [lap.out_lap for lap in figures.complete_laps] == [True, False, False, False]
    assert figures.theoretical_lap_s == pytest.approx(float(together), abs=1e-3)
    assert figures.best_lap_s == pytest.approx(LENGTH / 4.0, abs=1e-2)


def test_laps_through_the_nodes_note_who_rode(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    from bike_training.nodes import node_rides

    parameters: dict[str, dict[str, object]] = {}
    monkeypatch.setattr(node_rides, "ride_recorded", lambda domain, nodes, **named: parameters.update(nodes))
    ride = "r1", "monza", 5000.0, 1, tmp_path / "lap.mcap", 100.0
    node_rides.ride_through_nodes(*ride)
    assert parameters["record"]["notes"] == ["policy=classical", "circuit=monza"]
    assert not any("disturbances" in known for known in parameters.values())
    node_rides.ride_through_nodes(*ride, disturbances="grip_090")
    assert [parameters[name]["disturbances"] for name in ("sim_node", "drive")] == ["grip_090"] * 2


def test_off_track_time_and_validity(ride_of, circle) -> None:
    """Limits 1 m to both sides; the line is left by a triangle wave for a part that follows from similar triangles."""
    steps = 1000
    ride = circle(steps=steps)
    time = 0.05 * np.arange(steps)
    offset = np.clip(2.0 - np.abs(time - 25.0), 0.0, None)  # peaks at 2 m; beyond 1 m from 24 to 26 s
    ride.states |= {"lateral_error": offset, "front_lateral_error": offset, "front_progress": ride.states["progress"]}
    wide = np.full(len(ride.course["s"]), 1.0)
    ride.course |= {"width_left": wide, "width_right": wide}
    found = ride_of(ride)
    assert found.figures.off_track_s == pytest.approx(2.0, abs=1e-9)
    laps = found.figures.complete_laps
    assert [lap.valid for lap in laps] == [True, False, True]
    assert laps[1].off_track_s == pytest.approx(2.0, abs=1e-9)
    ride.states["front_lateral_error"] = np.zeros(steps)  # the front wheel stays inside: the machine is on the track
    assert ride_of(ride).figures.off_track_s == 0.0


@given(
    outside=st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=40),
    split=st.floats(0.0, 1.0),
    period=st.floats(0.01, 1),
)
def test_time_outside_adds_up(outside: list[float], split: float, period: float) -> None:
    """Over two parts that meet at a state it is that over the whole, and it is never longer than the ride."""
    time, values = period * np.arange(len(outside)), np.array(outside)
    whole = time_outside(time, values)
    at = time[int(split * (len(time) - 1))]
    parts = [time_outside(time, values, end_s=at), time_outside(time, values, begin_s=at)]
    assert 0.0 <= whole <= time[-1] + 1e-9
    assert sum(parts) == pytest.approx(whole, abs=1e-9)
    assert time_outside(time, -np.abs(values) - 1.0) == 0.0


def test_the_ideal_line_is_known_by_its_name(ride_of, circle) -> None:
    ride = circle(steps=400, offset=0.4)
    assert ride_of(ride).figures.ideal_distance_mean_m is None
    ride.course["name"] = "circle (ideal)"
    figures = ride_of(ride).figures
    assert figures.ideal_distance_mean_m == pytest.approx(0.4)
    assert figures.complete_laps[0].ideal_distance_max_m == pytest.approx(0.4)


def test_collisions_tell_speed_and_energy(ride_of, circle) -> None:
    text = "met a wall at 31.2 m/s, 14 deg, 152 kJ"
    event = {"step": 90, "kind": 3, "time": 4.5, "progress": 18.0, "value": 31.2, "text": text}
    (hit,) = ride_of(circle(steps=100, events=[event])).figures.collisions
    assert hit == {"time_s": 4.5, "progress_m": 18.0, "speed_m_s": 31.2, "energy_j": 152e3, "text": text}
