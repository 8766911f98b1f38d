"""Speed of the recorder: the writer alone beside the one of the `mcap` library, and the node behind ROS 2.

The load is what bicycles with their policies publish, sent by processes of their own (`bench.traffic`). The rate goes
up until messages are dropped or do not arrive in time; the last rate without is the figure. Publishers, middleware and
recorder share the machine's cores, so the figure is that of the whole road on this machine.

    python -m bench.recorder_speed
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml
from mcap.writer import Writer

from bench.traffic import messages_of_a_period
from bike_sim.recording import CHUNK_BYTES, RideRecorder, message_type
from bike_sim.ros.isolation import DOMAIN_VARIABLE, DomainLease, prepare_discovery
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
SENT_FOR: Final = 4.0
TIMEOUT: Final = 60.0
"""Wall-clock time after which a process that sends is given up, s."""


def measure() -> dict[str, Any]:
    """Return all figures of this module."""
    return {**load(), **writer_speed(), **largest_rate()}


def load() -> dict[str, float]:
    """Return what ten bicycles publish at 100 Hz."""
    period = messages_of_a_period()
    return {
        "ten_bicycles_messages_per_s": BIKES * CONTROL_RATE * len(period),
        "ten_bicycles_bytes_per_s": BIKES * CONTROL_RATE * sum(len(data) for _, data in period.values()),
    }


def writer_speed(periods: int = 2500, rounds: int = 3) -> dict[str, float]:
    """Return how many messages a second are written, and how much faster that is than the library's writer.

    Both write the same messages with the same chunks and compression, in turns; the best round of each counts. The
    ratio is one of processor times, so that it means something on a busy machine, too.

    Args:
        periods: control periods of one bicycle in a round.
        rounds: rounds of each.
    """
    period = messages_of_a_period()
    ways: dict[str, Callable[[Path, int], None]] = {
        "ours": lambda path, count: _write_ours(path, period, count),
        "library": lambda path, count: _write_with_library(path, period, count),
    }
    count = periods * len(period)
    rates: dict[str, list[float]] = {name: [] for name in ways}
    costs: dict[str, list[float]] = {name: [] for name in ways}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            for name, write in ways.items():
                begun, spent = time.perf_counter(), time.process_time()
                write(Path(folder) / f"{name}_{number}.mcap", periods)
                costs[name].append((time.process_time() - spent) / count)
                rates[name].append(count / (time.perf_counter() - begun))
    return {
        "recorder_messages_per_s": max(rates["ours"]),
        "recorder_cpu_us_per_message": 1e6 * min(costs["ours"]),
        "recorder_to_mcap_library_ratio": min(costs["library"]) / min(costs["ours"]),
    }


def _write_ours(path: Path, period: dict[str, tuple[type, bytes]], periods: int) -> None:
    with RideRecorder(path, flush_period_s=1e9) as recorder:
        for name, (kind, _) in period.items():
            recorder.add_topic(name, _type_name(kind))
        for number in range(periods):
            for name, (_, data) in period.items():
                recorder.write(name, data, number)


def _write_with_library(path: Path, period: dict[str, tuple[type, bytes]], periods: int) -> None:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        writer.start(profile="ros2")
        channels = {}
        for name, (kind, data) in period.items():
            described = message_type(_type_name(kind))
            schema = writer.register_schema(described.name, "ros2msg", described.definition.encode())
            channels[writer.register_channel(name, "cdr", schema)] = data
        for number in range(periods):
            for channel, data in channels.items():
                writer.add_message(channel, number, data, number, number)
        writer.finish()


def _type_name(kind: type) -> str:
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


@dataclass(frozen=True)
class Trial:
    """One rate, sent for some seconds.

    Attributes:
        sent: Messages sent.
        recorded: Messages in the recording.
        cpu_s: Processor time of the recorder from the first message on, s.
    """

    sent: int
    recorded: int
    cpu_s: float


def largest_rate() -> dict[str, float]:
    """Return the largest rate at which the node records every message, beside ten bicycles, and what a message costs.

    The processor time of a message, with what the middleware needs in the recorder's process, means something on a busy
    machine, too.
    """
    whole: list[Trial] = []
    for rate in RATES:
        trial = _best_trial(rate)
        if trial is None:
            break
        whole.append(trial)
        if trial.sent < 0.9 * rate * SENT_FOR:  # the publishers are at their end
            break
    largest = max((trial.sent / SENT_FOR for trial in whole), default=0.0)
    cost = min((trial.cpu_s / trial.recorded for trial in whole), default=float("nan"))
    return {
        "recorder_node_messages_per_s": largest,
        "recorder_node_to_ten_bicycles_ratio": largest / load()["ten_bicycles_messages_per_s"],
        "recorder_node_cpu_us_per_message": 1e6 * cost,
    }


def _best_trial(rate: float) -> Trial | None:
    """Return a trial in which every message was recorded, or nothing after some without."""
    trials = (send_and_record(rate) for _ in range(TRIALS))
    return next((trial for trial in trials if trial.recorded == trial.sent), None)


def send_and_record(rate: float) -> Trial:
    """Send at a rate and record what comes.

    Args:
        rate: messages a second to send.

    Raises:
        RuntimeError: the publishers did not find the recorder. NodeLost: the recorder failed.
    """
    with tempfile.TemporaryDirectory() as folder, DomainLease() as lease:
        target = Path(folder) / "ride"
        environment = {**os.environ, DOMAIN_VARIABLE: str(lease.domain_id)}
        prepare_discovery(environment)
        with NodeProcess("bike_sim.ros.record", {"path": str(target)}, lease.domain_id) as recorder:
            publishers = [_publisher(rate / PUBLISHERS, f"traffic{k}", environment) for k in range(PUBLISHERS)]
            for publisher in publishers:
                assert publisher.stdout is not None
                publisher.stdout.readline()  # all topics are heard
            cpu = _cpu_time(recorder.process.pid)
            sent = sum(_count_of(publisher) for publisher in publishers)
            recorder.check()
            cpu = _cpu_time(recorder.process.pid) - cpu
            recorder.close()
        if not (target / "metadata.yaml").exists():  # it did not even end in time
            return Trial(sent, 0, cpu)
        information = yaml.safe_load((target / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    recorded = sum(
        topic["message_count"]
        for topic in information["topics_with_message_count"]
        if re.match(r"/bike/traffic\d/", topic["topic_metadata"]["name"])
    )
    return Trial(sent, recorded, cpu)


def _publisher(rate: float, name: str, environment: dict[str, str]) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "bench.traffic", str(BIKES // PUBLISHERS), str(rate), str(SENT_FOR)]
    root = Path(__file__).parents[1]
    return subprocess.Popen([*command, "--name", name], env=environment, cwd=root, stdout=subprocess.PIPE, text=True)


def _cpu_time(process: int) -> float:
    """Return the processor time that all threads of a process have had, s."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _count_of(publisher: subprocess.Popen[str]) -> int:
    try:
        words, _ = publisher.communicate(timeout=TIMEOUT)
    finally:
        publisher.kill()
    if publisher.returncode:
        raise RuntimeError("a process that publishes for the recorder failed; its words are above")
    return int(words)


if __name__ == "__main__":
    for key, value in measure().items():
        print(f"{key:36} {value:,.4g}")
