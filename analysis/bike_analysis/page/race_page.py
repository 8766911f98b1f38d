"""The page of a race: result, positions over the lines of the laps, all machines on one map and in one view, events.

The view is that of compared rides: gaps at the same place, traces side by side, and the race from behind any machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.figures.numbers import lap_text
from bike_analysis.page.document import html_text, number_text, page_shell, program_version, row_html, table_html
from bike_analysis.page.ride_view import closed, limit_lines, road_spec
from bike_analysis.page.view import FAST_CHANNELS, PANELS, MapLine, Series, View, growing, series_colour, view_html
from bike_sim.course.course import Course

FloatArray = NDArray[np.float64]

PAGE_NAME: Final = "race.html"
_WIDTH, _ROW, _LEFT, _RIGHT = 900.0, 34.0, 110.0, 40.0
_GAP: Final = {
    "title": "Gap",
    "caption": "Time after the machine chosen above at the same place; below zero it is ahead.",
}
_LEAN: Final = {"title": "Lean", "caption": "Positive leaning right.", "lines": PANELS["lean"]["lines"][-1:]}


@dataclass(frozen=True)
class Racer:
    """A machine as the page shows it.

    Attributes:
        name: of machine and rider.
        grid: its place there, from 1.
        columns: time (s), distance from the start line (m), x, y, yaw, and what the panels show, until it is out.
        end: how its race ended in a word, where it did before the flag; else empty.
        contacts: times at which it touched another, s.
    """

    name: str
    grid: int
    columns: Mapping[str, FloatArray]
    end: str
    contacts: Sequence[float] = ()


@dataclass(frozen=True)
class RaceFigures:
    """What the page shows of a race.

    Attributes:
        title: headline.
        classification: lines of the result, by name of column.
        gaps: lap, sector, machine and time after the first at each line, s.
        events: time (s) and sentence of what happened.
        racers: the machines, in the order of the grid.
        circuit: its centre line with the limits.
        powered: whether the machines have engines.
    """

    title: str
    classification: Sequence[Mapping[str, Any]]
    gaps: Sequence[tuple[int, int, str, float]]
    events: Sequence[tuple[float, str]]
    racers: Sequence[Racer]
    circuit: Course
    powered: bool


def write_race_page(figures: RaceFigures, path: Path) -> Path:
    """Write the page of a race.

    Raises:
        OSError: the page cannot be written.
    """
    view = _view(figures)
    events = [row_html(lap_text(t), [_cell(text)]) for t, text in figures.events]
    parts = [
        _result(figures.classification),
        "<h2>Positions over the lines of the laps</h2>",
        _positions(figures.racers, figures.gaps),
        "<h2>The race</h2>",
        view_html(view),
        "<h2>What happened</h2>",
        table_html("<th>time</th><th class=text>event</th>", events),
    ]
    below = f"<p>{html_text(program_version())}</p>"
    path.write_text(page_shell(figures.title, below, parts, (view,)), encoding="utf-8")
    return path


def _view(figures: RaceFigures) -> View:
    course, powered = figures.circuit, figures.powered
    series = tuple(
        Series(
            racer.name,
            {name: growing(c) if name in ("time", "distance") else c for name, c in racer.columns.items()},
            series_colour(number),
            kind=racer.end,
        )
        for number, racer in enumerate(figures.racers)
    )
    keys = ("throttle", "brake") if powered else ()
    plain = (PANELS["speed"], PANELS["delta"] | _GAP, PANELS["lean"] | _LEAN, *(PANELS[key] for key in keys))
    panels = tuple(panel | {"lines": [line | {"fill": ""} for line in panel["lines"]]} for panel in plain)
    return View(
        "race",
        figures.title,
        series,
        panels,
        (MapLine("centre line", "reference", *closed(course, course.x, course.y)), *limit_lines(course)),
        map_caption="All machines at the time of the cursor; who is out is cleared away.",
        channels=FAST_CHANNELS if powered else {},
        follow=road_spec(figures.title, course, powered),
        moments=tuple(
            {"series": number, "row": row, "label": label}
            for number, racer in enumerate(figures.racers)
            for row, label in _moments(racer)
        ),
        reference=0,
        leads=True,
    )


def _moments(racer: Racer) -> list[tuple[int, str]]:
    """Return rows of a machine's columns and what happened there: contacts, and its end."""
    time = racer.columns["time"]
    rows = np.searchsorted(time, [t for t in racer.contacts if t <= time[-1]]).tolist()
    return [(row, "contact") for row in rows] + ([(len(time) - 1, racer.end)] if racer.end else [])


def _cell(text: str) -> str:
    return f"<td class=text>{html_text(text, 200)}</td>"


def _result(lines: Sequence[Mapping[str, Any]]) -> str:
    heads = ("position", "machine", "vehicle", "rider", "grid", "laps", "time", "penalty in s", "best lap", "passes",
             "contacts", "end")  # fmt: skip
    rows = []
    for line in lines:
        texts = (
            line["name"], line["vehicle"], line["rider"], line["grid"], line["laps"],
            "–" if line["time_s"] is None else lap_text(line["time_s"]), number_text(line["penalty_s"], 1),
            "–" if line["best_lap_s"] is None else lap_text(line["best_lap_s"]), number_text(line["passes"], 0, "+"),
            line["contacts"], line["end"].replace("_", " "),
        )  # fmt: skip
        rows.append(row_html(str(line["position"]), [_cell(str(text)) for text in texts]))
    return table_html("".join(f"<th class=text>{head}</th>" for head in heads), rows)


def _positions(racers: Sequence[Racer], gaps: Sequence[tuple[int, int, str, float]]) -> str:
    """Return the positions from the grid over all lines that were crossed, as SVG; a cross ends who is out."""
    places = {key: place for place, key in enumerate(sorted({(lap, sector) for lap, sector, _, _ in gaps}), start=1)}
    found: dict[str, list[tuple[int, int]]] = {racer.name: [(0, racer.grid)] for racer in racers}
    for key, place in places.items():
        order = sorted((gap, name) for lap, sector, name, gap in gaps if (lap, sector) == key)
        for position, (_, name) in enumerate(order, start=1):
            found[name].append((place, position))
    last, height = max(places.values(), default=1), _ROW * len(racers) + 36.0

    def at(place: float, position: float) -> tuple[float, float]:
        return _LEFT + place / last * (_WIDTH - _LEFT - _RIGHT), _ROW * (position - 0.5)

    parts = []
    ticks = {0: "grid"} | {place: f"{lap}.{sector}" for (lap, sector), place in places.items()}
    for place, text in ticks.items():
        x = at(place, 1.0)[0]
        parts.append(_line(((x, 4.0), (x, height - 28.0)), "grid", 1.0))
        parts.append(_text(x, height - 10.0, "middle", "ink", text))
    for number, racer in enumerate(racers):
        colour, points = series_colour(number), [at(*point) for point in found[racer.name]]
        parts.append(_line(points, colour, 2.5))
        (x, y), (end_x, end_y) = points[0], points[-1]
        parts.append(_text(x - 8.0, y + 4.0, "end", colour, racer.name))
        if racer.end:
            cross = "M-5,-5 L5,5 M-5,5 L5,-5"
            style = f'style="stroke:var(--{colour})" stroke-width="2.5" fill="none"'
            parts.append(f'<path transform="translate({end_x:.1f},{end_y:.1f})" d="{cross}" {style}/>')
        else:
            parts.append(_text(end_x + 8.0, end_y + 4.0, "start", colour, str(found[racer.name][-1][1])))
    words = "Lap and sector whose end was crossed. A cross is who is out."
    picture = f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" aria-label="Positions">{"".join(parts)}</svg>'
    return f'{picture}<p class="soft">{words}</p>'


def _line(points: Sequence[tuple[float, float]], colour: str, width: float) -> str:
    way = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{way}" fill="none" style="stroke:var(--{colour})" stroke-width="{width:g}"/>'


def _text(x: float, y: float, anchor: str, colour: str, text: str) -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="12"'
    return f'<text {place} style="fill:var(--{colour})">{html_text(text, 16)}</text>'
