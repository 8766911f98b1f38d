"""The report page of rides: one HTML file, made from recordings and, where several are compared, their comparison."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Final

import numpy as np

from bike_analysis.figures.circuit import Theory, corner_figures, course_corners
from bike_analysis.figures.compare import Comparison, counted_runs
from bike_analysis.figures.metrics import Figures
from bike_analysis.figures.numbers import lap_text
from bike_analysis.figures.recorded import folder_prefixes
from bike_analysis.figures.rides import Ride, RideRecording
from bike_analysis.page.document import (
    html_text,
    key_html,
    long_notes,
    note_words,
    number_text,
    page_shell,
    program_version,
    recorded_settings,
    row_html,
    table_html,
    time_cell,
)
from bike_analysis.page.ride_view import FAST, comparison_view, ride_view
from bike_analysis.page.view import View, view_html
from bike_analysis.read.container import MAX_SENTENCE
from bike_analysis.read.messages import Floats

DRAWN_RIDES: Final = 6
"""Rides that are drawn: the failed ones and those with the largest errors; the table has all of them."""

MOST_COLUMNS: Final = 4
"""Sectors that are columns of the table of times; more are its rows."""
_RADIANS: Final = re.compile(r"(-?[0-9.]+) rad\b")
_ENDS: Final = {"finished": "finished", "fell": "fell", "off_course": "left the course", "stopped": "stopped"}


def write_page(
    recordings: Sequence[RideRecording],
    path: str | os.PathLike[str],
    comparison: Comparison | None = None,
    theory: Theory | None = None,
) -> Path:
    """Write the report page.

    Args:
        recordings: What was read; all their rides are listed, and drawn if they are few.
        path: The file to write; its folder must exist.
        comparison: Rides or laps of them side by side, shown first.
        theory: The theoretical lap; None without one.

    Returns:
        The path.

    Raises:
        ValueError: If there is no recording.
        OSError: If the file cannot be written.
    """
    if not recordings:
        raise ValueError("a page needs at least one recording")
    rides = [ride for recording in recordings for ride in recording.rides]
    several = len(recordings) > 1
    prefixes = folder_prefixes([recording.path for recording in recordings])
    named = list(zip(prefixes, recordings, strict=True))
    sources = [prefix + recording.path.name if several else "" for prefix, recording in named]
    labels = [prefix + ride.label for prefix, recording in named for ride in recording.rides]
    names = [f"Ride {number}: {label}" if several else f"Ride {number}" for number, label in enumerate(labels, start=1)]
    figures = [ride.figures for ride in rides]
    failed_or_far = [(f.falls + f.off_course == 0, -(f.max_error_m or 0.0)) for f in figures]
    drawn = sorted(sorted(range(len(rides)), key=failed_or_far.__getitem__)[:DRAWN_RIDES])
    views: list[View] = []
    parts = ["".join(map(_warnings, recordings, sources))]
    if theory is not None:
        title = f"{recordings[0].vehicle} on {theory.track.name}"
    elif comparison is not None and several:
        title = comparison.title
    else:
        title = f"{len(recordings)} recordings" if several else recordings[0].path.name
    if comparison is not None:
        views.append(comparison_view(comparison, "comparison", theory))
        parts.append(_comparison(comparison, theory, views[0]))
    if len(rides) > 1:
        parts.append(_overview(rides, names, drawn))
    for index in drawn:
        course = rides[index].course
        name = f"{labels[index]} on {course.name if course else 'an unknown course'}"
        view = ride_view(rides[index].evaluated, f"ride-{index + 1}", name)
        views.append(view)
        parts.append(_ride(rides[index], names[index], view))
    target = Path(path)
    text = page_shell(title, _below(list(zip(recordings, sources, strict=True))), parts, views)
    target.write_text(text, encoding="utf-8")
    return target


# ---- side by side --------------------------------------------------------------------------------------------------


def _comparison(comparison: Comparison, theory: Theory | None, view: View) -> str:
    reference = html_text(comparison.short_labels[comparison.reference])
    return (
        f'<section id="comparison"><h2>Side by side</h2>{_lap_key(comparison, theory)}'
        f'<p class="soft">{len(comparison.runs)} rides or laps at the same places along the course. The reference is '
        f"{reference}.</p>{view_html(view)}<h3>Lap and sector times</h3>{time_table(comparison, theory)}"
        f"{corner_tables(comparison, theory, view)}</section>"
    )


def _lap_key(comparison: Comparison, theory: Theory | None) -> str:
    """The best lap beside the theoretical one."""
    if theory is None:
        return ""
    reference = comparison.runs[comparison.reference]
    best = reference.duration_s if reference.kind == "flying" else None
    limit = theory.lap_time
    entries = [
        ("best flying lap", "–" if best is None else lap_text(best), ""),
        ("theoretical lap", lap_text(limit), ""),
        ("best over theoretical", "–" if best is None else number_text(best - limit, 2, "+"), "s"),
    ]
    return key_html(entries)


def time_table(comparison: Comparison, theory: Theory | None = None) -> str:
    """Times of the runs and of their sectors, as HTML, each with what it is over the best one; the best are marked.

    A row is a run, or a sector where there are many. Laps from a standing or rolling start do not count as the best
    where there are others.
    """
    runs, sectors = comparison.runs, comparison.sectors
    durations = [run.duration_s if run.complete else None for run in runs]
    counted = counted_runs(runs)
    best = [min((d for k in counted if (d := durations[k]) is not None), default=None), *(s.best_s for s in sectors)]
    rows: list[tuple[str, str, Sequence[float | None]]] = [
        (name, run.kind, [duration, *(sector.times_s[k] for sector in sectors)])
        for k, (name, run, duration) in enumerate(zip(comparison.short_labels, runs, durations, strict=True))
    ]
    if comparison.best_sectors_s is not None:
        rows.append(("best sectors", "together", [comparison.best_sectors_s, *best[1:]]))
    if theory is not None:
        rows.append(("theoretical", "", [theory.lap_time, *theory.sector_times]))
    names = ["time"]
    for number, sector in enumerate(sectors, start=1):
        names.append(sector.name if sector.name == f"sector {number}" else f"{number}\u2002{sector.name}")
    cells = [[_behind_cell(time, least) for time, least in zip_longest(times, best)] for _, _, times in rows]
    if len(sectors) <= MOST_COLUMNS:
        head = "".join(f"<th>{html_text(name)}</th>" for name in ("run", "", *names))
        lines = [
            row_html(name, [f"<td class=text>{kind}</td>", *times])
            for (name, kind, _), times in zip(rows, cells, strict=True)
        ]
        return table_html(head, lines, "times")
    head = "<th></th>" + "".join(f"<th>{html_text(name)}<small>{kind}</small></th>" for name, kind, _ in rows)
    lines = [row_html(name, times) for name, *times in zip(names, *cells, strict=True)]
    return table_html(head, lines, "times")


def _behind_cell(time: float | None, best: float | None) -> str:
    behind = None if time is None or best is None or time == best else time - best
    return time_cell(time, best, "" if behind is None else f"<small>{number_text(behind, 3, '+')}</small>")


_CORNER_HEAD: Final = (
    "<th>corner</th><th>brakes at<br>m</th><th>before apex<br>m</th><th>entry<br>km/h</th><th>least<br>km/h</th>"
    "<th>exit<br>km/h</th><th>lean<br>°</th><th>variance<br>s</th><th class=text>most of it in</th>"
)


def corner_tables(comparison: Comparison, theory: Theory | None, view: View) -> str:
    """A table of the corners for each complete lap: of the reference against the theoretical lap, else against it."""
    reference = comparison.runs[comparison.reference]
    corners = course_corners(reference.ride.course, theory.track if theory is not None else None)
    names = comparison.short_labels
    durations = {names[k]: run.duration_s for k, run in enumerate(comparison.runs) if run.lap is not None}
    ridden = [series for series in view.series if series.name in durations]
    if not corners or not ridden or reference.ride.course is None:
        return ""
    length = reference.ride.course.length
    laps = {s.name: _from_line_to_line(s.columns, length, durations[s.name]) for s in ridden}
    first = ridden[0].name
    parts = ["<h3>Corners</h3>"]
    if theory is not None:
        ideal = _from_line_to_line(view.series[-1].columns, length, theory.lap_time)
        found = corner_figures(corners, length, laps[first], ideal)
        parts.append(_corner_table(found, f"{first}, measured against the theoretical lap", is_open=True))
    for other in [series.name for series in ridden[1:]] or ([] if theory is not None else [first]):
        found = corner_figures(corners, length, laps[other], laps[first])
        parts.append(_corner_table(found, f"{other}, measured against {first}", is_open=len(parts) == 1))
    return "".join(parts)


def _from_line_to_line(columns: Mapping[str, Floats], length: float, duration: float) -> dict[str, Floats]:
    """A lap whose first and last state lie a little inside, with the known times of the line."""
    ended = {name: np.pad(c, 1, mode="edge") for name, c in columns.items() if name in ("speed", "roll", "brake")}
    for name, end in (("distance", length), ("time", duration)):
        ended[name] = np.concatenate([[0.0], np.clip(columns[name], 0.0, end), [end]])
    return ended


def _corner_table(found: Sequence[Figures], title: str, is_open: bool) -> str:
    worst = max((corner.lost_s for corner in found), default=0.0)
    rows = []
    for corner in found:
        speeds = (corner.entry_speed, corner.least_speed, corner.exit_speed)
        cells = [
            *(_cell(v, 0) for v in (corner.braking_m, corner.before_apex_m, *speeds, corner.lean_deg)),
            f"<td{' class=worst' if corner.lost_s == worst > 0.0 else ''}>{number_text(corner.lost_s, 3, '+')}</td>",
            f"<td class=text>{corner.lost_in}</td>",
        ]
        rows.append(row_html(f"{corner.name} {corner.direction}", cells))
    total = number_text(sum(corner.lost_s for corner in found), 3, "+")
    rows.append(row_html("whole lap", ["<td></td>" * 6, f"<td>{total}</td><td></td>"]))
    table = table_html(_CORNER_HEAD, rows, "corners")
    return f"<details{' open' if is_open else ''}><summary>{html_text(title)}</summary>{table}</details>"


# ---- rides ---------------------------------------------------------------------------------------------------------


def _below(recordings: Sequence[tuple[RideRecording, str]]) -> str:
    """Text below the title: a line for each recording; who made the page ends that of a single one."""
    lines = [html_text(" · ".join(_words(recording, file)), MAX_SENTENCE) for recording, file in recordings]
    made = html_text(f"page by {program_version()}")
    lines = [f"{lines[0]} · {made}"] if len(lines) == 1 else [*lines, made]
    more = "".join(long_notes(recording.notes, file) for recording, file in recordings)
    return "".join(f'<p class="soft">{line}</p>' for line in lines) + more


def _words(recording: RideRecording, file: str) -> list[str]:
    total = sum(ride.figures.duration_s for ride in recording.rides)
    distance = sum(ride.figures.distance_m for ride in recording.rides)
    words = [file] if file else []
    words += [f"{total:.1f} s of simulated time", f"{distance:.0f} m", f"{recording.message_count:,} messages"]
    if recording.vehicle:
        words.append(f"vehicle {recording.vehicle}")
    words += recorded_settings(recording)
    return words + note_words(recording.notes, ("vehicle",))


def _warnings(recording: RideRecording, file: str) -> str:
    if not recording.warnings:
        return ""
    name = f"{file}: " if file else ""
    lines = "".join(f"<p>{html_text(name + w[:1].upper() + w[1:], MAX_SENTENCE)}.</p>" for w in recording.warnings)
    return f'<div class="warning" role="status">{lines}</div>'


def _overview(rides: Sequence[Ride], names: Sequence[str], drawn: Sequence[int]) -> str:
    head = "<th>ride</th><th class=text>course</th><th>speed<br>m/s</th><th>distance<br>m</th><th>time<br>s</th>"
    head += "<th>mean error<br>m</th><th>RMS error<br>m</th><th>max error<br>m</th><th class=text>end</th>"
    rows = []
    for index, ride in enumerate(rides):
        f, name = ride.figures, html_text(names[index])
        if index in drawn:
            name = f'<a href="#ride-{index + 1}">{name}</a>'
        cells = [
            f"<td>{name}</td><td class=text>{html_text(f.course or '–')}</td>",
            *(_cell(f.speed_mean_m_s, 2), _cell(f.distance_m, 0), _cell(f.duration_s, 1)),
            *(_cell(f.mean_error_m, 3), _cell(f.rms_error_m, 3), _cell(f.max_error_m, 3)),
            f'<td class="text {f.ended_by}">{_ENDS[f.ended_by]}</td>',
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    note = ""
    if len(drawn) < len(rides):
        note = f'<p class="soft">Drawn below are the {len(drawn)} with falls or the largest errors.</p>'
    return f"<h2>All rides</h2>{note}{table_html(head, rows, 'rides')}"


def _ride(ride: Ride, name: str, view: View) -> str:
    figures = ride.figures
    course = f" on {html_text(figures.course)}" if figures.course else ""
    speed = f" at {figures.speed_mean_m_s:.2f} m/s" if figures.speed_mean_m_s is not None else ""
    parts = [
        f'<section id="{view.key}"><h2>{html_text(name)}{course}{speed}</h2>',
        _outcome(ride, figures),
        key_html(_key_figures(figures)),
        view_html(view),
        _section_table(figures),
        "<h3>All figures</h3>",
        _figure_table(figures),
        "</section>",
    ]
    if not len(ride.commands):
        parts.insert(4, '<p class="soft">The age of commands is not shown: commands were not recorded.</p>')
    return "\n".join(parts)


def _outcome(ride: Ride, figures: Figures) -> str:
    words = {
        "finished": "Reached the end of the course.",
        "fell": "The vehicle fell.",
        "off_course": "The vehicle left the course.",
        "stopped": "The recording of this ride ends before the end of the course.",
    }
    said = [event.text for event in ride.events if event.text and event.kind in ("fall", "off_course", "wall")]
    text = said[0] if said and not figures.completed else words[figures.ended_by]
    text = _RADIANS.sub(lambda angle: f"{np.degrees(float(angle[1])):.0f}°", text)
    return f'<p class="{figures.ended_by}">{html_text(text)}</p>'


def _key_figures(f: Figures) -> list[tuple[str, str, str]]:
    """The tiles; those of motorcycles, whose speed is in km/h, have the best lap and the limits instead of errors."""
    lean = [abs(v) for v in (f.roll_min_deg, f.roll_max_deg) if v is not None]
    if f.complete_laps and (f.speed_max_m_s or 0.0) > FAST:
        flying = [lap for lap in f.complete_laps if not lap.out_lap]
        return [
            ("best lap", "–" if f.best_lap_s is None else lap_text(f.best_lap_s), ""),
            ("flying laps", str(len(flying)), ""),
            ("of them inside the limits", str(sum(lap.valid is True for lap in flying)), ""),
            ("time outside the limits", number_text(f.off_track_s, 2), "s"),
            ("top speed", number_text(3.6 * (f.speed_max_m_s or 0.0), 0), "km/h"),
            ("largest lean", number_text(max(lean, default=None), 0), "°"),
            ("falls", str(f.falls), ""),
            ("touches of walls", str(len(f.collisions)), ""),
        ]
    return [
        ("mean error", number_text(f.mean_error_m, 3), "m"),
        ("RMS error", number_text(f.rms_error_m, 3), "m"),
        ("max error", number_text(f.max_error_m, 3), "m"),
        ("speed", number_text(f.speed_mean_m_s, 2), "m/s"),
        ("distance", number_text(f.distance_m, 0), "m"),
        ("time", number_text(f.duration_s, 1), "s"),
        ("roll", _range(f.roll_min_deg, f.roll_max_deg, 0), "°"),
        ("steer", _range(f.steer_min_deg, f.steer_max_deg, 0), "°"),
    ]


def _section_table(f: Figures) -> str:
    if not f.sections:
        return ""
    top = max((s["max_error_m"] or 0.0) for s in f.sections) or 1.0
    rows = []
    for number, s in enumerate(f.sections, start=1):
        share = 100.0 * (s["max_error_m"] or 0.0) / top
        bar = f'<td class=bar><i style="width:{share:.1f}%"></i></td>'
        cells = f"<td>{number}&ensp;{html_text(s['name'])}</td>{_cell(s['start_m'], 1)}{_cell(s['mean_error_m'], 3)}"
        rows.append(f"<tr>{cells}{_cell(s['rms_error_m'], 3)}{_cell(s['max_error_m'], 3)}{bar}</tr>")
    head = "<th>section</th><th>from<br>m</th><th>mean<br>m</th><th>RMS<br>m</th><th>max<br>m</th><th class=bar></th>"
    return f"<h3>Distance to the path by section</h3>{table_html(head, rows)}"


def _figure_table(f: Figures) -> str:
    entries: Iterable[tuple[str, str]] = [
        ("duration", f"{f.duration_s:.2f} s"),
        ("distance travelled", f"{f.distance_m:.2f} m"),
        ("full laps", number_text(f.laps, 0)),
        ("speed, lowest to highest", f"{_range(f.speed_min_m_s, f.speed_max_m_s, 3)} m/s"),
        ("largest error at", f"{number_text(f.max_error_at_m, 1)} m"),
        ("falls", str(f.falls)),
        ("times off course", str(f.off_course)),
        ("roll", f"{_range(f.roll_min_deg, f.roll_max_deg)} °"),
        ("steer", f"{_range(f.steer_min_deg, f.steer_max_deg)} °"),
        ("roll rate, RMS", f"{number_text(f.roll_rate_rms_deg_s, 1)} °/s"),
        ("steer rate, RMS (steering activity)", f"{number_text(f.steer_rate_rms_deg_s, 1)} °/s"),
        ("steering torque, RMS", f"{number_text(f.steer_torque_rms_nm, 2)} Nm"),
        ("change of the command from step to step, mean", number_text(f.command_change_mean, 4)),
        ("recorded steps", f"{f.steps:,}"),
        ("steps missing", str(f.lost_steps)),
        ("states recorded twice", str(f.repeated_states)),
        ("states without a command", number_text(f.unanswered_states, 0)),
        ("age of the command, mean", f"{number_text(f.command_delay_mean_steps, 2)} steps"),
        ("age of the command, largest", f"{number_text(f.command_delay_max_steps, 0)} steps"),
        ("the same in simulated time, mean", _milliseconds(f.command_delay_mean_s, 1)),
        ("policy's answers since its start, median (wall clock)", _milliseconds(f.latency_median_s, 3)),
        ("the same, 99th percentile", _milliseconds(f.latency_p99_s, 3)),
    ]
    rows = "".join(row_html(name, [f"<td>{html_text(value)}</td>"]) for name, value in entries)
    return f'<div class="columns"><table><tbody>{rows}</tbody></table></div>'


def _milliseconds(seconds: float | None, digits: int) -> str:
    return f"{number_text(None if seconds is None else 1e3 * seconds, digits)} ms"


def _range(low: float | None, high: float | None, digits: int = 1) -> str:
    return f"{number_text(low, digits)} … {number_text(high, digits)}" if low is not None and high is not None else "–"


def _cell(value: float | None, digits: int) -> str:
    return f"<td>{number_text(value, digits)}</td>"
