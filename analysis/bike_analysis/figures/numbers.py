"""Columns of numbers that may be unknown (NaN): means, rates, shares of time, ages of commands, tyres; lap times."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.figures.rides import Ride
from bike_analysis.read.messages import Floats, Table
from bike_sim.course.road import between
from bike_sim.schema import TELEMETRY


def rms_of(values: NDArray[Any]) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def over(function: Any, values: NDArray[Any]) -> float | None:
    """Apply a function to the finite values; None if there are none (the field was not recorded)."""
    finite = values[np.isfinite(values)]
    return float(function(finite)) if len(finite) else None


def rate(values: Floats, time_s: Floats) -> Floats:
    """Change over time by central differences; NaN where there are fewer than two values or time stands still.

    Central differences over two steps, from the previous to the next state.
    The difference to the state before alone would be that of half a step earlier, with twice the noise.
    """
    if len(values) < 2:
        return np.full(len(values), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.asarray(np.gradient(values, time_s), dtype=np.float64)
    found[~np.isfinite(found)] = np.nan
    return found


def best_sectors_together(laps: Iterable[Sequence[float | None]]) -> float | None:
    """The sum of the best time of each sector, s: the theoretical best lap.

    Args:
        laps: Times of the sectors, one row per lap; None where a sector was not completed. Rows are of equal length.

    Returns:
        The sum of the times as they are, none of them rounded; None unless every sector has a time.
    """
    best = [min((t for t in times if t is not None), default=None) for times in zip(*laps, strict=True)]
    known = [time for time in best if time is not None]
    return float(sum(known)) if known and len(known) == len(best) else None


def lap_text(seconds: float) -> str:
    """Return a lap time as people write it: to the millisecond, with minutes where there are any."""
    minutes, milliseconds = divmod(round(1e3 * seconds), 60_000)  # rounded first: 59.9996 s are a minute
    rest = 1e-3 * milliseconds
    return f"{minutes}:{rest:06.3f}" if minutes else f"{rest:.3f}"


def significant(value: float, digits: int = 4) -> str:
    """Return a figure of unknown size for people: four significant digits, thousands with commas, no exponent."""
    if value == 0.0 or not np.isfinite(value):
        return "0" if value == 0.0 else "–"
    decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{min(decimals, 8)}f}"


def time_shares(values: Floats, time_s: Floats, edges: Sequence[float]) -> tuple[float, ...]:
    """Share of the time that a quantity spent in each bin.

    Args:
        values: One per state; missing ones are left out, those beyond the ends count in the first and the last bin.
        time_s: Of each state, s.
        edges: Of the bins, rising; one more than bins.

    Returns:
        Shares, %, together 100; zeros where nothing is known. A value holds until the next state.
    """
    lasting = np.diff(time_s, append=time_s[-1:])
    known = np.isfinite(values) & (lasting > 0.0)
    if not known.any():
        return (0.0,) * (len(edges) - 1)
    within = np.clip(values[known], edges[0], np.nextafter(edges[-1], -np.inf))
    counts, _ = np.histogram(within, np.asarray(edges), weights=lasting[known])
    return tuple(float(share) for share in 100.0 * counts / counts.sum())


def command_ages(ride: Ride) -> tuple[Floats, Floats]:
    """Return the age of the command that was applied in the step that led to each state.

    A state contains the command that was applied in the step that led to it. That command is looked up among the
    recorded ones: the newest one with this value that answers a state from before the step. Its age is the number of
    steps (and the simulated time) between the state that it answers and the state from which the step began. In
    lockstep it is 0; in free running it shows how late the commands were, a held command ageing with each step.

    Args:
        ride: A ride.

    Returns:
        Age of each state's command in control steps (0 if it answers the very state from which the step began) and in
        simulated time, s; NaN where it is not known.
    """
    states, commands = ride.states, ride.commands
    steering = np.clip(commands.steering, -1.0, 1.0)
    ages, seconds = np.full(len(states), np.nan), np.full(len(states), np.nan)
    values, value = np.unique(steering[np.isfinite(steering)], return_inverse=True)
    if not len(values) or len(states) < 2:
        return ages, seconds
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
    row = np.minimum(np.searchsorted(states.step, commands.step), len(states) - 1)
    # Of the state that a command answers; the command's own stamp only where that state is not there.
    answered_time = np.where(states.step[row] == commands.step, states.time_s[row], commands.time_s)
    ages[rows], seconds[rows] = begin - commands.step[match], begin_time - answered_time[match]
    return ages, seconds


def tyre_figures(ride: Ride) -> dict[str, float | None] | None:
    """Compute slip, use of friction and loads of the tyres, the engine's power, and how long aids acted.

    Largest values are on either side; the force of a tyre is largest at a use of about 2.6.

    Args:
        ride: A ride.

    Returns:
        Its figures by name, or None where no telemetry of it was recorded.
    """
    telemetry = ride.telemetry
    if not len(telemetry):
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
    figures["engine_power_max_w"] = over(np.max, telemetry.values.get("engine_power", nothing))
    return figures


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
    columns = {TELEMETRY[n].column: column for n, column in _of_states(ride.telemetry, ride, rows).items()}
    # States have accelerations, too, which are worked out from the motion.
    return {f"tyre_{n}" if n.startswith("acceleration") else n: column for n, column in columns.items()}


def grip_columns(ride: Ride, rows: slice) -> dict[str, Floats]:
    """Grip at some of a ride's states, inferred and true, as factors on what the rider knows, %.

    Empty where the rider inferred none.
    """
    inferred = _of_states(ride.grip, ride, rows)
    if "grip" not in inferred:
        return {}
    return {"inferred_grip": 100.0 * inferred["grip"], "true_grip": 100.0 * true_grip(ride, rows)}


def true_grip(ride: Ride, rows: slice) -> Floats:
    """Factor on the friction that the rider knows, of road and tyres, by the recorded disturbances."""
    states = ride.states
    progress = states.values.get("centre_progress", states.progress)
    try:
        road, tyres = (ride.recording.disturbances.get(part, {}) for part in ("road", "vehicle"))
        factor = np.full(len(states), float(road.get("grip", 1.0)))
        factor *= np.mean([float(tyres.get(f"{wheel}_tyre.friction", 1.0)) for wheel in ("front", "rear")])
        place = progress
        if states.course_length[0] > 0.0 and np.nanmax(states.progress) >= states.course_length[0]:
            # A lap of the followed line ends where one of the centre line does.
            place = progress % float(np.interp(states.course_length[0], states.progress, progress))
        for begin, end, grip in road.get("patches", []):
            factor[between(place, float(begin), float(end))] *= float(grip)
        factor *= 1.0 + float(road.get("drift_per_lap", 0.0)) * progress / max(states.course_length[0], 1.0)
        return factor[rows]
    except (AttributeError, TypeError, ValueError):
        return np.full(len(states), np.nan)[rows]  # not a document of ours


def _of_states(table: Table, ride: Ride, rows: slice) -> dict[str, Floats]:
    """Columns of messages of some of a ride's states, by name; NaN where a state has none, empty without messages."""
    if not len(table):
        return {}
    steps = ride.states.step[rows]
    order = np.argsort(table.step, kind="stable")
    match = order[np.minimum(np.searchsorted(table.step[order], steps), len(order) - 1)]
    known = table.step[match] == steps
    return {name: np.where(known, column[match], np.nan) for name, column in table.values.items()}
