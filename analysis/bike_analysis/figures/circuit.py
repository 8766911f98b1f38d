"""Laps on a circuit: corners, the theoretical lap, limits and gears of a machine.

All arc lengths are those of the recorded course, which is the followed line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.figures.laps import has_limits
from bike_analysis.figures.metrics import Figures
from bike_analysis.figures.numbers import rate
from bike_analysis.figures.rides import Ride, RideRecording
from bike_analysis.read.messages import Floats, RecordedCourse
from bike_sim.course.course import Course
from bike_sim.course.files import load_track, shipped_tracks
from bike_sim.course.track import Corner, Track, find_corners
from bike_sim.schema import GRAVITY

_SMOOTHING_S: Final = 0.1
"""Accelerations are means over this time, s."""


@dataclass(frozen=True)
class Machine:
    """Limits and gears of a machine, for reading its telemetry.

    Attributes:
        speeds: m/s, rising.
        lateral: Lateral accelerations of the limit at each speed, m/s^2, positive to the right; shape (n, k). The
            curve is closed: over the driving side from left to right, and back over the braking side.
        along: The longitudinal ones, m/s^2, of the same shape.
        spins: Speeds of the rear wheel, rad/s, rising from 0 in equal steps.
        gears: The gear at each of them, 1 for the first.
        ratios: Turns of the crank for one of the rear wheel, by gear.
    """

    speeds: Floats
    lateral: Floats
    along: Floats
    spins: Floats
    gears: NDArray[np.int64]
    ratios: Floats

    def gear(self, spin: Floats) -> Floats:
        """The gear at speeds of the rear wheel, rad/s; NaN where they are unknown."""
        place = np.rint(np.nan_to_num(spin) / self.spins[1]).astype(int)
        gears = self.gears[np.clip(place, 0, len(self.gears) - 1)].astype(np.float64)
        return np.where(np.isfinite(spin), gears, np.nan)

    def crank_rpm(self, spin: Floats) -> Floats:
        """Speed of the crank at speeds of the rear wheel, rpm, with a closed clutch."""
        gear = self.gear(spin)
        return spin * self.ratios[np.nan_to_num(gear, nan=1.0).astype(int) - 1] * 60.0 / (2.0 * math.pi)


@dataclass(frozen=True)
class Theory:
    """A theoretical lap on the followed line of a circuit.

    Attributes:
        track: The circuit.
        s: Arc length of the line, m, from 0 to its length.
        speed: m/s.
        lateral: Lateral acceleration, m/s^2, positive to the left.
        longitudinal: m/s^2.
        lap_time: s.
        sector_times: s.
        machine: Limits and gears of the machine; None leaves out gear, engine speed and the limit of the g-g diagram.
    """

    track: Track
    s: Floats
    speed: Floats
    lateral: Floats
    longitudinal: Floats
    lap_time: float
    sector_times: tuple[float, ...]
    machine: Machine | None = None


def circuit_figures(recording: RideRecording, theory: Theory) -> dict[str, Any]:
    """Figures of the laps of a recording's first ride on a circuit, ready for JSON. Out-laps do not count as laps."""
    ride, figures = recording.rides[0], recording.rides[0].figures
    flying = [lap for lap in figures.complete_laps if not lap.out_lap]
    best = min(flying, key=lambda lap: lap.lap_s, default=None)
    kinds = [event.kind for event in ride.events]
    return {
        "vehicle": recording.vehicle,
        "course": theory.track.name,
        "laps_s": [lap.lap_s for lap in flying],
        "lap_s": None if best is None else best.lap_s,
        "sectors_s": [] if best is None else best.sectors_s,
        "out_lap_s": next((lap.lap_s for lap in figures.complete_laps if lap.out_lap), None),
        "limit_s": theory.lap_time,
        "limit_sectors_s": list(theory.sector_times),
        "excess": None if best is None else max(lap.lap_s for lap in flying) / theory.lap_time - 1.0,
        "falls": kinds.count("fall"),
        "walls": kinds.count("wall"),
        "valid_laps": sum(lap.valid is True for lap in flying),
        "off_track_s": figures.off_track_s,
        "lost_steps": figures.lost_steps,
    }


def accelerations(ride: Ride, rows: slice) -> tuple[Floats, Floats]:
    """Lateral (positive to the right) and longitudinal acceleration, g, from speed and yaw, smoothed over 0.1 s."""
    states = ride.states  # of the whole ride: a lap has neighbours before and behind
    period = float(states.control_period[0])
    if len(states) < 2 or not period > 0.0:
        return np.full(len(states), np.nan)[rows], np.full(len(states), np.nan)[rows]
    count = min(max(1, round(_SMOOTHING_S / period)), len(states))
    kernel = np.ones(count) / count

    def smooth(values: Floats) -> Floats:
        smoothed = np.convolve(values, kernel, mode="same") / GRAVITY
        smoothed[: count // 2 + 1] = smoothed[len(smoothed) - count // 2 - 1 :] = np.nan  # the kernel hangs over
        return smoothed[rows]

    return smooth(-states.speed * rate(states.yaw, ride.time)), smooth(rate(states.speed, ride.time))


# ---- corners -------------------------------------------------------------------------------------------------------

BRAKING: Final = 5.0
"""Brake from which on a rider counts as braking, %."""
PHASES: Final = ("braking", "entry", "exit", "straight after")
"""Parts of a corner's stretch: up to where it begins, up to its apex, up to its end, and from there on."""


def course_corners(course: RecordedCourse | None, track: Track | None = None) -> tuple[Corner, ...]:
    """Find the corners of a recorded course.

    Args:
        course: The followed line.
        track: Its circuit; by default the shipped one of its name, else corners are found by the line's curvature.

    Returns:
        The corners with arc lengths of the line; none on an open course or one without limits.
    """
    if course is None or not course.closed or not has_limits(course) or len(course.curvature) < 3:
        return ()
    name = course.name.partition(" (")[0]
    if track is None and name in shipped_tracks():
        track = load_track(name)
    if track is None:
        line = (course.s, course.x, course.y, course.heading, course.curvature)
        try:
            return find_corners(Course(course.name, *line, closed=True))
        except ValueError:  # a line that is no circuit
            return ()
    places = np.array([(corner.begin, corner.apex, corner.end) for corner in track.corners]).reshape(-1)
    points = track.points(places)[:, :2]
    rows = [int(np.argmin(np.hypot(course.x - x, course.y - y))) for x, y in points]
    found = []
    for corner, (begin, apex, end) in zip(track.corners, course.s[rows].reshape(-1, 3), strict=True):
        end += course.length if end < begin else 0.0
        found.append(replace(corner, begin=float(begin), apex=float(apex), end=float(end)))
    return tuple(found)


def corner_figures(
    corners: Sequence[Corner], length_m: float, lap: Mapping[str, Floats], reference: Mapping[str, Floats]
) -> tuple[Figures, ...]:
    """Compute the figures of each corner.

    Args:
        corners: In the order of the lap.
        length_m: Length of the circuit.
        lap: Columns of the lap from line to line: ``distance``, m, never falling, ``time``, s, ``speed`` in any unit,
            and where they are known ``roll``, degrees, and ``brake``, %.
        reference: Distance and time of what it is measured against.

    Returns:
        For each ``name``, ``direction``, ``braking_m`` (where braking for it began, from the start line; None if it was
        not braked for), ``before_apex_m``, ``entry_speed``, ``least_speed``, ``exit_speed``, ``lean_deg`` without sign,
        ``lost_s`` over its stretch, which reaches to the middle of the straights before and after it, so that all
        corners make up the lap, negative where time was won; and ``lost_in``, that of `PHASES` in which most was lost,
        empty if nothing was.
    """
    middles = [0.5 * (before.end + after.begin) for before, after in pairwise(corners)]
    bounds = [0.0, *middles, length_m]
    distance, speed = lap["distance"], lap["speed"]
    nothing = np.zeros(len(distance))
    lean, brake = np.abs(lap.get("roll", nothing)), lap.get("brake", nothing)
    found = []
    for corner, (first, last) in zip(corners, pairwise(bounds), strict=True):
        end = min(corner.end, length_m)
        inside = (distance >= corner.begin) & (distance <= end)
        if not inside.any():
            inside[np.argmin(np.abs(distance - corner.apex))] = True
        braking = _braking_point(distance, brake, first, corner.apex)
        losses = [_lost(lap, reference, a, b) for a, b in pairwise((first, corner.begin, corner.apex, end, last))]
        found.append(
            Figures(
                name=corner.name,
                direction=corner.direction,
                braking_m=braking,
                before_apex_m=None if braking is None else corner.apex - braking,
                entry_speed=float(np.interp(corner.begin, distance, speed)),
                least_speed=float(np.min(speed[inside])),
                exit_speed=float(np.interp(end, distance, speed)),
                lean_deg=float(np.max(lean[inside])),
                lost_s=sum(losses),
                lost_in=PHASES[int(np.argmax(losses))] if max(losses) > 0.0 else "",
            )
        )
    return tuple(found)


def _lost(lap: Mapping[str, Floats], reference: Mapping[str, Floats], begin_m: float, end_m: float) -> float:
    """Time lost between two places, s; none where they are in the wrong order, as corners may overlap."""
    if end_m <= begin_m:
        return 0.0
    begins, ends = (np.interp([begin_m, end_m], one["distance"], one["time"]) for one in (lap, reference))
    return float((begins[1] - begins[0]) - (ends[1] - ends[0]))


def _braking_point(distance: Floats, brake: Floats, first_m: float, apex_m: float) -> float | None:
    """Place where the last stretch of braking before the apex began, m; None without any between the two places."""
    rows = np.flatnonzero((distance >= first_m) & (distance <= apex_m) & (brake >= BRAKING))
    if not len(rows):
        return None
    row = int(rows[-1])
    while row > 0 and brake[row - 1] >= BRAKING:
        row -= 1
    return float(distance[row])
