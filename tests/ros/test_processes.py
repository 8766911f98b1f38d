"""How the programs begin and end: bad parameters, signals, neighbours, and a simulator that dies."""

from __future__ import annotations

import math
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from bike_msgs.msg import BikeCommand, BikeState, Course, EpisodeStart, RideEvent
from bike_msgs.srv import Reset
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock

from bike_sim.ros.isolation import DISCOVERY_VARIABLE, PROFILES_VARIABLE
from bike_sim.ros.sim_node import SPECS, NodeSettings
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.envs.node_process import NodeLost
from bike_training.envs.ros_client import RosClient
from bike_training.nodes.live_watch import LiveWatch
from bike_training.nodes.node_rides import RideMonitor

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("compiled")]

PATIENCE = 90.0
"""Longest wait for another process, s: what a busy machine may need."""


def test_a_parameter_that_cannot_be_is_one_line_and_exit_code_2(ros) -> None:
    program = ros.simulator(speed="fast")
    assert program.wait() == 2
    assert "parameter speed must be a number, got 'fast'" in program.words
    assert program.words.count("\n") == 1
    assert program.words.startswith("sim_node: ")


@pytest.mark.parametrize(
    ("module", "name", "near"),
    [
        ("bike_sim.ros.sim_node", "coarse", "course"),
        ("bike_sim.ros.record", "topic", "topics"),
        ("bike_policy.drive", "polcy", "policy"),
        ("bike_policy.joy", "brake_axes", "brake_axis"),
    ],
)
def test_a_mistyped_parameter_is_refused_by_name(ros, module: str, name: str, near: str) -> None:
    program = ros.start(module, use_sim_time=False, **{name: "circle"})
    assert program.wait() == 2
    assert program.words.endswith(f": unknown parameter {name!r}; did you mean {near}?\n")
    assert program.words.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("engine", "steam", "parameter engine must be one of pybullet, whipple, compiled, got 'steam'"),
        ("perturb", 1, "parameter perturb must be true or false, got 1"),
        ("preview_count", 2.5, "parameter preview_count must be a whole number, got 2.5"),
        ("preview_count", 0, "preview count must be 1 to 1000"),
        ("vehicle", "nothing", "no vehicle 'nothing'"),
        ("time_step", 0.003, "not a whole number of time steps"),
        ("disturbances", "none.yaml", "none.yaml"),
        ("history", 0, "history must be at least 1"),
        ("real_time_factor", -1.0, "real_time_factor must be finite and not negative"),
        ("real_time_factor", 1e-12, "real_time_factor must be 0 or at least 1.39e-05, a control period an hour"),
        ("real_time_factor", 5e-324, "real_time_factor must be 0 or at least 1.39e-05"),
        ("command_timeout_s", math.nan, "command_timeout_s must be finite and not negative"),
    ],
)
def test_what_is_wrong_with_a_parameter_is_named(name: str, value: Any, words: str) -> None:
    values = {spec.name: spec.default for spec in SPECS} | {name: value}
    with pytest.raises((ValueError, FileNotFoundError), match=re.escape(words)):
        NodeSettings.from_parameters({spec.name: spec.read(values[spec.name]) for spec in SPECS})


def test_an_episode_that_cannot_begin_is_named() -> None:
    simulator = Simulator(SimulatorConfig(engine="whipple"))
    for change, words in (({"course": "nowhere"}, "'nowhere'"), ({"line": 0.5}, "are for circuits")):
        settings = NodeSettings.from_parameters({spec.name: spec.default for spec in SPECS} | change)
        with pytest.raises((ValueError, FileNotFoundError), match=words):
            settings.request(simulator)
    simulator.close()


def processor_time(pid: int) -> float:
    """Return the processor time that a process has taken so far, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_all_programs_end_within_two_seconds_and_close_their_files(ros, policy, tmp_path: Path) -> None:
    """Seconds of the processor, since other work may share the machine."""
    simulator = ros.simulator(course="circle")
    recorder = ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap"), notes=["policy=linear"])
    driver = ros.start("bike_policy.drive", policy=policy)
    probe = ros.probe()
    probe.until(lambda: probe.records("state", "command", "course", "course_points"))
    step = probe.states[-1].step
    probe.until(lambda: probe.states[-1].step > step + 40)
    programs = [driver, simulator, recorder]
    ended_before = resource.getrusage(resource.RUSAGE_CHILDREN)
    taken = sum(processor_time(program.process.pid) for program in programs)
    for program in programs:
        program.process.send_signal(signal.SIGINT)
    assert [program.wait() for program in programs] == [0, 0, 0]
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert ended.ru_utime - ended_before.ru_utime + ended.ru_stime - ended_before.ru_stime - taken < 2.0
    # They said goodbye: who does not is missed after 20 s, the lease that Fast DDS grants.
    probe.until(lambda: not probe.count_publishers("state"), patience=15.0)
    with (tmp_path / "ride.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        counts = {c.topic: summary.statistics.channel_message_counts.get(c.id, 0) for c in summary.channels.values()}
        assert counts["/bike/state"] > 10
        assert counts["/bike/course"] == 1
        assert {"/bike/command", "/bike/course_points", "/bike/events", "/clock", "/diagnostics"} <= set(counts)
        times = [message.log_time for _, channel, message in reader.iter_messages(topics=["/bike/state", "/bike/odom"])]
        assert min(times) >= 1_000_000_000
        assert max(times) < 3600 * 1_000_000_000  # simulated, not wall-clock time
    assert " 0 dropped" in recorder.words


GARBAGE = (bytes([0, 1, 0, 0, 0, 0, 0, 0]), b"\0\1\0\0", bytes(range(60)), b"\0\1\0\0" + b"\xff" * 200)


def test_bytes_of_a_stranger_end_no_node_and_are_recorded_as_they_are(ros, policy, tmp_path: Path) -> None:
    simulator = ros.simulator(course="circle")
    recorder = ros.start("bike_sim.ros.record", path=str(tmp_path / "ride.mcap"))
    driver = ros.start("bike_policy.drive", policy=policy)
    probe, sender = ros.probe(), ros.sender()
    watch = LiveWatch(ros.domain, "bike", lambda message: None)
    watch.start()
    monitor = RideMonitor(ros.domain)
    probe.until(lambda: probe.records("state", "command"))
    kinds = {"command": BikeCommand, "state": BikeState, "course": Course, "episode": EpisodeStart, "events": RideEvent}
    topics = {f"/bike/{name}": kind for name, kind in kinds.items()}
    topics |= {"/bike/_screen_state": BikeState, "/clock": Clock, "/diagnostics": DiagnosticArray}
    probe.destroy_subscription(next(s for s in probe.subscriptions if s.topic_name == "/bike/state"))
    probe.destroy_subscription(next(s for s in probe.subscriptions if s.topic_name == "/diagnostics"))
    qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = {topic: sender.create_publisher(kind, topic, qos) for topic, kind in topics.items()}

    def matched() -> bool:
        return all(0 < probe.count_subscribers(t) <= p.get_subscription_count() for t, p in publishers.items())

    sender.until(matched)  # a node that is found later would not get the bytes
    for topic, publisher in publishers.items():
        for data in GARBAGE:
            publisher.publish(data[:8] if topic == "/clock" else data)  # a type without texts has a largest size
    clock = time.monotonic()
    while time.monotonic() < clock + 2.0:
        monitor._node.spin_once(0.05)
    step = monitor._state.step
    while monitor._state.step <= step + 20 and time.monotonic() < clock + PATIENCE:
        monitor._node.spin_once(0.05)
    assert monitor._state.step > step + 20
    watch.check()
    watch.end()
    monitor.__exit__()
    for program in (simulator, driver, recorder):
        assert program.end(signal.SIGTERM)[0] == 0
    assert recorder.words.count("bytes on /bike/command are not of type bike_msgs/msg/BikeCommand") == 1
    with (tmp_path / "ride.mcap").open("rb") as file:
        messages = [message.data for _, _, message in make_reader(file).iter_messages(topics=["/bike/command"])]
    assert set(GARBAGE) <= set(messages)


def test_a_recording_in_several_files_has_no_gaps_and_opens_everywhere(ros, policy, tmp_path: Path) -> None:
    recorder = ros.start(
        "bike_sim.ros.record", path=str(tmp_path / "ride"), max_bag_duration=1.0, chunk_size=8192, compression="lz4"
    )
    simulator = ros.simulator(course="circle")
    probe = ros.probe()
    probe.pause(True)
    driver = ros.start("bike_policy.drive", policy=policy)
    probe.until(lambda: probe.records("state", "command"))
    probe.pause(False)
    probe.until(lambda: probe.states[-1].step > 60)
    for program in (driver, simulator, recorder):
        assert program.end()[0] == 0
    counts: Counter[str] = Counter()
    steps: dict[str, list[int]] = {"/bike/state": [], "/bike/command": []}
    files = sorted((tmp_path / "ride").glob("*.mcap"))
    for path in files:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            messages = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
        counts += Counter(topic for topic, _ in messages)
        assert [topic for topic, _ in messages].count("/bike/course") == 1
        for topic, numbers in steps.items():
            numbers += [message.step for name, message in messages if name == topic]
    assert len(files) >= 3
    states = steps["/bike/state"]
    assert sorted(set(states)) == list(range(max(states) + 1))
    assert max(states) > 60
    assert set(steps["/bike/command"]) >= set(states) - {max(states)}
    with AnyReader([tmp_path / "ride"]) as bag:
        assert counts == Counter(c.topic for c, _, data in bag.messages() if bag.deserialize(data, c.msgtype))
    assert {"/bike/markers", "/clock"} < set(counts)


TWO_MACHINES = """
set -e
ip link set lo up
unshare -n sleep 600 & other=$!
trap 'kill $other $simulator' EXIT
until [ "$(cat /proc/$other/comm)" = sleep ]; do sleep 0.05; done
ip link add v0 type veth peer name v1 netns $other
ip addr add 10.77.0.1/24 dev v0
ip link set v0 up
ip route add default dev v0
far_away() { nsenter -t $other -n "$@"; }
far_away ip link set lo up
far_away ip addr add 10.77.0.2/24 dev v1
far_away ip link set v1 up
far_away ip route add default dev v1
echo connected
"$PYTHON" -m bike_sim.ros.sim_node & simulator=$!
"$PYTHON" -c "$LISTENER" near "$PATIENCE"
far_away env ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET "$PYTHON" -c "$LISTENER" far "$FAR_PATIENCE"
"""
"""Two network namespaces with a cable between them: the simulator in one, a node that listens in the other once one
beside the simulator has found it."""

LISTENER = """
import sys, time, rclpy
rclpy.init()
node = rclpy.create_node("listener")
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end and not node.count_publishers("/bike/state"):
    time.sleep(0.1)
print(sys.argv[1], "heard", node.count_publishers("/bike/state"), flush=True)
"""


@pytest.mark.parametrize(("discovery", "heard", "patience"), [(None, 0, 3.0), ("SUBNET", 1, PATIENCE)])
def test_other_machines_see_nothing_unless_they_shall(discovery: str | None, heard: int, patience: float) -> None:
    environment = {**os.environ, "PYTHON": sys.executable, "LISTENER": LISTENER}
    environment |= {"PATIENCE": str(PATIENCE), "FAR_PATIENCE": str(patience)}
    for variable in (DISCOVERY_VARIABLE, PROFILES_VARIABLE):
        environment.pop(variable, None)
    if discovery:
        environment[DISCOVERY_VARIABLE] = discovery
    command = ["unshare", "-n", "-m", "sh", "-c", TWO_MACHINES]
    try:
        result = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=3.0 * PATIENCE, check=False
        )
    except FileNotFoundError:
        pytest.skip("no unshare here")
    if "connected" not in result.stdout:
        pytest.skip(f"network namespaces cannot be made here: {result.stderr.strip()[-100:]}")
    assert "near heard 1" in result.stdout, result.stderr
    assert f"far heard {heard}" in result.stdout, result.stderr


def test_a_dead_simulator_is_one_clear_error() -> None:
    with RosClient(SimulatorConfig(engine="whipple")) as client:
        client.reset(ResetRequest(course="line"))
        client.step(0.0)
        assert client._process is not None
        os.kill(client._process.process.pid, signal.SIGKILL)
        client._process.process.wait()
        with pytest.raises(NodeLost, match=r"ended with exit code -9"):
            client.step(0.0)
    with pytest.raises(NodeLost, match=r"exit code 2: sim_node: .*steam"):
        RosClient(SimulatorConfig(engine="steam"))


def test_parameters_are_checked_when_they_change(lockstep) -> None:
    for name, value, reason in (
        ("speed", -3.0, "parameter speed must be finite and not negative, got -3.0"),
        (
            "real_time_factor",
            1e-12,
            "parameter real_time_factor must be 0 or at least 1.39e-05, a control period an hour",
        ),
        ("course", "nowhere", "no shipped course is called 'nowhere'"),
        ("vehicle", "whipple", "read-only"),
    ):
        result = lockstep.set_parameter(name, value)
        assert not result.successful
        assert reason in result.reason
    assert lockstep.set_parameter("speed", 5).successful
    request = ResetRequest(course="line", seed=1)
    lockstep.reset(request)
    lockstep.until(lambda: abs(lockstep.states[-1].speed - 4.0) < 0.01)
    assert lockstep.reset(Reset.Request(seed=1)).state.speed == pytest.approx(5.0, abs=1e-6)
