"""The recorder writes what rosbag2's readers expect, and leaves a readable file however it ends."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg

from bike_sim.recording.definitions import MessageType, ament_share, message_type
from bike_sim.recording.recorder import RideRecorder


def read_with_rosbags(path: Path) -> list[tuple[str, int, object]]:
    with AnyReader([path]) as reader:
        return [(c.topic, t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages()]


def test_definition_holds_each_nested_type_once() -> None:
    text = message_type("bike_msgs/msg/CoursePoints").definition
    headings = [line for line in text.splitlines() if line.startswith("MSG: ")]
    assert headings == ["MSG: geometry_msgs/Point", "MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]
    assert text.count("=" * 80 + "\n") == 3
    assert not text.startswith("=")
    for kind in ("BikeState", "BikeCommand", "Course", "CoursePoints", "LeanHistory", "RideEvent"):
        name = f"bike_msgs/msg/{kind}"
        assert name in get_types_from_msg(message_type(name).definition, name)


def test_wrong_and_unknown_types_are_refused_by_name() -> None:
    for name in ("BikeState", "bike_msgs/BikeState", "bike_msgs/srv/Reset", "/msg/A", "a/msg/"):
        with pytest.raises(ValueError, match="package/msg/Type"):
            message_type(name)
    with pytest.raises(FileNotFoundError, match="no message 'Nothing'"):
        message_type("bike_msgs/msg/Nothing")
    with pytest.raises(FileNotFoundError, match="nowhere_msgs"):
        message_type("nowhere_msgs/msg/A")


def test_installed_packages_are_found_through_the_ament_index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    messages = tmp_path / "share" / "some_msgs" / "msg"
    messages.mkdir(parents=True)
    (messages / "A.msg").write_text("float64 x # m\n")
    hashes = {"type_hashes": [{"type_name": "some_msgs/msg/A", "hash_string": "RIHS01_00"}]}
    (messages / "A.json").write_text(json.dumps(hashes))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'other'}{os.pathsep}{tmp_path}")
    with pytest.raises(FileNotFoundError, match="is the workspace built"):
        ament_share("some_msgs")  # the directory is there, but nothing registered the package
    marker = tmp_path / "share" / "ament_index" / "resource_index" / "packages" / "some_msgs"
    marker.parent.mkdir(parents=True)
    marker.touch()
    described = message_type("some_msgs/msg/A")
    assert described.definition == "float64 x # m\n"
    assert described.type_hash == "RIHS01_00"


def test_directory_is_a_rosbag2_recording(writer, circle, tmp_path: Path) -> None:
    path = writer.write(tmp_path / "first_ride", [circle(steps=20)], notes={"vehicle": "whipple"})
    assert path == tmp_path / "first_ride" / "first_ride_0.mcap"
    with Reader(tmp_path / "first_ride") as reader:
        assert reader.message_count == 20 + 19 + 1
        assert reader.duration == 19 * 50_000_000 + 1  # rosbags counts the last nanosecond
        connection = next(c for c in reader.connections if c.topic == "/bike/course")
        assert connection.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
        assert connection.ext.offered_qos_profiles[0].depth == 1
    information = yaml.safe_load((tmp_path / "first_ride" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["custom_data"] == {"vehicle": "whipple"}
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
    assert counts == {"/bike/state": 20, "/bike/command": 19, "/bike/course": 1, "/bike/events": 0, "/diagnostics": 0}


def test_container_follows_rosbag2(writer, circle, tmp_path: Path) -> None:
    path = writer.write(tmp_path / "ride.mcap", [circle(steps=200)])
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        records = {m.name: m.metadata for m in reader.iter_metadata()}
    assert summary.statistics.message_count == 200 + 199 + 1
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 1
    assert {i.compression for i in summary.chunk_indexes} == {"zstd"}
    inside = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
    beside = yaml.safe_load((tmp_path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert inside == beside
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
        profile = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        assert profile[0]["reliability"] == "reliable"
        assert "&" not in channel.metadata["offered_qos_profiles"]
        described = message_type(schema.name)
        assert channel.metadata.get("topic_type_hash", "") == described.type_hash


def test_metadata_file_never_replaces_that_of_another_recording(writer, circle, tmp_path: Path) -> None:
    writer.write(tmp_path / "one.mcap", [circle(steps=5)])
    first = (tmp_path / "metadata.yaml").read_text()
    writer.write(tmp_path / "two.mcap", [circle(steps=6)])
    assert (tmp_path / "metadata.yaml").read_text() == first
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "metadata.yaml").write_text("name: not a recording\n")
    writer.write(tmp_path / "other" / "three.mcap", [circle(steps=5)])
    assert (tmp_path / "other" / "metadata.yaml").read_text() == "name: not a recording\n"


@pytest.mark.parametrize(("name", "file"), [("ride.mcap", "ride.mcap"), ("bag", "bag/bag_0.mcap")])
def test_no_metadata_is_left_of_a_recording_that_is_replaced(name: str, file: str, tmp_path: Path) -> None:
    """A kill would leave it beside a file that it does not describe. Whether the file itself is still there or not."""
    metadata = (tmp_path / file).parent / "metadata.yaml"
    for deleted in (False, True):
        RideRecorder(tmp_path / name, overwrite=True).close()
        assert metadata.exists()
        if deleted:
            (tmp_path / file).unlink()
        recorder = RideRecorder(tmp_path / name, overwrite=not deleted)
        assert not metadata.exists()
        recorder.close()
        assert metadata.exists()


def test_overwriting_needs_permission(writer, circle, tmp_path: Path) -> None:
    path = writer.write(tmp_path / "ride.mcap", [circle(steps=5)])
    with pytest.raises(FileExistsError, match=r"ride\.mcap"):
        writer.write(path, [circle(steps=6)])
    writer.write(path, [circle(steps=7)], overwrite=True)
    assert sum(topic == "/bike/state" for topic, _, _ in read_with_rosbags(path)) == 7


def test_misuse_gets_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="gzip"):
        RideRecorder(tmp_path / "a.mcap", compression="gzip")
    with pytest.raises(ValueError, match="chunk_bytes"):
        RideRecorder(tmp_path / "a.mcap", chunk_bytes=0)
    with RideRecorder(tmp_path / "ride.mcap") as recorder:
        with pytest.raises(ValueError, match="add_topic"):
            recorder.write("/bike/state", bytes(8), 0)
        recorder.add_topic("/bike/state", "bike_msgs/msg/BikeState")
        recorder.add_topic("/bike/state", "bike_msgs/msg/BikeState")  # the same again is no error
        with pytest.raises(ValueError, match="BikeCommand"):
            recorder.add_topic("/bike/state", "bike_msgs/msg/BikeCommand")
        with pytest.raises(ValueError, match="-1 ns"):
            recorder.write("/bike/state", bytes(8), -1)
        with pytest.raises(ValueError, match="3 bytes"):
            recorder.write("/bike/state", bytes(3), 0)
    recorder.close()
    with pytest.raises(ValueError, match="closed"):
        recorder.write("/bike/state", bytes(8), 0)


def test_the_file_is_finished_when_the_caller_fails(tmp_path: Path) -> None:
    def record_and_fail() -> None:
        with RideRecorder(tmp_path / "ride.mcap") as recorder:
            recorder.add_topic("/bike/state", "bike_msgs/msg/BikeState")
            recorder.write("/bike/state", bytes(2000), 5)
            raise RuntimeError("the caller")

    with pytest.raises(RuntimeError, match="the caller"):
        record_and_fail()
    with (tmp_path / "ride.mcap").open("rb") as file:
        assert make_reader(file).get_summary().statistics.message_count == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_disk_that_is_full_from_the_start_is_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "ride.mcap"
    path.symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"recording .*ride\.mcap stopped: No space left"):
        RideRecorder(path, overwrite=True)


FILLED = """
import os, resource, sys
sys.path[:0] = {path!r}
from bike_sim.recording.definitions import MessageType
from bike_sim.recording.recorder import RideRecorder
recorder = RideRecorder({file!r}, chunk_bytes=4096, compression="none")
recorder.add_topic("/blob", MessageType("some_msgs/msg/Blob", "uint64 number\\nuint8[] more\\n"))
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
try:
    for number in range(100_000):
        data = number.to_bytes(8, "little") + (1000).to_bytes(4, "little") + os.urandom(1000)
        recorder.write("/blob", bytes([0, 1, 0, 0]) + data, number)
except OSError as error:
    print(error)
recorder.close()
try:
    recorder.write("/blob", bytes(8), 0)
except ValueError as error:
    print(error)
"""


@settings(max_examples=4)
@given(limit=st.integers(30_000, 80_000))
def test_a_disk_that_fills_up_leaves_a_whole_file(limit: int, tmp_path: Path) -> None:
    folder = Path(tempfile.mkdtemp(dir=tmp_path))
    script = FILLED.format(path=sys.path, file=str(folder / "ride"), limit=limit)
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert re.fullmatch(r".*ride_0\.mcap stopped: File too large\n.*is closed\n", said)
    with Reader(folder / "ride") as reader:
        numbers = [int.from_bytes(data[4:12], "little") for *_, data in reader.messages()]
        assert reader.message_count == len(numbers)
    assert numbers == list(range(len(numbers)))
    # All but the chunk that had no room, and those that made room for the index and for metadata.yaml.
    assert len(numbers) * 1047 > limit - 4 * (4096 + 1047)
    assert (folder / "ride" / "metadata.yaml").exists()


BLOB = MessageType("some_msgs/msg/Blob", "uint8[] data\n")


def stored(path: Path) -> list[tuple[str, int, bytes]]:
    """Messages of a file in the order in which they were written; checksums are looked at."""
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        return [(channel.topic, message.log_time, message.data) for _, channel, message in messages]


MESSAGES = st.lists(
    st.tuples(
        st.sampled_from(["/a", "/b", "/b/c", "/späť"]),
        st.integers(0, 2**63 - 1),
        st.binary(min_size=4, max_size=300) | st.integers(4, 20_000).map(bytes),
    ),
    max_size=60,
)


@given(
    messages=MESSAGES,
    compression=st.sampled_from(["zstd", "lz4", "none"]),
    chunk_bytes=st.integers(1, 30_000),
    flush_every=st.integers(1, 20),
)
def test_any_bytes_on_any_topics_come_back(
    messages: list[tuple[str, int, bytes]],
    compression: str,
    chunk_bytes: int,
    flush_every: int,
    tmp_path: Path,
) -> None:
    folder = Path(tempfile.mkdtemp(dir=tmp_path)) / "bag"
    with RideRecorder(folder, compression=compression, chunk_bytes=chunk_bytes) as recorder:
        for count, (topic, log_time, data) in enumerate(messages):
            recorder.add_topic(topic, BLOB)
            recorder.write(topic, data, log_time)
            if count % flush_every == 0:
                recorder.flush()
        assert recorder.message_count == len(messages)
    assert {path.name for path in folder.iterdir()} == {"bag_0.mcap", "metadata.yaml"}
    assert stored(recorder.path) == messages
    assert recorder.bytes_written == recorder.path.stat().st_size
    with Reader(folder) as reader:
        by_rosbags = sorted((c.topic, t, bytes(data)) for c, t, data in reader.messages())
    assert by_rosbags == sorted(messages)


def test_a_directory_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    """Also one of several files, as rosbag2 makes it; others' files stay."""

    def record(overwrite: bool) -> None:
        with RideRecorder(tmp_path / "bag", overwrite=overwrite) as recorder:
            recorder.add_topic("/a", BLOB)
            recorder.write("/a", bytes(8), 0)

    record(overwrite=False)
    for name in ("bag_1.mcap", "bag_12.mcap", "bag_4.txt", "other_4.mcap"):
        (tmp_path / "bag" / name).write_text("old")
    with pytest.raises(FileExistsError, match=r"bag_0\.mcap exists already"):
        record(overwrite=False)
    record(overwrite=True)
    left = {path.name for path in (tmp_path / "bag").iterdir()}
    assert left == {"bag_0.mcap", "metadata.yaml", "bag_4.txt", "other_4.mcap"}


KILLED = """
import os, sys, time
sys.path[:0] = {path!r}
from pathlib import Path
from bike_sim.recording.definitions import MessageType
from bike_sim.recording.recorder import RideRecorder
kind = MessageType("some_msgs/msg/Blob", "float64 x\\n")
recorder = RideRecorder({file!r})
recorder.flush_period_s = 0.05
recorder.add_topic("/blob", kind)
for number in range(1000):
    recorder.write("/blob", number.to_bytes(4, "little") + os.urandom(100), number)
    time.sleep(0.001)
    if number == 300:
        print("go", flush=True)
"""


def test_a_killed_recorder_loses_no_more_than_the_flush_period(tmp_path: Path) -> None:
    from bike_analysis.read.container import Container

    file = tmp_path / "ride.mcap"
    script = KILLED.format(path=sys.path, file=str(file))
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"go\n"
        process.send_signal(signal.SIGKILL)
    container = Container(file)
    numbers = [int.from_bytes(m.data[:4], "little") for m in container.messages()]
    assert container.truncated
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > 300 - 100  # 100 messages take twice the flush period here
