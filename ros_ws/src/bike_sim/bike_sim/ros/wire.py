"""States and commands as the bytes that travel, without a message object between.

These two pass in every control step. Written field by field through their generated classes they cost several times the
bytes themselves (``bike bench ros``). The sent message is the same bit for bit; `tests/ros/test_wire.py` compares both
ways.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from bike_msgs.msg import BikeCommand, BikeState, RideEvent
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.ros.cdr import Codec
from bike_sim.ros.command_gate import Command
from bike_sim.ros.stamps import NANOSECONDS
from bike_sim.sim import look as lk
from bike_sim.sim.events import Event, EventKind, WallHit
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import CircuitView, Snapshot
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

MAP_FRAME: Final = "map"
BASE_FRAME: Final = "base_link"

_STATE: Final = Codec(
    BikeState.get_fields_and_field_types(), {"bike_msgs/RideEvent": RideEvent.get_fields_and_field_types()}
)
_COMMAND: Final = Codec(BikeCommand.get_fields_and_field_types())

# Offsets of blocks of neighbouring values in a state.
_HEAD: Final = 8  # stamp (2), frame, episode, step, control period, vehicle, steering limit
_LOOKED: Final = (
    lk.PROGRESS,
    lk.LATERAL_ERROR,
    lk.FRONT_PROGRESS,
    lk.FRONT_LATERAL_ERROR,
    lk.HEADING_ERROR,
    lk.CURVATURE,
)
_NAMES: Final = (
    *("header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "episode", "step", "control_period", "vehicle"),
    "steering_limit",
    *st.FIELDS,
    *lk.FIELDS[: lk.PROGRESS],
    *("steering_command", "throttle_command", "steer_torque"),
    *("progress", "course_length", "course_closed"),
    *(lk.FIELDS[place] for place in _LOOKED[1:]),
    *("preview_by_time", "preview_interval", "preview_spacing", "preview_x", "preview_y"),
    *("roll_history", "steer_history", "fallen", "off_course", "finished"),
    *("fall", "signals", "centre_place", "outside", "limit_margins", "off_track_time", "wall_energy", "wrong_way"),
    *("course_points", "wall_hit", "events"),
)
"""Values of a state in the order in which :func:`encode_state` gives them."""

if _STATE.names != _NAMES:  # a changed message that this module does not know
    raise ImportError(f"bike_msgs/BikeState is another version: it has {_STATE.names}; build the workspace again")

_EMPTY: Final = np.zeros(0)
_NO_LIMITS: Final = (0.0, _EMPTY, 0.0, 0.0, False)


class Episode(NamedTuple):
    """What stays the same over the states of an episode.

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
        """Return the facts of an episode with a control period (s)."""
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
    look, view, preview = snapshot.look.tolist(), snapshot.circuit, episode.preview
    sec, nanosec = divmod(stamp, NANOSECONDS)
    return _STATE.encode(
        (
            sec,
            nanosec,
            MAP_FRAME,
            snapshot.episode,
            snapshot.step,
            episode.control_period,
            episode.vehicle,
            episode.steering_limit,
            *snapshot.state.tolist(),
            *look[: lk.PROGRESS],
            snapshot.steering,
            snapshot.throttle,
            snapshot.steer_torque,
            look[lk.PROGRESS],
            episode.course_length,
            episode.course_closed,
            *[look[place] for place in _LOOKED[1:]],
            preview.by_time,
            preview.interval,
            look[lk.PREVIEW_SPACING],
            snapshot.preview_x,
            snapshot.preview_y,
            snapshot.roll_history,
            snapshot.steer_history,
            snapshot.fallen,
            snapshot.off_course,
            snapshot.finished,
            snapshot.fall,
            snapshot.signals,
            _EMPTY if view is None else view.place,
            *(_NO_LIMITS if view is None else _limits_of(view)),
            _EMPTY if view is None else view.points.ravel(),
            _EMPTY if view is None or view.wall is None else (view.wall.speed, view.wall.angle, view.wall.energy),
            [_event(event, snapshot, sec, nanosec) for event in snapshot.events],
        )
    )


def _limits_of(view: CircuitView) -> tuple[Any, ...]:
    """Return the limits of a view as a state has them; `look.CIRCUIT_FIELDS` begin with the four margins."""
    outside, off_track_time, wall_energy, wrong_way = view.limits[lk.OUTSIDE :].tolist()
    return outside, view.limits[: lk.OUTSIDE], off_track_time, wall_energy, wrong_way != 0.0


def _event(event: Event, snapshot: Snapshot, sec: int, nanosec: int) -> dict[str, Any]:
    return {
        "header.stamp.sec": sec,
        "header.stamp.nanosec": nanosec,
        "header.frame_id": MAP_FRAME,
        "episode": snapshot.episode,
        "step": snapshot.step,
        "kind": int(event.kind),
        "time": float(event.time),
        "progress": float(event.progress),
        "value": float(event.value),
        "text": event.text,
    }


def decode_state(data: bytes) -> StateMessage:
    """Return snapshot and episode of a state, bit for bit.

    Raises:
        ValueError: the bytes are no state.
    """
    row = _STATE.unpack(data)
    sec, nanosec, _, number, step, period, vehicle, limit = row[:_HEAD]
    at = _HEAD + st.STATE_SIZE
    pitch, yaw_rate, speed, front_x, front_y, steering, throttle, torque, progress, length, closed = row[at : at + 11]
    error, front_progress, front_error, heading, curvature, by_time, interval, spacing = row[at + 11 : at + 19]
    preview_x, preview_y, rolls, steers, fallen, off_course, finished = row[at + 19 : at + 26]
    fall, signals, place, outside, margins, off_track_time, wall_energy, wrong_way, points, wall, events = row[
        at + 26 :
    ]
    view = None
    if len(place):
        hit = WallHit(*wall.tolist()) if len(wall) else None
        limits = np.array((*margins, outside, off_track_time, wall_energy, float(wrong_way)))
        view = CircuitView(place, limits, points.reshape(3, -1, 3), hit)
    snapshot = Snapshot(
        episode=number,
        step=step,
        time=step * period,
        state=np.array(row[_HEAD:at]),
        look=np.array(
            (
                *(pitch, yaw_rate, speed, front_x, front_y, progress, error, heading, curvature),
                *(front_progress, front_error, spacing),
            )
        ),
        steering=steering,
        throttle=throttle,
        steer_torque=torque,
        preview_x=preview_x,
        preview_y=preview_y,
        roll_history=tuple(rolls.tolist()),
        steer_history=tuple(steers.tolist()),
        fallen=fallen,
        off_course=off_course,
        finished=finished,
        fall=fall,
        signals=signals,
        circuit=view,
        events=tuple(
            Event(EventKind(event["kind"]), event["time"], event["progress"], event["value"], event["text"])
            for event in events
        ),
    )
    facts = Episode(vehicle, limit, period, length, closed, Preview(by_time, interval, len(preview_x)))
    return StateMessage(snapshot, sec * NANOSECONDS + nanosec, facts)


def encode_command(command: Command, state_stamp: int = 0) -> bytes:
    """Return the bytes of ``bike_msgs/BikeCommand``.

    Args:
        command: the command.
        state_stamp: stamp of the state that it answers, ns.
    """
    sec, nanosec = divmod(state_stamp, NANOSECONDS)
    return _COMMAND.encode(
        (sec, nanosec, "", command.episode, command.step, float(command.steering), float(command.throttle))
    )


def decode_command(data: bytes) -> Command:
    """Return the command of a message.

    Raises:
        ValueError: the bytes are no command.
    """
    return Command(*_COMMAND.unpack(data)[3:])
