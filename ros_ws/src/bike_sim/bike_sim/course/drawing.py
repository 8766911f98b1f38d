"""Pictures of courses: the line from above with its sections and limits, and its curvature.

``python -m bike_sim.course.drawing FOLDER`` draws the pictures of docs/reference/courses.md, and the random circuits of
docs/reference/circuits.md.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colors
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.files import load_course, shipped_courses
from bike_sim.course.projection import point_at
from bike_sim.course.random_courses import CURRICULUM_PATHS, random_circuit, random_course
from bike_sim.course.track import Track

FloatArray = NDArray[np.float64]

_INK = "#222222"
_STRAIGHT = "#8a8a8a"
_LIMIT = "#bbbbbb"


def section_spans(course: Course) -> list[tuple[str, float, float]]:
    """Return name, first and last arc length (m) of each section; the whole course if it has none."""
    if not course.sections:
        return [(course.name, 0.0, course.length)]
    ends = [begin for _, begin in course.sections[1:]] + [course.length]
    return [(name, begin, end) for (name, begin), end in zip(course.sections, ends, strict=True)]


def section_colours(course: Course) -> list[str]:
    """Return one colour a section; straights are grey."""
    palette = itertools.cycle(f"C{i}" for i in range(7))
    colours = []
    for _, begin, end in section_spans(course):
        inside = (course.s >= begin) & (course.s < end)
        bent = bool(np.any(np.abs(course.curvature[inside]) > 1e-9))
        colours.append(colors.to_hex(next(palette)) if bent else _STRAIGHT)
    return colours


def draw_map(axes: Axes, course: Course) -> None:
    """Draw a course from above: its limits (or how far a ride may leave it), its sections, start and direction.

    Args:
        axes: where to draw; equal scales are set, in m.
        course: what to draw.
    """
    left = course.off_course_limit if course.width_left is None else course.width_left
    right = course.off_course_limit if course.width_right is None else course.width_right
    style = ":" if course.width_left is None else "-"
    for offset in (left, -right):
        # A limit farther inside a curve than its centre would run backwards.
        shown = np.where(offset * course.curvature < 1.0, offset, np.nan)
        axes.plot(
            course.x - shown * np.sin(course.heading),
            course.y + shown * np.cos(course.heading),
            color=_LIMIT,
            linestyle=style,
            linewidth=0.8,
        )
    for (name, begin, end), colour in zip(section_spans(course), section_colours(course), strict=True):
        inside = slice(max(0, int(np.searchsorted(course.s, begin)) - 1), int(np.searchsorted(course.s, end)) + 1)
        axes.plot(course.x[inside], course.y[inside], color=colour, linewidth=2.2, solid_capstyle="round")
        if colour != _STRAIGHT:
            _label(axes, course, name, 0.5 * (begin + end), colour)
    _arrow(axes, course)
    axes.set_aspect("equal")
    axes.set_xlabel("x in m")
    axes.set_ylabel("y in m")


def _point(course: Course, s: float) -> tuple[float, float, float, float]:
    return point_at(course.samples, s)


def _label(axes: Axes, course: Course, name: str, s: float, colour: str) -> None:
    """Write a name outside the course, or inside, next to a vertical line where there is no room outside."""
    x, y, tx, ty = _point(course, s)
    middle = np.array([np.mean(course.x), np.mean(course.y)])
    beside = np.array([-ty, tx])
    inside = float(beside @ (np.array([x, y]) - middle)) < 0.0
    if inside != (abs(beside[0]) > 0.9):
        beside = -beside
    axes.annotate(
        name,
        (x, y),
        xytext=(9.0 * beside[0], 11.0 * beside[1]),
        textcoords="offset points",
        ha="center" if abs(beside[0]) < 0.5 else ("left" if beside[0] > 0.0 else "right"),
        va="center" if abs(beside[1]) < 0.5 else ("bottom" if beside[1] > 0.0 else "top"),
        color=colour,
        fontsize=8,
    )


def _arrow(axes: Axes, course: Course) -> None:
    x, y, tx, ty = _point(course, 0.0)
    axes.plot(x, y, "o", color=_INK, markersize=5, zorder=3)
    axes.annotate(
        "",
        (x, y),
        xytext=(22.0 * tx, 22.0 * ty),
        textcoords="offset points",
        arrowprops={"arrowstyle": "<|-", "color": _INK},
        zorder=3,
    )


def draw_curvature(axes: Axes, course: Course) -> None:
    """Draw the curvature over arc length, coloured by section."""
    for (_, begin, end), colour in zip(section_spans(course), section_colours(course), strict=True):
        axes.axvspan(begin, end, color=colour, alpha=0.12, linewidth=0.0)
    axes.plot(course.s, course.curvature, color=_INK, linewidth=1.0, drawstyle="steps-post")
    axes.axhline(0.0, color=_LIMIT, linewidth=0.6, zorder=0)
    axes.set_xlim(0.0, course.length)
    axes.set_xlabel("distance along the line in m")
    axes.set_ylabel("curvature in 1/m")


def course_figure(course: Course) -> Figure:
    """Return a figure of a course: seen from above, and its curvature (positive to the left)."""
    width = max(float(np.ptp(course.x)), 1.0) + 3.0 * course.off_course_limit
    height = max(float(np.ptp(course.y)), 1.0) + 3.0 * course.off_course_limit
    map_height = float(np.clip(8.0 * height / width, 1.2, 6.0))
    figure = Figure(figsize=(9.0, map_height + 2.6), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=[map_height, 1.6])
    draw_map(above, course)
    draw_curvature(below, course)
    above.set_title(f"{course.name}: {course.length:.1f} m, {'closed' if course.closed else 'open'}", fontsize=10)
    return figure


def random_paths_figure() -> Figure:
    """Return a figure of random paths of the four curriculum parts (Weyrer et al. 2026, Table 4)."""
    figure = Figure(figsize=(9.0, 9.0), layout="constrained")
    for part, (axes, ranges) in enumerate(zip(figure.subplots(2, 2).flat, CURRICULUM_PATHS, strict=True), start=1):
        rng = np.random.default_rng([0, part])
        for _ in range(8):
            course = random_course(rng, ranges, 120.0)
            inside = course.s <= 120.0
            axes.plot(course.x[inside], course.y[inside], linewidth=1.4)
        axes.plot(0.0, 0.0, "o", color=_INK, markersize=4, zorder=3)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(
            f"part {part}: radius {ranges.radius_min:g} to {ranges.radius_max:g} m, transfers "
            f"{ranges.quintic_length_min:g} to {ranges.quintic_length_max:g} m by "
            f"{ranges.quintic_width_min:g} to {ranges.quintic_width_max:g} m",
            fontsize=8,
        )
        axes.set_xlabel("x in m")
        axes.set_ylabel("y in m")
    return figure


def random_circuits_figure() -> Figure:
    """Return a figure of the random circuits of the first seeds, each on its own scale."""
    figure = Figure(figsize=(12.0, 8.4), layout="constrained")
    for seed, axes in enumerate(figure.subplots(3, 4).flat):
        track = random_circuit(seed)
        draw_track(axes, track, labels=False)
        axes.set_axis_off()
        sharpest = min(corner.radius for corner in track.corners)
        axes.set_title(
            f"seed {seed}: {track.length:.0f} m, {len(track.corners)} corners\n"
            f"radii from {sharpest:.0f} m, {np.ptp(track.elevation):.0f} m of height",
            fontsize=9,
        )
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the shipped courses and random paths as PNG files."""
    parser = argparse.ArgumentParser(prog="python -m bike_sim.course.drawing", description=main.__doc__)
    parser.add_argument("folder", type=Path, help="folder for the pictures; made if it is not there")
    parser.add_argument("--course", action="append", help="name or file of a course, instead of all shipped ones")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in options.course or shipped_courses():
        course = load_course(name)
        course_figure(course).savefig(options.folder / f"course_{Path(name).stem.replace(':', '_')}.png", dpi=110)
    if not options.course:
        random_paths_figure().savefig(options.folder / "random_paths.png", dpi=110)
        random_circuits_figure().savefig(options.folder / "random_circuits.png", dpi=90)


if __name__ == "__main__":
    main()


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
