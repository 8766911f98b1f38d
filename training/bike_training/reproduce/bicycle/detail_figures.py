"""Figures 12 to 14 and 16 of Weyrer et al. (2026), drawn from the tables alone."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from bike_sim.course.course import Course
from bike_sim.course.files import load_course
from bike_training.explain.drawing import SYMBOLS
from bike_training.reproduce.bicycle.data import Data, Impact, Instant

_LENGTH: Final = 200.0
"""Of the benchmark path in Fig. 12, m."""
_PREVIEW: Final = 4.0 * 0.4
"""Distance of preview points at 4 m/s, m (Eq. 14)."""
_SHOWN: Final = 8
"""Rows of Fig. 14 for each policy."""
_FRAMES: Final = (
    ("a", "full circle", -3.0),
    ("b", "slalom", 23.6),
    ("c", "flat curve", 31.4),
    ("d", "soft lane change", 2.0),
    ("e", "hard lane change", 2.0),
    ("f", "hard lane change", 9.0),
)
"""Frames of Fig. 13: name, section, and how far into it (m). The paper shows them, but gives no numbers."""


def roll_and_steer(data: Data, plt: Any) -> Any:
    """Fig. 12: roll, steer and the negated curvature over the first 200 m, and the start of the full circle."""
    figure, (whole, close) = plt.subplots(
        1, 2, figsize=(11, 4), layout="constrained", width_ratios=(5, 2)
    )  # fmt: skip
    course = load_course("benchmark")
    rows = [row for row in data.ride if row.progress <= _LENGTH]
    begin = dict(course.sections)["full circle"]
    for axes, shown in ((whole, rows), (close, [row for row in rows if begin - 5.0 <= row.progress <= begin + 7.0])):
        along = [row.progress for row in shown]
        axes.axhline(0.0, color="0.8", lw=0.8)
        axes.plot(along, np.degrees([row.roll for row in shown]), color="C0", label="roll φ / °")
        axes.plot(along, np.degrees([row.steer for row in shown]), color="C1", label="steer δ / °")
        axes.set_xlabel("along the path / m")
    turn = whole.twinx()
    turn.plot([row.progress for row in rows], [-row.curvature for row in rows], "k:", lw=1, label="-κ / (1/m)")
    turn.set_ylabel("-κ / (1/m)")
    handles, names = (
        a + b for a, b in zip(whole.get_legend_handles_labels(), turn.get_legend_handles_labels(), strict=True)
    )
    whole.legend(handles, names, loc="lower right", fontsize="small")
    whole.set(ylabel="angle / °", title="Fig. 12: controller 1 of prop. on the benchmark path at 4 m/s")
    close.axvline(begin, color="k", ls=":", lw=1)
    close.set_title("before the full circle")
    return figure


def frames(data: Data, plt: Any) -> Any:
    """Fig. 13: track of the rear contact, and six instants from above with the preview points."""
    figure, axes = plt.subplot_mosaic("TTT;abc;def", figsize=(9, 10), layout="constrained", height_ratios=(4, 3, 3))
    course = load_course("benchmark")
    track = axes["T"]
    track.plot(course.x, course.y, color="0.75", lw=3, label="path")
    track.plot([row.x for row in data.ride], [row.y for row in data.ride], color="C0", lw=1, label="rear contact P")
    sections = dict(course.sections)
    for name, section, into in _FRAMES:
        if not data.ride:
            break
        row = min(data.ride, key=lambda row: abs(row.progress - sections[section] - into))
        track.annotate(f"({name})", (row.x, row.y), xytext=(6, 6), textcoords="offset points")
        track.plot(row.x, row.y, "k.", ms=6)
        _frame(axes[name], course, data, row)
        axes[name].set_title(
            f"({name}) φ {np.degrees(row.roll):+.1f}°, δ {np.degrees(row.steer):+.1f}°", fontsize="small"
        )
    track.set(aspect="equal", xlabel="x / m", ylabel="y / m", title="Fig. 13: controller 1 of prop. at 4 m/s")
    track.legend(loc="best")
    return figure


def _frame(axes: Any, course: Course, data: Data, row: Instant) -> None:
    """Draw a bicycle from above: its wheelbase, the path, its track so far, and the preview points."""
    axes.plot(course.x, course.y, color="0.75", lw=3)
    axes.plot([each.x for each in data.ride], [each.y for each in data.ride], color="C0", lw=1)
    ahead = [row.progress + k * _PREVIEW for k in range(5)]
    axes.plot(np.interp(ahead, course.s, course.x), np.interp(ahead, course.s, course.y), "o", color="C3", ms=4)
    axes.plot([row.x, row.front_x], [row.y, row.front_y], "k-o", lw=3, ms=4)
    middle_x, middle_y = np.interp(ahead[2], course.s, course.x), np.interp(ahead[2], course.s, course.y)
    axes.set(aspect="equal", xlim=(middle_x - 5.0, middle_x + 5.0), ylim=(middle_y - 5.0, middle_y + 5.0))
    axes.tick_params(labelsize="x-small")


def weights(impacts: tuple[Impact, ...], policy: str) -> dict[str, float]:
    """Return the mean magnitude of the SHAP values of each feature of a policy, rad, largest first."""
    found: dict[str, list[float]] = {}
    for row in impacts:
        if row.policy == policy:
            found.setdefault(row.feature, []).append(abs(row.shap))
    means = {feature: float(np.mean(values)) for feature, values in found.items()}
    return dict(sorted(means.items(), key=lambda item: -item[1]))


def impact(data: Data, plt: Any) -> Any:
    """Fig. 14: SHAP values of each observation, of controller 1 of prop. and of other actors."""
    policies = list(dict.fromkeys(row.policy for row in data.impacts)) or ["prop"]
    figure, row_of_axes = plt.subplots(
        1, len(policies), figsize=(6 * len(policies), 4.5), layout="constrained", squeeze=False
    )  # fmt: skip
    dots = None
    for axes, policy in zip(row_of_axes[0], policies, strict=True):
        means = weights(data.impacts, policy)
        total = sum(means.values()) or 1.0
        names = list(means)[:_SHOWN]
        for place, name in enumerate(names):
            dots = _swarm(axes, place, [row for row in data.impacts if (row.policy, row.feature) == (policy, name)])
        labels = [f"{SYMBOLS.get(name, name)}\n{means[name] / total:.0%}" for name in names]
        axes.axvline(0.0, color="0.8", lw=0.8, zorder=0)
        axes.set_yticks(range(len(names)), labels, fontsize="small")
        axes.invert_yaxis()
        others = sum(list(means.values())[_SHOWN:]) / total
        axes.set(xlabel="SHAP value / °", title=f"Fig. 14: {policy}, {len(means) - len(names)} others {others:.0%}")
    if dots is not None:
        figure.colorbar(dots, ax=row_of_axes[0][-1], label="value of the feature, low to high", ticks=[])
    return figure


def _swarm(axes: Any, place: int, rows: list[Impact]) -> Any:
    """Draw one dot an observation; those of like values spread around their row."""
    shares = np.degrees([row.shap for row in rows])
    values = np.array([row.value for row in rows])
    spread = np.ptp(values)
    colours = (values - values.min()) / spread if spread else np.full(len(values), 0.5)
    height = np.random.default_rng(place).uniform(-0.25, 0.25, len(rows))
    return axes.scatter(shares, place + height, c=colours, cmap="coolwarm", vmin=0.0, vmax=1.0, s=9)


def step_response(data: Data, plt: Any) -> Any:
    """Fig. 16: step response of the steering angle, and the largest value that is allowed."""
    figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
    time = [row.time for row in data.steering]
    axes.plot(time, [row.whipple for row in data.steering], label="compiled bicycle")
    axes.plot(time, [row.pybullet for row in data.steering], "--", label="PyBullet")
    axes.axhline(70.0, color="k", lw=0.8, label="set point")
    axes.axhline(77.0, color="k", ls=":", lw=1, label="largest allowed")
    axes.set(xlabel="t / s", ylabel="δ / °", title="Fig. 16: steering step from standstill", ylim=(0, None))
    axes.legend(loc="lower right")
    return figure
