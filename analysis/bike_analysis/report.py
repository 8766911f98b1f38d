"""From a recording to its report: figures, page and picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl

from bike_analysis.api import RideRecording
from bike_analysis.metrics import RideFigures, latency_figures, ride_figures
from bike_analysis.page import write_page
from bike_analysis.plots import overview_figure
from bike_analysis.reading import Recording, read_recording
from bike_analysis.rides import Ride, find_rides
from bike_analysis.style import RC

PAGE_NAME: Final = "ride.html"
PICTURE_NAME: Final = "ride.png"


def analyze(
    path: str | os.PathLike[str], out_dir: str | os.PathLike[str] | None = None, *, namespace: str | None = None
) -> dict[str, Any]:
    """Analyze a recording and, where asked, write its report.

    Args:
        path: An MCAP file, whole or torn, or a rosbag2 directory with one.
        out_dir: Where to write ``ride.html`` and ``ride.png``; nothing is written without it. It is created.
        namespace: Namespace of the vehicle's topics, where several were recorded.

    Returns:
        Figures ready for JSON: ``recording``, ``vehicle``, ``truncated``, ``warnings``, ``notes``, ``messages``,
        ``latency_median_s``, ``latency_p99_s``, ``rides`` (one dictionary a ride, see
        `bike_analysis.metrics.RideFigures`), and ``page`` and ``picture`` where they were written.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If the file is not a recording of a ride, or nothing of it can be read.
        OSError: If a file cannot be read or written.
    """
    recording = read_recording(path, namespace)
    rides = find_rides(recording)
    figures = [ride_figures(ride) for ride in rides]
    median, p99 = latency_figures(recording.latencies)
    result: dict[str, Any] = {
        "recording": str(recording.path),
        "vehicle": recording.vehicle or None,
        "truncated": recording.truncated,
        "warnings": list(recording.warnings),
        "notes": recording.notes,
        "messages": recording.message_count,
        "latency_median_s": median,
        "latency_p99_s": p99,
        "rides": [f.as_dict() for f in figures],
    }
    if out_dir is not None:
        page, picture = write_report(recording, rides, figures, Path(out_dir))
        result |= {"page": str(page), "picture": str(picture)}
    return result


def write_report(
    recording: Recording, rides: Sequence[Ride], figures: Sequence[RideFigures], out_dir: Path
) -> tuple[Path, Path]:
    """Write the report page and the picture.

    Args:
        recording: What was read.
        rides: Its rides.
        figures: Their figures, in the same order.
        out_dir: Directory, created if need be.

    Returns:
        Paths of the page and of the picture. The picture shows the ride with the longest way.

    Raises:
        OSError: If a file cannot be written.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    page, picture = out_dir / PAGE_NAME, out_dir / PICTURE_NAME
    write_page([RideRecording(recording)], page)
    longest = max(range(len(rides)), key=lambda i: figures[i].distance_m)
    with mpl.rc_context(RC):
        overview_figure(rides[longest], _headline(figures[longest])).savefig(picture, dpi=160)
    return page, picture


def _headline(f: RideFigures) -> str:
    parts = [f.course or "ride"]
    if f.speed_mean_m_s is not None:
        parts.append(f"{f.speed_mean_m_s:.2f} m/s")
    if f.mean_error_m is not None and f.max_error_m is not None:
        parts.append(f"mean distance {f.mean_error_m:.3f} m, largest {f.max_error_m:.3f} m")
    return " · ".join(parts)
