"""docs/reference/analysis.md: its Python runs, its columns are those of the tables, its figures those of the JSON."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bike_analysis import open_ride
from bike_analysis.figures.results import SCHEMA
from bike_analysis.page.document import recorded_settings
from bike_analysis.page.ride_view import histograms, ride_view
from bike_sim.recording.recorder import RideRecorder
from bike_sim.schema import SIGNALS, SUSPENSION, TELEMETRY
from bike_training.cli import main
from tests.bags import split_recording

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "analysis.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(writer, circle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three recordings of laps: a.mcap, b.mcap and lap.mcap."""
    folder = tmp_path_factory.mktemp("docs")
    for name, speed in (("a", 4.0), ("b", 4.5), ("lap", 5.0)):
        notes = {"policy": f"rider {name}"}
        ride = circle(steps=700, speed=speed, latency_ms=(0.1, 0.2))
        writer.write(folder / f"{name}.mcap", [ride], notes=notes, metadata_file=False)
    return folder


def test_its_python_runs(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(folder)
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/reference/analysis.md", "exec"), names)
    assert "rider lap" in capsys.readouterr().out
    assert np.nanmin(names["lost"]) == 0.0
    assert str(names["fast"]).startswith("rider b, lap ")
    assert len(names["laps"].runs) == len(names["ride"].laps)


def cells(heading: str) -> list[str]:
    """Names in the first cells of the table, or before the colons of the list, below a heading."""
    part = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"^(?:\|| -|-) (`[^:|]+)", part.replace("\n  `", " `"), re.MULTILINE)


@pytest.fixture(scope="module")
def with_telemetry(messages, folder: Path) -> Path:
    """A few states with telemetry, signals and inferred grip; numbers of telemetry are their fields' places."""
    for name in ("Telemetry", "BikeState", "EpisodeStart", "GripEstimate"):
        messages.learn(f"bike_msgs/msg/{name}")
    messages.learn("std_msgs/msg/String")
    path = folder / "telemetry.mcap"
    values = {name: float(k) for k, name in enumerate(TELEMETRY.names)}
    flags = ("traction_control", "anti_wheelie", "brake_control", "anti_stoppie", *_LOST)
    with RideRecorder(path, metadata_file=False) as recorder:
        recorder.add_topic("/bike/state", "bike_msgs/msg/BikeState")
        recorder.add_topic("/bike/telemetry", "bike_msgs/msg/Telemetry")
        recorder.add_topic("/bike/episode", "bike_msgs/msg/EpisodeStart")
        recorder.add_topic("/bike/grip", "bike_msgs/msg/GripEstimate")
        recorder.add_topic("/bike/disturbances", "std_msgs/msg/String")
        world = messages.make("std_msgs/msg/String", data=json.dumps(WORLD))
        recorder.write("/bike/disturbances", messages.cdr("std_msgs/msg/String", world), round(1e9))
        episode = messages.make("bike_msgs/msg/EpisodeStart", signal_names=list(SIGNALS.columns))
        recorder.write("/bike/episode", messages.cdr("bike_msgs/msg/EpisodeStart", episode), round(1e9))
        for step in range(20):
            both = {"header": messages.header(1.0 + 0.02 * step), "episode": 1, "step": step}
            state = messages.make("bike_msgs/msg/BikeState", control_period=0.02, x=0.1 * step, speed=20.0, **both)
            state.signals = np.arange(float(len(SIGNALS)))
            state.centre_place = np.array([10.0 * step, 0.0, 0.0, 0.0])
            grip = messages.make("bike_msgs/msg/GripEstimate", grip=1.0 - 0.01 * step, **both)
            recorder.write("/bike/grip", messages.cdr("bike_msgs/msg/GripEstimate", grip), round(1e9 + 2e7 * step))
            told = values | {name: step >= 15 for name in flags}
            told["rear_slip_angle"] = 0.01 * (step - 10)
            telemetry = messages.make("bike_msgs/msg/Telemetry", **both, **told)
            time = round(1e9 + 2e7 * step)
            recorder.write("/bike/state", messages.cdr("bike_msgs/msg/BikeState", state), time)
            if step != 3:  # one is lost
                recorder.write("/bike/telemetry", messages.cdr("bike_msgs/msg/Telemetry", telemetry), time)
    return path


_LOST = ("rear_contact_lost", "front_contact_lost")
WORLD = {
    "name": "wet\x1b",
    "road": {"grip": 0.9, "patches": [[100.0, 120.0, 0.5]]},
    "vehicle": {"front_tyre.friction": 0.8, "rear_tyre.friction": 1.0},
}


def test_inferred_and_true_grip_are_in_one_panel(with_telemetry: Path) -> None:
    """The true one is that of the recorded disturbances: road, patches by place along the centre line, and tyres."""
    view = ride_view(open_ride(with_telemetry).rides[0], "ride", "ride")
    (panel,) = (panel for panel in view.panels if panel["key"] == "road_grip")
    assert [line["column"] for line in panel["lines"]] == ["true_grip", "inferred_grip"]
    columns = view.series[0].columns
    np.testing.assert_allclose(columns["inferred_grip"], 100.0 - np.arange(20.0))
    expected = np.full(20, 81.0)
    expected[[10, 11]] = 40.5
    np.testing.assert_allclose(columns["true_grip"], expected)
    assert recorded_settings(open_ride(with_telemetry))[-1] == "disturbances wet\\x1b"


def test_its_columns_are_those_of_the_table(with_telemetry: Path) -> None:
    table = open_ride(with_telemetry).rides[0].table()
    documented = re.findall(r"`(\w+)`", " ".join(cells("Columns")))
    assert sorted(documented) == sorted(table.columns)
    assert len(documented) == len(set(documented))


def test_suspension_is_read_from_the_signals_of_the_states(with_telemetry: Path) -> None:
    """Columns of the table by the names of the episode, and on the page channels, panels and both histograms."""
    ride = open_ride(with_telemetry).rides[0]
    table = ride.table()
    for name in SUSPENSION.columns:
        assert set(table[name]) == {float(SIGNALS.columns.index(name))}
    view = ride_view(ride, "ride", "ride")
    assert {"travel", "damper", "pitch", "twist", "chain"} <= {panel["key"] for panel in view.panels}
    columns = view.series[0].columns
    assert columns["fork_speed"][0] == 1e3 * SIGNALS.index("fork_speed")
    assert {"fork_speed-histogram", "shock_speed-histogram"} <= {found["key"] for found in histograms(view.series)}


def test_telemetry_is_beside_its_state(with_telemetry: Path) -> None:
    ride = open_ride(with_telemetry).rides[0]
    table = ride.table()
    known = table.step != 3
    np.testing.assert_allclose(table.rear_slip_angle_rad[known], 0.01 * (table.step[known] - 10))
    assert np.isnan(table.rear_slip_angle_rad[3])
    assert set(table.front_load_n[known]) == {float(TELEMETRY.index("front_load"))}
    tyres = ride.figures.tyres
    assert tyres["rear_slip_angle_max_deg"] == pytest.approx(np.degrees(0.1))
    assert tyres["anti_wheelie_s"] == pytest.approx(5 * 0.02)
    assert tyres["front_contact_lost_s"] == pytest.approx(5 * 0.02)


def test_its_figures_are_those_of_the_json(folder: Path, tmp_path: Path, capsys) -> None:
    files = ("--out", str(tmp_path / "o"), "--csv", str(tmp_path / "t.csv"), "--parquet", str(tmp_path / "t.parquet"))
    figures = run(capsys, str(folder / "a.mcap"), str(folder / "b.mcap"), *files)["figures"]
    laps = {name for ride in figures["rides"] for lap in ride["complete_laps"] for name in lap}
    of_rides = {name for ride in figures["rides"] for name in ride} | laps
    known = of_rides | set(figures)
    for part in ("recordings", "comparisons"):
        known |= {f"{prefix}{name}" for name in figures[part][0] for prefix in ("", f"{part}[].")}
    known |= {name for part in ("runs", "sectors") for name in figures["comparisons"][0][part][0]}
    documented = re.findall(r"`([^`]+)`", " ".join(cells("Figures") + cells("JSON")))
    assert set(documented) <= known
    assert of_rides - {"recording"} <= set(documented)


def check_fields(result: dict) -> None:
    """Check that an output has the fields of its records, and only numbers that JSON knows."""
    json.dumps(result, allow_nan=False)
    assert result["schema"] == SCHEMA
    names = set(result["figures"]["rides"][0])
    assert all(set(ride) == names for ride in result["figures"]["rides"])


def run(capsys, *words: str) -> dict:
    capsys.readouterr()
    assert main(["analyze", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_every_output_has_the_fields_of_its_records(folder: Path, with_telemetry: Path, tmp_path: Path, capsys) -> None:
    for words in (("lap.mcap",), ("a.mcap", "b.mcap", "lap.mcap"), ("telemetry.mcap",)):
        check_fields(run(capsys, *(str(folder / word) for word in words)))
    torn = tmp_path / "torn.mcap"
    torn.write_bytes((folder / "a.mcap").read_bytes()[:-3000])
    check_fields(run(capsys, str(torn)))
    copy = shutil.copy(folder / "lap.mcap", tmp_path / "lap.mcap")
    files = ("--out", str(tmp_path / "o"), "--csv", str(tmp_path / "t.csv"), "--parquet", str(tmp_path / "t.parquet"))
    result = run(capsys, str(copy), *files)
    check_fields(result)
    assert all(Path(result["figures"][name]).exists() for name in ("page", "csv", "parquet"))


def test_split_recordings_are_read_as_one(writer, circle, tmp_path: Path) -> None:
    """A directory whose metadata lists several files, as rosbag2 leaves them."""
    whole = writer.write(tmp_path / "whole.mcap", [circle(steps=300)], metadata_file=False)
    split_recording(whole, tmp_path / "parts", 4.0)
    assert len(list((tmp_path / "parts").glob("*.mcap"))) > 2
    one, many = open_ride(whole), open_ride(tmp_path / "parts")
    assert many.warnings == one.warnings
    pd.testing.assert_frame_equal(many.rides[0].table(), one.rides[0].table())
