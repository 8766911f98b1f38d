"""Figures of recorded laps: traces over distance, g-g diagram, map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from bike_analysis.plots import GRAVITY, WIDE, new_figure, thin
from bike_analysis.reading import Floats
from bike_analysis.style import BAND, BLUE, ERROR_MAP, INK, MUTED, ORANGE, RC

if TYPE_CHECKING:
    from bike_analysis.lap_report import LapRecording, Theory

_KMH: Final = 3.6
_LIMIT_STEP: Final = 5
_SMOOTHING_S: Final = 0.1


def speed_trace_figure(laps: LapRecording, theory: Theory) -> Figure:
    """Draw the speed of the flying laps over distance, and that of the theoretical lap."""
    with mpl.rc_context(RC):
        figure = new_figure(WIDE, 3.4)
        axes = figure.subplots()
        _corner_marks(axes, laps)
        for lap in laps.flying:
            rows = laps.rows(lap)
            way = _along(laps, rows)
            axes.plot(*thin(way, _KMH * laps.ride.states.speed[rows]), color=BLUE, linewidth=1.0, alpha=0.8)
        scale = laps.track.length / theory.s[-1]
        axes.plot(*thin(theory.s * scale, _KMH * theory.speed), color=ORANGE, linewidth=1.0)
        axes.set(xlabel="distance from the start line, m", ylabel="speed, km/h", xlim=(0.0, laps.track.length))
    return figure


def lean_trace_figure(laps: LapRecording) -> Figure:
    """Draw the lean of the flying laps over distance."""
    with mpl.rc_context(RC):
        figure = new_figure(WIDE, 2.6)
        axes = figure.subplots()
        _corner_marks(axes, laps)
        for lap in laps.flying:
            rows = laps.rows(lap)
            lean = np.degrees(laps.ride.states.roll[rows])
            axes.plot(*thin(_along(laps, rows), lean), color=BLUE, linewidth=1.0, alpha=0.8)
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        axes.set(xlabel="distance from the start line, m", ylabel="lean, deg", xlim=(0.0, laps.track.length))
    return figure


def accelerations(laps: LapRecording, rows: slice) -> tuple[Floats, Floats]:
    """Return lateral (positive left) and longitudinal acceleration of states, m/s^2, from speed and yaw."""
    states = laps.ride.states
    time, yaw, speed = laps.time[rows], states.yaw[rows], states.speed[rows]
    count = max(1, round(_SMOOTHING_S / float(states.control_period[0])))
    kernel = np.ones(count) / count

    def smooth(values: Floats) -> Floats:
        return np.convolve(values, kernel, mode="same")

    return smooth(speed * np.gradient(yaw, time))[count:-count], smooth(np.gradient(speed, time))[count:-count]


def gg_figure(laps: LapRecording, theory: Theory) -> Figure:
    """Draw the g-g diagram of the flying laps and of the theoretical lap."""
    with mpl.rc_context(RC):
        figure = new_figure(WIDE, 0.55 * WIDE)
        axes = figure.subplots()
        for lap in laps.flying:
            lateral, along = accelerations(laps, laps.rows(lap))
            axes.plot(-lateral[::3] / GRAVITY, along[::3] / GRAVITY, ".", color=BLUE, markersize=1.6)
        axes.plot(-theory.lateral[::4] / GRAVITY, theory.longitudinal[::4] / GRAVITY, ".", color=ORANGE, markersize=1.6)
        axes.axhline(0.0, color=MUTED, linewidth=0.7)
        axes.axvline(0.0, color=MUTED, linewidth=0.7)
        axes.set_aspect("equal")
        axes.set(xlabel="lateral, g, positive to the right", ylabel="longitudinal, g")
    return figure


def track_map_figure(laps: LapRecording) -> Figure:
    """Draw the ride between the limits, coloured by speed, with the places off the track."""
    track, states = laps.track, laps.ride.states
    centre = track.centre
    rows = np.arange(0, len(centre.s), _LIMIT_STEP)
    progress = centre.s[rows]
    with mpl.rc_context(RC):
        figure = new_figure(WIDE, 0.72 * WIDE)
        axes = figure.subplots()
        for offset in (track.width_left[rows], -track.width_right[rows]):
            edge = track.points(progress, offset)
            axes.plot(edge[:, 0], edge[:, 1], color=MUTED, linewidth=0.6)
        keep = np.arange(0, len(states.x), 3)
        points = np.stack([states.x[keep], states.y[keep]], axis=1)
        speed = _KMH * states.speed[keep]
        ridden = LineCollection(
            list(np.stack([points[:-1], points[1:]], axis=1)),
            array=speed[:-1],
            cmap=ERROR_MAP,
            norm=Normalize(speed.min(), speed.max()),
            linewidth=1.1,
        )
        axes.add_collection(ridden)
        off = laps.outside > 0.0
        if off.any():
            axes.plot(states.x[off], states.y[off], "o", color=ORANGE, markersize=4.0, fillstyle="none")
        for corner in track.corners:
            side = 1.0 if corner.angle < 0.0 else -1.0
            width = float(track.at(track.width_left if side > 0.0 else track.width_right, corner.apex))
            x, y, _ = track.points(np.array([corner.apex]), side * (width + 22.0))[0]
            axes.text(x, y, corner.name, color=INK, ha="center", va="center", fontsize=8.0)
        figure.colorbar(ridden, ax=axes, label="speed, km/h", shrink=0.6)
        axes.set_aspect("equal")
        axes.set_axis_off()
    return figure


def _along(laps: LapRecording, rows: slice) -> Floats:
    """Return the distance from the start line along the centre line, m."""
    return laps.progress[rows] - laps.track.length * np.round(laps.progress[rows][0] / laps.track.length)


def _corner_marks(axes: mpl.axes.Axes, laps: LapRecording) -> None:
    """Shade the corners and name them."""
    for corner in laps.track.corners:
        axes.axvspan(corner.begin, min(corner.end, laps.track.length), color=BAND, alpha=0.25, linewidth=0.0)
        axes.text(
            corner.apex, 1.01, corner.name, transform=axes.get_xaxis_transform(), ha="center", color=MUTED, fontsize=7.0
        )
