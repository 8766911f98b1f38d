"""A ride as a log of MoTeC i2: an ``.ld`` file of channels, and an ``.ldx`` file beside it whose beacons mark the laps.

MoTeC publishes no description. The layout is that which open readers found (gotzl/ldparser, gopher-vision): a header, a
chain of blocks (event, venue, vehicle), a linked list of channels, and their samples at constant rates.
"""

from __future__ import annotations

import struct
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from bike_analysis.figures.rides import Ride
from bike_analysis.read.messages import Floats
from bike_sim.schema import GRAVITY

_HEADER: Final = struct.Struct("<I4xII20xI24xHHHI8sHHI4x16s16x16s16x64s64s64x64s64x1024xI66x64s126x64s64s")
_EVENT: Final = struct.Struct("<64s64s1024sI")
_VENUE: Final = struct.Struct("<64s1034xI")
_VEHICLE: Final = struct.Struct("<64s128xI32s32s")
_CHANNEL: Final = struct.Struct("<IIIIHHHHhhhh32s8s12s40x")
_FLOAT: Final = (7, 4)
"""Type of samples: floating point, and its bytes."""
MOST_SAMPLES: Final = 20_000_000
"""Samples of a channel that are written at most."""


class _Channel(NamedTuple):
    """A channel: MoTeC's name, its short form, unit, column of the ride's table and what turns it into the unit."""

    name: str
    short: str
    unit: str
    column: str
    convert: Callable[[Floats], Floats] = lambda values: values


CHANNELS: Final = (
    _Channel("Ground Speed", "Speed", "km/h", "speed_m_s", lambda v: 3.6 * v),
    _Channel("Throttle Pos", "Throttle", "%", "throttle_command", lambda v: 100.0 * np.maximum(v, 0.0)),
    _Channel("Brake Pos", "Brake", "%", "throttle_command", lambda v: 100.0 * np.maximum(-v, 0.0)),
    _Channel("Steered Angle", "Steer", "deg", "steer_rad", np.degrees),
    _Channel("Steering Torque", "SteerTrq", "Nm", "steer_torque_nm"),
    _Channel("Lean Angle", "Lean", "deg", "roll_rad", np.degrees),
    _Channel("Gyro Roll Velocity", "GyroRoll", "deg/s", "roll_rate_rad_s", np.degrees),
    _Channel("Gyro Yaw Velocity", "GyroYaw", "deg/s", "yaw_rate_rad_s", np.degrees),
    _Channel("G Force Long", "G Long", "G", "acceleration_m_s2", lambda v: v / GRAVITY),
    _Channel("G Force Lat", "G Lat", "G", "lateral_acceleration_m_s2", lambda v: v / GRAVITY),
    _Channel("Corrected Distance", "Dist", "m", "distance_m"),
    _Channel("Lap Distance", "LapDist", "m", "station_m"),
    _Channel("Pos X", "X", "m", "x_m"),
    _Channel("Pos Y", "Y", "m", "y_m"),
    _Channel("Line Error", "LineErr", "m", "lateral_error_m"),
    _Channel("Engine Power", "Power", "kW", "engine_power_w", lambda v: 1e-3 * v),
    _Channel("Tyre Load F", "LoadF", "N", "front_load_n"),
    _Channel("Tyre Load R", "LoadR", "N", "rear_load_n"),
    _Channel("Tyre Slip F", "SlipF", "%", "front_slip", lambda v: 100.0 * v),
    _Channel("Tyre Slip R", "SlipR", "%", "rear_slip", lambda v: 100.0 * v),
    _Channel("Tyre Slip Angle F", "SlipAngF", "deg", "front_slip_angle_rad", np.degrees),
    _Channel("Tyre Slip Angle R", "SlipAngR", "deg", "rear_slip_angle_rad", np.degrees),
    _Channel("Susp Pos F", "SuspF", "mm", "fork_travel_m", lambda v: 1e3 * v),
    _Channel("Susp Pos R", "SuspR", "mm", "shock_travel_m", lambda v: 1e3 * v),
)
"""Channels that are written where a ride has them. Signs are this project's: left positive, lean to the right."""
BEACON: Final = "Beacon"
"""Channel that is 1 in the sample after the start line."""
LAP: Final = "Lap Number"
"""Channel that counts the laps from 1, each beacon begins another."""


def write_ld(ride: Ride, path: Path) -> Path:
    """Write a ride, and its laps into the ``.ldx`` file beside it.

    Args:
        ride: of a recording.
        path: the ``.ld`` file; its folder is created.

    Returns:
        The ``.ld`` file.

    Raises:
        ValueError: a name that does not end in ``.ld``, or a ride too short or too long for a log.
        OSError: a file cannot be written.
    """
    if path.suffix.lower() != ".ld":
        raise ValueError(f"{path}: MoTeC i2 opens logs whose names end in .ld")
    table = ride.table()
    times = table["time_s"].to_numpy()
    steps = np.diff(times)
    if len(times) < 2 or not steps.max() > 0.0:
        raise ValueError(f"{ride.label}: a log needs at least two states at different times")
    rate = max(1, round(1.0 / float(np.median(steps[steps > 0.0]))))
    grid = np.arange(int(times[-1] * rate) + 1) / rate
    if rate > 0xFFFF or len(grid) > MOST_SAMPLES:
        raise ValueError(f"{ride.label}: {len(grid)} samples at {rate} Hz are more than a log of {MOST_SAMPLES} takes")
    beacons = _beacons(ride)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(_log(ride, rate, _samples(table, times, grid, beacons)))
    path.with_suffix(".ldx").write_text(_laps(ride, beacons), encoding="utf-8")
    return path


def _beacons(ride: Ride) -> list[float]:
    """Return the times at which the start line was ridden over, s since the ride's first state."""
    ends = {round(at, 6) for lap in ride.laps for at in (lap.begin_s, lap.begin_s + lap.duration_s)}
    return sorted(at for at in ends if at > 0.0)


def _samples(table: pd.DataFrame, times: Floats, grid: Floats, beacons: list[float]) -> list[tuple[_Channel, Floats]]:
    """Return the channels that a ride has, at constant steps."""
    found = []
    for channel in CHANNELS:
        if channel.column not in table:
            continue
        values = table[channel.column].to_numpy(dtype=np.float64, na_value=np.nan)
        known = np.isfinite(values)
        if not known.any():
            continue
        samples = np.interp(grid, times[known], values[known])
        found.append((channel, channel.convert(samples)))
    marks = np.zeros(len(grid))
    marks[np.minimum(np.searchsorted(grid, beacons), len(grid) - 1)] = 1.0
    return [*found, (_Channel(BEACON, BEACON, "", ""), marks), (_Channel(LAP, "Lap", "", ""), 1.0 + np.cumsum(marks))]


def _log(ride: Ride, rate: int, channels: list[tuple[_Channel, Floats]]) -> bytes:
    recording = ride.recording
    event = _HEADER.size
    venue = event + _EVENT.size
    vehicle = venue + _VENUE.size
    first = vehicle + _VEHICLE.size
    data = first + len(channels) * _CHANNEL.size
    when = time.localtime(recording.path.stat().st_mtime)
    course = ride.course.name if ride.course else ""
    names = [_text(name, 64) for name in (recording.policy, recording.vehicle, course)]
    header = _HEADER.pack(
        0x40, first, data, event, 1, 0x4240, 0xF, 0x1F44, b"ADL", 420, 0xADB0, len(channels),
        time.strftime("%d/%m/%Y", when).encode(), time.strftime("%H:%M:%S", when).encode(), *names,
        0xC81A4, *[_text(ride.label, 64)] * 2, b"",
    )  # fmt: skip
    blocks = [header, _EVENT.pack(_text(ride.label, 64), b"", b"", venue), _VENUE.pack(names[2], vehicle)]
    blocks.append(_VEHICLE.pack(names[1], 0, b"Motorcycle", b""))
    samples = [values.astype("<f4").tobytes() for _, values in channels]
    for place, ((channel, values), written) in enumerate(zip(channels, samples, strict=True)):
        at = first + place * _CHANNEL.size
        before = at - _CHANNEL.size if place else 0
        behind = at + _CHANNEL.size if place + 1 < len(channels) else 0
        texts = (_text(channel.name, 32), _text(channel.short, 8), _text(channel.unit, 12))
        blocks.append(
            _CHANNEL.pack(before, behind, data, len(values), 0x2EE1 + place, *_FLOAT, rate, 0, 1, 1, 0, *texts)
        )
        data += len(written)
    return b"".join([*blocks, *samples])


def _text(text: str, size: int) -> bytes:
    """Return a text as a log holds it: ASCII, ended by a zero."""
    return text.encode("ascii", errors="replace")[: size - 1]


def _laps(ride: Ride, beacons: list[float]) -> str:
    """Return the ``.ldx`` file: a marker where each lap ends or begins, and the fastest lap."""
    root = ET.Element("LDXFile", Locale="English_United Kingdom.1252", DefaultLocale="C", Version="1.6")
    layers = ET.SubElement(root, "Layers")
    layer = ET.SubElement(layers, "Layer")
    group = ET.SubElement(ET.SubElement(layer, "MarkerBlock"), "MarkerGroup", Name="Beacons", Index="3")
    for number, at in enumerate(beacons, start=1):
        microseconds = f"{1e6 * at:.17e}"
        ET.SubElement(
            group, "Marker", Version="100", ClassName="BCN", Name=f"Manual.{number}", Flags="77", Time=microseconds
        )
    ET.SubElement(layer, "RangeBlock")
    details = ET.SubElement(layers, "Details")
    values = {"Total Laps": str(len(beacons) + 1)}
    best = ride.best_lap
    if best is not None:
        minutes, seconds = divmod(best.duration_s, 60.0)
        values["Fastest Time"] = f"{minutes:.0f}:{seconds:06.3f}"
        values["Fastest Lap"] = str(
            1 + int(np.searchsorted(beacons, best.begin_s + 1e-3))
        )  # 1 ends at the first beacon
    for name, value in values.items():
        ET.SubElement(details, "String", Id=name, Value=value)
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'
