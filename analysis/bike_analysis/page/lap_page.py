"""The report of recorded laps: times, traces against the theoretical lap, map, g-g diagram, follow view."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final

import numpy as np

from bike_analysis.figures.lap_recording import LapRecording, LapTrace, Theory, corner_figures, timing_agrees
from bike_analysis.figures.numbers import best_sectors_together, best_times, lap_text
from bike_analysis.page.document import long_notes, note_words, page_shell, program_version, recorded_settings
from bike_analysis.page.html import html_text, key_html, number_text, row_html, table_html, time_cell
from bike_analysis.page.lap_view import lap_view, theory_columns
from bike_analysis.page.view import View, view_html
from bike_analysis.read.container import LONGEST_SENTENCE
from bike_analysis.read.messages import Floats

PAGE_NAME: Final = "lap.html"


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
    below += long_notes(laps.recording.notes)
    parts = [_key(laps, figures), view_html(view), "<h2>Lap and sector times</h2>", _time_table(laps, theory)]
    parts += [_agreement(figures), corner_tables(laps, theory, view)]
    return page_shell(title, below, parts, [view])


def _header(laps: LapRecording) -> list[str]:
    """Machine, circuit, rider, date and settings. The tiles do not show an out-lap."""
    recording, track = laps.recording, laps.track
    notes = dict(recording.notes)
    words = [f"machine {recording.vehicle}", f"circuit {track.name}, {track.length:.0f} m"]
    words.append(f"rider {notes.pop('policy', 'unknown')}")
    words += recorded_settings(recording)
    if "recorded" in notes:
        words.append(f"recorded {notes.pop('recorded')}")
    words += note_words(notes, ("vehicle", "circuit"))
    return [*words, recording.path.name, f"{recording.message_count:,} messages", f"page by {program_version()}"]


def _key(laps: LapRecording, figures: dict[str, Any]) -> str:
    """The tiles: numbers that stand for themselves."""
    best, limit, ridden = figures["lap_s"], figures["limit_s"], len(figures["laps_s"])
    rows = [row for lap in laps.flying for row in range(*laps.rows(lap).indices(len(laps.ride.states)))]
    states = laps.ride.states.take(np.array(rows, dtype=int)) if rows else laps.ride.states
    entries = [
        ("best lap", "–" if best is None else lap_text(best), ""),
        ("theoretical best", lap_text(limit), ""),
        ("best over theoretical", "–" if best is None else number_text(best - limit, 2, "+"), "s"),
        ("laps after the out-lap", str(ridden), ""),
        ("of them inside the limits", f"{figures['valid_laps']} of {ridden}", ""),
        ("time outside the limits", f"{figures['off_track_s']:.2f}", "s"),
        ("top speed", f"{3.6 * float(np.nanmax(states.speed)):.0f}", "km/h"),
        ("largest lean", f"{np.degrees(float(np.nanmax(np.abs(states.roll)))):.0f}", "°"),
        ("falls", str(figures["falls"]), ""),
        ("touches of walls", str(figures["walls"]), ""),
    ]
    return key_html(entries)


def _time_table(laps: LapRecording, theory: Theory) -> str:
    """Lap and sector times by the number in the events, each with what it is over the best one; the best are marked."""
    names = [name for name, _ in laps.track.sectors]
    left = any(lap.off_track for lap in laps.timing.laps)
    head = "".join(f"<th>{html_text(name)}</th>" for name in ("lap", "time", *names, *(["off track"] if left else [])))
    flying = [lap.sectors for lap in laps.flying]
    best = [min((lap.duration for lap in laps.flying), default=None), *best_times(flying)]
    rows = []
    for lap in laps.timing.laps:
        name = str(lap.number) if lap in laps.flying else f"{lap.number} (out)"
        rows.append(_time_row(name, (lap.duration, *lap.sectors), best, f"{lap.off_track:.2f} s" if left else None))
    together = best_sectors_together(flying)
    if len(flying) > 1 and together is not None:
        rows.append(_time_row("best sectors", (together, *best[1:]), [best[0]], "" if left else None))
    rows.append(_time_row("theoretical", (theory.lap_time, *theory.sector_times), best, "" if left else None))
    return table_html(head, rows, "times")


def _time_row(name: str, times: Sequence[float | None], best: Sequence[float | None], last: str | None) -> str:
    cells = []
    for time, least in zip_longest(times, best):
        behind = None if time is None or least is None or time == least else time - least
        more = "" if behind is None else f"<small>{number_text(behind, 3, '+')}</small>"
        cells.append(time_cell(time, least, more))
    cells += [] if last is None else [f"<td>{last}</td>"]
    return row_html(name, cells)


def corner_tables(laps: LapRecording, theory: Theory, view: View) -> str:
    """A table of the corners for each flying lap: the best against the theoretical lap, the others against the best."""
    by_number = {f"lap {lap.number}": lap for lap in laps.flying}
    ridden = [series for series in view.series if series.name in by_number]
    if not ridden or not laps.track.corners:
        return ""
    best, *others = ridden
    limit = _trace(theory_columns(laps, theory), laps.track.length, theory.lap_time)
    traces = {s.name: _trace(s.columns, laps.track.length, by_number[s.name].duration) for s in ridden}
    parts = ["<h2>Corners</h2>"]
    parts.append(_corner_table(laps, best.name, traces[best.name], "the theoretical lap", limit, is_open=True))
    for other in others:
        words = f"the best, {best.name}"
        parts.append(_corner_table(laps, other.name, traces[other.name], words, traces[best.name]))
    return "".join(parts)


def _trace(columns: dict[str, Floats], length: float, duration: float) -> LapTrace:
    """A lap from line to line: its first and last state lie a little inside, and the times of the line are known."""
    nothing = np.zeros(len(columns["distance"]))
    ended = [columns["speed"], columns.get("roll", nothing), columns.get("brake", nothing)]
    distance = np.concatenate([[0.0], np.clip(columns["distance"], 0.0, length), [length]])
    time = np.concatenate([[0.0], np.clip(columns["time"], 0.0, duration), [duration]])
    return LapTrace(distance, time, *(np.pad(column, 1, mode="edge") for column in ended))


_CORNER_HEAD: Final = (
    "<th>corner</th><th>brakes at<br>m</th><th>before apex<br>m</th><th>entry<br>km/h</th><th>least<br>km/h</th>"
    "<th>exit<br>km/h</th><th>lean<br>°</th><th>lost<br>s</th><th class=text>most of it in</th>"
)


def _corner_table(
    laps: LapRecording, name: str, lap: LapTrace, against: str, reference: LapTrace, is_open: bool = False
) -> str:
    found = corner_figures(laps.track.corners, laps.track.length, lap, reference)
    worst = max((corner.lost_s for corner in found), default=0.0)
    rows = []
    for corner in found:
        speeds = (corner.entry_speed, corner.least_speed, corner.exit_speed)
        cells = [
            *(
                f"<td>{number_text(v, 0)}</td>"
                for v in (corner.braking_m, corner.before_apex_m, *speeds, corner.lean_deg)
            ),
            f"<td{' class=worst' if corner.lost_s == worst > 0.0 else ''}>{number_text(corner.lost_s, 3, '+')}</td>",
            f"<td class=text>{corner.lost_in}</td>",
        ]
        rows.append(row_html(f"{corner.name} {corner.direction}", cells))
    total = number_text(sum(corner.lost_s for corner in found), 3, "+")
    rows.append(row_html("whole lap", ["<td></td>" * 6, f"<td>{total}</td><td></td>"]))
    words = f"{html_text(name)}, measured against {html_text(against)}"
    table = table_html(_CORNER_HEAD, rows, "corners")
    return f"<details{' open' if is_open else ''}><summary>{words}</summary>{table}</details>"


def _agreement(figures: dict[str, Any]) -> str:
    if figures["timing_agrees"]:
        return '<p class="soft">Computed again from the recorded contact points, all times equal the events.</p>'
    return (
        '<div class="warning" role="status"><p>The times computed from the recording differ from its events; '
        f"{figures['lost_steps']} steps are missing.</p></div>"
    )
