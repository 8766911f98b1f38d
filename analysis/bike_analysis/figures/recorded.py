"""A recording, its rides and its laps, with figures and tables that are computed when they are first needed.

All numbers are those of every recorded state; nothing is decimated here. Only drawing decimates.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count
from pathlib import Path

import pandas as pd

from bike_analysis.figures.compare import Comparison, Run, compare_runs
from bike_analysis.figures.laps import CompleteLap, counted_laps, evaluated_ride, find_laps
from bike_analysis.figures.metrics import Figures, ride_figures, ride_table
from bike_analysis.read.messages import RecordedCourse, RecordedEvent
from bike_analysis.read.reading import Recording, read_recording
from bike_analysis.read.rides import Ride, find_rides


@dataclass(frozen=True, eq=False)
class RecordedRide:
    """One ride of a recording, from a reset to the next.

    Attributes:
        recording: The recording that it is in.
        data: Its typed columns, commands, events and latencies (`bike_analysis.read.rides.Ride`).
    """

    recording: RideRecording
    data: Ride

    def __repr__(self) -> str:
        return f"<RecordedRide {self.label}: {len(self.data.states)} states, {len(self.laps)} laps>"

    @property
    def number(self) -> int:
        """Number in the recording, from 1."""
        return self.data.index

    @property
    def label(self) -> str:
        """Name for people: the file's, and the ride's number where the file has several."""
        name = self.recording.path.stem
        return name if len(self.recording.rides) == 1 else f"{name}, ride {self.number}"

    @property
    def course(self) -> RecordedCourse | None:
        """The followed line with its sections and limits, or None where it was not recorded."""
        return self.data.course

    @property
    def events(self) -> tuple[RecordedEvent, ...]:
        """Falls, walls, laps, sectors and so on, in order."""
        return self.data.events

    @cached_property
    def evaluated(self) -> Ride:
        """The ride up to the finish of an open course: what figures, pages and comparisons are about."""
        return evaluated_ride(self.data)

    @cached_property
    def figures(self) -> Figures:
        """Figures of the whole ride and of its laps."""
        return ride_figures(self.data)

    @cached_property
    def laps(self) -> tuple[RecordedLap, ...]:
        """Complete laps on a closed course, in order."""
        return tuple(RecordedLap(self, lap) for lap in find_laps(self.data))

    @property
    def best_lap(self) -> RecordedLap | None:
        """The fastest complete lap, out-laps not counted where there are others; None without one."""
        counted = counted_laps([lap.data for lap in self.laps])
        return min((lap for lap in self.laps if lap.data in counted), key=lambda lap: lap.duration_s, default=None)

    def table(self) -> pd.DataFrame:
        """The ride as a table, one row per recorded state.

        Returns:
            Columns with units in their names, as `bike_analysis.figures.metrics` says.
        """
        return ride_table(self.data)


@dataclass(frozen=True, eq=False)
class RecordedLap:
    """One complete lap of a ride.

    Attributes:
        ride: The ride that it is in.
        data: When it began and ended, its sectors and its rows (`bike_analysis.figures.laps.Lap`).
    """

    ride: RecordedRide
    data: CompleteLap

    def __repr__(self) -> str:
        return f"<RecordedLap {self.label}: {self.duration_s:.3f} s>"

    @property
    def number(self) -> int:
        """Number in the ride, from 1."""
        return self.data.number

    @property
    def label(self) -> str:
        """Name for people."""
        return f"{self.ride.label}, lap {self.number}"

    @property
    def duration_s(self) -> float:
        """Lap time, s."""
        return self.data.duration_s

    @property
    def sectors_s(self) -> tuple[float, ...]:
        """Times of the sectors, s; empty where the course has none."""
        return self.data.sectors_s

    def table(self) -> pd.DataFrame:
        """The rows of `RecordedRide.table` inside the lap, with ``time_s`` counted from the start line."""
        table = self.ride.table().iloc[self.data.rows].reset_index(drop=True)
        table["time_s"] -= self.data.begin_s
        return table


@dataclass(frozen=True, eq=False)
class RideRecording:
    """An opened recording.

    Attributes:
        data: All that was read (`bike_analysis.read.reading.Recording`).
    """

    data: Recording

    def __repr__(self) -> str:
        return f"<RideRecording {self.path.name}: {len(self.rides)} rides, {len(self.laps)} laps>"

    @property
    def path(self) -> Path:
        """The file."""
        return self.data.path

    @property
    def vehicle(self) -> str:
        """Name of the vehicle; empty where it was not recorded."""
        return self.data.vehicle

    @property
    def policy(self) -> str:
        """Rider, from the recorder's note ``policy``; empty where unknown."""
        return self.data.notes.get("policy", "")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Faults of the recording, one sentence each."""
        return self.data.warnings

    @cached_property
    def rides(self) -> tuple[RecordedRide, ...]:
        """The rides, in order; at least one."""
        return tuple(RecordedRide(self, ride) for ride in find_rides(self.data))

    @property
    def laps(self) -> tuple[RecordedLap, ...]:
        """Complete laps of all rides, in order."""
        return tuple(lap for ride in self.rides for lap in ride.laps)


def folder_prefixes(paths: Sequence[Path]) -> list[str]:
    """Return prefixes that distinguish files of the same name.

    Args:
        paths: Files, in any order; one may come several times.

    Returns:
        For each "", or as few of the last folders as differ between files of its name, with a slash behind.
    """
    whole = {path: path.resolve() for path in dict.fromkeys(paths)}
    folders: dict[str, set[Path]] = {}
    for path in whole.values():
        folders.setdefault(path.stem, set()).add(path.parent)
    depths = {
        name: next(n for n in count() if len({_last(folder, n) for folder in those}) == len(those))
        for name, those in folders.items()
    }
    return [
        "".join(f"{part.strip('/')}/" for part in _last(path.parent, depths[path.stem]))
        for path in map(whole.__getitem__, paths)
    ]


def _last(folder: Path, parts: int) -> tuple[str, ...]:
    return folder.parts[-parts:] if parts else ()


Comparable = str | os.PathLike[str] | RideRecording | RecordedRide | RecordedLap
"""Arguments of `compare`."""


def open_ride(path: str | os.PathLike[str], namespace: str | None = None) -> RideRecording:
    """Open a recording.

    Args:
        path: An MCAP file, complete or truncated, or a rosbag2 directory with one.
        namespace: Namespace of the vehicle's topics, where several were recorded.

    Returns:
        The recording. Rides, laps, figures and tables are computed when they are first needed.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If it is not a recording of a ride, or nothing of it can be read.
        OSError: If the file cannot be read.
    """
    return RideRecording(read_recording(path, namespace))


def compare(items: Iterable[Comparable], station_m: float | None = None) -> Comparison:
    """Put rides and laps side by side.

    Args:
        items: Paths, opened recordings, rides or laps. Of a recording all rides are taken; of a ride with complete laps
            the fastest one, unless only one ride was found in all: then all its laps.
        station_m: Distance of the stations at which they are compared, m; by default about 2500 along the course.

    Returns:
        The comparison.

    Raises:
        ValueError: If nothing was given, the courses differ in length, or `station_m` is not positive.
        FileNotFoundError: If there is no such recording.
        RecordingError: If a file is not a recording of a ride.
    """
    return compare_runs(_runs(comparable(items)), station_m)


def comparable(items: Iterable[Comparable]) -> list[RecordedRide | RecordedLap]:
    """Which rides and laps `compare` would compare; see there."""
    given = [open_ride(i) if isinstance(i, str | os.PathLike) else i for i in items]
    flat: list[RecordedRide | RecordedLap] = []
    for item in given:
        flat += item.rides if isinstance(item, RideRecording) else [item]
    if len(flat) == 1 and isinstance(flat[0], RecordedRide) and flat[0].laps:
        return list(flat[0].laps)
    return [(item.best_lap or item) if isinstance(item, RecordedRide) else item for item in flat]


def _runs(items: Iterable[RecordedRide | RecordedLap]) -> list[Run]:
    """The compared runs, with labels that differ."""
    given = list(items)
    rides = [item.ride if isinstance(item, RecordedLap) else item for item in given]
    runs: dict[str, Run] = {}
    paths = [ride.recording.path for ride in rides]
    riders = {ride.recording.path: ride.recording.policy for ride in rides}
    if len(riders) > 1 and all(riders.values()) and len(set(riders.values())) == len(riders):
        names = [riders[path] for path in paths]  # each recording has a rider of its own
    else:
        names = [prefix + path.stem for prefix, path in zip(folder_prefixes(paths), paths, strict=True)]
    for item, ride, named in zip(given, rides, names, strict=True):
        name = named + item.label.removeprefix(ride.recording.path.stem)
        labels = chain([name], (f"{name} ({n})" for n in count(2)))
        label = next(label for label in labels if label not in runs)
        lap = item.data if isinstance(item, RecordedLap) else None
        runs[label] = Run(label, ride.recording.path.name, ride.evaluated, lap, ride.recording.policy)
    return list(runs.values())
