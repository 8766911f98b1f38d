"""Synthetic rides of known closed form, written through the real recorder and serialized by the rosbags library."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bike_sim.recording.definitions import message_type
from bike_sim.recording.metadata import LATCHED, Qos
from bike_sim.recording.recorder import RideRecorder

TYPES = {
    "/bike/state": "bike_msgs/msg/BikeState",
    "/bike/command": "bike_msgs/msg/BikeCommand",
    "/bike/course": "bike_msgs/msg/Course",
    "/bike/events": "bike_msgs/msg/RideEvent",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
PERIOD = 0.05  # s
EVIL_NAMES = (
    "<!--<script>",
    "</script><script>alert(1)</script>",
    "--><img src=x onerror=alert(1)>",
    "\x1b[2J\x1b[31mred\x07",
    "one\ntwo\r\u2028three\u2029",
    "\u202eesrever",
    "$\\frac{1}{$",
    "&lt;b&gt; <b>&amp;</b>",
    "円周路",
    "\"'` onclick=alert(1)",
    "n" * 5000,
)
"""Names that a page, a terminal or a picture might take for something else."""


class Messages:
    """Makes and serializes messages of the types above."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.EMPTY)
        for name in TYPES.values():
            self.learn(name)

    def learn(self, name: str) -> None:
        """Get to know a type of an installed package."""
        fresh = get_types_from_msg(message_type(name).definition, name)
        self.store.register({k: v for k, v in fresh.items() if k not in self.store.fielddefs})

    def make(self, name: str, /, **values: Any) -> Any:
        """Make a message; fields that are not given are zero."""
        fields = {}
        for key, descriptor in self.store.fielddefs[name][1]:
            fields[key] = values.pop(key) if key in values else self._zero(descriptor)
        assert not values, f"{name} has no {sorted(values)}"
        return self.store.types[name](**fields)

    def _zero(self, descriptor: Any) -> Any:
        kind, detail = descriptor
        if kind.name == "NAME":
            return self.make(detail)
        if kind.name == "BASE":
            return {"string": "", "bool": False}.get(detail[0], 0)
        (inner, of), count = detail
        numeric = inner.name == "BASE" and of[0] != "string"
        return np.zeros(count if kind.name == "ARRAY" else 0, dtype=of[0]) if numeric else []

    def header(self, time_s: float) -> Any:
        nanoseconds = round(time_s * 1e9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="map")

    def cdr(self, name: str, message: Any) -> bytes:
        return bytes(self.store.serialize_cdr(message, name))


@dataclass
class SyntheticRide:
    """Columns of a ride by message field, and what else was said during it."""

    states: dict[str, Any]
    episode: int = 1
    start_s: float = 1.0
    course: dict[str, Any] | None = None
    events: list[dict[str, Any]] = field(default_factory=list)
    delay: int = 0
    skip_steps: frozenset[int] = frozenset()
    latency_ms: tuple[float, float] | None = None
    stamps: Any = None

    @property
    def steps(self) -> int:
        return len(self.states["x"])


def circle_ride(
    steps: int = 400, radius: float = 10.0, offset: float | np.ndarray = 0.3, speed: float = 4.0, **options: Any
) -> SyntheticRide:
    """Ride around a left-turning circle about (0, radius), `offset` m to the left of it, that is inside."""
    offset = np.broadcast_to(np.asarray(offset, dtype=float), (steps,))
    progress = speed * PERIOD * np.arange(steps)
    angle = progress / radius
    states = {
        "x": (radius - offset) * np.sin(angle),
        "y": radius - (radius - offset) * np.cos(angle),
        "yaw": angle,
        "roll": np.full(steps, -np.arctan(speed**2 / (9.81 * radius))),
        "steer": np.full(steps, 0.1),
        "speed": np.full(steps, speed),
        "progress": progress,
        "course_length": np.full(steps, 2.0 * np.pi * radius),
        "course_closed": np.full(steps, True),
        "vehicle": np.full(steps, "whipple"),
        "steering_limit": np.full(steps, np.radians(70.0)),
        "lateral_error": offset.copy(),
        "curvature": np.full(steps, 1.0 / radius),
        "steering_command": 0.2 * np.sin(0.37 * np.arange(steps)),
    }
    s = np.arange(0.0, 2.0 * np.pi * radius, 0.1)
    course = {
        "name": "circle",
        "closed": True,
        "length": 2.0 * np.pi * radius,
        "off_course_limit": 3.5,
        "s": s,
        "x": radius * np.sin(s / radius),
        "y": radius - radius * np.cos(s / radius),
        "curvature": np.full(len(s), 1.0 / radius),
        "section_names": ["first half", "second half"],
        "section_starts": np.array([0.0, np.pi * radius]),
    }
    return SyntheticRide(states, course=course, **options)


class EpisodeWriter:
    """Writes synthetic rides as a recording."""

    def __init__(self, messages: Messages) -> None:
        self.messages = messages

    def write(self, path: Path, rides: Iterable[SyntheticRide], topics: Iterable[str] = TYPES, **options: Any) -> Path:
        # Small chunks, so that a short ride has several of them.
        options = {"chunk_bytes": 64 * 1024, **options}
        with RideRecorder(path, **options) as recorder:
            recorder.flush_period_s = 1e9
            for topic in topics:
                recorder.add_topic(topic, TYPES[topic], LATCHED if topic == "/bike/course" else Qos())
            for ride in rides:
                self._write_ride(recorder, ride)
        return recorder.path

    def _write_ride(self, recorder: RideRecorder, ride: SyntheticRide) -> None:
        if ride.course is not None:
            self._put(recorder, "/bike/course", ride.start_s, episode=ride.episode, **ride.course)
        for step in range(ride.steps):
            time_s = ride.start_s + PERIOD * step if ride.stamps is None else float(ride.stamps[step])
            values = {name: _plain(column[step]) for name, column in ride.states.items()}
            header = {"episode": ride.episode, "step": step}
            if step not in ride.skip_steps:
                extra = {"control_period": PERIOD, "preview_x": np.arange(5.0), "preview_y": np.zeros(5)}
                self._put(recorder, "/bike/state", time_s, **{**header, **extra, **values})
            for event in ride.events:
                if event["step"] == step:
                    self._put(recorder, "/bike/events", time_s, **{"episode": ride.episode, **event})
            if step + 1 + ride.delay < ride.steps:  # the command that is applied `delay` steps late
                applied = _plain(ride.states["steering_command"][step + 1 + ride.delay])
                self._put(recorder, "/bike/command", time_s, **header, steering=applied)
            if ride.latency_ms and step % 20 == 0:
                self._put_latency(recorder, time_s, ride.latency_ms)

    def _put(self, recorder: RideRecorder, topic: str, time_s: float, **values: Any) -> None:
        if topic in recorder.topics:
            message = self.messages.make(TYPES[topic], header=self.messages.header(time_s), **values)
            recorder.write(topic, self.messages.cdr(TYPES[topic], message), round(time_s * 1e9))

    def _put_latency(self, recorder: RideRecorder, time_s: float, latency_ms: tuple[float, float]) -> None:
        make = self.messages.make
        pairs = {"answers": "20", "latency_median_ms": str(latency_ms[0]), "latency_p99_ms": str(latency_ms[1])}
        values = [make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in pairs.items()]
        status = make("diagnostic_msgs/msg/DiagnosticStatus", name="drive", level=0, values=values)
        self._put(recorder, "/diagnostics", time_s, status=[status])


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


@pytest.fixture(scope="session")
def messages() -> Messages:
    return Messages()


@pytest.fixture(scope="session")
def writer(messages: Messages) -> EpisodeWriter:
    return EpisodeWriter(messages)


@pytest.fixture(scope="session")
def circle() -> Callable[..., SyntheticRide]:
    return circle_ride


@pytest.fixture(scope="session")
def old_recording() -> Path:
    """A ride that an older version recorded; see `test_old_recordings.py`."""
    return Path(__file__).parent / "recordings" / "ride_of_2be20ba.mcap"


@pytest.fixture(scope="session")
def evil_names() -> tuple[str, ...]:
    return EVIL_NAMES
