"""Comparison of rides or laps, aligned by arc length along the course.

Each run is interpolated at the same stations, equidistant along the course. There the time since the run's start,
and every column of `bike_analysis.figures.metrics`, are interpolated between the two recorded states around it. So the
difference of two times at a station is what one run has lost on the other up to there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import pandas as pd

from bike_analysis.figures.laps import (
    ON_THE_LINE,
    Lap,
    farther_than_before,
    known_length,
    reset_time,
    sector_starts,
)
from bike_analysis.figures.metrics import Figures, motion_columns, station
from bike_analysis.figures.numbers import best_sectors_together
from bike_analysis.figures.rides import Ride
from bike_analysis.read.messages import Flags, Floats

STATIONS: Final = 2500
"""About so many stations are wanted along a course."""
MOST_ROWS: Final = 2_000_000
"""Stations or times of one run that are computed at most."""
MOST_NAMED: Final = 2
"""Riders or runs that a title names."""
STANDING: Final = 1.0
"""A lap that begins slower than this begins from a standing start, m/s."""
SAME_LENGTH: Final = 0.03
"""Courses whose lengths differ by more than this part are not the same."""


class CourseError(ValueError):
    """Rides on different courses were to be compared."""


@dataclass(frozen=True)
class Run:
    """One run of a comparison: a ride, or one lap of it.

    Attributes:
        label: Name for people, unique within a comparison.
        ride: The ride.
        lap: The lap, or None for the whole ride.
    """

    label: str
    ride: Ride
    lap: Lap | None = None

    @property
    def source(self) -> str:
        """The recording's file name."""
        return self.ride.recording.path.name

    @property
    def policy(self) -> str:
        """Who rode, from the recording's notes; empty where unknown."""
        return self.ride.recording.policy

    @property
    def begin_s(self) -> float:
        """When the lap or the ride (its reset) began, s since the ride's first recorded state."""
        return self.lap.begin_s if self.lap is not None else -reset_time(self.ride)

    @property
    def begin_m(self) -> float:
        """Progress at which it began, m."""
        return self.lap.begin_m if self.lap is not None else 0.0

    @property
    def rows(self) -> slice:
        """Rows of the ride's states inside it."""
        return slice(0, len(self.ride.states)) if self.lap is None else self.lap.rows

    @property
    def duration_s(self) -> float:
        """Lap time, or the time of the whole ride since its reset, s."""
        return self.lap.duration_s if self.lap is not None else float(self.ride.time[-1]) - self.begin_s

    @property
    def kind(self) -> str:
        """Kind of lap, by its beginning; ``whole ride`` for a ride."""
        if self.lap is None:
            return "whole ride"
        if not self.lap.out_lap:
            return "flying"
        begins = self.ride.states.speed[self.lap.first]
        return "standing start" if begins < STANDING else "rolling start"

    @property
    def complete(self) -> bool:
        """Whether it is a lap, or a ride recorded from its reset that reached the end of its course."""
        return self.lap is not None or (self.ride.ended_by == "finished" and int(self.ride.states.step[0]) == 0)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs on the same course, aligned. Columns are interpolated when they are first needed.

    Attributes:
        course: Name of the course; empty where none was recorded.
        runs: The compared runs, in the order given.
        reference: Index of the run that the others are measured against: the fastest complete one, else the one that
            came farthest.
        station_m: Stations along the course, m, shape (stations,).
        scales: Factor that scales the arc length of each run to that of the reference; 1 where a length is unknown.
        sectors: Of a closed course, or the sections of an open one; empty where it has none. Each has its ``name``,
            ``start_m``, ``end_m``, ``times_s`` by run (None where it was not completed), the best of them, ``best_s``,
            out-laps not counted where there are others (None if no run completed it), and ``best_run``, who rode it.
    """

    course: str
    runs: tuple[Run, ...]
    reference: int
    station_m: Floats
    scales: tuple[float, ...]
    sectors: tuple[Figures, ...]

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(run.label for run in self.runs)} at {len(self.station_m)} stations>"

    @property
    def title(self) -> str:
        """The riders, or the runs where riders are not known or the same, and the course."""
        riders = list(dict.fromkeys(run.policy for run in self.runs))
        several = len({run.source for run in self.runs}) > 1
        named = riders if all(riders) and (len(riders) > 1 or not several) else list(self.short_labels)
        names = " and ".join(named) if len(named) <= MOST_NAMED else f"{len(named)} rides or laps"
        return f"{names} on {self.course}" if self.course else names

    @property
    def short_labels(self) -> tuple[str, ...]:
        """Labels of the runs; without the recording's name where all are laps of one."""
        labels = tuple(run.label for run in self.runs)
        heads = {label.rpartition(", ")[0] for label in labels}
        if len(labels) > 1 and len(heads) == 1 and heads != {""}:
            return tuple(label.rpartition(", ")[2] for label in labels)
        return labels

    @cached_property
    def values(self) -> dict[str, Floats]:
        """Aligned values by column, shape (runs, stations); NaN where a run was not."""
        aligned = [self._aligned(k, motion_columns(run.ride, _rows(run))) for k, run in enumerate(self.runs)]
        nothing = np.full(len(self.station_m), np.nan)
        names = dict.fromkeys(name for part in aligned for name in part)
        motion = {name: np.stack([part.pop(name, nothing) for part in aligned]) for name in names}
        for run, place in zip(self.runs, motion["distance_m"], strict=True):
            if run.lap is not None:
                place -= place[0]
        times = np.stack([self.times(k) for k in range(len(self.runs))])
        return {"time_s": times, "delta_s": times - self._reference_times, **motion}

    def times(self, index: int) -> Floats:
        """When one run was at each station, s since its begin; NaN where it was not."""
        run = self.runs[index]
        return self._aligned(index, {"time_s": run.ride.time[_rows(run)] - run.begin_s})["time_s"]

    def lost(self, index: int) -> Floats:
        """Time that one run had lost on the reference at each station, s; NaN where one of them was not."""
        return self.times(index) - self._reference_times

    @cached_property
    def _reference_times(self) -> Floats:
        return self.times(self.reference)

    def _aligned(self, index: int, columns: dict[str, Any]) -> dict[str, Floats]:
        """Columns of one run's rows, put on the stations."""
        run = self.runs[index]
        fresh, places = _arc_lengths(run, self.scales[index])
        found = {}
        for name, column in columns.items():
            values = np.asarray(column, dtype=np.float64)[fresh]
            found[name] = np.interp(self.station_m, places, values, left=np.nan, right=np.nan)
        return found

    def column(self, name: str) -> Floats:
        """One aligned column.

        Args:
            name: ``time_s``, ``delta_s`` or a numeric column of `bike_analysis.figures.metrics`.

        Returns:
            Shape (runs, stations); NaN where a run was not.

        Raises:
            KeyError: If there is no such column.
        """
        if name not in self.values:
            raise KeyError(f"no aligned column {name!r}; there are {', '.join(self.values)}")
        return self.values[name]

    @cached_property
    def table(self) -> pd.DataFrame:
        """All runs below each other: ``run``, ``source``, ``ride``, ``lap``, ``station_m``, then the aligned columns.

        One row per run and station, without stations that a run did not reach.
        """
        parts = [self._part(index) for index in range(len(self.runs))]
        table = pd.concat(parts, ignore_index=True)
        for name in ("run", "source"):
            table[name] = table[name].astype("category")
        return table

    def _part(self, index: int) -> pd.DataFrame:
        run = self.runs[index]
        known = np.isfinite(self.values["time_s"][index])
        names: dict[str, Any] = {
            "run": run.label,
            "source": run.source,
            "ride": run.ride.index,
            "lap": 0 if run.lap is None else run.lap.number,
            "station_m": self.station_m[known],
        }
        return pd.DataFrame(names | {name: column[index][known] for name, column in self.values.items()})

    def fastest(self, count: int) -> Comparison:
        """The same with the fastest runs only, the reference among them.

        Args:
            count: How many to keep; complete runs come first.

        Returns:
            A comparison at the same stations.
        """
        if len(self.runs) <= count:
            return self
        others = [i for i in range(len(self.runs)) if i != self.reference]
        others.sort(key=lambda i: (not self.runs[i].complete, self.runs[i].duration_s))
        kept = sorted([self.reference, *others[: count - 1]])
        runs = tuple(self.runs[i] for i in kept)
        scales = tuple(self.scales[i] for i in kept)
        reference = kept.index(self.reference)
        return replace(self, runs=runs, reference=reference, scales=scales, sectors=_sectors(runs))

    @property
    def best_sectors_s(self) -> float | None:
        """The theoretical best lap: the sum of the best sectors, s; None unless every sector has one."""
        return best_sectors_together([[sector.best_s for sector in self.sectors]])


def compare_runs(runs: Sequence[Run], station_m: float | None = None) -> Comparison:
    """Align runs on the same course.

    Args:
        runs: At least one.
        station_m: Distance of stations, m; by default a round number that gives about `STATIONS` of them.

    Returns:
        The comparison.

    Raises:
        CourseError: If the courses differ in length.
        ValueError: If there is no run, or the distance of stations is not positive.
    """
    if not runs:
        raise ValueError("nothing to compare: no ride or lap was given")
    lengths = [known_length(run.ride.states) for run in runs]
    known_lengths = [length for length in lengths if length is not None]
    if known_lengths and max(known_lengths) > (1.0 + SAME_LENGTH) * min(known_lengths):
        measured = [(length, run.label) for run, length in zip(runs, lengths, strict=True) if length is not None]
        ends = ", ".join(f"{label}: {length:.0f} m" for length, label in (min(measured), max(measured)))
        raise CourseError(f"rides on different courses cannot be aligned ({ends})")
    reference = _reference(runs)
    whole = lengths[reference] or max(float(np.nanmax(station(runs[reference].ride), initial=0.0)), 1e-6)
    spacing = _round_spacing(whole / STATIONS) if station_m is None else float(station_m)
    if not (spacing > 0.0 and np.isfinite(spacing)):
        raise ValueError(f"the distance of stations must be positive, got {station_m!r} m")
    if whole / spacing > MOST_ROWS:
        raise ValueError(f"stations {spacing:g} m apart on {whole:.0f} m would be more than {MOST_ROWS}")
    stations = np.arange(0.0, whole + 1e-9 * whole, spacing)
    known = lengths[reference]
    scales = tuple(1.0 if known is None or length is None else known / length for length in lengths)
    course = min((run.ride.course.name for run in runs if run.ride.course is not None), default="")
    return Comparison(course, tuple(runs), reference, stations, scales, _sectors(runs))


def counted_runs(runs: Sequence[Run]) -> list[int]:
    """Indices of the runs that may be the best: without out-laps, unless there are no others."""
    flying = [index for index, run in enumerate(runs) if run.lap is None or not run.lap.out_lap]
    return flying or list(range(len(runs)))


def _reference(runs: Sequence[Run]) -> int:
    complete = [index for index in counted_runs(runs) if runs[index].complete]
    complete = complete or [index for index, run in enumerate(runs) if run.complete]
    if complete:
        return min(complete, key=lambda index: runs[index].duration_s)
    return max(range(len(runs)), key=lambda index: float(runs[index].ride.distance[-1]))


def _round_spacing(wanted: float) -> float:
    """The next smaller of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(f * power for f in (1.0, 2.0, 5.0) if f * power <= wanted * (1.0 + 1e-9)))


def _rows(run: Run) -> slice:
    """Rows of the ride's states that belong to a run; for a lap with the states around both crossings."""
    if run.lap is None:
        return slice(0, len(run.ride.states))
    return slice(max(run.lap.first - 1, 0), run.lap.last + 1)


def _arc_lengths(run: Run, scale: float) -> tuple[Flags, Floats]:
    """Which of a run's rows are farther than all before, and their arc lengths, m, scaled by `scale`."""
    progress = run.ride.states.progress
    if not np.isfinite(progress).any():
        progress = run.ride.distance
    place = (progress[_rows(run)] - run.begin_m) * scale
    farthest = np.maximum.accumulate(np.where(np.isfinite(place), place, -np.inf))
    fresh = farthest > np.concatenate([[-np.inf], farthest[:-1]])
    return fresh, place[fresh]


def _sectors(runs: Sequence[Run]) -> tuple[Figures, ...]:
    """Times of the sectors. Laps have their own; for a whole ride it is the time between the sector ends."""
    course = next((run.ride.course for run in runs if run.ride.course is not None), None)
    if course is None or not course.section_names:
        return ()
    closed = any(run.lap is not None for run in runs)
    starts = sector_starts(runs[0].ride) if closed else np.unique(course.section_starts)
    ends = np.append(starts[1:], course.length)
    sections = np.searchsorted(course.section_starts, starts + 1e-6, side="right") - 1
    known_names = dict(enumerate(course.section_names))
    names = [known_names.get(index, f"sector {k}") for k, index in enumerate(sections.tolist(), start=1)]
    times = [_sector_times(run, starts, ends) for run in runs]
    counted = counted_runs(runs)
    found = []
    for name, start, end, row in zip(names, starts, ends, zip(*times, strict=True), strict=True):
        known = {k: t for k, t in enumerate(row) if t is not None and k in counted}
        best = min(known, key=lambda k: known[k], default=None)
        best_s, best_run = (None, None) if best is None else (known[best], runs[best].label)
        ends_m = {"start_m": float(start), "end_m": float(end)}
        found.append(Figures(name=name, **ends_m, times_s=row, best_s=best_s, best_run=best_run))
    return tuple(found)


def _sector_times(run: Run, starts: Floats, ends: Floats) -> list[float | None]:
    """Time of a run in each sector; None for one that it did not complete."""
    if run.lap is not None:
        times: list[float | None] = list(run.lap.sectors_s)
        return times if len(times) == len(starts) else [None] * len(starts)
    progress, time = farther_than_before(run.ride.states.progress, run.ride.time)
    if not len(progress):
        return [None] * len(starts)
    first, last = progress[0] - ON_THE_LINE, progress[-1] + ON_THE_LINE
    spans = np.interp(ends, progress, time) - np.interp(starts, progress, time)
    whole = (starts >= first) & (ends <= last)
    return [float(span) if ridden else None for span, ridden in zip(spans, whole, strict=True)]
