"""The page of a running ride: the view of a report page, fed through a WebSocket, with controls to steer the ride."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Final

import numpy as np

from bike_analysis.figures.compare import Comparison
from bike_analysis.page.document import html_text, page_shell, program_version
from bike_analysis.page.ride_view import (
    closed,
    is_fast,
    limit_lines,
    road_spec,
    run_columns,
)
from bike_analysis.page.view import FAST_CHANNELS, PANELS, MapLine, Series, View, series_colour, view_html
from bike_analysis.read.container import MAX_SENTENCE
from bike_sim.course.course import Course

_LEAN: Final = {"lines": PANELS["lean"]["lines"][1:], "caption": "Lean is positive to the right, steer to the left."}
_COMMAND: Final = {
    "lines": PANELS["command"]["lines"][1:],
    "caption": "In [−1, 1], positive to the left.",
    "ends": (-1.0, 1.0),
}
_MOVING: Final = ("time", "distance", "yaw", "roll", "steer", "speed", "error", "command")
_DRIVEN: Final = ("throttle", "brake", "rear_slip", "front_slip", "rear_load", "front_load")
"""Columns of a vehicle with throttle and brake."""
_GHOST_WORDS: Final = (
    " The ring is the ghost, at the same time since the beginning.",
    " The ring is the ghost, at the same time since the beginning of the lap.",
)
_SHOWN: Final = (*_MOVING, *_DRIVEN, "x", "y")
_STEER_KEYS: Final = (("← →", "lean"), ("↑ ↓", "throttle, brake"), (".", "one step while paused"))
_KEYS: Final = (("space", "pause, go on"), ("r", "from the start again"), ("t", "light or dark"))
_OTHER_HANDS: Final = (
    ("gamepad", "left stick leans, right trigger is the throttle, left trigger the brake"),
    ("touch", "drag in the two fields beside the map: lean, and throttle or brake"),
)


Ghost = tuple[Series, bool]
"""A recorded ride or lap that rides along: columns that count from its beginning, and whether each lap begins it."""


def ghost_of(comparison: Comparison, course: Course) -> Ghost | None:
    """Return the fastest of compared runs as a ghost, or None where it was ridden on another course.

    Args:
        comparison: Of recordings.
        course: The line that the live ride follows.
    """
    run = comparison.runs[comparison.reference]
    if comparison.course != course.name or run.ride.course is None:
        return None
    columns = run_columns(comparison, comparison.reference, is_fast(run.ride))
    shown = {name: column for name, column in columns.items() if name in _SHOWN}
    return Series(run.label, shown, series_colour(1)), run.lap is not None


def live_view(
    course: Course, machine: str, powered: bool, ghost: Ghost | None = None, others: Sequence[str] = ()
) -> View:
    """Return the view of a ride that has not begun.

    Args:
        course: The line that is followed.
        machine: Name of the vehicle.
        powered: Whether it has throttle and brake; its speed is shown in km/h.
        ghost: Who rides along, on the map and in the traces.
        others: Names of the other machines of a race; there is no ghost then.
    """
    still = np.zeros(2)
    columns = {
        **{name: still for name in _MOVING},
        "x": np.full(2, course.x[0]),
        "y": np.full(2, course.y[0]),
        **({name: still for name in _DRIVEN} if powered else {}),
    }
    speed = PANELS["speed"] | ({"zero": True, "least": 10.0} if powered else {})
    keys = ("throttle", "brake", "slip", "load") if powered else ()
    driven = (PANELS[key] | {"folded": False} for key in keys)
    panels = (speed, PANELS["lean"] | _LEAN, *driven, PANELS["command"] | _COMMAND, PANELS["error"])
    path = MapLine("desired path", "reference", *closed(course, course.x, course.y))
    return View(
        "live",
        f"{machine} on {course.name}",
        (
            Series("you" if others else "this ride", columns),
            *(ghost[:1] if ghost else ()),
            *(Series(name, dict(columns), series_colour(number)) for number, name in enumerate(others, start=1)),
        ),
        panels,
        (path, *limit_lines(course)),
        colours=(),
        map_caption="Where the ride is, and its last half minute." + (_GHOST_WORDS[ghost[1]] if ghost else ""),
        channels=FAST_CHANNELS if powered else {},
        follow=road_spec(f"{machine}, {course.name}", course, powered),
    )


def render_live_page(
    view: View,
    rider: str | None,
    names: Sequence[str],
    powered: bool,
    host: str,
    words: Sequence[str] = (),
    laps: bool = False,
    others: Sequence[str] = (),
) -> str:
    """Return the page.

    Args:
        view: By `live_view`.
        rider: Name of the computer's rider; None where somebody else's ride is watched: the page cannot steer it then,
            and has no controls but pause and restart.
        names: Columns of the states that come through the WebSocket, in order.
        powered: Whether the vehicle has throttle and brake.
        host: Origin of the WebSocket, for the content security policy.
        words: Said below the title, after the rider if there is one.
        laps: Whether the view's ghost begins again with each lap.
        others: Columns of the states of the other machines that come with each state, in order.
    """
    title = view.title
    scales = {"roll": 180.0 / np.pi, "steer": 180.0 / np.pi, "throttle": 100.0, "brake": 100.0}
    if powered:
        scales |= {"speed": 3.6, "rear_slip": 100.0, "front_slip": 100.0, "rear_load": 1e-3, "front_load": 1e-3}
    steers = rider is not None
    spec = {"names": list(names), "scales": scales, "powered": powered, "watched": not steers, "ghostLaps": laps}
    spec |= {"others": list(others)}
    parts = [_controls(rider, powered), view_html(view, _pads(powered) if steers else ())]
    facts = [f"rider of the computer: {rider}", "recorded as it is ridden"] if rider is not None else []
    below = html_text(" · ".join([*facts, *words, f"page by {program_version()}"]), MAX_SENTENCE)
    keys = (*_STEER_KEYS, *_KEYS, *_OTHER_HANDS) if steers else _KEYS
    return page_shell(title, f'<p class="soft">{below}</p>', parts, [view], connect=host, live=spec, keys=keys)


def _controls(rider: str | None, powered: bool) -> str:
    """Return the buttons; with pace and who rides where the page steers."""
    pause = '<button type="button" data-live="pause">Pause</button>'
    reset = '<button type="button" data-live="reset">Restart</button>'
    step = hands = ""
    if rider is not None:
        step = '<button type="button" data-live="step">Step</button>'
        paces = "".join(
            f'<option value="{pace}"{" selected" if pace == "1" else ""}>{pace} ×</option>'
            for pace in ("0.1", "0.25", "0.5", "1", "2", "4")
        )
        hands = (
            f'<select aria-label="Pace of the ride">{paces}</select>'
            '<fieldset class="switch"><legend>who rides</legend>'
            f'<label><input type="radio" name="who" value="computer" checked>{escape(rider)}</label>'
            '<label><input type="radio" name="who" value="hands">you</label></fieldset>'
        )
        if not powered:
            hands += '<label class="balance"><input type="checkbox" checked> the computer balances</label>'
    return (
        f'<div class="live-bar" role="group" aria-label="The ride">{pause}{step}{reset}{hands}'
        '<p class="now live-state" role="status"></p></div>'
    )


def _pads(powered: bool) -> tuple[str, str]:
    """Return the touch pads to the left and to the right of the map."""
    drive = '<div class="pad" data-pad="throttle"><span>throttle<br>brake</span></div>' if powered else ""
    return '<div class="pad" data-pad="steering"><span>lean</span></div>', drive
