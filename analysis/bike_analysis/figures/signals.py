"""Commands and telemetry of a ride: ages of the applied commands, tyres and rider aids of superbikes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from bike_analysis.figures.numbers import over, rms_of
from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import Floats, Integers
from bike_sim.schema import TELEMETRY


@dataclass(frozen=True)
class CommandDelay:
    """Age of the command that was applied in each step.

    Attributes:
        rows: Rows of the ride's states (those after a step) for which it is known.
        steps: Age in control steps: 0 if the command answers the very state from which the step began.
        time_s: The same in simulated time, s.
    """

    rows: Integers
    steps: Integers
    time_s: Floats


def command_delay(ride: Ride) -> CommandDelay:
    """Return the age of the applied commands.

    A state contains the command that was applied in the step that led to it. That command is looked up among the
    recorded ones: the newest one with this value that answers a state from before the step. Its age is the number of
    steps (and the simulated time) between the state that it answers and the state from which the step began. In
    lockstep it is 0; in free running it shows how late the commands were, a held command ageing with each step.

    Args:
        ride: A ride.

    Returns:
        The delay of each step for which the command was found; empty if commands were not recorded.
    """
    states, commands = ride.states, ride.commands
    steering = np.clip(commands.steering, -1.0, 1.0)
    values, value = np.unique(steering[np.isfinite(steering)], return_inverse=True)
    if not len(values) or len(states) < 2:
        return CommandDelay(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))
    finite = np.flatnonzero(np.isfinite(steering))
    span = int(max(states.step[-1], commands.step.max())) + 2
    # One number for value and step: the newest command of a value is found by one search.
    key = value * span + commands.step[finite]
    order = np.argsort(key, kind="stable")
    applied, begin = states.steering_command[1:], states.step[1:] - 1
    place = np.minimum(np.searchsorted(values, applied), len(values) - 1)
    found = np.searchsorted(key[order], place * span + begin, side="right") - 1
    match = finite[order[np.maximum(found, 0)]]
    known = (found >= 0) & (values[place] == applied) & (steering[match] == applied) & (begin >= 0)
    rows, match, begin = np.flatnonzero(known) + 1, match[known], begin[known]
    begin_time = np.where(states.step[rows - 1] == begin, states.time_s[rows - 1], np.nan)
    return CommandDelay(rows, begin - commands.step[match], begin_time - _answered_time(ride)[match])


def _answered_time(ride: Ride) -> Floats:
    """Time of the state that each command answers, s: the command's own stamp only where that state is not there."""
    states, commands = ride.states, ride.commands
    row = np.minimum(np.searchsorted(states.step, commands.step), len(states) - 1)
    return np.where(states.step[row] == commands.step, states.time_s[row], commands.time_s)


def command_ages(ride: Ride) -> tuple[Floats, Floats]:
    """Age of the command applied in the step that led to each state, in steps and in s; NaN where it is not known."""
    delay = command_delay(ride)
    steps, seconds = np.full(len(ride.states), np.nan), np.full(len(ride.states), np.nan)
    steps[delay.rows], seconds[delay.rows] = delay.steps, delay.time_s
    return steps, seconds


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
    telemetry = ride.telemetry
    if telemetry is None or not len(telemetry.step):
        return None
    nothing = np.empty(0)
    period = float(ride.states.control_period[0])
    figures: dict[str, float | None] = {}
    for wheel in ("rear", "front"):
        angle = np.degrees(telemetry.values.get(f"{wheel}_slip_angle", nothing))
        figures[f"{wheel}_slip_angle_rms_deg"] = over(rms_of, angle)
        figures[f"{wheel}_slip_angle_max_deg"] = over(np.max, np.abs(angle))
        figures[f"{wheel}_slip_max"] = over(np.max, np.abs(telemetry.values.get(f"{wheel}_slip", nothing)))
        figures[f"{wheel}_slip_use_max"] = over(np.max, telemetry.values.get(f"{wheel}_slip_use", nothing))
        figures[f"{wheel}_load_min_n"] = over(np.min, telemetry.values.get(f"{wheel}_load", nothing))
    for name in ("traction_control", "anti_wheelie", "brake_control", "anti_stoppie", *_LOST):
        steps = over(np.sum, telemetry.values.get(name, nothing))
        figures[f"{name}_s"] = None if steps is None or not np.isfinite(period) else steps * period
    return TyreFigures(engine_power_max_w=over(np.max, telemetry.values.get("engine_power", nothing)), **figures)


PEAK_USE: Final = 1.5 * math.tan(math.pi / 3.0)
"""Normalised slip at which the force is largest, for the shape of 1.5 that all shipped tyres have
(`bike_sim.physics.superbike.tyres.peak_slip`)."""
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
    telemetry = ride.telemetry
    if telemetry is None or not len(telemetry.step):
        return {}
    steps = ride.states.step[rows]
    order = np.argsort(telemetry.step, kind="stable")
    place = np.minimum(np.searchsorted(telemetry.step[order], steps), len(order) - 1)
    match = order[place]
    known = telemetry.step[match] == steps
    return {_column(n): np.where(known, c[match], np.nan) for n, c in telemetry.values.items()}


def _column(name: str) -> str:
    """Column of tables; states have accelerations, too, which are worked out from the motion."""
    column = TELEMETRY[name].column
    return f"tyre_{column}" if name.startswith("acceleration") else column
