"""How the programs begin and end: bad parameters, signals, neighbours, and a simulator that dies."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from bike_msgs.msg import BikeCommand, BikeState, Course, EpisodeStart, RideEvent
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy, QoSProfile
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


@pytest.mark.parametrize(
    ("module", "name", "value", "words"),
    [
        ("bike_sim.ros.sim_node", "speed", "fast", "parameter speed must be a number, got 'fast'"),
        ("bike_sim.ros.sim_node", "coarse", "circle", "unknown parameter 'coarse'; did you mean course?"),
        ("bike_sim.ros.record", "topic", "circle", "unknown parameter 'topic'; did you mean topics?"),
        ("bike_policy.drive", "polcy", "circle", "unknown parameter 'polcy'; did you mean policy?"),
        ("bike_policy.joy", "brake_axes", "circle", "unknown parameter 'brake_axes'; did you mean brake_axis?"),
    ],
)
def test_a_parameter_that_cannot_be_is_one_line_and_exit_code_2(
    run_here: Any, module: str, name: str, value: str, words: str
) -> None:
    program = {"bike_policy.joy": "joystick"}.get(module, module.rpartition(".")[2])
    assert run_here(module, use_sim_time=False, **{name: value}) == (2, f"{program}: {words}\n")


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
    while time.monotonic() < clock + 2.0 or (monitor._state is None and time.monotonic() < clock + PATIENCE):
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
        os.kill(client._own[0].process.pid, signal.SIGKILL)
        client._own[0].process.wait()
        with pytest.raises(NodeLost, match=r"ended with exit code -9"):
            client.step(0.0)
    with pytest.raises(NodeLost, match=r"exit code 2: sim_node: .*steam"):
        RosClient(SimulatorConfig(engine="steam"))


def test_a_client_joins_a_simulator_that_runs() -> None:
    """Rides of the client that has started a simulator and of one that finds it are the same; the first ends it."""
    config, request = SimulatorConfig(engine="whipple"), ResetRequest(course="line", seed=3)

    def ride(client: RosClient) -> list[float]:
        client.reset(request)
        return [value for _ in range(5) for value in client.step(0.1).state.tolist()]

    with RosClient(config) as first:
        alone = ride(first)
        with RosClient(config, join=first.domain_id) as second:
            assert ride(second) == alone
        assert ride(first) == alone
