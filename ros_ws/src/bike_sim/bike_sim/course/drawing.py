"""Pictures of courses: the line from above with its limits and sections, its curvature, and the height of circuits.

``python -m bike_sim.course.drawing FOLDER`` draws the pictures of docs/reference/courses.md, and the random circuits of
docs/reference/circuits.md.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
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
_LEFT, _RIGHT = "#c07f00", "#2f6fae"
"""Corners of circuits."""


class Part(NamedTuple):
    """A part of a line: its name, where it begins and ends (arc length, m), and its colour."""

    name: str
    begin: float
    end: float
    colour: str


def sections_of(course: Course) -> list[Part]:
    """Return the sections of a course, or the whole of it if it has none; straights are grey."""
    palette = itertools.cycle(f"C{i}" for i in range(7))
    sections = course.sections or ((course.name, 0.0),)
    ends = [begin for _, begin in sections[1:]] + [course.length]
    parts = []
    for (name, begin), end in zip(sections, ends, strict=True):
        bent = np.any(np.abs(course.curvature[(course.s >= begin) & (course.s < end)]) > 1e-9)
        parts.append(Part(name, begin, end, next(palette) if bent else _STRAIGHT))
    return parts


def corners_of(track: Track) -> list[Part]:
    """Return the corners of a circuit."""
    return [Part(each.name, each.begin, each.end, _LEFT if each.angle > 0.0 else _RIGHT) for each in track.corners]


def draw_map(axes: Axes, course: Course, parts: Sequence[Part], labels: bool = True) -> None:
    """Draw a course from above: its limits (or how far a ride may leave it), its parts, start and direction.

    Args:
        axes: to draw in; equal scales are set, in m.
        course: to draw; the centre line of a circuit.
        parts: of it.
        labels: write the names of the parts that are not straight.
    """
    left = course.off_course_limit if course.width_left is None else course.width_left
    right = course.off_course_limit if course.width_right is None else course.width_right
    style = ":" if course.width_left is None else "-"
    for offset in (left, -right):
        # A limit farther inside a curve than its centre would run backwards.
        shown = np.where(offset * course.curvature < 1.0, offset, np.nan)
        limit = course.x - shown * np.sin(course.heading), course.y + shown * np.cos(course.heading)
        axes.plot(*limit, color=_LIMIT, linestyle=style, linewidth=0.8)
    axes.plot(course.x, course.y, color=_STRAIGHT, linewidth=2.2)
    for part in parts:
        first, last = np.searchsorted(course.s, (part.begin, part.end))
        inside = slice(max(0, first - 1), last + 1)
        axes.plot(course.x[inside], course.y[inside], color=part.colour, linewidth=2.2, solid_capstyle="round")
        if labels and part.colour != _STRAIGHT:
            _label(axes, course, part)
    x, y, tx, ty = point_at(course.samples, 0.0)
    axes.plot(x, y, "o", color=_INK, markersize=5, zorder=3)
    arrow = {"arrowstyle": "<|-", "color": _INK}
    axes.annotate("", (x, y), xytext=(22.0 * tx, 22.0 * ty), textcoords="offset points", arrowprops=arrow, zorder=3)
    axes.set(aspect="equal", xlabel="x in m", ylabel="y in m")


def _label(axes: Axes, course: Course, part: Part) -> None:
    """Write a name outside the course, or inside, next to a vertical line where there is no room outside."""
    x, y, tx, ty = point_at(course.samples, 0.5 * (part.begin + part.end))
    middle = np.array([np.mean(course.x), np.mean(course.y)])
    beside = np.array([-ty, tx])
    inside = float(beside @ (np.array([x, y]) - middle)) < 0.0
    if inside != (abs(beside[0]) > 0.9):
        beside = -beside
    axes.annotate(
        part.name,
        (x, y),
        xytext=(9.0 * beside[0], 11.0 * beside[1]),
        textcoords="offset points",
        ha="center" if abs(beside[0]) < 0.5 else ("left" if beside[0] > 0.0 else "right"),
        va="center" if abs(beside[1]) < 0.5 else ("bottom" if beside[1] > 0.0 else "top"),
        color=part.colour,
        fontsize=8,
    )


def _figure(course: Course, parts: Sequence[Part], panels: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with the map of a course and panels over its arc length, the first of them with its curvature."""
    margin = 3.0 * course.off_course_limit
    width, height = (max(float(np.ptp(places)), 1.0) + margin for places in (course.x, course.y))
    map_height = float(np.clip(8.0 * height / width, 1.2, 8.0))
    figure = Figure(figsize=(9.0, map_height + 1.6 * panels + 1.0), layout="constrained")
    axes = list(figure.subplots(1 + panels, 1, height_ratios=[map_height] + [1.6] * panels))
    draw_map(axes[0], course, parts)
    for panel in axes[1:]:
        for part in parts:
            panel.axvspan(part.begin, part.end, color=part.colour, alpha=0.12, linewidth=0.0)
        panel.set_xlim(0.0, course.length)
    axes[1].plot(course.s, course.curvature, color=_INK, linewidth=1.0, drawstyle="steps-post")
    axes[1].axhline(0.0, color=_LIMIT, linewidth=0.6, zorder=0)
    axes[1].set_ylabel("curvature in 1/m")
    axes[-1].set_xlabel("distance along the line in m")
    return figure, axes


def course_figure(course: Course) -> Figure:
    """Return a figure of a course: seen from above, and its curvature (positive to the left)."""
    figure, axes = _figure(course, sections_of(course), 1)
    axes[0].set_title(f"{course.name}: {course.length:.1f} m, {'closed' if course.closed else 'open'}", fontsize=10)
    return figure


def track_figure(track: Track, line: Course, s: FloatArray, speed: FloatArray, title: str) -> Figure:
    """Return a figure of a circuit: a lap from above, coloured by its speed, and curvature, height and speed.

    Args:
        track: the circuit.
        line: that the lap follows.
        s: arc lengths on it, m.
        speed: there, m/s.
        title: above the map.
    """
    figure, axes = _figure(track.centre, corners_of(track), 3)
    for wall in track.walls():
        axes[0].plot(*track.points(track.centre.s, wall)[:, :2].T, color=_LIMIT, linewidth=0.7, linestyle="--")
    for _, begin in track.sectors:
        across = track.points(np.array([begin, begin]), np.array([-2.0, 2.0]) * np.max(track.width_left))
        axes[0].plot(across[:, 0], across[:, 1], color=_INK, linewidth=0.9)
    points = np.stack([np.interp(s, line.s, line.x), np.interp(s, line.s, line.y)], axis=1)
    lap = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="turbo", linewidths=2.4, zorder=3)
    lap.set_array(3.6 * 0.5 * (speed[1:] + speed[:-1]))
    axes[0].add_collection(lap)
    figure.colorbar(lap, ax=axes[0], label="speed in km/h", shrink=0.7, pad=0.01)
    axes[0].set_title(title, fontsize=10)
    axes[2].plot(track.centre.s, track.elevation, color=_INK, linewidth=1.0)
    axes[2].set_ylabel("height in m")
    axes[3].plot(s * track.length / line.length, 3.6 * speed, color=_INK, linewidth=1.0)
    axes[3].set_ylabel("speed in km/h")
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
        axes.set(xlabel="x in m", ylabel="y in m")
    return figure


def random_circuits_figure() -> Figure:
    """Return a figure of the random circuits of the first seeds, each on its own scale."""
    figure = Figure(figsize=(12.0, 8.4), layout="constrained")
    for seed, axes in enumerate(figure.subplots(3, 4).flat):
        track = random_circuit(seed)
        draw_map(axes, track.centre, corners_of(track), labels=False)
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
