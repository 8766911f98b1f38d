"""Results of `bike analyze` as plain values: the figures of its ``--json`` (docs/reference/analysis.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from bike_analysis.figures.compare import Comparison
from bike_analysis.figures.metrics import Figures, latency_figures
from bike_analysis.figures.recorded import RecordedRide, RideRecording

SCHEMA: Final = "bike.analyze/2"
SPEED_STEP: Final = 0.25
"""Grid of speeds for grouping rides, m/s: that of Fig. 10 in the bicycle paper."""
STEADY: Final = 0.2
"""A ride whose speed varies by more than this fraction is left out of T(v)."""


def finite(value: Any) -> Any:
    """Plain lists and dictionaries without numbers that JSON does not know; those become None."""
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def recording_figures(recording: RideRecording) -> dict[str, Any]:
    """Describe a recording; what was not recorded is None."""
    data = recording.data
    median, p99 = latency_figures(data.latencies)
    return {
        "recording": str(data.path),
        "vehicle": data.vehicle or None,
        "policy": recording.policy or None,
        "truncated": data.truncated,
        "warnings": data.warnings,
        "notes": data.notes,
        "messages": data.message_count,
        "topics": data.topics,
        "dropped_messages": data.dropped_messages,
        "latency_median_s": median,
        "latency_p99_s": p99,
    }


def ride_entry(ride: RecordedRide) -> dict[str, Any]:
    """Describe a ride: its recording and its figures."""
    return {"recording": str(ride.recording.path), **ride.figures}


def comparison_figures(comparison: Comparison) -> dict[str, Any]:
    """Describe the result of a comparison."""
    stations, runs = comparison.station_m, comparison.runs
    return {
        "course": comparison.course,
        "reference": runs[comparison.reference].label,
        "spacing_m": float(stations[1] - stations[0]) if len(stations) > 1 else 0.0,
        "stations": len(stations),
        "runs": [_run_figures(comparison, index) for index in range(len(runs))],
        "sectors": [asdict(sector) for sector in comparison.sectors],
        "theoretical_lap_s": comparison.best_sectors_s,
    }


def _run_figures(comparison: Comparison, index: int) -> dict[str, Any]:
    """Describe a ride or lap; ``delta_s`` is lost on the reference at the last station that both rode."""
    run, delta = comparison.runs[index], comparison.lost(index)
    known = np.flatnonzero(np.isfinite(delta))
    return {
        "run": run.label,
        "source": run.source,
        "policy": run.policy or None,
        "ride": run.ride.index,
        "lap": None if run.lap is None else run.lap.number,
        "duration_s": run.duration_s,
        "complete": run.complete,
        "delta_s": float(delta[known[-1]]) if len(known) else None,
    }


def distance_by_speed(recordings: Sequence[RideRecording]) -> list[dict[str, Any]]:
    """Put rides at the same speed on the same course together: T(v) of the bicycle paper, Eq. 15.

    Args:
        recordings: What was read. Each policy counts as one controller, however often it rode.

    Returns:
        One entry per course and speed, sorted.
    """
    groups: dict[tuple[str, int], list[tuple[str, Figures]]] = {}
    for recording in recordings:
        for ride in recording.rides:
            f = ride.figures
            low, mean, high = f.speed_min_m_s, f.speed_mean_m_s, f.speed_max_m_s
            if f.course is None or f.mean_error_m is None or low is None or mean is None or high is None:
                continue
            if mean > 0.0 and high - low <= STEADY * mean:
                controller = recording.policy or str(recording.path)
                groups.setdefault((f.course, round(mean / SPEED_STEP)), []).append((controller, f))
    return [_speed_figures(course, SPEED_STEP * step, found) for (course, step), found in sorted(groups.items())]


def _speed_figures(course: str, speed: float, found: Sequence[tuple[str, Figures]]) -> dict[str, Any]:
    by_controller: dict[str, list[float]] = {}
    for controller, f in found:
        by_controller.setdefault(controller, []).append(f.mean_error_m or 0.0)
    return {
        "course": course,
        "speed_m_s": speed,
        "controllers": len(by_controller),
        "rides": len(found),
        "completed": sum(f.completed for _, f in found),
        "mean_error_m": float(np.mean([np.mean(means) for means in by_controller.values()])),
        "max_error_m": max(f.max_error_m or 0.0 for _, f in found),
    }
