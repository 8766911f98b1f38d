"""The picture of a ride: map and error, drawn by matplotlib for documents that show no page.

Signs are those of the recording: lateral error positive to the left.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bike_analysis.figures.laps import lap_range
from bike_analysis.page.ride_view import map_lines, section_middles
from bike_analysis.page.style import BAND, BLUE, ERROR_MAP, INK, MUTED, ORANGE, RC
from bike_analysis.read.rides import Ride
from bike_analysis.read.tables import Floats

WIDTH: Final = 9.2
"""Width of the picture, inches."""

_POINTS: Final = 1600


def thin(x: NDArray[Any], y: NDArray[Any], points: int = _POINTS) -> tuple[NDArray[Any], NDArray[Any]]:
    """Decimate a line for drawing, keeping the minimum and the maximum of each interval.

    Args:
        x: Abscissae.
        y: Ordinates, of the same length.
        points: Largest number of points wanted.

    Returns:
        x and y of the kept points, in order; everything where there are few enough.
    """
    if len(x) <= points:
        return x, y
    size = -(-len(x) // max(points // 2, 1))
    stretches = -(-len(x) // size)
    padded = np.full(stretches * size, np.nan)
    padded[: len(y)] = y
    rows = padded.reshape(stretches, size)
    lowest = np.argmin(np.where(np.isfinite(rows), rows, np.inf), axis=1)
    highest = np.argmax(np.where(np.isfinite(rows), rows, -np.inf), axis=1)
    keep = np.sort(np.stack([lowest, highest], axis=1) + size * np.arange(stretches)[:, None], axis=1).ravel()
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
        draw_map(figure, upper, ride)
        draw_error(lower, ride)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure


def draw_map(figure: Figure, axes: Axes, ride: Ride) -> None:
    """Draw the map into axes, with its colour scale.

    Args:
        figure: Figure of the axes.
        axes: Where to draw.
        ride: A ride.
    """
    for line in map_lines(ride):
        colour, width, name = (BAND, 5.0, line.name) if line.role == "wanted" else (MUTED, 0.8, None)
        axes.plot(line.x, line.y, color=colour, lw=width, solid_capstyle="butt", label=name)
    states = ride.states
    rows = np.unique(np.linspace(0, len(states) - 1, min(len(states), 1200)).astype(int))
    points = np.column_stack([states.x[rows], states.y[rows]])
    error = np.abs(states.lateral_error[rows])
    top = max(float(np.nanmax(np.abs(states.lateral_error), initial=0.0)), 1e-6)
    driven = LineCollection(
        [*np.stack([points[:-1], points[1:]], axis=1)],
        cmap=ERROR_MAP,
        norm=Normalize(0.0, top),
        linewidths=1.8,
        capstyle="round",
    )
    driven.set_array(np.maximum(error[:-1], error[1:]))
    axes.add_collection(driven)
    _draw_section_numbers(axes, ride)
    _draw_ends(axes, ride)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.set(xlabel="x in m", ylabel="y in m")
    bar = figure.colorbar(driven, ax=axes, location="bottom", aspect=50, fraction=0.05, pad=0.02, shrink=0.6)
    bar.set_label("distance to the path in m")
    bar.outline.set_visible(False)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.0, handlelength=1.2)


def draw_error(axes: Axes, ride: Ride) -> None:
    """Draw the lateral error into axes.

    Args:
        axes: Where to draw.
        ride: A ride.
    """
    states = ride.states
    way, label = _way(ride)
    x, y = thin(way, states.lateral_error)
    axes.axhline(0.0, color=MUTED, lw=0.7)
    axes.fill_between(x, y, 0.0, color=BLUE, alpha=0.18, lw=0)
    axes.plot(x, y, color=BLUE, lw=1.1)
    _draw_sections(axes, ride, way)
    if np.isfinite(states.lateral_error).any():
        row = int(np.nanargmax(np.abs(states.lateral_error)))
        axes.plot(way[row], states.lateral_error[row], "o", color=ORANGE, ms=4.5)
        right = way[row] > 0.75 * way[-1]
        axes.annotate(
            f"max {abs(states.lateral_error[row]):.3f} m",
            (way[row], states.lateral_error[row]),
            textcoords="offset points",
            xytext=(-7 if right else 7, 0),
            ha="right" if right else "left",
            va="center",
            color=ORANGE,
        )
    axes.set(xlabel=label, ylabel="lateral error in m\n(left positive)")
    axes.margins(x=0.01, y=0.12)


def _way(ride: Ride) -> tuple[Floats, str]:
    """Abscissa of figures over distance, and its label."""
    if np.isfinite(ride.states.progress).all():
        return ride.states.progress, "way along the course in m"
    return ride.distance, "distance driven in m"


def _map_height(ride: Ride) -> float:
    """Height of a map in inches that fits the path's own proportions."""
    line_x, line_y = ride.reference_line()
    x, y = np.append(line_x, ride.states.x), np.append(line_y, ride.states.y)
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return 2.5
    across, up = float(np.ptp(x[known])), float(np.ptp(y[known]))
    return float(np.clip((WIDTH - 0.8) * up / max(across, 1e-3), 1.2, 1.2 * WIDTH) + 1.3)


def _draw_ends(axes: Axes, ride: Ride) -> None:
    """Mark the start with an arrow-like triangle and the end by how it came."""
    states = ride.states
    yaw = np.degrees(states.yaw[0]) if np.isfinite(states.yaw[0]) else 90.0
    axes.plot(states.x[0], states.y[0], marker=(3, 0, yaw - 90.0), ms=9, color=INK, ls="", label="start")
    markers = {"fell": ("X", ORANGE, "fall"), "off_course": ("X", ORANGE, "off course")}
    shape, colour, name = markers.get(ride.ended_by, ("s", INK, "end"))
    axes.plot(states.x[-1], states.y[-1], marker=shape, ms=8 if shape == "X" else 5, color=colour, ls="", label=name)


def _draw_section_numbers(axes: Axes, ride: Ride) -> None:
    """Write each section's number at its middle, to the left of the line."""
    for number, place, left in section_middles(ride.course):
        axes.annotate(
            str(number),
            (place[0], place[1]),
            textcoords="offset points",
            xytext=(10.0 * left[0], 10.0 * left[1]),
            ha="center",
            va="center",
            color=MUTED,
            fontsize=8,
        )


def _draw_sections(axes: Axes, ride: Ride, way: Floats) -> None:
    """Mark where sections begin, with their numbers along the upper edge; a closed course repeats them every lap."""
    course = ride.course
    if course is None or not course.section_names:
        return
    first, last = float(way[0]), float(way[-1])
    laps = lap_range(0.0, last, course.length) if course.closed else range(1)
    transform = axes.get_xaxis_transform()
    figure = axes.get_figure(root=True)
    room = 0.18 / (figure.get_figwidth() if figure else WIDTH)  # a number is about 0.15 inches wide
    for lap in laps:
        bounds = np.append(course.section_starts, course.length) + lap * course.length
        for number, (begin, end) in enumerate(pairwise(bounds), start=1):
            begin_seen, end_seen = max(begin, first), min(end, last)
            if begin_seen >= end_seen:
                continue
            axes.axvline(begin_seen, color=MUTED, lw=0.6, ls=(0, (1, 2)))
            if end_seen - begin_seen > room * (last - first):
                middle = 0.5 * (begin_seen + end_seen)
                axes.text(
                    middle, 1.0, str(number), transform=transform, ha="center", va="bottom", color=MUTED, fontsize=8
                )
