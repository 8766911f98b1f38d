"""The page of a race: result, positions and gaps over the lines of the laps, and the map with all machines moving.

Pictures are SVG and move without a script, so the page is small and a browser needs no JavaScript for it.
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
from bike_analysis.page.view import SERIES_COLOURS

FloatArray = NDArray[np.float64]

PAGE_NAME: Final = "race.html"
FRAMES: Final = 400
"""Places of each machine on the moving map."""
SPEED_UP: Final = 10.0
"""How much faster than the race the map moves."""
_WIDTH, _HEIGHT, _LEFT, _BELOW = 900.0, 320.0, 110.0, 30.0
_MAP: Final = 900.0


@dataclass(frozen=True)
class RaceFigures:
    """What the page shows of a race.

    Attributes:
        title: headline.
        classification: lines of the result, by name of column.
        gaps: lap, sector, machine and time after the first at each line, s.
        events: time (s) and sentence of what happened.
        names: of the machines, in the order of the grid.
        x: places of the machines, m, shape (steps, n).
        y: the same, m.
        duration: of the race, s.
        limits: left and right limit, x and y, m, shape (2, 2, k).
    """

    title: str
    classification: Sequence[Mapping[str, Any]]
    gaps: Sequence[tuple[int, int, str, float]]
    events: Sequence[tuple[float, str]]
    names: Sequence[str]
    x: FloatArray
    y: FloatArray
    duration: float
    limits: FloatArray


def write_race_page(figures: RaceFigures, path: Path) -> Path:
    """Write the page of a race.

    Raises:
        OSError: the page cannot be written.
    """
    positions = _positions(figures.gaps)
    gaps = {name: [(line, gap) for line, gap in points] for name, points in _by_name(figures.gaps).items()}
    parts = [
        _result(figures.classification),
        "<h2>Positions over the lines of the laps</h2>",
        _chart(figures.names, positions, "position", 1.0),
        "<h2>Gaps to the first</h2>",
        _chart(figures.names, gaps, "s", 0.0),
        "<h2>Map</h2>",
        f"<p>All machines, {SPEED_UP:g} times as fast.</p>",
        _map(figures),
        "<h2>What happened</h2>",
        table_html("<th>time</th><th>event</th>", [row_html(lap_text(t), [_cell(text)]) for t, text in figures.events]),
    ]
    below = f"<p>{html_text(program_version())}</p>"
    path.write_text(page_shell(figures.title, below, parts, ()), encoding="utf-8")
    return path


def _cell(text: str) -> str:
    return f"<td class=text>{html_text(text, 200)}</td>"


def _result(lines: Sequence[Mapping[str, Any]]) -> str:
    heads = ("position", "machine", "rider", "grid", "laps", "time", "penalty", "best lap", "passes", "contacts", "end")
    rows = []
    for line in lines:
        texts = (
            line["name"], line["rider"], line["grid"], line["laps"],
            "–" if line["time_s"] is None else lap_text(line["time_s"]), number_text(line["penalty_s"], 1),
            "–" if line["best_lap_s"] is None else lap_text(line["best_lap_s"]), f"{line['passes']:+d}",
            line["contacts"], line["end"].replace("_", " "),
        )  # fmt: skip
        rows.append(row_html(str(line["position"]), [_cell(str(text)) for text in texts]))
    return table_html("".join(f"<th>{head}</th>" for head in heads), rows)


def _by_name(gaps: Sequence[tuple[int, int, str, float]]) -> dict[str, list[tuple[int, float]]]:
    """Return the gaps of each machine over the numbers of the lines that it crossed."""
    lines = {key: place for place, key in enumerate(sorted({(lap, sector) for lap, sector, _, _ in gaps}))}
    found: dict[str, list[tuple[int, float]]] = {}
    for lap, sector, name, gap in gaps:
        found.setdefault(name, []).append((lines[lap, sector], gap))
    return found


def _positions(gaps: Sequence[tuple[int, int, str, float]]) -> dict[str, list[tuple[int, float]]]:
    """Return the position of each machine over the numbers of the lines that it crossed."""
    found: dict[str, list[tuple[int, float]]] = {}
    by_name = _by_name(gaps)
    for line in sorted({line for points in by_name.values() for line, _ in points}):
        order = sorted((gap, name) for name, points in by_name.items() for at, gap in points if at == line)
        for position, (_, name) in enumerate(order, start=1):
            found.setdefault(name, []).append((line, float(position)))
    return found


def _chart(names: Sequence[str], curves: Mapping[str, Sequence[tuple[int, float]]], unit: str, least: float) -> str:
    """Return curves over the numbers of lines, the least value on top."""
    values = [value for points in curves.values() for _, value in points]
    lines = max((line for points in curves.values() for line, _ in points), default=1) or 1
    most = max([least + 1.0, *values])
    parts = []
    for place, name in enumerate(names):
        colour = SERIES_COLOURS[place % len(SERIES_COLOURS)]
        points = [
            (_LEFT + line / lines * (_WIDTH - _LEFT - 10.0), 12.0 + (value - least) / (most - least) * (_HEIGHT - 50.0))
            for line, value in curves.get(name, ())
        ]
        way = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        dash = "" if place < len(SERIES_COLOURS) else ' stroke-dasharray="6 4"'
        parts.append(f'<polyline points="{way}" fill="none" style="stroke:var(--{colour})" stroke-width="2.5"{dash}/>')
        if points:
            parts.append(
                f'<text x="{_LEFT - 6:.0f}" y="{points[0][1] + 4:.1f}" text-anchor="end" font-size="12" '
                f'style="fill:var(--{colour})">{html_text(name, 16)}</text>'
            )
    scale = (
        f'<text x="{_WIDTH - 8:.0f}" y="{_HEIGHT - 8:.0f}" text-anchor="end" font-size="12" style="fill:var(--ink)">'
        f"lines crossed, 0 to {lines}; {least:g} to {most:.1f} {unit} downwards</text>"
    )
    return f'<svg viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img">{"".join(parts)}{scale}</svg>'


def _map(figures: RaceFigures) -> str:
    x, y = figures.limits[:, 0].ravel(), figures.limits[:, 1].ravel()
    size = max(np.ptp(x), np.ptp(y), 1.0)
    height = _MAP * np.ptp(y) / size + 20.0

    def place(px: FloatArray, py: FloatArray) -> tuple[FloatArray, FloatArray]:
        return 10.0 + (px - x.min()) / size * (_MAP - 20.0), height - 10.0 - (py - y.min()) / size * (_MAP - 20.0)

    parts = []
    for side in figures.limits:
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*place(side[0], side[1]), strict=True))
        parts.append(f'<polyline points="{points}" fill="none" style="stroke:var(--ink)" stroke-width="1"/>')
    chosen = np.unique(np.linspace(0, len(figures.x) - 1, min(FRAMES, len(figures.x))).astype(int))
    time = figures.duration / SPEED_UP
    for row, name in enumerate(figures.names):
        px, py = place(figures.x[chosen, row], figures.y[chosen, row])
        colour = SERIES_COLOURS[row % len(SERIES_COLOURS)]
        moves = "".join(
            f'<animate attributeName="{axis}" dur="{time:.2f}s" repeatCount="indefinite" '
            f'values="{";".join(f"{value:.1f}" for value in values)}"/>'
            for axis, values in (("cx", px), ("cy", py))
        )
        parts.append(
            f'<circle cx="{px[0]:.1f}" cy="{py[0]:.1f}" r="6" style="fill:var(--{colour})">'
            f"<title>{html_text(name)}</title>{moves}</circle>"
        )
    return f'<svg viewBox="0 0 {_MAP:.0f} {height:.0f}" role="img">{"".join(parts)}</svg>'
