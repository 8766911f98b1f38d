"""View of a comparison of rides or laps, and the table of their sectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from bike_analysis.figures.compare import Comparison
from bike_analysis.figures.numbers import lap_text
from bike_analysis.page.html import html_text
from bike_analysis.page.ride_view import (
    aid_bands,
    course_sections,
    is_fast,
    map_lines,
    panels_for,
    ride_columns,
    section_labels,
    speed_channels,
)
from bike_analysis.page.view import Panel, PanelLine, Series, View, series_colour
from bike_analysis.read.tables import Floats

DELTA: Final = Panel(
    *("delta", "Time lost on the reference", "time lost", "s", (PanelLine("delta", "time lost", "orange"),)),
    caption="Difference of the times at the same place along the course; where it rises, time is lost.",
    least=0.05,
)
_OWN_TITLES: Final = {"lean": "Lean"}
_LEFT_OUT: Final = ("command", "age")
_MAIN_COLUMN: Final = {"lean": "roll"}


def comparison_view(comparison: Comparison, key: str) -> View:
    """Return the view of a comparison: distance-aligned traces, time lost, and a ghost for each other run.

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
        (DELTA, *comparison_panels(columns[0], fast)),
        map_lines(reference.ride),
        labels=section_labels(reference.ride.course),
        sections=course_sections(reference.ride, columns[0]["distance"], reference.begin_m),
        map_caption="The full dot is the reference, rings are the ghosts of the others at the same time since the "
        "beginning. Buttons above show and hide them.",
        channels=speed_channels(fast),
        bands=aid_bands(reference.ride, slice(0, None) if reference.lap is None else reference.lap.rows),
    )


def comparison_panels(columns: dict[str, Floats], fast: bool) -> tuple[Panel, ...]:
    """Panels with a line a series, or one for each wheel."""
    found = []
    for panel in panels_for(columns, fast):
        if panel.key in _LEFT_OUT:
            continue
        wanted = _MAIN_COLUMN.get(panel.key)
        lines = tuple(replace(line, fill="") for line in panel.lines if wanted in (None, line.column))
        if lines:
            title = _OWN_TITLES.get(panel.key, panel.title)
            found.append(replace(panel, title=title, lines=lines, caption="" if wanted else panel.caption))
    return tuple(found)


def run_columns(comparison: Comparison, index: int) -> dict[str, Floats]:
    """Columns of a compared run as pages show them, from its beginning; with the time that it lost on the reference."""
    run = comparison.runs[index]
    rows = slice(0, len(run.ride.states)) if run.lap is None else run.lap.rows
    columns = ride_columns(run.ride, rows, run.begin_m, run.begin_s)
    for name in ("steer", "balance", "command", "reached", "age"):
        columns.pop(name, None)
    delta = comparison.lost(index)
    known = np.isfinite(delta)
    if known.any():
        outside = {"left": np.nan, "right": np.nan}
        columns["delta"] = np.interp(columns["distance"], comparison.station_m[known], delta[known], **outside)
    return columns


def comparison_words(comparison: Comparison) -> str:
    """A sentence that names the compared runs, as HTML."""
    course = f" on {html_text(comparison.course)}" if comparison.course else ""
    return (
        f'<p class="soft">{len(comparison.runs)} rides or laps{course}, at the same places along the course. The '
        f"reference is {html_text(comparison.runs[comparison.reference].label)}.</p>"
    )


def sector_table(comparison: Comparison) -> str:
    """The times of the runs and of their sectors, as HTML: a column a run, and one of the best."""
    runs = comparison.runs
    reference = runs[comparison.reference]
    head = "".join(f"<th>{html_text(name)}</th>" for name in ("time", *(run.label for run in runs), "best"))
    durations = [run.duration_s if run.complete else None for run in runs]
    rows = [_row("whole", durations, reference.duration_s if reference.complete else None)]
    lost = [None if d is None else d - reference.duration_s for d in durations]
    cells = "".join(f"<td>{'–' if d is None else f'{d:+.3f}'.replace('-', '−')}</td>" for d in lost)
    rows.append(f"<tr><td>lost on the reference</td>{cells}<td></td></tr>")
    for number, sector in enumerate(comparison.sectors, start=1):
        rows.append(_row(f"{number}\u2002{sector.name}", sector.times_s, sector.best_s))
    together = comparison.best_sectors_s
    if together is not None:
        rows.append(f"<tr><td>best sectors together</td>{'<td></td>' * len(runs)}<td>{lap_text(together)}</td></tr>")
    return f"<div class=scroll><table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"


def _row(name: str, times: Sequence[float | None], best: float | None) -> str:
    """One line of the table: a time for each run, the best one marked and repeated at the end."""
    mark = ' class="best"'
    cells = [f"<td{mark if time is not None and time == best else ''}>{_time(time)}</td>" for time in times]
    return f"<tr><td>{html_text(name)}</td>{''.join(cells)}<td>{_time(best)}</td></tr>"


def _time(seconds: float | None) -> str:
    return "–" if seconds is None else lap_text(seconds)
