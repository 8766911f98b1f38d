"""Speed of the analysis: an hour of riding at 100 Hz with every topic.

A superbike rides an out-lap and a flying lap through the nodes, with a recorder. The flying lap is written again and
again, with new stamps, steps and progress. The analysis is a fresh process, so that its memory is its own. Both
wall-clock and processor time are given: only the latter means something on a busy machine.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from rosbags.highlevel import AnyReader
from tqdm import tqdm

from bike_analysis.read.columns import MessageLayout, MessageSchema
from bike_sim.course.files import load_track
from bike_sim.physics.superbike.engine import TIME_STEP
from bike_sim.recording.definitions import MessageType
from bike_sim.recording.metadata import LATCHED, Qos
from bike_sim.recording.recorder import RideRecorder
from bike_sim.ros.isolation import DomainLease
from bike_training.nodes.node_rides import ride_recorded

VEHICLE: Final = "panigale_v4r"
CIRCUIT: Final = "barcelona"
PERIOD: Final = 0.01
"""Control period of the recorded ride, s: 100 Hz."""
HOUR: Final = 3600.0
EXCERPT: Final = 360.0
"""Length of the ride that is analysed before, s: it compiles what is compiled once."""
SECOND: Final = 1_000_000_000
"""ns."""


# ----------------------------------------------------------------------------------------------------- the recording


class _Message(NamedTuple):
    """A message of the lap that is repeated."""

    topic: str
    log_time_ns: int
    data: bytes


class _Topic:
    """A topic of the lap; shifts its messages in time, steps and arc length."""

    def __init__(self, type_name: str, definition: str, latched: bool) -> None:
        self.type, self.latched = MessageType(type_name, definition), latched
        self._schema = MessageSchema(type_name, definition)
        self._fields: dict[int, list[tuple[int, struct.Struct, str]]] = {}

    def shifted(self, data: bytes, shift: Mapping[str, float]) -> bytes:
        """Return a message shifted by `seconds`, `steps` and `metres`."""
        changed = bytearray(data)
        if len(data) not in self._fields:
            self._fields[len(data)] = self._find_fields(data)
        for offset, packing, kind in self._fields[len(data)]:
            (value,) = packing.unpack_from(changed, offset)
            packing.pack_into(changed, offset, value + shift[kind])
        return bytes(changed)

    def _find_fields(self, data: bytes) -> list[tuple[int, struct.Struct, str]]:
        kinds = {
            "header.stamp.sec": ("<i", "seconds"),
            "clock.sec": ("<i", "seconds"),
            "step": ("<I", "steps"),
            "progress": ("<d", "metres"),
            "front_progress": ("<d", "metres"),
        }
        if self.type.name.endswith("RideEvent"):
            kinds["time"] = ("<d", "seconds")
        return [
            (offset, struct.Struct(kinds[name][0]), kinds[name][1])
            for name, (_, offset) in MessageLayout(self._schema, data).places.items()
            if name in kinds
        ]


@dataclass(frozen=True)
class Lap:
    """A part of a recorded ride that can be repeated.

    Attributes:
        topics: Topics by name.
        latched: Messages that a recording has once.
        messages: Messages of the lap in the order of recording.
        seconds: Duration, whole seconds.
        metres: Length of a lap along the followed line, m.
    """

    topics: dict[str, _Topic]
    latched: list[_Message]
    messages: list[_Message]
    seconds: int
    metres: float


def record_lap(distance: float | None = None) -> Lap:
    """Ride through the nodes and take one lap of the recording.

    Args:
        distance: Length of the repeated part, m; None takes a lap of the circuit.
    """
    length = load_track(CIRCUIT).line(1.0).length if distance is None else distance
    simulator = {"vehicle": VEHICLE, "course": CIRCUIT, "time_step": TIME_STEP, "control_period": PERIOD}
    with tempfile.TemporaryDirectory() as folder, DomainLease() as lease:
        path = Path(folder) / "lap.mcap"
        starts: list[int] = []

        def is_over(state: Any) -> bool:
            if state.fallen:
                raise RuntimeError(f"the rider of the benchmark fell after {state.progress:.1f} m")
            if state.progress >= length and not starts:
                starts.append(state.header.stamp.sec + 1)
            return bool(state.progress >= 2.0 * length)

        ride_recorded(
            lease.domain_id,
            {
                "record": {"path": str(path), "notes": ["policy=classical", f"vehicle={VEHICLE}"]},
                "sim_node": simulator,
                "drive": {"policy": "classical"},
            },
            title=f"{VEHICLE}, {CIRCUIT}",
            distance=2.0 * length,
            longest=HOUR,
            is_over=is_over,
        )
        return _take_lap(path, starts[0], length)


def _take_lap(path: Path, start: int, length: float) -> Lap:
    """Return the messages of whole seconds from `start`, s, on."""
    with AnyReader([path]) as reader:
        topics = {
            each.topic: _Topic(each.msgtype, each.msgdef.data, _is_latched(each.ext.offered_qos_profiles))
            for each in reader.connections
        }
        found = [_Message(connection.topic, time_ns, bytes(data)) for connection, time_ns, data in reader.messages()]
    seconds = found[-1].log_time_ns // SECOND - start
    begin, end = start * SECOND, (start + seconds) * SECOND
    latched = [message for message in found if topics[message.topic].latched]
    part = [each for each in found if begin <= each.log_time_ns < end and not topics[each.topic].latched]
    return Lap(topics, latched, part, seconds, length)


def _is_latched(profiles: Sequence[Any]) -> bool:
    return any(profile.durability.name == "TRANSIENT_LOCAL" for profile in profiles)


def write_recording(path: Path, duration: float, lap: Lap) -> int:
    """Write a ride of any length.

    Args:
        path: The recording.
        duration: Length of the ride, s.
        lap: What is repeated.

    Returns:
        Number of messages.
    """
    end = lap.messages[0].log_time_ns + round(duration * SECOND)
    with RideRecorder(path, overwrite=True, notes={"policy": "classical", "vehicle": VEHICLE}) as recorder:
        for name, topic in lap.topics.items():
            recorder.add_topic(name, topic.type, LATCHED if topic.latched else Qos())
        for message in lap.latched:
            recorder.write(message.topic, message.data, lap.messages[0].log_time_ns)
        for number in tqdm(range(int(duration // lap.seconds) + 1), desc="writing", unit="lap", leave=False):
            seconds = number * lap.seconds
            shift = {"seconds": seconds, "steps": round(seconds / PERIOD), "metres": number * lap.metres}
            for name, time_ns, data in lap.messages:
                if time_ns + seconds * SECOND >= end:
                    break
                recorder.write(name, lap.topics[name].shifted(data, shift), time_ns + seconds * SECOND)
        return recorder.message_count


# ---------------------------------------------------------------------------------------------------------- measuring


@dataclass(frozen=True)
class Used:
    """Resources that a process used.

    Attributes:
        wall_s: Wall-clock time, s.
        processor_s: Processor time of all its threads, s.
        memory_gib: Largest resident memory, GiB.
        output: What it printed.
    """

    wall_s: float
    processor_s: float
    memory_gib: float
    output: str


def run_alone(*words: str) -> Used:
    """Run a Python program in a process of its own and see what it uses.

    Raises:
        RuntimeError: If it fails.
    """
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        output = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
    except BaseException:  # stopped by Ctrl-C: what it reads and writes is about to be removed
        process.kill()
        process.wait()
        raise
    process.returncode = os.waitstatus_to_exitcode(status)
    took = time.perf_counter() - began
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(words)} ended with exit code {process.returncode}")
    return Used(took, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20, output)


def hour_figures(path: Path, out: Path, count: int) -> dict[str, float]:
    """Return time and memory of `bike analyze` of a recording with page, picture and figures."""
    used = run_alone("-m", "bike_training.cli", "analyze", str(path), "--json", "--out", str(out))
    figures = json.loads(used.output)["figures"]
    if figures["recordings"][0]["messages"] != count:
        raise RuntimeError(f"{figures['recordings'][0]['messages']} of {count} messages were read")
    return {
        "hour_messages": float(count),
        "hour_recording_mib": path.stat().st_size / 2**20,
        "hour_analysis_s": used.wall_s,
        "hour_analysis_processor_s": used.processor_s,
        "peak_memory_gib": used.memory_gib,
        "hour_laps": float(len(figures["rides"][0]["complete_laps"])),
    }


def measure(duration: float = HOUR, excerpt: float = EXCERPT, distance: float | None = None) -> dict[str, Any]:
    """Return all figures of this module.

    Args:
        duration: Length of the ride that is analysed, s.
        excerpt: Length of the ride that is analysed before, s.
        distance: Length of the part of the ride that is repeated, m; None takes a lap.
    """
    lap = record_lap(distance)
    with tempfile.TemporaryDirectory() as folder:
        part, whole = Path(folder) / "excerpt.mcap", Path(folder) / "hour.mcap"
        hour_figures(part, Path(folder) / "out", write_recording(part, excerpt, lap))
        count = write_recording(whole, duration, lap)
        print(f"analysing {count} messages ...", file=sys.stderr)
        return hour_figures(whole, Path(folder) / "out", count)
