"""What the paper says of its experiments, and what the tables say of it."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from scipy.stats import fisher_exact

from bike_sim.course.files import load_course
from bike_training.reproduce.bicycle.data import Data, Rides
from bike_training.reproduce.bicycle.detail_figures import weights
from bike_training.reproduce.statement import LEAST_RUNS, NO, OPEN, YES, FloatArray, Found, Statement, interval

_ALIKE: Final = 0.5
"""Share of prop.'s steps within which a difference must lie to count as none."""
RODE_ALL: Final = ("prop", "alt1", "alt2", "alt3", "alt4")
"""Settings all of whose controllers ride random paths in the paper."""


def finished_at(data: Data, setting: str) -> FloatArray:
    """Return the learning steps after which the runs of a setting have ended the curriculum."""
    return np.array([run.finished_at for run in data.runs if run.setting == setting and run.finished_at >= 0], float)


def ended(data: Data, setting: str) -> bool:
    """Return whether there are runs of a setting, and all of them have ended."""
    runs = [run for run in data.runs if run.setting == setting]
    return bool(runs) and all(run.status == "finished" for run in runs)


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


def _all_end(settings: Sequence[str]) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        means = {name: finished_at(data, name) for name in settings}
        totals = {name: sum(run.setting == name for run in data.runs) for name in settings}
        text = ", ".join(
            f"{name} {len(values)} of {totals[name]}" + (f" ({values.mean():,.0f} steps)" if len(values) else "")
            for name, values in means.items()
        )
        if not all(ended(data, name) for name in settings):
            return Found(text, OPEN)
        if all(len(values) == totals[name] for name, values in means.items()):
            return Found(text, YES)
        return Found(*_told_of_cut(data, settings, text))

    return find


def _told_of_cut(data: Data, settings: Sequence[str], text: str) -> tuple[str, str]:
    """Return the text and the verdict where runs have not ended: none if they had too few steps to say so.

    The paper's n_tot is twice what its *prop.* needs and more.
    """
    prop = finished_at(data, "prop")
    steps = [run.steps for run in data.runs if run.setting in settings and run.finished_at < 0]
    if not len(prop) or min(steps) < 2.0 * prop.mean():
        return f"{text}; others were cut off after {min(steps):,} steps, less than twice prop.'s", OPEN
    return text, NO


def _needs_more(setting: str) -> Callable[[Data], Found]:
    """A run that has not ended counts as one that ended with its last step, so the ratio is a lower bound.

    It is none where a run of *prop.* has not ended: those that have would be the quick ones.
    """

    def find(data: Data) -> Found:
        ours, prop = _at_least(data, setting), finished_at(data, "prop")
        done, total = len(finished_at(data, setting)), len(ours)
        text = f"{done} of {total} runs end"
        if not (ended(data, setting) and ended(data, "prop") and len(prop)):
            return Found(text, OPEN)
        if len(prop) < len(_at_least(data, "prop")):
            return Found(f"{text}, of prop. {len(prop)} of {len(_at_least(data, 'prop'))}", OPEN)
        low, high = interval(ours, prop, rule=operator.truediv)
        mean = ours.mean() / prop.mean()
        text += f"; {'at least ' if done < total else ''}{mean:.2f} times prop.'s steps ({low:.2f} to {high:.2f})"
        if not (low > 1.0 or high < 1.0) or min(len(ours), len(prop)) < LEAST_RUNS:
            return Found(text, OPEN)
        return Found(text, YES if low > 1.0 else NO)

    return find


def _at_least(data: Data, setting: str) -> FloatArray:
    """Return the steps to the end of the curriculum, of runs that did not end it all they made."""
    runs = [run for run in data.runs if run.setting == setting]
    return np.array([run.finished_at if run.finished_at >= 0 else run.steps for run in runs], float)


def _no_difference(setting: str) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        ours, prop = finished_at(data, setting), finished_at(data, "prop")
        totals = [sum(run.setting == name for run in data.runs) for name in (setting, "prop")]
        if min(len(ours), len(prop)) < 2 or [len(ours), len(prop)] != totals:
            text = f"{len(ours)} of {totals[0]} and {len(prop)} of {totals[1]} runs end"
            return Found(text, OPEN)
        low, high = interval(ours, prop, rule=operator.sub)
        text = f"difference of the means {low:+,.0f} to {high:+,.0f} steps (95 %)"
        if min(totals) < LEAST_RUNS or (low <= 0.0 <= high and max(-low, high) > _ALIKE * prop.mean()):
            return Found(text, OPEN)
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
    text = f"{done} of {len(runs)}"
    if not ended(data, "alt5") or done == len(runs):
        return Found(text, NO if runs and done == len(runs) else OPEN)
    text, verdict = _told_of_cut(data, ["alt5"], text)
    return Found(text, YES if done and verdict == NO else OPEN)


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


def _fails_slow(data: Data) -> Found:
    rides = [ride for ride in data.rides if ride.course == "benchmark" and ride.setting in RODE_ALL]
    failed = [ride for ride in rides if not ride.completed]
    if not rides:
        return Found("no controller", OPEN)
    places = sorted({(ride.setting, ride.speed) for ride in failed})
    text = ", ".join(f"{name} at {speed:g} m/s" for name, speed in places[:8]) or "none fails"
    text = f"{len(failed)} of {len(rides)} rides" + (f": {text}" if failed else "")
    return Found(text, YES if all(ride.speed <= 2.25 for ride in failed) else NO)


def _least_in_the_middle(data: Data) -> Found:
    found = {speed: mean for speed, (mean, _) in mean_distance(data, "prop", "benchmark").items() if np.isfinite(mean)}
    if len(found) < 3:
        return Found("no controller", OPEN)
    best = min(found, key=lambda speed: found[speed])
    low, high = min(found), max(found)
    text = f"{found[best]:.3f} m at {best:g} m/s; {found[low]:.3f} m at {low:g}, {found[high]:.3f} m at {high:g} m/s"
    return Found(text, YES if low < best < high else NO)


def _leans_with_curvature(data: Data) -> Found:
    rows = [row for row in data.ride if row.progress <= 200.0]
    if len(rows) < 2 or not any(row.curvature for row in rows):
        return Found("no ride", OPEN)
    found = float(np.corrcoef([row.roll for row in rows], [-row.curvature for row in rows])[0, 1])
    return Found(f"correlation {found:.2f}", YES if found > 0.9 else NO)


def _counter_steers(data: Data) -> Found:
    begin = dict(load_course("benchmark").sections)["full circle"]
    before = [row for row in data.ride if begin - 4.0 <= row.progress <= begin]
    if not before or data.ride[-1].progress <= begin:
        return Found("no ride", OPEN)
    steer, roll = min(row.steer for row in before), before[-1].roll
    text = f"steer down to {math.degrees(steer):.1f}°, roll {math.degrees(roll):.1f}° at the circle's start"
    return Found(text, YES if steer < 0.0 and roll < 0.0 else NO)


def _correlation(data: Data, policy: str, feature: str) -> float:
    rows = [row for row in data.impacts if (row.policy, row.feature) == (policy, feature)]
    return float(np.corrcoef([row.value for row in rows], [row.shap for row in rows])[0, 1])


def _weightiest(data: Data) -> Found:
    means = weights(data.impacts, "prop")
    if not means:
        return Found("no controller", OPEN)
    total, names = sum(means.values()), list(means)[:5]
    text = ", ".join(f"{name} {means[name] / total:.0%}" for name in names)
    return Found(text, YES if set(names) == {"roll", "t_p3", "t_p2", "roll_rate", "t_p4"} else NO)


def _weightiest_is_roll(data: Data) -> Found:
    means = weights(data.impacts, "prop")
    if not means:
        return Found("no controller", OPEN)
    first = next(iter(means))
    return Found(first, YES if first == "roll" else NO)


def _pulls_down(features: Sequence[str]) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        if not weights(data.impacts, "prop"):
            return Found("no controller", OPEN)
        found = {name: _correlation(data, "prop", name) for name in features}
        text = "correlation " + ", ".join(f"{name} {value:+.2f}" for name, value in found.items())
        return Found(text, YES if all(value < -0.5 for value in found.values()) else NO)

    return find


def _pulls_together(data: Data) -> Found:
    rows = [row for row in data.impacts if row.policy == "prop" and row.feature in ("t_p2", "t_p3", "t_p4")]
    if not rows:
        return Found("no controller", OPEN)
    numbers = sorted({row.observation for row in rows})
    sums = [
        [sum(part) for part in zip(*((r.value, r.shap) for r in rows if r.observation == n), strict=True)]
        for n in numbers
    ]
    found = float(np.corrcoef(np.array(sums).T)[0, 1])
    return Found(f"correlation {found:+.2f}", YES if found < -0.5 else NO)


def _hardly_any_weight(features: Sequence[str]) -> Callable[[Data], Found]:
    def find(data: Data) -> Found:
        means = weights(data.impacts, "prop")
        if not means:
            return Found("no controller", OPEN)
        total = sum(means.values())
        text = ", ".join(f"{name} {means[name] / total:.1%}" for name in features)
        return Found(text, YES if not set(features) & set(list(means)[:5]) else NO)

    return find


def _directions(data: Data) -> Found:
    if not data.directions:
        return Found("not measured", OPEN)
    engines = ("formula", "whipple", "pybullet")
    errors = {name: max(abs(getattr(row, name) - row.published) for row in data.directions) for name in engines}
    text = "largest difference " + ", ".join(f"{name} {error:.3f}°" for name, error in errors.items())
    return Found(text, YES if max(errors.values()) < 0.1 else NO)


def _overshoot(data: Data) -> Found:
    if not data.steering:
        return Found("not measured", OPEN)
    peaks = {name: max(getattr(row, name) for row in data.steering) / 70.0 - 1.0 for name in ("whipple", "pybullet")}
    text = ", ".join(f"{name} {peak:.1%}" for name, peak in peaks.items())
    return Found(text, YES if all(0.0 < peak <= 0.1 for peak in peaks.values()) else NO)


def _rare_circles(data: Data) -> Found:
    """Agree where Fisher's exact test of the two counts finds no difference at 5 %."""
    if not data.chances:
        return Found("not drawn", OPEN)
    chance = data.chances[0]
    table = [[chance.circles, chance.paths - chance.circles], [20, 9_980]]
    text = f"{chance.circles} of {chance.paths:,} paths ({chance.circles / chance.paths:.2%})"
    return Found(text, YES if float(fisher_exact(table).pvalue) > 0.05 else NO)


STATEMENTS: Final = (
    Statement(
        "Fig. 8",
        "all runs of prop. and alt(1-4) end the curriculum",
        _all_end(RODE_ALL),
    ),
    Statement("Fig. 8", "alt(2) needs more steps than prop. (over 2.5 against under 2 million)", _needs_more("alt2")),
    Statement("Fig. 8", "alt(5) needs more steps than prop. (over 2.5 against under 2 million)", _needs_more("alt5")),
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
    Statement(
        "Sect. 5.3.3", "on the benchmark path controllers of prop. and alt(1-4) fail at 2.25 m/s at most", _fails_slow
    ),
    Statement(
        "Sect. 5.3.3",
        "T(v) of prop. is least at 4.25 m/s (0.08 m), and larger at 2 (0.19 m) and 7 m/s (0.15 m)",
        _least_in_the_middle,
    ),
    Statement("Fig. 11", "the controller of alt(3) stays within 2 m of the junction's path", _on_junction),
    Statement("Fig. 11", "it deviates less than the Stanley controller", _beats_stanley),
    Statement("Fig. 12", "the roll is proportional to the negated curvature", _leans_with_curvature),
    Statement("Fig. 12", "before the circle to the left it steers right and leans left", _counter_steers),
    Statement("Fig. 14", "the roll has the greatest impact", _weightiest_is_roll),
    Statement("Fig. 14", "roll, t_P3, t_P2, roll rate and t_P4 weigh most", _weightiest),
    Statement("Sect. 5.5", "steers into the fall: roll pulls to the other sign", _pulls_down(["roll"])),
    Statement("Sect. 5.5", "t_P3 and t_P2 pull to the other sign", _pulls_down(["t_p3", "t_p2"])),
    Statement("Sect. 6", "counter-steers: t_P2 to t_P4 together pull to the other sign", _pulls_together),
    Statement(
        "Sects. 5.5 and 6",
        "yaw and front wheel rate are among the others",
        _hardly_any_weight(["yaw_cos", "yaw_sin", "front_wheel_rate"]),
    ),
    Statement("Sect. 6", "20 of 10,000 paths of learning have a full circle (0.2 %)", _rare_circles),
    Statement("Table 8", "direction of the front contact in nine postures", _directions),
    Statement("Appendix B", "P = 9 Nm, D = 1.6 Nms overshoot by at most 10 %", _overshoot),
)
"""Statements that the experiments can answer."""
