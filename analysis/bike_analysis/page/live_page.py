"""The page of a running ride: the view of a report page, fed through a WebSocket, with controls to steer the ride."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any, Final

import numpy as np

from bike_analysis.page.html import html_text
from bike_analysis.page.ride_view import BRAKE, ERROR, SPEED, THROTTLE
from bike_analysis.page.shell import page_shell
from bike_analysis.page.view import KMH, MapLine, Panel, PanelLine, Series, View, view_html
from bike_analysis.read.tables import Floats
from bike_analysis.read.text import shown
from bike_sim.course.course import Course

ROAD_POINTS: Final = 1500
"""Most points of each edge of the road in the view from behind."""
PATH_HALF_WIDTH: Final = 1.5
"""Half of the width of the road that is drawn about a path without limits, m."""

_LEAN: Final = Panel(
    *("lean", "Lean and steer", "angle", "°"),
    (PanelLine("steer", "steer δ", "orange"), PanelLine("roll", "lean φ", "blue")),
    caption="Lean is positive to the right, steer to the left.",
)
_COMMAND: Final = Panel(
    *("command", "Steering command", "command", "", (PanelLine("command", "applied", "violet", step=True),)),
    caption="In [−1, 1], positive to the left.",
    ends=(-1.0, 1.0),
)
_KEYS: Final = (
    ("← →", "lean"),
    ("↑ ↓", "throttle, brake"),
    ("space", "pause, go on"),
    (".", "one step while paused"),
    ("r", "from the start again"),
    ("t", "light or dark"),
    ("gamepad", "left stick leans, right trigger is the throttle, left trigger the brake"),
    ("touch", "drag in the two fields below the view: lean, and throttle or brake"),
)


def live_view(course: Course, machine: str, powered: bool) -> View:
    """Return the view of a ride that has not begun.

    Args:
        course: The line that is followed.
        machine: Name of the vehicle.
        powered: Whether it has throttle and brake; its speed is shown in km/h.
    """
    still = np.zeros(2)
    columns = {
        **{name: still for name in ("time", "distance", "yaw", "roll", "steer", "speed", "error", "command")},
        "x": np.full(2, course.x[0]),
        "y": np.full(2, course.y[0]),
        **({"throttle": still, "brake": still} if powered else {}),
    }
    panels = [SPEED, _LEAN, *((THROTTLE, BRAKE) if powered else ()), _COMMAND, ERROR]
    left, right = (_edge(course, side) for side in (1.0, -1.0))
    lines = [MapLine("line followed", "wanted", *_closed(course, course.x, course.y))]
    if course.width_left is not None:
        edges = (("left limit", left), ("right limit", right))
        lines += [MapLine(name, "limit", *_closed(course, *edge)) for name, edge in edges]
    return View(
        "live",
        f"{machine} on {course.name}",
        (Series("live", columns),),
        tuple(_in_kmh(panel) if powered and panel.key == "speed" else panel for panel in panels),
        tuple(lines),
        colours=(),
        map_caption="Where the ride is, and its last half minute.",
        channels={"speed": KMH} if powered else {},
        follow=_follow(course, machine, powered, left, right),
    )


def _in_kmh(panel: Panel) -> Panel:
    return Panel(panel.key, panel.title, panel.label, KMH.unit, panel.lines, zero=True, least=10.0)


def _closed(course: Course, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    return (np.append(x, x[0]), np.append(y, y[0])) if course.closed else (x, y)


def _edge(course: Course, side: float) -> tuple[Floats, Floats]:
    """Edge of the road on the left (1) or on the right (-1)."""
    width = course.width_left if side > 0.0 else course.width_right
    away = side * (np.full(len(course.s), PATH_HALF_WIDTH) if width is None else width)
    return course.x - away * np.sin(course.heading), course.y + away * np.cos(course.heading)


def _follow(
    course: Course, machine: str, powered: bool, left: tuple[Floats, Floats], right: tuple[Floats, Floats]
) -> dict[str, Any]:
    every = max(1, -(-len(course.s) // ROAD_POINTS), round(course_step(powered) / float(course.s[1])))
    return {
        "title": shown(f"{machine}, {course.name}"),
        "lapTime": "",
        "step": float(course.s[1]) * every,
        "edges": [_rounded(edge[::every]) for edge in (*left, *right)],
        "line": [_rounded(course.x[::every]), _rounded(course.y[::every])],
        "open": not course.closed,
        "unit": "km/h" if powered else "m/s",
        "machine": "superbike" if powered else "bicycle",
    }


def course_step(powered: bool) -> float:
    """Distance of the road's points in the view from behind, m."""
    return 4.0 if powered else 1.0


def _rounded(values: Floats) -> list[float]:
    return [round(float(value), 2) for value in values]


def render_live_page(view: View, rider: str, names: Sequence[str], powered: bool, host: str) -> str:
    """Return the page.

    Args:
        view: By `live_view`.
        rider: Name of the computer's rider.
        names: Columns of the states that come through the WebSocket, in order.
        powered: Whether the vehicle has throttle and brake.
        host: Origin of the WebSocket, for the content security policy.
    """
    title = view.title
    scales = {"roll": 180.0 / np.pi, "steer": 180.0 / np.pi, "throttle": 100.0, "brake": 100.0}
    if powered:
        scales["speed"] = 3.6
    spec = {"names": list(names), "scales": scales, "powered": powered}
    parts = [_controls(rider, powered), view_html(view), _pads(powered)]
    below = f'<p class="soft">{html_text(f"rider of the computer: {rider}")} · recorded as it is ridden</p>'
    return page_shell(title, below, parts, [view], connect=host, live=spec, keys=_KEYS)


def _controls(rider: str, powered: bool) -> str:
    paces = "".join(
        f'<option value="{pace}"{" selected" if pace == "1" else ""}>{pace} ×</option>'
        for pace in ("0.1", "0.25", "0.5", "1", "2", "4")
    )
    balance = "" if powered else '<label class="balance"><input type="checkbox" checked> the computer balances</label>'
    return (
        '<div class="live-bar" role="group" aria-label="The ride">'
        '<button type="button" data-live="pause">Pause</button><button type="button" data-live="step">Step</button>'
        '<button type="button" data-live="reset">Restart</button>'
        f'<select aria-label="Pace of the ride">{paces}</select>'
        '<fieldset class="switch"><legend>who rides</legend>'
        f'<label><input type="radio" name="who" value="computer" checked>{escape(rider)}</label>'
        f'<label><input type="radio" name="who" value="hands">you</label></fieldset>{balance}'
        '<p class="now live-state" role="status"></p></div>'
    )


def _pads(powered: bool) -> str:
    drive = '<div class="pad" data-pad="throttle"><span>throttle<br>brake</span></div>' if powered else ""
    return f'<div class="pads"><div class="pad" data-pad="steering"><span>lean</span></div>{drive}</div>'
