"""Pictures of circuits: from above with limits, walls, corners and sectors, and over distance."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.track import Track

FloatArray = NDArray[np.float64]

_INK = "#222222"
_ROAD = "#dcdcdc"
_WALL = "#9a9a9a"
_IDEAL = "#c0392b"
_STRIDE = 10


def draw_track(axes: Axes, track: Track, labels: bool = True) -> None:
    """Draw a circuit from above: road, walls, median, corners, sectors, start and direction; scales in m."""
    rows = slice(None, None, _STRIDE)
    s = track.centre.s[rows]
    left, right = track.points(s, track.width_left[rows]), track.points(s, -track.width_right[rows])
    # Quadrangles instead of one polygon: a circuit that crosses itself on a bridge has no inside.
    quadrangles = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)[:, :, :2]
    axes.add_collection(PolyCollection(list(quadrangles), facecolor=_ROAD, edgecolor=_ROAD, linewidth=0.3, zorder=1))
    for limit in (left, right):
        axes.plot(limit[:, 0], limit[:, 1], color=_INK, linewidth=0.5)
    for wall in track.walls():
        points = track.points(s, wall[rows])
        axes.plot(points[:, 0], points[:, 1], color=_WALL, linewidth=0.7, linestyle=(0, (4, 2)))
    if labels:
        _label_corners(axes, track)
    for name, begin in track.sectors:
        across = track.points(np.array([begin, begin]), np.array([-2.0, 2.0]) * np.max(track.width_left))
        axes.plot(across[:, 0], across[:, 1], color=_INK, linewidth=1.8 if begin == 0.0 else 0.9, label=f"_{name}")
    _draw_direction(axes, track)
    axes.set_aspect("equal")
    axes.set_xlabel("x in m")
    axes.set_ylabel("y in m")


def _label_corners(axes: Axes, track: Track) -> None:
    for corner in track.corners:
        # On the inside, where no run-off is wide.
        sign = 1.0 if corner.angle > 0.0 else -1.0
        width = float(track.at(track.width_left if sign > 0.0 else track.width_right, corner.apex))
        point = track.points(np.array([corner.apex]), sign * (width + min(16.0, 0.9 * corner.radius)))[0]
        axes.text(point[0], point[1], corner.name, fontsize=8, ha="center", va="center", color=_INK, fontweight="bold")


def _draw_direction(axes: Axes, track: Track) -> None:
    reach = 0.035 * track.length
    side = 3.0 * float(np.max(track.width_left))
    arrow = track.points(np.array([0.0, reach]), side)
    (x0, y0), (x1, y1) = arrow[:, :2].tolist()
    axes.annotate("", (x1, y1), xytext=(x0, y0), arrowprops={"arrowstyle": "-|>", "color": _INK})


def draw_line_by_speed(axes: Axes, line: Course, s: FloatArray, speed: FloatArray) -> Colorbar:
    """Draw a line coloured by speed (m/s at arc lengths s), with the scale in km/h."""
    x, y = np.interp(s, line.s, line.x), np.interp(s, line.s, line.y)
    points = np.stack([x, y], axis=1)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    drawn = LineCollection(list(segments), cmap="turbo", linewidths=1.6)
    drawn.set_array(3.6 * 0.5 * (speed[1:] + speed[:-1]))
    axes.add_collection(drawn)
    return axes.figure.colorbar(drawn, ax=axes, label="speed in km/h", shrink=0.7, pad=0.01)


def draw_ideal(axes: Axes, track: Track) -> None:
    """Draw the ideal line from above."""
    line = track.line(1.0)
    axes.plot(line.x, line.y, color=_IDEAL, linewidth=0.9)


def draw_profile_over_distance(axes: Axes, track: Track, column: FloatArray, label: str, colour: str = _INK) -> None:
    """Draw a column of the centre line's samples over distance, with corners shaded and sectors marked."""
    shade_corners(axes, track)
    axes.plot(track.centre.s[::_STRIDE], column[::_STRIDE], color=colour, linewidth=1.0)
    axes.set_ylabel(label)


def shade_corners(axes: Axes, track: Track) -> None:
    """Shade the corners over distance and mark the sectors."""
    for corner in track.corners:
        axes.axvspan(corner.begin, corner.end, color="#e8c170" if corner.angle > 0.0 else "#8fb8de", alpha=0.3, lw=0.0)
    for _, begin in track.sectors:
        axes.axvline(begin, color=_INK, linewidth=0.7, linestyle=":")
    axes.set_xlim(0.0, track.length)


def track_figure(
    track: Track, lap: tuple[Course, FloatArray, FloatArray] | None = None, title: str | None = None
) -> Figure:
    """Return a figure of a circuit.

    Args:
        track: the circuit; its ideal line is drawn if it has one.
        lap: a line, arc lengths on it (m) and speeds there (m/s) to colour it with, or None.
        title: above the map; name, length and direction if None.
    """
    rows = 3 if lap is None else 4
    extent = np.ptp(track.centre.x), np.ptp(track.centre.y)
    tall = float(np.clip(9.0 * (extent[1] + 120.0) / (extent[0] + 120.0), 3.5, 10.0))
    figure = Figure(figsize=(10.0, tall + 1.5 * (rows - 1) + 0.5), layout="constrained")
    axes = figure.subplots(rows, 1, height_ratios=[tall] + [1.5] * (rows - 1))
    draw_track(axes[0], track)
    if lap is not None:
        draw_line_by_speed(axes[0], *lap)
    elif track.ideal is not None:
        draw_ideal(axes[0], track)
    draw_profile_over_distance(axes[1], track, 1e3 * track.centre.curvature, "curvature\nin 1/km")
    draw_profile_over_distance(axes[2], track, track.elevation, "height in m", "#4e7a27")
    if track.ideal is not None:
        line = track.line(1.0)
        along = line.s * track.length / line.length
        axes[1].plot(along[::_STRIDE], 1e3 * line.curvature[::_STRIDE], color=_IDEAL, linewidth=0.8)
    if lap is not None:
        line, s, speed = lap
        shade_corners(axes[3], track)
        axes[3].plot(s * track.length / line.length, 3.6 * speed, color=_INK, linewidth=1.0)
        axes[3].set_ylabel("speed\nin km/h")
    axes[-1].set_xlabel("distance in m")
    axes[0].set_title(
        title or f"{track.name}: {track.length:.0f} m, {track.direction}, {len(track.corners)} corners", fontsize=10
    )
    return figure
