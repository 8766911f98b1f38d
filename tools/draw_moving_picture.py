"""Draw the moving picture of the README from a recording: map, bicycle from behind, speed, lean and steering.

.venv/bin/python tools/draw_moving_picture.py out/ride/ride.mcap docs/images/ride.gif --begin 20 --duration 14
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes

from bike_analysis import open_ride

FRAMES_PER_SECOND = 12
WHEEL, SEAT = 0.35, 1.0  # m, radius of a wheel and height of the saddle
INK, LINE, TRAIL = "#222222", "#2b7bba", "#d1495b"


def draw_map(axes: Axes, table: pd.DataFrame, course: pd.DataFrame | None) -> None:
    """Draw what does not move: the course, or the whole ride where none was recorded."""
    x, y = (course["x"], course["y"]) if course is not None else (table["x_m"], table["y_m"])
    axes.plot(x, y, color=LINE, lw=1.2)
    axes.set_aspect("equal")
    axes.set_xlabel("x / m")
    axes.set_ylabel("y / m")


def draw_behind(axes: Axes, roll: float, steer: float) -> None:
    """Draw the bicycle from behind: rear wheel, rider, handlebar."""
    axes.clear()
    axes.set_xlim(-1.0, 1.0)
    axes.set_ylim(-0.1, 1.9)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.axhline(0.0, color=INK, lw=1.0)
    up, across = np.array([np.sin(roll), np.cos(roll)]), np.array([np.cos(roll), -np.sin(roll)])
    for begin, end, width in ((0.0, 2.0 * WHEEL, 7), (2.0 * WHEEL, SEAT + 0.5, 3)):
        axes.plot(*np.stack([begin * up, end * up], axis=1), color=INK, lw=width, solid_capstyle="round")
    head = (SEAT + 0.68) * up
    axes.plot(*head, "o", color=INK, ms=13)
    # Turned to the left the right end of the handlebar comes nearer, which from behind is a shorter bar.
    bar = 0.32 * np.cos(steer) * across
    axes.plot(*np.stack([SEAT * up - bar, SEAT * up + bar], axis=1), color=TRAIL, lw=4, solid_capstyle="round")


def main() -> None:
    """Draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--begin", type=float, default=0.0, help="s of the ride")
    parser.add_argument("--duration", type=float, default=12.0, help="s")
    args = parser.parse_args()
    ride = open_ride(args.recording).rides[0]
    table = ride.table()
    time = table["time_s"].to_numpy() - float(table["time_s"].iloc[0])
    moments = args.begin + np.arange(0.0, args.duration, 1.0 / FRAMES_PER_SECOND)
    columns = {name: np.interp(moments, time, table[name]) for name in table.columns if table[name].dtype.kind == "f"}
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.6, 3.2), width_ratios=(2.4, 1.0), layout="constrained", dpi=80
    )
    draw_map(left, table, None)
    (trail,) = left.plot([], [], color=TRAIL, lw=2.5)
    (dot,) = left.plot([], [], "o", color=TRAIL, ms=7)

    def show(frame: int) -> None:
        trail.set_data(columns["x_m"][: frame + 1], columns["y_m"][: frame + 1])
        dot.set_data(columns["x_m"][frame : frame + 1], columns["y_m"][frame : frame + 1])
        draw_behind(right, columns["roll_rad"][frame], columns["steer_rad"][frame])
        left.set_title(
            f"{columns['speed_m_s'][frame]:.1f} m/s   lean {np.degrees(columns['roll_rad'][frame]):+5.1f}°   "
            f"error {100.0 * columns['lateral_error_m'][frame]:+5.1f} cm",
            fontsize=10,
        )

    animation = FuncAnimation(figure, show, frames=len(moments))
    animation.save(args.picture, writer=PillowWriter(fps=FRAMES_PER_SECOND))
    print(f"{args.picture}: {len(moments)} frames, {args.picture.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
