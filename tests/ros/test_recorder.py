"""The recorder as a process: which topics it takes, and what a fault costs."""

from __future__ import annotations

import os
import re
import resource
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
from shape_msgs.msg import Plane
from std_msgs.msg import Float64, String

from bike_analysis.read.container import Container
from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_sim.ros import node_tools
from bike_sim.ros.isolation import DOMAIN_VARIABLE
from bike_sim.ros.node_tools import NANOSECONDS, time_to_message
from bike_sim.ros.record import SPECS, writing_settings
from bike_training.envs.node_process import NodeLost, NodeProcess
from bike_training.nodes import node_rides
from bike_training.nodes.node_rides import START_TIMEOUT, RideMonitor, ride_recorded

pytestmark = pytest.mark.ros


@pytest.fixture
def sender(ros: Any) -> Any:
    return ros.sender()


def counts_in(path: Path) -> Counter[str]:
    with path.open("rb") as file:
        return Counter(channel.topic for _, channel, _ in make_reader(file, validate_crcs=True).iter_messages())


def decoded(path: Path) -> list[tuple[str, Any]]:
    """Decode every message of a file with mcap-ros2-support."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]


# ------------------------------------------------------------------------------------------------------------ settings


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"chunk_size": 0}, "parameter chunk_size must be from 1 to"),
        ({"chunk_size": 1.5}, "parameter chunk_size must be a whole number, got 1.5"),
        ({"compression": "gzip"}, "parameter compression must be one of zstd, lz4, none, got 'gzip'"),
        ({"clock": "moon"}, "parameter clock must be one of simulated, wall, got 'moon'"),
        ({"topics": ["a"], "all_topics": True}, "all_topics and topics exclude each other"),
        ({"notes": ["no equals sign"]}, "'no equals sign' is not of the form name=text"),
    ],
)
def test_what_is_wrong_with_a_parameter_is_named(changes: dict[str, Any], words: str) -> None:
    values = {spec.name: spec.default for spec in SPECS} | changes
    with pytest.raises(ValueError, match=re.escape(words)):
        writing_settings({spec.name: spec.read(values[spec.name]) for spec in SPECS})


def test_settings_that_cannot_be_end_the_node_with_one_line(run_here: Any, tmp_path: Path) -> None:
    wrong: dict[str, dict[str, Any]] = {
        "'no good' is no name of a topic": {"topics": ["no good"]},
        "directory /dev/null cannot be made: File exists": {"path": "/dev/null/ride.mcap"},
        "exists already": {"path": str(tmp_path / "old.mcap")},
    }
    (tmp_path / "old.mcap").write_text("precious")
    for words, parameters in wrong.items():
        code, told = run_here("bike_sim.ros.record", **parameters)
        assert (code, told.count("\n")) == (2, 1), told
        assert told.startswith("record: ")
        assert words in told
    assert (tmp_path / "old.mcap").read_text() == "precious"


def test_the_recorder_starts_without_the_simulator() -> None:
    look = "import sys, bike_sim.ros.record; print({'numba', 'scipy', 'bike_sim.sim.simulator'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True).stdout == "set()\n"


# -------------------------------------------------------------------------------------------------------------- topics


def test_late_unknown_and_uninstalled_topics_are_no_error(
    ros: Any, sender: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hidden = tmp_path / "without" / "shape_msgs"  # the recorder's own process does not have this package
    hidden.mkdir(parents=True)
    (hidden / "__init__.py").write_text("raise ImportError('shape_msgs is not installed')\n")
    monkeypatch.setenv("PYTHONPATH", str(hidden.parent))
    chosen = ["late", "/never", "plane", "mixed"]
    strange = sender.create_publisher(Plane, "plane", 1)
    mixed = sender.create_publisher(String, "mixed", node_tools.SENDER_QOS)
    recorder = ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap"), topics=chosen)
    sender.until(lambda: "not there yet" in recorder.words)
    assert "recorded when they come: /bike/late, /never\n" in recorder.words
    late = sender.open(PointStamped, "late")
    other = sender.create_publisher(String, "other", 1)
    assert not other.get_subscription_count()
    poor = sender.open(String, "mixed", QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT))
    sender.until(lambda: mixed.get_subscription_count() == 1)
    for number in range(20):
        late.publish(PointStamped())
        strange.publish(Plane())
        mixed.publish(String(data="x" * number))
        poor.publish(String(data=f"poor {number}"))
        sender.during(0.02)
    sender.until(lambda: sender.figures().get("messages_written") == "60")
    assert recorder.end()[0] == 0
    assert counts_in(tmp_path / "ride.mcap") == {"/bike/late": 20, "/bike/mixed": 40}
    strings = [message.data for topic, message in decoded(tmp_path / "ride.mcap") if topic == "/bike/mixed"]
    assert sorted(strings) == sorted([f"poor {k}" for k in range(20)] + ["x" * k for k in range(20)])
    assert recorder.words.count("not there yet") == 1
    warnings = [line for line in recorder.words.splitlines() if "[WARN]" in line]
    assert len(warnings) == 1, warnings
    assert "/bike/plane of type shape_msgs/msg/Plane is not recorded: shape_msgs is not installed" in warnings[0]


def test_a_stamp_of_the_wall_clock_before_the_first_clock_is_no_simulated_time(
    ros: Any, sender: Any, tmp_path: Path
) -> None:
    recorder = ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap"))
    place, clock = sender.open(PointStamped, "place"), sender.open(Clock, "/clock")

    def publish(stamp_ns: int) -> None:
        message = PointStamped()
        message.header.stamp = time_to_message(stamp_ns)
        place.publish(message)
        sender.during(0.05)

    publish(time.time_ns())
    publish(3 * NANOSECONDS)  # somebody who knows the simulated time already
    clock.publish(Clock(clock=time_to_message(5 * NANOSECONDS)))
    sender.during(0.05)
    publish(time.time_ns())
    publish(64 * NANOSECONDS)
    assert recorder.end()[0] == 0
    with (tmp_path / "ride.mcap").open("rb") as content:
        messages = make_reader(content).iter_messages(["/bike/place"], log_time_order=False)
        assert [message.log_time // NANOSECONDS for _, _, message in messages] == [0, 3, 5, 64]
    assert recorder.words.count("get time 0 until a state or /clock comes") == 1


def test_all_topics_by_wall_clock(ros: Any, sender: Any, tmp_path: Path) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    static = sender.create_publisher(String, "/static", latched)
    static.publish(String(data="stays"))
    recorder = ros.start(
        "bike_sim.ros.record",
        path=str(tmp_path / "all"),
        all_topics=True,
        clock="wall",
        compression="lz4",
    )
    bare, hidden = sender.open(Float64, "/elsewhere/bare"), sender.create_publisher(Float64, "/_hidden", 1)
    began = time.time_ns()
    for number in range(60):
        bare.publish(Float64(data=float(number)))
        hidden.publish(Float64())
        sender.during(0.01)
    ended = time.time_ns()
    assert recorder.end()[0] == 0
    with AnyReader([tmp_path / "all"]) as reader:
        seen = [(c.topic, t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages()]
    numbers = [(t, message.data) for topic, t, message in seen if topic == "/elsewhere/bare"]
    assert [number for _, number in numbers] == list(range(60))
    assert all(began < t < ended for t, _ in numbers)
    assert "/rosout" in {topic for topic, *_ in seen}
    assert [message.data for topic, _, message in seen if topic == "/static"] == ["stays"]
    assert "/_hidden" not in {topic for topic, *_ in seen}
    with Reader(tmp_path / "all") as bag:
        assert bag.message_count == len(seen)


# -------------------------------------------------------------------------------------------------------------- faults


def test_a_kill_costs_less_than_a_second(ros: Any, sender: Any, tmp_path: Path) -> None:
    recorder = ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap"), clock="wall")
    publisher = sender.open(Float64, "number")
    sent: dict[int, float] = {}
    for number in range(500):
        sent[number] = time.monotonic()
        publisher.publish(Float64(data=float(number)))
        sender.during(0.005)
    killed_at = time.monotonic()
    recorder.process.send_signal(signal.SIGKILL)
    recorder.wait()
    container = Container(tmp_path / "ride.mcap")
    messages = list(container.messages())
    topics = {number: channel.topic for number, channel in container.channels.items()}
    numbers = [decode_float(m.data) for m in messages if topics[m.channel] == "/bike/number"]
    assert numbers == list(range(len(numbers)))
    assert container.truncated
    lost = [time_sent for number, time_sent in sent.items() if number >= len(numbers)]
    assert killed_at - min(lost, default=killed_at) < 1.0


def decode_float(data: bytes) -> int:
    return int(struct.unpack_from("<d", data, 4)[0])


def test_a_full_disk_ends_the_recording_and_not_the_ride(ros: Any, policy: str, tmp_path: Path) -> None:
    simulator = ros.simulator(course="circle")
    recorder = ros.start("bike_sim.ros.record", path=str(tmp_path / "ride"), chunk_size=16_384)
    probe = ros.probe()
    driver = ros.start("bike_policy.drive", policy=policy)
    probe.until(lambda: probe.records("state", "command") and probe.states[-1].step > 20)
    # The same as a full disk, for this process alone: no file of it may grow beyond this.
    file = tmp_path / "ride" / "ride_0.mcap"
    limit = file.stat().st_size + 100_000
    resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    assert recorder.wait() == 2
    complaints = [line for line in recorder.words.splitlines() if not line.startswith("[")]
    assert complaints == [f"record: recording {file} stopped: File too large"]
    step = probe.states[-1].step
    probe.until(lambda: probe.states[-1].step > step + 20)
    assert simulator.process.poll() is None
    assert driver.process.poll() is None
    probe.until(lambda: probe.reports[-1].level == DiagnosticStatus.ERROR)
    assert probe.reports[-1].message.endswith("File too large")
    with AnyReader([tmp_path / "ride"]) as reader:
        steps = [
            reader.deserialize(data, c.msgtype).step for c, _, data in reader.messages() if c.topic.endswith("state")
        ]
    assert steps == sorted(steps)
    assert len(steps) > 10
    assert file.stat().st_size <= limit


def ride_a_little(domain: int, recording: Path, **record: Any) -> None:
    ride_recorded(
        domain,
        {
            "record": {"path": str(recording), **record},
            "sim_node": {"course": "circle", "engine": "whipple", "time_step": 0.01, "mode": "lockstep"},
            "drive": {"policy": DEFAULT_POLICY},
        },
        title="circle",
        distance=10.0,
        longest=2.0,
    )


SLOW_SIMULATOR = """
import time
end = time.monotonic() + 4.5
while time.monotonic() < end:
    pass
from bike_sim.ros.sim_node import main
main()
"""


def test_a_start_that_works_for_long_is_waited_for_and_explained(
    ros: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As the first one on a machine, which compiles: limits count silence."""
    (tmp_path / "slow_simulator.py").write_text(SLOW_SIMULATOR)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(node_rides, "LONG_START", 1.0)
    parameters = {"course": "circle", "engine": "whipple", "time_step": 0.01}
    with RideMonitor(ros.domain) as monitor, NodeProcess("slow_simulator", parameters, ros.domain) as simulator:
        began = time.monotonic()
        monitor.pause(True, 4.0, [simulator])  # discovery is silent too, for longer on a slow machine
        assert time.monotonic() - began > 4.5
    assert capfd.readouterr().err == f"{node_rides.EXPLANATION}\n"


def test_a_ride_waits_for_its_recorder(ros: Any, tmp_path: Path) -> None:
    """Somebody else who listens to the states is no recorder."""
    simulator = ros.simulator(course="circle")
    ros.probe()
    with RideMonitor(ros.domain) as monitor:
        with pytest.raises(NodeLost, match="did not find each other within 2 s; missing: /bike/state"):
            monitor.wait_for_recorder(2.0, [], ["state"])
        record = {"path": str(tmp_path / "ride.mcap")}
        with NodeProcess("bike_sim.ros.record", record, ros.domain) as recorder:
            monitor.wait_for_recorder(START_TIMEOUT, [recorder], ["state", "course"])
            with pytest.raises(NodeLost, match="within 1 s; missing: /bike/command"):
                monitor.wait_for_recorder(1.0, [recorder], ["state", "command"])  # nobody drives
            recorder.finish()
    assert simulator.process.poll() is None
    counts = counts_in(tmp_path / "ride.mcap")
    assert counts["/bike/state"] > 0
    assert counts["/bike/course"] == 1


def test_a_recorder_that_cannot_close_its_file_fails_the_ride(
    ros: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ride whose recording was cut short by a full disk at its very end is not reported as if it were whole."""
    watch = RideMonitor.watch

    def watch_and_fill(monitor: RideMonitor, bar: Any, longest: float, needed: list[NodeProcess], *more: Any) -> None:
        watch(monitor, bar, longest, needed, *more)
        (recorder,) = (node for node in needed if node.module == "bike_sim.ros.record")
        size = (tmp_path / "ride.mcap").stat().st_size
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    monkeypatch.setattr(RideMonitor, "watch", watch_and_fill)
    with pytest.raises(NodeLost, match=r"record: recording .*ride.mcap stopped: File too large"):
        ride_a_little(ros.domain, tmp_path / "ride.mcap", chunk_size=1 << 20)


def test_lost_messages_are_counted(ros: Any, sender: Any, tmp_path: Path) -> None:
    recorder = ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap"))
    publisher = sender.open(String, "flood", QoSProfile(depth=5))
    publisher.publish(String(data="before"))
    sender.until(lambda: sender.figures().get("messages_written", "0") != "0")
    sender.during(1.0)
    recorder.process.send_signal(signal.SIGSTOP)  # held up for longer than the publisher can wait
    for _ in range(3000):
        publisher.publish(String(data="x" * 2000))
    recorder.process.send_signal(signal.SIGCONT)
    publisher.publish(String(data="after"))
    sender.until(lambda: int(sender.figures()["messages_dropped"]) > 0)
    sender.until(lambda: sum(int(sender.figures()[f"messages_{what}"]) for what in ("written", "dropped")) >= 3002)
    assert any(
        s.level == DiagnosticStatus.WARN and "dropped since the last report" in s.message for s in sender.reports
    )
    assert recorder.end()[0] == 0
    dropped = 3002 - counts_in(tmp_path / "ride.mcap")["/bike/flood"]
    assert f"{dropped} dropped" in recorder.words.splitlines()[-1]
    sender.until(lambda: sender.figures()["messages_dropped"] == str(dropped))  # the last report arrives


# ---------------------------------------------------------------------------------------------------------- throughput

BIKES = 10
RATE = 8_000.0
"""Messages a second: what ten bicycles and their policies publish at 100 Hz, eight each a control period."""
SENT_FOR = 2.0


@pytest.mark.slow
def test_ten_bicycles_at_a_hundred_hertz_are_recorded_whole(ros: Any, sender: Any, tmp_path: Path) -> None:
    folder = tmp_path / "ride"
    recorder = ros.start("bike_sim.ros.record", path=str(folder))
    sender.until(sender.figures)
    command = [sys.executable, "-m", "bench.recorder_speed", "--send", str(BIKES), str(RATE), str(SENT_FOR)]
    environment = {**os.environ, DOMAIN_VARIABLE: str(ros.domain)}
    root = Path(__file__).parents[2]
    with subprocess.Popen(command, env=environment, cwd=root, stdout=subprocess.PIPE, text=True) as publisher:
        assert publisher.stdout is not None
        assert publisher.stdout.readline() == "heard on all topics\n"
        sent = int(publisher.stdout.readline())
        sender.until(lambda: int(sender.figures()["messages_written"]) >= sent)
    assert sender.figures()["messages_dropped"] == "0"
    assert float(sender.figures()["write_lag_ms"]) < 5000.0
    assert recorder.end()[0] == 0
    with Reader(folder) as reader:
        counts = Counter(connection.topic for connection, *_ in reader.messages())
    assert sum(n for topic, n in counts.items() if topic.startswith("/bike/traffic/b")) == sent
    assert sent > 0.5 * RATE * SENT_FOR  # a busy machine may not send more
