"""Core types as messages of ``bike_msgs`` and back; states and commands travel by `bike_sim.ros.wire`.

Floating-point numbers cross unchanged, so a ride is the same bit for bit on both sides. Arrays travel as
``array.array``, which the generated classes take without looking at each element.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Final

import numpy as np
from bike_msgs.msg import BikeCommand, BikeState, CoursePoints, EpisodeStart, LeanHistory, RideEvent
from bike_msgs.msg import Course as CourseMessage
from bike_msgs.srv import Reset
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message

from bike_sim.course import projection
from bike_sim.course.course import Course
from bike_sim.course.random_paths import PathRanges
from bike_sim.physics import state as st
from bike_sim.ros.command_gate import Command
from bike_sim.ros.stamps import NANOSECONDS as NANOSECONDS
from bike_sim.ros.stamps import stamp_message
from bike_sim.ros.stamps import time_from_message as time_from_message
from bike_sim.ros.stamps import time_to_message as time_to_message
from bike_sim.ros.wire import BASE_FRAME as BASE_FRAME
from bike_sim.ros.wire import MAP_FRAME as MAP_FRAME
from bike_sim.ros.wire import Episode as Episode
from bike_sim.ros.wire import decode_state, encode_command, encode_state
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import Event, EventKind
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.snapshot import Snapshot

FloatArray = NDArray[np.float64]

_OWN: Final = -1.0
"""What line and progress of a reset say to keep the simulator's own."""

_RANGE_FIELDS: Final = (
    "radius_min",
    "radius_max",
    "quintic_length_min",
    "quintic_length_max",
    "quintic_width_min",
    "quintic_width_max",
)


# ------------------------------------------------------------------------------------------------------------ state


def state_to_message(snapshot: Snapshot, episode: Episode, stamp: int) -> BikeState:
    """Return the message of a snapshot; see `bike_sim.ros.wire.encode_state`, which makes its bytes.

    Args:
        snapshot: to be sent.
        episode: that it belongs to.
        stamp: simulated time, ns.
    """
    return deserialize_message(encode_state(snapshot, episode, stamp), BikeState)


def snapshot_from_message(message: BikeState) -> Snapshot:
    """Return the snapshot in a message, bit for bit."""
    return decode_state(serialize_message(message)).snapshot


def command_to_message(command: Command, state_stamp: int = 0) -> BikeCommand:
    """Return the message of a command, which answers a state with a stamp (ns)."""
    return deserialize_message(encode_command(command, state_stamp), BikeCommand)


# ------------------------------------------------------------------------------------------------------------ reset


def reset_to_message(request: ResetRequest) -> Reset.Request:
    """Return the service request for an episode."""
    message = Reset.Request()
    _fill_request(message, request)
    return message


def reset_from_message(message: Reset.Request, own: ResetRequest) -> ResetRequest:
    """Return the request for an episode in a service request.

    Args:
        message: the request. Its seed must have been drawn already if it was negative.
        own: the simulator's own settings, which serve where the message leaves something open.

    Raises:
        ValueError: naming the invalid value.
    """
    ranges = {name: getattr(message, name) for name in _RANGE_FIELDS}
    preview = own.preview
    if message.preview_count:
        preview = Preview(message.preview_by_time, message.preview_interval, message.preview_count)
    speed = (message.speed_min, message.speed_max)
    return ResetRequest(
        seed=message.seed,
        course=message.course or own.course,
        speed_range=own.speed_range if speed == (0.0, 0.0) else speed,
        perturb=message.perturb,
        initial_state=tuple(message.initial_state) or None,
        path_ranges=PathRanges(**ranges) if any(ranges.values()) else own.path_ranges,
        path_length=message.path_length or own.path_length,
        preview=preview,
        context=tuple(message.context),
        line=own.line if message.line == _OWN else message.line,
        progress=own.progress if message.progress == _OWN else message.progress,
        speed_share=message.speed_share,
        start_offset=message.start_offset,
        start_heading=message.start_heading,
    )


def episode_start_to_message(
    request: ResetRequest, config: SimulatorConfig, signal_names: Sequence[str], episode: int, stamp: int
) -> EpisodeStart:
    """Return the message of how an episode began.

    Args:
        request: the request that was met.
        config: the simulator.
        signal_names: of the telemetry.
        episode: number of the episode.
        stamp: simulated time of the first state, ns.
    """
    message = EpisodeStart()
    message.header.stamp = time_to_message(stamp)
    message.episode = episode
    for spec in fields(config):
        setattr(message, spec.name, getattr(config, spec.name))
    _fill_request(message, request)
    message.signal_names = list(signal_names)
    return message


def _fill_request(message: Reset.Request | EpisodeStart, request: ResetRequest) -> None:
    """Set the fields that a reset and the start of an episode have in common."""
    message.seed = int(request.seed)
    message.course = request.course
    message.speed_min, message.speed_max = map(float, request.speed_range)
    message.perturb = bool(request.perturb)
    if request.initial_state is not None:
        message.initial_state = _floats(request.initial_state)
    for name in _RANGE_FIELDS:
        setattr(message, name, float(getattr(request.path_ranges, name)))
    message.path_length = float(request.path_length or 0.0)
    message.preview_count = int(request.preview.count)
    message.preview_by_time = bool(request.preview.by_time)
    message.preview_interval = float(request.preview.interval)
    message.context = array("d", request.context)
    message.line = float(request.line)
    message.progress = float(request.progress)
    message.speed_share = float(request.speed_share)
    message.start_offset = float(request.start_offset)
    message.start_heading = float(request.start_heading)


# ----------------------------------------------------------------------------------------------------------- course


_COLUMNS: Final = ("s", "x", "y", "heading", "curvature")
_OPTIONAL_COLUMNS: Final = ("width_left", "width_right", "height", "bank", "grip")
"""Columns of a course in its message; the latter are empty where a course has none."""


def course_to_message(course: Course, episode: int, stamp: int) -> CourseMessage:
    """Return the message of a complete course.

    Args:
        course: the course.
        episode: number of the episode that it is ridden in.
        stamp: simulated time, ns.
    """
    message = CourseMessage()
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = MAP_FRAME
    message.episode = episode
    message.name = course.name
    message.closed = course.closed
    message.length = course.length
    message.off_course_limit = float(course.off_course_limit)
    for name in _COLUMNS + _OPTIONAL_COLUMNS:
        column = getattr(course, name)
        if column is not None:
            setattr(message, name, _floats(column))
    message.section_names = [name for name, _ in course.sections]
    message.section_starts = array("d", (start for _, start in course.sections))
    return message


def course_from_message(message: CourseMessage) -> Course:
    """Return the course in a message.

    Raises:
        ValueError: columns that do not describe a course.
    """
    found = {name: getattr(message, name) for name in _COLUMNS + _OPTIONAL_COLUMNS}
    columns: dict[str, Any] = {
        name: np.array(column) if column or name in _COLUMNS else None for name, column in found.items()
    }
    return Course(
        name=message.name,
        closed=message.closed,
        off_course_limit=message.off_course_limit,
        sections=tuple(zip(message.section_names, message.section_starts, strict=True)),
        **columns,
    )


def course_points_to_message(snapshot: Snapshot, course: Course, stamp: int) -> CoursePoints:
    """Return the preview of the followed line and of both limits.

    Args:
        snapshot: to be sent.
        course: the course that is followed.
        stamp: simulated time, ns.
    """
    message = CoursePoints()
    stamp_message(message, snapshot, stamp, BASE_FRAME)
    message.progress = float(snapshot.look[lk.PROGRESS])
    message.lateral_error = float(snapshot.look[lk.LATERAL_ERROR])
    message.heading_error = float(snapshot.look[lk.HEADING_ERROR])
    if snapshot.circuit is not None:
        for name, row in (("line", lk.LINE), ("left", lk.LEFT), ("right", lk.RIGHT)):
            setattr(message, name, [Point(x=x, y=y, z=z) for x, y, z in snapshot.circuit.points[row].tolist()])
        return message
    message.line = _points(snapshot.preview_x, snapshot.preview_y)
    if course.width_left is not None:
        message.left = _limit(snapshot, course, course.width_left)
    if course.width_right is not None:
        message.right = _limit(snapshot, course, -course.width_right)
    return message


def _limit(snapshot: Snapshot, course: Course, offset: FloatArray) -> list[Point]:
    """Return points at a lateral distance (m, positive left, given along the course) from the preview points."""
    count = len(snapshot.preview_x)
    stations = snapshot.look[lk.PROGRESS] + np.arange(count) * snapshot.look[lk.PREVIEW_SPACING]
    inside = stations % course.length if course.closed else np.clip(stations, 0.0, course.length)
    distance = np.interp(inside, course.s, offset)
    x, y = np.empty(count), np.empty(count)
    yaw = snapshot.state[st.YAW]
    cos, sin = np.cos(yaw), np.sin(yaw)
    for k, s in enumerate(stations):
        _, _, tx, ty = projection.point_at(course.x, course.y, course.heading, course.spacing, course.closed, s)
        x[k] = snapshot.preview_x[k] - distance[k] * (cos * ty - sin * tx)
        y[k] = snapshot.preview_y[k] + distance[k] * (cos * tx + sin * ty)
    return _points(x, y)


# ---------------------------------------------------------------------------------------------------------- history


def lean_history_to_message(snapshot: Snapshot, stamp: int, period: int) -> LeanHistory:
    """Return the last roll and steer angles with their times.

    Args:
        snapshot: to be sent.
        stamp: simulated time of the snapshot, ns.
        period: control period, ns.
    """
    message = LeanHistory()
    stamp_message(message, snapshot, stamp, BASE_FRAME)
    count = len(snapshot.roll_history)
    message.stamps = [time_to_message(stamp - (count - 1 - k) * period) for k in range(count)]
    message.roll = array("d", snapshot.roll_history)
    message.steer = array("d", snapshot.steer_history)
    message.roll_delta = _floats(np.diff(snapshot.roll_history, prepend=snapshot.roll_history[:1]))
    message.steer_delta = _floats(np.diff(snapshot.steer_history, prepend=snapshot.steer_history[:1]))
    return message


# ----------------------------------------------------------------------------------------------------------- events


def event_to_message(event: Event, snapshot: Snapshot, stamp: int) -> RideEvent:
    """Return the message of an event.

    Args:
        event: what happened.
        snapshot: the snapshot that reported it.
        stamp: simulated time of the snapshot, ns.
    """
    message = RideEvent()
    stamp_message(message, snapshot, stamp, MAP_FRAME)
    message.kind = int(event.kind)
    message.time = float(event.time)
    message.progress = float(event.progress)
    message.value = float(event.value)
    message.text = event.text
    return message


def event_from_message(message: RideEvent) -> Event:
    """Return the event in a message."""
    return Event(EventKind(message.kind), message.time, message.progress, message.value, message.text)


def _floats(values: Sequence[float] | FloatArray) -> array[float]:
    return array("d", np.asarray(values, dtype=np.float64).tobytes())


def _points(x: FloatArray, y: FloatArray) -> list[Point]:
    return [Point(x=a, y=b, z=0.0) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
