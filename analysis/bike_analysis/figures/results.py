"""Results of `bike analyze` as typed records: the figures of its ``--json``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from bike_analysis.figures.compare import Comparison, SectorFigures
from bike_analysis.figures.metrics import RideFigures, latency_figures
from bike_analysis.figures.recorded import RideRecording

SCHEMA: Final = "bike.analyze/2"
SPEED_STEP: Final = 0.25
"""Grid of speeds for grouping rides, m/s: that of Fig. 10 in the bicycle paper."""
STEADY: Final = 0.2
"""A ride whose speed varies by more than this fraction is left out of T(v)."""


@dataclass(frozen=True)
class RecordingFigures:
    """A recording.

    Attributes:
        recording: The file.
        vehicle: Name of the vehicle; null where it was not recorded.
        policy: Who rode, from the recorder's notes; null where unknown.
        truncated: Whether data is missing: the file is truncated, or a part damaged.
        warnings: What was missing or wrong, one sentence each.
        notes: What the recorder noted about the ride.
        messages: Messages read, of all topics.
        topics: Messages read, by topic.
        dropped_messages: Messages that the recorder had to give up, as it reported; null without a report.
        latency_median_s: Median wall-clock time of the policy's answers since its start, by its last report.
        latency_p99_s: 99th percentile of the same.
    """

    recording: str
    vehicle: str | None
    policy: str | None
    truncated: bool
    warnings: tuple[str, ...]
    notes: dict[str, str]
    messages: int
    topics: dict[str, int]
    dropped_messages: int | None
    latency_median_s: float | None
    latency_p99_s: float | None


@dataclass(frozen=True)
class RunFigures:
    """A ride or lap within a comparison.

    Attributes:
        run: Name, unique within the comparison.
        source: The recording's file name.
        policy: Who rode; null where unknown.
        ride: Number of the ride in its recording.
        lap: Number of the lap in its ride; null for a whole ride.
        duration_s: Lap time, or time of the ride since its reset.
        complete: Whether it is a complete lap, or a ride recorded from its reset that reached the end of its course.
        delta_s: Time lost on the reference at the last station that both rode; negative where it was won.
    """

    run: str
    source: str
    policy: str | None
    ride: int
    lap: int | None
    duration_s: float | None
    complete: bool
    delta_s: float | None


@dataclass(frozen=True)
class ComparisonFigures:
    """Rides or laps on the same course.

    Attributes:
        course: Name of the course; empty where none was recorded.
        reference: Run that the others are measured against.
        spacing_m: Distance of the stations at which they are compared.
        stations: Number of stations.
        runs: The compared runs.
        sectors: Times of the sectors; empty where the course has none.
        theoretical_lap_s: Sum of the best sectors; null unless every sector has one.
    """

    course: str
    reference: str
    spacing_m: float
    stations: int
    runs: tuple[RunFigures, ...]
    sectors: tuple[SectorFigures, ...]
    theoretical_lap_s: float | None


@dataclass(frozen=True)
class SpeedFigures:
    """Distance to the path at one speed, over controllers (bicycle paper, Eq. 15).

    Attributes:
        course: Name of the course.
        speed_m_s: Speed v, rounded to a quarter of a metre a second.
        controllers: Number N of controllers: policies, or recordings where the policy is not known.
        rides: Number of rides.
        completed: Rides that reached the end of the course without fault.
        mean_error_m: T(v), the mean over controllers of the mean distance to the path.
        max_error_m: Largest distance of any of them.
    """

    course: str
    speed_m_s: float
    controllers: int
    rides: int
    completed: int
    mean_error_m: float
    max_error_m: float


@dataclass(frozen=True)
class Analysis:
    """All figures of an analysis.

    Attributes:
        recordings: The recordings, in the order given.
        rides: Their rides, in order; `recording` is the file and the rest as in `RideFigures`.
        comparisons: Rides and laps side by side, one entry per course; empty where there is nothing to compare.
        distance_by_speed: T(v), one entry per course and speed; only of rides at a steady speed.
        truncated: Whether anything is missing in one of the recordings.
        warnings: All warnings, with the file where there are several; also files that could not be read.
        page: The report page, where it was written.
        picture: The picture, where it was written.
        csv: The aligned table as CSV, if requested.
        parquet: The same as Parquet.
        video: Moving picture of the longest ride, if requested.
    """

    recordings: tuple[RecordingFigures, ...]
    rides: tuple[RideEntry, ...]
    comparisons: tuple[ComparisonFigures, ...]
    distance_by_speed: tuple[SpeedFigures, ...]
    truncated: bool
    warnings: tuple[str, ...]
    page: str | None = None
    picture: str | None = None
    csv: str | None = None
    parquet: str | None = None
    video: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """The figures as plain types, ready for JSON.

        Values that are not finite become None, absent outputs are omitted, and the figures of a ride are next to its
        recording, not in a separate record.
        """
        plain: dict[str, Any] = finite(asdict(self))
        plain["rides"] = [{"recording": ride["recording"], **ride["figures"]} for ride in plain["rides"]]
        return {name: value for name, value in plain.items() if name not in WRITTEN or value is not None}


WRITTEN: Final = ("page", "picture", "csv", "parquet", "video")


@dataclass(frozen=True)
class RideEntry:
    """A ride of one of the recordings.

    Attributes:
        recording: The file.
        figures: Its figures.
    """

    recording: str
    figures: RideFigures = field(repr=False)


def finite(value: Any) -> Any:
    """Plain lists and dictionaries without numbers that JSON does not know."""
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def recording_figures(recording: RideRecording) -> RecordingFigures:
    """Describe a recording."""
    data = recording.data
    median, p99 = latency_figures(data.latencies)
    return RecordingFigures(
        recording=str(data.path),
        vehicle=data.vehicle or None,
        policy=recording.policy or None,
        truncated=data.truncated,
        warnings=data.warnings,
        notes=data.notes,
        messages=data.message_count,
        topics=data.topics,
        dropped_messages=data.dropped_messages,
        latency_median_s=median,
        latency_p99_s=p99,
    )


def comparison_figures(comparison: Comparison) -> ComparisonFigures:
    """Describe the result of a comparison."""
    stations, runs = comparison.station_m, comparison.runs
    return ComparisonFigures(
        course=comparison.course,
        reference=runs[comparison.reference].label,
        spacing_m=float(stations[1] - stations[0]) if len(stations) > 1 else 0.0,
        stations=len(stations),
        runs=tuple(_run_figures(comparison, index) for index in range(len(runs))),
        sectors=comparison.sectors,
        theoretical_lap_s=comparison.best_sectors_s,
    )


def _run_figures(comparison: Comparison, index: int) -> RunFigures:
    run, delta = comparison.runs[index], comparison.lost(index)
    known = np.flatnonzero(np.isfinite(delta))
    return RunFigures(
        run=run.label,
        source=run.source,
        policy=run.policy or None,
        ride=run.ride.index,
        lap=None if run.lap is None else run.lap.number,
        duration_s=run.duration_s,
        complete=run.complete,
        delta_s=float(delta[known[-1]]) if len(known) else None,
    )


def distance_by_speed(recordings: Sequence[RideRecording]) -> tuple[SpeedFigures, ...]:
    """Put rides at the same speed on the same course together: T(v) of the bicycle paper, Eq. 15.

    Args:
        recordings: What was read. Each policy counts as one controller, however often it rode.

    Returns:
        One entry per course and speed, sorted.
    """
    groups: dict[tuple[str, int], list[tuple[str, RideFigures]]] = {}
    for recording in recordings:
        for ride in recording.rides:
            f = ride.figures
            low, mean, high = f.speed_min_m_s, f.speed_mean_m_s, f.speed_max_m_s
            if f.course is None or f.mean_error_m is None or low is None or mean is None or high is None:
                continue
            if mean > 0.0 and high - low <= STEADY * mean:
                controller = recording.policy or str(recording.path)
                groups.setdefault((f.course, round(mean / SPEED_STEP)), []).append((controller, f))
    return tuple(_speed_figures(course, SPEED_STEP * step, found) for (course, step), found in sorted(groups.items()))


def _speed_figures(course: str, speed: float, found: Sequence[tuple[str, RideFigures]]) -> SpeedFigures:
    by_controller: dict[str, list[float]] = {}
    for controller, f in found:
        by_controller.setdefault(controller, []).append(f.mean_error_m or 0.0)
    return SpeedFigures(
        course=course,
        speed_m_s=speed,
        controllers=len(by_controller),
        rides=len(found),
        completed=sum(f.completed for _, f in found),
        mean_error_m=float(np.mean([np.mean(means) for means in by_controller.values()])),
        max_error_m=max(f.max_error_m or 0.0 for _, f in found),
    )
