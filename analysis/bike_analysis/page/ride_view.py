"""Views of rides and laps: map, view from behind, and channels over distance or time; one alone or side by side.

Signs are those of the recording: roll positive leaning right, steer and lateral error positive to the left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np

from bike_analysis.figures.circuit import Machine, Theory, accelerations, course_corners
from bike_analysis.figures.compare import Comparison, counted_runs
from bike_analysis.figures.laps import beyond_limits, has_limits, lap_range
from bike_analysis.figures.numbers import (
    AIDS,
    command_ages,
    grip_columns,
    grip_used,
    lap_text,
    rate,
    telemetry_columns,
    time_shares,
)
from bike_analysis.figures.rides import Ride
from bike_analysis.page.view import (
    CHANNELS,
    FAST_CHANNELS,
    PANELS,
    Drawn,
    MapLine,
    Series,
    View,
    factor,
    growing,
    series_colour,
)
from bike_analysis.read.messages import Floats, RecordedCourse
from bike_sim.course.course import Course
from bike_sim.course.track import Corner
from bike_sim.schema import BIKE_STATE, GRAVITY, SUSPENSION, TELEMETRY

FAST: Final = 15.0
"""Beyond this speed km/h are shown, m/s."""
OFF_TRACK_POINTS: Final = 400
"""Largest number of markers of positions off the track."""
ROAD_POINTS: Final = 1500
"""Most points of each edge of the road in the view from behind."""
PATH_HALF_WIDTH: Final = 1.5
"""Half of the width of the road that is drawn about a path without limits, m."""
ROAD_STEPS: Final = {True: 4.0, False: 1.0}
"""Distance of the road's points for machines with and without an engine, m."""
CURVE_SPEED_STEP: Final = 10.0
"""Speeds between which limits of the g-g diagram are not distinguished, km/h."""
LABEL_DISTANCE: Final = 22.0
"""Least distance of a corner's number from the limit, m."""
LABEL_SHARE: Final = 0.03
"""The same as a part of the circuit's extent: a map is as wide as its page allows."""
_HISTOGRAMS: Final = (
    ("roll", "Lean by time", "lean to either side in °", tuple(range(0, 71, 5))),
    ("rear_grip", "Grip used by time, rear", "grip used in %", tuple(range(0, 121, 10))),
    ("front_grip", "Grip used by time, front", "grip used in %", tuple(range(0, 121, 10))),
    ("shock_speed", "Damper speed by time, rear", "mm/s, bump positive", tuple(range(-200, 201, 25))),
    ("fork_speed", "Damper speed by time, fork", "mm/s, bump positive", tuple(range(-200, 201, 25))),
)
"""Column, title, axis and edges of the bins; sizes count where these do not go below zero."""


_OF_MOTORCYCLES: Final = (
    *("gear", "engine", "roll_rate", "torque", "slip", "drift", "load", "grip", "road_grip", "travel", "damper"),
    *("pitch", "twist", "chain"),
)
"""Panels of motorcycles."""
_ALONE: Final = ("steer", "balance", "command", "reached", "age")
"""Columns that mean nothing beside those of another ride."""


def ride_view(ride: Ride, key: str, title: str) -> View:
    """Return the view of a ride.

    Args:
        ride: A ride.
        key: Unique name on the page.
        title: For exported pictures.

    Returns:
        Its view. What was not recorded is left out.
    """
    rows, fast = slice(0, len(ride.states)), is_fast(ride)
    columns = ride_columns(ride, rows, fast)
    corners = course_corners(ride.course)
    faults, off = ride_faults(ride), off_track(ride, beyond_limits(ride.states, ride.course))
    ends = [marked(name, "x-thin", "orange", ride, at) for name, at in faults.items()]
    ends = ends or [marked("end", "square", "ink", ride, [len(ride.states) - 1])]
    return View(
        key,
        title,
        (Series(ride.course.name if ride.course else "ride", columns),),
        panels_for(columns, fast),
        map_lines(ride),
        (marked("start", "triangle-up", "ink", ride, [0]), *ends, *([off] if off else [])),
        corner_labels(ride.course, corners) or section_labels(ride.course),
        course_sections(ride, columns["distance"]),
        tuple(name for name in ("error", "speed", "roll", "steer", "throttle") if name in columns),
        "The ridden path over the desired path; the dot is the rear contact point at the cursor.",
        FAST_CHANNELS if fast else {},
        gg_cloud([columns]) if fast else None,
        follow_spec(ride, title, fast),
        aid_bands(ride, rows),
        moments=tuple({"series": 0, "row": row, "label": name} for name, rows in faults.items() for row in rows),
    )


def comparison_view(comparison: Comparison, key: str, theory: Theory | None = None) -> View:
    """Return the view of a comparison: traces over distance, variance, and a ghost for each other run.

    Args:
        comparison: The runs, aligned. Out-laps are not drawn where there are others.
        key: Unique name on the page.
        theory: The theoretical lap; None without one.

    Returns:
        Its view. The reference comes first and carries the cursor.
    """
    runs, drawn = comparison.runs, counted_runs(comparison.runs)
    order = sorted(drawn, key=lambda i: (i != comparison.reference, not runs[i].complete, runs[i].duration_s))
    reference = runs[comparison.reference]
    ride, fast = reference.ride, is_fast(reference.ride)
    machine = theory.machine if theory is not None else None
    columns = [run_columns(comparison, i, fast, machine) for i in order]
    names = comparison.short_labels
    series = [
        Series(names[i], c, series_colour(n), kind=runs[i].kind)
        for n, (i, c) in enumerate(zip(order, columns, strict=True))
    ]
    if theory is not None:
        series.append(Series("theoretical", theory_columns(comparison, theory), "muted", theory=True))
    corners = course_corners(ride.course, theory.track if theory is not None else None)
    sections = course_sections(ride, columns[0]["distance"], reference.begin_m)
    off = off_track(ride, beyond_limits(ride.states, ride.course))
    bands = aid_bands(ride, reference.rows)
    coloured = tuple(n for n in ("speed", "error", "roll", "throttle", "brake", "rear_grip") if n in columns[0])
    lap_time = lap_text(reference.duration_s) if reference.lap is not None else ""
    return View(
        key,
        comparison.title,
        tuple(series),
        panels_for(columns[0], fast, compared=True),
        map_lines(ride),
        () if off is None else (off,),
        corner_labels(ride.course, corners) or section_labels(ride.course),
        corner_sections(corners, columns[0]["distance"]) or sections,
        coloured if theory is not None else (),
        "The full dot is the reference, rings are the ghosts of the others at the same time since the beginning. "
        "Buttons above show and hide them." + (" Wider below the path: where an aid acts." if bands else ""),
        FAST_CHANNELS if fast else {},
        gg_cloud([s.columns for s in series if "lateral" in s.columns], machine) if fast else None,
        follow_spec(ride, comparison.title, fast, lap_time),
        bands,
        histograms(series[: len(order)]) if fast else (),
        tuple(
            {"series": n, "row": row - runs[i].rows.start, "label": name}
            for n, i in enumerate(order)
            for name, rows in ride_faults(runs[i].ride).items()
            for row in rows
            if runs[i].rows.start <= row < runs[i].rows.stop
        ),
        len(series) - 1 if theory is not None else 0,
    )


def panels_for(columns: Mapping[str, Floats], fast: bool, compared: bool = False) -> tuple[Drawn, ...]:
    """The panels of which there is something to draw.

    Args:
        columns: Of the first series.
        fast: Whether it is a motorcycle's.
        compared: Whether other series are beside it: speed and differences come first, and areas are lines.
    """
    order = [panel for key, panel in PANELS.items() if fast or key not in _OF_MOTORCYCLES]
    if compared:
        lean = {"title": "Lean", "caption": "Positive leaning right.", "lines": PANELS["lean"]["lines"][-1:]}
        first = [PANELS["speed"], PANELS["delta"], PANELS["speed_delta"], PANELS["lean"] | lean]
        others = ("error", "command", "age", *(panel["key"] for panel in first))
        order = [*first, *(panel for panel in order if panel["key"] not in others), PANELS["error"]]
    else:
        order = order[2:]  # without differences
    kept = []
    for panel in order:
        lines = [
            line | ({"fill": ""} if compared else {})
            for line in panel["lines"]
            if line["column"] in columns or panel["key"] in ("delta", "speed_delta")
        ]
        if lines:
            speeds = fast and lines[0]["column"] in FAST_CHANNELS
            kept.append(panel | {"lines": lines, "least": 5.0 * panel["least"] if speeds else panel["least"]})
    return tuple(kept)


def is_fast(ride: Ride) -> bool:
    """Whether the ride is one of a motorcycle, by its speed."""
    speed = ride.states.speed
    return bool(np.isfinite(speed).any()) and float(np.nanmax(speed)) > FAST


# ---- columns -------------------------------------------------------------------------------------------------------


def ride_columns(
    ride: Ride,
    rows: slice,
    fast: bool,
    begin_m: float = 0.0,
    begin_s: float | None = None,
    machine: Machine | None = None,
) -> dict[str, Floats]:
    """Columns of a part of a ride, as the page shows them.

    Args:
        ride: A ride.
        rows: The part.
        fast: Whether speeds are in km/h, and accelerations are shown.
        begin_m: Progress that counts as distance 0, m.
        begin_s: Time since the ride's first state that counts as 0, s; that of the first row if None.
        machine: For gear and engine speed; None leaves them out.

    Returns:
        Columns by name (see `bike_analysis.page.view.CHANNELS`); what was not recorded is missing.
    """
    states, telemetry = ride.states.take(rows), telemetry_columns(ride, rows)
    time, driven = ride.time[rows], states.throttle_command
    known = np.isfinite(states.progress).any()
    place = states.progress - begin_m if known else ride.distance[rows] - ride.distance[rows][0]
    limit = np.where(states.steering_limit > 0.0, states.steering_limit, np.nan)
    columns: dict[str, Floats] = {
        "distance": growing(place),
        "time": growing(time - (time[0] if begin_s is None else begin_s)),
        "balance": -np.degrees(np.arctan(states.speed**2 * states.curvature / GRAVITY)),
        "reached": states.steer / limit,
        "age": command_ages(ride)[0][rows],
    }
    for name, channel in (CHANNELS | (FAST_CHANNELS if fast else {})).items():
        if channel.source in states.values:
            schema = SUSPENSION if channel.source in SUSPENSION.names else BIKE_STATE
            columns[name] = factor(channel, schema[channel.source]) * states.values[channel.source]
        elif channel.source in TELEMETRY.names and TELEMETRY[channel.source].column in telemetry:
            quantity = TELEMETRY[channel.source]
            columns[name] = factor(channel, quantity) * telemetry[quantity.column]
    if np.any(np.nan_to_num(driven)):  # else a vehicle without a drive
        columns |= {"throttle": 100.0 * np.maximum(driven, 0.0), "brake": 100.0 * np.maximum(-driven, 0.0)}
    for wheel in ("rear", "front"):
        if f"{wheel}_slip_use" in telemetry:
            columns[f"{wheel}_grip"] = grip_used(telemetry[f"{wheel}_slip_use"])
    columns |= grip_columns(ride, rows)
    if "fork_travel" not in columns:
        columns.pop("pitch", None)
    if fast:
        columns["lateral"], columns["along"] = accelerations(ride, rows)
    if machine is not None:
        spin = rate(ride.states.rear_wheel_angle, ride.time)[rows]
        columns |= {"gear": machine.gear(spin), "engine": machine.crank_rpm(spin)}
    return {name: column for name, column in columns.items() if np.isfinite(column).any()}


def run_columns(comparison: Comparison, index: int, fast: bool, machine: Machine | None = None) -> dict[str, Floats]:
    """Columns of a compared run as pages show them, from its beginning, with distances as those of the reference."""
    run = comparison.runs[index]
    columns = ride_columns(run.ride, run.rows, fast, run.begin_m, run.begin_s, machine)
    kept = {name: column for name, column in columns.items() if name not in _ALONE}
    return kept | {"distance": comparison.scales[index] * columns["distance"]}


def theory_columns(comparison: Comparison, theory: Theory) -> dict[str, Floats]:
    """Columns of the theoretical lap, over arc length as that of the reference; lateral positive to the right, in g."""
    course = comparison.runs[comparison.reference].ride.course
    step, speed = np.diff(theory.s), theory.speed
    time = np.concatenate([[0.0], np.cumsum(2.0 * step / (speed[:-1] + speed[1:]))])
    return {
        "distance": theory.s * (course.length if course is not None else theory.s[-1]) / theory.s[-1],
        "time": time * theory.lap_time / time[-1],
        "speed": 3.6 * speed,
        "lateral": -theory.lateral / GRAVITY,
        "along": theory.longitudinal / GRAVITY,
    }


def aid_bands(ride: Ride, rows: slice) -> tuple[Drawn, ...]:
    """When each rider aid acted, as ranges of the part's rows; aids that never did are left out."""
    telemetry = telemetry_columns(ride, rows)
    bands = []
    for number, (key, name) in enumerate(AIDS.items(), start=1):
        acting = np.nan_to_num(telemetry.get(key, np.zeros(0))) > 0.5
        edges = np.flatnonzero(np.diff(acting, prepend=False, append=False))
        if len(edges):
            ranges = tuple(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
            bands.append({"key": key, "name": name, "colour": f"aid{number}", "rows": ranges})
    return tuple(bands)


def histograms(series: Sequence[Series]) -> tuple[Drawn, ...]:
    """Distribution of each lap's time over lean, the used share of its tyres' grip, and the dampers' speed."""
    found = []
    for key, title, label, edges in _HISTOGRAMS:
        known = {s.name: s.columns for s in series if key in s.columns}
        if known:
            sizes = {name: c[key] if edges[0] < 0 else np.abs(c[key]) for name, c in known.items()}
            shares = {name: time_shares(sizes[name], c["time"], edges) for name, c in known.items()}
            histogram = {"key": f"{key}-histogram", "title": title, "label": label, "caption": ""}
            found.append(histogram | {"edges": tuple(map(float, edges)), "shares": shares})
    return tuple(found)


def gg_cloud(columns: Sequence[Mapping[str, Floats]], machine: Machine | None = None) -> Drawn | None:
    """The g-g diagram of these columns, with the machine's limits where they are known; None without any."""
    if not columns or any("lateral" not in c for c in columns):
        return None
    x, y = (np.concatenate([c[name] for c in columns]) for name in ("lateral", "along"))
    box = (float(np.nanmin(x)), float(np.nanmax(x)), float(np.nanmin(y)), float(np.nanmax(y)))
    limited, limit = "", None
    if machine is not None:
        limited = " The dashed curve is what the machine can do at this speed on level ground."
        speeds = 3.6 * machine.speeds
        wanted = np.arange(CURVE_SPEED_STEP, speeds[-1], CURVE_SPEED_STEP)
        rows = np.unique(np.abs(speeds[:, None] - wanted).argmin(axis=0))
        curves = np.round(np.stack([machine.lateral[rows], machine.along[rows]], axis=1) / GRAVITY, 3)
        limit = {"speeds": np.round(speeds[rows], 1).tolist(), "unit": "km/h", "curves": curves.tolist()}
    return {
        "title": "Accelerations (g-g diagram)",
        **{"x": "lateral", "y": "along", "x_label": "lateral in g, right positive", "y_label": "longitudinal in g"},
        "box": box,
        "caption": "From the recorded states: speed times yaw rate, and change of speed. The dot is the cursor."
        + limited,
        "limit": limit,
    }


# ---- map and road --------------------------------------------------------------------------------------------------


def map_lines(ride: Ride) -> tuple[MapLine, ...]:
    """The desired path and, where they were recorded, the limits."""
    return MapLine("desired path", "reference", *ride.reference_line()), *limit_lines(ride.course)


def limit_lines(course: RecordedCourse | Course | None) -> list[MapLine]:
    """The limits to the left and to the right of a course; none without them."""
    if course is None or not has_limits(course):
        return []
    sides = (("left limit", 1.0), ("right limit", -1.0))
    return [MapLine(name, "limit", *closed(course, *edge(course, side))) for name, side in sides]


def closed(course: RecordedCourse | Course, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """A line along a course, with its first point as its last one if it is closed."""
    return (np.append(x, x[0]), np.append(y, y[0])) if course.closed else (x, y)


def edge(course: RecordedCourse | Course, side: float, beyond: float = 0.0) -> tuple[Floats, Floats]:
    """Edge of a road on the left (`side` 1) or on the right (-1) of a course, m; without limits `PATH_HALF_WIDTH` away.

    Args:
        course: With the line.
        side: Of it.
        beyond: Farther out, m.
    """
    width: Any = PATH_HALF_WIDTH
    if has_limits(course):
        width = course.width_left if side > 0.0 else course.width_right
    away = side * (width + beyond)
    return course.x - away * np.sin(course.heading), course.y + away * np.cos(course.heading)


def follow_spec(ride: Ride, title: str, powered: bool, lap_time: str = "") -> Drawn | None:
    """Return the data of a view from behind; None where course or motion is not known."""
    course, states = ride.course, ride.states
    if course is None or len(course.x) < 3 or not course.s[1] > 0.0:
        return None
    motion = (states.x, states.y, states.yaw, states.roll, states.speed, states.progress)
    if not all(np.isfinite(column).any() for column in motion):
        return None
    return road_spec(title, course, powered, lap_time)


def road_spec(title: str, course: RecordedCourse | Course, powered: bool, lap_time: str = "") -> Drawn:
    """Return the data of a road that is seen from behind a vehicle.

    Args:
        title: Above the instruments.
        course: With the followed line.
        powered: Whether the machine has an engine: its speed is in km/h.
        lap_time: Below the title.
    """
    step = float(course.s[1])
    every = max(1, -(-len(course.x) // ROAD_POINTS), round(ROAD_STEPS[powered] / step))
    edges = (*edge(course, 1.0), *edge(course, -1.0))
    return {
        "title": title,
        "lapTime": lap_time,
        "step": step * every,
        "edges": [np.round(values[::every], 2).tolist() for values in edges],
        "line": [np.round(values[::every], 2).tolist() for values in (course.x, course.y)],
        "open": not course.closed,
        "unit": "km/h" if powered else "m/s",
        "machine": "superbike" if powered else "bicycle",
    }


def ride_faults(ride: Ride) -> dict[str, list[int]]:
    """Rows of falls, of leaving the course and of walls, by name; from events, else from the states' flags."""
    states, found = ride.states, {}
    flags = {"fall": states.fallen, "off_course": states.off_course}
    for kind, name in (("fall", "fall"), ("off_course", "off course"), ("wall", "wall")):
        steps = [event.step for event in ride.events if event.kind == kind]
        rows = np.clip(np.searchsorted(states.step, steps), 0, len(states) - 1).tolist()
        if not rows and kind in flags and flags[kind].any():
            rows = [int(np.argmax(flags[kind]))]
        if rows:
            found[name] = rows
    return found


def off_track(ride: Ride, outside: Floats) -> Drawn | None:
    """Mark the positions beyond the limits, where `outside` (m, one value per state) is positive; None without any."""
    rows = np.flatnonzero(outside > 0.0)
    if not len(rows):
        return None
    return marked("off the track", "circle-open", "orange", ride, rows[:: -(-len(rows) // OFF_TRACK_POINTS)].tolist())


def marked(name: str, symbol: str, colour: str, ride: Ride, rows: list[int]) -> Drawn:
    """Mark the known positions of some states."""
    x, y = ride.states.x[rows], ride.states.y[rows]
    known = np.isfinite(x) & np.isfinite(y)
    return {"name": name, "symbol": symbol, "colour": colour, "x": x[known].tolist(), "y": y[known].tolist()}


def section_labels(course: RecordedCourse | None) -> tuple[Drawn, ...]:
    """Number of each section, to the left of its middle."""
    if course is None or len(course.x) < 3 or not course.section_names:
        return ()
    bounds = np.append(course.section_starts, course.length)
    rows = np.clip(np.searchsorted(course.s, 0.5 * (bounds[:-1] + bounds[1:])), 1, len(course.s) - 2)
    beside = 0.025 * max(float(np.ptp(course.x)), float(np.ptp(course.y)))
    dx, dy = course.x[rows + 1] - course.x[rows - 1], course.y[rows + 1] - course.y[rows - 1]
    share = beside / np.maximum(np.hypot(dx, dy), 1e-9)
    places = np.round(np.stack([course.x[rows] - share * dy, course.y[rows] + share * dx], axis=1), 3).tolist()
    return tuple({"x": x, "y": y, "text": str(number)} for number, (x, y) in enumerate(places, start=1))


def course_sections(ride: Ride, distance: Floats, lap_begin: float = 0.0) -> tuple[Drawn, ...]:
    """Sections of the course as rows of the ride; a closed course repeats them every lap.

    Args:
        ride: A ride.
        distance: Its distance as the view has it, m.
        lap_begin: Progress at the distance 0, m.

    Returns:
        The sections, in order; those that were not come by are missing.
    """
    course = ride.course
    if course is None or not course.section_names or not len(distance):
        return ()
    first, last = float(distance[0]) + lap_begin, float(distance[-1]) + lap_begin
    laps = lap_range(first, last, course.length) if course.closed else range(1)
    found = []
    for lap in laps:
        bounds = np.append(course.section_starts, course.length) + lap * course.length - lap_begin
        for number, (begin, end) in enumerate(pairwise(np.searchsorted(distance, bounds)), start=1):
            stop = int(min(end, len(distance) - 1))
            if begin < stop:
                name, ends = course.section_names[number - 1], {"first": int(begin), "last": stop}
                found.append({"label": str(number), "name": name, **ends, "shaded": False})
    return tuple(found)


def corner_labels(course: RecordedCourse | None, corners: Sequence[Corner]) -> tuple[Drawn, ...]:
    """Number of each corner beside the track: outside of the corner, or where it is farthest from any part of it."""
    if course is None or not corners:
        return ()
    road = np.concatenate([np.stack(edge(course, side), 1) for side in (1.0, -1.0)])
    beside = max(LABEL_DISTANCE, LABEL_SHARE * float(np.ptp(road, axis=0).max()))
    outside = {side: edge(course, side, beside) for side in (1.0, -1.0)}
    labels = []
    for corner in corners:
        row = int(np.clip(np.searchsorted(course.s, corner.apex), 0, len(course.s) - 1))
        places = [np.array([c[row] for c in outside[side]]) for side in (-np.sign(corner.angle), np.sign(corner.angle))]
        gaps = [float(np.hypot(*(road - place).T).min()) for place in places]
        x, y = places[0] if gaps[0] > 0.8 * beside else places[int(np.argmax(gaps))]
        labels.append({"x": round(float(x), 2), "y": round(float(y), 2), "text": corner.name})
    return tuple(labels)


def corner_sections(corners: Sequence[Corner], distance: Floats) -> tuple[Drawn, ...]:
    """Corners as rows of the first series."""
    found = []
    for corner in corners:
        first, last = np.searchsorted(distance, [corner.begin, corner.end])
        last = min(int(last), len(distance) - 1)
        if first < last:
            ends = {"first": int(first), "last": last}
            found.append({"label": corner.name, "name": f"corner {corner.name}", **ends, "shaded": True})
    return tuple(found)
