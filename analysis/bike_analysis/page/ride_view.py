"""Views of rides and laps: map, and error, lean, speed and command over distance or time; one alone or side by side.

Signs are those of the recording: roll positive leaning right, steer and lateral error positive to the left.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.figures.compare import Comparison
from bike_analysis.figures.laps import beyond_limits, has_limits, lap_range
from bike_analysis.figures.numbers import AIDS, command_ages, grip_used, telemetry_columns
from bike_analysis.page.view import (
    KMH,
    KMH_DIFFERENCE,
    Band,
    Channel,
    MapLine,
    Mark,
    Panel,
    PanelLine,
    Section,
    Series,
    View,
    growing,
    series_colour,
)
from bike_analysis.read.messages import Floats, RecordedCourse
from bike_analysis.read.rides import Ride
from bike_sim.schema import GRAVITY

FAST: Final = 15.0
"""Beyond this speed km/h are shown, m/s."""
OFF_TRACK_POINTS: Final = 400
"""Largest number of markers of positions off the track."""
_KMH: Final = 3.6
ROAD_POINTS: Final = 1500
"""Most points of each edge of the road in the view from behind."""
PATH_HALF_WIDTH: Final = 1.5
"""Half of the width of the road that is drawn about a path without limits, m."""
ROAD_STEPS: Final = {True: 4.0, False: 1.0}
"""Distance of the road's points for machines with and without an engine, m."""

DELTA: Final = Panel(
    *("delta", "Time lost on the reference", "time lost", "s", (PanelLine("delta", "time lost", "orange"),)),
    caption="Difference of the times at the same place to the ride or lap chosen above; where it rises, time is lost.",
    least=0.05,
)
SPEED_DELTA: Final = Panel(
    *("speed_delta", "Speed less that of the reference", "difference", "m/s"),
    (PanelLine("speed_delta", "difference", "green"),),
    least=0.2,
)
ERROR: Final = Panel(
    *("error", "Distance to the path", "to the left", "m", (PanelLine("error", "distance", "blue", fill="area"),)),
    caption="Signed distance of the rear contact point, positive to the left.",
    least=0.02,
)
LEAN: Final = Panel(
    *("lean", "Lean and steer", "angle", "°"),
    (
        PanelLine("balance", "balanced turn", "band", fill="band"),
        PanelLine("steer", "steer δ", "orange"),
        PanelLine("roll", "roll φ", "blue"),
    ),
    caption="Roll is positive leaning right, steer positive to the left. The band is the lean that balances the path's "
    "curvature κ at this speed, −atan(v²κ/g). A short steer to the other side before a turn is counter-steering.",
)
SPEED: Final = Panel("speed", "Speed", "speed", "m/s", (PanelLine("speed", "speed", "green"),), zero=False, least=0.2)
THROTTLE: Final = Panel(
    *("throttle", "Throttle", "throttle", "%", (PanelLine("throttle", "throttle", "green", "area", step=True),)),
    ends=(0.0, 100.0),
    bands=("traction_control", "anti_wheelie"),
)
BRAKE: Final = Panel(
    *("brake", "Brake", "brake", "%", (PanelLine("brake", "brake", "orange", "area", step=True),)),
    ends=(0.0, 100.0),
    bands=("brake_control", "anti_stoppie"),
)
GEAR: Final = Panel("gear", "Gear", "gear", "", (PanelLine("gear", "gear", "violet", step=True),), ends=(0.0, 6.0))
ENGINE: Final = Panel(
    *("engine", "Engine speed", "engine speed", "rpm", (PanelLine("engine", "engine speed", "violet"),)),
    caption="Of the crank, with a closed clutch: from the turning of the rear wheel and the machine's gears.",
    zero=False,
)
TORQUE: Final = Panel(
    *("torque", "Steering torque", "torque", "Nm", (PanelLine("torque", "torque", "gold"),)),
    caption="On the fork about the steering axis, positive to the left.",
)
ROLL_RATE: Final = Panel(
    *("roll_rate", "Lean rate", "lean rate", "°/s", (PanelLine("roll_rate", "lean rate", "blue"),)),
    caption="Positive while leaning further right.",
)


def _wheels(column: str) -> tuple[PanelLine, PanelLine]:
    """A line for the rear wheel, and a dashed one for the front wheel."""
    return PanelLine(f"rear_{column}", "rear", "blue"), PanelLine(f"front_{column}", "front", "orange", dash=True)


SLIP: Final = Panel(
    *("slip", "Longitudinal slip", "slip", "%", _wheels("slip")),
    caption="Positive driving, negative braking.",
    bands=("traction_control", "brake_control"),
)
DRIFT: Final = Panel(
    *("drift", "Slip angle", "slip angle", "°", _wheels("drift")), caption="Positive where the wheel moves to its left."
)
LOAD: Final = Panel("load", "Load", "vertical load", "kN", _wheels("load"))
GRIP: Final = Panel(
    *("grip", "Grip used", "grip used", "%", _wheels("grip")),
    caption="Force of the tyre by the largest that it could have; beyond 100 % it slides, and its slip by that of the "
    "largest force is shown.",
    ends=(0.0, 100.0),
)
COMMAND: Final = Panel(
    *("command", "Steering command", "command", ""),
    (PanelLine("reached", "steer reached", "muted", dash=True), PanelLine("command", "applied", "blue", step=True)),
    caption="Set value in [−1, 1], positive to the left, and the steering angle on the same scale.",
)
AGE: Final = Panel(
    *("age", "Delay of the command", "age", "steps", (PanelLine("age", "age", "violet", "area", step=True),)),
    caption="Control steps between the state that a command answers and the state from which it was applied; 0 means "
    "that the very next step used it.",
    least=1.2,
)


def ride_view(ride: Ride, key: str, title: str) -> View:
    """Return the view of a ride.

    Args:
        ride: A ride.
        key: Unique name on the page.
        title: For exported pictures.

    Returns:
        Its view. What was not recorded is left out.
    """
    columns = ride_columns(ride, slice(0, len(ride.states)))
    fast = is_fast(ride)
    return View(
        key,
        title,
        (Series(ride.course.name if ride.course else "ride", columns),),
        panels_for(columns, fast),
        map_lines(ride),
        ride_marks(ride),
        section_labels(ride.course),
        course_sections(ride, columns["distance"]),
        tuple(name for name in ("error", "speed", "roll", "steer", "throttle") if name in columns),
        "The ridden path over the reference path; the dot is the rear contact point at the cursor.",
        speed_channels(fast),
        bands=aid_bands(ride, slice(0, len(ride.states))),
    )


def comparison_view(comparison: Comparison, key: str) -> View:
    """Return the view of a comparison: traces over distance, time lost, and a ghost for each other run.

    Args:
        comparison: The runs, aligned.
        key: Unique name on the page.

    Returns:
        Its view. The reference comes first and carries the cursor.
    """
    runs = comparison.runs
    order = [comparison.reference, *(i for i in range(len(runs)) if i != comparison.reference)]
    columns = [run_columns(comparison, i) for i in order]
    reference = runs[comparison.reference]
    fast = is_fast(reference.ride)
    series = tuple(
        Series(runs[i].label, c, series_colour(n)) for n, (i, c) in enumerate(zip(order, columns, strict=True))
    )
    return View(
        key,
        f"{comparison.course or 'rides'} side by side",
        series,
        comparison_panels(columns[0], fast),
        map_lines(reference.ride),
        labels=section_labels(reference.ride.course),
        sections=course_sections(reference.ride, columns[0]["distance"], reference.begin_m),
        map_caption="The full dot is the reference, rings are the ghosts of the others at the same time since the "
        "beginning. Buttons above show and hide them.",
        channels=speed_channels(fast),
        bands=aid_bands(reference.ride, reference.rows),
        reference=0,
    )


def comparison_panels(columns: dict[str, Floats], fast: bool) -> tuple[Panel, ...]:
    """Panels of differences, then those with a line a series, or one for each wheel; steer is left out."""
    found = [DELTA, in_kmh(SPEED_DELTA) if fast else SPEED_DELTA]
    for panel in panels_for(columns, fast):
        if panel.key == "lean":
            panel = replace(panel, title="Lean", caption="Positive leaning right.", lines=panel.lines[-1:])
        if panel.key not in ("command", "age"):
            found.append(replace(panel, lines=tuple(replace(line, fill="") for line in panel.lines)))
    return tuple(found)


def run_columns(comparison: Comparison, index: int) -> dict[str, Floats]:
    """Columns of a compared run as pages show them, from its beginning, with distances as those of the reference."""
    run = comparison.runs[index]
    columns = compared(ride_columns(run.ride, run.rows, run.begin_m, run.begin_s))
    return columns | {"distance": comparison.scales[index] * columns["distance"]}


def compared(columns: dict[str, Floats]) -> dict[str, Floats]:
    """Columns that mean something beside those of another ride."""
    return {name: c for name, c in columns.items() if name not in ("steer", "balance", "command", "reached", "age")}


_CONTROLS: Final = (THROTTLE, BRAKE, GEAR, ENGINE, ROLL_RATE, TORQUE, SLIP, DRIFT, LOAD, GRIP)


def is_fast(ride: Ride) -> bool:
    """Whether the ride is one of a motorcycle, by its speed."""
    speed = ride.states.speed
    return bool(np.isfinite(speed).any()) and float(np.nanmax(speed)) > FAST


def speed_channels(fast: bool) -> dict[str, Channel]:
    """The channel of the speed, where it is not the usual one."""
    return {"speed": KMH, "speed_delta": KMH_DIFFERENCE} if fast else {}


def ride_columns(ride: Ride, rows: slice, begin_m: float = 0.0, begin_s: float | None = None) -> dict[str, Floats]:
    """Columns of a part of a ride, as the page shows them.

    Args:
        ride: A ride.
        rows: The part.
        begin_m: Progress that counts as distance 0, m.
        begin_s: Time since the ride's first state that counts as 0, s; that of the first row if None.

    Returns:
        Columns by name (see `bike_analysis.page.view.CHANNELS`); what was not recorded is missing.
    """
    states = ride.states.take(rows)
    time = ride.time[rows]
    known = np.isfinite(states.progress).any()
    place = states.progress - begin_m if known else ride.distance[rows] - ride.distance[rows][0]
    speed = states.speed
    limit = np.where(states.steering_limit > 0.0, states.steering_limit, np.nan)
    columns: dict[str, NDArray[Any]] = {
        "distance": growing(place),
        "time": growing(time - (time[0] if begin_s is None else begin_s)),
        "x": states.x,
        "y": states.y,
        "yaw": states.yaw,
        "error": states.lateral_error,
        "roll": np.degrees(states.roll),
        "steer": np.degrees(states.steer),
        "balance": -np.degrees(np.arctan(speed**2 * states.curvature / GRAVITY)),
        "speed": speed * (_KMH if is_fast(ride) else 1.0),
        "throttle": 100.0 * np.maximum(states.throttle_command, 0.0),
        "brake": 100.0 * np.maximum(-states.throttle_command, 0.0),
        "torque": states.steer_torque,
        "roll_rate": np.degrees(states.roll_rate),
        "command": states.steering_command,
        "reached": states.steer / limit,
        "age": command_ages(ride)[0][rows],
    }
    if not np.any(np.nan_to_num(states.throttle_command)):
        del columns["throttle"], columns["brake"]  # a vehicle without a drive
    columns |= tyre_columns(ride, rows)
    return {name: column for name, column in columns.items() if np.isfinite(column).any()}


def tyre_columns(ride: Ride, rows: slice) -> dict[str, Floats]:
    """Telemetry of both tyres as the page shows it; empty where it was not recorded."""
    telemetry = telemetry_columns(ride, rows)
    columns = {}
    for wheel in ("rear", "front"):
        for name, field, shown_as in (
            ("slip", f"{wheel}_slip", lambda slip: 100.0 * slip),
            ("drift", f"{wheel}_slip_angle_rad", np.degrees),
            ("load", f"{wheel}_load_n", lambda load: 1e-3 * load),
            ("grip", f"{wheel}_slip_use", grip_used),
        ):
            if field in telemetry:
                columns[f"{wheel}_{name}"] = shown_as(telemetry[field])
    return columns


def aid_bands(ride: Ride, rows: slice) -> tuple[Band, ...]:
    """When each rider aid acted, as ranges of the part's rows; aids that never did are left out."""
    telemetry = telemetry_columns(ride, rows)
    bands = []
    for (key, name), colour in zip(AIDS.items(), ("violet", "gold", "rose", "blue"), strict=True):
        acting = np.nan_to_num(telemetry.get(key, np.zeros(0))) > 0.5
        edges = np.flatnonzero(np.diff(acting, prepend=False, append=False))
        if len(edges):
            bands.append(Band(key, name, colour, tuple(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))))
    return tuple(bands)


def in_kmh(panel: Panel) -> Panel:
    """The panel of a speed in km/h."""
    return replace(panel, unit=KMH.unit, least=5.0 * panel.least)


def panels_for(columns: dict[str, Floats], fast: bool) -> tuple[Panel, ...]:
    """The panels of which there is something to draw."""
    speed = in_kmh(SPEED) if fast else SPEED
    order = (
        (ERROR, LEAN, speed, *_CONTROLS, COMMAND, AGE) if fast else (ERROR, LEAN, speed, THROTTLE, BRAKE, COMMAND, AGE)
    )
    kept = []
    for panel in order:
        lines = tuple(line for line in panel.lines if line.column in columns)
        if lines:
            kept.append(replace(panel, lines=lines))
    return tuple(kept)


def map_lines(ride: Ride) -> tuple[MapLine, ...]:
    """The reference path and, where they were recorded, the limits."""
    x, y = ride.reference_line()
    lines = [MapLine("reference path", "reference", x, y)]
    course = ride.course
    if course is not None and has_limits(course):
        heading = np.arctan2(np.gradient(course.y), np.gradient(course.x))
        for name, side, width in (("left limit", 1.0, course.width_left), ("right limit", -1.0, course.width_right)):
            limit = edge(course.x, course.y, heading, side, width)
            lines.append(MapLine(name, "limit", *closed(course.closed, *limit)))
    return tuple(lines)


def closed(ends_where_it_begins: bool, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """A line, with its first point as its last one if it is closed."""
    return (np.append(x, x[0]), np.append(y, y[0])) if ends_where_it_begins else (x, y)


def edge(x: Floats, y: Floats, heading: Floats, side: float, width: Floats | None) -> tuple[Floats, Floats]:
    """Edge of a road on the left (`side` 1) or on the right (-1) of a line; `PATH_HALF_WIDTH` away without limits."""
    away = side * (np.full(len(x), PATH_HALF_WIDTH) if width is None else width)
    return x - away * np.sin(heading), y + away * np.cos(heading)


def follow_spec(
    title: str, step: float, line: Sequence[Floats], edges: Sequence[Floats], powered: bool, **more: Any
) -> dict[str, Any]:
    """Return the data of a view from behind.

    Args:
        title: Above the instruments.
        step: Distance of the road's points, m.
        line: x and y of the followed line; nothing where it is not known.
        edges: x and y of the left edge, then of the right one.
        powered: Whether the machine has an engine: its speed is in km/h.
        more: ``open``, whether the road does not end where it begins, and ``lapTime``, a text.
    """
    every = max(1, -(-len(edges[0]) // ROAD_POINTS), round(ROAD_STEPS[powered] / step))
    return {
        "title": title,
        "lapTime": "",
        "step": step * every,
        "edges": [np.round(values[::every], 2).tolist() for values in edges],
        "line": [np.round(values[::every], 2).tolist() for values in line],
        "open": False,
        "unit": "km/h" if powered else "m/s",
        "machine": "superbike" if powered else "bicycle",
        **more,
    }


def ride_marks(ride: Ride) -> tuple[Mark, ...]:
    """Marks of beginning and end, of faults, and of places where both wheels were beyond the limits."""
    states = ride.states
    marks = [marked("start", "triangle-up", "ink", ride, [0])]
    flags = {"fall": states.fallen, "off_course": states.off_course}
    for kind, name in (("fall", "fall"), ("off_course", "off course"), ("wall", "wall")):
        steps = [event.step for event in ride.events if event.kind == kind]
        rows = np.clip(np.searchsorted(states.step, steps), 0, len(states) - 1).tolist()
        if not rows and kind in flags and flags[kind].any():
            rows = [int(np.argmax(flags[kind]))]
        if rows:
            marks.append(marked(name, "x-thin", "orange", ride, rows))
    if len(marks) == 1:
        marks.append(marked("end", "square", "ink", ride, [len(states) - 1]))
    off = off_track(ride, beyond_limits(states, ride.course))
    return tuple(marks if off is None else [*marks, off])


def off_track(ride: Ride, outside: Floats) -> Mark | None:
    """Mark the positions beyond the limits, where `outside` (m, one value per state) is positive; None without any."""
    rows = np.flatnonzero(outside > 0.0)
    if not len(rows):
        return None
    return marked("off the track", "circle-open", "orange", ride, rows[:: -(-len(rows) // OFF_TRACK_POINTS)].tolist())


def marked(name: str, symbol: str, colour: str, ride: Ride, rows: list[int]) -> Mark:
    """Mark the known positions of some states."""
    x, y = ride.states.x[rows], ride.states.y[rows]
    known = np.isfinite(x) & np.isfinite(y)
    return Mark(name, symbol, colour, x[known].tolist(), y[known].tolist())


def section_labels(course: RecordedCourse | None) -> tuple[dict[str, Any], ...]:
    """Number of each section, to the left of its middle."""
    labels = []
    for number, place, left in section_middles(course):
        assert course is not None
        beside = 0.025 * max(float(np.ptp(course.x)), float(np.ptp(course.y)))
        x, y = place + beside * left
        labels.append({"x": round(float(x), 3), "y": round(float(y), 3), "text": str(number)})
    return tuple(labels)


def section_middles(course: RecordedCourse | None) -> Iterator[tuple[int, Floats, Floats]]:
    """Number of each section with the position of its middle, m, and the direction to the left there."""
    if course is None or len(course.x) < 3 or not course.section_names:
        return
    bounds = np.append(course.section_starts, course.length)
    for number, middle in enumerate(0.5 * (bounds[:-1] + bounds[1:]), start=1):
        at = int(np.clip(np.searchsorted(course.s, middle), 1, len(course.s) - 2))
        dx, dy = course.x[at + 1] - course.x[at - 1], course.y[at + 1] - course.y[at - 1]
        left = np.array([-dy, dx]) / max(float(np.hypot(dx, dy)), 1e-9)
        yield number, np.array([course.x[at], course.y[at]]), left


def course_sections(ride: Ride, distance: Floats, lap_begin: float = 0.0) -> tuple[Section, ...]:
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
                found.append(Section(str(number), course.section_names[number - 1], int(begin), stop))
    return tuple(found)
