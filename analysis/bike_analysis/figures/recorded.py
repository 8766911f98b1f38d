"""Opening of recordings, and what of them is compared."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from itertools import chain, count
from pathlib import Path

from bike_analysis.figures.compare import Comparison, Run, compare_runs
from bike_analysis.figures.laps import Lap
from bike_analysis.figures.rides import Ride, RideRecording, find_rides
from bike_analysis.read.reading import read_recording


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


Comparable = str | os.PathLike[str] | RideRecording | Ride | Lap
"""Arguments of `compare`."""


def open_ride(path: str | os.PathLike[str], namespace: str | None = None) -> RideRecording:
    """Open a recording.

    Args:
        path: An MCAP file, complete or truncated, or a rosbag2 directory with one.
        namespace: Namespace of the vehicle's topics, where several were recorded.

    Returns:
        The recording with its rides.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If it is not a recording of a ride, or nothing of it can be read.
        OSError: If the file cannot be read.
    """
    recording = read_recording(path, namespace)
    return RideRecording(**vars(recording), rides=find_rides(recording))


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


def comparable(items: Iterable[Comparable]) -> list[Ride | Lap]:
    """Which rides and laps `compare` would compare; see there."""
    given = [open_ride(i) if isinstance(i, str | os.PathLike) else i for i in items]
    flat: list[Ride | Lap] = []
    for item in given:
        flat += item.rides if isinstance(item, RideRecording) else [item]
    if len(flat) == 1 and isinstance(flat[0], Ride) and flat[0].laps:
        return list(flat[0].laps)
    return [(item.best_lap or item) if isinstance(item, Ride) else item for item in flat]


def _runs(items: Iterable[Ride | Lap]) -> list[Run]:
    """The compared runs, with labels that differ."""
    given = list(items)
    rides = [item.ride if isinstance(item, Lap) else item for item in given]
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
        runs[label] = Run(label, ride.evaluated, item if isinstance(item, Lap) else None)
    return list(runs.values())
