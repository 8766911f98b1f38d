"""Pieces of HTML, and how text and data get into a page without becoming part of its code."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any, Final

from bike_analysis.read.text import LONGEST_NAME, shown

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


def table_html(head: str, rows: Sequence[str], kind: str = "") -> str:
    """Return a table that scrolls horizontally on a narrow screen; `kind` is its class."""
    named = f" class={kind}" if kind else ""
    return f"<div class=scroll><table{named}><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"


def key_html(entries: Iterable[tuple[str, str, str]]) -> str:
    """Return the most important figures, each with name, value and unit."""
    items = (f"<div><dt>{escape(k)}</dt><dd>{v} <small>{escape(unit)}</small></dd></div>" for k, v, unit in entries)
    return f'<dl class="key">{"".join(items)}</dl>'
