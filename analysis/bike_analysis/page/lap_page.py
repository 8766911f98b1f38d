"""The report of recorded laps: times, traces against the theoretical lap, map, g-g diagram, follow view."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import numpy as np

from bike_analysis.figures.lap_recording import LapRecording, Theory, timing_agrees
from bike_analysis.figures.numbers import best_sectors_together, best_times, lap_text
from bike_analysis.page.html import html_text, key_html, table_html
from bike_analysis.page.lap_view import lap_view
from bike_analysis.page.shell import page_shell
from bike_analysis.page.view import view_html
from bike_analysis.read.text import LONGEST_SENTENCE

PAGE_NAME: Final = "lap.html"

_PROGRAM: Final = "two-wheeler-lab"


def lap_figures(laps: LapRecording, theory: Theory) -> dict[str, Any]:
    """Return the figures of recorded laps, ready for JSON."""
    flying = laps.flying
    best = min(flying, key=lambda lap: lap.duration, default=None)
    kinds = [event.kind for event in laps.ride.events]
    return {
        "vehicle": laps.recording.vehicle,
        "course": laps.track.name,
        "laps_s": [lap.duration for lap in flying],
        "lap_s": None if best is None else best.duration,
        "sectors_s": [] if best is None else list(best.sectors),
        "out_lap_s": laps.timing.laps[0].duration if laps.timing.laps else None,
        "limit_s": theory.lap_time,
        "limit_sectors_s": list(theory.sector_times),
        "excess": None if best is None else max(lap.duration for lap in flying) / theory.lap_time - 1.0,
        "falls": kinds.count("fall"),
        "walls": kinds.count("wall"),
        "valid_laps": sum(lap.valid for lap in flying),
        "off_track_s": laps.timing.off_track,
        "timing_agrees": timing_agrees(laps),
        "lost_steps": int(np.sum(np.diff(laps.ride.states.step) - 1)),
    }


def write_lap_report(laps: LapRecording, theory: Theory, out_dir: Path) -> Path:
    """Write the report page and return its path.

    Raises:
        OSError: If it cannot be written.
    """
    out_dir.mkdir(parents=True, exist_ok=True)
    path = out_dir / PAGE_NAME
    path.write_text(render_lap_page(laps, theory), encoding="utf-8")
    return path


def render_lap_page(laps: LapRecording, theory: Theory) -> str:
    """Return the report page: HTML without any reference to the outside."""
    figures = lap_figures(laps, theory)
    title = f"{laps.recording.vehicle} on {laps.track.name}"
    view = lap_view(laps, theory, "laps", title)
    below = f'<p class="soft">{html_text(" · ".join(_header(laps)), LONGEST_SENTENCE)}</p>'
    parts = [_key(figures), view_html(view), "<h2>Lap and sector times</h2>", _time_table(laps, theory)]
    return page_shell(title, below, [*parts, _agreement(figures)], [view])


def _header(laps: LapRecording) -> list[str]:
    """Vehicle, circuit, rider and source of the numbers. The tiles do not show an out-lap."""
    recording, track = laps.recording, laps.track
    words = [f"machine {recording.vehicle}", f"circuit {track.name}, {track.length:.0f} m"]
    words += [f"{name} {value}" for name, value in recording.notes.items() if name not in ("vehicle", "circuit")]
    return [*words, recording.path.name, f"{recording.message_count:,} messages", program_version()]


def program_version() -> str:
    """Name and version of the program that makes the page, as installed."""
    try:
        return f"{_PROGRAM} {version(_PROGRAM)}"
    except PackageNotFoundError:
        return _PROGRAM


def _key(figures: dict[str, Any]) -> str:
    excess = figures["excess"]
    entries = [
        ("best lap", "–" if figures["lap_s"] is None else lap_text(figures["lap_s"]), ""),
        ("theoretical lap", lap_text(figures["limit_s"]), ""),
        ("slowest lap over theoretical", "–" if excess is None else f"{100 * excess:+.1f}", "%"),
        ("laps within the limits", f"{figures['valid_laps']} of {len(figures['laps_s'])}", ""),
        ("time off the track", f"{figures['off_track_s']:.2f}", "s"),
        ("falls", str(figures["falls"]), ""),
        ("wall contacts", str(figures["walls"]), ""),
    ]
    return key_html(entries)


def _time_table(laps: LapRecording, theory: Theory) -> str:
    """Lap and sector times by the number in the events; the best flying ones are marked, with their sum."""
    names = [name for name, _ in laps.track.sectors]
    head = "".join(f"<th>{html_text(name)}</th>" for name in ("lap", "time", *names, "off track"))
    flying = [lap.sectors for lap in laps.flying]
    best = [min((lap.duration for lap in laps.flying), default=None), *best_times(flying)]
    rows = []
    for lap in laps.timing.laps:
        name = str(lap.number) if lap in laps.flying else f"{lap.number} (out)"
        rows.append(
            _time_row(name, (lap.duration, *lap.sectors), best, f"{lap.off_track:.2f} s" if lap.off_track else "")
        )
    together = best_sectors_together(flying)
    if len(flying) > 1 and together is not None:
        rows.append(_time_row("best sectors", (together, *best[1:]), [], ""))
    rows.append(_time_row("theoretical", (theory.lap_time, *theory.sector_times), [], ""))
    return table_html(head, rows)


def _time_row(name: str, times: Sequence[float | None], best: Sequence[float | None], last: str) -> str:
    cells = []
    for column, time in enumerate(times):
        mark = ' class="best"' if column < len(best) and time == best[column] else ""
        cells.append(f"<td{mark}>{'–' if time is None else lap_text(time)}</td>")
    return f"<tr><td>{html_text(name)}</td>{''.join(cells)}<td>{last}</td></tr>"


def _agreement(figures: dict[str, Any]) -> str:
    if figures["timing_agrees"]:
        return '<p class="soft">Computed again from the recorded contact points, all times equal the events.</p>'
    return (
        '<div class="warning" role="status"><p>The times computed from the recording differ from its events; '
        f"{figures['lost_steps']} steps are missing.</p></div>"
    )
