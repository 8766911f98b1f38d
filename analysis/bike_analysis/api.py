"""The analysis as a few functions for notebooks and programs; all else is built on these.

    from bike_analysis import compare, open_ride

    recording = open_ride("ride.mcap")
    for ride in recording.rides:
        print(ride.figures.mean_error_m, [lap.duration_s for lap in ride.laps])
    table = recording.rides[0].table()          # pandas, one row a state, SI units
    both = compare(["a.mcap", "b.mcap"])        # aligned by the way along the course
    both.table, both.ghosts(), both.best_sectors_s

All numbers are those of every recorded state; nothing is thinned out here. Whoever draws thins out.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count
from pathlib import Path

import pandas as pd

from bike_analysis.compare import Comparison, Run, compare_runs
from bike_analysis.laps import Lap, find_laps
from bike_analysis.metrics import RideFigures, ride_figures
from bike_analysis.reading import Course, Event, Recording, read_recording
from bike_analysis.rides import Ride, find_rides
from bike_analysis.table import ride_table


@dataclass(frozen=True, eq=False)
class RecordedRide:
    """One ride of a recording, from a reset to the next.

    Attributes:
        recording: The recording that it is in.
        data: Its typed columns, commands, events and latencies (`bike_analysis.rides.Ride`).
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
    def course(self) -> Course | None:
        """The followed line with its sections and limits, or None where it was not recorded."""
        return self.data.course

    @property
    def events(self) -> tuple[Event, ...]:
        """Falls, walls, laps, sectors and so on, in order."""
        return self.data.events

    @cached_property
    def figures(self) -> RideFigures:
        """Figures of the whole ride and of its laps."""
        return ride_figures(self.data)

    @cached_property
    def laps(self) -> tuple[RecordedLap, ...]:
        """Complete laps on a closed course, in order."""
        return tuple(RecordedLap(self, lap) for lap in find_laps(self.data))

    @property
    def best_lap(self) -> RecordedLap | None:
        """The fastest complete lap, or None."""
        return min(self.laps, key=lambda lap: lap.duration_s, default=None)

    def table(self) -> pd.DataFrame:
        """The ride as a table, one row a recorded state.

        Returns:
            Columns with units in their names, as `bike_analysis.table` says.
        """
        return ride_table(self.data)


@dataclass(frozen=True, eq=False)
class RecordedLap:
    """One complete lap of a ride.

    Attributes:
        ride: The ride that it is in.
        data: When it began and ended, its sectors and its rows (`bike_analysis.laps.Lap`).
    """

    ride: RecordedRide
    data: Lap

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
        data: All that was read (`bike_analysis.reading.Recording`).
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
        """Who rode, from the recorder's note ``policy``; empty where unknown."""
        return self.data.notes.get("policy", "")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was missing or wrong, a sentence each."""
        return self.data.warnings

    @cached_property
    def rides(self) -> tuple[RecordedRide, ...]:
        """The rides, in order; at least one."""
        return tuple(RecordedRide(self, ride) for ride in find_rides(self.data))

    @property
    def laps(self) -> tuple[RecordedLap, ...]:
        """Complete laps of all rides, in order."""
        return tuple(lap for ride in self.rides for lap in ride.laps)


Comparable = str | os.PathLike[str] | RideRecording | RecordedRide | RecordedLap
"""What `compare` takes."""


def open_ride(path: str | os.PathLike[str], namespace: str | None = None) -> RideRecording:
    """Open a recording.

    Args:
        path: An MCAP file, whole or torn, or a rosbag2 directory with one.
        namespace: Namespace of the vehicle's topics, where several were recorded.

    Returns:
        The recording. Rides, laps, figures and tables are worked out when they are first asked for.

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
    """What is compared, with labels that differ."""
    given = list(items)
    rides = [item.ride if isinstance(item, RecordedLap) else item for item in given]
    runs: dict[str, Run] = {}
    for item, ride, prefix in zip(given, rides, folder_prefixes([r.recording.path for r in rides]), strict=True):
        name = prefix + item.label
        labels = chain([name], (f"{name} ({n})" for n in count(2)))
        label = next(label for label in labels if label not in runs)
        lap = item.data if isinstance(item, RecordedLap) else None
        runs[label] = Run(label, ride.recording.path.name, ride.data, lap, ride.recording.policy)
    return list(runs.values())


def folder_prefixes(paths: Sequence[Path]) -> list[str]:
    """Say what to put before the names of files so that those of one name can be told apart.

    Args:
        paths: Files, in any order; one may come several times.

    Returns:
        For each "", or as few of the last folders as differ between files of its name, with a slash behind.
    """
    whole = {path: path.resolve() for path in dict.fromkeys(paths)}
    folders: dict[str, set[Path]] = {}
    for path in whole.values():
        folders.setdefault(path.stem, set()).add(path.parent)
    depths = {name: _depth(those) for name, those in folders.items()}
    return [
        "".join(f"{part.strip('/')}/" for part in _last(path.parent, depths[path.stem]))
        for path in map(whole.__getitem__, paths)
    ]


def _depth(folders: Set[Path]) -> int:
    """How many of the last parts tell folders apart."""
    return next(n for n in count() if len({_last(folder, n) for folder in folders}) == len(folders))


def _last(folder: Path, parts: int) -> tuple[str, ...]:
    return folder.parts[-parts:] if parts else ()
