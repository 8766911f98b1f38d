"""The picture of a ride: map and error, drawn by matplotlib for documents that show no page.

Signs are those of the recording: lateral error positive to the left.
"""

from __future__ import annotations

from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from bike_analysis.page.document import BAND, BLUE, ERROR_MAP, INK, MUTED, ORANGE, RC
from bike_analysis.page.ride_view import course_sections, map_lines, section_middles
from bike_analysis.page.view import growing
from bike_analysis.read.messages import Floats
from bike_analysis.read.rides import Ride

WIDTH: Final = 9.2
"""Width of the picture, inches."""
MAP_POINTS: Final = 1200
"""States of the ridden path that are drawn."""
_NUMBER_ROOM: Final = 0.02
"""Least length of a section whose number is written, as a part of the axis."""


def thin(x: Floats, y: Floats, points: int = 1600) -> tuple[Floats, Floats]:
    """Decimate a line to a number of points, keeping the minimum and the maximum of each interval."""
    if len(x) <= points:
        return x, y
    groups = np.array_split(np.arange(len(x)), max(points // 2, 1))
    low, high = (np.where(np.isfinite(y), y, missing) for missing in (np.inf, -np.inf))
    keep = np.unique([g[part] for g in groups for part in (np.argmin(low[g]), np.argmax(high[g]))])
    return x[keep], y[keep]


def overview_figure(ride: Ride, title: str) -> Figure:
    """Draw map and error together, for the picture file.

    Args:
        ride: A ride.
        title: Its headline.

    Returns:
        The figure.
    """
    with mpl.rc_context(RC):
        height = _map_height(ride)
        figure = Figure(figsize=(WIDTH, height + 2.9), layout="constrained")
        FigureCanvasAgg(figure)
        upper, lower = figure.subplots(2, 1, height_ratios=[height, 2.3])
        _draw_map(figure, upper, ride)
        _draw_error(lower, ride)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure


def _map_height(ride: Ride) -> float:
    """Height of a map in inches that fits the path's own proportions."""
    places = np.stack(
        [np.append(*pair) for pair in zip(ride.reference_line(), (ride.states.x, ride.states.y), strict=True)]
    )
    places = places[:, np.isfinite(places).all(axis=0)]
    if not places.size:
        return 2.5
    across, up = np.ptp(places, axis=1)
    return float(np.clip((WIDTH - 0.8) * up / max(across, 1e-3), 1.2, 1.2 * WIDTH) + 1.3)


def _draw_map(figure: Figure, axes: Axes, ride: Ride) -> None:
    """Draw the map into axes, with its colour scale, the sections' numbers, beginning and end."""
    states = ride.states
    for line in map_lines(ride):
        colour, width, name = (BAND, 5.0, line.name) if line.role == "reference" else (MUTED, 0.8, None)
        axes.plot(line.x, line.y, color=colour, lw=width, solid_capstyle="butt", label=name)
    rows = np.unique(np.linspace(0, len(states) - 1, min(len(states), MAP_POINTS)).astype(int))
    points = np.column_stack([states.x[rows], states.y[rows]])
    error = np.abs(states.lateral_error)
    scale = Normalize(0.0, max(float(np.nanmax(error, initial=0.0)), 1e-6))
    pieces = [*np.stack([points[:-1], points[1:]], axis=1)]
    ridden = LineCollection(pieces, cmap=ERROR_MAP, norm=scale, linewidths=1.8, capstyle="round")
    ridden.set_array(np.maximum(error[rows][:-1], error[rows][1:]))
    axes.add_collection(ridden)
    for number, place, left in section_middles(ride.course):
        beside: dict[str, Any] = {
            "textcoords": "offset points",
            "xytext": tuple(10.0 * left),
            "ha": "center",
            "va": "center",
        }
        axes.annotate(str(number), tuple(place), color=MUTED, fontsize=8, **beside)
    yaw = np.degrees(states.yaw[0]) if np.isfinite(states.yaw[0]) else 90.0
    axes.plot(states.x[0], states.y[0], marker=(3, 0, yaw - 90.0), ms=9, color=INK, ls="", label="start")
    failed = {"fell": "fall", "off_course": "off course"}.get(ride.ended_by)
    shape, size, ink = ("X", 8, ORANGE) if failed else ("s", 5, INK)
    axes.plot(states.x[-1], states.y[-1], marker=shape, ms=size, color=ink, ls="", label=failed or "end")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set(xlabel="x in m", ylabel="y in m")
    bar = figure.colorbar(ridden, ax=axes, location="bottom", aspect=50, fraction=0.05, pad=0.02, shrink=0.6)
    bar.set_label("distance to the path in m")
    bar.outline.set_visible(False)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.0, handlelength=1.2)


def _draw_error(axes: Axes, ride: Ride) -> None:
    """Draw the lateral error over arc length, with its maximum and where sections begin."""
    error = ride.states.lateral_error
    along = np.isfinite(ride.states.progress).all()
    distance = ride.states.progress if along else ride.distance
    axes.axhline(0.0, color=MUTED, lw=0.7)
    x, y = thin(distance, error)
    axes.fill_between(x, y, 0.0, color=BLUE, alpha=0.18, lw=0)
    axes.plot(x, y, color=BLUE, lw=1.1)
    length = float(distance[-1] - distance[0])
    for section in course_sections(ride, growing(distance)) if along else ():
        begin, end = float(distance[section["first"]]), float(distance[section["last"]])
        axes.axvline(begin, color=MUTED, lw=0.6, ls=(0, (1, 2)))
        if end - begin > _NUMBER_ROOM * length:
            above: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom"}
            axes.text(0.5 * (begin + end), 1.0, section["label"], color=MUTED, fontsize=8, **above)
    if np.isfinite(error).any():
        row = int(np.nanargmax(np.abs(error)))
        axes.plot(distance[row], error[row], "o", color=ORANGE, ms=4.5)
        right = distance[row] - distance[0] > 0.75 * length
        placed: dict[str, Any] = {"xytext": (-7 if right else 7, 0), "ha": "right" if right else "left", "va": "center"}
        words = f"max {abs(error[row]):.3f} m"
        axes.annotate(words, (distance[row], error[row]), textcoords="offset points", color=ORANGE, **placed)
    label = "arc length along the course in m" if along else "distance ridden in m"
    axes.set(xlabel=label, ylabel="lateral error in m\n(left positive)")
    axes.margins(x=0.01, y=0.12)
