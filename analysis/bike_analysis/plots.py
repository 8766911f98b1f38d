"""Figures of one ride.

Each function makes a figure of its own, wide for a desk or narrow for a phone, and draws thinned-out lines where there
are more points than can be seen (`thin` keeps every extreme). Signs are those of the recording: roll positive leaning
right, steer and lateral error positive to the left.
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
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from bike_analysis.metrics import command_delay
from bike_analysis.reading import Floats
from bike_analysis.rides import Ride
from bike_analysis.style import BAND, BLUE, ERROR_MAP, GRID, INK, MUTED, ORANGE, RC

GRAVITY: Final = 9.81
"""m/s^2, as in the benchmark of Meijaard et al. (2007)."""
WIDE: Final = 9.2
"""Width of a figure for a desk, inches."""
NARROW: Final = 4.3
"""Width of a figure for a phone, inches."""

_POINTS: Final = 1600
_ZOOM_S: Final = 4.0


def thin(x: NDArray[Any], y: NDArray[Any], points: int = _POINTS) -> tuple[NDArray[Any], NDArray[Any]]:
    """Thin out a line for drawing, keeping the smallest and the largest value of each stretch.

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


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure that belongs to no window.

    Args:
        width: Inches.
        height: Inches.

    Returns:
        The figure, laid out by constraints.
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def map_figure(ride: Ride, narrow: bool = False) -> Figure:
    """Draw the path driven by the rear contact over the path wanted, coloured by the distance between them.

    Args:
        ride: A ride.
        narrow: For a phone.

    Returns:
        The figure, with equal scales on both axes.
    """
    width = NARROW if narrow else WIDE
    with mpl.rc_context(RC):
        figure = new_figure(width, _map_height(ride, width))
        draw_map(figure, figure.add_subplot(), ride, narrow)
    return figure


def error_figure(ride: Ride, narrow: bool = False) -> Figure:
    """Draw the lateral error of the rear contact over the way along the course, with the course's sections.

    Args:
        ride: A ride.
        narrow: For a phone.

    Returns:
        The figure.
    """
    with mpl.rc_context(RC):
        figure = new_figure(NARROW if narrow else WIDE, 2.5)
        draw_error(figure.add_subplot(), ride)
    return figure


def lean_figure(ride: Ride, narrow: bool = False) -> Figure:
    """Draw roll, steer and negated curvature over the way along the course (Weyrer et al. 2026, Fig. 12).

    A left turn (positive curvature) needs a lean to the left (negative roll), which is why the curvature is negated.
    Its axis is scaled by v^2/g, so that it lies on the roll where a small lean balances the turn, that is where
    tan(roll) = -v^2 curvature / g.

    Args:
        ride: A ride.
        narrow: For a phone.

    Returns:
        The figure.
    """
    with mpl.rc_context(RC):
        figure = new_figure(NARROW if narrow else WIDE, 3.2)
        draw_lean(figure, figure.add_subplot(), ride)
    return figure


def command_figure(ride: Ride, narrow: bool = False) -> Figure:
    """Draw the steering command over time, a close look at the largest error, and the age of the applied command.

    Args:
        ride: A ride.
        narrow: For a phone.

    Returns:
        The figure.
    """
    with mpl.rc_context(RC):
        figure = new_figure(NARROW if narrow else WIDE, 5.4 if narrow else 4.6)
        whole, close, delay = figure.subplots(3, 1, height_ratios=[1.0, 1.0, 0.7])
        _draw_commands(whole, ride, close=False)
        _draw_commands(close, ride, close=True)
        middle = ride.time[int(np.argmax(np.nan_to_num(np.abs(ride.states.lateral_error))))]
        first = min(max(0.0, middle - _ZOOM_S / 2), max(0.0, ride.time[-1] - _ZOOM_S))
        close.set_xlim(first, first + min(_ZOOM_S, max(ride.time[-1], 0.1)))
        _fit_command_axis(close, ride)
        whole.axvspan(*close.get_xlim(), color=GRID, lw=0)
        if not narrow:
            close.set_title("close look at the largest error", loc="left", color=MUTED)
        _draw_delay(delay, ride)
        figure.align_ylabels()
    return figure


def overview_figure(ride: Ride, title: str) -> Figure:
    """Draw map and error together, for the picture file.

    Args:
        ride: A ride.
        title: Its headline.

    Returns:
        The figure.
    """
    with mpl.rc_context({**RC, "figure.facecolor": "white", "savefig.facecolor": "white"}):
        height = _map_height(ride, WIDE)
        figure = new_figure(WIDE, height + 2.9)
        upper, lower = figure.subplots(2, 1, height_ratios=[height, 2.3])
        draw_map(figure, upper, ride, narrow=False)
        draw_error(lower, ride)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure


def draw_map(figure: Figure, axes: Axes, ride: Ride, narrow: bool) -> None:
    """Draw the map into axes, with its colour scale.

    Args:
        figure: Figure of the axes.
        axes: Where to draw.
        ride: A ride.
        narrow: For a phone.
    """
    line_x, line_y = ride.reference_line()
    axes.plot(line_x, line_y, color=BAND, lw=5.0, solid_capstyle="butt", label="path wanted")
    _draw_limits(axes, ride)
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
    _draw_section_numbers(axes, ride, narrow)
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


def draw_lean(figure: Figure, axes: Axes, ride: Ride) -> None:
    """Draw roll, steer and negated curvature into axes.

    Args:
        figure: Figure of the axes.
        axes: Where to draw.
        ride: A ride.
    """
    states = ride.states
    way, label = _way(ride)
    speed = float(np.nanmean(states.speed)) if np.isfinite(states.speed).any() else np.nan
    balance = np.degrees(speed**2 / GRAVITY)  # degrees of lean for a curvature of 1 1/m, small angles
    if not np.isfinite(balance) or balance < 1.0:
        balance = np.degrees(1.0)
    handles: list[Any] = []
    if np.isfinite(states.curvature).any():
        x, y = thin(way, -balance * states.curvature)
        handles.append(axes.fill_between(x, y, 0.0, color=BAND, alpha=0.75, lw=0, label="−κ of the path"))
    for values, colour, name in ((states.steer, ORANGE, "steer δ"), (states.roll, BLUE, "roll φ")):
        handles += axes.plot(*thin(way, np.degrees(values)), color=colour, lw=1.1, label=name)
    axes.axhline(0.0, color=MUTED, lw=0.7)
    axes.margins(x=0.01)
    low, high = axes.get_ylim()
    _draw_sections(axes, ride, way)
    axes.set_ylim(low, high)
    other = axes.twinx()
    other.set_ylim(low / balance, high / balance)
    other.grid(False)
    other.spines["right"].set_visible(True)
    other.spines["right"].set_color(MUTED)
    other.set_ylabel("−κ in 1/m")
    axes.set(xlabel=label, ylabel="angle in °")
    figure.legend(handles=handles[::-1], loc="outside upper left", ncols=3, handlelength=1.4)


def _way(ride: Ride) -> tuple[Floats, str]:
    """Abscissa of figures over distance, and its label."""
    if np.isfinite(ride.states.progress).all():
        return ride.states.progress, "way along the course in m"
    return ride.distance, "distance driven in m"


def _map_height(ride: Ride, width: float) -> float:
    """Height of a map in inches that fits the path's own proportions."""
    line_x, line_y = ride.reference_line()
    x, y = np.append(line_x, ride.states.x), np.append(line_y, ride.states.y)
    across, up = float(np.nanmax(x) - np.nanmin(x)), float(np.nanmax(y) - np.nanmin(y))
    return float(np.clip((width - 0.8) * up / max(across, 1e-3), 1.2, 1.2 * width) + 1.3)


def _draw_limits(axes: Axes, ride: Ride) -> None:
    course = ride.course
    if course is None or len(course.width_left) != len(course.x) or len(course.width_right) != len(course.x):
        return
    heading = np.unwrap(np.arctan2(np.gradient(course.y), np.gradient(course.x)))
    for side, width in ((1.0, course.width_left), (-1.0, course.width_right)):
        x, y = course.x - side * width * np.sin(heading), course.y + side * width * np.cos(heading)
        axes.plot(x, y, color=MUTED, lw=0.8, label="limits" if side > 0 else None)


def _draw_ends(axes: Axes, ride: Ride) -> None:
    """Mark the start with an arrow-like triangle and the end by how it came."""
    states = ride.states
    yaw = np.degrees(states.yaw[0]) if np.isfinite(states.yaw[0]) else 90.0
    axes.plot(states.x[0], states.y[0], marker=(3, 0, yaw - 90.0), ms=9, color=INK, ls="", label="start")
    markers = {"fell": ("X", ORANGE, "fall"), "off_course": ("X", ORANGE, "off course")}
    shape, colour, name = markers.get(ride.ended_by, ("s", INK, "end"))
    axes.plot(states.x[-1], states.y[-1], marker=shape, ms=8 if shape == "X" else 5, color=colour, ls="", label=name)


def _draw_section_numbers(axes: Axes, ride: Ride, narrow: bool) -> None:
    """Write each section's number beside the middle of it, to the left of the line."""
    course = ride.course
    if course is None or len(course.x) < 3 or not course.section_names:
        return
    bounds = np.append(course.section_starts, course.length)
    for number, middle in enumerate(0.5 * (bounds[:-1] + bounds[1:]), start=1):
        at = int(np.clip(np.searchsorted(course.s, middle), 1, len(course.s) - 2))
        dx, dy = course.x[at + 1] - course.x[at - 1], course.y[at + 1] - course.y[at - 1]
        scale = (8.0 if narrow else 10.0) / max(float(np.hypot(dx, dy)), 1e-9)
        axes.annotate(
            str(number),
            (course.x[at], course.y[at]),
            textcoords="offset points",
            xytext=(-scale * dy, scale * dx),
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
    laps = range(int(last // course.length) + 1) if course.closed and course.length > 0.0 else range(1)
    transform = axes.get_xaxis_transform()
    figure = axes.get_figure(root=True)
    room = 0.18 / (figure.get_figwidth() if figure else WIDE)  # a number is about 0.15 inches wide
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


def _draw_commands(axes: Axes, ride: Ride, close: bool) -> None:
    states, commands = ride.states, ride.commands
    start = states.time_s[0]
    axes.axhline(0.0, color=MUTED, lw=0.7)
    if close:
        limit = np.where(states.steering_limit > 0.0, states.steering_limit, np.nan)
        if np.isfinite(limit).any():
            axes.plot(ride.time, states.steer / limit, color=BAND, lw=2.0, label="steer reached")
        axes.step(ride.time, states.steering_command, where="pre", color=BLUE, lw=1.3, label="applied")
        if len(commands):
            given: dict[str, Any] = dict(ls="", marker="o", ms=3.2, color=ORANGE, label="given")
            axes.plot(commands.time_s - start, commands.steering, **given)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1, handlelength=1.2)
    else:
        axes.plot(*thin(ride.time, states.steering_command), color=BLUE, lw=0.9)
    axes.set(ylabel="steering\ncommand", xlabel="time in s" if close else None)
    axes.margins(x=0.01)


def _fit_command_axis(axes: Axes, ride: Ride) -> None:
    """Fit the vertical axis to what is seen in the horizontal one."""
    low, high = axes.get_xlim()
    states = ride.states
    rows = (ride.time >= low) & (ride.time <= high)
    limit = np.where(states.steering_limit > 0.0, states.steering_limit, np.nan)
    seen = np.concatenate([states.steering_command[rows], (states.steer / limit)[rows]])
    seen = seen[np.isfinite(seen)]
    if len(seen):
        pad = 0.12 * max(float(np.ptp(seen)), 0.02)
        axes.set_ylim(float(seen.min()) - pad, float(seen.max()) + pad)


def _draw_delay(axes: Axes, ride: Ride) -> None:
    delay = command_delay(ride)
    axes.set(ylabel="age of the\ncommand\nin steps", xlabel="time in s", xlim=(0.0, max(float(ride.time[-1]), 0.1)))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=2))
    if not len(delay.rows):
        axes.text(0.5, 0.5, "commands were not recorded", transform=axes.transAxes, ha="center", color=MUTED)
        return
    x, y = thin(ride.time[delay.rows], delay.steps.astype(float))
    axes.fill_between(x, y, 0.0, step="pre", color=BLUE, alpha=0.18, lw=0)
    axes.step(x, y, where="pre", color=BLUE, lw=1.1)
    axes.set_ylim(-0.1, max(1.0, float(delay.steps.max())) * 1.15)
