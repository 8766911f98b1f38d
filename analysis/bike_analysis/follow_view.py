"""A ride seen from behind, as a small animation on the report page: drawn on a canvas from the recording alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.lap_timing import Lap

if TYPE_CHECKING:
    from bike_analysis.lap_report import LapRecording

FRAME_TIME: Final = 0.04
"""Simulated time between two stored frames, s; the animation interpolates between them."""

EDGE_STEP: Final = 4.0
"""Distance of the road's stored points, m."""

_SCRIPT: Final = Path(__file__).with_name("follow_view.js")


def follow_view(laps: LapRecording, lap: Lap | None) -> str:
    """Return the animation as HTML: a canvas, its controls, data and script.

    Args:
        laps: The recording.
        lap: The lap to show; the whole ride if None.
    """
    data = json.dumps(follow_data(laps, lap), separators=(",", ":"))
    script = _SCRIPT.read_text(encoding="utf-8")
    return (
        '<div class="follow"><canvas id="follow" width="960" height="540" role="img" '
        'aria-label="The ride seen from behind" style="width:100%;height:auto;display:block;border-radius:.5rem">'
        '</canvas><p style="display:flex;gap:.8rem;align-items:center">'
        '<button id="follow-play" type="button">pause</button>'
        '<input id="follow-time" type="range" min="0" max="1" step="0.0001" value="0" style="flex:1" '
        'aria-label="time"><select id="follow-rate" aria-label="rate"><option value="0.25">¼ ×</option>'
        '<option value="1" selected>1 ×</option><option value="4">4 ×</option></select></p></div>'
        f'<script type="application/json" id="follow-data">{data}</script><script>{script}</script>'
    )


def follow_data(laps: LapRecording, lap: Lap | None) -> dict[str, Any]:
    """Return what the animation draws: frames of the lap, the road's edges and the line, rounded."""
    states, track = laps.ride.states, laps.track
    rows = slice(0, len(states)) if lap is None else laps.rows(lap)
    every = max(1, round(FRAME_TIME / float(states.control_period[0])))
    take = np.arange(rows.start, rows.stop, every)
    count = round(track.length / EDGE_STEP)
    progress = np.linspace(0.0, track.length, count, endpoint=False)
    course = laps.ride.course
    line: list[list[float]] = []
    if course is not None and len(course.x):
        steps = np.linspace(0, len(course.x) - 1, count).astype(int)
        line = [_rounded(course.x[steps], 1), _rounded(course.y[steps], 1)]
    edges = []
    for width, sign in ((track.width_left, 1.0), (track.width_right, -1.0)):
        points = track.points(progress, sign * track.at(width, progress))
        edges += [_rounded(points[:, 0], 1), _rounded(points[:, 1], 1)]
    return {
        "title": f"{laps.recording.vehicle}, {track.name}",
        "dt": every * float(states.control_period[0]),
        "t0": 0.0 if lap is None else float(laps.time[rows.start] - lap.began),
        "lap": None if lap is None else lap.duration,
        "x": _rounded(states.x[take], 2),
        "y": _rounded(states.y[take], 2),
        "yaw": _rounded(states.yaw[take], 4),
        "roll": _rounded(states.roll[take], 4),
        "steer": _rounded(states.steer[take], 4),
        "speed": _rounded(states.speed[take], 2),
        "throttle": _rounded(states.throttle_command[take], 3),
        "progress": _rounded(np.mod(laps.progress[take], track.length), 1),
        "step": track.length / count,
        "edges": edges,
        "line": line,
    }


def _rounded(values: NDArray[np.float64], digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]
