"""`bike validate --course`: check a circuit's file, and draw it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bike_analysis.figures.numbers import lap_text
from bike_sim.course.drawing import track_figure
from bike_sim.course.files import load_track
from bike_sim.course.track import Track
from bike_sim.planning.envelope import point_mass_envelope
from bike_sim.planning.lap_limit import LapLimit, lap_limit
from bike_sim.planning.minimum_time import with_fastest_line
from bike_training.arguments import check_positive, make_folder

SCHEMA: Final = "bike.validate_course/1"

LARGEST_LATERAL: Final = 10.0
"""Largest cornering of a reference machine, in g: far more than any has, and far from where no line is found."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Check or draw, print a table unless `args.json`, and return the figures.

    Raises:
        ValueError: the file is broken. FileNotFoundError: it does not exist.
    """
    check_positive("--lateral-g", args.lateral_g, "g", LARGEST_LATERAL)
    if args.out is not None:
        make_folder("--out", args.out)
    envelope = point_mass_envelope(args.lateral_g)
    console = Console(quiet=args.json)
    with console.status("computing the fastest line"):
        track = with_fastest_line(load_track(args.course), envelope)
        ideal, median = lap_limit(envelope, track.line(1.0)), lap_limit(envelope, track.line(0.0))
    figures = _figures(track, ideal, median)
    console.print(_table(track, figures))
    if args.out is not None:
        path = args.out / f"{track.name}.png"
        _draw(track, ideal, path)
        console.print(f"written: {path}")
        figures["picture"] = str(path)
    return {"schema": SCHEMA, "ok": ideal.lap_time <= median.lap_time, "figures": figures}


def _figures(track: Track, ideal: LapLimit, median: LapLimit) -> dict[str, Any]:
    width = track.width_left + track.width_right
    return {
        "circuit": track.name,
        "length_m": track.length,
        "direction": track.direction,
        "width_min_m": float(width.min()),
        "width_max_m": float(width.max()),
        "radius_min_m": float(1.0 / np.abs(track.centre.curvature).max()),
        "height_range_m": float(np.ptp(track.elevation)),
        "corners": [
            {"name": corner.name, "direction": corner.direction, "apex_m": corner.apex, "radius_m": corner.radius}
            for corner in track.corners
        ],
        "machine": ideal.machine,
        "ideal_lap_s": ideal.lap_time,
        "median_lap_s": median.lap_time,
        "ideal_length_m": float(ideal.s[-1]),
    }


def _table(track: Track, figures: dict[str, Any]) -> Table:
    table = Table(box=box.SIMPLE, title=f"{track.name}: a sound circuit", show_header=False)
    directions = [corner["direction"] for corner in figures["corners"]]
    rows = {
        "length": f"{figures['length_m']:.1f} m, {figures['direction']}",
        "width": f"{figures['width_min_m']:.1f} to {figures['width_max_m']:.1f} m",
        "corners": f"{len(directions)}: {directions.count('left')} left, {directions.count('right')} right",
        "smallest radius": f"{figures['radius_min_m']:.1f} m",
        "height": f"{figures['height_range_m']:.0f} m between lowest and highest",
        f"theoretical lap ({figures['machine']})": f"{figures['ideal_lap_s']:.2f} s on the ideal line, "
        f"{figures['median_lap_s']:.2f} s on the median",
    }
    for name, value in rows.items():
        table.add_row(name, value)
    return table


def _draw(track: Track, ideal: LapLimit, path: Path) -> None:
    title = (
        f"{track.name}: {track.length:.0f} m, {track.direction}, {len(track.corners)} corners; "
        f"{ideal.machine}: {lap_text(ideal.lap_time)}"
    )
    track_figure(track, (track.line(1.0), ideal.s, ideal.speed), title).savefig(path, dpi=100)
