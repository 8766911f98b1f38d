"""The frame that all pages share: one HTML file that needs no network, in light and dark, for desk and phone.

It holds style, script, uPlot and the content security policy that blocks all network requests; and the words below the
title, by which a ride was computed and recorded.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from typing import Any, Final

import numpy as np

from bike_analysis.page.html import html_text, script_json
from bike_analysis.page.style import style_variables
from bike_analysis.page.view import View
from bike_analysis.read.container import LONGEST_SENTENCE
from bike_analysis.read.messages import Simulation
from bike_analysis.read.reading import Recording

SHORT: Final = 60
"""Most characters of a note that stands in a line with others, as a policy's name; a whole task has more."""
_SCRIPTS: Final = ("chart.js", "parts.js", "follow.js", "view.js")
_PROGRAM: Final = "two-wheeler-lab"
_LIVE_SCRIPT: Final = "live.js"
_POLICY: Final = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
_KEYS: Final = (
    ("← →", "move the cursor; with shift ten times as far"),
    ("Home End", "to the beginning, to the end (with the focus on a plot)"),
    ("+ −", "zoom about the cursor"),
    ("0", "the whole ride"),
    ("p", "play, pause"),
    ("t", "light or dark"),
    ("mouse", "drag a stretch to zoom into it, double-click for all; shift-drag pans; control and wheel zoom"),
    ("fingers", "one moves the cursor, two zoom and pan"),
)


def page_shell(
    title: str,
    below: str,
    parts: Iterable[str],
    views: Sequence[View],
    *,
    connect: str = "",
    live: dict[str, Any] | None = None,
    keys: Sequence[tuple[str, str]] = _KEYS,
) -> str:
    """Put a page together.

    Args:
        title: Headline.
        below: HTML under it.
        parts: HTML of the page, with the frames of the views (`bike_analysis.page.view.view_html`) in their order.
        views: Views that the script draws into them; a page without any is small.
        connect: The only origin that the page may connect to; none if empty.
        live: Data of a page that shows a running ride in its first view.
        keys: Keys and gestures with what they do.

    Returns:
        The whole page.
    """
    data = script_json([view.data() for view in views])
    listed = "".join(f"<dt>{_kbd(key)}</dt><dd>{escape(text)}</dd>" for key, text in keys)
    policy = f"{_POLICY}; connect-src {escape(connect, quote=True)}" if connect else _POLICY
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">',
            f"<title>{html_text(title)}</title><style>{page_style()}</style></head><body><main>",
            f"<header><h1>{html_text(title)}</h1>",
            f'<button id="theme" type="button" aria-label="Dark colours">Dark</button>{below}</header>',
            f"<details><summary>Keys and gestures</summary><dl class=keys>{listed}</dl></details>" if views else "",
            '<noscript><p class="warning">The plots need JavaScript; the tables do not.</p></noscript>'
            if views
            else "",
            *parts,
            "</main>",
            f'<script type="application/json" id="page-data">{data}</script>',
            f"<script>{_vendored('uPlot.iife.min.js')}</script>" if views else "",
            "" if live is None else f'<script type="application/json" id="live-data">{script_json(live)}</script>',
            f"<script>{page_script(live is not None)}</script>",
            "</body></html>",
        ]
    )


@cache
def _vendored(name: str) -> str:
    """A file of uPlot (MIT licence, in ``vendor/uPlot.LICENSE``)."""
    return (files("bike_analysis.page") / "vendor" / name).read_text(encoding="utf-8")


@cache
def page_script(live: bool = False) -> str:
    """Return the page's own script; with that of a running ride if `live`."""
    here = files("bike_analysis.page")
    names = (*_SCRIPTS, _LIVE_SCRIPT) if live else _SCRIPTS
    parts = "\n".join((here / name).read_text(encoding="utf-8") for name in names)
    return f'(() => {{\n"use strict";\n{parts}}})();'


@cache
def page_style() -> str:
    """Return the style sheet of report pages."""
    text = (files("bike_analysis.page") / "page.css").read_text(encoding="utf-8")
    text = text.replace("@LIGHT@", style_variables(dark=False)).replace("@DARKER@", style_variables(dark=True))
    return _vendored("uPlot.min.css") + text


def _kbd(keys: str) -> str:
    return " ".join(f"<kbd>{escape(key)}</kbd>" for key in keys.split())


def program_version() -> str:
    """Name and version of the program that makes the page, as installed."""
    try:
        return f"{_PROGRAM} {version(_PROGRAM)}"
    except PackageNotFoundError:
        return _PROGRAM


def note_words(notes: Mapping[str, str], left_out: Collection[str]) -> list[str]:
    """Return words for the recorder's notes that fit into a line."""
    return [f"{name} {value}" for name, value in notes.items() if name not in left_out and len(value) <= SHORT]


def long_notes(notes: Mapping[str, str], file: str = "") -> str:
    """Return the notes that fit into no line as HTML, folded; nothing where there are none.

    Args:
        notes: of a recording.
        file: its name, where the page has several.
    """
    listed = "".join(
        f"<dt>{html_text(name)}</dt><dd>{html_text(value, LONGEST_SENTENCE)}</dd>"
        for name, value in notes.items()
        if len(value) > SHORT
    )
    if not listed:
        return ""
    whose = html_text(file or "the recording")
    return f"<details><summary>More notes of {whose}</summary><dl class=keys>{listed}</dl></details>"


def settings_words(period: float, simulation: Simulation | None) -> list[str]:
    """Return words for control period, s, and simulation; nothing for what is not known."""
    words = [f"a command every {1e3 * period:g} ms"] if period > 0.0 else []
    if simulation is not None and simulation.engine:
        words.append(f"engine {simulation.engine}")
    if simulation is not None and simulation.time_step > 0.0:
        words.append(f"steps of {1e3 * simulation.time_step:g} ms")
    return words


def recorded_settings(recording: Recording) -> list[str]:
    """Return the words of all control periods and simulations of a recording, each once."""
    periods = np.unique(np.round(recording.states.control_period, 6))
    words = [word for period in periods for word in settings_words(float(period), None)]
    return list(dict.fromkeys([*words, *(word for one in recording.simulations for word in settings_words(0.0, one))]))
