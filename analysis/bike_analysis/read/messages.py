"""Messages that are decoded one by one: beginnings, courses, events, and what nodes report on diagnostics."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from bike_analysis.read.tables import LARGEST, Floats

EVENT_KINDS: Final = ("reset", "fall", "off_course", "wall", "lap", "finish", "sector", "back_on_course")
"""Names of ``RideEvent.kind``, by number."""
LONGEST_COURSE: Final = 1e7
"""m."""
DECODED_BY_MESSAGE: Final = (
    *("bike_msgs/msg/EpisodeStart", "bike_msgs/msg/Course", "bike_msgs/msg/RideEvent"),
    "diagnostic_msgs/msg/DiagnosticArray",
)
"""Types of these messages."""

_COURSE_ARRAYS: Final = ("s", "x", "y", "curvature", "width_left", "width_right", "section_starts")
_LATENCY_KEY: Final = re.compile(r"^(?:\w+_)?latency_(median|p50|p99)_(s|ms|us)$")
_COUNT: Final = re.compile(r"[0-9]{1,18}")
_SECONDS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


@dataclass(frozen=True)
class Simulation:
    """Engine and step by which the motion was computed (``bike_msgs/EpisodeStart``).

    Attributes:
        engine: Physics engine; empty where it was not recorded.
        time_step: Integration step, s; 0 where it was not recorded.
    """

    engine: str
    time_step: float


@dataclass(frozen=True)
class RecordedCourse:
    """A followed line (``bike_msgs/Course``).

    Attributes:
        order: Place of the message in the recording.
        episode: Episode in which it is followed.
        name: Its name.
        closed: Whether it ends where it begins.
        length: Its length, m.
        off_course_limit: Lateral error beyond which a ride counts as off course, m.
        s: Arc length of each sample, m.
        x: Samples in map, m.
        y: Samples in map, m.
        curvature: 1/m, positive turning left.
        width_left: From the line to the left limit, m; empty without limits.
        width_right: From the line to the right limit, m; empty without limits.
        section_names: Names of its sections, in order.
        section_starts: Arc length at which each section begins, m.
    """

    order: int
    episode: int
    name: str
    closed: bool
    length: float
    off_course_limit: float
    s: Floats
    x: Floats
    y: Floats
    curvature: Floats
    width_left: Floats
    width_right: Floats
    section_names: tuple[str, ...]
    section_starts: Floats


@dataclass(frozen=True)
class RecordedEvent:
    """Something that happened in a ride (``bike_msgs/RideEvent``).

    Attributes:
        order: Place of the message in the recording.
        episode: Episode.
        step: Step that reported it.
        kind: One of `EVENT_KINDS`, or ``kind_<number>`` if it is newer than this program.
        time_s: Time since the reset, s.
        progress_m: Where, as arc length, m.
        value: See ``RideEvent.msg``; depends on the kind.
        text: One sentence for people.
    """

    order: int
    episode: int
    step: int
    kind: str
    time_s: float
    progress_m: float
    value: float
    text: str


@dataclass(frozen=True)
class Latency:
    """Wall-clock time that the policy took to answer, as it reported it on diagnostics.

    Attributes:
        order: Place of the message in the recording.
        median_s: Median, s; NaN where it was not reported.
        p99_s: 99th percentile, s; NaN where it was not reported.
    """

    order: int
    median_s: float
    p99_s: float


def simulation_of(_: int, message: Any) -> Simulation:
    """Engine and step of an episode; empty and 0 where it does not state them.

    Raises:
        ValueError: If its step is no time.
    """
    time_step = float(getattr(message, "time_step", 0.0))
    if not 0.0 <= time_step <= LARGEST:
        raise ValueError(f"a time step of {time_step:.3g} s")
    return Simulation(str(getattr(message, "engine", "")), time_step)


def course_of(order: int, message: Any) -> RecordedCourse:
    """A course.

    Raises:
        ValueError: If its columns do not describe one.
    """
    arrays: dict[str, Any] = {name: np.array(getattr(message, name), dtype=np.float64) for name in _COURSE_ARRAYS}
    course = RecordedCourse(
        order,
        *(int(message.episode), str(message.name), bool(message.closed)),
        *(float(message.length), float(message.off_course_limit)),
        section_names=tuple(map(str, message.section_names)),
        **arrays,
    )
    if not 0.0 < course.length <= LONGEST_COURSE:
        raise ValueError(f"a course of {course.length:.3g} m")
    if not len(course.s) == len(course.x) == len(course.y):
        raise ValueError("columns of unequal length")
    if len(course.section_names) != len(course.section_starts):
        raise ValueError(f"{len(course.section_names)} names for {len(course.section_starts)} sections")
    for name in _COURSE_ARRAYS:
        if not (np.abs(getattr(course, name)) <= LARGEST).all():
            raise ValueError(f"{name} has values that cannot be")
    return course


def event_of(order: int, message: Any) -> RecordedEvent:
    """An event."""
    kind = int(message.kind)
    name = EVENT_KINDS[kind] if kind < len(EVENT_KINDS) else f"kind_{kind}"
    numbers = (float(message.time), float(message.progress), float(message.value))
    return RecordedEvent(order, int(message.episode), int(message.step), name, *numbers, str(message.text))


@dataclass(frozen=True)
class Report:
    """One status of a DiagnosticArray: place in the recording, name of who reports, values by key."""

    order: int
    name: str
    values: dict[str, str]


def reports_of(order: int, message: Any) -> list[Report]:
    """The statuses of a DiagnosticArray."""
    return [
        Report(order, str(status.name), {str(pair.key): str(pair.value) for pair in status.values})
        for status in message.status
    ]


def own_reports(reports: Sequence[Report], namespace: str) -> Sequence[Report]:
    """Reports of the nodes in a namespace; all reports if there are none."""
    prefix = f"{namespace.strip('/')}/".lstrip("/")
    names = [report.name.lstrip("/") for report in reports]
    inside = [name.startswith(prefix) if prefix else "/" not in name for name in names]
    return [report for report, mine in zip(reports, inside, strict=True) if mine] or reports


def latency_of(report: Report) -> Latency | None:
    """Latency in a report: values named ``latency_median_ms`` and ``latency_p99_ms`` (or in s or us)."""
    found: dict[str, float] = {}
    for key, text in report.values.items():
        match = _LATENCY_KEY.match(key)
        if match is None:
            continue
        try:
            value = float(text) * _SECONDS[match[2]]
        except ValueError:
            continue
        found["p99" if match[1] == "p99" else "median"] = value
    if not found:
        return None
    return Latency(report.order, found.get("median", np.nan), found.get("p99", np.nan))


def dropped_messages(reports: Sequence[Report], namespace: str) -> int | None:
    """Messages that the recorder dropped, from its reports: that of the vehicle, where several report."""
    counted = [report for report in reports if _COUNT.fullmatch(report.values.get("messages_dropped", ""))]
    return max((int(report.values["messages_dropped"]) for report in own_reports(counted, namespace)), default=None)
