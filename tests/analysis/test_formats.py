"""Recordings in other programs' formats, read back by readers that are not those of this project."""

from __future__ import annotations

import json
import struct
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from bike_analysis import open_ride
from bike_analysis.formats.motec import BEACON, write_ld
from bike_analysis.formats.topics import read_topic
from bike_analysis.read.container import RecordingError
from bike_training.cli import main

LAP_S = 20.0 * np.pi / 4.0


def read_log(path: Path) -> tuple[dict[str, str], dict[str, tuple[int, str, np.ndarray]]]:
    """Read a log by the offsets that are documented for it (gopher-vision): texts, and channels with rate and unit."""
    data = path.read_bytes()
    (first,) = struct.unpack_from("<I", data, 0x08)
    texts = {name: data[at : at + 64].split(b"\0")[0].decode("ascii") for name, at in
             (("date", 0x5E), ("driver", 0x9E), ("vehicle", 0xDE), ("venue", 0x15E))}  # fmt: skip
    channels, place = {}, first
    while place:
        _, following, at, count = struct.unpack_from("<4I", data, place)
        kind, size, rate = struct.unpack_from("<3H", data, place + 0x12)
        shift, multiplier, scale, places = struct.unpack_from("<4h", data, place + 0x18)
        assert (kind, size) == (7, 4)
        name, unit = (
            data[place + b : place + e].split(b"\0")[0].decode("ascii") for b, e in ((0x20, 0x40), (0x48, 0x54))
        )
        values = np.frombuffer(data, "<f4", count, at).astype(float)
        channels[name] = rate, unit, (values / scale * 10.0**-places + shift) * multiplier
        place = following
    return texts, channels


def test_a_log_holds_the_ride_at_a_constant_rate_and_its_laps(writer, circle, tmp_path: Path) -> None:
    path = writer.write(
        tmp_path / "ride.mcap", [circle(steps=1000, skip_steps=frozenset({77, 78}))], notes={"policy": "rüdi"}
    )
    ride = open_ride(path).rides[0]
    texts, channels = read_log(write_ld(ride, tmp_path / "new" / "lap.ld"))
    assert (texts["driver"], texts["vehicle"], texts["venue"]) == ("r?di", "whipple", "circle")
    rates = {rate for rate, _, _ in channels.values()}
    assert rates == {20}
    assert {len(values) for _, _, values in channels.values()} == {1000}
    table = ride.table().select_dtypes("number").set_index("step").reindex(range(1000)).interpolate()
    for name, unit, expected in (
        ("Ground Speed", "km/h", 3.6 * table["speed_m_s"]),
        ("Lean Angle", "deg", np.degrees(table["roll_rad"])),
        ("Pos X", "m", table["x_m"]),
        ("G Force Lat", "G", table["lateral_acceleration_m_s2"] / 9.81),
    ):
        assert channels[name][1] == unit
        np.testing.assert_allclose(channels[name][2], expected, rtol=1e-6, atol=1e-3)
    assert set(np.unique(channels["Lap Number"][2])) == {1.0, 2.0, 3.0, 4.0}
    beacons = np.flatnonzero(channels[BEACON][2]) / 20.0
    markers = [1e-6 * float(marker.attrib["Time"]) for marker in ET.parse(tmp_path / "new" / "lap.ldx").iter("Marker")]
    assert markers == pytest.approx([LAP_S, 2.0 * LAP_S, 3.0 * LAP_S], abs=1e-5)
    assert (beacons - markers).max() < 0.05
    assert (beacons - markers).min() >= 0.0
    values = {e.attrib["Id"]: e.attrib["Value"] for e in ET.parse(tmp_path / "new" / "lap.ldx").iter("String")}
    assert values["Fastest Time"] == "0:15.708"
    assert 1 <= int(values["Fastest Lap"]) <= 3


def test_a_ride_that_makes_no_log_says_so(writer, circle, tmp_path: Path, capsys) -> None:
    path = writer.write(tmp_path / "ride.mcap", [circle(steps=1)])
    assert main(["analyze", str(path), "--json", "--ld", str(tmp_path / "lap.ld")]) == 2
    assert "at least two states" in capsys.readouterr().err
    assert main(["analyze", str(path), "--json", "--ld", str(tmp_path / "lap.csv")]) == 2
    assert "names end in .ld" in capsys.readouterr().err


@pytest.fixture(scope="module")
def told(old_recording: Path) -> dict[str, list]:
    """Messages by topic, as the decoder of the mcap package reads them."""
    found: dict[str, list] = {}
    with old_recording.open("rb") as file:
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


@pytest.mark.parametrize("topic", ["/bike/state", "/bike/command", "/bike/course", "/bike/events", "/diagnostics"])
def test_any_topic_is_a_table_of_its_fields(topic: str, old_recording: Path, told: dict[str, list]) -> None:
    table, warnings = read_topic(old_recording, topic.lstrip("/"))
    assert not warnings
    assert len(table) == len(told[topic])
    for row in (0, len(table) - 1):
        time, message = told[topic][row]
        assert table["log_time_s"][row] == pytest.approx(1e-9 * time)
        assert table["header.stamp.sec"][row] == message.header.stamp.sec
        for name in [name for name in table if "." not in name and name != "log_time_s"]:
            expected, value = getattr(message, name), table[name][row]
            if isinstance(value, list) and value and isinstance(value[0], dict):
                assert [each["name"] for each in value] == [each.name for each in expected]
            else:
                assert value == (list(expected) if isinstance(value, list) else expected)


def test_the_command_writes_a_topic(old_recording: Path, tmp_path: Path, capsys, told: dict[str, list]) -> None:
    csv, parquet = tmp_path / "new" / "t.csv", tmp_path / "t.parquet"
    words = ["analyze", str(old_recording), "--topic", "bike/state"]
    assert main([*words, "--csv", str(csv), "--parquet", str(parquet), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["messages"] == len(told["/bike/state"])
    by_text, whole = pd.read_csv(csv), pd.read_parquet(parquet)
    assert list(by_text) == list(whole) == list(figures["columns"])
    np.testing.assert_array_equal(by_text["roll"], whole["roll"])
    assert json.loads(by_text["preview_x"][3]) == list(whole["preview_x"][3])
    assert main([*words, "--csv", str(old_recording)]) == 2
    assert "would be overwritten" in capsys.readouterr().err
    assert main(["analyze", str(old_recording), "--topic", "bike/stat"]) == 2
    assert "has no topic '/bike/stat'; did you mean /bike/state?" in capsys.readouterr().err
    assert main(["analyze", str(old_recording), "--topic", "bike/state", "--ld", "x.ld"]) == 2
    assert "--ld is for a recording" in capsys.readouterr().err


def test_what_is_not_of_ros_2_is_refused_in_one_line(writer, circle, tmp_path: Path) -> None:
    whole, torn = writer.write(tmp_path / "ride.mcap", [circle()]), tmp_path / "torn.mcap"
    for share, least in ((0.4, 50), (0.01, None)):
        torn.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
        if least is None:
            with pytest.raises(RecordingError, match="is torn"):
                read_topic(torn, "/bike/state")
            continue
        table, warnings = read_topic(torn, "/bike/state")
        assert least < len(table) < 400
        assert "is torn" in warnings[0]
    (tmp_path / "car.mcap").write_bytes(b"a car's log")
    with pytest.raises(RecordingError, match="not an MCAP recording"):
        read_topic(tmp_path / "car.mcap", "/bike/state")


def test_foreign_encodings_are_named(tmp_path: Path, foreign_bag: Callable[[str], Path]) -> None:
    with pytest.raises(RecordingError, match="protobuf by protobuf, and CDR by ros2msg is read"):
        read_topic(foreign_bag("protobuf"), "/car/pose")


@pytest.fixture
def foreign_bag(tmp_path: Path) -> Callable[[str], Path]:
    from mcap.writer import Writer

    def make(encoding: str) -> Path:
        path = tmp_path / "foreign.mcap"
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            schema = writer.register_schema("car.Pose", encoding, b"...")
            channel = writer.register_channel("/car/pose", encoding, schema)
            writer.add_message(channel, 1, b"x", 1)
            writer.finish()
        return path

    return make
