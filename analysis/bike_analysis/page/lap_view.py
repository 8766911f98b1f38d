"""The view of laps on a circuit: each flying lap over arc length, the theoretical lap, g-g diagram, map."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from bike_analysis.figures.lap_recording import LapRecording, Theory
from bike_analysis.figures.numbers import lap_text
from bike_analysis.page.compare_view import comparison_panels
from bike_analysis.page.ride_view import GRAVITY, off_track, ride_columns
from bike_analysis.page.view import KMH, Cloud, MapLine, Panel, PanelLine, Section, Series, View, growing, series_colour
from bike_analysis.read.tables import Floats
from bike_analysis.read.text import shown
from bike_sim.course.lap_timing import Lap

DELTA: Final = Panel(
    *("delta", "Time lost on the theoretical lap", "time lost", "s", (PanelLine("delta", "time lost", "orange"),)),
    caption="Difference of the times at the same place; where it rises, time is lost.",
    least=0.05,
)
ROAD_STEP: Final = 4.0
"""Distance of the road's points in the ride seen from behind, m."""
LABEL_BESIDE: Final = 22.0
"""Distance of a corner's name from the limit, m."""
_SMOOTHING_S: Final = 0.1


def lap_view(laps: LapRecording, theory: Theory, key: str, title: str) -> View:
    """Return the view of recorded laps.

    Args:
        laps: The recording with its timing. Without a flying lap the whole ride is drawn as one.
        theory: The theoretical lap.
        key: Unique name on the page.
        title: For exported pictures.

    Returns:
        Its view. The best flying lap comes first and carries the cursor.
    """
    best = sorted(laps.flying, key=lambda lap: lap.duration)
    limit = theory_columns(laps, theory)
    series = [
        Series(f"lap {lap.number}", lap_columns(laps, lap, limit), series_colour(n)) for n, lap in enumerate(best)
    ]
    if not series:
        series = [Series("ride", lap_columns(laps, None, limit))]
    first = series[0].columns
    series.append(Series("theoretical", limit, "muted", theory=True))
    panels = (_lean_from(panel) for panel in comparison_panels(first, fast=True))
    off = off_track(laps.ride, laps.outside)
    return View(
        key,
        title,
        tuple(series),
        (DELTA, *panels),
        track_lines(laps),
        () if off is None else (off,),
        corner_labels(laps),
        corner_sections(laps, first["distance"]),
        ("speed", "error", "roll", "throttle"),
        "The best flying lap between the limits. Rings are the other laps at the same time since the line.",
        {"speed": KMH},
        gg_cloud([s.columns for s in series]),
        follow_data(laps, best[0] if best else None),
    )


def _lean_from(panel: Panel) -> Panel:
    return replace(panel, caption="Positive leaning right.") if panel.key == "lean" else panel


def lap_columns(laps: LapRecording, lap: Lap | None, limit: dict[str, Floats]) -> dict[str, Floats]:
    """Columns of a lap, over arc length along the centre line; the whole ride if None."""
    rows = slice(0, len(laps.ride.states)) if lap is None else laps.rows(lap)
    columns = ride_columns(laps.ride, rows)
    for name in ("balance", "reached", "age", "command"):
        columns.pop(name, None)
    way = laps.progress[rows]
    columns["distance"] = growing(way - laps.track.length * np.round(way[0] / laps.track.length))
    if lap is not None:
        columns["time"] = growing(laps.time[rows] - lap.began)
        on_time = np.interp(columns["distance"], limit["distance"], limit["time"])
        columns["delta"] = columns["time"] - on_time
    columns["lateral"], columns["along"] = accelerations(laps, rows)
    return columns


def theory_columns(laps: LapRecording, theory: Theory) -> dict[str, Floats]:
    """Columns of the theoretical lap, over arc length along the centre line; lateral positive to the right, in g."""
    step, speed = np.diff(theory.s), theory.speed
    time = np.concatenate([[0.0], np.cumsum(2.0 * step / (speed[:-1] + speed[1:]))])
    return {
        "distance": theory.s * laps.track.length / theory.s[-1],
        "time": time * theory.lap_time / time[-1],
        "speed": 3.6 * speed,
        "lateral": -theory.lateral / GRAVITY,
        "along": theory.longitudinal / GRAVITY,
    }


def accelerations(laps: LapRecording, rows: slice) -> tuple[Floats, Floats]:
    """Lateral (positive to the right) and longitudinal acceleration, g, from speed and yaw, smoothed over 0.1 s."""
    states = laps.ride.states
    time, yaw, speed = laps.time, states.yaw, states.speed  # of the whole ride: a lap has neighbours before and behind
    if len(time) < 2:
        return np.full(len(time[rows]), np.nan), np.full(len(time[rows]), np.nan)
    count = min(max(1, round(_SMOOTHING_S / float(states.control_period[0]))), len(time))
    kernel = np.ones(count) / count

    def smooth(values: Floats) -> Floats:
        smoothed = np.convolve(values, kernel, mode="same") / GRAVITY
        smoothed[: count // 2 + 1] = smoothed[len(smoothed) - count // 2 - 1 :] = np.nan  # the kernel hangs over
        return smoothed

    return smooth(-speed * np.gradient(yaw, time))[rows], smooth(np.gradient(speed, time))[rows]


def gg_cloud(columns: list[dict[str, Floats]]) -> Cloud:
    """The g-g diagram of these columns."""
    x = np.concatenate([c["lateral"] for c in columns])
    y = np.concatenate([c["along"] for c in columns])
    box = (float(np.nanmin(x)), float(np.nanmax(x)), float(np.nanmin(y)), float(np.nanmax(y)))
    return Cloud(
        *("Accelerations (g-g diagram)", "lateral", "along", "lateral in g, right positive", "longitudinal in g", box),
        caption="From the recorded states: speed times yaw rate, and change of speed. The dot is the cursor.",
    )


def track_lines(laps: LapRecording) -> tuple[MapLine, ...]:
    """The limits of the circuit and the line that was followed."""
    track = laps.track
    centre = track.centre
    lines = []
    for name, offset in (("left limit", track.width_left), ("right limit", -track.width_right)):
        edge = track.points(centre.s, offset)
        lines.append(MapLine(name, "limit", edge[:, 0], edge[:, 1]))
    x, y = laps.ride.reference_line()
    return (MapLine("line followed", "wanted", x, y), *lines)


def corner_labels(laps: LapRecording) -> tuple[dict[str, Any], ...]:
    """Name of each corner, outside of it."""
    track = laps.track
    labels = []
    for corner in track.corners:
        side = 1.0 if corner.angle < 0.0 else -1.0
        width = float(track.at(track.width_left if side > 0.0 else track.width_right, corner.apex))
        x, y, _ = track.points(np.array([corner.apex]), side * (width + LABEL_BESIDE))[0]
        labels.append({"x": round(float(x), 2), "y": round(float(y), 2), "text": corner.name})
    return tuple(labels)


def corner_sections(laps: LapRecording, distance: Floats) -> tuple[Section, ...]:
    """Corners as rows of the first series."""
    found = []
    for corner in laps.track.corners:
        first, last = np.searchsorted(distance, [corner.begin, min(corner.end, laps.track.length)])
        last = min(int(last), len(distance) - 1)
        if first < last:
            found.append(Section(corner.name, f"corner {corner.name}", int(first), last, shaded=True))
    return tuple(found)


def follow_data(laps: LapRecording, lap: Lap | None) -> dict[str, Any]:
    """Additional data of the follow view: limits, line and labels."""
    track, course = laps.track, laps.ride.course
    count = round(track.length / ROAD_STEP)
    progress = np.linspace(0.0, track.length, count, endpoint=False)
    line: list[list[float]] = []
    if course is not None and len(course.x):
        rows = np.linspace(0, len(course.x) - 1, count).astype(int)
        line = [_rounded(course.x[rows]), _rounded(course.y[rows])]
    edges = []
    for width, sign in ((track.width_left, 1.0), (track.width_right, -1.0)):
        points = track.points(progress, sign * track.at(width, progress))
        edges += [_rounded(points[:, 0]), _rounded(points[:, 1])]
    return {
        "title": shown(f"{laps.recording.vehicle}, {track.name}"),
        "lapTime": "" if lap is None else lap_text(lap.duration),
        "step": track.length / count,
        "edges": edges,
        "line": line,
    }


def _rounded(values: Floats) -> list[float]:
    return [round(float(value), 1) for value in values]
