"""Figures 8 to 14 and 16 of Weyrer et al. (2026), drawn from the tables alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from bike_sim.course.files import load_course
from bike_training.reproduce.bicycle import detail_figures
from bike_training.reproduce.bicycle.data import Data
from bike_training.reproduce.bicycle.statements import controller_1, finished_at, mean_distance
from bike_training.reproduce.statement import interval

_COLOURS: Final = {name: f"C{place}" for place, name in enumerate(("prop", "alt1", "alt2", "alt3", "alt4", "alt5"))}
_SMOOTH: Final = 3
"""Validations of the moving average of Fig. 9; the paper, whose runs are ten times as long, takes 20."""
_LEARNING: Final = ("prop", "alt1", "alt2", "alt5")
"""Settings of Fig. 9; with the others nothing could be told apart."""


def _settings(data: Data) -> list[str]:
    known = {run.setting for run in data.runs}
    return [name for name in _COLOURS if name in known]


def _steps(data: Data, plt: Any) -> Any:
    """Fig. 8: learning steps until the curriculum is ended, dots for runs, bars for means with 95 % intervals."""
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    names = _settings(data)
    for place, name in enumerate(names):
        done = finished_at(data, name)
        if len(done):
            low, high = interval(done)
            axes.bar(place, done.mean(), color=_COLOURS[name], alpha=0.4)
            axes.plot([place, place], [low, high], color="k", lw=1)
            axes.plot(np.full(len(done), place), done, "o", color=_COLOURS[name])
        open_runs = [run.steps for run in data.runs if run.setting == name and run.finished_at < 0]
        axes.plot(np.full(len(open_runs), place), open_runs, "x", color=_COLOURS[name])
    marked = [
        f"{name}{'*' if any(r.setting == name and r.finished_at < 0 for r in data.runs) else ''}" for name in names
    ]
    axes.set_xticks(range(len(names)), marked)
    axes.set(
        ylabel="learning steps", title="Fig. 8: steps to the end of the curriculum (*, x: not ended)", ylim=(0, None)
    )
    return figure


def _learning(data: Data, plt: Any) -> Any:
    """Fig. 9: validation error with its range over the runs, and the parts of the runs."""
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(7, 7), sharex=True, layout="constrained")
    for name in [name for name in _settings(data) if name in _LEARNING]:
        curves = []
        for seed in sorted({run.seed for run in data.runs if run.setting == name}):
            rows = sorted(
                (row for row in data.validations if (row.setting, row.seed) == (name, seed)), key=lambda row: row.step
            )
            if not rows:
                continue
            steps = np.array([row.step for row in rows], float)
            curves.append((steps, _averaged([row.error for row in rows])))
            ends = [run.finished_at for run in data.runs if (run.setting, run.seed) == (name, seed)]
            parts = [*((row.step, row.part) for row in rows), *((end, 5) for end in ends if end >= 0)]
            bottom.step(*zip(*parts, strict=True), where="post", color=_COLOURS[name], lw=1)
        if curves:
            grid = np.linspace(min(c[0][0] for c in curves), max(c[0][-1] for c in curves), 200)
            each = np.array([np.interp(grid, *curve, left=np.nan, right=np.nan) for curve in curves])
            with np.errstate(all="ignore"):
                top.plot(grid, _over_runs(each, np.nanmean), color=_COLOURS[name], label=name)
                low, high = (_over_runs(each, rule) for rule in (np.nanmin, np.nanmax))
            top.fill_between(grid, low, high, color=_COLOURS[name], alpha=0.2)
    top.set(ylabel="validation error e", title="Fig. 9: learning", ylim=(0, None))
    if top.has_data():
        top.legend()
    bottom.set(ylabel="part of the curriculum", xlabel="learning steps", yticks=(1, 2, 3, 4, 5))
    return figure


def _over_runs(each: Any, rule: Any) -> Any:
    found = np.full(each.shape[1], np.nan)
    known = np.isfinite(each).any(axis=0)
    found[known] = rule(each[:, known], axis=0)
    return found


def _averaged(values: Sequence[float]) -> Any:
    """Return the mean of the last validations at each one."""
    sums = np.cumsum(np.concatenate([[0.0], values]))
    last = np.arange(1, len(sums))
    first = np.maximum(last - _SMOOTH, 0)
    return (sums[last] - sums[first]) / (last - first)


def _distances(data: Data, plt: Any) -> Any:
    """Fig. 10: T(v) on random paths and on the benchmark path, and mean and maximum of the best controllers."""
    figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(7, 10), sharex=True, layout="constrained")
    for axes, course, kind in ((top, "random", "paths"), (middle, "benchmark", "path")):
        for name in _settings(data):
            points = mean_distance(data, name, course)
            if not points:
                continue
            axes.plot(list(points), [mean for mean, _ in points.values()], ":", color=_COLOURS[name], lw=1)
            for speed, (mean, whole) in points.items():
                axes.plot(speed, mean, "o", color=_COLOURS[name], alpha=1.0 if whole else 0.3, ms=4)
            axes.plot([], [], "o", color=_COLOURS[name], label=name)
        axes.set(ylabel="T(v) / m", title=f"Fig. 10: {course} {kind} (pale: a controller fails)", ylim=(0, None))
        if axes.has_data():
            axes.legend()
    for name in ("prop", "alt3"):
        seed = controller_1(data, name)
        rides = [r for r in data.rides if (r.setting, r.seed, r.course) == (name, seed, "benchmark")]
        speeds = [ride.speed for ride in rides]
        if rides:
            bottom.plot(speeds, [ride.mean for ride in rides], "o-", color=_COLOURS[name], ms=3, label=f"{name}: mean")
            bottom.plot(speeds, [r.largest for r in rides], "s--", color=_COLOURS[name], ms=3, label=f"{name}: maximum")
    if bottom.has_data():
        bottom.legend()
    bottom.set(xlabel="v / (m/s)", ylabel="distance / m", title="controller 1 on the benchmark path", ylim=(0, None))
    return figure


def _junction(data: Data, plt: Any) -> Any:
    """Fig. 11: tracks of the front contacts, and of the rear ones dotted."""
    figure, axes = plt.subplots(figsize=(7, 6), layout="constrained")
    course = load_course("junction")
    axes.plot(course.x, course.y, color="0.6", lw=4, label="path")
    for place, name in enumerate(dict.fromkeys(row.rider for row in data.tracks)):
        rows = [row for row in data.tracks if row.rider == name]
        colour = _COLOURS.get(name, f"C{6 + place}")
        axes.plot([row.front_x for row in rows], [row.front_y for row in rows], color=colour, label=name)
        axes.plot([row.x for row in rows], [row.y for row in rows], ":", color=colour, lw=1)
    axes.set(xlabel="x / m", ylabel="y / m", title="Fig. 11: junction at 4 m/s (dotted: rear contact)")
    axes.set(aspect="equal", xlim=(-4.0, 20.0), ylim=(-12.0, 5.0))
    axes.legend(loc="lower right")
    return figure


FIGURES: Final = {
    "fig8.png": _steps,
    "fig9.png": _learning,
    "fig10.png": _distances,
    "fig11.png": _junction,
    "fig12.png": detail_figures.roll_and_steer,
    "fig13.png": detail_figures.frames,
    "fig14.png": detail_figures.impact,
    "fig16.png": detail_figures.step_response,
}
"""What draws each figure, by its file."""
