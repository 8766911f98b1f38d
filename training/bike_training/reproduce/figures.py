"""Figures of both papers, drawn from the tables alone."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd

from bike_sim.course.files import load_course, load_track
from bike_sim.course.track import Corner, Track
from bike_sim.planning.envelope import envelope
from bike_sim.planning.line_cache import track_with_line
from bike_sim.vehicles.files import load_superbike
from bike_training.explain.drawing import SYMBOLS
from bike_training.reproduce.bicycle_results import controller_1, finished_at, mean_distance
from bike_training.reproduce.data import Tables, select
from bike_training.reproduce.statement import interval
from bike_training.reproduce.superbike_results import (
    CIRCUITS,
    KINDS,
    MACHINE,
    circuit_of,
    overshoots,
    setting_of,
)

_SETTINGS: Final = ("prop", "alt1", "alt2", "alt3", "alt4", "alt5")
_COLOURS: Final = {name: f"C{place}" for names in (_SETTINGS, KINDS) for place, name in enumerate(names)}
"""Of the settings of both papers."""

# ----------------------------------------------------------------------------------------------- the bicycle paper

_SMOOTH: Final = 3
"""Validations of the moving average of Fig. 9; the paper, whose runs are ten times as long, takes 20."""
_LEARNING: Final = ("prop", "alt1", "alt2", "alt5")
"""Settings of Fig. 9; with the others nothing could be told apart."""


def _settings(data: Tables) -> list[str]:
    known = set(data["runs"]["setting"])
    return [name for name in _SETTINGS if name in known]


def _steps(data: Tables, plt: Any) -> Any:
    """Fig. 8: learning steps until the curriculum is ended, dots for runs, bars for means with 95 % intervals."""
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    names, labels = _settings(data), []
    for place, name in enumerate(names):
        done, runs = finished_at(data, name), select(data["runs"], setting=name)
        if len(done):
            low, high = interval(done)
            axes.bar(place, done.mean(), color=_COLOURS[name], alpha=0.4)
            axes.plot([place, place], [low, high], color="k", lw=1)
            axes.plot(np.full(len(done), place), done, "o", color=_COLOURS[name])
        open_runs = runs[runs["finished_at"] < 0]["steps"]
        axes.plot(np.full(len(open_runs), place), open_runs, "x", color=_COLOURS[name])
        labels.append(f"{name}*" if len(open_runs) else name)
    axes.set_xticks(range(len(names)), labels)
    axes.set(
        ylabel="learning steps", title="Fig. 8: steps to the end of the curriculum (*, x: not ended)", ylim=(0, None)
    )
    return figure


def _learning(data: Tables, plt: Any) -> Any:
    """Fig. 9: validation error with its range over the runs, and the parts of the runs."""
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(7, 7), sharex=True, layout="constrained")
    for name in [name for name in _settings(data) if name in _LEARNING]:
        curves = []
        rows_of_seed = dict(iter(select(data["validations"], setting=name).sort_values("step").groupby("seed")))
        for _, seed, end in (
            select(data["runs"], setting=name)[["seed", "finished_at"]].sort_values("seed").itertuples()
        ):
            if seed not in rows_of_seed:
                continue
            rows = rows_of_seed[seed]
            averaged = rows["error"].rolling(_SMOOTH, min_periods=1).mean()
            curves.append((rows["step"].to_numpy(float), averaged.to_numpy()))
            parts = [*zip(rows["step"], rows["part"], strict=True), *([(end, 5)] if end >= 0 else [])]
            bottom.step(*zip(*parts, strict=True), where="post", color=_COLOURS[name], lw=1)
        if curves:
            grid = np.linspace(min(c[0][0] for c in curves), max(c[0][-1] for c in curves), 200)
            each = np.array([np.interp(grid, *curve, left=np.nan, right=np.nan) for curve in curves])
            known = np.isfinite(each).any(axis=0)
            mean, low, high = (rule(each[:, known], axis=0) for rule in (np.nanmean, np.nanmin, np.nanmax))
            top.plot(grid[known], mean, color=_COLOURS[name], label=name)
            top.fill_between(grid[known], low, high, color=_COLOURS[name], alpha=0.2)
    top.set(ylabel="validation error e", title="Fig. 9: learning", ylim=(0, None))
    if top.has_data():
        top.legend()
    bottom.set(ylabel="part of the curriculum", xlabel="learning steps", yticks=(1, 2, 3, 4, 5))
    return figure


def _distances(data: Tables, plt: Any) -> Any:
    """Fig. 10: T(v) on random paths and on the benchmark path, and mean and maximum of the best controllers."""
    figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(7, 10), sharex=True, layout="constrained")
    for axes, course, kind in ((top, "random", "paths"), (middle, "benchmark", "path")):
        for name in _settings(data):
            points = mean_distance(data, name, course)
            if points.empty:
                continue
            axes.plot(points.index, points["mean"], ":", color=_COLOURS[name], lw=1)
            for speed, mean, whole in points.itertuples():
                axes.plot(speed, mean, "o", color=_COLOURS[name], alpha=1.0 if whole else 0.3, ms=4)
            axes.plot([], [], "o", color=_COLOURS[name], label=name)
        axes.set(ylabel="T(v) / m", title=f"Fig. 10: {course} {kind} (pale: a controller fails)", ylim=(0, None))
        if axes.has_data():
            axes.legend()
    for name in ("prop", "alt3"):
        rides = select(data["rides"], setting=name, seed=controller_1(data, name), course="benchmark")
        for column, style, label in (("mean", "o-", "mean"), ("largest", "s--", "maximum")) if len(rides) else ():
            bottom.plot(rides["speed"], rides[column], style, color=_COLOURS[name], ms=3, label=f"{name}: {label}")
    if bottom.has_data():
        bottom.legend()
    bottom.set(xlabel="v / (m/s)", ylabel="distance / m", title="controller 1 on the benchmark path", ylim=(0, None))
    return figure


def _junction(data: Tables, plt: Any) -> Any:
    """Fig. 11: tracks of the front contacts, and of the rear ones dotted."""
    figure, axes = plt.subplots(figsize=(7, 6), layout="constrained")
    course = load_course("junction")
    axes.plot(course.x, course.y, color="0.6", lw=4, label="path")
    for place, (name, rows) in enumerate(data["tracks"].groupby("rider", sort=False)):
        colour = _COLOURS.get(str(name), f"C{6 + place}")
        axes.plot(rows["front_x"], rows["front_y"], color=colour, label=name)
        axes.plot(rows["x"], rows["y"], ":", color=colour, lw=1)
    axes.set(xlabel="x / m", ylabel="y / m", title="Fig. 11: junction at 4 m/s (dotted: rear contact)")
    axes.set(aspect="equal", xlim=(-4.0, 20.0), ylim=(-12.0, 5.0))
    axes.legend(loc="lower right")
    return figure


_LENGTH: Final = 200.0
"""Of the benchmark path in Fig. 12, m."""
_SHOWN: Final = 8
"""Rows of Fig. 14 for each policy."""


def _roll_and_steer(data: Tables, plt: Any) -> Any:
    """Fig. 12: roll, steer and the negated curvature over the first 200 m, and the start of the full circle."""
    figure, (whole, close) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained", width_ratios=(5, 2))
    course = load_course("benchmark")
    rows = data["ride"][data["ride"]["progress"] <= _LENGTH]
    begin = dict(course.sections)["full circle"]
    for axes, shown in ((whole, rows), (close, rows[rows["progress"].between(begin - 5.0, begin + 7.0)])):
        axes.axhline(0.0, color="0.8", lw=0.8)
        axes.plot(shown["progress"], np.degrees(shown["roll"]), color="C0", label="roll φ / °")
        axes.plot(shown["progress"], np.degrees(shown["steer"]), color="C1", label="steer δ / °")
        axes.set_xlabel("along the path / m")
    turn = whole.twinx()
    turn.plot(rows["progress"], -rows["curvature"], "k:", lw=1, label="-κ / (1/m)")
    turn.set_ylabel("-κ / (1/m)")
    handles, names = (
        a + b for a, b in zip(whole.get_legend_handles_labels(), turn.get_legend_handles_labels(), strict=True)
    )
    whole.legend(handles, names, loc="lower right", fontsize="small")
    whole.set(ylabel="angle / °", title="Fig. 12: controller 1 of prop. on the benchmark path at 4 m/s")
    close.axvline(begin, color="k", ls=":", lw=1)
    close.set_title("before the full circle")
    return figure


def _impact(data: Tables, plt: Any) -> Any:
    """Fig. 14: SHAP values of each observation, of controller 1 of prop. and of other actors."""
    import shap  # type: ignore[import-untyped]  # late: it takes seconds

    impacts, chosen = data["impacts"], controller_1(data, "prop")
    shown = impacts[(impacts["setting"] != "prop") | (impacts["seed"] == chosen)]
    policies = list(shown["setting"].unique())
    count = max(1, len(policies))
    figure, row_of_axes = plt.subplots(1, count, figsize=(6 * count, 4.5), layout="constrained", squeeze=False)
    for axes, policy in zip(row_of_axes[0], policies, strict=False):
        rows = select(shown, setting=policy)
        shares, values = (rows.pivot(index="observation", columns="feature", values=name) for name in ("shap", "value"))
        names = [SYMBOLS.get(name, name) for name in shares.columns]
        found = shap.Explanation(np.degrees(shares.to_numpy()), data=values.to_numpy(), feature_names=names)
        shap.plots.beeswarm(found, max_display=_SHOWN, ax=axes, plot_size=None, show=False)
        axes.set(xlabel="SHAP value / °", title=f"Fig. 14: {policy}")
    return figure


def _step_response(data: Tables, plt: Any) -> Any:
    """Fig. 16: step response of the steering angle, and the largest value that is allowed."""
    figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    response = data["steering"]
    axes.plot(response["time"], response["whipple"], label="compiled bicycle")
    axes.plot(response["time"], response["pybullet"], "--", label="PyBullet")
    axes.axhline(70.0, color="k", lw=0.8, label="set point")
    axes.axhline(77.0, color="k", ls=":", lw=1, label="largest allowed")
    axes.set(xlabel="t / s", ylabel="δ / °", title="Fig. 16: steering step from standstill", ylim=(0, None))
    axes.legend(loc="lower right")
    return figure


BICYCLE_FIGURES: Final = {
    "fig8.png": _steps,
    "fig9.png": _learning,
    "fig10.png": _distances,
    "fig11.png": _junction,
    "fig12.png": _roll_and_steer,
    "fig14.png": _impact,
    "fig16.png": _step_response,
}
"""Functions that draw the figures of the bicycle paper, by their files."""

# --------------------------------------------------------------------------------------------- the superbike paper

SPDL_THRESHOLD: Final = 300.0
"""Expected return that SPDL keeps; with 500 it stayed at its first distribution, whose episodes return 390 to 424."""
_AROUND: Final = 80.0
"""Length that is drawn before and behind a corner, m."""
_ELLIPSES: Final = 7
"""Distributions that are drawn of a run."""


def _limits(axes: Any, track: Track, progress: Any) -> None:
    """Draw the limits of a circuit, or of a part of it."""
    for offset in (track.at(track.width_left, progress), -track.at(track.width_right, progress)):
        axes.plot(*track.points(progress, offset)[:, :2].T, color="0.7", lw=1)


def _coloured(axes: Any, moments: pd.DataFrame, shared: tuple[float, float]) -> Any:
    """Draw a ride coloured by its speed."""
    from matplotlib.collections import LineCollection

    points = moments[["x", "y"]].to_numpy()
    parts = np.stack([points[:-1], points[1:]], axis=1)
    line = LineCollection(list(parts), cmap="turbo", linewidths=2.5)
    line.set_array(moments["speed"].to_numpy()[:-1])
    line.set_clim(*shared)
    axes.add_collection(line)
    axes.set(aspect="equal")
    axes.autoscale_view()
    return line


def _flying_laps(data: Tables) -> dict[str, pd.DataFrame]:
    """Return the flying laps by setting."""
    laps = data["moments"].groupby("setting", sort=False)
    return {str(name): rows for name, rows in laps if len(rows) > 1}


def _speed_range(laps: dict[str, pd.DataFrame]) -> tuple[float, float]:
    speeds = pd.concat([rows["speed"] for rows in laps.values()])
    return speeds.min(), speeds.max()


def _lap(data: Tables, plt: Any) -> Any:
    """Fig. 3: a flying lap of the best run of each setting, coloured by speed."""
    rode, track = _flying_laps(data), load_track(CIRCUITS[0])
    names = list(rode) or ["spdl"]
    figure, axes = plt.subplots(1, len(names), figsize=(6 * len(names), 5), layout="constrained", squeeze=False)
    line = None
    for each, name in zip(axes[0], names, strict=True):
        _limits(each, track, np.linspace(0.0, track.length, 2000, endpoint=False))
        if name in rode:
            line = _coloured(each, rode[name], _speed_range(rode))
            seed, time = (rode[name][column].iloc[-1] for column in ("seed", "time"))
            each.set_title(f"Fig. 3: {name.upper()}, seed {seed}, to {time:.1f} s")
        each.set(xlabel="x / m", ylabel="y / m", aspect="equal")
    if line is not None:
        figure.colorbar(line, ax=axes[0][-1], label="speed / (m/s)")
    return figure


def _widest(data: Tables, track: Track) -> Corner:
    found = overshoots(data, "spdl") or overshoots(data, "sac")
    if not found:
        return track.corners[0]
    name = max(found, key=lambda each: found[each])
    return next(corner for corner in track.corners if corner.name == name)


def _overshoot(data: Tables, plt: Any) -> Any:
    """Fig. 4: the corner in which SPDL runs widest, with limits and ideal line, and the distance to it."""
    machine = load_superbike(MACHINE)
    rode, track = _flying_laps(data), track_with_line(CIRCUITS[0], envelope(machine))
    corner = _widest(data, track)
    begin, end = corner.begin - _AROUND, corner.end + _AROUND
    figure, (map_axes, error_axes) = plt.subplots(1, 2, figsize=(12, 5), layout="constrained")
    along = np.linspace(begin, end, 400)
    _limits(map_axes, track, along)
    assert track.ideal is not None, "it was computed"
    map_axes.plot(*track.points(along, track.at(track.ideal, along))[:, :2].T, "k--", lw=1, label="ideal line")
    sign = 1.0 if corner.angle > 0.0 else -1.0
    for name, rows in rode.items():
        shown = rows.assign(at=begin + (rows["progress"] - begin) % track.length).sort_values("at", kind="stable")
        shown = shown[shown["at"] <= end]
        if len(shown) < 2:
            continue
        if name == "spdl":
            figure.colorbar(_coloured(map_axes, shown, _speed_range(rode)), ax=map_axes, label="speed / (m/s)")
        else:
            map_axes.plot(shown["x"], shown["y"], ":", color="k", lw=1.5, label=name.upper())
        error_axes.plot(shown["at"], -sign * shown["error"], color=_COLOURS[name], label=name.upper())
    error_axes.axvspan(corner.begin, corner.end, color="0.92", zorder=0)
    error_axes.axhline(0.0, color="0.6", lw=0.8)
    error_axes.set(xlabel="along the circuit / m", ylabel="outside of the ideal line / m", title="inside below 0")
    map_axes.set(xlabel="x / m", ylabel="y / m", title=f"Fig. 4: corner {corner.name} (coloured: SPDL)", aspect="equal")
    map_axes.legend()
    if error_axes.get_legend_handles_labels()[0]:
        error_axes.legend()
    return figure


def _circuits(data: Tables) -> list[str]:
    """Circuits that were learned on, in the paper's order; the first one where there is none."""
    learned_on = set(map(circuit_of, data["runs"]["setting"]))
    return [circuit for circuit in CIRCUITS if circuit in learned_on] or [CIRCUITS[0]]


def learning(data: Tables, plt: Any) -> Any:
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


def _learned(data: Tables, circuit: str, top: Any, bottom: Any) -> None:
    """Draw the runs on a circuit: returns above, validations below."""
    for kind in KINDS:
        colour, name = _COLOURS[kind], setting_of(kind, circuit)
        top.plot([], [], color=colour, label=kind.upper())
        runs, episodes, found = (select(data[each], setting=name) for each in ("runs", "episodes", "validations"))
        for seed in sorted(runs["seed"].unique()):
            rows, errors = select(episodes, seed=seed), select(found, seed=seed)
            top.plot(rows["step"], rows["total"], color=colour, lw=1, alpha=0.7)
            bottom.plot(errors["step"], errors["error"], ".-", color=colour, lw=1, ms=4, alpha=0.7)
    laps = select(data["laps"], actor="early")
    early = list(laps[laps["setting"].map(circuit_of) == circuit]["step"])
    for axes in (top, bottom) if early else ():
        axes.axvline(early[0], color="0.7", ls=":", lw=1)


def _distribution(data: Tables, plt: Any) -> Any:
    """SPDL's context over its updates on one circuit: means, divergence and value, and ellipses of a run."""
    circuit = _circuits(data)[0]
    figure, axes = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
    figure.suptitle(circuit)
    rows = select(data["contexts"], setting=setting_of("spdl", circuit)).sort_values("iteration", kind="stable")
    paths: dict[Any, pd.DataFrame] = dict(iter(rows.groupby("seed", sort=False)))
    for seed, path in paths.items():
        colour, steps = f"C{seed}", path["step"]
        axes[0, 0].plot(steps, path["kl"], color=colour, label=f"seed {seed}")
        axes[0, 1].plot(steps, path["value"], color=colour)
        axes[1, 0].plot(steps, path["v_max"], color=colour)
        axes[1, 0].plot(steps, 25.0 + 65.0 * path["d_median"], ":", color=colour)
    axes[0, 0].set(ylabel="divergence from the target / nat", title="Divergence")
    axes[0, 1].axhline(SPDL_THRESHOLD, color="k", ls=":", lw=1)
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


def _ellipses(axes: Any, path: pd.DataFrame) -> None:
    """Draw the distribution of speed limit and d_median of some updates, the last one darkest."""
    chosen = np.unique(np.linspace(0, len(path) - 1, _ELLIPSES).round().astype(int))
    angle = np.linspace(0.0, 2.0 * np.pi, 80)
    row: Any
    for number, row in zip(chosen, path.iloc[chosen].itertuples(), strict=True):
        shade = 0.25 + 0.75 * number / max(1, len(path) - 1)
        # Cholesky factor of the covariance of (v_max, d_median).
        across = row.correlation * np.cos(angle) + np.sqrt(max(0.0, 1.0 - row.correlation**2)) * np.sin(angle)
        x = row.v_max + row.std_v_max * np.cos(angle)
        axes.plot(x, row.d_median + row.std_d_median * across, color="C0", alpha=shade)
        axes.plot(row.v_max, row.d_median, ".", color="C0", alpha=shade)
        axes.annotate(str(row.iteration), (row.v_max, row.d_median), fontsize="x-small")
    axes.plot(90.0, 1.0, "k*", ms=10)


SUPERBIKE_FIGURES: Final = {
    "fig3.png": _lap,
    "fig4.png": _overshoot,
    "learning.png": learning,
    "distribution.png": _distribution,
}
"""Functions that draw the figures of the superbike paper, by their files."""
