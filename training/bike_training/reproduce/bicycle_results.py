"""Tables of the bicycle paper's experiments, its statements, and its tables as Markdown (Weyrer et al. 2026)."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import fisher_exact

from bike_sim.course.files import load_course
from bike_training.reproduce.data import Run, RunRow, Tables, table
from bike_training.reproduce.statement import (
    MIN_RUNS,
    FloatArray,
    NothingFound,
    Verdict,
    interval,
    markdown,
    some,
    statements,
    with_interval,
)

# -------------------------------------------------------------------------------------------------------------- rows


@dataclass(frozen=True)
class Rides(RunRow):
    """A ride of a controller.

    Attributes:
        course: ``benchmark`` or ``random``.
        speed: m/s.
        completed: whether it came to its end.
        mean: mean distance of the rear contact, m.
        largest: its largest distance, m.
    """

    course: str
    speed: float
    completed: bool
    mean: float
    largest: float


@dataclass(frozen=True)
class Track:
    """An instant of a ride on the junction.

    Attributes:
        rider: controller or classical rider.
        time: s.
        x: rear contact, m.
        y: rear contact, m.
        front_x: front contact, m.
        front_y: front contact, m.
        rear_error: lateral error of the rear contact, m.
        front_error: lateral error of the front contact, m.
        completed: whether the ride came to its end.
    """

    rider: str
    time: float
    x: float
    y: float
    front_x: float
    front_y: float
    rear_error: float
    front_error: float
    completed: bool


@dataclass(frozen=True)
class Instant:
    """An instant of the ride of Figs. 12 and 13.

    Attributes:
        progress: along the path, m.
        x: rear contact, m.
        y: rear contact, m.
        front_x: front contact, m.
        front_y: front contact, m.
        roll: rad.
        steer: rad.
        curvature: of the path at the rear contact, 1/m.
    """

    progress: float
    x: float
    y: float
    front_x: float
    front_y: float
    roll: float
    steer: float
    curvature: float


@dataclass(frozen=True)
class Impact:
    """Share of a feature of an observation in the set point of the steering angle (Fig. 14).

    Attributes:
        policy: setting, or name of a shipped actor.
        observation: number.
        feature: name in the layout.
        value: of the feature, in its unit.
        shap: share in the set point, rad.
    """

    policy: str
    observation: int
    feature: str
    value: float
    shap: float


@dataclass(frozen=True)
class Direction:
    """A row of Table 8, in degrees.

    Attributes:
        roll: of the posture.
        steer: of the posture.
        published: direction of the front contact.
        formula: by Eq. (A.10).
        whipple: measured by rolling in the compiled engine.
        pybullet: measured by rolling in PyBullet.
    """

    roll: float
    steer: float
    published: float
    formula: float
    whipple: float
    pybullet: float


@dataclass(frozen=True)
class SteeringStep:
    """An instant of the step response of Fig. 16.

    Attributes:
        time: s.
        whipple: steering angle in the compiled engine, deg.
        pybullet: steering angle in PyBullet, deg.
    """

    time: float
    whipple: float
    pybullet: float


@dataclass(frozen=True)
class Chance:
    """Frequency of full circles in the paths of learning (Sect. 6).

    Attributes:
        paths: drawn from part 4.
        length: least length of each, m.
        circles: paths with five bends in a row to one side.
    """

    paths: int
    length: float
    circles: int


@dataclass(frozen=True)
class Data(Tables):
    """All tables; the error of a validation is the mean of its errors e_i (Eq. 12)."""

    rides: tuple[Rides, ...] = table("rides.csv", Rides)
    tracks: tuple[Track, ...] = table("junction.csv", Track)
    ride: tuple[Instant, ...] = table("ride.csv", Instant)
    impacts: tuple[Impact, ...] = table("impacts.csv", Impact)
    directions: tuple[Direction, ...] = table("table8.csv", Direction)
    steering: tuple[SteeringStep, ...] = table("steering_step.csv", SteeringStep)
    chances: tuple[Chance, ...] = table("full_circles.csv", Chance)


# ------------------------------------------------------------------------------------------------------- learning

_ALIKE: Final = 0.5
"""Share of prop.'s steps within which a difference must lie to count as none."""
RODE_ALL: Final = ("prop", "alt1", "alt2", "alt3", "alt4")
"""Settings all of whose controllers ride random paths in the paper."""
NO_CONTROLLER: Final = "no controller"


def runs_of(data: Data, *settings: str) -> list[Run]:
    """Return the runs of some settings."""
    return [run for run in data.runs if run.setting in settings]


def finished_at(data: Data, setting: str) -> FloatArray:
    """Return the learning steps after which the runs of a setting have ended the curriculum."""
    return np.array([run.finished_at for run in runs_of(data, setting) if run.finished_at >= 0], float)


def _ended(data: Data, *settings: str) -> bool:
    """Return whether there are runs of all settings, and all of them have ended."""
    each = [runs_of(data, name) for name in settings]
    return all(each) and all(run.status == "finished" for runs in each for run in runs)


def _all_end(data: Data, settings: Sequence[str]) -> Verdict:
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


def _of_cut_runs(data: Data, settings: Sequence[str], text: str) -> Verdict:
    """Return the verdict where runs have not ended: open if they had too few steps to say so.

    The paper's n_tot is twice what its *prop.* needs and more.
    """
    prop = finished_at(data, "prop")
    steps = [run.steps for run in runs_of(data, *settings) if run.finished_at < 0]
    if not len(prop) or min(steps) < 2.0 * prop.mean():
        return f"{text}; others were cut off after {min(steps):,} steps, less than twice prop.'s", None
    return text, False


def _needs_more(data: Data, setting: str) -> Verdict:
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


def _no_difference(data: Data, setting: str) -> Verdict:
    ours, prop = finished_at(data, setting), finished_at(data, "prop")
    totals = [len(runs_of(data, name)) for name in (setting, "prop")]
    if min(len(ours), len(prop)) < 2 or [len(ours), len(prop)] != totals:
        return f"{len(ours)} of {totals[0]} and {len(prop)} of {totals[1]} runs end", None
    low, high = interval(ours, prop, rule=operator.sub)
    text = f"difference of the means {low:+,.0f} to {high:+,.0f} steps (95 %)"
    if min(totals) < MIN_RUNS or (low <= 0.0 <= high and max(-low, high) > _ALIKE * prop.mean()):
        return text, None
    return text, low <= 0.0 <= high


def _part_two(data: Data) -> Verdict:
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


def _few_finish(data: Data) -> Verdict:
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


def mean_distance(data: Data, setting: str, course: str) -> dict[float, tuple[float, bool]]:
    """Return T(v) of Eq. (15) by speed, with whether all controllers came to the end; of those that did."""
    found: dict[float, tuple[float, bool]] = {}
    rides = [ride for ride in data.rides if (ride.setting, ride.course) == (setting, course)]
    for speed in sorted({ride.speed for ride in rides}):
        there = [ride for ride in rides if ride.speed == speed]
        means = [ride.mean for ride in there if ride.completed]
        found[speed] = (float(np.mean(means)) if means else float("nan"), len(means) == len(there))
    return found


def _known_distances(data: Data) -> dict[float, float]:
    """Return T(v) of *prop.* on the benchmark path at the speeds at which a controller came to the end."""
    found = mean_distance(data, "prop", "benchmark").items()
    return {speed: mean for speed, (mean, _) in found if np.isfinite(mean)}


def controller_1(data: Data, setting: str) -> int | None:
    """Return the seed of the controller with the smallest largest distance on the benchmark path (Sect. 5.3.3)."""
    worst: dict[int, tuple[bool, float]] = {}
    for ride in _benchmark(data, setting):
        fell, largest = worst.get(ride.seed, (False, 0.0))
        worst[ride.seed] = (fell or not ride.completed, max(largest, ride.largest))
    return min(worst, key=lambda seed: worst[seed]) if worst else None


def _benchmark(data: Data, setting: str) -> list[Rides]:
    return [ride for ride in data.rides if (ride.setting, ride.course) == (setting, "benchmark")]


def _all_ridden(data: Data, settings: Sequence[str], course: str) -> Verdict:
    rides = [ride for ride in data.rides if ride.setting in settings and ride.course == course]
    done = sum(ride.completed for ride in rides)
    missing = sorted(set(settings) - {ride.setting for ride in rides})
    text = f"{done} of {len(rides)} rides" + (f"; no controller of {', '.join(missing)}" if missing else "")
    return text, False if done < len(rides) else None if missing else True


def _below(data: Data, limit: float) -> Verdict:
    largest = max(some(_known_distances(data), NO_CONTROLLER).values())
    return f"largest T {largest:.3f} m", largest < limit


def worst_of(data: Data, setting: str) -> tuple[Rides, Rides] | None:
    """Return the benchmark rides of controller 1 with the largest maximum and with the largest mean (Table 6)."""
    seed = controller_1(data, setting)
    rides = [ride for ride in _benchmark(data, setting) if ride.seed == seed]
    if not rides:
        return None
    return max(rides, key=lambda ride: ride.largest), max(rides, key=lambda ride: ride.mean)


def _largest_distances(data: Data, setting: str, largest: float, mean: float) -> Verdict:
    by_maximum, by_mean = some(worst_of(data, setting) or (), NO_CONTROLLER)
    text = f"{by_maximum.largest:.2f} m at {by_maximum.speed:g} m/s, {by_mean.mean:.3f} m at {by_mean.speed:g} m/s"
    return text, by_maximum.largest <= largest and by_mean.mean <= mean


def _fails_slow(data: Data) -> Verdict:
    rides = [ride for ride in data.rides if ride.course == "benchmark" and ride.setting in RODE_ALL]
    failed = [ride for ride in some(rides, NO_CONTROLLER) if not ride.completed]
    places = sorted({(ride.setting, ride.speed) for ride in failed})
    text = ", ".join(f"{name} at {speed:g} m/s" for name, speed in places[:8])
    text = f"{len(failed)} of {len(rides)} rides" + (f": {text}" if failed else "")
    return text, all(ride.speed <= 2.25 for ride in failed)


def _least_in_the_middle(data: Data) -> Verdict:
    found = _known_distances(data)
    if len(found) < 3:
        raise NothingFound(NO_CONTROLLER)
    best = min(found, key=lambda speed: found[speed])
    low, high = min(found), max(found)
    text = f"{found[best]:.3f} m at {best:g} m/s; {found[low]:.3f} m at {low:g}, {found[high]:.3f} m at {high:g} m/s"
    return text, low < best < high


def _junction_error(data: Data, rider: str) -> float | None:
    """Return the largest error of a front contact on the junction, m; infinite where the ride ended early."""
    rows = [row for row in data.tracks if row.rider == rider]
    if not rows:
        return None
    return max(abs(row.front_error) for row in rows) if rows[0].completed else math.inf


def _error_text(error: float) -> str:
    return f"{error:.2f} m" if math.isfinite(error) else "not ridden to the end"


def _on_junction(data: Data) -> Verdict:
    error = _junction_error(data, "alt3")
    if error is None:
        raise NothingFound(NO_CONTROLLER)
    return _error_text(error), error < 2.0


def _beats_stanley(data: Data) -> Verdict:
    ours = _junction_error(data, "alt3")
    others = {name: _junction_error(data, name) for name in ("stanley", "lqr")}
    text = ", ".join(f"{name}: {_error_text(error)}" for name, error in others.items() if error is not None)
    stanley = others["stanley"]
    return text, None if ours is None or stanley is None else ours < stanley


# ----------------------------------------------------------------------------------------- one controller closely


def _leans_with_curvature(data: Data) -> Verdict:
    rows = [row for row in data.ride if row.progress <= 200.0]
    if len(rows) < 2 or not any(row.curvature for row in rows):
        raise NothingFound("no ride")
    found = float(np.corrcoef([row.roll for row in rows], [-row.curvature for row in rows])[0, 1])
    return f"correlation {found:.2f}", found > 0.9


def _counter_steers(data: Data) -> Verdict:
    begin = dict(load_course("benchmark").sections)["full circle"]
    before = [row for row in data.ride if begin - 4.0 <= row.progress <= begin]
    if not before or data.ride[-1].progress <= begin:
        raise NothingFound("no ride")
    steer, roll = min(row.steer for row in before), before[-1].roll
    text = f"steer down to {math.degrees(steer):.1f}°, roll {math.degrees(roll):.1f}° at the circle's start"
    return text, steer < 0.0 and roll < 0.0


def weights(impacts: Sequence[Impact], policy: str) -> dict[str, float]:
    """Return the mean magnitude of the SHAP values of each feature of a policy, rad, largest first."""
    found: dict[str, list[float]] = {}
    for row in impacts:
        if row.policy == policy:
            found.setdefault(row.feature, []).append(abs(row.shap))
    means = {feature: float(np.mean(values)) for feature, values in found.items()}
    return dict(sorted(means.items(), key=lambda item: -item[1]))


def _shares(data: Data) -> dict[str, float]:
    """Return the share of each feature in the magnitudes of all, of controller 1 of *prop.*, largest first."""
    means = some(weights(data.impacts, "prop"), NO_CONTROLLER)
    total = sum(means.values())
    return {name: mean / total for name, mean in means.items()}


def _weightiest(data: Data) -> Verdict:
    shares = _shares(data)
    names = list(shares)[:5]
    text = ", ".join(f"{name} {shares[name]:.0%}" for name in names)
    return text, set(names) == {"roll", "t_p3", "t_p2", "roll_rate", "t_p4"}


def _weightiest_is_roll(data: Data) -> Verdict:
    first = next(iter(_shares(data)))
    return first, first == "roll"


def _correlation(data: Data, *features: str) -> float:
    """Return the correlation of features of *prop.* with their SHAP values, each summed over the features."""
    rows = [row for row in data.impacts if row.policy == "prop" and row.feature in features]
    sums: dict[int, tuple[float, float]] = {}
    for row in some(rows, NO_CONTROLLER):
        value, shap = sums.get(row.observation, (0.0, 0.0))
        sums[row.observation] = (value + row.value, shap + row.shap)
    return float(np.corrcoef(np.array(list(sums.values())).T)[0, 1])


def _pulls_down(data: Data, *features: str) -> Verdict:
    found = {name: _correlation(data, name) for name in features}
    text = "correlation " + ", ".join(f"{name} {value:+.2f}" for name, value in found.items())
    return text, all(value < -0.5 for value in found.values())


def _pulls_together(data: Data) -> Verdict:
    found = _correlation(data, "t_p2", "t_p3", "t_p4")
    return f"correlation {found:+.2f}", found < -0.5


def _hardly_any_weight(data: Data, *features: str) -> Verdict:
    shares = _shares(data)
    text = ", ".join(f"{name} {shares[name]:.1%}" for name in features)
    return text, not set(features) & set(list(shares)[:5])


def _directions(data: Data) -> Verdict:
    rows = some(data.directions, "not measured")
    engines = ("formula", "whipple", "pybullet")
    errors = {name: max(abs(getattr(row, name) - row.published) for row in rows) for name in engines}
    text = "largest difference " + ", ".join(f"{name} {error:.3f}°" for name, error in errors.items())
    return text, max(errors.values()) < 0.1


def _overshoot(data: Data) -> Verdict:
    rows = some(data.steering, "not measured")
    peaks = {name: max(getattr(row, name) for row in rows) / 70.0 - 1.0 for name in ("whipple", "pybullet")}
    text = ", ".join(f"{name} {peak:.1%}" for name, peak in peaks.items())
    return text, all(0.0 < peak <= 0.1 for peak in peaks.values())


def _rare_circles(data: Data) -> Verdict:
    """Agree where Fisher's exact test of the two counts finds no difference at 5 %."""
    chance = some(data.chances, "not drawn")[0]
    counts = [[chance.circles, chance.paths - chance.circles], [20, 9_980]]
    text = f"{chance.circles} of {chance.paths:,} paths ({chance.circles / chance.paths:.2%})"
    return text, float(fisher_exact(counts).pvalue) > 0.05


_YAW_AND_WHEEL: Final = ("yaw_cos", "yaw_sin", "front_wheel_rate")

STATEMENTS: Final = statements(
    ("Fig. 8", "all runs of prop. and alt(1-4) end the curriculum", _all_end, RODE_ALL),
    ("Fig. 8", "alt(2) needs more steps than prop. (over 2.5 against under 2 million)", _needs_more, "alt2"),
    ("Fig. 8", "alt(5) needs more steps than prop. (over 2.5 against under 2 million)", _needs_more, "alt5"),
    ("Sect. 5.2", "the yaw's representation, alt(1), does not change the steps", _no_difference, "alt1"),
    ("Sect. 5.2", "the front contact, alt(3), makes no difference in learning", _no_difference, "alt3"),
    ("Sect. 5.2", "the exponential reward, alt(4), makes no difference in learning", _no_difference, "alt4"),
    ("Sect. 5.2", "alt(2) takes 264 % of prop.'s steps in part 2", _part_two),
    ("Sect. 5.2", "two of five runs of alt(5) end the curriculum", _few_finish),
    (
        "Sect. 5.3.2",
        "all controllers of prop. and alt(1-4) ride random paths at all speeds",
        _all_ridden,
        RODE_ALL,
        "random",
    ),
    ("Sect. 5.3.3", "all controllers of prop. ride the benchmark path", _all_ridden, ("prop",), "benchmark"),
    ("Sect. 5.3.3", "all controllers of alt(3) ride the benchmark path", _all_ridden, ("alt3",), "benchmark"),
    ("Sect. 5.3.3", "T(v) of prop. on the benchmark path is below 0.2 m", _below, 0.2),
    (
        "Table 6",
        "prop.: at most 0.69 m, in the mean at most 0.09 m, both at 7 m/s",
        _largest_distances,
        "prop",
        0.69,
        0.09,
    ),
    (
        "Table 6",
        "alt(3): at most 0.58 m at 7 m/s, in the mean at most 0.13 m at 2.25 m/s",
        _largest_distances,
        "alt3",
        0.58,
        0.13,
    ),
    ("Sect. 5.3.3", "on the benchmark path controllers of prop. and alt(1-4) fail at 2.25 m/s at most", _fails_slow),
    (
        "Sect. 5.3.3",
        "T(v) of prop. is least at 4.25 m/s (0.08 m), and larger at 2 (0.19 m) and 7 m/s (0.15 m)",
        _least_in_the_middle,
    ),
    ("Fig. 11", "the controller of alt(3) stays within 2 m of the junction's path", _on_junction),
    ("Fig. 11", "it deviates less than the Stanley controller", _beats_stanley),
    ("Fig. 12", "the roll is proportional to the negated curvature", _leans_with_curvature),
    ("Fig. 12", "before the circle to the left it steers right and leans left", _counter_steers),
    ("Fig. 14", "the roll has the greatest impact", _weightiest_is_roll),
    ("Fig. 14", "roll, t_P3, t_P2, roll rate and t_P4 weigh most", _weightiest),
    ("Sect. 5.5", "steers into the fall: roll pulls to the other sign", _pulls_down, "roll"),
    ("Sect. 5.5", "t_P3 and t_P2 pull to the other sign", _pulls_down, "t_p3", "t_p2"),
    ("Sect. 6", "counter-steers: t_P2 to t_P4 together pull to the other sign", _pulls_together),
    ("Sects. 5.5 and 6", "yaw and front wheel rate are among the others", _hardly_any_weight, *_YAW_AND_WHEEL),
    ("Sect. 6", "20 of 10,000 paths of learning have a full circle (0.2 %)", _rare_circles),
    ("Table 8", "direction of the front contact in nine postures", _directions),
    ("Appendix B", "P = 9 Nm, D = 1.6 Nms overshoot by at most 10 %", _overshoot),
)
"""Statements that the experiments can answer."""


# --------------------------------------------------------------------------------------------------------- tables

_PUBLISHED_6: Final = {
    "prop": ("0.69 m at 7 m/s", "0.09 m at 7 m/s"),
    "alt3": ("0.58 m at 7 m/s", "0.13 m at 2.25 m/s"),
}


def _settings(data: Data) -> str:
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


def _table_6(data: Data) -> str:
    rows = []
    for name, (published_max, published_mean) in _PUBLISHED_6.items():
        for by_maximum, by_mean in filter(None, [worst_of(data, name)]):
            controller, largest = f"{name} (seed {by_maximum.seed})", by_maximum.largest
            found = f"{largest:.2f} m at {by_maximum.speed:g} m/s", f"{by_mean.mean:.3f} m at {by_mean.speed:g} m/s"
            rows.append((controller, "largest maximum", published_max, found[0]))
            rows.append(("", "largest mean", published_mean, found[1]))
    return markdown(("controller 1 of", "", "published", "found"), rows)


def _table_8(data: Data) -> str:
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
