"""Tables of the bicycle paper's experiments, its statements, and its tables as Markdown (Weyrer et al. 2026)."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from scipy.stats import fisher_exact

from bike_sim.course.files import load_course
from bike_training.reproduce.data import Run, Tables, read_paper, row_kinds, tables_of
from bike_training.reproduce.statement import (
    MIN_RUNS,
    FloatArray,
    NothingFound,
    Verdict,
    interval,
    markdown,
    some,
    statements_of,
    with_interval,
)

PAPER: Final = read_paper("bicycle")
Data: Final = tables_of(PAPER)
"""All tables; the error of a validation is the mean of its errors e_i (Eq. 12)."""
Rides, Track, Instant, Impact, Direction, SteeringStep, Chance = row_kinds(Data)

# ------------------------------------------------------------------------------------------------------- learning

_ALIKE: Final = 0.5
"""Share of prop.'s steps within which a difference must lie to count as none."""
RODE_ALL: Final = ("prop", "alt1", "alt2", "alt3", "alt4")
"""Settings all of whose controllers ride random paths in the paper."""
NO_CONTROLLER: Final = "no controller"


def runs_of(data: Tables, *settings: str) -> list[Run]:
    """Return the runs of some settings."""
    return [run for run in data.runs if run.setting in settings]


def finished_at(data: Tables, setting: str) -> FloatArray:
    """Return the learning steps after which the runs of a setting have ended the curriculum."""
    return np.array([run.finished_at for run in runs_of(data, setting) if run.finished_at >= 0], float)


def _ended(data: Tables, *settings: str) -> bool:
    """Return whether there are runs of all settings, and all of them have ended."""
    each = [runs_of(data, name) for name in settings]
    return all(each) and all(run.status == "finished" for runs in each for run in runs)


def _all_end(data: Tables, settings: Sequence[str]) -> Verdict:
    means = {name: finished_at(data, name) for name in settings}
    totals = {name: len(runs_of(data, name)) for name in settings}
    text = ", ".join(
        f"{name} {len(values)} of {totals[name]}" + (f" ({values.mean():,.0f} steps)" if len(values) else "")
        for name, values in means.items()
    )
    if not _ended(data, *settings):
        return text, None
    if all(len(values) == totals[name] for name, values in means.items()):
        return text, True
    return _of_cut_runs(data, settings, text)


def _of_cut_runs(data: Tables, settings: Sequence[str], text: str) -> Verdict:
    """Return the verdict where runs have not ended: open if they had too few steps to say so.

    The paper's n_tot is twice what its *prop.* needs and more.
    """
    prop = finished_at(data, "prop")
    steps = [run.steps for run in runs_of(data, *settings) if run.finished_at < 0]
    if not len(prop) or min(steps) < 2.0 * prop.mean():
        return f"{text}; others were cut off after {min(steps):,} steps, less than twice prop.'s", None
    return text, False


def _needs_more(data: Tables, setting: str) -> Verdict:
    """A run that has not ended counts as one that ended with its last step, so the ratio is a lower bound.

    It is open where a run of *prop.* has not ended: those that have would be the quick ones.
    """
    ours = np.array([run.finished_at if run.finished_at >= 0 else run.steps for run in runs_of(data, setting)], float)
    prop, of_prop = finished_at(data, "prop"), len(runs_of(data, "prop"))
    done, total = len(finished_at(data, setting)), len(ours)
    text = f"{done} of {total} runs end"
    if not (_ended(data, setting, "prop") and len(prop)):
        return text, None
    if len(prop) < of_prop:
        return f"{text}, of prop. {len(prop)} of {of_prop}", None
    low, high = interval(ours, prop, rule=operator.truediv)
    mean = ours.mean() / prop.mean()
    text += f"; {'at least ' if done < total else ''}{mean:.2f} times prop.'s steps ({low:.2f} to {high:.2f})"
    if not (low > 1.0 or high < 1.0) or min(len(ours), len(prop)) < MIN_RUNS:
        return text, None
    return text, low > 1.0


def _no_difference(data: Tables, setting: str) -> Verdict:
    ours, prop = finished_at(data, setting), finished_at(data, "prop")
    totals = [len(runs_of(data, name)) for name in (setting, "prop")]
    if min(len(ours), len(prop)) < 2 or [len(ours), len(prop)] != totals:
        return f"{len(ours)} of {totals[0]} and {len(prop)} of {totals[1]} runs end", None
    low, high = interval(ours, prop, rule=operator.sub)
    text = f"difference of the means {low:+,.0f} to {high:+,.0f} steps (95 %)"
    if min(totals) < MIN_RUNS or (low <= 0.0 <= high and max(-low, high) > _ALIKE * prop.mean()):
        return text, None
    return text, low <= 0.0 <= high


def _part_two(data: Tables) -> Verdict:
    means = {}
    for setting in ("prop", "alt2"):
        spans = []
        for seed in {run.seed for run in runs_of(data, setting)}:
            rows = [row for row in data.validations if (row.setting, row.seed) == (setting, seed)]
            ends = {part: max((row.step for row in rows if row.part == part), default=-1) for part in (1, 2)}
            if min(ends.values()) >= 0 and any(row.part > 2 for row in rows):
                spans.append(ends[2] - ends[1])
        means[setting] = float(np.mean(some(spans, "no run of both has passed part 2")))
    ratio = means["alt2"] / means["prop"]
    return f"{ratio:.0%}", ratio > 1.5


def _few_finish(data: Tables) -> Verdict:
    runs = runs_of(data, "alt5")
    done = len(finished_at(data, "alt5"))
    text = f"{done} of {len(runs)}"
    if runs and done == len(runs):
        return text, False
    if not _ended(data, "alt5"):
        return text, None
    text, verdict = _of_cut_runs(data, ["alt5"], text)
    return text, True if done and verdict is False else None


# ---------------------------------------------------------------------------------------------------------- rides


def mean_distance(data: Tables, setting: str, course: str) -> dict[float, tuple[float, bool]]:
    """Return T(v) of Eq. (15) by speed, with whether all controllers came to the end; of those that did."""
    found: dict[float, tuple[float, bool]] = {}
    rides = [ride for ride in data.rides if (ride.setting, ride.course) == (setting, course)]
    for speed in sorted({ride.speed for ride in rides}):
        there = [ride for ride in rides if ride.speed == speed]
        means = [ride.mean for ride in there if ride.completed]
        found[speed] = (float(np.mean(means)) if means else float("nan"), len(means) == len(there))
    return found


def _known_distances(data: Tables) -> dict[float, float]:
    """Return T(v) of *prop.* on the benchmark path at the speeds at which a controller came to the end."""
    found = mean_distance(data, "prop", "benchmark").items()
    return {speed: mean for speed, (mean, _) in found if np.isfinite(mean)}


def controller_1(data: Tables, setting: str) -> int | None:
    """Return the seed of the controller with the smallest largest distance on the benchmark path (Sect. 5.3.3)."""
    worst: dict[int, tuple[bool, float]] = {}
    for ride in _benchmark(data, setting):
        fell, largest = worst.get(ride.seed, (False, 0.0))
        worst[ride.seed] = (fell or not ride.completed, max(largest, ride.largest))
    return min(worst, key=lambda seed: worst[seed]) if worst else None


def _benchmark(data: Tables, setting: str) -> list[Any]:
    return [ride for ride in data.rides if (ride.setting, ride.course) == (setting, "benchmark")]


def _all_ridden(data: Tables, settings: Sequence[str], course: str) -> Verdict:
    rides = [ride for ride in data.rides if ride.setting in settings and ride.course == course]
    done = sum(ride.completed for ride in rides)
    missing = sorted(set(settings) - {ride.setting for ride in rides})
    text = f"{done} of {len(rides)} rides" + (f"; no controller of {', '.join(missing)}" if missing else "")
    return text, False if done < len(rides) else None if missing else True


def _below(data: Tables, limit: float) -> Verdict:
    largest = max(some(_known_distances(data), NO_CONTROLLER).values())
    return f"largest T {largest:.3f} m", largest < limit


def worst_of(data: Tables, setting: str) -> tuple[Any, Any] | None:
    """Return the benchmark rides of controller 1 with the largest maximum and with the largest mean (Table 6)."""
    seed = controller_1(data, setting)
    rides = [ride for ride in _benchmark(data, setting) if ride.seed == seed]
    if not rides:
        return None
    return max(rides, key=lambda ride: ride.largest), max(rides, key=lambda ride: ride.mean)


def _largest_distances(data: Tables, setting: str, largest: float, mean: float) -> Verdict:
    by_maximum, by_mean = some(worst_of(data, setting) or (), NO_CONTROLLER)
    text = f"{by_maximum.largest:.2f} m at {by_maximum.speed:g} m/s, {by_mean.mean:.3f} m at {by_mean.speed:g} m/s"
    return text, by_maximum.largest <= largest and by_mean.mean <= mean


def _fails_slow(data: Tables) -> Verdict:
    rides = [ride for ride in data.rides if ride.course == "benchmark" and ride.setting in RODE_ALL]
    failed = [ride for ride in some(rides, NO_CONTROLLER) if not ride.completed]
    places = sorted({(ride.setting, ride.speed) for ride in failed})
    text = ", ".join(f"{name} at {speed:g} m/s" for name, speed in places[:8])
    text = f"{len(failed)} of {len(rides)} rides" + (f": {text}" if failed else "")
    return text, all(ride.speed <= 2.25 for ride in failed)


def _least_in_the_middle(data: Tables) -> Verdict:
    found = _known_distances(data)
    if len(found) < 3:
        raise NothingFound(NO_CONTROLLER)
    best = min(found, key=lambda speed: found[speed])
    low, high = min(found), max(found)
    text = f"{found[best]:.3f} m at {best:g} m/s; {found[low]:.3f} m at {low:g}, {found[high]:.3f} m at {high:g} m/s"
    return text, low < best < high


def _junction_error(data: Tables, rider: str) -> float | None:
    """Return the largest error of a front contact on the junction, m; infinite where the ride ended early."""
    rows = [row for row in data.tracks if row.rider == rider]
    if not rows:
        return None
    return max(abs(row.front_error) for row in rows) if rows[0].completed else math.inf


def _error_text(error: float) -> str:
    return f"{error:.2f} m" if math.isfinite(error) else "not ridden to the end"


def _on_junction(data: Tables) -> Verdict:
    error = _junction_error(data, "alt3")
    if error is None:
        raise NothingFound(NO_CONTROLLER)
    return _error_text(error), error < 2.0


def _beats_stanley(data: Tables) -> Verdict:
    ours = _junction_error(data, "alt3")
    others = {name: _junction_error(data, name) for name in ("stanley", "lqr")}
    text = ", ".join(f"{name}: {_error_text(error)}" for name, error in others.items() if error is not None)
    stanley = others["stanley"]
    return text, None if ours is None or stanley is None else ours < stanley


# ----------------------------------------------------------------------------------------- one controller closely


def _leans_with_curvature(data: Tables) -> Verdict:
    rows = [row for row in data.ride if row.progress <= 200.0]
    if len(rows) < 2 or not any(row.curvature for row in rows):
        raise NothingFound("no ride")
    found = float(np.corrcoef([row.roll for row in rows], [-row.curvature for row in rows])[0, 1])
    return f"correlation {found:.2f}", found > 0.9


def _counter_steers(data: Tables) -> Verdict:
    begin = dict(load_course("benchmark").sections)["full circle"]
    before = [row for row in data.ride if begin - 4.0 <= row.progress <= begin]
    if not before or data.ride[-1].progress <= begin:
        raise NothingFound("no ride")
    steer, roll = min(row.steer for row in before), before[-1].roll
    text = f"steer down to {math.degrees(steer):.1f}°, roll {math.degrees(roll):.1f}° at the circle's start"
    return text, steer < 0.0 and roll < 0.0


def weights(impacts: Sequence[Any], policy: str) -> dict[str, float]:
    """Return the mean magnitude of the SHAP values of each feature of a policy, rad, largest first."""
    found: dict[str, list[float]] = {}
    for row in impacts:
        if row.policy == policy:
            found.setdefault(row.feature, []).append(abs(row.shap))
    means = {feature: float(np.mean(values)) for feature, values in found.items()}
    return dict(sorted(means.items(), key=lambda item: -item[1]))


def _shares(data: Tables) -> dict[str, float]:
    """Return the share of each feature in the magnitudes of all, of controller 1 of *prop.*, largest first."""
    means = some(weights(data.impacts, "prop"), NO_CONTROLLER)
    total = sum(means.values())
    return {name: mean / total for name, mean in means.items()}


def _weightiest(data: Tables) -> Verdict:
    shares = _shares(data)
    names = list(shares)[:5]
    text = ", ".join(f"{name} {shares[name]:.0%}" for name in names)
    return text, set(names) == {"roll", "t_p3", "t_p2", "roll_rate", "t_p4"}


def _weightiest_is_roll(data: Tables) -> Verdict:
    first = next(iter(_shares(data)))
    return first, first == "roll"


def _correlation(data: Tables, *features: str) -> float:
    """Return the correlation of features of *prop.* with their SHAP values, each summed over the features."""
    rows = [row for row in data.impacts if row.policy == "prop" and row.feature in features]
    sums: dict[int, tuple[float, float]] = {}
    for row in some(rows, NO_CONTROLLER):
        value, shap = sums.get(row.observation, (0.0, 0.0))
        sums[row.observation] = (value + row.value, shap + row.shap)
    return float(np.corrcoef(np.array(list(sums.values())).T)[0, 1])


def _pulls_down(data: Tables, *features: str) -> Verdict:
    found = {name: _correlation(data, name) for name in features}
    text = "correlation " + ", ".join(f"{name} {value:+.2f}" for name, value in found.items())
    return text, all(value < -0.5 for value in found.values())


def _pulls_together(data: Tables) -> Verdict:
    found = _correlation(data, "t_p2", "t_p3", "t_p4")
    return f"correlation {found:+.2f}", found < -0.5


def _hardly_any_weight(data: Tables, *features: str) -> Verdict:
    shares = _shares(data)
    text = ", ".join(f"{name} {shares[name]:.1%}" for name in features)
    return text, not set(features) & set(list(shares)[:5])


def _directions(data: Tables) -> Verdict:
    rows = some(data.directions, "not measured")
    engines = ("formula", "whipple", "pybullet")
    errors = {name: max(abs(getattr(row, name) - row.published) for row in rows) for name in engines}
    text = "largest difference " + ", ".join(f"{name} {error:.3f}°" for name, error in errors.items())
    return text, max(errors.values()) < 0.1


def _overshoot(data: Tables) -> Verdict:
    rows = some(data.steering, "not measured")
    peaks = {name: max(getattr(row, name) for row in rows) / 70.0 - 1.0 for name in ("whipple", "pybullet")}
    text = ", ".join(f"{name} {peak:.1%}" for name, peak in peaks.items())
    return text, all(0.0 < peak <= 0.1 for peak in peaks.values())


def _rare_circles(data: Tables) -> Verdict:
    """Agree where Fisher's exact test of the two counts finds no difference at 5 %."""
    chance = some(data.chances, "not drawn")[0]
    counts = [[chance.circles, chance.paths - chance.circles], [20, 9_980]]
    text = f"{chance.circles} of {chance.paths:,} paths ({chance.circles / chance.paths:.2%})"
    return text, float(fisher_exact(counts).pvalue) > 0.05


STATEMENTS: Final = statements_of(
    PAPER,
    _all_end,
    _all_ridden,
    _beats_stanley,
    _below,
    _counter_steers,
    _directions,
    _fails_slow,
    _few_finish,
    _hardly_any_weight,
    _largest_distances,
    _leans_with_curvature,
    _least_in_the_middle,
    _needs_more,
    _no_difference,
    _on_junction,
    _overshoot,
    _part_two,
    _pulls_down,
    _pulls_together,
    _rare_circles,
    _weightiest,
    _weightiest_is_roll,
)
"""Statements that the experiments can answer."""


# --------------------------------------------------------------------------------------------------------- tables


def _settings(data: Tables) -> str:
    rows = []
    for name in dict.fromkeys(run.setting for run in data.runs):
        done, ridden = finished_at(data, name), _benchmark(data, name)
        # Mean distance of each controller, over the rides that came to the end.
        by_seed = [
            [ride.mean for ride in ridden if ride.completed and ride.seed == seed]
            for seed in sorted({ride.seed for ride in ridden})
        ]
        means = np.array([np.mean(values) for values in by_seed if values])
        others = [ride.completed for ride in data.rides if (ride.setting, ride.course) == (name, "random")]
        cells = (f"{sum(each)} of {len(each)}" for each in ([ride.completed for ride in ridden], others))
        ended = f"{len(done)} of {len(runs_of(data, name))}"
        rows.append((name, ended, with_interval(done, ",.0f"), with_interval(means, ".3f"), *cells))
    head = ("setting", "curricula ended", "steps to the end", "T, benchmark path / m")
    return markdown((*head, "rides ended, benchmark", "random"), rows)


def _table_6(data: Tables) -> str:
    rows = []
    for name, (published_max, published_mean) in PAPER["published"]["table_6"].items():
        for by_maximum, by_mean in filter(None, [worst_of(data, name)]):
            controller, largest = f"{name} (seed {by_maximum.seed})", by_maximum.largest
            found = f"{largest:.2f} m at {by_maximum.speed:g} m/s", f"{by_mean.mean:.3f} m at {by_mean.speed:g} m/s"
            rows.append((controller, "largest maximum", published_max, found[0]))
            rows.append(("", "largest mean", published_mean, found[1]))
    return markdown(("controller 1 of", "", "published", "found"), rows)


def _table_8(data: Tables) -> str:
    rows = []
    for row in data.directions:
        found = (f"{value:.3f}" for value in (row.formula, row.whipple, row.pybullet))
        rows.append((f"{row.roll:g}", f"{row.steer:g}", f"{row.published:g}", *found))
    return markdown(("roll", "steer", "published", "Eq. (A.10)", "compiled, rolled", "PyBullet, rolled"), rows)


TABLES: Final = {
    "Settings, means with 95 % bootstrap intervals": _settings,
    "Table 6: controller 1 on the benchmark path": _table_6,
    "Table 8: direction of the front contact, degrees": _table_8,
}
"""All tables as Markdown, by their headings."""
