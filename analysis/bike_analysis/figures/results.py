"""Results of `bike analyze` as plain values: the figures of its ``--json`` (docs/reference/analysis.md)."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from bike_analysis.figures.compare import Comparison
from bike_analysis.figures.metrics import latency_figures
from bike_analysis.figures.rides import Ride, RideRecording

SCHEMA: Final = "bike.analyze/4"


def finite(value: Any) -> Any:
    """Plain lists and dictionaries without numbers that JSON does not know; those become None."""
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def recording_figures(recording: RideRecording) -> dict[str, Any]:
    """Describe a recording; what was not recorded is None."""
    median, p99 = latency_figures(recording.latencies)
    return {
        "recording": str(recording.path),
        "vehicle": recording.vehicle or None,
        "policy": recording.policy or None,
        "truncated": recording.truncated,
        "warnings": recording.warnings,
        "notes": recording.notes,
        "messages": recording.message_count,
        "topics": recording.topics,
        "dropped_messages": recording.dropped_messages,
        "latency_median_s": median,
        "latency_p99_s": p99,
    }


def ride_entry(ride: Ride) -> dict[str, Any]:
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
        "sectors": list(comparison.sectors),
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
