"""The report page: one HTML file that needs no network, follows the reader's colour scheme and fits a phone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Final

from bike_analysis.metrics import RideFigures
from bike_analysis.plots import command_figure, error_figure, lean_figure, map_figure
from bike_analysis.reading import Recording
from bike_analysis.rides import Ride
from bike_analysis.style import style_variables, themed_svg

DRAWN_RIDES: Final = 6
"""Rides that are drawn; the table has all of them."""

_STYLE: Final = """
:root { color-scheme: light dark; --page: #ffffff; --card: #f6f7f9; --line: #d9dde3; --soft: #5e6875;
  --good: #00795f; --bad: #b3401a; --font: system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", sans-serif;
  @LIGHT@ }
@media (prefers-color-scheme: dark) {
  :root { --page: #12161b; --card: #1a2027; --line: #2c333c; --soft: #9aa5b3; --good: #43c9a3; --bad: #f2915c;
    @DARK@ } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink); font: 16px/1.5 var(--font);
  -webkit-text-size-adjust: 100%; }
main { max-width: 62rem; margin: 0 auto; padding: 1.5rem 1.1rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .2rem; letter-spacing: -.01em; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 3rem 0 .3rem; padding-top: 1.2rem; border-top: 1px solid var(--line); }
header + h2, header + section > h2 { margin-top: 1.2rem; padding-top: 0; border: 0; }
h3 { font-size: 1rem; margin: 2rem 0 .2rem; }
p { margin: .3rem 0 .8rem; }
.soft, figcaption { color: var(--soft); }
figcaption { font-size: .9rem; max-width: 46rem; }
.warning { border-left: 4px solid var(--bad); background: var(--card); padding: .6rem .9rem; margin: 1rem 0; }
.warning p { margin: 0; }
.key { display: grid; grid-template-columns: repeat(4, 1fr); gap: .6rem; margin: 1rem 0 0; }
.key div { background: var(--card); border-radius: .5rem; padding: .6rem .8rem; }
.key dt { color: var(--soft); font-size: .82rem; }
.key dd { margin: 0; font-size: 1.3rem; font-weight: 600; font-variant-numeric: tabular-nums; white-space: nowrap; }
.key small { font-size: .8rem; font-weight: 400; color: var(--soft); }
figure { margin: .6rem 0 0; }
figure svg { display: block; width: 100%; height: auto; }
.narrow { display: none !important; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .92rem; margin: .6rem 0; width: 100%;
  font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .28rem .6rem; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { font-weight: 600; vertical-align: bottom; }
th:first-child, td:first-child, .text { text-align: left; }
tbody tr:hover { background: var(--card); }
.bar { width: 30%; min-width: 6rem; }
.bar i { display: block; height: .55rem; border-radius: .3rem; background: var(--blue); min-width: 1px; }
.finished { color: var(--good); } .fell, .off_course { color: var(--bad); font-weight: 600; }
.columns { columns: 2 22rem; column-gap: 2.5rem; }
.columns table { margin: 0; } .columns tr { break-inside: avoid; }
.columns td:first-child { white-space: normal; }
a { color: var(--blue); }
@media (max-width: 46rem) {
  main { padding: 1rem .8rem 3rem; } h1 { font-size: 1.35rem; }
  .wide { display: none !important; } .narrow { display: block !important; }
  .key { grid-template-columns: 1fr 1fr; } .key dd { font-size: 1.12rem; }
  th, td { padding: .28rem .35rem; } td:first-child { white-space: normal; } .bar { display: none; }
}
@media print { body { font-size: 11px; } h2 { break-before: page; } }
"""

_ENDS: Final = {"finished": "finished", "fell": "fell", "off_course": "left the course", "stopped": "stopped"}


def render_page(recording: Recording, rides: Sequence[Ride], figures: Sequence[RideFigures]) -> str:
    """Make the report page.

    Args:
        recording: What was read.
        rides: Its rides.
        figures: Their figures, in the same order.

    Returns:
        HTML without any reference to the outside.
    """
    title = f"{recording.path.name}: {len(rides)} ride{'s' if len(rides) != 1 else ''}"
    drawn = _chosen(figures)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<title>{escape(title)}</title><style>{page_style()}</style></head><body><main>",
        f"<header><h1>{escape(recording.path.name)}</h1>{_subtitle(recording, figures)}{_warnings(recording)}</header>",
    ]
    if len(rides) > 1:
        parts.append(_overview(figures, drawn))
    for index in drawn:
        parts.append(_ride(rides[index], figures[index]))
    parts.append("</main></body></html>")
    return "\n".join(parts)


def page_style() -> str:
    """Return the style sheet of report pages."""
    return _STYLE.replace("@LIGHT@", style_variables(dark=False)).replace("@DARK@", style_variables(dark=True))


def _chosen(figures: Sequence[RideFigures]) -> list[int]:
    """Indices of the rides to draw: all if they are few, else the failed ones and those with the largest errors."""
    if len(figures) <= DRAWN_RIDES:
        return list(range(len(figures)))
    worst = sorted(
        range(len(figures)),
        key=lambda i: (figures[i].falls + figures[i].off_course == 0, -(figures[i].max_error_m or 0.0)),
    )
    return sorted(worst[:DRAWN_RIDES])


def _subtitle(recording: Recording, figures: Sequence[RideFigures]) -> str:
    total = sum(f.duration_s for f in figures)
    way = sum(f.distance_m for f in figures)
    words = [f"{total:.1f} s of simulated time, {way:.0f} m, {recording.message_count:,} messages"]
    if recording.vehicle:
        words.append(f"vehicle: {recording.vehicle}")
    words += [f"{name}: {value}" for name, value in recording.notes.items() if name != "vehicle"]
    return f'<p class="soft">{escape(" · ".join(words))}</p>'


def _warnings(recording: Recording) -> str:
    if not recording.warnings:
        return ""
    lines = "".join(f"<p>{escape(w[:1].upper() + w[1:])}.</p>" for w in recording.warnings)
    return f'<div class="warning" role="status">{lines}</div>'


def _overview(figures: Sequence[RideFigures], drawn: Sequence[int]) -> str:
    head = "<th>ride</th><th class=text>course</th><th>speed<br>m/s</th><th>way<br>m</th><th>mean error<br>m</th>"
    head += "<th>RMS error<br>m</th><th>max error<br>m</th><th class=text>end</th>"
    rows = []
    for index, f in enumerate(figures):
        name = f'<a href="#ride-{f.ride}">{f.ride}</a>' if index in drawn else str(f.ride)
        cells = [
            f"<td>{name}</td><td class=text>{escape(f.course or '–')}</td>",
            *(_cell(f.speed_mean_m_s, 2), _cell(f.distance_m, 0)),
            *(_cell(f.mean_error_m, 3), _cell(f.rms_error_m, 3), _cell(f.max_error_m, 3)),
            f'<td class="text {f.ended_by}">{_ENDS[f.ended_by]}</td>',
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    note = ""
    if len(drawn) < len(figures):
        note = f'<p class="soft">Drawn below are the {len(drawn)} with falls or the largest errors.</p>'
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f"<h2>All rides</h2>{note}<div class=scroll>{table}</div>"


def _ride(ride: Ride, figures: RideFigures) -> str:
    course = f" on {escape(figures.course)}" if figures.course else ""
    speed = f" at {figures.speed_mean_m_s:.2f} m/s" if figures.speed_mean_m_s is not None else ""
    prefix = f"r{figures.ride}"
    numbers = " Numbers are its sections, as in the table below." if figures.sections else ""
    return "\n".join(
        [
            f'<section id="ride-{figures.ride}"><h2>Ride {figures.ride}{course}{speed}</h2>',
            _outcome(ride, figures),
            _key_figures(figures),
            "<h3>Path driven over path wanted</h3>",
            _both(map_figure, ride, f"{prefix}m", f"Rear contact point, by its distance to the path.{numbers}"),
            "<h3>Distance to the path</h3>",
            _both(error_figure, ride, f"{prefix}e", "Signed distance of the rear contact point, positive to the left."),
            _section_table(figures),
            "<h3>Lean and steer</h3>",
            _both(
                lean_figure,
                ride,
                f"{prefix}l",
                "Roll is positive leaning right, steer positive to the left. The path's curvature is negated, since a "
                "left turn needs a lean to the left, and scaled by v²/g: where roll lies on it, a small lean balances "
                "the turn. A short steer to the other side before a turn is counter-steering.",
            ),
            "<h3>Command and its delay</h3>",
            _both(
                command_figure,
                ride,
                f"{prefix}c",
                "Steering command in [−1, 1], positive to the left. Its age counts control steps between the state "
                "that it answers and the state from which it was applied; 0 means that the very next step used it.",
            ),
            "<h3>All figures</h3>",
            _figure_table(figures),
            "</section>",
        ]
    )


def _outcome(ride: Ride, figures: RideFigures) -> str:
    words = {
        "finished": "Reached the end of the course.",
        "fell": "The vehicle fell.",
        "off_course": "The vehicle left the course.",
        "stopped": "The recording of this ride ends before the end of the course.",
    }
    said = [event.text for event in ride.events if event.text and event.kind in ("fall", "off_course", "wall")]
    text = said[0] if said and not figures.completed else words[figures.ended_by]
    return f'<p class="{figures.ended_by}">{escape(text)}</p>'


def _key_figures(f: RideFigures) -> str:
    entries = [
        ("mean error", _number(f.mean_error_m, 3), "m"),
        ("RMS error", _number(f.rms_error_m, 3), "m"),
        ("max error", _number(f.max_error_m, 3), "m"),
        ("speed", _number(f.speed_mean_m_s, 2), "m/s"),
        ("way", _number(f.distance_m, 0), "m"),
        ("time", _number(f.duration_s, 1), "s"),
        ("roll", _range(f.roll_min_deg, f.roll_max_deg, 0), "°"),
        ("steer", _range(f.steer_min_deg, f.steer_max_deg, 0), "°"),
    ]
    items = "".join(f"<div><dt>{k}</dt><dd>{v} <small>{unit}</small></dd></div>" for k, v, unit in entries)
    return f'<dl class="key">{items}</dl>'


def _both(draw, ride: Ride, prefix: str, caption: str) -> str:  # type: ignore[no-untyped-def]
    """The same figure for a desk and for a phone; the style shows one of them."""
    pictures = []
    for kind, narrow in (("wide", False), ("narrow", True)):
        svg = themed_svg(draw(ride, narrow=narrow), escape(caption, quote=True), f"{prefix}{kind[0]}")
        pictures.append(f'<div class="{kind}">{svg}</div>')
    return f"<figure>{''.join(pictures)}<figcaption>{escape(caption)}</figcaption></figure>"


def _section_table(f: RideFigures) -> str:
    if not f.sections:
        return ""
    top = max((s.max_error_m or 0.0) for s in f.sections) or 1.0
    rows = []
    for number, s in enumerate(f.sections, start=1):
        share = 100.0 * (s.max_error_m or 0.0) / top
        bar = f'<td class=bar><i style="width:{share:.1f}%"></i></td>'
        cells = f"<td>{number}&ensp;{escape(s.name)}</td>{_cell(s.start_m, 1)}{_cell(s.mean_error_m, 3)}"
        rows.append(f"<tr>{cells}{_cell(s.rms_error_m, 3)}{_cell(s.max_error_m, 3)}{bar}</tr>")
    head = "<th>section</th><th>from<br>m</th><th>mean<br>m</th><th>RMS<br>m</th><th>max<br>m</th><th class=bar></th>"
    return f"<div class=scroll><table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"


def _figure_table(f: RideFigures) -> str:
    entries: Iterable[tuple[str, str]] = [
        ("duration", f"{f.duration_s:.2f} s"),
        ("distance driven", f"{f.distance_m:.2f} m"),
        ("full laps", _number(f.laps, 0)),
        ("speed, lowest to highest", f"{_range(f.speed_min_m_s, f.speed_max_m_s, 3)} m/s"),
        ("largest error at", f"{_number(f.max_error_at_m, 1)} m"),
        ("falls", str(f.falls)),
        ("times off course", str(f.off_course)),
        ("roll", f"{_range(f.roll_min_deg, f.roll_max_deg)} °"),
        ("steer", f"{_range(f.steer_min_deg, f.steer_max_deg)} °"),
        ("roll rate, RMS", f"{_number(f.roll_rate_rms_deg_s, 1)} °/s"),
        ("steer rate, RMS (steering activity)", f"{_number(f.steer_rate_rms_deg_s, 1)} °/s"),
        ("steering torque, RMS", f"{_number(f.steer_torque_rms_nm, 2)} Nm"),
        ("change of the command from step to step, mean", _number(f.command_change_mean, 4)),
        ("recorded steps", f"{f.steps:,}"),
        ("steps missing", str(f.lost_steps)),
        ("states recorded twice", str(f.repeated_states)),
        ("states without a command", _number(f.unanswered_states, 0)),
        ("age of the command, mean", f"{_number(f.command_delay_mean_steps, 2)} steps"),
        ("age of the command, largest", f"{_number(f.command_delay_max_steps, 0)} steps"),
        ("the same in simulated time, mean", f"{_scaled(f.command_delay_mean_s, 1e3, 1)} ms"),
        ("policy's answer, median (wall clock)", f"{_scaled(f.latency_median_s, 1e3, 3)} ms"),
        ("policy's answer, 99th percentile", f"{_scaled(f.latency_p99_s, 1e3, 3)} ms"),
    ]
    rows = "".join(f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in entries)
    return f'<div class="columns"><table><tbody>{rows}</tbody></table></div>'


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}".replace("-", "−")


def _scaled(value: float | None, factor: float, digits: int) -> str:
    return _number(None if value is None else value * factor, digits)


def _range(low: float | None, high: float | None, digits: int = 1) -> str:
    return f"{_number(low, digits)} … {_number(high, digits)}" if low is not None and high is not None else "–"


def _cell(value: float | None, digits: int) -> str:
    return f"<td>{_number(value, digits)}</td>"
