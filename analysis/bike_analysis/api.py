"""The analysis as a few functions for notebooks and programs; all else is built on these.

    from bike_analysis import compare, open_ride


    recording = open_ride("ride.mcap")
    for ride in recording.rides:
        print(ride.figures.mean_error_m, [lap.duration_s for lap in ride.laps])
    table = recording.rides[0].table()          # pandas, one row per state, SI units
    both = compare(["a.mcap", "b.mcap"])        # aligned by arc length along the course
    both.table, both.ghosts(), both.best_sectors_s

All numbers are those of every recorded state; nothing is decimated here. Only drawing decimates.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from itertools import chain, count

from bike_analysis.figures.compare import Comparison, Run, compare_runs
from bike_analysis.figures.recorded import RecordedLap, RecordedRide, RideRecording, folder_prefixes
from bike_analysis.read.reading import read_recording

Comparable = str | os.PathLike[str] | RideRecording | RecordedRide | RecordedLap
"""What `compare` takes."""


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
    """What is compared, with labels that differ."""
    given = list(items)
    rides = [item.ride if isinstance(item, RecordedLap) else item for item in given]
    runs: dict[str, Run] = {}
    for item, ride, named in zip(given, rides, _names([r.recording for r in rides]), strict=True):
        name = named + item.label.removeprefix(ride.recording.path.stem)
        labels = chain([name], (f"{name} ({n})" for n in count(2)))
        label = next(label for label in labels if label not in runs)
        lap = item.data if isinstance(item, RecordedLap) else None
        runs[label] = Run(label, ride.recording.path.name, ride.judged, lap, ride.recording.policy)
    return list(runs.values())


def _names(recordings: Sequence[RideRecording]) -> list[str]:
    """What each recording is called: who rode, where each of several has a rider of its own, else its file."""
    riders = {recording.path: recording.policy for recording in recordings}
    if len(riders) > 1 and all(riders.values()) and len(set(riders.values())) == len(riders):
        return [recording.policy for recording in recordings]
    paths = [recording.path for recording in recordings]
    return [prefix + path.stem for prefix, path in zip(folder_prefixes(paths), paths, strict=True)]
