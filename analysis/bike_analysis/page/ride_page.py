"""The report page of rides: one HTML file, made from recordings and, where several are compared, their comparison."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from bike_analysis.figures.compare import Comparison
from bike_analysis.figures.metrics import RideFigures
from bike_analysis.figures.recorded import RecordedRide, RideRecording, folder_prefixes
from bike_analysis.page.document import long_notes, note_words, page_shell, program_version, recorded_settings
from bike_analysis.page.html import html_text, key_html, number_text, row_html, table_html, time_cell
from bike_analysis.page.ride_view import comparison_view, ride_view
from bike_analysis.page.view import View, view_html
from bike_analysis.read.container import LONGEST_SENTENCE
from bike_analysis.read.rides import Ride

DRAWN_RIDES: Final = 6
"""Rides that are drawn; the table has all of them."""

_ENDS: Final = {"finished": "finished", "fell": "fell", "off_course": "left the course", "stopped": "stopped"}


def write_page(
    recordings: Sequence[RideRecording], path: str | os.PathLike[str], comparison: Comparison | None = None
) -> Path:
    """Write the report page.

    Args:
        recordings: What was read; all their rides are listed, and drawn if they are few.
        path: The file to write; its folder must exist.
        comparison: Rides or laps of them side by side, shown first.

    Returns:
        The path.

    Raises:
        ValueError: If there is no recording.
        OSError: If the file cannot be written.
    """
    target = Path(path)
    target.write_text(render_page(recordings, comparison), encoding="utf-8")
    return target


def render_page(recordings: Sequence[RideRecording], comparison: Comparison | None = None) -> str:
    """Make the report page; see `write_page`.

    Returns:
        HTML without any reference to the outside.
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
    title = f"{len(recordings)} recordings" if several else recordings[0].path.name
    drawn = _chosen([ride.figures for ride in rides])
    views: list[View] = []
    parts = ["".join(map(_warnings, recordings, sources))]
    if comparison is not None:
        views.append(comparison_view(comparison, "comparison"))
        course = f" on {html_text(comparison.course)}" if comparison.course else ""
        reference = html_text(comparison.runs[comparison.reference].label)
        parts.append(
            f'<section id="comparison"><h2>Side by side</h2><p class="soft">{len(comparison.runs)} rides or laps'
            f"{course}, at the same places along the course. The reference is {reference}.</p>"
            f"{view_html(views[-1])}<h3>Times and best sectors</h3>{sector_table(comparison)}</section>"
        )
    if len(rides) > 1:
        parts.append(_overview(rides, names, drawn))
    for index in drawn:
        view = ride_view(rides[index].evaluated, f"ride-{index + 1}", f"{labels[index]} on {_course(rides[index])}")
        views.append(view)
        parts.append(_ride(rides[index], names[index], view))
    return page_shell(title, _below(list(zip(recordings, sources, strict=True))), parts, views)


def sector_table(comparison: Comparison) -> str:
    """The times of the runs and of their sectors, as HTML: a column a run, and one of the best."""
    runs = comparison.runs
    reference = runs[comparison.reference]
    head = "".join(f"<th>{html_text(name)}</th>" for name in ("time", *(run.label for run in runs), "best"))
    durations = [run.duration_s if run.complete else None for run in runs]
    lost = [number_text(None if d is None else d - reference.duration_s, 3, "+") for d in durations]
    lines = [("whole", durations, reference.duration_s if reference.complete else None)]
    lines += [(f"{n}\u2002{s.name}", list(s.times_s), s.best_s) for n, s in enumerate(comparison.sectors, start=1)]
    rows = [
        row_html(name, [*(time_cell(t, best) for t in times), time_cell(best, None)]) for name, times, best in lines
    ]
    rows.insert(1, row_html("lost on the reference", [*(f"<td>{text}</td>" for text in lost), "<td></td>"]))
    together = comparison.best_sectors_s
    if together is not None:
        rows.append(row_html("best sectors together", ["<td></td>" * len(runs), time_cell(together, None)]))
    return table_html(head, rows)


def _below(recordings: Sequence[tuple[RideRecording, str]]) -> str:
    """Text below the title: a line for each recording; who made the page ends that of a single one."""
    lines = [html_text(" · ".join(_words(recording, file)), LONGEST_SENTENCE) for recording, file in recordings]
    made = html_text(f"page by {program_version()}")
    lines = [f"{lines[0]} · {made}"] if len(lines) == 1 else [*lines, made]
    more = "".join(long_notes(recording.data.notes, file) for recording, file in recordings)
    return "".join(f'<p class="soft">{line}</p>' for line in lines) + more


def _course(ride: RecordedRide) -> str:
    return ride.course.name if ride.course else "an unknown course"


def _chosen(figures: Sequence[RideFigures]) -> list[int]:
    """Indices of the rides to draw: all if they are few, else the failed ones and those with the largest errors."""
    if len(figures) <= DRAWN_RIDES:
        return list(range(len(figures)))
    worst = sorted(
        range(len(figures)),
        key=lambda i: (figures[i].falls + figures[i].off_course == 0, -(figures[i].max_error_m or 0.0)),
    )
    return sorted(worst[:DRAWN_RIDES])


def _words(recording: RideRecording, file: str) -> list[str]:
    total = sum(ride.figures.duration_s for ride in recording.rides)
    distance = sum(ride.figures.distance_m for ride in recording.rides)
    words = [file] if file else []
    words += [f"{total:.1f} s of simulated time", f"{distance:.0f} m", f"{recording.data.message_count:,} messages"]
    if recording.vehicle:
        words.append(f"vehicle {recording.vehicle}")
    words += recorded_settings(recording.data)
    return words + note_words(recording.data.notes, ("vehicle",))


def _warnings(recording: RideRecording, file: str) -> str:
    if not recording.warnings:
        return ""
    name = f"{file}: " if file else ""
    lines = "".join(f"<p>{html_text(name + w[:1].upper() + w[1:], LONGEST_SENTENCE)}.</p>" for w in recording.warnings)
    return f'<div class="warning" role="status">{lines}</div>'


def _overview(rides: Sequence[RecordedRide], names: Sequence[str], drawn: Sequence[int]) -> str:
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


def _ride(ride: RecordedRide, name: str, view: View) -> str:
    figures = ride.figures
    course = f" on {html_text(figures.course)}" if figures.course else ""
    speed = f" at {figures.speed_mean_m_s:.2f} m/s" if figures.speed_mean_m_s is not None else ""
    parts = [
        f'<section id="{view.key}"><h2>{html_text(name)}{course}{speed}</h2>',
        _outcome(ride.data, figures),
        key_html(_key_figures(figures)),
        view_html(view),
        _section_table(figures),
        "<h3>All figures</h3>",
        _figure_table(figures),
        "</section>",
    ]
    if not len(ride.data.commands):
        parts.insert(4, '<p class="soft">The age of commands is not shown: commands were not recorded.</p>')
    return "\n".join(parts)


def _outcome(ride: Ride, figures: RideFigures) -> str:
    words = {
        "finished": "Reached the end of the course.",
        "fell": "The vehicle fell.",
        "off_course": "The vehicle left the course.",
        "stopped": "The recording of this ride ends before the end of the course.",
    }
    said = [event.text for event in ride.events if event.text and event.kind in ("fall", "off_course", "wall")]
    text = said[0] if said and not figures.completed else words[figures.ended_by]
    return f'<p class="{figures.ended_by}">{html_text(text)}</p>'


def _key_figures(f: RideFigures) -> list[tuple[str, str, str]]:
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


def _section_table(f: RideFigures) -> str:
    if not f.sections:
        return ""
    top = max((s.max_error_m or 0.0) for s in f.sections) or 1.0
    rows = []
    for number, s in enumerate(f.sections, start=1):
        share = 100.0 * (s.max_error_m or 0.0) / top
        bar = f'<td class=bar><i style="width:{share:.1f}%"></i></td>'
        cells = f"<td>{number}&ensp;{html_text(s.name)}</td>{_cell(s.start_m, 1)}{_cell(s.mean_error_m, 3)}"
        rows.append(f"<tr>{cells}{_cell(s.rms_error_m, 3)}{_cell(s.max_error_m, 3)}{bar}</tr>")
    head = "<th>section</th><th>from<br>m</th><th>mean<br>m</th><th>RMS<br>m</th><th>max<br>m</th><th class=bar></th>"
    return f"<h3>Distance to the path by section</h3>{table_html(head, rows)}"


def _figure_table(f: RideFigures) -> str:
    entries: Iterable[tuple[str, str]] = [
        ("duration", f"{f.duration_s:.2f} s"),
        ("distance ridden", f"{f.distance_m:.2f} m"),
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
