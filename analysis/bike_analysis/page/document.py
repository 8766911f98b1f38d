"""The frame that all pages share: one HTML file that needs no network, in light and dark, for desk and phone.

It holds style, script, uPlot and the content security policy that blocks all network requests; and the words below the
title, by which a ride was computed and recorded. Text, data and columns of numbers in a page cannot become part of its
code.

The line colours can be distinguished with colour-blindness (they differ in lightness and lie first of all on the
blue-orange axis); the scale of errors is viridis, with large errors farthest from the background in both schemes.

A column is small enough for an hour at 100 Hz and exact to a stated quantum: it becomes integer multiples of that.
Differences from row to row are small, so they are zigzag coded (sign in the lowest bit), split into four planes of
bytes, deflated and written in base64. ``chart.js`` undoes this.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from bike_analysis.figures.numbers import lap_text
from bike_analysis.read.container import MAX_NAME, MAX_SENTENCE, shown
from bike_analysis.read.messages import Simulation
from bike_analysis.read.reading import Recording
from bike_sim.documents import parse_yaml

if TYPE_CHECKING:
    from bike_analysis.page.view import View

_COLOURS: Final = parse_yaml((files("bike_analysis.page") / "colours.yaml").read_text(encoding="utf-8"))
_LIGHT: Final = {name: found[0] for name, found in _COLOURS.items() if len(found) > 1}
_DARK: Final = {name: found[-1] for name, found in _COLOURS.items()}

_ERROR_LEVELS: Final = 16
_VIRIDIS: Final = mpl.colormaps["viridis"]
_ERROR_LIGHT: Final = [to_hex(_VIRIDIS(x)) for x in np.linspace(0.86, 0.0, _ERROR_LEVELS)]
_ERROR_DARK: Final = [to_hex(_VIRIDIS(x)) for x in np.linspace(0.28, 1.0, _ERROR_LEVELS)]

RC: Final = mpl.rc_params_from_file(str(files("bike_analysis.page") / "page.mplstyle"), use_default_template=False)
"""Style of pictures."""


def colour(name: str) -> str:
    """Return a colour of the light scheme by its name."""
    return _LIGHT[name]


def style_variables(dark: bool) -> str:
    """Declare the colours as CSS variables.

    Args:
        dark: For the dark scheme.

    Returns:
        Declarations, ``--ink: #...;`` and so on; in the dark scheme those of the page's surfaces, too.
    """
    variables = dict(_DARK if dark else _LIGHT)
    variables |= {f"e{index}": colour for index, colour in enumerate(_ERROR_DARK if dark else _ERROR_LIGHT)}
    scheme = "color-scheme: dark; " if dark else ""
    return scheme + " ".join(f"--{name}: {value};" for name, value in variables.items())


_BY_NUMBER: Final = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}
"""Characters by which a name could end the script element, or a line of it; JSON knows them by their numbers, too."""


def html_text(text: str, longest: int = MAX_NAME) -> str:
    """Text out of a recording as HTML, also within an attribute; see `shown`."""
    return escape(shown(text, longest), quote=True)


def script_json(data: Any) -> str:
    """Data as JSON that may stand within a script element, whatever its strings say.

    A string like ``<!--<script>`` would otherwise make the browser look for another end of the element.

    Raises:
        ValueError: If a number is not finite.
    """
    return json.dumps(data, separators=(",", ":"), allow_nan=False).translate(_BY_NUMBER)


MISSING: Final = -(2**31)
"""Multiple that stands for NaN."""
_LARGEST: Final = 2**30


def embed(values: NDArray[Any], quantum: float) -> dict[str, Any]:
    """Pack a column.

    Args:
        values: Numbers; NaN and infinity become NaN.
        quantum: What the numbers are rounded to; made coarser where they would not fit 31 bits.

    Returns:
        ``rows``, ``quantum`` and ``data``, ready for JSON.

    Raises:
        ValueError: If the quantum is not positive.
    """
    if not quantum > 0.0:
        raise ValueError(f"the quantum of a column must be positive, got {quantum!r}")
    column = np.asarray(values, dtype=np.float64)
    known = np.isfinite(column)
    largest = float(np.abs(column[known]).max(initial=0.0))
    quantum = max(quantum, largest / _LARGEST)
    multiples = np.where(known, np.rint(np.where(known, column, 0.0) / quantum), MISSING).astype(np.int64)
    steps = np.diff(multiples, prepend=0).astype(np.int32)  # differences wrap, and so do the sums that undo them
    zigzag = ((steps << 1) ^ (steps >> 31)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4).T.tobytes()
    return {
        "rows": len(column),
        "quantum": quantum,
        "data": base64.b64encode(zlib.compress(planes, 6)).decode("ascii"),
    }


def table_html(head: str, rows: Sequence[str], kind: str = "") -> str:
    """Return a table that scrolls horizontally on a narrow screen; `kind` is its class."""
    named = f" class={kind}" if kind else ""
    return f"<div class=scroll><table{named}><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"


def row_html(name: str, cells: Iterable[str]) -> str:
    """Return a row of a table: its name, which is text, and cells, which are HTML."""
    return f"<tr><td>{html_text(name)}</td>{''.join(cells)}</tr>"


def time_cell(seconds: float | None, best: float | None, more: str = "") -> str:
    """Return a cell with a lap or sector time, marked where it is the best one."""
    mark = ' class="best"' if seconds is not None and seconds == best else ""
    return f"<td{mark}>{'–' if seconds is None else lap_text(seconds)}{more}</td>"


def number_text(value: float | None, digits: int, sign: str = "") -> str:
    """Return a number with a typographic minus, and with its sign if `sign` is "+"; a dash for None."""
    return "–" if value is None else f"{round(value, digits) + 0.0:{sign}.{digits}f}".replace("-", "−")


def key_html(entries: Iterable[tuple[str, str, str]]) -> str:
    """Return the most important figures, each with name, value and unit."""
    items = (f"<div><dt>{escape(k)}</dt><dd>{v} <small>{escape(unit)}</small></dd></div>" for k, v, unit in entries)
    return f'<dl class="key">{"".join(items)}</dl>'


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
        f"<dt>{html_text(name)}</dt><dd>{html_text(value, MAX_SENTENCE)}</dd>"
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
    """Return the words of all control periods and simulations of a recording, each once, and of what disturbed it."""
    periods = np.unique(np.round(recording.states.control_period, 6))
    words = [word for period in periods for word in settings_words(float(period), None)]
    words += [word for one in recording.simulations for word in settings_words(0.0, one)]
    name = recording.disturbances.get("name", "")
    words += [f"disturbances {shown(str(name))}"] if name else []
    return list(dict.fromkeys(words))
