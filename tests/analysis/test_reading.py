"""What is read is what was written, whole or torn; what is no ride gets one clear error."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer
from rosbags.highlevel import AnyReader

from bike_analysis import open_ride
from bike_analysis.read.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.read.container import MAGIC, Container, RecordingError, find_files
from bike_analysis.read.messages import STATE_QUANTITIES, Table
from bike_analysis.read.reading import forward_time, read_recording
from bike_sim.recording.definitions import MessageType, message_type
from bike_sim.recording.recorder import RideRecorder
from bike_training.replay import read_rides
from tests.bags import split_recording

COLUMN_NAMES = ("time_s", "episode", "step", *(quantity.name for quantity in STATE_QUANTITIES))


@pytest.fixture(scope="module")
def recorded(writer, circle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two rides in many small chunks."""
    path = tmp_path_factory.mktemp("recorded") / "ride.mcap"
    first = circle(
        steps=60, events=[{"step": 30, "kind": 4, "time": 1.5, "progress": 6.0, "value": 1.5, "text": "Lap"}]
    )
    second = circle(steps=40, episode=2, start_s=10.0, offset=-0.2, latency_ms=(0.1, 0.4))
    return writer.write(path, [first, second], chunk_bytes=3000, notes={"policy": "closed form"})


def columns_by_rosbags(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    rows = []
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == "/bike/state"]
        for connection, _, data in reader.messages(connections=connections):
            rows.append(reader.deserialize(data, connection.msgtype))
    return {name: np.array([getattr(row, name) for row in rows]) for name in names}


def test_columns_agree_with_rosbags(recorded: Path) -> None:
    recording = read_recording(recorded)
    names = [name for name in COLUMN_NAMES if name != "time_s"]
    expected = columns_by_rosbags(recorded, names)
    for name in names:
        np.testing.assert_array_equal(getattr(recording.states, name), expected[name], err_msg=name)
    assert len(recording.states) == 100
    assert not recording.truncated
    assert recording.warnings == ()
    assert recording.notes == {"policy": "closed form"}
    assert recording.vehicle == "whipple"


def test_other_topics_are_read(recorded: Path) -> None:
    recording = read_recording(recorded)
    assert [c.episode for c in recording.courses] == [1, 2]
    course = recording.courses[0]
    assert (course.name, course.closed, course.section_names) == ("circle", True, ("first half", "second half"))
    assert course.length == pytest.approx(20 * np.pi)
    assert [(e.kind, e.step, e.text) for e in recording.events] == [("lap", 30, "Lap")]
    assert len(recording.commands) == 59 + 39
    assert [(x.median_s, x.p99_s) for x in recording.latencies] == [(1e-4, 4e-4)] * 2
    assert np.all(np.diff(recording.states.order) > 0)
    np.testing.assert_allclose(recording.states.time_s[:3], [1.0, 1.05, 1.10], rtol=0, atol=1e-9)


@pytest.fixture
def split(writer, circle, tmp_path: Path) -> Path:
    """A recording in three files, a second of riding each."""
    whole = writer.write(tmp_path / "whole.mcap", [circle(steps=60)])
    folder = split_recording(whole, tmp_path / "tour", 0.99)
    assert [path.name for path in find_files(folder)] == ["tour_0.mcap", "tour_1.mcap", "tour_2.mcap"]
    return folder


def list_only(folder: Path, count: int) -> None:
    """Let metadata.yaml list the first files only, as a killed recorder leaves it."""
    file = folder / "metadata.yaml"
    content = yaml.safe_load(file.read_text())
    information = content["rosbag2_bagfile_information"]
    information["relative_file_paths"] = information["relative_file_paths"][:count]
    file.write_text(yaml.safe_dump(content))


def test_a_killed_recorder_lists_what_it_finished_and_the_rest_is_read_too(split: Path) -> None:
    whole = read_recording(split)
    list_only(split, 1)
    (split / "other_7.mcap").write_bytes(b"another recording")
    (split / "tour_10.mcap").write_bytes((split / "tour_2.mcap").read_bytes()[:-100])
    (split / "tour_2.mcap").unlink()  # the number counts, not the alphabet
    recording = read_recording(split)
    np.testing.assert_array_equal(recording.states.step, whole.states.step)
    assert recording.truncated
    (told,) = recording.warnings
    assert told.startswith("tour_10.mcap is torn: ")


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_file_that_is_missing_is_named_and_the_others_are_read(split: Path, lost: int) -> None:
    whole = read_recording(split)
    (split / f"tour_{lost}.mcap").unlink()
    recording = read_recording(split)
    assert recording.states.step.tolist() == [k for k in whole.states.step if k // 20 != lost]
    assert recording.truncated
    assert recording.warnings == (f"tour_{lost}.mcap is missing: metadata.yaml lists it",)


@pytest.mark.parametrize("content", [b"", b"\x89MC", b"not of this kind"])
@pytest.mark.parametrize("lost", [0, 2])
def test_a_file_that_cannot_be_read_does_not_take_the_others_with_it(split: Path, lost: int, content: bytes) -> None:
    whole = read_recording(split)
    (split / f"tour_{lost}.mcap").write_bytes(content)
    recording = read_recording(split)
    assert recording.states.step.tolist() == [k for k in whole.states.step if k // 20 != lost]
    assert recording.truncated
    (told,) = recording.warnings
    assert told.startswith(f"left out: {split}/tour_{lost}.mcap ")
    _, (recorded,) = read_rides(split)
    np.testing.assert_array_equal(recorded.columns["x"], recording.states.x)
    for number in range(3):
        (split / f"tour_{number}.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=r"tour_0\.mcap"):
        read_recording(split)


def assert_prefix(path: Path, whole: Path) -> None:
    full, torn = read_recording(whole), read_recording(path)
    count = len(torn.states)
    assert torn.truncated
    assert "torn" in torn.warnings[0]
    assert 0 < count <= len(full.states)
    for name in COLUMN_NAMES:
        np.testing.assert_array_equal(getattr(torn.states, name), getattr(full.states, name)[:count], err_msg=name)
    np.testing.assert_array_equal(torn.commands.steering, full.commands.steering[: len(torn.commands)])


def first_state_end(path: Path) -> int:
    """End of the first chunk that has a state, in bytes from the file's begin."""
    states = set()
    with path.open("rb") as file:
        for chunk in StreamReader(file, emit_chunks=True).records:
            for record in breakup_chunk(chunk) if isinstance(chunk, Chunk) else []:
                if isinstance(record, Channel) and record.topic == "/bike/state":
                    states.add(record.id)
                if isinstance(record, Message) and record.channel_id in states:
                    return file.tell()
    raise AssertionError(f"{path} has no state")


@given(data=st.data())
def test_cut_at_any_byte(recorded: Path, tmp_path: Path, data: st.DataObject) -> None:
    content = recorded.read_bytes()
    length = data.draw(st.integers(0, len(content) - 1))
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(content[:length])
    if length >= first_state_end(recorded):
        assert_prefix(torn, recorded)
        assert len(read_recording(torn).states) > 20 or length < len(content) // 2, "every whole chunk is read"
        return
    with pytest.raises(RecordingError) as caught:
        read_recording(torn)
    assert str(torn) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_can_be_read_twice(recorded: Path) -> None:
    box = Container(recorded)
    first = list(box.messages())
    counts = dict(box.counts)
    assert sum(counts.values()) == len(first) > 0
    assert list(box.messages()) == first
    assert box.counts == counts


@given(place=st.floats(0.0, 1.0, exclude_max=True), value=st.integers(1, 255))
@example(place=0.0, value=1)
def test_damage_never_gives_wrong_numbers_or_a_traceback(
    recorded: Path, tmp_path: Path, place: float, value: int
) -> None:
    content = bytearray(recorded.read_bytes())
    content[int(place * len(content))] ^= value
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    try:
        recording = read_recording(damaged)
    except RecordingError:
        return
    assert_part(recording.states, read_recording(recorded).states)


def assert_part(part: Table, whole: Table) -> None:
    """Every state that is left is one that was written."""
    row = {key: k for k, key in enumerate(zip(whole.episode.tolist(), whole.step.tolist(), strict=True))}
    rows = [row[key] for key in zip(part.episode.tolist(), part.step.tolist(), strict=True)]
    assert rows == sorted(rows)
    for name in COLUMN_NAMES:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[rows], err_msg=name)


def chunk_places(path: Path) -> list[tuple[int, int]]:
    """Begin and end of each chunk in the file."""
    with path.open("rb") as file:
        return [
            (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length)
            for index in make_reader(file).get_summary().chunk_indexes
        ]


@pytest.mark.parametrize("which", [0, 1, -1])
def test_a_damaged_chunk_is_left_out_and_the_rest_is_read(recorded: Path, tmp_path: Path, which: int) -> None:
    """Also the first one, which described the topics: the summary at the file's end describes them again."""
    content = bytearray(recorded.read_bytes())
    begin, end = chunk_places(recorded)[which]
    content[(begin + end) // 2] ^= 0x55
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    part, whole = read_recording(damaged), read_recording(recorded)
    assert part.truncated
    assert "1 part is damaged and left out" in part.warnings[0]
    assert part.message_count < whole.message_count
    assert len(part.states) > len(whole.states) - 20
    assert_part(part.states, whole.states)


def declare(content: bytearray, at: int, value: int) -> bytes:
    content[at : at + 8] = value.to_bytes(8, "little")
    return bytes(content)


@pytest.mark.parametrize("length", [2**31, 2**40, 2**63, 2**64 - 1])
@pytest.mark.parametrize("what", ["record", "uncompressed", "compressed"])
def test_huge_declared_lengths_do_not_eat_memory(recorded: Path, tmp_path: Path, length: int, what: str) -> None:
    """The third chunk claims to be huge; nothing of that size is allocated."""
    begin, _ = chunk_places(recorded)[2]
    place = {"record": begin + 1, "uncompressed": begin + 9 + 16, "compressed": begin + 9 + 28 + 4 + len("zstd")}[what]
    huge = tmp_path / "huge.mcap"
    huge.write_bytes(declare(bytearray(recorded.read_bytes()), place, length))
    tracemalloc.start()
    part = read_recording(huge)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 64e6
    assert part.truncated
    assert_part(part.states, read_recording(recorded).states)


def test_a_huge_frame_inside_a_chunk_does_not_eat_memory(tmp_path: Path) -> None:
    """A few kilobytes that unpack to gigabytes, with honest and with lying lengths around them."""
    bomb = zstandard.ZstdCompressor().compress(bytes(2**30))
    for declared in (2**30, 1000):
        head = struct.pack("<QQQII", 0, 0, declared, 0, 4) + b"zstd" + struct.pack("<Q", len(bomb))
        record = struct.pack("<BQ", 6, len(head) + len(bomb)) + head + bomb
        path = tmp_path / "bomb.mcap"
        path.write_bytes(MAGIC + record)
        tracemalloc.start()
        with pytest.raises(RecordingError, match="torn"):
            read_recording(path)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 64e6


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\x89MCA", "first 8 bytes"),
        (b"SQLite format 3\0" + bytes(100), "SQLite"),
        (b"#ROSBAG V2.0\n" + bytes(100), "ROS 1"),
        (b"a,b\n1,2\n", "not an MCAP recording"),
        (b"\x89MCAP0\r\n", "torn before its first whole chunk"),
        (b"\x89MCAP0\r\n" + bytes(1000), "torn before its first whole chunk"),
    ],
)
def test_foreign_files(content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)


def test_missing_files(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nothing\.mcap"):
        read_recording(tmp_path / "nothing.mcap")
    with pytest.raises(FileNotFoundError, match=r"no \.mcap file"):
        read_recording(tmp_path)


def test_recordings_without_our_topics(tmp_path: Path, writer, circle) -> None:
    with RideRecorder(tmp_path / "foreign.mcap") as recorder:
        recorder.add_topic("/chatter", MessageType("std_msgs/msg/String", "string data\n"))
        recorder.write("/chatter", b"\0\1\0\0" + (3).to_bytes(4, "little") + b"hi\0", 1)
    with pytest.raises(RecordingError, match=r"/chatter \(std_msgs/msg/String\)"):
        read_recording(tmp_path / "foreign.mcap")
    writer.write(tmp_path / "idle.mcap", [])
    with pytest.raises(RecordingError, match="holds no state"):
        read_recording(tmp_path / "idle.mcap")
    with (tmp_path / "json.mcap").open("wb") as file:
        foreign = Writer(file)
        foreign.start(profile="x-json")
        foreign.finish()
    with pytest.raises(RecordingError, match="profile 'x-json'"):
        read_recording(tmp_path / "json.mcap")


@pytest.mark.parametrize("fault", ["set back", "set forward and back", "shuffled", "backwards"])
def test_a_clock_that_goes_back_does_not_shorten_a_lap(writer, circle, tmp_path: Path, fault: str) -> None:
    right = 30.0 + 0.05 * np.arange(700)
    wrong = {
        "set back": right - np.where(np.arange(700) >= 450, 20.0, 0.0),
        "set forward and back": right + np.where(np.arange(700) == 450, 1e6, 0.0),
        "shuffled": np.random.default_rng(1).permutation(right),
        "backwards": right[::-1],
    }[fault]
    (expected,), (found,) = (
        open_ride(writer.write(tmp_path / f"{name}.mcap", [circle(steps=700, stamps=stamps)])).rides
        for name, stamps in (("right", right), ("wrong", wrong))
    )
    assert expected.recording.warnings == ()
    assert [lap.duration_s for lap in found.laps] == pytest.approx([lap.duration_s for lap in expected.laps])
    assert len(found.laps) == 2
    assert found.figures.duration_s == pytest.approx(0.05 * 699)
    assert found.figures.command_delay_max_s == pytest.approx(0.0)
    assert found.states.time_s[0] == pytest.approx(wrong[0])
    (told,) = found.recording.warnings
    assert told.startswith("the stamps of ride 1 go back in time ")
    if fault == "set back":
        assert told.endswith(" once, first after step 449: its time is counted from its steps")


def test_time_that_stands_still_is_no_warning_and_the_period_may_be_unknown() -> None:
    episode, step = np.array([1, 1, 1, 2, 2, 2]), np.array([0, 1, 2, 0, 1, 2])
    unknown = np.full(6, np.nan)
    time_s, told = forward_time(np.array([5.0, 5.0, 6.0, 1.0, 1.5, 2.0]), episode, step, unknown)
    assert time_s.tolist() == [5.0, 5.0, 6.0, 1.0, 1.5, 2.0]
    assert told == []
    time_s, told = forward_time(np.array([5.0, 5.5, 3.0, 1.0, 0.5, 0.2]), episode, step, unknown)
    assert time_s.tolist() == [5.0, 5.5, 6.0, 1.0, 1.0, 1.0]
    assert ["ride 1 go back in time once" in told[0], "ride 2 go back in time 2 times" in told[1]] == [True, True]


def test_missing_topics_are_a_warning(writer, circle, tmp_path: Path) -> None:
    recording = read_recording(writer.write(tmp_path / "only.mcap", [circle(steps=10)], topics=["/bike/state"]))
    assert len(recording.states) == 10
    assert len(recording.commands) == 0
    assert recording.courses == ()
    assert any("/bike/command" in warning for warning in recording.warnings)


def write_states_of(definition: str, tmp_path: Path, payload: bytes) -> Path:
    with RideRecorder(tmp_path / "other.mcap", overwrite=True) as recorder:
        recorder.add_topic("/robot/state", MessageType("bike_msgs/msg/BikeState", definition))
        recorder.write("/robot/state", payload, 0)
    return tmp_path / "other.mcap"


def test_other_versions_of_the_state(tmp_path: Path) -> None:
    header = message_type("bike_msgs/msg/BikeCommand").definition.split("=" * 80, 1)[1]
    body = "std_msgs/Header header\nuint32 episode\nuint32 step\nfloat64 x\nfloat64 y\n"
    stamp = b"\0\1\0\0" + bytes(8) + (1).to_bytes(4, "little") + b"\0" + bytes(3)  # frame_id "", padded to four bytes
    numbers = (7).to_bytes(4, "little") + bytes(4) + np.array([1.5, -2.5, 0.25]).tobytes()
    older = write_states_of(f"{body}float64 lateral_error\n{'=' * 80}{header}", tmp_path, stamp + numbers)
    recording = read_recording(older)
    assert recording.namespace == "/robot"
    assert (recording.states.episode[0], recording.states.x[0], recording.states.y[0]) == (7, 1.5, -2.5)
    assert recording.states.lateral_error[0] == 0.25
    assert np.isnan(recording.states.roll[0])
    assert any("roll" in warning for warning in recording.warnings)
    without = read_recording(write_states_of(f"{body}{'=' * 80}{header}", tmp_path, stamp + numbers))
    assert np.isnan(without.states.lateral_error[0])
    assert any("has no" in warning and "lateral_error" in warning for warning in without.warnings)
    foreign = write_states_of(f"std_msgs/Header header\nfloat64 voltage\n{'=' * 80}{header}", tmp_path, stamp + numbers)
    with pytest.raises(RecordingError, match="none of the known fields"):
        read_recording(foreign)
    broken = write_states_of("this is no definition", tmp_path, stamp + numbers)
    with pytest.raises(RecordingError, match="lacks the type bike_msgs/msg/this"):
        read_recording(broken)
    short = write_states_of(f"{body}float64 lateral_error\n{'=' * 80}{header}", tmp_path, (stamp + numbers)[:-1])
    with pytest.raises(RecordingError, match=r"of \d+ bytes"):
        read_recording(short)


def write_vehicles(path: Path, messages, *topics: str) -> Path:
    """A state on each topic."""
    with RideRecorder(path) as recorder:
        for place, topic in enumerate(topics):
            message = messages.make("bike_msgs/msg/BikeState", header=messages.header(1.0), x=float(place))
            recorder.add_topic(topic, "bike_msgs/msg/BikeState")
            recorder.write(topic, messages.cdr("bike_msgs/msg/BikeState", message), 0)
    return path


def test_several_vehicles_must_be_chosen(tmp_path: Path, messages) -> None:
    path = write_vehicles(tmp_path / "two.mcap", messages, "/red/state", "/blue/state")
    with pytest.raises(RecordingError, match="/blue, /red"):
        read_recording(path)
    assert read_recording(path, namespace="red").namespace == "/red"
    with pytest.raises(RecordingError, match="no states of /green"):
        read_recording(path, namespace="/green")


def test_the_usual_vehicle_is_read_with_a_warning_that_names_the_others(tmp_path: Path, messages) -> None:
    path = write_vehicles(tmp_path / "two.mcap", messages, "/abc/state", "/bike/state", "/state")
    recording = read_recording(path)
    assert (recording.namespace, recording.states.x[0]) == ("/bike", 1.0)
    (told,) = [text for text in recording.warnings if "several vehicles" in text]
    assert "/, /abc, /bike" in told
    assert "--vehicle" in told
    assert not any("several" in text for text in read_recording(path, "abc").warnings)


def test_a_vehicle_in_the_root_namespace(tmp_path: Path, messages) -> None:
    path = write_vehicles(tmp_path / "root.mcap", messages, "/state", "/abc/state")
    for name in ("/", ""):
        recording = read_recording(path, name)
        assert (recording.namespace, recording.states.x[0]) == ("", 0.0)
        _, (recorded,) = read_rides(path, name)
        assert recorded.columns["x"].tolist() == [0.0]
    with pytest.raises(RecordingError, match="no states of /bike; it has /, /abc"):
        read_recording(path, "/bike")
    alone = read_recording(write_vehicles(tmp_path / "alone.mcap", messages, "/state"))
    assert alone.namespace == ""
    with pytest.raises(RecordingError, match="no states of /; it has /abc"):
        read_recording(write_vehicles(tmp_path / "abc.mcap", messages, "/abc/state"), "/")


def test_states_are_read_from_topics_named_state(tmp_path: Path, messages) -> None:
    foo = write_vehicles(tmp_path / "foo.mcap", messages, "/foo", "/bike/mystate")
    with pytest.raises(
        RecordingError, match=r"foo\.mcap: .* a topic named state, here they are on /bike/mystate, /foo"
    ):
        read_recording(foo)
    with pytest.raises(RecordingError, match="no states of /foo; it has none"):
        read_recording(foo, "foo")
    both = read_recording(write_vehicles(tmp_path / "both.mcap", messages, "/foo", "/red/state"))
    assert (both.namespace, both.states.x[0]) == ("/red", 1.0)


def test_latencies_are_those_of_the_chosen_vehicle(tmp_path: Path, messages) -> None:
    kind, make = "diagnostic_msgs/msg/DiagnosticArray", messages.make

    def status(name: str, **values: float) -> Any:
        pairs = [make("diagnostic_msgs/msg/KeyValue", key=k, value=str(v)) for k, v in values.items()]
        return make("diagnostic_msgs/msg/DiagnosticStatus", name=name, level=0, values=pairs)

    def latencies(vehicle: str, *statuses: Any) -> tuple[list[float], int | None]:
        path = tmp_path / "two.mcap"
        state = messages.cdr("bike_msgs/msg/BikeState", make("bike_msgs/msg/BikeState", header=messages.header(1.0)))
        with RideRecorder(path, overwrite=True) as recorder:
            for name in ("bike", "bike2"):
                recorder.add_topic(f"/{name}/state", "bike_msgs/msg/BikeState")
                recorder.write(f"/{name}/state", state, 0)
            recorder.add_topic("/diagnostics", kind)
            recorder.write("/diagnostics", messages.cdr(kind, make(kind, status=list(statuses))), 0)
        recording = read_recording(path, vehicle)
        return [latency.median_s for latency in recording.latencies], recording.dropped_messages

    one, two = status("bike/drive", latency_median_ms=1), status("/bike2/drive", latency_median_ms=100)
    assert latencies("bike", one, two) == ([1e-3], None)
    assert latencies("bike2", one, two) == ([0.1], None)
    assert latencies("bike", status("bike/sim_node"), two) == ([], None)  # that of another rider is no stand-in
    assert latencies("bike", status("rider", latency_median_ms=3)) == ([3e-3], None)
    first, second = status("bike/record", messages_dropped=1), status("bike2/record", messages_dropped=2)
    assert latencies("bike", one, first, second) == ([1e-3], 1)
    assert latencies("bike", one, second) == ([1e-3], 2)  # one recorder may write down both


DEFINITION = """bool flag
float64[] values
uint8 small
string name
float32[3] triple
int64 number
geometry_msgs/Point point
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
"""


@given(
    rows=st.lists(
        st.tuples(
            st.booleans(),
            st.integers(0, 2),
            st.integers(0, 255),
            st.text("abü", max_size=5),
            st.integers(-(2**63), 2**63 - 1),
        ),
        min_size=1,
        max_size=12,
    ),
    little=st.booleans(),
)
def test_columns_of_mixed_layouts_agree_with_rosbags(rows: list[tuple], little: bool) -> None:
    """Strings and arrays of any length shift what follows; each message must still be read right."""
    schema = MessageSchema("some_msgs/msg/Mixed", DEFINITION)
    store = schema._store
    mixed, point = store.types["some_msgs/msg/Mixed"], store.types["geometry_msgs/msg/Point"]
    encoded = []
    for flag, length, small, name, number in rows:
        values, triple = np.arange(float(length)), np.array([1, 2, 3], np.float32)
        message = mixed(flag, values, small, name, triple, number, point(0.5, small + 0.25, -1.0))
        encoded.append(bytes(store.serialize_cdr(message, "some_msgs/msg/Mixed", little_endian=little)))
    fields = ["flag", "small", "triple", "number", "point.y"]
    columns = read_columns(schema, encoded, fields)
    expected = [schema.decode(data) for data in encoded]
    assert columns["flag"].tolist() == [m.flag for m in expected] == [row[0] for row in rows]
    assert columns["small"].tolist() == [m.small for m in expected]
    assert columns["number"].tolist() == [m.number for m in expected] == [row[4] for row in rows]
    assert columns["triple"].tolist() == [[1.0, 2.0, 3.0]] * len(rows)
    assert columns["point.y"].tolist() == [row[2] + 0.25 for row in rows]
    if len({row[1] for row in rows}) > 1:
        with pytest.raises(SchemaError, match="values"):
            read_columns(schema, encoded, ["values"])


def read_columns(schema: MessageSchema, messages: list[bytes], fields: list[str]) -> dict[str, np.ndarray]:
    """Columns of messages; the first half is one block, the others are another."""
    reader, middle = ColumnReader(schema, fields), len(messages) // 2
    for part in (messages[:middle], messages[middle:]):
        ends = np.cumsum([len(data) for data in part], dtype=np.int64)
        begins = ends - np.array([len(data) for data in part], dtype=np.int64)
        assert reader.add_block(np.frombuffer(b"".join(part), np.uint8), begins, ends).all()
    return reader.finish()


def test_excess_bytes_after_a_message_are_ignored_and_can_be_cut_off(messages) -> None:
    """rclpy's serialize_message leaves arbitrary bytes behind a message with empty arrays."""
    name = "bike_msgs/msg/Course"
    schema = MessageSchema(name, message_type(name).definition)
    exact = messages.cdr(name, messages.make(name, name="a", section_names=["b", "cde"]))
    padded = exact + b"\xa5" * 28
    assert schema.decode(padded).section_names == ["b", "cde"]
    assert schema.trim(padded) == exact
    assert schema.trim(exact) == exact
    for wrong in (b"", b"\1\1\0\0", exact[:-1], b"\0\7" + exact[2:]):
        with pytest.raises(SchemaError, match=r"bike_msgs/msg/Course"):
            schema.decode(wrong)


def test_unchunked_files_are_read(tmp_path: Path, messages) -> None:
    described = message_type("bike_msgs/msg/BikeState")
    message = messages.make("bike_msgs/msg/BikeState", header=messages.header(1.0), episode=3, x=1.0)
    with (tmp_path / "flat.mcap").open("wb") as file:
        flat = Writer(file, use_chunking=False)
        flat.start(profile="ros2")
        schema = flat.register_schema(described.name, "ros2msg", described.definition.encode())
        channel = flat.register_channel("/bike/state", "cdr", schema)
        for number in range(3):
            flat.add_message(channel, number, messages.cdr(described.name, message), number)
        flat.finish()
    recording = read_recording(tmp_path / "flat.mcap")
    assert recording.states.episode.tolist() == [3, 3, 3]
    torn = tmp_path / "torn.mcap"
    whole = (tmp_path / "flat.mcap").read_bytes()
    last = whole.rindex(messages.cdr(described.name, message))
    for length, left in ((len(whole) - 200, 3), (last + 10, 2)):  # within the summary, and within the last message
        torn.write_bytes(whole[:length])
        container = Container(torn)
        assert len(list(container.messages())) == left
        assert container.truncated
