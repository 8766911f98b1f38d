"""From recordings to their report: figures, comparisons, page, video and tables."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import pandas as pd

from bike_analysis.figures.circuit import Theory, circuit_figures
from bike_analysis.figures.compare import Comparison, CourseError
from bike_analysis.figures.laps import Lap
from bike_analysis.figures.recorded import comparable, compare, open_ride
from bike_analysis.figures.results import comparison_figures, finite, recording_figures, ride_entry
from bike_analysis.figures.rides import Ride, RideRecording
from bike_analysis.formats.motec import write_ld
from bike_analysis.page.ride_page import write_page
from bike_analysis.page.video import write_video
from bike_analysis.read.container import METADATA_FILE, RecordingError, find_files

PAGE_NAME: Final = "ride.html"
LAP_PAGE_NAME: Final = "lap.html"
DRAWN_RUNS: Final = 8
"""Rides or laps that are drawn side by side: the fastest ones. Figures and tables have all of them."""


@dataclass(frozen=True)
class Video:
    """A moving picture: its file, where in the ride it begins, s, and how long it lasts, s (None: to the end)."""

    path: Path
    begin_s: float = 0.0
    duration_s: float | None = None


Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


def analyze(
    paths: Paths,
    out_dir: str | os.PathLike[str] | None = None,
    *,
    namespace: str | None = None,
    csv: str | os.PathLike[str] | None = None,
    parquet: str | os.PathLike[str] | None = None,
    station_m: float | None = None,
    video: Video | None = None,
    ld: Path | None = None,
) -> dict[str, Any]:
    """Analyze recordings and, where asked, write their report and tables.

    Args:
        paths: One or more MCAP files, complete or truncated, or rosbag2 directories.
        out_dir: Where to write ``ride.html``; nothing is written without it. It is created.
        namespace: Namespace of the vehicle's topics, where several were recorded.
        csv: File for the aligned table as CSV.
        parquet: File for the same as Parquet.
        station_m: Distance of the stations of the aligned table, m; by default about 2500 along the course.
        video: Moving picture of the longest ride, and of other vehicles of its recording.
        ld: File for the longest ride as a log of MoTeC i2, with its laps in the ``.ldx`` file beside it.

    Returns:
        Figures ready for JSON, see docs/reference/analysis.md. A recording that cannot be read becomes a
        warning where others can.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If none of the files is a recording of a ride that can be read.
        ValueError: If `station_m` is not positive, a file to be written is one of the recordings, or a video cannot be
            made of the longest ride.
        OSError: If a file cannot be read or written.
    """
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    page = None if out_dir is None else Path(out_dir) / PAGE_NAME
    keep_recordings(given, [Path(path) for path in (page, csv, parquet, video and video.path, ld) if path])
    recordings, unread = _open_all(given, namespace)
    warnings = [text if len(recordings) == 1 else f"{r.path}: {text}" for r in recordings for text in r.warnings]
    comparisons, incomparable = _comparisons(recordings, station_m)
    several = [c for c in comparisons if len(c.runs) > 1]
    rides = [ride for recording in recordings for ride in recording.rides]
    figures = {
        "recordings": [recording_figures(recording) for recording in recordings],
        "rides": [ride_entry(ride) for ride in rides],
        "comparisons": [comparison_figures(comparison) for comparison in several],
        "truncated": any(recording.truncated for recording in recordings),
        "warnings": [*unread, *warnings, *incomparable],
    }
    if page is not None:
        page.parent.mkdir(parents=True, exist_ok=True)
        largest = max(several, key=lambda c: len(c.runs), default=None)
        figures["page"] = str(write_page(recordings, page, None if largest is None else largest.fastest(DRAWN_RUNS)))
    if csv is not None:
        figures["csv"] = str(write_table(comparisons, csv))
    if parquet is not None:
        figures["parquet"] = str(write_table(comparisons, parquet, parquet=True))
    longest = max(rides, key=lambda ride: ride.figures.distance_m)
    if ld is not None:
        figures["ld"] = str(write_ld(longest, ld))
    if video is not None:
        beside = _others(longest)
        figures["video"] = str(write_video(longest, video.path, video.begin_s, video.duration_s, beside))
    plain: dict[str, Any] = finite(figures)
    return plain


def _others(ride: Ride) -> list[Ride]:
    """Return the rides that other vehicles of the same recording made at the same time, as in a race."""
    recording, found = ride.recording, []
    begin, end = ride.states.time_s[[0, -1]]
    for topic in recording.topics:
        if topic.endswith("/state") and topic != f"{recording.namespace or ''}/state":
            with suppress(RecordingError):  # a topic of that name with other messages
                other = open_ride(recording.path, topic.removesuffix("/state") or "/")
                found += [r for r in other.rides if r.states.time_s[0] < end and r.states.time_s[-1] > begin]
    return found


def analyze_laps(path: str | os.PathLike[str], theory: Theory, out_dir: Path | None = None) -> dict[str, Any]:
    """Analyze laps on a circuit beside the theoretical one, and write their page.

    Args:
        path: The recording; its first ride counts.
        theory: The theoretical lap of the circuit that was ridden.
        out_dir: Where to write ``lap.html``; nothing is written without it. It is created.

    Returns:
        Figures ready for JSON, see `bike_analysis.figures.circuit.circuit_figures`; with ``page`` where it was written.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If it is not a recording.
        OSError: If the page cannot be written.
    """
    recording = open_ride(path)
    ride, figures = recording.rides[0], circuit_figures(recording, theory)
    if out_dir is not None:
        out_dir.mkdir(parents=True, exist_ok=True)
        laps = compare(ride.laps or [ride])
        figures["page"] = str(write_page([recording], out_dir / LAP_PAGE_NAME, laps, theory))
    return figures


def keep_recordings(recordings: Sequence[str | os.PathLike[str]], written: Sequence[Path]) -> None:
    """See that no recording is overwritten, whatever name or link it is called by.

    Raises:
        ValueError: Naming the first file that would be.
    """
    kept: list[Path] = []
    for recording in map(Path, recordings):
        kept += [recording, recording / METADATA_FILE, *recording.glob("*.mcap")]
        with suppress(RecordingError, OSError):  # reported when it is opened
            kept += find_files(recording)
    for target in written:
        if target.exists() and any(file.exists() and target.samefile(file) for file in kept):
            raise ValueError(f"{target} is one of the recordings: it would be overwritten")


def _open_all(
    paths: Sequence[str | os.PathLike[str]], namespace: str | None
) -> tuple[list[RideRecording], tuple[str, ...]]:
    """Open recordings; those that cannot be read become sentences, unless none can.

    Raises:
        RecordingError, OSError: That of the first file, if no file can be read.
    """
    opened: list[RideRecording] = []
    failures: list[RecordingError | OSError] = []
    for path in paths:
        try:
            recording = open_ride(path, namespace)
            for ride in recording.rides:
                _ = ride.figures  # computed here, so that a failure concerns this file alone
            opened.append(recording)
        except (RecordingError, OSError) as error:
            failures.append(error)
        except ValueError as error:  # impossible numbers
            failures.append(RecordingError(f"{path}: its figures cannot be worked out ({error})"))
    if not opened:
        raise failures[0] if failures else RecordingError("no recording was given")
    return opened, tuple(f"left out: {error}" for error in failures)


def _comparisons(recordings: Sequence[RideRecording], station_m: float | None) -> tuple[list[Comparison], list[str]]:
    """Compare rides on the same course; sentences for those that cannot be compared.

    Raises:
        ValueError: If `station_m` is not positive.
    """
    groups: dict[str, list[Ride | Lap]] = {}
    for item in comparable(recordings):
        course = item.ride.course if isinstance(item, Lap) else item.course
        groups.setdefault(course.name if course is not None else "", []).append(item)
    found, incomparable = [], []
    for items in groups.values():
        try:
            found.append(compare(items, station_m))
        except CourseError as error:
            incomparable.append(f"no comparison: {error}")
    return found, incomparable


def write_table(comparisons: Sequence[Comparison], path: str | os.PathLike[str], parquet: bool = False) -> Path:
    """Write the aligned tables of comparisons below each other, with the name of the ``course`` in front.

    Args:
        comparisons: At least one.
        path: The file; its folder is created.
        parquet: As Parquet, in full precision; else as CSV: a line of names, commas, points, ten digits, empty where a
            value is not known.

    Raises:
        ModuleNotFoundError: If Parquet is wanted and pyarrow is not installed.
        OSError: If the file cannot be written.
    """
    if parquet and find_spec("pyarrow") is None:
        raise ModuleNotFoundError("Parquet files need pyarrow: pip install pyarrow", name="pyarrow")
    parts = [comparison.table.copy(deep=False) for comparison in comparisons]
    for part, comparison in zip(parts, comparisons, strict=True):
        part.insert(0, "course", comparison.course)
    table, target = pd.concat(parts, ignore_index=True), Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    if parquet:
        table.to_parquet(target, index=False, compression="zstd")
    else:
        table.to_csv(target, index=False, float_format="%.10g", errors="backslashreplace")
    return target
