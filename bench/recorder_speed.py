"""Speed of the recorder: the node behind ROS 2.

The load is what bicycles with their policies publish, sent by processes of their own. The rate goes up until messages
are dropped or do not arrive in time; the last rate without is the figure. Publishers, middleware and recorder share the
machine's cores, so the figure is that of the whole path on this machine.

    python -m bench.recorder_speed --send 10 8000 5    # send: ten bicycles, 8000 messages a second, for 5 s

A sender prints a line when all topics have a listener, and the number of messages once all are sent. It ends when all
have arrived.
"""

from __future__ import annotations

import argparse
import os
import re
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np
import psutil
import rclpy.node
import yaml
from bike_msgs.msg import BikeCommand, BikeState
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock

from bike_sim.ros import messages, node_tools, standard_messages
from bike_sim.ros.command_gate import Command
from bike_sim.ros.isolation import DOMAIN_VARIABLE, DomainLease, prepare_discovery
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.envs.node_process import NodeProcess

BIKES: Final = 10
CONTROL_RATE: Final = 100.0
"""Hz, of each bicycle."""
RATES: Final = (5_000, 8_000, 10_000, 20_000, 40_000, 60_000, 70_000, 80_000, 85_000, 90_000, 100_000)
"""Messages a second that are tried."""
PUBLISHERS: Final = 2
"""Processes that share a rate: one alone cannot send as much as is recorded."""
TRIALS: Final = 3
"""A rate counts if one of so many trials is whole: what else the machine does costs messages near its limit."""
SENDING_TIME: Final = 4.0
"""Wall-clock time of a trial, s."""
TIMEOUT: Final = 60.0
"""Wall-clock time after which a process that sends is given up, s."""
START_TIMEOUT: Final = 30.0
"""Wall-clock time in which every topic must have found a listener, s."""
ARRIVAL_TIMEOUT: Final = 20.0
"""Wall-clock time in which the listeners must have all messages, s."""
SETTLING: Final = 1.0
"""Wall-clock time between that and the first message, s."""
PACE: Final = 0.002
"""Wall-clock time between two bursts, s."""
UNSTAMPED: Final = "markers"
ROOT: Final = Path(__file__).parents[1]


def measure(rates: Sequence[int] = RATES, duration: float = SENDING_TIME) -> dict[str, float]:
    """Return the largest rate at which the node records every message, beside ten bicycles, and what a message costs.

    The processor time of a message, with what the middleware needs in the recorder's process, means something on a busy
    machine, too.

    Args:
        rates: messages a second that are tried, ascending.
        duration: wall-clock time of a trial, s.
    """
    period = messages_of_a_period()
    of_ten = BIKES * CONTROL_RATE * len(period)
    largest, cost = 0.0, float("nan")
    for rate in rates:
        trials = (send_and_record(rate, duration) for _ in range(TRIALS))
        sent, spent = next(((sent, spent) for sent, recorded, spent in trials if recorded == sent), (0, 0.0))
        if sent:
            largest, cost = sent / duration, float(np.fmin(cost, spent / sent))
        if sent < 0.9 * rate * duration:  # messages are lost, or the publishers are at their end
            break
    return {
        "ten_bicycles_messages_per_s": of_ten,
        "ten_bicycles_bytes_per_s": BIKES * CONTROL_RATE * sum(len(data) for _, data in period.values()),
        "recorder_node_messages_per_s": largest,
        "recorder_node_to_ten_bicycles_ratio": largest / of_ten,
        "recorder_node_cpu_us_per_message": 1e6 * cost,
    }


def send_and_record(rate: float, duration: float) -> tuple[int, int, float]:
    """Send at a rate and record what comes.

    Args:
        rate: messages a second to send.
        duration: wall-clock time of the sending, s.

    Returns:
        Messages sent, messages in the recording, and processor time of the recorder from the first message on, s.

    Raises:
        RuntimeError: the publishers did not find the recorder.
        NodeLost: the recorder failed.
    """
    with tempfile.TemporaryDirectory() as folder, DomainLease() as lease:
        target = Path(folder) / "ride"
        environment = {**os.environ, DOMAIN_VARIABLE: str(lease.domain_id)}
        prepare_discovery(environment)
        with NodeProcess("bike_sim.ros.record", {"path": str(target)}, lease.domain_id) as recorder:
            words = [sys.executable, "-m", "bench.recorder_speed", "--send", str(BIKES // PUBLISHERS)]
            words += [str(rate / PUBLISHERS), str(duration), "--name"]
            publishers = [
                subprocess.Popen([*words, f"traffic{k}"], env=environment, cwd=ROOT, stdout=subprocess.PIPE, text=True)
                for k in range(PUBLISHERS)
            ]
            for publisher in publishers:
                assert publisher.stdout is not None
                publisher.stdout.readline()  # all topics are heard
            used = psutil.Process(recorder.process.pid)
            before = sum(used.cpu_times()[:2])
            sent = sum(_count_of(publisher) for publisher in publishers)
            recorder.check()
            spent = sum(used.cpu_times()[:2]) - before
            recorder.close()
        if not (target / "metadata.yaml").exists():  # it did not even end in time
            return sent, 0, spent
        information = yaml.safe_load((target / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {
        each["topic_metadata"]["name"]: each["message_count"] for each in information["topics_with_message_count"]
    }
    return sent, sum(count for name, count in counts.items() if re.match(r"/bike/traffic\d/", name)), spent


def _count_of(publisher: subprocess.Popen[str]) -> int:
    assert publisher.stdout is not None
    try:
        words = publisher.stdout.readline()  # like the line before: what is buffered is lost to `communicate`
        publisher.wait(TIMEOUT)
    finally:
        publisher.kill()
    if publisher.returncode:
        raise RuntimeError("a process that publishes for the recorder failed; its words are above")
    return int(words)


# ------------------------------------------------------------------------------------------------------------ sending


def messages_of_a_period() -> dict[str, tuple[type, bytes]]:
    """Return name, type and CDR of all messages that belong to one control period of one bicycle."""
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.005, control_period=0.01))
    request = ResetRequest(course="benchmark", speed_range=(4.0, 4.0))
    snapshot = simulator.reset(request)
    for _ in range(10):
        snapshot = simulator.step(0.0)
    assert simulator.course is not None
    period = round(simulator.config.control_period * node_tools.NANOSECONDS)
    stamp = node_tools.NANOSECONDS
    episode = messages.Episode.of(simulator.vehicle, simulator.course, request.preview, simulator.config.control_period)
    made = {
        "state": deserialize_message(messages.encode_state(snapshot, episode, stamp), BikeState),
        "command": deserialize_message(messages.encode_command(Command(1, snapshot.step, 0.1)), BikeCommand),
        "clock": Clock(clock=node_tools.time_to_message(stamp)),
        "course_points": messages.course_points_to_message(snapshot, simulator.course, stamp),
        "lean_history": messages.lean_history_to_message(snapshot, stamp, period),
        "odom": standard_messages.odometry(snapshot, simulator.vehicle, stamp),
        "joint_states": standard_messages.joint_state(snapshot, simulator.vehicle, stamp),
        "markers": standard_messages.vehicle_markers(snapshot, simulator.vehicle, stamp),
    }
    return {name: (type(message), bytes(serialize_message(message))) for name, message in made.items()}


class Traffic(rclpy.node.Node):
    """Publishes the messages of several bicycles."""

    def __init__(self, bikes: int, context: Context, name: str = "traffic") -> None:
        super().__init__(name, context=context, namespace=node_tools.NAMESPACE, start_parameter_services=False)
        period = messages_of_a_period()
        self._load: list[tuple[Publisher, bytes, bool]] = []
        for bike in range(bikes):
            for topic, (kind, data) in period.items():
                publisher = self.create_publisher(
                    kind, f"{name}/b{bike}/{topic}", node_tools.SENDER_QOS, event_callbacks=node_tools.QUIET
                )
                self._load.append((publisher, data, topic != UNSTAMPED))
        self.senders = [publisher for publisher, *_ in self._load]

    def send(self, rate: float, duration: float) -> int:
        """Send messages, topic by topic, until the time is over; return how many.

        Args:
            rate: messages a second of wall-clock time.
            duration: of the sending, s of wall-clock time.
        """
        with ExitStack() as stack:
            # The handles themselves, which `Publisher.publish` would take and give back for each message.
            for publisher in self.senders:
                stack.enter_context(publisher.handle)
            load = [(publisher.handle.publish_raw, data, stamped) for publisher, data, stamped in self._load]
            sent, begun = 0, time.monotonic()
            while (elapsed := time.monotonic() - begun) < duration:
                for number in range(sent, int(elapsed * rate)):
                    period, topic = divmod(number, len(load))
                    publish, data, stamped = load[topic]
                    publish(_stamped(data, period) if stamped else data)
                    sent = number + 1
                time.sleep(PACE)
        return sent


def _stamped(data: bytes, period: int) -> bytes:
    """Return a message that begins with a header, at another time: 1 s and so many control periods of 10 ms."""
    seconds, hundredths = divmod(100 + period, 100)
    return data[:4] + struct.pack("<iI", seconds, hundredths * 10_000_000) + data[12:]


def main() -> None:
    """Send as a process of its own, and tell the parent by standard output how far it is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    metavar = ("BIKES", "RATE", "DURATION")
    parser.add_argument("--send", type=float, nargs=3, required=True, metavar=metavar, help="1/s and s")
    parser.add_argument("--name", default="traffic", help="name of the sending node and of its topics")
    args = parser.parse_args()
    bikes, rate, duration = args.send
    prepare_discovery()
    with Context() as context:
        traffic = Traffic(int(bikes), context, args.name)
        end = time.monotonic() + START_TIMEOUT
        while not all(publisher.get_subscription_count() for publisher in traffic.senders):
            if time.monotonic() > end:
                sys.exit(f"nobody listens to all topics after {START_TIMEOUT:g} s; does a recorder run?")
            time.sleep(0.05)
        time.sleep(SETTLING)
        print("heard on all topics", flush=True)
        print(traffic.send(rate, duration), flush=True)
        end = time.monotonic() + ARRIVAL_TIMEOUT
        for publisher in traffic.senders:
            publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))
        traffic.destroy_node()


if __name__ == "__main__":
    main()
