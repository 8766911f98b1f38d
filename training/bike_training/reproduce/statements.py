"""What the paper says of its experiments, and what the tables say of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_training.reproduce.data import Data, Rides

FloatArray = NDArray[np.float64]

YES, NO, OPEN = "yes", "no", "open"
"""Whether it agrees; open where the runs do not say."""
_DRAWS: Final = 10_000
_SEED: Final = 0
RODE_ALL: Final = ("prop", "alt1", "alt2", "alt3", "alt4")
"""Settings all of whose controllers ride random paths in the paper."""


class Found(NamedTuple):
    """What was found, and whether the paper agrees."""

    text: str
    agrees: str


@dataclass(frozen=True)
class Statement:
    """A statement of the paper.

    Attributes:
        source: section, figure or table. paper: what it says. find: what the tables say.
    """

    source: str
    paper: str
    find: Callable[[Data], Found]


def finished_at(data: Data, setting: str) -> FloatArray:
    """Return the learning steps after which the runs of a setting have ended the curriculum."""
    return np.array([run.finished_at for run in data.runs if run.setting == setting and run.finished_at >= 0], float)


def ended(data: Data, setting: str) -> bool:
    """Return whether there are runs of a setting, and all of them have ended."""
    runs = [run for run in data.runs if run.setting == setting]
    return bool(runs) and all(run.status == "finished" for run in runs)


def interval(values: FloatArray) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of a mean; NaN where there are fewer than two values."""
    if len(values) < 2:
        return float("nan"), float("nan")
    draws = np.random.default_rng(_SEED).choice(values, (_DRAWS, len(values))).mean(axis=1)
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def mean_distance(data: Data, setting: str, course: str) -> dict[float, tuple[float, bool]]:
    """Return T(v) of Eq. (15) by speed, with whether all controllers came to the end; of those that did."""
    found: dict[float, tuple[float, bool]] = {}
    rides = [ride for ride in data.rides if (ride.setting, ride.course) == (setting, course)]
    for speed in sorted({ride.speed for ride in rides}):
        there = [ride for ride in rides if ride.speed == speed]
        means = [ride.mean for ride in there if ride.completed]
        found[speed] = (float(np.mean(means)) if means else float("nan"), len(means) == len(there))
    return found


def controller_1(data: Data, setting: str) -> int | None:
    """Return the seed of the controller with the smallest largest distance on the benchmark path (Sect. 5.3.3)."""
    worst: dict[int, tuple[bool, float]] = {}
    for ride in _benchmark(data, setting):
        fell, largest = worst.get(ride.seed, (False, 0.0))
        worst[ride.seed] = (fell or not ride.completed, max(largest, ride.largest))
    return min(worst, key=lambda seed: worst[seed]) if worst else None


def _benchmark(data: Data, setting: str) -> list[Rides]:
    return [ride for ride in data.rides if (ride.setting, ride.course) == (setting, "benchmark")]


def _steps_below(limit: float, settings: Sequence[str]) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        means = {name: finished_at(data, name) for name in settings}
        text = ", ".join(
            f"{name} {values.mean():,.0f}" if len(values) else f"{name} -" for name, values in means.items()
        )
        if not all(ended(data, name) and len(values) for name, values in means.items()):
            return Found(text, OPEN)
        return Found(text, YES if all(values.mean() < limit for values in means.values()) else NO)

    return find


def _needs_more(setting: str) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        ours, prop = finished_at(data, setting), finished_at(data, "prop")
        total = sum(run.setting == setting for run in data.runs)
        text = f"{len(ours)} of {total} runs finished" + (f", mean {ours.mean():,.0f}" if len(ours) else "")
        if not (ended(data, setting) and ended(data, "prop") and len(prop)):
            return Found(text, OPEN)
        return Found(text, YES if len(ours) < total or ours.mean() > prop.mean() else NO)

    return find


def _no_difference(setting: str) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        ours, prop = finished_at(data, setting), finished_at(data, "prop")
        if min(len(ours), len(prop)) < 2:
            return Found(f"{len(ours)} and {len(prop)} runs finished", OPEN)
        rng = np.random.default_rng(_SEED)
        draws = [rng.choice(values, (_DRAWS, len(values))).mean(axis=1) for values in (ours, prop)]
        low, high = np.percentile(draws[0] - draws[1], [2.5, 97.5])
        text = f"difference of the means {low:+,.0f} to {high:+,.0f} steps (95 %)"
        return Found(text, YES if low <= 0.0 <= high else NO)

    return find


def _part_two(data: Data) -> Found:
    means = {}
    for setting in ("prop", "alt2"):
        spans = []
        for seed in {run.seed for run in data.runs if run.setting == setting}:
            steps = {1: -1, 2: -1}
            for row in sorted(data.validations, key=lambda row: row.step):
                if (row.setting, row.seed) == (setting, seed) and row.part in steps:
                    steps[row.part] = row.step
            later = any((row.setting, row.seed) == (setting, seed) and row.part > 2 for row in data.validations)
            if min(steps.values()) >= 0 and later:
                spans.append(steps[2] - steps[1])
        means[setting] = float(np.mean(spans)) if spans else float("nan")
    ratio = means["alt2"] / means["prop"]
    if not np.isfinite(ratio):
        return Found("no run of both has passed part 2", OPEN)
    return Found(f"{ratio:.0%}", YES if ratio > 1.5 else NO)


def _few_finish(data: Data) -> Found:
    runs = [run for run in data.runs if run.setting == "alt5"]
    done = sum(run.finished_at >= 0 for run in runs)
    return Found(f"{done} of {len(runs)}", OPEN if not ended(data, "alt5") else YES if done < len(runs) else NO)


def _all_ridden(settings: Sequence[str], course: str) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        rides = [ride for ride in data.rides if ride.setting in settings and ride.course == course]
        done = sum(ride.completed for ride in rides)
        missing = sorted(set(settings) - {ride.setting for ride in rides})
        text = f"{done} of {len(rides)} rides" + (f"; no controller of {', '.join(missing)}" if missing else "")
        if done < len(rides):
            return Found(text, NO)
        return Found(text, OPEN if missing else YES)

    return find


def _below(limit: float) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        means = [mean for mean, _ in mean_distance(data, "prop", "benchmark").values() if np.isfinite(mean)]
        if not means:
            return Found("no controller", OPEN)
        return Found(f"largest T {max(means):.3f} m", YES if max(means) < limit else NO)

    return find


def worst_of(data: Data, setting: str) -> tuple[float, float, float, float] | None:
    """Return Table 6 of a setting: largest maximum distance (m), its speed (m/s), largest mean, its speed."""
    seed = controller_1(data, setting)
    rides = [ride for ride in _benchmark(data, setting) if ride.seed == seed]
    if not rides:
        return None
    largest, mean = max(rides, key=lambda ride: ride.largest), max(rides, key=lambda ride: ride.mean)
    return largest.largest, largest.speed, mean.mean, mean.speed


def _table_6(setting: str, largest: float, mean: float) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        worst = worst_of(data, setting)
        if worst is None:
            return Found("no controller", OPEN)
        text = f"{worst[0]:.2f} m at {worst[1]:g} m/s, {worst[2]:.3f} m at {worst[3]:g} m/s"
        return Found(text, YES if worst[0] <= largest and worst[2] <= mean else NO)

    return find


def _largest_front(data: Data, rider: str) -> float | None:
    """Return the largest error of a front contact on the junction, m; infinite where the ride ended early."""
    rows = [row for row in data.tracks if row.rider == rider]
    if not rows:
        return None
    return max(abs(row.front_error) for row in rows) if rows[0].completed else math.inf


def _told(error: float) -> str:
    return f"{error:.2f} m" if math.isfinite(error) else "not ridden to the end"


def _on_junction(data: Data) -> Found:
    error = _largest_front(data, "alt3")
    return Found("no controller", OPEN) if error is None else Found(_told(error), YES if error < 2.0 else NO)


def _beats_stanley(data: Data) -> Found:
    ours = _largest_front(data, "alt3")
    others = {name: _largest_front(data, name) for name in ("stanley", "lqr")}
    text = ", ".join(f"{name}: {_told(error)}" for name, error in others.items() if error is not None)
    stanley = others["stanley"]
    if ours is None or stanley is None:
        return Found(text, OPEN)
    return Found(text, YES if ours < stanley else NO)


STATEMENTS: Final = (
    Statement(
        "Fig. 8",
        "prop., alt(1), alt(3), alt(4) need less than 2,000,000 steps",
        _steps_below(2e6, ("prop", "alt1", "alt3", "alt4")),
    ),
    Statement("Fig. 8", "alt(2) needs more steps than prop. (over 2,500,000)", _needs_more("alt2")),
    Statement("Fig. 8", "alt(5) needs more steps than prop. (over 2,500,000)", _needs_more("alt5")),
    Statement("Sect. 5.2", "the yaw's representation, alt(1), does not change the steps", _no_difference("alt1")),
    Statement("Sect. 5.2", "the front contact, alt(3), makes no difference in learning", _no_difference("alt3")),
    Statement("Sect. 5.2", "the exponential reward, alt(4), makes no difference in learning", _no_difference("alt4")),
    Statement("Sect. 5.2", "alt(2) takes 264 % of prop.'s steps in part 2", _part_two),
    Statement("Sect. 5.2", "two of five runs of alt(5) end the curriculum", _few_finish),
    Statement(
        "Sect. 5.3.2",
        "all controllers of prop. and alt(1-4) ride random paths at all speeds",
        _all_ridden(RODE_ALL, "random"),
    ),
    Statement("Sect. 5.3.3", "all controllers of prop. ride the benchmark path", _all_ridden(("prop",), "benchmark")),
    Statement("Sect. 5.3.3", "all controllers of alt(3) ride the benchmark path", _all_ridden(("alt3",), "benchmark")),
    Statement("Sect. 5.3.3", "T(v) of prop. on the benchmark path is below 0.2 m", _below(0.2)),
    Statement(
        "Table 6", "prop.: at most 0.69 m, in the mean at most 0.09 m, both at 7 m/s", _table_6("prop", 0.69, 0.09)
    ),
    Statement(
        "Table 6",
        "alt(3): at most 0.58 m at 7 m/s, in the mean at most 0.13 m at 2.25 m/s",
        _table_6("alt3", 0.58, 0.13),
    ),
    Statement("Fig. 11", "the controller of alt(3) stays within 2 m of the junction's path", _on_junction),
    Statement("Fig. 11", "it deviates less than the Stanley controller", _beats_stanley),
)
"""Statements that the experiments can answer."""


def table(data: Data) -> str:
    """Return the table "paper says, found, agrees" as Markdown."""
    lines = ["| source | the paper says | found here | agrees |", "|---|---|---|---|"]
    for statement in STATEMENTS:
        found = statement.find(data)
        lines.append(f"| {statement.source} | {statement.paper} | {found.text} | {found.agrees} |")
    return "\n".join(lines) + "\n"
