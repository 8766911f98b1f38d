"""Several rides or laps side by side, aligned by the way along the course.

Each run is put on the same stations: places along the course, a fixed way apart. There the time since the run's begin,
and every column of `bike_analysis.table`, are interpolated between the two recorded states around it. So the difference
of two times at a station is what one run has lost on the other up to there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import pandas as pd

from bike_analysis.laps import ON_THE_LINE, Lap, farther_than_before, sector_starts
from bike_analysis.reading import Floats
from bike_analysis.rides import Ride
from bike_analysis.table import motion_columns, station

STATIONS: Final = 2500
"""About so many stations are wanted along a course."""
MOST_ROWS: Final = 2_000_000
"""Stations or times of one run that are worked out at most."""
SAME_LENGTH: Final = 0.03
"""Courses whose lengths differ by more than this part are not the same."""


class CourseError(ValueError):
    """Rides on different courses were to be compared."""


@dataclass(frozen=True)
class Run:
    """What is compared: a ride, or one lap of it.

    Attributes:
        label: Name for people, unique within a comparison.
        source: The recording's file name.
        ride: The ride.
        lap: The lap, or None for the whole ride.
        policy: Who rode, from the recording's notes; empty where unknown.
    """

    label: str
    source: str
    ride: Ride
    lap: Lap | None = None
    policy: str = ""

    @property
    def duration_s(self) -> float:
        """Lap time, or the time of the whole ride, s."""
        return self.lap.duration_s if self.lap is not None else float(self.ride.time[-1])

    @property
    def complete(self) -> bool:
        """Whether it is a lap, or a ride that reached the end of its course."""
        return self.lap is not None or self.ride.ended_by == "finished"


@dataclass(frozen=True)
class SectorComparison:
    """One sector over all complete laps (or one section of an open course over all runs).

    Attributes:
        name: Of the sector.
        start_m: Where it begins, m.
        end_m: Where it ends, m.
        times_s: Time of each run of the comparison, s; None where a run did not ride it whole.
        best_s: The best of these times, s; None if nobody rode it whole.
        best: Index of the run with the best time, or None.
    """

    name: str
    start_m: float
    end_m: float
    times_s: tuple[float | None, ...]
    best_s: float | None
    best: int | None


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs on the same course, aligned.

    Attributes:
        course: Name of the course; empty where none was recorded.
        runs: What is compared, in the order given.
        reference: Index of the run that the others are measured against: the fastest complete one, else the one that
            came farthest.
        station_m: Stations along the course, m, shape (stations,).
        sectors: Times of the sectors; empty where the course has no sections.
        columns: Names of the aligned columns.
        values: Aligned values by column, shape (runs, stations); NaN where a run was not.
    """

    course: str
    runs: tuple[Run, ...]
    reference: int
    station_m: Floats
    sectors: tuple[SectorComparison, ...]
    columns: tuple[str, ...]
    values: dict[str, Floats]

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(run.label for run in self.runs)} at {len(self.station_m)} stations>"

    def column(self, name: str) -> Floats:
        """One aligned column.

        Args:
            name: ``time_s``, ``delta_s`` or a numeric column of `bike_analysis.table`.

        Returns:
            Shape (runs, stations); NaN where a run was not.

        Raises:
            KeyError: If there is no such column.
        """
        if name not in self.values:
            raise KeyError(f"no aligned column {name!r}; there are {', '.join(self.columns)}")
        return self.values[name]

    @cached_property
    def table(self) -> pd.DataFrame:
        """All runs below each other: ``run``, ``source``, ``ride``, ``lap``, ``station_m``, then the aligned columns.

        One row a run and station; stations at which a run was not are left out.
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
        return pd.DataFrame(names | {name: self.values[name][index][known] for name in self.columns})

    def ghosts(self, period_s: float = 0.1) -> pd.DataFrame:
        """Where each run was at the same time since its begin.

        Args:
            period_s: Time between two positions, s.

        Returns:
            One row a time and run: ``time_s``, ``run``, ``station_m``, ``x_m``, ``y_m``, ``gap_m`` (way ahead of the
            reference, negative behind), ``speed_m_s``. A run that has ended has no more rows.

        Raises:
            ValueError: If the period is not positive.
        """
        if not period_s > 0.0:
            raise ValueError(f"the period of ghosts must be positive, got {period_s!r}")
        if float(np.nanmax(self.values["time_s"], initial=0.0)) / period_s > MOST_ROWS:
            raise ValueError(f"ghosts every {period_s:g} s would be more than {MOST_ROWS}")
        reference = self._over_time(self.reference, "station_m", None)
        parts = []
        for index, run in enumerate(self.runs):
            known = np.isfinite(self.values["time_s"][index])
            if not known.any():
                continue
            time = np.arange(0.0, self.values["time_s"][index][known][-1] + 1e-9, period_s)
            places = {n: self._over_time(index, n, time)[1] for n in ("station_m", "x_m", "y_m", "speed_m_s")}
            ahead = places["station_m"] - np.interp(time, *reference, left=np.nan, right=np.nan)
            parts.append(pd.DataFrame({"time_s": time, "run": run.label, **places, "gap_m": ahead}))
        return pd.concat(parts, ignore_index=True).sort_values(["time_s", "run"], kind="stable", ignore_index=True)

    def _over_time(self, index: int, name: str, time: Floats | None) -> tuple[Floats, Floats]:
        """A column of a run over time: at its stations, or interpolated at given times."""
        clock = self.values["time_s"][index]
        known = np.isfinite(clock)
        values = self.station_m[known] if name == "station_m" else self.values[name][index][known]
        if time is None:
            return clock[known], values
        return time, np.interp(time, clock[known], values)

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
        values = {name: column[kept] for name, column in self.values.items()}
        reference = kept.index(self.reference)
        return replace(self, runs=runs, reference=reference, sectors=_sectors(runs), values=values)

    @property
    def best_sectors_s(self) -> float | None:
        """The theoretical best lap: the sum of the best sectors, s; None unless every sector has one."""
        best = [sector.best_s for sector in self.sectors]
        return float(sum(t for t in best if t is not None)) if best and None not in best else None


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
    lengths = [_length(run) for run in runs]
    names = {run.ride.course.name for run in runs if run.ride.course is not None}
    if max(lengths) > (1.0 + SAME_LENGTH) * min(lengths) and (names or len(runs) == 1):
        told = ", ".join(f"{run.label}: {length:.0f} m" for run, length in zip(runs, lengths, strict=True))
        raise CourseError(f"rides on different courses cannot be aligned ({told})")
    reference = _reference(runs)
    whole = lengths[reference]
    spacing = _round_spacing(whole / STATIONS) if station_m is None else float(station_m)
    if not (spacing > 0.0 and np.isfinite(spacing)):
        raise ValueError(f"the distance of stations must be positive, got {station_m!r} m")
    if whole / spacing > MOST_ROWS:
        raise ValueError(f"stations {spacing:g} m apart on {whole:.0f} m would be more than {MOST_ROWS}")
    stations = np.arange(0.0, whole + 1e-9 * whole, spacing)
    aligned = [_aligned(run, stations, whole / length) for run, length in zip(runs, lengths, strict=True)]
    columns = tuple(dict.fromkeys(name for part in aligned for name in part))
    nothing = np.full(len(stations), np.nan)
    values = {name: np.stack([part.get(name, nothing) for part in aligned]) for name in columns}
    values["delta_s"] = values["time_s"] - values["time_s"][reference]
    ordered = ("time_s", "delta_s", *(name for name in columns if name != "time_s"))
    course = next(iter(sorted(names)), "")
    return Comparison(course, tuple(runs), reference, stations, _sectors(runs), ordered, values)


def _length(run: Run) -> float:
    """Length of a run's course, m; where it is unknown, of the way driven."""
    length = float(run.ride.states.course_length[-1])
    if np.isfinite(length) and length > 0.0:
        return length
    return max(float(np.nanmax(station(run.ride))), 1e-6)


def _reference(runs: Sequence[Run]) -> int:
    complete = [index for index, run in enumerate(runs) if run.complete]
    if complete:
        return min(complete, key=lambda index: runs[index].duration_s)
    return max(range(len(runs)), key=lambda index: float(runs[index].ride.distance[-1]))


def _round_spacing(wanted: float) -> float:
    """The next smaller of 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(f * power for f in (1.0, 2.0, 5.0) if f * power <= wanted * (1.0 + 1e-9)))


def _aligned(run: Run, stations: Floats, scale: float) -> dict[str, Floats]:
    """All numeric columns of a run at the stations; `scale` stretches its own way to that of the reference."""
    ride = run.ride
    begin_m, begin_s, rows = 0.0, 0.0, slice(0, len(ride.states))
    if run.lap is not None:
        begin_m, begin_s = run.lap.begin_m, run.lap.begin_s
        rows = slice(max(run.lap.first - 1, 0), run.lap.last + 1)  # with the states around both crossings
    progress = ride.states.progress if np.isfinite(ride.states.progress).any() else ride.distance
    way = (progress[rows] - begin_m) * scale
    farthest = np.maximum.accumulate(np.where(np.isfinite(way), way, -np.inf))
    fresh = np.append(True, np.diff(farthest) > 0.0) & np.isfinite(way)
    ways = way[fresh]
    found: dict[str, Floats] = {}
    for name, column in {"time_s": ride.time[rows] - begin_s, **motion_columns(ride, rows)}.items():
        values = np.asarray(column, dtype=np.float64)[fresh]
        found[name] = np.interp(stations, ways, values, left=np.nan, right=np.nan)
    if run.lap is not None:
        found["distance_m"] -= found["distance_m"][0]
    return found


def _sectors(runs: Sequence[Run]) -> tuple[SectorComparison, ...]:
    """Times of the sectors. Laps tell their own; of a whole ride it is the time between their ends."""
    course = next((run.ride.course for run in runs if run.ride.course is not None), None)
    if course is None or not course.section_names:
        return ()
    closed = any(run.lap is not None for run in runs)
    starts = sector_starts(runs[0].ride) if closed else np.unique(course.section_starts)
    ends = np.append(starts[1:], course.length)
    names = _sector_names(course.section_names, course.section_starts, starts)
    times = [_sector_times(run, starts, ends) for run in runs]
    found = []
    for name, start, end, row in zip(names, starts, ends, zip(*times, strict=True), strict=True):
        known = {k: t for k, t in enumerate(row) if t is not None}
        best = min(known, key=lambda k: known[k], default=None)
        found.append(SectorComparison(name, float(start), float(end), row, None if best is None else known[best], best))
    return tuple(found)


def _sector_names(names: Sequence[str], given: Floats, starts: Floats) -> list[str]:
    """Name of the section that each start belongs to."""
    index = np.searchsorted(np.asarray(given), starts + 1e-6, side="right") - 1
    return [names[i] if 0 <= i < len(names) else f"sector {k + 1}" for k, i in enumerate(index.tolist())]


def _sector_times(run: Run, starts: Floats, ends: Floats) -> list[float | None]:
    """Time of a run in each sector; None for one that it did not ride whole."""
    if run.lap is not None:
        told: list[float | None] = list(run.lap.sectors_s)
        return told if len(told) == len(starts) else [None] * len(starts)
    progress, time = farther_than_before(run.ride.states.progress, run.ride.time)
    if not len(progress):
        return [None] * len(starts)
    first, last = progress[0] - ON_THE_LINE, progress[-1] + ON_THE_LINE
    spans = np.interp(ends, progress, time) - np.interp(starts, progress, time)
    whole = (starts >= first) & (ends <= last)
    return [float(span) if ridden else None for span, ridden in zip(spans, whole, strict=True)]
