"""What tyres and rider aids of a superbike did, from the recorded telemetry (``bike_msgs/Telemetry``)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from bike_analysis.figures.numbers import over, rms_of
from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import TELEMETRY_COLUMNS, Floats


@dataclass(frozen=True)
class TyreFigures:
    """Slip, loads and aids over a ride. Largest values are on either side.

    Attributes:
        rear_slip_angle_rms_deg: Root mean square of the slip angle.
        rear_slip_angle_max_deg: Largest slip angle.
        rear_slip_max: Largest longitudinal slip, driving or braking.
        rear_slip_use_max: Largest use of the friction; the force is largest at about 2.6.
        front_slip_angle_rms_deg: As for the rear tyre.
        front_slip_angle_max_deg: As for the rear tyre.
        front_slip_max: As for the rear tyre.
        front_slip_use_max: As for the rear tyre.
        rear_load_min_n: Least vertical load.
        front_load_min_n: Least vertical load.
        engine_power_max_w: Largest power at the crank.
        traction_control_s: Time during which traction control allowed less than requested.
        anti_wheelie_s: The same for the anti-wheelie.
        brake_control_s: The same for the brake control.
        anti_stoppie_s: The same for the anti-stoppie.
        rear_contact_lost_s: Time with the rear wheel in the air.
        front_contact_lost_s: Time with the front wheel in the air.
    """

    rear_slip_angle_rms_deg: float | None
    rear_slip_angle_max_deg: float | None
    rear_slip_max: float | None
    rear_slip_use_max: float | None
    front_slip_angle_rms_deg: float | None
    front_slip_angle_max_deg: float | None
    front_slip_max: float | None
    front_slip_use_max: float | None
    rear_load_min_n: float | None
    front_load_min_n: float | None
    engine_power_max_w: float | None
    traction_control_s: float | None
    anti_wheelie_s: float | None
    brake_control_s: float | None
    anti_stoppie_s: float | None
    rear_contact_lost_s: float | None
    front_contact_lost_s: float | None


def tyre_figures(ride: Ride) -> TyreFigures | None:
    """Compute the figures of the tyres.

    Args:
        ride: A ride.

    Returns:
        Its figures, or None where no telemetry of it was recorded.
    """
    told = ride.telemetry
    if told is None or not len(told.step):
        return None
    nothing = np.empty(0)
    period = float(ride.states.control_period[0])
    figures: dict[str, float | None] = {}
    for wheel in ("rear", "front"):
        angle = np.degrees(told.values.get(f"{wheel}_slip_angle", nothing))
        figures[f"{wheel}_slip_angle_rms_deg"] = over(rms_of, angle)
        figures[f"{wheel}_slip_angle_max_deg"] = over(np.max, np.abs(angle))
        figures[f"{wheel}_slip_max"] = over(np.max, np.abs(told.values.get(f"{wheel}_slip", nothing)))
        figures[f"{wheel}_slip_use_max"] = over(np.max, told.values.get(f"{wheel}_slip_use", nothing))
        figures[f"{wheel}_load_min_n"] = over(np.min, told.values.get(f"{wheel}_load", nothing))
    for name in ("traction_control", "anti_wheelie", "brake_control", "anti_stoppie", *_LOST):
        steps = over(np.sum, told.values.get(name, nothing))
        figures[f"{name}_s"] = None if steps is None or not np.isfinite(period) else steps * period
    return TyreFigures(engine_power_max_w=over(np.max, told.values.get("engine_power", nothing)), **figures)


PEAK_USE: Final = 1.5 * math.tan(math.pi / 3.0)
"""Normalised slip at which the force is largest, for the shape of 1.5 that all shipped tyres have
(`bike_sim.physics.tyres.peak_slip`)."""
AIDS: Final = {
    "traction_control": "traction control",
    "anti_wheelie": "anti-wheelie",
    "brake_control": "brake control",
    "anti_stoppie": "anti-stoppie",
}
"""Rider aids, by column of the telemetry."""


def grip_used(use: Floats) -> Floats:
    """Share of the grip that a tyre uses, %.

    Args:
        use: Normalised slip s (``rear_slip_use``, ``front_slip_use``).

    Returns:
        Up to the peak, its force by the largest one, ``100 sin(1.5 atan(s / 1.5))``; beyond, where the force falls
        again and the tyre slides, its slip by that of the peak, so that more slip is always more.
    """
    return np.where(use <= PEAK_USE, 100.0 * np.sin(1.5 * np.arctan(use / 1.5)), 100.0 * use / PEAK_USE)


_LOST = ("rear_contact_lost", "front_contact_lost")


def telemetry_columns(ride: Ride, rows: slice) -> dict[str, Floats]:
    """Telemetry of some of a ride's states, by name of the table's column; NaN where a state has none."""
    told = ride.telemetry
    if told is None or not len(told.step):
        return {}
    steps = ride.states.step[rows]
    order = np.argsort(told.step, kind="stable")
    place = np.minimum(np.searchsorted(told.step[order], steps), len(order) - 1)
    match = order[place]
    known = told.step[match] == steps
    return {TELEMETRY_COLUMNS[n]: np.where(known, c[match], np.nan) for n, c in told.values.items()}
