"""The road of the view from behind: edges and line as ``follow_view.js`` takes them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from bike_analysis.read.tables import Floats
from bike_analysis.read.text import shown

ROAD_POINTS: Final = 1500
"""Most points of each edge."""
PATH_HALF_WIDTH: Final = 1.5
"""Half of the width of the road that is drawn about a path without limits, m."""
STEPS: Final = {True: 4.0, False: 1.0}
"""Distance of the road's points for machines with and without an engine, m."""


def edge(x: Floats, y: Floats, heading: Floats, side: float, width: Floats | None) -> tuple[Floats, Floats]:
    """Edge of a road on the left (`side` 1) or on the right (-1) of a line; `PATH_HALF_WIDTH` away without limits."""
    away = side * (np.full(len(x), PATH_HALF_WIDTH) if width is None else width)
    return x - away * np.sin(heading), y + away * np.cos(heading)


def follow_spec(
    title: str, line: tuple[Floats, Floats, Floats], edges: tuple[Floats, ...], closed: bool, powered: bool
) -> dict[str, Any]:
    """Return the data of a view from behind.

    Args:
        title: Above the instruments.
        line: Arc length from 0 in equal steps, x and y of the followed line, m.
        edges: x and y of the left edge, then of the right one, at the same places.
        closed: Whether the line ends where it begins.
        powered: Whether the machine has an engine: its speed is in km/h.
    """
    s, x, y = line
    every = max(1, -(-len(s) // ROAD_POINTS), round(STEPS[powered] / float(s[1])))
    return {
        "title": shown(title),
        "lapTime": "",
        "step": float(s[1]) * every,
        "edges": [_rounded(values[::every]) for values in edges],
        "line": [_rounded(x[::every]), _rounded(y[::every])],
        "open": not closed,
        "unit": "km/h" if powered else "m/s",
        "machine": "superbike" if powered else "bicycle",
    }


def _rounded(values: Floats) -> list[float]:
    return [round(float(value), 2) for value in values]
