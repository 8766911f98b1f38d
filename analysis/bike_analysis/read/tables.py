"""Columns of recorded messages: states, commands and telemetry, one row per message, with the fields' names and units.

``bike_msgs`` defines the messages. A recording may lack fields, which are then NaN.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.motion import MOTION_FIELDS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
TableT = TypeVar("TableT", bound="Table")

STATE_TYPE: Final = "bike_msgs/msg/BikeState"
COMMAND_TYPE: Final = "bike_msgs/msg/BikeCommand"
TELEMETRY_TYPE: Final = "bike_msgs/msg/Telemetry"

LARGEST: Final = 1e9
"""No place, angle, rate or torque of a ride is larger, in SI units; damaged numbers mostly are."""


@dataclass(frozen=True)
class Table:
    """Columns of equal length, one row per message, in the order of recording.

    Attributes:
        order: Place of each message in the recording, counted over all topics.
        time_s: Simulated time from the message's stamp, s.
        episode: Number of the episode.
        step: Control steps since the episode's reset.
    """

    order: Integers
    time_s: Floats
    episode: Integers
    step: Integers

    def __len__(self) -> int:
        return len(self.order)

    def take(self, rows: NDArray[Any] | slice) -> Self:
        """Select rows.

        Args:
            rows: Mask, indices or slice.

        Returns:
            A table of the same kind with these rows.
        """
        return type(self)(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(frozen=True)
class States(Table):
    """States of the vehicle (``bike_msgs/BikeState``), without preview and history.

    Signs: x forward, y left, z up; roll positive leaning right; yaw and steer positive to the left.

    Attributes:
        control_period: Time between two steps, s.
        steering_limit: Set point of the steering angle for a steering command of 1, rad. Of a superbike,
            whose command requests a lean, the steering stop.
        x: Rear contact point in map, m.
        y: Rear contact point in map, m.
        yaw: rad, not wrapped.
        roll: rad, positive leaning right.
        steer: rad, positive to the left.
        rear_wheel_angle: rad, not wrapped, positive rolling forward.
        front_wheel_angle: The same for the front wheel, rad.
        roll_rate: rad/s.
        steer_rate: rad/s.
        front_wheel_rate: rad/s.
        pitch: Of the rear frame, rad, positive nose down.
        yaw_rate: rad/s, positive to the left.
        speed: Forward speed of the rear contact point, m/s.
        front_x: Front contact point in map, m.
        front_y: Front contact point in map, m.
        steering_command: Command applied during the step that led here, in [-1, 1].
        throttle_command: The same for throttle and brake.
        steer_torque: Torque of the steering drive, Nm.
        progress: Arc length of the nearest point of the course, m.
        course_length: Length of the course, m.
        course_closed: Whether the course ends where it begins.
        lateral_error: Signed distance of the rear contact to the course, m, positive left of it.
        front_progress: Arc length of the point of the course nearest to the front contact, m.
        front_lateral_error: Signed distance of the front contact to the course, m.
        heading_error: rad, positive left.
        curvature: Of the course at progress, 1/m, positive turning left.
        fallen: Whether the vehicle has fallen.
        off_course: Whether it left the course.
        finished: Whether it reached the end of the course.
    """

    control_period: Floats
    steering_limit: Floats
    x: Floats
    y: Floats
    yaw: Floats
    roll: Floats
    steer: Floats
    rear_wheel_angle: Floats
    front_wheel_angle: Floats
    roll_rate: Floats
    steer_rate: Floats
    front_wheel_rate: Floats
    pitch: Floats
    yaw_rate: Floats
    speed: Floats
    front_x: Floats
    front_y: Floats
    steering_command: Floats
    throttle_command: Floats
    steer_torque: Floats
    progress: Floats
    course_length: Floats
    course_closed: Flags
    lateral_error: Floats
    front_progress: Floats
    front_lateral_error: Floats
    heading_error: Floats
    curvature: Floats
    fallen: Flags
    off_course: Flags
    finished: Flags


@dataclass(frozen=True)
class Commands(Table):
    """Commands (``bike_msgs/BikeCommand``). Stamp, episode and step are those of the state that a command answers.

    Attributes:
        steering: In [-1, 1], positive to the left.
        throttle: In [-1, 1], positive accelerates.
    """

    steering: Floats
    throttle: Floats


@dataclass(frozen=True)
class Telemetry:
    """What tyres, engine, brakes and rider aids of a superbike did (``bike_msgs/Telemetry``), one row per message.

    Attributes:
        order: Place of each message in the recording.
        time_s: Simulated time, s.
        episode: Episode of the state that it belongs to.
        step: Step of that state.
        values: Numbers and flags by name of the message's field, in its units.
    """

    order: Integers
    time_s: Floats
    episode: Integers
    step: Integers
    values: dict[str, Floats]

    def take(self, rows: NDArray[Any] | slice) -> Telemetry:
        """Select rows by mask, indices or slice."""
        values = {name: column[rows] for name, column in self.values.items()}
        return Telemetry(self.order[rows], self.time_s[rows], self.episode[rows], self.step[rows], values)


TELEMETRY_COLUMNS: Final = {
    "acceleration_longitudinal": "tyre_acceleration_longitudinal_m_s2",
    "acceleration_lateral": "tyre_acceleration_lateral_m_s2",
    **{
        f"{wheel}_{name}": f"{wheel}_{name}{unit}"
        for wheel in ("rear", "front")
        for name, unit in (
            ("slip_angle", "_rad"),
            ("slip", ""),
            ("camber", "_rad"),
            ("load", "_n"),
            ("force_longitudinal", "_n"),
            ("force_lateral", "_n"),
            ("slip_use", ""),
            ("brake_force", "_n"),
            ("contact_lost", ""),
        )
    },
    "engine_power": "engine_power_w",
    "engine_force": "engine_force_n",
    "drag_force": "drag_force_n",
    "rider_offset": "rider_offset_m",
    "lean_reference": "lean_reference_rad",
    "traction_control": "traction_control",
    "anti_wheelie": "anti_wheelie",
    "brake_control": "brake_control",
    "anti_stoppie": "anti_stoppie",
}
"""Fields of ``bike_msgs/Telemetry`` that are read, with the names of their columns in tables."""

TABLE_OF_TYPE: Final[dict[str, type[Table]]] = {STATE_TYPE: States, COMMAND_TYPE: Commands}
"""Kind of the table that messages of a type become."""
COLUMNS: Final[dict[str, tuple[str, ...]]] = {
    **{
        name: tuple(f.name for f in fields(kind) if f.name not in ("order", "time_s"))
        for name, kind in TABLE_OF_TYPE.items()
    },
    TELEMETRY_TYPE: ("episode", "step", *TELEMETRY_COLUMNS),
    **MOTION_FIELDS,
}
"""Fields that are read as columns, by type of the message."""


def make_table(
    kind: type[TableT], order: Integers, time_s: Floats, columns: dict[str, NDArray[Any]], count: int
) -> TableT:
    """A table of columns; absent ones are filled, and impossible numbers become NaN."""
    values: dict[str, NDArray[Any]] = {"order": order, "time_s": time_s}
    for f in fields(kind):
        if f.name in values:
            continue
        dtype, absent = _column_kind(str(f.type))
        column = columns.pop(f.name, None)
        if column is not None:
            values[f.name] = column.astype(dtype, copy=False)
            if dtype is np.float64:
                values[f.name][~(np.abs(values[f.name]) <= LARGEST)] = np.nan
        elif f.name == "step":
            values[f.name] = np.arange(count, dtype=np.int64)
        else:
            values[f.name] = np.full(count, 1 if f.name == "episode" else absent, dtype)
    return kind(**values)


def empty_table(kind: type[TableT]) -> TableT:
    """A table without rows."""
    nothing = np.empty(0, np.int64)
    return make_table(kind, nothing, np.empty(0), {}, 0)


def _column_kind(annotation: str) -> tuple[type, float | bool | int]:
    """Element type of a column and the value that stands for an absent one."""
    return {"Floats": (np.float64, np.nan), "Integers": (np.int64, 0), "Flags": (np.bool_, False)}[annotation]
