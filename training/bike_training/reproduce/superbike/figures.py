"""Figures of the superbike paper, drawn from the tables alone, and two of learning."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from typing import Any, Final

import numpy as np

from bike_sim.course.files import load_track
from bike_sim.course.track import Corner, Track
from bike_sim.planning.envelope import envelope
from bike_sim.planning.line_cache import track_with_line
from bike_sim.vehicles.files import load_superbike
from bike_training.reproduce.superbike.data import Context, Data, Moment
from bike_training.reproduce.superbike.experiment import CIRCUITS, MACHINE, THRESHOLD, circuit_of, setting_of
from bike_training.reproduce.superbike.statements import overshoots, path_of

_COLOURS: Final = {"spdl": "C0", "sac": "C1"}
_AROUND: Final = 80.0
"""What is drawn before and behind a corner, m."""
_ELLIPSES: Final = 7
"""Distributions that are drawn of a run."""


def _limits(axes: Any, track: Track, progress: Any) -> None:
    """Draw the limits of a circuit, or of a part of it."""
    for offset in (track.at(track.width_left, progress), -track.at(track.width_right, progress)):
        axes.plot(*track.points(progress, offset)[:, :2].T, color="0.7", lw=1)


def _coloured(axes: Any, moments: Sequence[Moment], shared: tuple[float, float]) -> Any:
    """Draw a ride coloured by its speed."""
    from matplotlib.collections import LineCollection

    points = np.array([(row.x, row.y) for row in moments])
    parts = np.stack([points[:-1], points[1:]], axis=1)
    line = LineCollection(list(parts), cmap="turbo", linewidths=2.5)
    line.set_array(np.array([row.speed for row in moments[:-1]]))
    line.set_clim(*shared)
    axes.add_collection(line)
    axes.set(aspect="equal")
    axes.autoscale_view()
    return line


def _rode(data: Data) -> dict[str, list[Moment]]:
    found: dict[str, list[Moment]] = {}
    for row in data.moments:
        found.setdefault(row.setting, []).append(row)
    return {name: rows for name, rows in found.items() if len(rows) > 1}


def _speed_range(rode: dict[str, list[Moment]]) -> tuple[float, float]:
    speeds = [row.speed for rows in rode.values() for row in rows]
    return min(speeds), max(speeds)


def lap(data: Data, plt: Any) -> Any:
    """Fig. 3: a flying lap of the best run of each setting, coloured by speed."""
    rode, track = _rode(data), load_track(CIRCUITS[0])
    names = list(rode) or ["spdl"]
    figure, axes = plt.subplots(1, len(names), figsize=(6 * len(names), 5), layout="constrained", squeeze=False)
    line = None
    for each, name in zip(axes[0], names, strict=True):
        _limits(each, track, np.linspace(0.0, track.length, 2000, endpoint=False))
        if name in rode:
            line = _coloured(each, rode[name], _speed_range(rode))
            each.set_title(f"Fig. 3: {name.upper()}, seed {rode[name][0].seed}, to {rode[name][-1].time:.1f} s")
        each.set(xlabel="x / m", ylabel="y / m", aspect="equal")
    if line is not None:
        figure.colorbar(line, ax=axes[0][-1], label="speed / (m/s)")
    return figure


def _widest(data: Data, track: Track) -> Corner:
    found = overshoots(data, "spdl") or overshoots(data, "sac")
    if not found:
        return track.corners[0]
    name = max(found, key=lambda each: found[each])
    return next(corner for corner in track.corners if corner.name == name)


def overshoot(data: Data, plt: Any) -> Any:
    """Fig. 4: the corner in which SPDL runs widest, with limits and ideal line, and the distance to it."""
    machine = load_superbike(MACHINE)
    rode, track = _rode(data), track_with_line(CIRCUITS[0], envelope(machine))
    corner = _widest(data, track)
    begin, end = corner.begin - _AROUND, corner.end + _AROUND
    figure, (map_axes, error_axes) = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
    along = np.linspace(begin, end, 400)
    _limits(map_axes, track, along)
    assert track.ideal is not None, "it was computed"
    map_axes.plot(*track.points(along, track.at(track.ideal, along))[:, :2].T, "k--", lw=1, label="ideal line")
    sign = 1.0 if corner.angle > 0.0 else -1.0
    for name, rows in rode.items():
        placed = [(row, begin + (row.progress - begin) % track.length) for row in rows]
        placed = sorted(((row, at) for row, at in placed if at <= end), key=itemgetter(1))
        shown, at = [row for row, _ in placed], [at for _, at in placed]
        if len(shown) < 2:
            continue
        if name == "spdl":
            figure.colorbar(_coloured(map_axes, shown, _speed_range(rode)), ax=map_axes, label="speed / (m/s)")
        else:
            map_axes.plot(
                [row.x for row in shown], [row.y for row in shown], ":", color="k", lw=1.5, label=name.upper()
            )
        distance = [-sign * row.error for row in shown]
        error_axes.plot(at, distance, color=_COLOURS[name], label=name.upper())
    error_axes.axvspan(corner.begin, corner.end, color="0.92", zorder=0)
    error_axes.axhline(0.0, color="0.6", lw=0.8)
    error_axes.set(xlabel="along the circuit / m", ylabel="outside of the ideal line / m", title="inside below 0")
    map_axes.set(xlabel="x / m", ylabel="y / m", title=f"Fig. 4: corner {corner.name} (coloured: SPDL)", aspect="equal")
    map_axes.legend()
    if error_axes.get_legend_handles_labels()[0]:
        error_axes.legend()
    return figure


def _circuits(data: Data) -> list[str]:
    """Circuits that were learned on, in the paper's order; the first one where there is none."""
    learned_on = {circuit_of(run.setting) for run in data.runs}
    return [circuit for circuit in CIRCUITS if circuit in learned_on] or [CIRCUITS[0]]


def learning(data: Data, plt: Any) -> Any:
    """Return of the last 100 episodes, and excess of validations, a column for each circuit."""
    circuits = _circuits(data)
    size = (2.0 + 4.5 * len(circuits), 7.0)
    figure, axes = plt.subplots(
        2, len(circuits), figsize=size, sharex="col", sharey="row", layout="constrained", squeeze=False
    )
    for (top, bottom), circuit in zip(axes.T, circuits, strict=True):
        _learned(data, circuit, top, bottom)
        top.set(title=circuit)
        bottom.set(xlabel="decisions", ylim=(0.0, 1.05))
    axes[0, 0].set(ylabel="return of an episode")
    axes[0, 0].legend()
    axes[1, 0].set(ylabel="excess of validations (1: not whole)")
    figure.suptitle("Learning, each run (dotted: early snapshot)")
    return figure


def _learned(data: Data, circuit: str, top: Any, bottom: Any) -> None:
    """Draw the runs on a circuit: returns above, validations below."""
    for kind, colour in _COLOURS.items():
        name = setting_of(kind, circuit)
        top.plot([], [], color=colour, label=kind.upper())
        for seed in sorted({run.seed for run in data.runs if run.setting == name}):
            rows = [row for row in data.episodes if (row.setting, row.seed) == (name, seed)]
            top.plot([row.step for row in rows], [row.total for row in rows], color=colour, lw=1, alpha=0.7)
            found = [row for row in data.validations if (row.setting, row.seed) == (name, seed)]
            steps, errors = [row.step for row in found], [row.error for row in found]
            bottom.plot(steps, errors, ".-", color=colour, lw=1, ms=4, alpha=0.7)
    early = [row.step for row in data.laps if row.actor == "early" and circuit_of(row.setting) == circuit]
    for axes in (top, bottom) if early else ():
        axes.axvline(early[0], color="0.7", ls=":", lw=1)


def distribution(data: Data, plt: Any) -> Any:
    """SPDL's context over its updates on one circuit: means, divergence and value, and ellipses of a run."""
    circuit = _circuits(data)[0]
    figure, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
    figure.suptitle(circuit)
    paths = path_of(data, setting_of("spdl", circuit))
    for seed, path in paths.items():
        steps = [row.step for row in path]
        colour = f"C{seed}"
        axes[0, 0].plot(steps, [row.kl for row in path], color=colour, label=f"seed {seed}")
        axes[0, 1].plot(steps, [row.value for row in path], color=colour)
        axes[1, 0].plot(steps, [row.v_max for row in path], color=colour)
        twin = [25.0 + 65.0 * row.d_median for row in path]
        axes[1, 0].plot(steps, twin, ":", color=colour)
    axes[0, 0].set(ylabel="divergence from the target / nat", title="Divergence")
    axes[0, 1].axhline(THRESHOLD, color="k", ls=":", lw=1)
    axes[0, 1].set(ylabel="expected return", title="Value that SPDL sees (dotted: threshold)")
    axes[1, 0].set(xlabel="decisions", ylabel="mean speed limit / (m/s)", title="Means (dotted: d_median, 0 to 1)")
    if paths:
        axes[0, 0].legend()
        axes[0, 0].set_yscale("log")
        first = min(paths)
        _ellipses(axes[1, 1], paths[first])
        axes[1, 1].set_title(f"Seed {first}: ellipses of one standard deviation")
    axes[1, 1].set(xlabel="speed limit / (m/s)", ylabel="d_median")
    return figure


def _ellipses(axes: Any, path: Sequence[Context]) -> None:
    """Draw the distribution of speed limit and d_median of some updates, the last one darkest."""
    chosen = np.unique(np.linspace(0, len(path) - 1, _ELLIPSES).round().astype(int))
    angle = np.linspace(0.0, 2.0 * np.pi, 80)
    for number in chosen:
        row = path[number]
        shade = 0.25 + 0.75 * number / max(1, len(path) - 1)
        # Cholesky factor of the covariance of (v_max, d_median).
        across = row.correlation * np.cos(angle) + np.sqrt(max(0.0, 1.0 - row.correlation**2)) * np.sin(angle)
        x = row.v_max + row.std_v_max * np.cos(angle)
        axes.plot(x, row.d_median + row.std_d_median * across, color="C0", alpha=shade)
        axes.plot(row.v_max, row.d_median, ".", color="C0", alpha=shade)
        axes.annotate(str(row.iteration), (row.v_max, row.d_median), fontsize="x-small")
    axes.plot(90.0, 1.0, "k*", ms=10)


FIGURES: Final = {
    "fig3.png": lap,
    "fig4.png": overshoot,
    "learning.png": learning,
    "distribution.png": distribution,
}
"""What draws each figure, by its file."""
