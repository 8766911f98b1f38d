"""Speed of the analysis: an hour of riding at 100 Hz with every topic, and the rate of reading beside `rosbags`.

The recording is made of real messages: a superbike rides a flying lap, all that the simulator, the policy and the
recorder publish is serialized, and the lap is written again and again by the recorder, with new stamps, steps and
progress. Analysing and reading happen in fresh processes, so that their memory is their own; wall-clock and processor
time are both told, because only the latter means something on a busy machine.

    python -m bench.analysis_speed
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from bike_analysis.read.columns import MessageSchema
from bike_analysis.read.reading import read_recording
from bike_policy.riders.classical import ClassicalRider
from bike_sim.physics.superbike_engine import TIME_STEP
from bike_sim.recording import LATCHED, MessageType, Qos, RideRecorder, message_type
from bike_sim.ros import messages, standard_messages
from bike_sim.ros.command_gate import Command
from bike_sim.ros.messages import NANOSECONDS
from bike_sim.ros.telemetry_message import telemetry_to_message
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.superbike import Superbike

VEHICLE: Final = "panigale_v4r"
CIRCUIT: Final = "barcelona"
PERIOD: Final = 0.01
"""Control period of the recorded ride, s: 100 Hz."""
HOUR: Final = 3600.0
EXCERPT: Final = 360.0
"""Length of the ride with which the rates of reading are compared, s."""
ROUNDS: Final = 3
DECODED: Final = ("/bike/state", "/bike/command", "/bike/telemetry", "/bike/events", "/bike/course", "/diagnostics")
"""Topics that the analysis decodes; `rosbags` decodes the same."""

_TRANSFORMS: Final = MessageType(
    "tf2_msgs/msg/TFMessage",
    "geometry_msgs/TransformStamped[] transforms\n"
    + "".join(
        f"{'=' * 80}\nMSG: {name}\n{text}\n"
        for name, text in (
            (
                "geometry_msgs/TransformStamped",
                "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
            ),
            ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"),
            ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"),
            ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
            ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
            ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"),
        )
    ),
)
"""Transforms are recorded too, though the wheels bring no package with their type."""


# ----------------------------------------------------------------------------------------------------- the recording


@dataclass(frozen=True)
class _Change:
    """A field that differs from lap to lap: where it lies, how it is packed, and which of the lap's counts it takes."""

    offset: int
    packing: struct.Struct
    what: str


class _LapTopic:
    """Messages of one topic during one lap, which can be written again for any lap."""

    def __init__(self, name: str, kind: MessageType, qos: Qos) -> None:
        self.name, self.kind, self.qos = name, kind, qos
        self.schema = MessageSchema(kind.name, kind.definition)
        self.messages: list[tuple[int, bytes]] = []
        self._changes: dict[int, tuple[_Change, ...]] = {}

    def add(self, step: int, data: bytes) -> None:
        """Add the message of a step."""
        self.messages.append((step, self.schema.trim(data)))

    def once(self, index: int) -> bool:
        """Whether a message belongs to the reset and is not written again with every lap."""
        return self.qos is LATCHED or (index == 0 and self.name == "/bike/events")

    def shifted(self, index: int, counts: dict[str, float]) -> bytes:
        """The message at a place of the list, shifted in time, steps and way by `counts`."""
        data = bytearray(self.messages[index][1])
        changes = self._changes.get(len(data))
        if changes is None:
            changes = self._changes[len(data)] = self._find_changes(bytes(data))
        for change in changes:
            (value,) = change.packing.unpack_from(data, change.offset)
            change.packing.pack_into(data, change.offset, value + counts[change.what])
        return bytes(data)

    def _find_changes(self, data: bytes) -> tuple[_Change, ...]:
        kinds = {
            "header.stamp.sec": ("<i", "seconds"),
            "clock.sec": ("<i", "seconds"),
            "step": ("<I", "steps"),
            "progress": ("<d", "way"),
            "front_progress": ("<d", "way"),
        }
        if self.kind.name.endswith("RideEvent"):
            kinds["time"] = ("<d", "seconds")
        return tuple(
            _Change(place.offset, struct.Struct(kinds[place.name][0]), kinds[place.name][1])
            for place in self.schema.layout(data).places
            if place.name in kinds
        )


def ride_lap() -> tuple[list[_LapTopic], int, float]:
    """Ride one flying lap and serialize all that is published.

    Returns:
        The topics with their messages, the number of steps (whole seconds of them), and the way of the lap along the
        followed line, m.
    """
    machine = Simulator(SimulatorConfig(vehicle=VEHICLE, time_step=TIME_STEP, control_period=PERIOD))
    try:
        request = machine.at_own_speed(ResetRequest(course=CIRCUIT))
        snapshot = machine.reset(request)
        assert machine.course is not None
        assert machine.track is not None
        rider = ClassicalRider()
        rider.begin(machine.vehicle, machine.course, PERIOD, machine.preview)
        writer = _LapWriter(machine, request, snapshot)
        with tqdm(total=round(2.0 * machine.track.length), desc="riding", unit="m", leave=False) as bar:
            while (progress := snapshot.progress) < 2.0 * machine.track.length:
                bar.update(round(progress) - bar.n)
                command = rider.command(snapshot)
                assert command is not None
                steering, throttle = command
                if progress >= machine.track.length:
                    writer.write(snapshot, steering, throttle)
                snapshot = machine.step(steering, throttle)
                if snapshot.fallen:
                    raise RuntimeError(f"the rider of the benchmark fell at {snapshot.time:.1f} s: {snapshot.fall}")
        return writer.finish()
    finally:
        machine.close()


class _LapWriter:
    """Serializes what the simulator and the policy publish during the lap."""

    def __init__(self, machine: Simulator, request: ResetRequest, first: Snapshot) -> None:
        assert machine.course is not None
        assert machine.track is not None
        assert isinstance(machine.vehicle, Superbike)
        self._machine, self._vehicle = machine, machine.vehicle
        self._episode = messages.Episode.of(machine.vehicle, machine.course, machine.preview, PERIOD)
        self._topics: dict[str, _LapTopic] = {}
        self._transforms = get_typestore(Stores.EMPTY)
        self._transforms.register(get_types_from_msg(_TRANSFORMS.definition, _TRANSFORMS.name))
        self._steps = 0
        stamp = NANOSECONDS
        once = messages.episode_start_to_message(request, machine.config, machine.plant.signal_names, 1, stamp)
        self._add("/bike/episode", once, LATCHED)
        self._add("/bike/course", messages.course_to_message(machine.course, 1, stamp), LATCHED)
        self._add("/bike/course_marker", standard_messages.course_marker(machine.course, stamp), LATCHED)
        self._add("/bike/events", messages.event_to_message(first.events[0], first, stamp))

    def write(self, snapshot: Snapshot, steering: float, throttle: float) -> None:
        """Serialize one step."""
        stamp = NANOSECONDS + self._steps * round(PERIOD * NANOSECONDS)
        course = self._episode.course
        seen = _as_step(snapshot, self._steps)
        self._add("/clock", Clock(clock=messages.time_to_message(stamp)))
        self._add("/bike/state", messages.state_to_message(seen, self._episode, stamp))
        self._add("/bike/course_points", messages.course_points_to_message(seen, course, stamp))
        self._add("/bike/lean_history", messages.lean_history_to_message(seen, stamp, round(PERIOD * NANOSECONDS)))
        self._add("/bike/telemetry", telemetry_to_message(seen, self._vehicle, stamp))
        self._add("/bike/odom", standard_messages.odometry(seen, stamp))
        self._add("/bike/joint_states", standard_messages.joint_state(seen, stamp))
        self._add("/bike/markers", standard_messages.vehicle_markers(seen, self._vehicle, stamp))
        self._add_transform(seen, stamp)
        for event in seen.events:
            self._add("/bike/events", messages.event_to_message(event, seen, stamp))
        command = Command(seen.episode, seen.step, steering, throttle)
        self._add("/bike/command", messages.command_to_message(command, stamp))
        if self._steps % round(1.0 / PERIOD) == 0:
            for node, figures in _REPORTS.items():
                self._add("/diagnostics", _report(node, figures, stamp))
        self._steps += 1

    def finish(self) -> tuple[list[_LapTopic], int, float]:
        """What `ride_lap` returns: laps are repeated after whole seconds, so that stamps shift by seconds only."""
        steps = self._steps // round(1.0 / PERIOD) * round(1.0 / PERIOD)
        return list(self._topics.values()), steps, self._episode.course.length

    def _add(self, topic: str, message: Any, qos: Qos | None = None) -> None:
        kind = type(message)
        self._put(topic, f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}", serialize_message(message), qos)

    def _add_transform(self, snapshot: Snapshot, stamp: int) -> None:
        sent = standard_messages.base_transform(snapshot, stamp)
        types = self._transforms.types
        moved, turned = sent.transform.translation, sent.transform.rotation
        time_type, header_type = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
        header = header_type(time_type(sent.header.stamp.sec, sent.header.stamp.nanosec), sent.header.frame_id)
        transform = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](moved.x, moved.y, moved.z),
            types["geometry_msgs/msg/Quaternion"](turned.x, turned.y, turned.z, turned.w),
        )
        stamped = types["geometry_msgs/msg/TransformStamped"](header, sent.child_frame_id, transform)
        data = self._transforms.serialize_cdr(types[_TRANSFORMS.name]([stamped]), _TRANSFORMS.name)
        self._put("/tf", _TRANSFORMS.name, bytes(data), None)

    def _put(self, topic: str, name: str, data: bytes, qos: Qos | None) -> None:
        if topic not in self._topics:
            kind = _TRANSFORMS if name == _TRANSFORMS.name else message_type(name)
            self._topics[topic] = _LapTopic(topic, kind, qos or Qos())
        self._topics[topic].add(self._steps, data)


_REPORTS: Final = {
    "bike/sim_node": {"mode": "lockstep", "episode": 1, "step": 0, "control_steps_per_s": 100.0},
    "bike/drive": {"policy": "classical", "latency_median_ms": 0.11, "latency_p99_ms": 0.34},
    "bike/record": {"path": "hour.mcap", "topics": 14, "messages_written": 0, "messages_dropped": 0},
}
"""What the three nodes report once a second."""


def _report(node: str, figures: dict[str, Any], stamp: int) -> DiagnosticArray:
    values = [KeyValue(key=key, value=str(value)) for key, value in figures.items()]
    message = DiagnosticArray(status=[DiagnosticStatus(name=node, message="riding", values=values)])
    message.header.stamp = messages.time_to_message(stamp)
    return message


def _as_step(snapshot: Snapshot, step: int) -> Snapshot:
    """Return a snapshot as one of the first lap; the lap that ends where this one begins is not repeated with it."""
    later = snapshot.time - step * PERIOD
    # In the laps after, the events within states keep their times: nothing reads them there, but their bytes.
    events = tuple(replace(event, time=event.time - later) for event in snapshot.events if step)
    return replace(snapshot, episode=1, step=step, time=step * PERIOD, events=events)


def write_recording(path: Path, duration: float, lap: tuple[list[_LapTopic], int, float]) -> int:
    """Write a ride of any length.

    Args:
        path: The recording.
        duration: Length of the ride, s.
        lap: What `ride_lap` returned.

    Returns:
        Number of messages.
    """
    topics, steps, way = lap
    schedule = _schedule(topics, steps)
    with RideRecorder(path, overwrite=True, notes={"policy": "classical", "vehicle": VEHICLE}) as recorder:
        for topic in topics:
            recorder.add_topic(topic.name, topic.kind, topic.qos)
        for total in tqdm(range(round(duration / PERIOD)), desc="writing", unit="step", leave=False):
            number, step = divmod(total, steps)
            counts = {"seconds": number * round(steps * PERIOD), "steps": number * steps, "way": number * way}
            stamp = NANOSECONDS + total * round(PERIOD * NANOSECONDS)
            for topic, index in schedule[step]:
                if total and topic.once(index):
                    continue
                recorder.write(topic.name, topic.shifted(index, counts), stamp)
        return recorder.message_count


def _schedule(topics: list[_LapTopic], steps: int) -> list[list[tuple[_LapTopic, int]]]:
    """Which messages are written at each step of a lap."""
    schedule: list[list[tuple[_LapTopic, int]]] = [[] for _ in range(steps)]
    for topic in topics:
        for index, (step, _) in enumerate(topic.messages):
            if step < steps:
                schedule[step].append((topic, index))
    return schedule


# ---------------------------------------------------------------------------------------------------------- measuring


@dataclass(frozen=True)
class Used:
    """What a process used.

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


def read_ours(path: Path) -> int:
    """Read a recording as the analysis does; return the number of messages."""
    return read_recording(path).message_count


def read_rosbags(path: Path) -> int:
    """Read a recording with `rosbags` and decode the topics that the analysis decodes."""
    count = 0
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            count += 1
            if connection.topic in DECODED:
                reader.deserialize(data, connection.msgtype)
    return count


def read_rosbags_raw(path: Path) -> int:
    """Read a recording with `rosbags` and decode nothing."""
    with AnyReader([path]) as reader:
        return sum(1 for _ in reader.messages())


READERS: Final[dict[str, Callable[[Path], int]]] = {
    "reading": read_ours,
    "rosbags": read_rosbags,
    "rosbags_raw": read_rosbags_raw,
}


def reading_rates(path: Path) -> dict[str, float]:
    """Return messages per second of processor time by reader, the best of some rounds in turn."""
    best: dict[str, float] = {}
    for name in tqdm([*READERS] * ROUNDS, desc="reading", unit="reading", leave=False):
        told = json.loads(run_alone("-m", "bench.analysis_speed", "--read", name, str(path)).output)
        best[name] = max(best.get(name, 0.0), told["messages"] / told["processor_s"])
    return {
        "reading_messages_per_s": best["reading"],
        "rosbags_messages_per_s": best["rosbags"],
        "rosbags_raw_messages_per_s": best["rosbags_raw"],
        "reading_to_rosbags_ratio": best["reading"] / best["rosbags"],
        "reading_to_rosbags_raw_ratio": best["reading"] / best["rosbags_raw"],
    }


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


def measure(duration: float = HOUR, excerpt: float = EXCERPT) -> dict[str, Any]:
    """Return all figures of this module.

    Args:
        duration: Length of the ride that is analysed, s.
        excerpt: Length of the ride with which rates of reading are compared, s.
    """
    lap = ride_lap()
    with tempfile.TemporaryDirectory() as folder:
        part, whole = Path(folder) / "excerpt.mcap", Path(folder) / "hour.mcap"
        write_recording(part, excerpt, lap)
        figures = reading_rates(part)  # compiles what is compiled once, before time is taken below
        count = write_recording(whole, duration, lap)
        print(f"analysing {count} messages ...", file=sys.stderr)
        return {**hour_figures(whole, Path(folder) / "out", count), **figures}


def _tell_reading(name: str, path: Path) -> None:
    began = time.process_time()
    count = READERS[name](path)
    print(json.dumps({"messages": count, "processor_s": time.process_time() - began}))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--read"]:
        _tell_reading(sys.argv[2], Path(sys.argv[3]))
    else:
        for key, value in measure().items():
            print(f"{key:30} {value:.4g}")
