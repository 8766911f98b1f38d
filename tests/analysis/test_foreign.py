"""Recordings that nobody here made: other bicycles, other versions, damage. What can be shown is shown."""

from __future__ import annotations

import io
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from bike_analysis import RecordingError, compare, open_ride
from bike_analysis.figures.metrics import ride_figures
from bike_analysis.figures.results import SCHEMA
from bike_analysis.read.messages import EARTH_RADIUS
from bike_sim.recording.definitions import MessageType
from bike_sim.recording.recorder import RideRecorder
from bike_training.cli import main
from bike_training.replay import read_rides

RATE = 20.0
ODOMETRY, IMU, FIX = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix"


@pytest.fixture(scope="module")
def foreign(messages, tmp_path_factory: pytest.TempPathFactory):
    """Write standard messages: a ride around a circle of 20 m radius to the left at 5 m/s, leaning 0.2 rad."""
    for name in (ODOMETRY, IMU, FIX):
        messages.learn(name)

    def put(message: Any, **values: float) -> None:
        for name, value in values.items():
            setattr(message, name, value)

    def turn(orientation: Any, roll: float, yaw: float) -> None:
        (a, b), (c, d) = ((np.cos(angle / 2), np.sin(angle / 2)) for angle in (roll, yaw))
        put(orientation, x=c * b, y=d * b, z=d * a, w=c * a)

    def odometry(time: float) -> Any:
        message, angle = messages.make(ODOMETRY, header=messages.header(time + 1.0)), 0.25 * time
        put(message.pose.pose.position, x=20 * np.sin(angle), y=20 - 20 * np.cos(angle))
        turn(message.pose.pose.orientation, -0.2, angle)
        message.twist.twist.linear.x, message.twist.twist.angular.z = 5.0, 0.25
        return message

    def imu(time: float) -> Any:
        message = messages.make(IMU, header=messages.header(time + 1.0))
        turn(message.orientation, -0.2, 0.25 * time)
        put(message.angular_velocity, x=0.05 * np.cos(time), z=0.25)
        return message

    def fix(time: float) -> Any:
        message, angle = messages.make(FIX, header=messages.header(time + 1.0)), 0.25 * time
        message.latitude = 47.0 + np.degrees((20 - 20 * np.cos(angle)) / EARTH_RADIUS)
        message.longitude = 11.0 + np.degrees(20 * np.sin(angle) / EARTH_RADIUS / np.cos(np.radians(47.0)))
        return message

    makers = {ODOMETRY: ("/odom", odometry), IMU: ("/imu/data", imu), FIX: ("/fix", fix)}
    folder = tmp_path_factory.mktemp("foreign")

    def write(
        *kinds: str,
        seconds: float = 10.0,
        gap: float = 0.0,
        change: Callable[[float, Any], None] = lambda time, message: None,
    ) -> Path:
        path = folder / f"{len(list(folder.iterdir()))}.mcap"
        with RideRecorder(path, metadata_file=False) as recorder:
            for kind in kinds:
                recorder.add_topic(makers[kind][0], kind)
            for step in range(round(seconds * RATE)):
                time = step / RATE + (gap if step > 0.5 * seconds * RATE else 0.0)
                for kind in kinds:
                    topic, maker = makers[kind]
                    message = maker(time)
                    change(time, message)
                    recorder.write(topic, messages.cdr(kind, message), round((time + 1.0) * 1e9))
        return path

    return write


def test_odometry_and_imu_make_a_ride(foreign) -> None:
    recording = open_ride(foreign(ODOMETRY, IMU))
    (ride,) = recording.rides
    states, time = ride.states, ride.time
    np.testing.assert_allclose(states.x, 20 * np.sin(0.25 * time), atol=1e-9)
    np.testing.assert_allclose(states.yaw, 0.25 * time, atol=1e-9)
    np.testing.assert_allclose(states.roll, -0.2, atol=1e-9)
    np.testing.assert_allclose(states.roll_rate, 0.0, atol=1e-12)  # odometry tells it, so the IMU's is not taken
    assert ride.figures.speed_mean_m_s == pytest.approx(5.0)
    assert ride.figures.distance_m == pytest.approx(5.0 * 9.95, rel=1e-4)
    assert ride.figures.roll_min_deg == pytest.approx(np.degrees(-0.2))
    assert ride.figures.lateral_acceleration_max_m_s2 == pytest.approx(1.25)
    assert ride.figures.mean_error_m is None
    with pytest.raises(RecordingError, match="no states of a simulator"):
        read_rides(recording.path)
    told = [text for text in recording.warnings if "/odom" in text]
    assert len(told) == 1
    assert "/imu/data" in told[0]


def test_satellite_and_imu_give_place_speed_and_lean(foreign) -> None:
    (ride,) = open_ride(foreign(FIX, IMU)).rides
    states, time = ride.states, ride.time
    np.testing.assert_allclose(states.x, 20 * np.sin(0.25 * time), atol=1e-3)
    np.testing.assert_allclose(states.y, 20 - 20 * np.cos(0.25 * time), atol=1e-3)
    np.testing.assert_allclose(states.speed[1:-1], 5.0, rtol=2e-3)
    np.testing.assert_allclose(states.roll_rate, 0.05 * np.cos(time), atol=1e-9)


def test_a_receiver_without_a_fix_has_no_place(foreign) -> None:
    def lose(time: float, message: Any) -> None:
        if time < 2.0:
            message.status.status, message.latitude, message.longitude = -1, 0.0, 0.0

    (ride,) = open_ride(foreign(FIX, change=lose)).rides
    states, time = ride.states, ride.time
    early = time < 2.0 - 1e-6
    assert np.isnan(states.x[early]).all()
    assert np.isnan(states.y[early]).all()
    assert ride.figures.distance_m == pytest.approx(5.0 * 7.95, rel=1e-3)
    heading = states.yaw[~early][2:-1]
    np.testing.assert_allclose(np.diff(heading), 0.25 / RATE, rtol=0.05)
    (never,) = open_ride(foreign(FIX, change=lose, seconds=1.0)).rides
    assert np.isnan(never.states.x).all()


@pytest.mark.parametrize("known_from", [np.inf, 3.0, 0.05])
def test_stamps_of_zero_are_no_times(foreign, known_from: float) -> None:
    """The log times tell how far apart the messages are, also where they are of another clock than the stamps."""

    def forget(time: float, message: Any) -> None:
        message.header.stamp.sec += 1000
        if time < known_from - 1e-6:
            message.header.stamp.sec = message.header.stamp.nanosec = 0

    (ride,) = open_ride(foreign(ODOMETRY, change=forget)).rides
    np.testing.assert_allclose(ride.time, np.arange(200) / RATE, atol=1e-6)
    assert ride.states.time_s[0] == pytest.approx(1.0 if known_from == np.inf else 1001.0)
    assert ride.figures.speed_mean_m_s == pytest.approx(5.0)


def test_inertial_data_alone_are_shown(foreign, tmp_path: Path, capsys) -> None:
    path = foreign(IMU)
    (ride,) = open_ride(path).rides
    assert ride.figures.roll_rate_max_deg_s == pytest.approx(np.degrees(0.05), rel=1e-3)
    assert ride.figures.speed_mean_m_s is None
    assert ride.figures.distance_m == 0.0
    assert main(["analyze", str(path), "--out", str(tmp_path), "--csv", str(tmp_path / "t.csv")]) == 0
    assert (tmp_path / "ride.html").exists()


def test_silence_separates_rides(foreign) -> None:
    rides = open_ride(foreign(ODOMETRY, gap=60.0)).rides
    assert len(rides) == 2
    assert [run.duration_s for run in compare(rides).runs] == [ride.figures.duration_s for ride in rides]
    assert len(open_ride(foreign(ODOMETRY, gap=5.0)).rides) == 1


STATE_HEAD = "std_msgs/Header header\nuint32 episode\nuint32 step\n"
HEADER = "\n{line}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{line}\n".format(
    line="=" * 80
)
HEADER += "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"


def other_version(path: Path, fields: str, payload: bytes) -> Path:
    """Three states of another version of the message, whose fields after the head are `fields`."""
    with RideRecorder(path, overwrite=True, metadata_file=False) as recorder:
        recorder.add_topic("/bike/state", MessageType("bike_msgs/msg/BikeState", STATE_HEAD + fields + HEADER))
        for step in range(3):
            stamp = step.to_bytes(4, "little") + bytes(4) + (1).to_bytes(4, "little") + bytes(4)
            count = (1).to_bytes(4, "little") + step.to_bytes(4, "little")
            recorder.write("/bike/state", b"\0\1\0\0" + stamp + count + payload, step)
    return path


def test_fields_of_other_types_are_read_where_they_are_numbers(tmp_path: Path) -> None:
    fields = "float32 x\nint32 y\nstring roll\nfloat64[] speed\nint8 lateral_error\n"
    payload = np.array([1.5], "<f4").tobytes() + np.array([-2], "<i4").tobytes()  # ends at byte 32 behind the header
    payload += (
        (3).to_bytes(4, "little") + b"hi\0\0" + (1).to_bytes(4, "little") + bytes(4) + np.ones(1).tobytes() + b"\3"
    )
    recording = open_ride(other_version(tmp_path / "v.mcap", fields, payload))
    states = recording.rides[0].states
    assert (states.x[0], states.y[0], states.lateral_error[0]) == (1.5, -2.0, 3.0)
    assert np.isnan(states.roll).all()
    assert np.isnan(states.speed).all()
    (told,) = [text for text in recording.warnings if "/bike/state has no" in text]
    assert "roll" in told
    assert "speed" in told


def test_states_without_places_are_shown(tmp_path: Path, capsys) -> None:
    path = other_version(tmp_path / "v.mcap", "float64 lateral_error\n", np.array([0.25]).tobytes())
    assert main(["analyze", str(path), "--json", "--out", str(tmp_path / "out")]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert figures["rides"][0]["mean_error_m"] == 0.25
    assert figures["rides"][0]["distance_m"] == 0.0


@pytest.mark.parametrize(
    "fields",
    [
        "A[] roll\nfloat64 y\n" + "=" * 80 + "\nMSG: bike_msgs/A\nA[] again\n",
        "A roll\nfloat64 y\n" + "=" * 80 + "\nMSG: bike_msgs/A\nA again\n",
        "float64[4294967295] x\nfloat64 y\n",
        "Empty[4294967295] many\nfloat64 y\n" + "=" * 80 + "\nMSG: bike_msgs/Empty\n",
    ],
)
def test_definitions_made_to_harm_do_not(tmp_path: Path, capsys, fields: str) -> None:
    """Messages that contain themselves and endless arrays of nothing end at once."""
    path = other_version(tmp_path / "v.mcap", fields, np.full(2, 2.0**-9).tobytes())
    check_answer(*analyze_quietly(path, capsys))


@pytest.fixture(scope="module")
def recorded(writer, circle, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("recorded") / "ride.mcap"
    ride = circle(steps=90, events=[{"step": 80, "kind": 4, "time": 4.0, "progress": 16.0, "value": 4.0}])
    ride.latency_ms = (0.1, 0.3)
    return writer.write(path, [ride, circle(steps=40, episode=2, start_s=10.0)], chunk_bytes=4000).read_bytes()


def analyze_quietly(path: Path, capsys: pytest.CaptureFixture, *more: str) -> tuple[int, str, list[str]]:
    """Run the command; its exit code, its output, and its lines on standard error."""
    capsys.readouterr()
    code = main(["analyze", str(path), "--json", *more])
    captured = capsys.readouterr()
    return code, captured.out, captured.err.splitlines()


def check_answer(code: int, out: str, err: list[str]) -> None:
    """One line and nothing else, or a valid result with warnings."""
    if code == 2:
        assert out == ""
        assert [line[:14] for line in err if not line.startswith("warning: ")] == ["bike analyze: "]
        return
    assert code == 0
    assert json.loads(out)["schema"] == SCHEMA
    assert all(line.startswith("warning: ") for line in err)


def flipped(content: bytes, flips: list[tuple[float, int]], path: Path) -> Path:
    """A file with some bytes changed: places as shares of its length, and what they are changed by."""
    damaged = bytearray(content)
    for place, value in flips:
        damaged[int(place * len(damaged))] ^= value
    path.write_bytes(damaged)
    return path


FLIPS = st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255))


@pytest.fixture(scope="module")
def unchecked(recorded: bytes) -> bytes:
    """The same recording without compression and checksums, so that damage reaches the messages themselves."""
    out = io.BytesIO()
    writer = Writer(out, chunk_size=4000, compression=CompressionType.NONE, enable_crcs=False, enable_data_crcs=False)
    writer.start(profile="ros2")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for schema, channel, message in make_reader(io.BytesIO(recorded)).iter_messages():
        if schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(channel.topic, "cdr", schemas[schema.id])
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
    writer.finish()
    return out.getvalue()


@given(flips=st.lists(FLIPS, min_size=1, max_size=200))
def test_damage_that_no_checksum_finds(
    unchecked: bytes, tmp_path: Path, capsys, flips: list[tuple[float, int]]
) -> None:
    """Wrong numbers cannot be told from right ones here; but there is an answer, and it is valid."""
    check_answer(*analyze_quietly(flipped(unchecked, flips, tmp_path / "damaged.mcap"), capsys))


@settings(max_examples=2)
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=12458)  # a gap as long as a lap
def test_damaged_recordings_are_drawn_too(unchecked: bytes, tmp_path: Path, capsys, seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = (rng.integers(len(unchecked) // 2, len(unchecked), 60) + 0.5) / len(unchecked)
    flips = [(float(place), int(rng.integers(1, 256))) for place in places]
    path = flipped(unchecked, flips, tmp_path / "damaged.mcap")
    check_answer(*analyze_quietly(path, capsys, "--out", str(tmp_path / "out")))


def test_what_cannot_be_worked_out_names_its_file_and_leaves_the_others(
    recorded: bytes, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "good.mcap").write_bytes(recorded)
    (tmp_path / "bad.mcap").write_bytes(recorded)

    def figures(ride: Any) -> Any:
        if next(numbers) == 0:
            raise ValueError("array of sample points is empty")
        return ride_figures(ride)

    monkeypatch.setattr("bike_analysis.figures.metrics.ride_figures", figures)
    for paths, code in ((["bad.mcap"], 2), (["bad.mcap", "good.mcap"], 1)):
        numbers = itertools.count()
        assert main(["analyze", *(str(tmp_path / path) for path in paths), "--json"]) == code
        (told,) = capsys.readouterr().err.splitlines()
        assert told.endswith("bad.mcap: its figures cannot be worked out (array of sample points is empty)")


def test_one_bad_file_among_good_ones(recorded: bytes, tmp_path: Path, capsys) -> None:
    good, bad = tmp_path / "good.mcap", tmp_path / "bad.mcap"
    good.write_bytes(recorded)
    bad.write_bytes(b"nothing of this kind")
    code = main(["analyze", str(good), str(bad), str(tmp_path / "missing.mcap"), "--json"])
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert (code, result["ok"]) == (1, False)
    assert len(result["figures"]["recordings"]) == 1
    assert [line.split(":")[1] for line in captured.err.splitlines()] == [" left out"] * 2
    assert main(["analyze", str(bad), "--json"]) == 2
