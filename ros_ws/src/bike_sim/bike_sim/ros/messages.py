"""Core types as messages of ``bike_msgs`` and back.

Floating-point numbers cross unchanged, so a ride is the same bit for bit on both sides. States and commands pass in
every control step: they travel as bytes, which the type store of `rosbags` writes and reads with the installed
definitions, without a message object of rclpy between. Everything else fills the generated classes; arrays travel as
``array.array``, which those take without looking at each element.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from dataclasses import fields
from functools import lru_cache
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np
from bike_msgs.msg import Course as CourseMessage
from bike_msgs.msg import CoursePoints, EpisodeStart, GripEstimate, LeanHistory, RideEvent, Telemetry
from bike_msgs.srv import Reset
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bike_sim.course import projection
from bike_sim.course.course import Course
from bike_sim.course.random_courses import PathRanges
from bike_sim.physics import state as st
from bike_sim.recording.definitions import message_type
from bike_sim.ros.command_gate import Command
from bike_sim.ros.node_tools import NANOSECONDS, time_to_message
from bike_sim.schema import BIKE_STATE, FLAG, LIMITS, LOOK, OPPONENT, SIGNALS, STATE, TELEMETRY
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import Event, EventKind, WallHit
from bike_sim.sim.request import IN_MESSAGES, Preview, ResetRequest
from bike_sim.sim.snapshot import CircuitView, Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

MAP_FRAME: Final = "map"
FOOTPRINT_FRAME: Final = "base_footprint"
"""Rear contact point, yaw only."""

STATE_TYPE: Final = "bike_msgs/msg/BikeState"
COMMAND_TYPE: Final = "bike_msgs/msg/BikeCommand"
OPPONENTS_TYPE: Final = "bike_msgs/msg/Opponents"

_RANGES: Final = tuple(spec.name for spec in fields(PathRanges))
# ------------------------------------------------------------------------------------------------------------ bytes

_STORE: Final = get_typestore(Stores.EMPTY)
for _kind in (STATE_TYPE, COMMAND_TYPE, OPPONENTS_TYPE):
    _STORE.register(
        {
            name: definition
            for name, definition in get_types_from_msg(message_type(_kind).definition, _kind).items()
            if name not in _STORE.types
        }
    )
_MESSAGES: Final[dict[str, Any]] = dict(_STORE.types)
_State, _Command = _MESSAGES[STATE_TYPE], _MESSAGES[COMMAND_TYPE]
_Opponents = _MESSAGES[OPPONENTS_TYPE]
_Event, _Header = _MESSAGES["bike_msgs/msg/RideEvent"], _MESSAGES["std_msgs/msg/Header"]
_Time = _MESSAGES["builtin_interfaces/msg/Time"]

if not {*BIKE_STATE.names} <= {*_State.__dataclass_fields__}:
    raise ImportError("the installed bike_msgs/BikeState is another version than this software; build the workspace")

_SHOWN: Final = ("episode", "step", "steer_torque", "fallen", "off_course", "finished", "fall")
_ARRAYS: Final = ("preview_x", "preview_y", "signals")
"""Fields of a snapshot that have the same name in the message."""
_CONSTANTS: Final = ("vehicle", "steering_limit", "control_period", "course_length", "course_closed")
"""The same of an episode."""
_shown, _arrays, _constants = attrgetter(*_SHOWN), attrgetter(*_ARRAYS), attrgetter(*_CONSTANTS)
_minimal_state = attrgetter(*STATE.names)
_derived = attrgetter(*LOOK.names)
_beyond = attrgetter(*LIMITS.names[lk.OUTSIDE :])

_preview: Final = lru_cache(maxsize=16)(Preview)
"""States of an episode have the same form of the preview, whose values are checked once."""

_EMPTY: Final = np.zeros(0)
_NO_LIMITS: Final = (0.0, 0.0, 0.0, 0.0)


def _decode(data: bytes, kind: str) -> Any:
    """Return a message of the type store; bytes after its last field are ignored.

    Raises:
        ValueError: the bytes are not such a message.
    """
    if len(data) < 4 or bytes(data[:2]) not in (b"\0\0", b"\0\1"):
        raise ValueError(f"{len(data)} bytes are not a message in plain CDR")
    definition = _STORE.get_msgdef(kind)
    read = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
    body = bytearray(memoryview(data)[4:])  # a copy, in which arrays of numbers are aligned and may be written
    try:
        return read(body, 0, definition.cls, _STORE)[0]
    except (SerdeError, struct.error, ValueError) as error:
        raise ValueError(f"{len(data)} bytes are not a message of type {kind}: {error}") from error


def _header(stamp: int, frame: str) -> Any:
    sec, nanosec = divmod(stamp, NANOSECONDS)
    return _Header(stamp=_Time(sec=sec, nanosec=nanosec), frame_id=frame)


def time_from_message(stamp: Any) -> int:
    """Return the nanoseconds of a time stamp."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


# ------------------------------------------------------------------------------------------------------------ state


class Episode(NamedTuple):
    """Constants of an episode's states.

    Attributes:
        vehicle: name of the vehicle that rides.
        steering_limit: its largest steering set point, or the stop, rad.
        control_period: s.
        course_length: m.
        course_closed: whether the course ends where it begins.
        preview: which points of the line ahead are seen.
    """

    vehicle: str
    steering_limit: float
    control_period: float
    course_length: float
    course_closed: bool
    preview: Preview

    @classmethod
    def of(cls, vehicle: Vehicle, course: Course, preview: Preview, period: float) -> Episode:
        """Return the constants of an episode with a control period (s)."""
        return cls(vehicle.name, float(vehicle.max_steer), float(period), course.length, course.closed, preview)


class StateMessage(NamedTuple):
    """A received state.

    Attributes:
        snapshot: of the state.
        stamp: simulated time, ns.
        episode: that it belongs to.
    """

    snapshot: Snapshot
    stamp: int
    episode: Episode


def encode_state(snapshot: Snapshot, episode: Episode, stamp: int) -> bytes:
    """Return the bytes of ``bike_msgs/BikeState``.

    Args:
        snapshot: to be sent.
        episode: that it belongs to.
        stamp: simulated time, ns.
    """
    view, preview, header = snapshot.circuit, episode.preview, _header(stamp, MAP_FRAME)
    outside, off_track_time, wall_energy, wrong_way = _NO_LIMITS if view is None else view.limits[lk.OUTSIDE :].tolist()
    hit = None if view is None else view.wall
    message = _State.__new__(_State)  # its constructor takes three times as long to take over some fifty fields
    values = vars(message)
    values |= zip(STATE.names, snapshot.state.tolist(), strict=True)
    values |= zip(LOOK.names, snapshot.look.tolist(), strict=True)
    values |= zip(_SHOWN, _shown(snapshot), strict=True)
    values |= zip(_ARRAYS, _arrays(snapshot), strict=True)
    values |= zip(_CONSTANTS, episode, strict=False)
    values |= dict(
        header=header,
        steering_command=snapshot.steering,
        throttle_command=snapshot.throttle,
        preview_by_time=preview.by_time,
        preview_interval=preview.interval,
        roll_history=np.array(snapshot.roll_history, dtype=np.float64),
        steer_history=np.array(snapshot.steer_history, dtype=np.float64),
        centre_place=_EMPTY if view is None else view.place,
        outside=outside,
        limit_margins=_EMPTY if view is None else view.limits[: lk.OUTSIDE],
        off_track_time=off_track_time,
        wall_energy=wall_energy,
        wrong_way=wrong_way != 0.0,
        course_points=_EMPTY if view is None else view.points.ravel(),
        wall_hit=_EMPTY if hit is None else np.array((hit.speed, hit.angle, hit.energy)),
        events=[_Event(header=header, **_event_values(event, snapshot)) for event in snapshot.events],
    )
    return bytes(_STORE.serialize_cdr(message, STATE_TYPE))


def decode_state(data: bytes) -> StateMessage:
    """Return snapshot and episode of a state, bit for bit.

    Raises:
        ValueError: the bytes are not a state.
    """
    message = _decode(data, STATE_TYPE)
    preview = _preview(message.preview_by_time, message.preview_interval, len(message.preview_x))
    episode = Episode._make((*_constants(message), preview))
    return StateMessage(snapshot_from_message(message), time_from_message(message.header.stamp), episode)


def snapshot_from_message(message: Any) -> Snapshot:
    """Return the snapshot in a ``bike_msgs/BikeState`` of rclpy or of the type store, bit for bit.

    Raises:
        ValueError: arrays that do not fit each other.
    """
    preview_x, preview_y, signals = map(np.asarray, _arrays(message))
    rolls, steers = message.roll_history, message.steer_history
    if len(preview_x) != len(preview_y) or len(rolls) != len(steers):
        raise ValueError("a state whose preview or lean history has columns of different length")
    return Snapshot(
        **dict(zip(_SHOWN, _shown(message), strict=True)),
        time=message.step * message.control_period,
        state=np.array(_minimal_state(message)),
        look=np.array(_derived(message)),
        steering=message.steering_command,
        throttle=message.throttle_command,
        preview_x=preview_x,
        preview_y=preview_y,
        roll_history=tuple(rolls.tolist()),
        steer_history=tuple(steers.tolist()),
        signals=signals,
        circuit=_circuit_view(message) if len(message.centre_place) else None,
        events=tuple(map(event_from_message, message.events)) if message.events else (),
    )


def _circuit_view(message: Any) -> CircuitView:
    place, margins, wall = (
        np.asarray(part) for part in (message.centre_place, message.limit_margins, message.wall_hit)
    )
    if len(place) != lk.PLACE_SIZE or len(margins) != lk.OUTSIDE or len(wall) not in (0, len(fields(WallHit))):
        raise ValueError(f"a state with {len(place)} places, {len(margins)} margins and {len(wall)} numbers of a wall")
    limits = np.array((*margins, *map(float, _beyond(message))))
    points = np.asarray(message.course_points).reshape(3, -1, 3)
    return CircuitView(place, limits, points, WallHit(*wall.tolist()) if len(wall) else None)


def encode_command(command: Command, state_stamp: int = 0) -> bytes:
    """Return the bytes of ``bike_msgs/BikeCommand``.

    Args:
        command: the command.
        state_stamp: stamp of the state that it answers, ns.
    """
    message = _Command(
        header=_header(state_stamp, ""),
        episode=command.episode,
        step=command.step,
        steering=float(command.steering),
        throttle=float(command.throttle),
    )
    return bytes(_STORE.serialize_cdr(message, COMMAND_TYPE))


def decode_command(data: bytes) -> Command:
    """Return the command of a message.

    Raises:
        ValueError: the bytes are not a command.
    """
    message = _decode(data, COMMAND_TYPE)
    return Command(message.episode, message.step, message.steering, message.throttle)


def encode_opponents(snapshot: Snapshot, stamp: int, frame: str = FOOTPRINT_FRAME) -> bytes:
    """Return the bytes of ``bike_msgs/Opponents``.

    Args:
        snapshot: of a race.
        stamp: simulated time, ns.
        frame: base_footprint of the machine.
    """
    assert snapshot.opponents is not None, "it is a snapshot of a race"
    columns = np.ascontiguousarray(snapshot.opponents.T)
    numbers = dict(zip(OPPONENT.names[1:], columns[1:], strict=True))
    message = _Opponents(
        header=_header(stamp, frame), episode=snapshot.episode, step=snapshot.step, present=columns[0] != 0.0, **numbers
    )
    return bytes(_STORE.serialize_cdr(message, OPPONENTS_TYPE))


def decode_opponents(data: bytes) -> tuple[int, int, FloatArray]:
    """Return episode, step and what is seen of the nearest others, as in `Snapshot.opponents`, bit for bit.

    Raises:
        ValueError: the bytes are no such message.
    """
    message = _decode(data, OPPONENTS_TYPE)
    columns = [np.asarray(getattr(message, name), dtype=np.float64) for name in OPPONENT.names]
    return message.episode, message.step, np.stack(columns, axis=1)


# ------------------------------------------------------------------------------------------------------------ reset


def reset_to_message(request: ResetRequest) -> Reset.Request:
    """Return the service request for an episode."""
    message = Reset.Request()
    _fill_request(message, request)
    return message


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
    for names, source in ((IN_MESSAGES, request), (_RANGES, request.path_ranges)):
        for name in names:
            setattr(message, name, type(getattr(message, name))(getattr(source, name)))
    message.speed_min, message.speed_max = map(float, request.speed_range)
    if request.initial_state is not None:
        message.initial_state = _floats(request.initial_state)
    message.path_length = float(request.path_length or 0.0)
    message.preview_count = int(request.preview.count)
    message.preview_by_time = bool(request.preview.by_time)
    message.preview_interval = float(request.preview.interval)
    message.context = array("d", request.context)


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
    _stamp_message(message, snapshot, stamp, FOOTPRINT_FRAME)
    message.progress = float(snapshot.look[lk.PROGRESS])
    message.lateral_error = float(snapshot.look[lk.LATERAL_ERROR])
    message.heading_error = float(snapshot.look[lk.HEADING_ERROR])
    if snapshot.circuit is not None:
        for name, row in (("line", lk.LINE), ("left", lk.LEFT), ("right", lk.RIGHT)):
            setattr(message, name, [Point(x=x, y=y, z=z) for x, y, z in snapshot.circuit.points[row].tolist()])
        return message
    message.line = _points(snapshot.preview_x, snapshot.preview_y)
    for name, width, side in (("left", course.width_left, 1.0), ("right", course.width_right, -1.0)):
        if width is not None:
            setattr(message, name, _limit(snapshot, course, side * width))
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
        _, _, tx, ty = projection.point_at(course.samples, s)
        x[k] = snapshot.preview_x[k] - distance[k] * (cos * ty - sin * tx)
        y[k] = snapshot.preview_y[k] + distance[k] * (cos * tx + sin * ty)
    return _points(x, y)


# ---------------------------------------------------------------------------------------------------------- history


def grip_to_message(estimate: tuple[float, float, float], snapshot: Snapshot, stamp: int) -> GripEstimate:
    """Return a message of the grip that a rider infers.

    Args:
        estimate: grip here, grip expected, and standard deviation of the error.
        snapshot: that it is inferred from.
        stamp: simulated time of the snapshot, ns.
    """
    message = GripEstimate()
    _stamp_message(message, snapshot, stamp, FOOTPRINT_FRAME)
    message.grip, message.expected, message.deviation = estimate
    return message


def lean_history_to_message(snapshot: Snapshot, stamp: int, period: int) -> LeanHistory:
    """Return the last roll and steer angles with their times.

    Args:
        snapshot: to be sent.
        stamp: simulated time of the snapshot, ns.
        period: control period, ns.
    """
    message = LeanHistory()
    _stamp_message(message, snapshot, stamp, FOOTPRINT_FRAME)
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
        event: of the ride.
        snapshot: the snapshot that reported it.
        stamp: simulated time of the snapshot, ns.
    """
    message = RideEvent(**_event_values(event, snapshot))
    message.header.stamp, message.header.frame_id = time_to_message(stamp), MAP_FRAME
    return message


def _event_values(event: Event, snapshot: Snapshot) -> dict[str, Any]:
    numbers = {name: float(getattr(event, name)) for name in ("time", "progress", "value")}
    return {"episode": snapshot.episode, "step": snapshot.step, "kind": int(event.kind), "text": event.text} | numbers


def event_from_message(message: Any) -> Event:
    """Return the event in a message."""
    return Event(EventKind(message.kind), message.time, message.progress, message.value, message.text)


# -------------------------------------------------------------------------------------------------------- telemetry

_COPIED: Final = tuple((q.name, SIGNALS.index(q.signal), q.unit == FLAG) for q in TELEMETRY if q.signal)
"""Fields that carry a signal: name, place of the signal, whether it is a flag."""

_REAR_LOAD, _FRONT_LOAD = SIGNALS.index("rear_load"), SIGNALS.index("front_load")
_DRIVE, _REAR_BRAKE, _FRONT_BRAKE = (SIGNALS.index(name) for name in ("drive_torque", "rear_brake", "front_brake"))


def telemetry_to_message(snapshot: Snapshot, vehicle: Superbike, stamp: int) -> Telemetry:
    """Return tyres, engine, brakes and electronics of a superbike.

    Args:
        snapshot: to be sent.
        vehicle: the superbike; its radii turn torques into forces.
        stamp: simulated time, ns.
    """
    message = Telemetry()
    _stamp_message(message, snapshot, stamp, FOOTPRINT_FRAME)
    measured = snapshot.signals.tolist()
    for name, place, is_flag in _COPIED:
        setattr(message, name, measured[place] != 0.0 if is_flag else measured[place])
    message.engine_force = measured[_DRIVE] / vehicle.rR
    message.rear_brake_force = measured[_REAR_BRAKE] / vehicle.rR
    message.front_brake_force = measured[_FRONT_BRAKE] / vehicle.rF
    message.rear_contact_lost = measured[_REAR_LOAD] <= 0.0
    message.front_contact_lost = measured[_FRONT_LOAD] <= 0.0
    return message


# ---------------------------------------------------------------------------------------------------------- helpers


def _stamp_message(message: Any, snapshot: Snapshot, stamp: int, frame: str) -> None:
    """Fill header, episode and step of a message about a snapshot at a simulated time, ns."""
    message.header.stamp = time_to_message(stamp)
    message.header.frame_id = frame
    message.episode = snapshot.episode
    message.step = snapshot.step


def _floats(values: Sequence[float] | FloatArray) -> array[float]:
    return array("d", np.asarray(values, dtype=np.float64).tobytes())


def _points(x: FloatArray, y: FloatArray) -> list[Point]:
    return [Point(x=a, y=b, z=0.0) for a, b in zip(x.tolist(), y.tolist(), strict=True)]
