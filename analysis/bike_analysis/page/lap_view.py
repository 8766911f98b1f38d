"""The view of laps on a circuit: each flying lap over arc length, the theoretical lap, g-g diagram, map."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from bike_analysis.figures.lap_recording import LapRecording, Machine, Theory
from bike_analysis.figures.numbers import lap_text, rate, time_shares
from bike_analysis.page.ride_view import (
    aid_bands,
    compared,
    comparison_panels,
    follow_spec,
    map_lines,
    off_track,
    ride_columns,
    speed_channels,
)
from bike_analysis.page.view import (
    KMH,
    Cloud,
    Histogram,
    Limit,
    Section,
    Series,
    View,
    growing,
    series_colour,
)
from bike_analysis.read.messages import Floats
from bike_sim.course.lap_timing import Lap
from bike_sim.schema import GRAVITY

LEAN_BINS: Final = tuple(range(0, 71, 5))
"""Edges of the histogram of lean, degrees."""
GRIP_BINS: Final = tuple(range(0, 121, 10))
"""Edges of the histograms of grip used, %."""
CURVE_SPEED_STEP: Final = 10.0
"""Speeds between which limits of the g-g diagram are not distinguished, km/h."""
ROAD_STEP: Final = 4.0
"""Distance of the road's points in the ride seen from behind, m."""
LABEL_BESIDE: Final = 22.0
"""Least distance of a corner's name from the limit, m."""
LABEL_SHARE: Final = 0.03
"""The same as a part of the circuit's extent: a map is as wide as its page allows."""
_SMOOTHING_S: Final = 0.1
_KMH: Final = 3.6


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
        Series(f"lap {lap.number}", lap_columns(laps, lap, theory.machine), series_colour(n))
        for n, lap in enumerate(best)
    ]
    if not series:
        series = [Series("ride", lap_columns(laps, None, theory.machine))]
    first = series[0].columns
    histograms = lap_histograms(series)
    series.append(Series("theoretical", limit, "muted", theory=True))
    off = off_track(laps.ride, laps.outside)
    bands = aid_bands(laps.ride, laps.rows(best[0]) if best else slice(0, None))
    coloured = "Wider below the path: where an aid acts. " if bands else ""
    return View(
        key,
        title,
        tuple(series),
        tuple(sorted(comparison_panels(first, fast=True), key=lambda panel: panel.key == "error")),
        map_lines(laps.ride),
        () if off is None else (off,),
        corner_labels(laps),
        corner_sections(laps, first["distance"]),
        tuple(name for name in ("speed", "error", "roll", "throttle", "brake", "rear_grip") if name in first),
        f"The best flying lap between the limits. {coloured}Rings are the other laps at the same time since the line.",
        speed_channels(fast=True),
        gg_cloud([s.columns for s in series], theory.machine),
        follow_data(laps, best[0] if best else None),
        bands,
        histograms,
        len(series) - 1,
    )


def lap_columns(laps: LapRecording, lap: Lap | None, machine: Machine | None = None) -> dict[str, Floats]:
    """Columns of a lap, over arc length along the centre line; the whole ride if None."""
    rows = slice(0, len(laps.ride.states)) if lap is None else laps.rows(lap)
    columns = compared(ride_columns(laps.ride, rows))
    place = laps.progress[rows]
    columns["distance"] = growing(place - laps.track.length * np.round(place[0] / laps.track.length))
    if lap is not None:
        columns["time"] = growing(laps.time[rows] - lap.began)
    if machine is not None:
        spin = rate(laps.ride.states.rear_wheel_angle, laps.time)[rows]
        columns |= {"gear": machine.gear(spin), "engine": machine.crank_rpm(spin)}
    columns["lateral"], columns["along"] = accelerations(laps, rows)
    return columns


def theory_columns(laps: LapRecording, theory: Theory) -> dict[str, Floats]:
    """Columns of the theoretical lap, over arc length along the centre line; lateral positive to the right, in g."""
    step, speed = np.diff(theory.s), theory.speed
    time = np.concatenate([[0.0], np.cumsum(2.0 * step / (speed[:-1] + speed[1:]))])
    return {
        "distance": theory.s * laps.track.length / theory.s[-1],
        "time": time * theory.lap_time / time[-1],
        "speed": _KMH * speed,
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


def lap_histograms(series: list[Series]) -> tuple[Histogram, ...]:
    """Distribution of each lap's time over lean and over the used share of its tyres' grip."""
    found = []
    for key, title, label, edges in (
        ("roll", "Lean by time", "lean to either side in °", LEAN_BINS),
        ("rear_grip", "Grip used by time, rear", "grip used in %", GRIP_BINS),
        ("front_grip", "Grip used by time, front", "grip used in %", GRIP_BINS),
    ):
        known = {s.name: s.columns for s in series if key in s.columns}
        if known:
            shares = {name: time_shares(np.abs(c[key]), c["time"], edges) for name, c in known.items()}
            found.append(Histogram(f"{key}-histogram", title, label, tuple(map(float, edges)), shares))
    return tuple(found)


def gg_limit(machine: Machine) -> Limit:
    """Curves of the g-g diagram, every 10 km/h, in g."""
    wanted = np.arange(CURVE_SPEED_STEP, _KMH * machine.speeds[-1], CURVE_SPEED_STEP)
    rows = np.unique(np.abs(_KMH * machine.speeds[:, None] - wanted).argmin(axis=0))
    curves = tuple((_hundredths(machine.lateral[row]), _hundredths(machine.along[row])) for row in rows)
    return Limit(tuple(round(float(_KMH * machine.speeds[row]), 1) for row in rows), KMH.unit, curves)


def _hundredths(accelerations: Floats) -> tuple[float, ...]:
    return tuple(round(float(value), 3) for value in accelerations / GRAVITY)


def gg_cloud(columns: list[dict[str, Floats]], machine: Machine | None = None) -> Cloud:
    """The g-g diagram of these columns, with the machine's limits where they are known."""
    x = np.concatenate([c["lateral"] for c in columns])
    y = np.concatenate([c["along"] for c in columns])
    box = (float(np.nanmin(x)), float(np.nanmax(x)), float(np.nanmin(y)), float(np.nanmax(y)))
    return Cloud(
        *("Accelerations (g-g diagram)", "lateral", "along", "lateral in g, right positive", "longitudinal in g", box),
        caption="From the recorded states: speed times yaw rate, and change of speed. The dot is the cursor; the "
        "dashed curve is what the machine can do at this speed on level ground, by its tyres, engine and brakes.",
        limit=None if machine is None else gg_limit(machine),
    )


def corner_labels(laps: LapRecording) -> tuple[dict[str, Any], ...]:
    """Name of each corner beside the track: outside of the corner, or where it is farthest from any part of it."""
    track = laps.track
    road = np.concatenate([track.points(track.centre.s, w)[:, :2] for w in (track.width_left, -track.width_right)])
    beside = max(LABEL_BESIDE, LABEL_SHARE * float(np.ptp(road, axis=0).max()))
    labels = []
    for corner in track.corners:
        places = []
        for side in (1.0, -1.0) if corner.angle < 0.0 else (-1.0, 1.0):
            width = float(track.at(track.width_left if side > 0.0 else track.width_right, corner.apex))
            places.append(track.points(np.array([corner.apex]), side * (width + beside))[0][:2])
        room = [float(np.hypot(*(road - place).T).min()) for place in places]
        x, y = places[0] if room[0] > 0.8 * beside else places[int(np.argmax(room))]
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
    """Additional data of the view from behind: limits, line and labels."""
    track, course = laps.track, laps.ride.course
    count = round(track.length / ROAD_STEP)
    progress = np.linspace(0.0, track.length, count, endpoint=False)
    rows = np.linspace(0, len(course.x) - 1, count).astype(int) if course is not None and len(course.x) else None
    line = [] if course is None or rows is None else [course.x[rows], course.y[rows]]
    widths = ((track.width_left, 1.0), (track.width_right, -1.0))
    edges = np.concatenate([track.points(progress, sign * track.at(w, progress))[:, :2].T for w, sign in widths])
    title = f"{laps.recording.vehicle}, {track.name}"
    time = "" if lap is None else lap_text(lap.duration)
    return follow_spec(title, track.length / count, line, list(edges), powered=True, lapTime=time)
