"""Evaluation of a policy as in the paper: 21 speeds on the benchmark path, then on random paths.

Source: Weyrer et al. (2026), Sects. 5.3.1 to 5.3.3, Fig. 10 and Table 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np

from bike_sim.course.files import load_course
from bike_sim.sim.request import RANDOM_COURSE, ResetRequest
from bike_training.rollout.rollout import RideResult, time_for

SPEEDS: Final = tuple(2.0 + 0.25 * k for k in range(21))
"""The 21 speeds, m/s."""

RANDOM_DURATION: Final = 30.0
"""Duration of a ride on a random path, s."""

PAPER_MEAN: Final = 0.09
PAPER_MAX: Final = 0.69
"""Largest mean and largest maximum distance of the paper's best controller with the proposed settings, m (Table 6)."""

Ride = Callable[[ResetRequest, float], RideResult]
"""Rides a request for at most a time, s."""


def evaluate(
    ride: Ride,
    course_name: str = "benchmark",
    speeds: Sequence[float] = SPEEDS,
    random_rides: int = 1,
    seed: int = 0,
    tick: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Ride all speeds and return the figures.

    Args:
        ride: settings of a ride.
        course_name: the fixed course.
        speeds: m/s.
        random_rides: rides on random paths at each speed.
        seed: seed of the random paths.
        tick: called after each ride.
    """
    course = load_course(course_name)
    rides = []
    for speed in speeds:
        request = ResetRequest(course=course_name, speed_range=(speed, speed))
        rides.append(ride(request, time_for(course, speed)).figures(course.sections))
        tick()
    randoms = []
    for number in range(random_rides):
        for place, speed in enumerate(speeds):
            request = ResetRequest(
                seed=seed + number * len(speeds) + place,
                course=RANDOM_COURSE,
                speed_range=(speed, speed),
                path_length=1.2 * RANDOM_DURATION * speed + 20.0,
            )
            randoms.append(ride(request, RANDOM_DURATION).figures())
            tick()
    return {
        "course": course_name,
        **summary("", rides),
        "rides": rides,
        **summary("random_", randoms),
        "random": randoms,
    }


def summary(prefix: str, rides: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return counts and distances of rides, in names that begin with a prefix; nothing of none.

    Args:
        prefix: of the names.
        rides: figures of each, see `RideResult.figures`.
    """
    if not rides:
        return {}
    return {
        f"{prefix}rides_count": len(rides),
        f"{prefix}completed_count": sum(ride["completed"] for ride in rides),
        f"{prefix}worst_mean_m": max(ride["mean_m"] for ride in rides),
        f"{prefix}worst_max_m": max(ride["max_m"] for ride in rides),
        f"{prefix}average_mean_m": float(np.mean([ride["mean_m"] for ride in rides])),
        f"{prefix}average_steer_rate_deg_s": float(np.mean([ride["steer_rate_rms_deg_s"] for ride in rides])),
    }


def draw(figures: dict[str, Any], name: str, path: Path) -> None:
    """Draw distances over speed as in Fig. 10, and the error of each section of the course.

    Args:
        figures: result of :func:`evaluate`.
        name: of the rider, for the title.
        path: PNG file.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    rides, randoms = figures["rides"], figures["random"]
    fig, (top, middle, bottom) = plt.subplots(3, 1, figsize=(9, 12), layout="constrained")
    speeds = [ride["speed_m_s"] for ride in rides]
    _draw_distances(top, rides, "mean_m", "o-", "mean")
    _draw_distances(top, rides, "max_m", "s--", "maximum")
    top.axhline(
        PAPER_MEAN, color="0.5", lw=1, ls=":", label=f"paper's best controller: mean {PAPER_MEAN} m, max {PAPER_MAX} m"
    )
    top.axhline(PAPER_MAX, color="0.5", lw=1, ls=":")
    top.set(title=f"{name} on {figures['course']}", ylabel="distance / m", ylim=(0, None))
    top.legend()
    if randoms:
        _draw_distances(middle, randoms, "mean_m", "o", "mean of a 30 s ride")
        _draw_distances(middle, randoms, "max_m", "s", "maximum")
        if middle.get_legend_handles_labels()[0]:
            middle.legend()
    middle.set(title="random paths of part 4", xlabel="speed / (m/s)", ylabel="distance / m", ylim=(0, None))
    _draw_sections(fig, bottom, rides, speeds)
    fig.savefig(path, dpi=130)
    plt.close(fig)


def _draw_distances(axes: Any, rides: Sequence[dict[str, Any]], key: str, style: str, label: str) -> None:
    done = [(ride["speed_m_s"], ride[key]) for ride in rides if ride["completed"]]
    if done:
        axes.plot(*zip(*done, strict=True), style, label=label, ms=4)
    for ride in rides:
        if not ride["completed"]:
            axes.axvline(ride["speed_m_s"], color="tab:red", alpha=0.4)


def _draw_sections(fig: Any, axes: Any, rides: Sequence[dict[str, Any]], speeds: Sequence[float]) -> None:
    names: list[str] = []
    for ride in rides:
        names += [part["section"] for part in ride.get("sections", []) if part["section"] not in names]
    table = np.full((len(names), len(rides)), np.nan)
    for column, ride in enumerate(rides):
        for part in ride.get("sections", []):
            row = names.index(part["section"])
            table[row, column] = np.nanmax([table[row, column], part["max_m"]])
    image = axes.imshow(table, aspect="auto", cmap="viridis", origin="upper")
    axes.set_yticks(range(len(names)), names)
    axes.set_xticks(range(0, len(speeds), 4), [f"{speeds[k]:g}" for k in range(0, len(speeds), 4)])
    axes.set(title="largest distance in each section / m", xlabel="speed / (m/s)")
    fig.colorbar(image, ax=axes)
