"""Text, data and columns of numbers in a page, none of which can become part of its code; pieces of HTML.

A column is small enough for an hour at 100 Hz and exact to a stated quantum: it becomes integer multiples of that.
Differences from row to row are small, so they are zigzag coded (sign in the lowest bit), split into four planes of
bytes, deflated and written in base64. ``chart.js`` undoes this.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.figures.numbers import lap_text
from bike_analysis.read.container import LONGEST_NAME, shown

_BY_NUMBER: Final = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}
"""Characters by which a name could end the script element, or a line of it; JSON knows them by their numbers, too."""


def html_text(text: str, longest: int = LONGEST_NAME) -> str:
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
