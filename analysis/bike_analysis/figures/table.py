"""A ride as a pandas table: one row per recorded state, SI units, names that end in their unit.

Suffixes: ``_s`` seconds, ``_m`` metres, ``_m_s`` metres a second, ``_m_s2``, ``_rad``, ``_rad_s``, ``_nm`` newton
metres, ``_1_m`` one over metres; columns without a suffix are counts, flags, fractions in [-1, 1] or names. What was
not recorded is NaN. Nothing is decimated.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd

from bike_analysis.figures.course import beyond_limits
from bike_analysis.figures.laps import CompleteLap, course_length, find_laps, lap_of_states
from bike_analysis.figures.numbers import rate
from bike_analysis.figures.signals import command_ages, telemetry_columns
from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import STATE_QUANTITIES, Floats

_CONSTANT: Final = ("control_period", "steering_limit", "course_length", "course_closed", "front_progress")
STATE_COLUMNS: Final = {q.column: q.name for q in STATE_QUANTITIES if q.name not in _CONSTANT}
"""Columns that are fields of the recorded state, by name of the column."""


def ride_table(ride: Ride, laps: tuple[CompleteLap, ...] | None = None) -> pd.DataFrame:
    """Make the table of a ride.

    Args:
        ride: A ride.
        laps: Its laps, where they are known already.

    Returns:
        One row per state; see `docs/reference/analysis.md` for each column.
    """
    states = ride.states
    columns: dict[str, Any] = {
        "time_s": ride.time,
        "stamp_s": states.time_s,
        "step": states.step,
        "lap": lap_of_states(ride, find_laps(ride) if laps is None else laps),
        "station_m": station(ride),
    }
    steps, seconds = command_ages(ride)
    columns |= motion_columns(ride, slice(None))
    columns |= {"command_age_steps": steps, "command_age_s": seconds, "section": _section_names(ride)}
    return pd.DataFrame(columns)


def motion_columns(ride: Ride, rows: slice) -> dict[str, Any]:
    """Columns of the motion at selected states of a ride, by name."""
    states = ride.states.take(rows)
    columns: dict[str, Any] = {"distance_m": ride.distance[rows]}
    columns |= {name: getattr(states, field) for name, field in STATE_COLUMNS.items()}
    columns["acceleration_m_s2"] = rate(states.speed, states.time_s)
    columns["lateral_acceleration_m_s2"] = states.speed * states.yaw_rate
    columns["outside_m"] = beyond_limits(states, ride.course)
    return columns | telemetry_columns(ride, rows)


def station(ride: Ride) -> Floats:
    """Place on the course of each state, m: progress (within the lap on a closed course), else distance travelled."""
    states = ride.states
    if not np.isfinite(states.progress).any():
        return ride.distance
    length = course_length(ride)
    return states.progress if length is None else np.mod(states.progress, length)


def _section_names(ride: Ride) -> Any:
    course, index = ride.course, ride.section_of()
    names: list[str] = [] if course is None or not len(index) else list(dict.fromkeys(course.section_names))
    codes = np.full(len(ride.states), -1, dtype=np.int64)
    if course is not None and len(index):
        codes = np.array([names.index(name) for name in course.section_names] + [-1], dtype=np.int64)[index]
    return pd.Categorical.from_codes(codes, pd.Index(names, dtype=object))
