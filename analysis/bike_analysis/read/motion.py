"""Motion out of standard messages, for recordings of other bicycles: pose, velocity, inertial and satellite data.

Such a recording has no course, steering or steps. Its data is converted to the columns of our
states, and all else stays unknown (NaN). Signs are those of REP-103 (x forward, y left, z up), in which a roll about x
leans right where it is positive, as in ``bike_msgs``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ODOMETRY: Final = "nav_msgs/msg/Odometry"
SATELLITE: Final = "sensor_msgs/msg/NavSatFix"
INERTIAL: Final = "sensor_msgs/msg/Imu"

_POSE: Final = "pose.pose."
_TWIST: Final = "twist.twist."
MOTION_FIELDS: Final[dict[str, tuple[str, ...]]] = {
    ODOMETRY: (
        *(f"{_POSE}position.{axis}" for axis in "xy"),
        *(f"{_POSE}orientation.{axis}" for axis in "xyzw"),
        f"{_TWIST}linear.x",
        f"{_TWIST}linear.y",
        f"{_TWIST}angular.x",
        f"{_TWIST}angular.z",
    ),
    SATELLITE: ("latitude", "longitude", "status.status"),
    INERTIAL: (*(f"orientation.{axis}" for axis in "xyzw"), "angular_velocity.x", "angular_velocity.z"),
}
"""Fields that are read, by type."""
MOTION_TYPES: Final = tuple(MOTION_FIELDS)
"""Message types with motion, the most informative first."""

NEW_RIDE_AFTER: Final = 10.0
"""Silence after which another ride begins, s."""
EARTH_RADIUS: Final = 6_371_008.8
"""Mean radius of the Earth, m (IUGG)."""


@dataclass(frozen=True)
class Motion:
    """One recorded topic of motion.

    Attributes:
        topic: Its name.
        type_name: One of `MOTION_TYPES`.
        order: Place of each message in the recording.
        time_s: Time of each message, s.
        columns: Values by field; absent ones are missing.
    """

    topic: str
    type_name: str
    order: NDArray[np.int64]
    time_s: Floats
    columns: dict[str, NDArray[Any]]

    def column(self, name: str) -> Floats:
        """A field; NaN where it was not recorded."""
        found = self.columns.get(name)
        return np.full(len(self.time_s), np.nan) if found is None else np.asarray(found, dtype=np.float64)

    def sorted(self) -> Motion:
        """The same in the order of time, each time once."""
        _, rows = np.unique(self.time_s, return_index=True)
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Motion(self.topic, self.type_name, self.order[rows], self.time_s[rows], columns)


def states_of_motion(motions: Sequence[Motion]) -> tuple[dict[str, NDArray[Any]], str]:
    """Compute the columns of states.

    Args:
        motions: Recorded topics. Of each type the one with the most messages counts; odometry gives the rows, or else
            satellite fixes, or else inertial data; the others are interpolated in time.

    Returns:
        Columns by field of `bike_analysis.read.tables.States`, with ``order`` and ``time_s``; and a sentence that says
        what they were computed from.
    """
    chosen = {}
    for kind in MOTION_TYPES:
        usable = [motion.sorted() for motion in motions if motion.type_name == kind and len(motion.time_s)]
        if usable:
            chosen[kind] = max(usable, key=lambda motion: len(motion.time_s))
    if not chosen:
        return {"time_s": np.empty(0), "order": np.empty(0)}, "no message of its topics can be decoded"
    base = next(iter(chosen.values()))
    states: dict[str, NDArray[Any]] = {"order": base.order, "time_s": base.time_s}
    for kind, motion in chosen.items():
        for name, values in _WORKED_OUT[kind](motion).items():
            there = np.isfinite(values)
            if name not in states and there.sum() > 1:
                outside = {"left": np.nan, "right": np.nan}
                states[name] = np.interp(base.time_s, motion.time_s[there], values[there], **outside)
    _complete(states)
    used = " and ".join(f"{motion.topic} ({kind})" for kind, motion in chosen.items())
    return (
        states,
        f"no states of ours were recorded: the motion is that of {used}, without course, steering and command",
    )


def _odometry(motion: Motion) -> dict[str, Floats]:
    roll, pitch, yaw = _angles(*(motion.column(f"{_POSE}orientation.{axis}") for axis in "xyzw"))
    return {
        "x": motion.column(f"{_POSE}position.x"),
        "y": motion.column(f"{_POSE}position.y"),
        "yaw": yaw,
        "roll": roll,
        "pitch": pitch,
        "speed": np.hypot(motion.column(f"{_TWIST}linear.x"), motion.column(f"{_TWIST}linear.y")),
        "roll_rate": motion.column(f"{_TWIST}angular.x"),
        "yaw_rate": motion.column(f"{_TWIST}angular.z"),
    }


def _satellite(motion: Motion) -> dict[str, Floats]:
    """East and north of the first fix, on a plane that touches the Earth there; NaN without a fix (status below 0)."""
    fixed = np.where(motion.column("status.status") < 0.0, np.nan, 1.0)
    latitude, longitude = (fixed * np.radians(motion.column(name)) for name in ("latitude", "longitude"))
    known = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not len(known):
        return {}
    first = known[0]
    east = EARTH_RADIUS * np.cos(latitude[first]) * (longitude - longitude[first])
    return {"x": east, "y": EARTH_RADIUS * (latitude - latitude[first])}


def _inertial(motion: Motion) -> dict[str, Floats]:
    roll, pitch, yaw = _angles(*(motion.column(f"orientation.{axis}") for axis in "xyzw"))
    rates = {"roll_rate": motion.column("angular_velocity.x"), "yaw_rate": motion.column("angular_velocity.z")}
    return {"yaw": yaw, "roll": roll, "pitch": pitch, **rates}


_WORKED_OUT: Final = {ODOMETRY: _odometry, SATELLITE: _satellite, INERTIAL: _inertial}


def _angles(x: Floats, y: Floats, z: Floats, w: Floats) -> tuple[Floats, Floats, Floats]:
    """Roll, pitch and yaw (not wrapped) of unit quaternions, rad; NaN for an invalid quaternion.

    Rotations about z, then y, then x, as REP-103 has them.
    """
    norm = np.sqrt(x * x + y * y + z * z + w * w)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y, z, w = (np.where(norm > 0.5, part / norm, np.nan) for part in (x, y, z, w))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, _unwrapped(yaw)


def _unwrapped(angle: Floats) -> Floats:
    """An unwrapped angle, rad; NaN is kept."""
    known = np.isfinite(angle)
    angle[known] = np.unwrap(angle[known])
    return angle


def _complete(states: dict[str, NDArray[Any]]) -> None:
    """Add derived columns: speed and heading from positions, rides and period from times."""
    time = states["time_s"]
    if len(time) > 1 and "x" in states and "y" in states:
        across, along = np.gradient(states["x"], time), np.gradient(states["y"], time)
        if not np.nan_to_num(states.get("speed", np.zeros(1))).any():
            states["speed"] = np.hypot(across, along)
        if "yaw" not in states:
            states["yaw"] = _unwrapped(np.arctan2(along, across))
    steps = np.diff(time)
    silences = steps > NEW_RIDE_AFTER
    states["episode"] = np.concatenate([[1], 1 + np.cumsum(silences)])
    begins = np.flatnonzero(np.append(True, silences))
    states["step"] = np.arange(len(time)) - begins[states["episode"] - 1]  # each ride begins with its step 0
    usual = float(np.median(steps)) if len(steps) else np.nan
    states["control_period"] = np.full(len(time), usual)
