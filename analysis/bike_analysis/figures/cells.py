"""Tables for people from records of figures: a heading and a format string for each column."""

from __future__ import annotations

import math
import string
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from bike_analysis.figures.numbers import lap_text, significant
from bike_analysis.read.container import shown

UNKNOWN: Final = "-"
_CONVERSIONS: Final[Mapping[str, Callable[[float], str]]] = {"l": lap_text, "g": significant}


class _Cells(string.Formatter):
    """Format strings with ``!l`` for lap times, ``!g`` for four significant digits, and a dash for what is unknown."""

    def convert_field(self, value: Any, conversion: Any) -> Any:
        if conversion not in _CONVERSIONS:
            return super().convert_field(value, conversion)
        return None if _is_unknown(value) else _CONVERSIONS[conversion](value)

    def format_field(self, value: Any, format_spec: str) -> Any:
        return UNKNOWN if _is_unknown(value) else super().format_field(value, format_spec)


def _is_unknown(value: Any) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))


def cells(columns: Iterable[str], record: Mapping[str, Any]) -> list[str]:
    """Return the cells of a row.

    Args:
        columns: format strings over the record, as ``{falls} of {rides}``.
        record: figures by name.
    """
    formatter = _Cells()
    return [formatter.vformat(column, (), record) for column in columns]


def table_text(columns: Mapping[str, str], records: Iterable[Mapping[str, Any]], left: int = 1) -> list[str]:
    """Return a table of figures as lines.

    Args:
        columns: format strings by heading.
        records: a row each.
        left: columns of text, which come first; the others stand on the right.
    """
    return lines_of([list(columns), *(cells(columns.values(), record) for record in records)], left)


def lines_of(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Return rows of cells, the headings first, as lines of columns; what a terminal must not get is escaped."""
    whole = [[shown(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*whole, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if place < left else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in whole
    ]


def markdown(rows: Sequence[Sequence[Any]]) -> str:
    """Return rows of cells, the headings first, as a table in Markdown."""

    def line(row: Sequence[Any]) -> str:
        return "".join(f"| {cell} " if str(cell) else "| " for cell in row) + "|\n"

    head, *others = rows
    return "".join([line(head), "|---" * len(head) + "|\n", *map(line, others)])
