"""Figures of a ride, and the ride as a pandas table. All of them come from every recorded state, none is decimated.

Distances to the path are those of the rear contact point, t_0 = d(P, P_P0) in the bicycle paper, which evaluates their
mean and maximum along a ride (Weyrer et al. 2026, Sect. 5.3 and Eq. 15). Distance to the ideal line, time off the
track, falls and collisions are the figures of the superbike paper for a deployed policy (its Table I). Names end in
their units; what cannot be computed from the recording is None.

The table has one row per recorded state, SI units, and names that end in their unit: ``_s`` seconds, ``_m`` metres,
``_m_s`` metres a second, ``_m_s2``, ``_rad``, ``_rad_s``, ``_nm`` newton metres, ``_1_m`` one over metres; columns
without a suffix are counts, flags, fractions in [-1, 1] or names. What was not recorded is NaN.
"""

from __future__ import annotations

import re
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bike_analysis.figures.laps import (
    Lap,
    beyond_limits,
    counted_laps,
    course_length,
    lap_of_states,
    time_outside,
)
from bike_analysis.figures.numbers import (
    best_sectors_together,
    command_ages,
    over,
    rate,
    rms_of,
    telemetry_columns,
    tyre_figures,
)
from bike_analysis.figures.rides import Ride
from bike_analysis.read.messages import STATE_QUANTITIES, Floats, Latency, Table
from bike_sim.schema import SUSPENSION

_CONSTANT: Final = ("control_period", "steering_limit", "course_length", "course_closed", "front_progress")
STATE_COLUMNS: Final = {q.column: q.name for q in STATE_QUANTITIES if q.name not in _CONSTANT}
"""Columns that are fields of the recorded state, by name of the column."""


def ride_table(ride: Ride) -> pd.DataFrame:
    """Make the table of a ride: one row per state; see `docs/reference/analysis.md` for each column."""
    states = ride.states
    columns: dict[str, Any] = {
        "time_s": ride.time,
        "stamp_s": states.time_s,
        "step": states.step,
        "lap": lap_of_states(ride, ride.laps),
        "station_m": station(ride),
    }
    steps, seconds = command_ages(ride)
    columns |= motion_columns(ride, slice(None))
    course, index = ride.course, ride.section_of()
    names = np.array([None, *(course.section_names if course is not None else ())], dtype=object)
    inside = names[index + 1] if len(index) else np.full(len(states), None)
    section = pd.Categorical(inside, list(dict.fromkeys(names[1:])))
    return pd.DataFrame(columns | {"command_age_steps": steps, "command_age_s": seconds, "section": section})


def motion_columns(ride: Ride, rows: slice) -> dict[str, Any]:
    """Columns of the motion at selected states of a ride, by name."""
    states = ride.states.take(rows)
    columns: dict[str, Any] = {"distance_m": ride.distance[rows]}
    columns |= {name: getattr(states, field) for name, field in STATE_COLUMNS.items()}
    columns["acceleration_m_s2"] = rate(states.speed, states.time_s)
    columns["lateral_acceleration_m_s2"] = states.speed * states.yaw_rate
    columns["outside_m"] = beyond_limits(states, ride.course)
    columns |= {q.column: states.values[q.name] for q in SUSPENSION if q.name in states.values}
    return columns | telemetry_columns(ride, rows)


def station(ride: Ride) -> Floats:
    """Place on the course of each state, m: progress (within the lap on a closed course), else distance travelled."""
    states = ride.states
    if not np.isfinite(states.progress).any():
        return ride.distance
    length = course_length(ride)
    return states.progress if length is None else np.mod(states.progress, length)


IDEAL_LINE: Final = "(ideal)"
"""End of the name of a followed line that is the circuit's ideal line."""

_ENERGY: Final = re.compile(r"([0-9.]+) kJ")


class Figures(dict[str, Any]):
    """Figures of a ride or of one of its laps by name, each an attribute too.

    The page of the analysis describes them all (docs/reference/analysis.md). Names end in their units; what cannot be
    computed is None.
    """

    def __getattr__(self, name: str) -> Any:
        """Return a figure.

        Raises:
            AttributeError: There is none of that name.
        """
        try:
            return self[name]
        except KeyError:
            raise AttributeError(f"no figure {name!r}; there are {', '.join(self)}") from None


LAP_MOTION: Final = (
    *("speed_min_m_s", "speed_mean_m_s", "speed_max_m_s", "roll_min_deg", "roll_max_deg", "roll_rate_rms_deg_s"),
    *("steer_rate_rms_deg_s", "acceleration_max_m_s2", "braking_max_m_s2", "lateral_acceleration_max_m_s2"),
)
"""Figures of the motion that laps have."""


def ride_figures(ride: Ride) -> Figures:
    """Compute the figures of a ride.

    Args:
        ride: A ride as recorded. Its motion is evaluated up to the finish of an open course (`evaluated_ride`); falls,
            collisions, gaps and delays are those of the whole recording.

    Returns:
        Its figures.
    """
    whole, ride = ride, ride.evaluated
    states = ride.states
    error = np.abs(states.lateral_error)
    laps = ride.laps
    outside = beyond_limits(states, ride.course)
    median, p99 = latency_figures(ride.latencies)
    (ages, seconds), answered = command_ages(whole), np.unique(whole.commands.step)
    length, progress = course_length(ride), states.progress[np.isfinite(states.progress)]
    worst = float(states.progress[int(np.nanargmax(error))]) if np.isfinite(error).any() else np.nan
    left = sum(e.kind == "off_course" and (ride is whole or e.step < states.step[-1]) for e in ride.events)
    return Figures(
        ride=ride.index,
        episode=ride.episode,
        course=ride.course.name if ride.course else None,
        ended_by=ride.ended_by,
        completed=ride.ended_by == "finished",
        falls=_times(whole.states.fallen, sum(e.kind == "fall" for e in ride.events)),
        off_course=_times(states.off_course, left),
        duration_s=float(ride.time[-1]),
        distance_m=float(ride.distance[-1]),
        laps=None if length is None or not len(progress) else int((progress[-1] - progress[0]) // length),
        **error_figures(error),
        max_error_at_m=worst if np.isfinite(worst) else None,
        **motion_figures(states),
        steps=len(whole.states),
        lost_steps=_lost_steps(whole.states),
        lost_commands=int(answered[-1] - answered[0] + 1 - len(answered)) if len(answered) else None,
        repeated_states=ride.repeated_states,
        unanswered_states=int(np.sum(~np.isin(whole.states.step[:-1], answered))) if len(answered) else None,
        command_delay_mean_steps=over(np.mean, ages),
        command_delay_max_steps=None if (oldest := over(np.max, ages)) is None else int(oldest),
        command_delay_mean_s=over(np.mean, seconds),
        command_delay_max_s=over(np.max, seconds),
        latency_median_s=median,
        latency_p99_s=p99,
        **ideal_figures(ride, slice(None)),
        off_track_s=time_outside(ride.time, outside),
        collisions=collisions(ride),
        best_lap_s=min((lap.duration_s for lap in counted_laps(laps)), default=None),
        theoretical_lap_s=best_sectors_together(lap.sectors_s for lap in counted_laps(laps) if lap.sectors_s),
        tyres=tyre_figures(ride),
        complete_laps=tuple(lap_figures(ride, lap, outside) for lap in laps),
        sections=section_figures(ride),
    )


def motion_figures(states: Table) -> dict[str, Any]:
    """Speed, lean, steering and accelerations over some states, by name."""
    roll, steer = np.degrees(states.roll), np.degrees(states.steer)
    roll_rate, steer_rate = np.degrees(states.roll_rate), np.degrees(states.steer_rate)
    change = rate(states.speed, states.time_s)
    return {
        "speed_min_m_s": over(np.min, states.speed),
        "speed_mean_m_s": over(np.mean, states.speed),
        "speed_max_m_s": over(np.max, states.speed),
        "roll_min_deg": over(np.min, roll),
        "roll_max_deg": over(np.max, roll),
        "steer_min_deg": over(np.min, steer),
        "steer_max_deg": over(np.max, steer),
        "roll_rate_rms_deg_s": over(rms_of, roll_rate),
        "steer_rate_rms_deg_s": over(rms_of, steer_rate),
        "steer_torque_rms_nm": over(rms_of, states.steer_torque),
        "roll_rate_max_deg_s": over(np.max, np.abs(roll_rate)),
        "steer_rate_max_deg_s": over(np.max, np.abs(steer_rate)),
        "command_change_mean": over(np.mean, np.abs(np.diff(states.steering_command[1:]))),
        "throttle_change_mean": over(np.mean, np.abs(np.diff(states.throttle_command[1:]))),
        "acceleration_max_m_s2": over(np.max, change),
        "braking_max_m_s2": over(np.max, -change),
        "lateral_acceleration_max_m_s2": over(np.max, np.abs(states.speed * states.yaw_rate)),
    }


def ideal_figures(ride: Ride, rows: slice) -> dict[str, Any]:
    """Mean over time of the distance to the ideal line, and the largest, m; None unless it is the followed line."""
    if ride.course is None or not ride.course.name.endswith(IDEAL_LINE):
        return {"ideal_distance_mean_m": None, "ideal_distance_max_m": None}
    distance, time = np.abs(ride.states.lateral_error[rows]), ride.time[rows]
    span = float(time[-1] - time[0]) if len(time) > 1 else 0.0
    mean = float(np.trapezoid(distance, time)) / span if span > 0.0 else over(np.mean, distance)
    return {"ideal_distance_mean_m": mean, "ideal_distance_max_m": over(np.max, distance)}


def lap_figures(ride: Ride, lap: Lap, outside: Floats) -> Figures:
    """Compute the figures of a lap.

    Args:
        ride: A ride.
        lap: One of its laps.
        outside: What `beyond_limits` says of the ride's states.

    Returns:
        Its figures.
    """
    states = ride.states.take(lap.rows)
    off_track, motion = time_outside(ride.time, outside, lap.begin_s, lap.end_s), motion_figures(states)
    return Figures(
        lap=lap.number,
        lap_s=lap.duration_s,
        sectors_s=list(lap.sectors_s),
        valid=None if off_track is None else off_track == 0.0,
        from_events=lap.from_events,
        begin_s=lap.begin_s,
        out_lap=lap.out_lap,
        off_track_s=off_track,
        **error_figures(np.abs(states.lateral_error)),
        **ideal_figures(ride, lap.rows),
        **{name: motion[name] for name in LAP_MOTION},
        falls=int(states.fallen.any()),
        lost_steps=_lost_steps(states) if len(states) else 0,
    )


def collisions(ride: Ride) -> list[dict[str, Any]]:
    """Collisions with walls: time since the reset, arc length, speed, and energy as the event's text states it."""
    found = []
    for event in ride.events:
        if event.kind == "wall":
            match = _ENERGY.search(event.text)
            energy = 1e3 * float(match[1]) if match else None
            entry: dict[str, Any] = {"time_s": event.time_s, "progress_m": event.progress_m, "speed_m_s": event.value}
            found.append(entry | {"energy_j": energy, "text": event.text})
    return found


def section_figures(ride: Ride) -> list[dict[str, Any]]:
    """Compute the distance to the path for each section of the course.

    Args:
        ride: A ride.

    Returns:
        One entry per section, in order, over all laps; empty if the course or its sections were not recorded.
    """
    course = ride.course
    section = ride.section_of()
    if course is None or not len(section):
        return []
    error = np.abs(ride.states.lateral_error)
    figures = []
    for index, (name, start) in enumerate(zip(course.section_names, course.section_starts, strict=False)):
        inside = error[section == index]
        figures.append({"name": name, "start_m": float(start), "samples": len(inside), **error_figures(inside)})
    return figures


def latency_figures(latencies: tuple[Latency, ...]) -> tuple[float | None, float | None]:
    """Median and 99th percentile of the policy's latency, s, from the last report; None if no report has it.

    Each report is over all answers since the policy's start (the last 100,000), so the last one covers the most. The
    first ones are over few answers, of which the very first is slow: their 99th percentile would be that one answer.

    Args:
        latencies: Reports, in order.
    """
    median = [x.median_s for x in latencies if np.isfinite(x.median_s)]
    p99 = [x.p99_s for x in latencies if np.isfinite(x.p99_s)]
    return median[-1] if median else None, p99[-1] if p99 else None


def error_figures(error: Floats) -> dict[str, Any]:
    """Mean, maximum and root mean square of distances, by name."""
    return {
        "mean_error_m": over(np.mean, error),
        "max_error_m": over(np.max, error),
        "rms_error_m": over(rms_of, error),
    }


def _times(flags: NDArray[np.bool_], events: int) -> int:
    """Number of times that something happened: rises of its flag, or events where the flag was not recorded in time."""
    rises = int(flags[0]) + int(np.sum(flags[1:] & ~flags[:-1]))
    return max(rises, events)


def _lost_steps(states: Table) -> int:
    return int(states.step[-1] - states.step[0] + 1 - len(states))
