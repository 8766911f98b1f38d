"""Tables of the bicycle paper's experiments, its statements, and its tables as Markdown (Weyrer et al. 2026)."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import fisher_exact

from bike_analysis.figures.cells import markdown
from bike_sim.course.files import load_course
from bike_training.reproduce.data import Tables, last_steps, read_paper, select
from bike_training.reproduce.statement import (
    MIN_RUNS,
    FloatArray,
    NothingFound,
    Verdict,
    compare,
    interval,
    some,
    statements_of,
    with_interval,
)

PAPER: Final = read_paper("bicycle")
"""Its tables and statements; the error of a validation is the mean of its errors e_i (Eq. 12)."""

# ------------------------------------------------------------------------------------------------------- learning

_ALIKE: Final = 0.5
"""Share of prop.'s steps within which a difference must lie to count as none."""
RODE_ALL: Final = ("prop", "alt1", "alt2", "alt3", "alt4")
"""Settings all of whose controllers ride random paths in the paper."""
NO_CONTROLLER: Final = "no controller"


def runs_of(data: Tables, *settings: str) -> pd.DataFrame:
    """Return the runs of some settings."""
    return select(data["runs"], setting=settings)


def finished_at(data: Tables, setting: str) -> FloatArray:
    """Return the learning steps after which the runs of a setting have ended the curriculum."""
    found = runs_of(data, setting)["finished_at"].to_numpy(float)
    return found[found >= 0.0]


def _ended(data: Tables, *settings: str) -> bool:
    """Return whether there are runs of all settings, and all of them have ended."""
    runs = runs_of(data, *settings)
    return set(runs["setting"]) == set(settings) and bool((runs["status"] == "finished").all())


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
    prop, runs = finished_at(data, "prop"), runs_of(data, *settings)
    least = runs[runs["finished_at"] < 0]["steps"].min()
    if not len(prop) or least < 2.0 * prop.mean():
        return f"{text}; others were cut off after {least:,} steps, less than twice prop.'s", None
    return text, False


def _needs_more(data: Tables, setting: str) -> Verdict:
    """A run that has not ended counts as one that ended with its last step, so the ratio is a lower bound.

    It is open where a run of *prop.* has not ended: those that have would be the quick ones.
    """
    ours = last_steps(runs_of(data, setting))
    prop, of_prop = finished_at(data, "prop"), len(runs_of(data, "prop"))
    done, total = len(finished_at(data, setting)), len(ours)
    text = f"{done} of {total} runs end"
    if not (_ended(data, setting, "prop") and len(prop)):
        return text, None
    if len(prop) < of_prop:
        return f"{text}, of prop. {len(prop)} of {of_prop}", None
    low, high, less = compare((ours, prop), operator.truediv, 1.0)
    mean = ours.mean() / prop.mean()
    text += f"; {'at least ' if done < total else ''}{mean:.2f} times prop.'s steps ({low:.2f} to {high:.2f})"
    return text, None if less is None else not less


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
    found = {}
    for setting in ("prop", "alt2"):
        spans = []
        for _, rows in select(data["validations"], setting=setting).groupby("seed"):
            ends = rows.groupby("part")["step"].max()
            if {1, 2} <= set(ends.index) and ends.index.max() > 2:
                spans.append(ends[2] - ends[1])
        found[setting] = some(spans, "no run of both has passed part 2")
    ratio, runs = np.mean(found["alt2"]) / np.mean(found["prop"]), [len(spans) for spans in found.values()]
    text = f"{ratio:.0%} ({runs[0]} and {runs[1]} runs have passed it)"
    return text, ratio > 1.5 if min(runs) >= MIN_RUNS else None


def _few_finish(data: Tables) -> Verdict:
    runs, done = len(runs_of(data, "alt5")), len(finished_at(data, "alt5"))
    text = f"{done} of {runs}"
    if runs and done == runs:
        return text, False
    if not _ended(data, "alt5"):
        return text, None
    text, verdict = _of_cut_runs(data, ["alt5"], text)
    return text, True if done and verdict is False else None


# ---------------------------------------------------------------------------------------------------------- rides


def mean_distance(data: Tables, setting: str, course: str) -> pd.DataFrame:
    """Return T(v) of Eq. (15) by speed: its ``mean`` over the controllers that came to the end, and whether ``all``."""
    rides = select(data["rides"], setting=setting, course=course)
    means = rides["mean"].where(rides["completed"]).groupby(rides["speed"]).mean()
    return pd.DataFrame({"mean": means, "all": rides.groupby("speed")["completed"].all()})


def _known_distances(data: Tables) -> pd.Series:
    """Return T(v) of *prop.* on the benchmark path at the speeds at which a controller came to the end."""
    return mean_distance(data, "prop", "benchmark")["mean"].dropna()


def controller_1(data: Tables, setting: str) -> int | None:
    """Return the seed of the controller with the smallest largest distance on the benchmark path (Sect. 5.3.3)."""
    rides = select(data["rides"], setting=setting, course="benchmark")
    worst = rides.assign(fell=~rides["completed"]).groupby("seed")[["fell", "largest"]].max()
    return None if worst.empty else int(worst.sort_values(["fell", "largest"]).index[0])


def _all_ridden(data: Tables, settings: Sequence[str], course: str) -> Verdict:
    rides = select(data["rides"], setting=settings, course=course)
    done, missing = int(rides["completed"].sum()), sorted(set(settings) - set(rides["setting"]))
    text = f"{done} of {len(rides)} rides" + (f"; no controller of {', '.join(missing)}" if missing else "")
    return text, False if done < len(rides) else None if missing else True


def _below(data: Tables, limit: float) -> Verdict:
    largest = some(_known_distances(data), NO_CONTROLLER).max()
    return f"largest T {largest:.3f} m", largest < limit


def worst_of(data: Tables, setting: str) -> tuple[Any, Any] | None:
    """Return the benchmark rides of controller 1 with the largest maximum and with the largest mean (Table 6)."""
    rides = select(data["rides"], setting=setting, seed=controller_1(data, setting), course="benchmark")
    return None if rides.empty else (rides.iloc[rides["largest"].argmax()], rides.iloc[rides["mean"].argmax()])


def _largest_distances(data: Tables, setting: str, largest: float, mean: float) -> Verdict:
    by_maximum, by_mean = some(worst_of(data, setting) or (), NO_CONTROLLER)
    text = f"{by_maximum['largest']:.2f} m at {by_maximum['speed']:g} m/s"
    text += f", {by_mean['mean']:.3f} m at {by_mean['speed']:g} m/s"
    return text, by_maximum["largest"] <= largest and by_mean["mean"] <= mean


def _fails_slow(data: Tables) -> Verdict:
    rides = some(select(data["rides"], setting=RODE_ALL, course="benchmark"), NO_CONTROLLER)
    failed = rides[~rides["completed"]]
    places = failed[["setting", "speed"]].drop_duplicates().sort_values(["setting", "speed"]).head(8)
    text = ", ".join(f"{name} at {speed:g} m/s" for name, speed in places.itertuples(index=False))
    text = f"{len(failed)} of {len(rides)} rides" + (f": {text}" if text else "")
    return text, bool((failed["speed"] <= 2.25).all())


def _least_in_the_middle(data: Tables) -> Verdict:
    found = _known_distances(data)
    if len(found) < 3:
        raise NothingFound(NO_CONTROLLER)
    best, low, high = float(str(found.idxmin())), found.index.min(), found.index.max()
    text = f"{found[best]:.3f} m at {best:g} m/s; {found[low]:.3f} m at {low:g}, {found[high]:.3f} m at {high:g} m/s"
    return text, low < best < high


def _junction_errors(data: Tables) -> dict[Any, float]:
    """Return the largest error of a front contact on the junction by rider, m; infinite where the ride ended early."""
    rides = data["tracks"].groupby("rider", sort=False)
    return {
        rider: float(rows["front_error"].abs().max()) if rows["completed"].all() else math.inf for rider, rows in rides
    }


def _on_junction(data: Tables) -> Verdict:
    found = _junction_errors(data)
    if "alt3" not in found:
        raise NothingFound(NO_CONTROLLER)
    return f"{found['alt3']:.2f} m", found["alt3"] < 2.0


def _beats_stanley(data: Tables) -> Verdict:
    found = _junction_errors(data)
    others = [name for name in ("stanley", "lqr") if name in found]
    text = ", ".join(
        f"{name}: {found[name]:.2f} m" if math.isfinite(found[name]) else f"{name}: not ridden to the end"
        for name in others
    )
    return text, found["alt3"] < found["stanley"] if {"alt3", "stanley"} <= found.keys() else None


# ----------------------------------------------------------------------------------------- one controller closely


def _leans_with_curvature(data: Tables) -> Verdict:
    rows = data["ride"][data["ride"]["progress"] <= 200.0]
    if len(rows) < 2 or not rows["curvature"].any():
        raise NothingFound("no ride")
    found = float(np.corrcoef(rows["roll"], -rows["curvature"])[0, 1])
    return f"correlation {found:.2f}", found > 0.9


def _counter_steers(data: Tables) -> Verdict:
    begin, ride = dict(load_course("benchmark").sections)["full circle"], data["ride"]
    before = ride[ride["progress"].between(begin - 4.0, begin)]
    if before.empty or ride["progress"].iloc[-1] <= begin:
        raise NothingFound("no ride")
    steer, roll = before["steer"].min(), before["roll"].iloc[-1]
    text = f"steer down to {math.degrees(steer):.1f}°, roll {math.degrees(roll):.1f}° at the circle's start"
    return text, steer < 0.0 and roll < 0.0


NO_SEED: Final = -1
"""In place of the seed of a run, of actors that are shipped."""


def weights(impacts: pd.DataFrame, setting: str) -> pd.DataFrame:
    """Return the mean magnitude of the SHAP values of each feature (columns) of each controller (rows), rad.

    The feature that is largest in the mean comes first.
    """
    rows = select(impacts, setting=setting)
    means = rows.assign(shap=rows["shap"].abs()).pivot_table(index="seed", columns="feature", values="shap", sort=False)
    return means[means.mean().sort_values(ascending=False, kind="stable").index]


def _shares(data: Tables) -> pd.DataFrame:
    """Return the share of each feature in the magnitudes of all, of each controller of *prop.*, largest first."""
    means = some(weights(data["impacts"], "prop"), NO_CONTROLLER)
    return means.div(means.sum(axis=1), axis=0)


def _with_shares(shares: pd.DataFrame) -> str:
    form = "{:.0%}" if shares.mean().max() > 0.05 else "{:.1%}"
    return ", ".join(f"{name} {with_interval(shares[name].to_numpy(), form.format)}" for name in shares)


def _weightiest(data: Tables, *features: str) -> Verdict:
    """Agree where the least of these features weighs more than the largest of all others, in the mean of controllers.

    A difference decides where its interval over the controllers leaves out 0.
    """
    shares = _shares(data)
    least = next(name for name in reversed(shares.columns) if name in features)
    other = next(name for name in shares if name not in features)
    difference = (shares[least] - shares[other]).to_numpy()
    low, high = interval(difference)
    decided = len(difference) >= MIN_RUNS and not low <= 0.0 <= high
    return _with_shares(shares[shares.columns[: len(features)]]), low > 0.0 if decided else None


def _pulls_down(data: Tables, *groups: Sequence[str]) -> Verdict:
    """Agree where the features of each group, summed, correlate negatively with their SHAP values, summed.

    The interval over the controllers decides.
    """
    found = {}
    for features in groups:
        rows = some(select(data["impacts"], setting="prop", feature=features), NO_CONTROLLER)
        sums = rows.groupby(["seed", "observation"])[["value", "shap"]].sum().groupby("seed")
        found[" + ".join(features)] = np.array([np.corrcoef(each["value"], each["shap"])[0, 1] for _, each in sums])
    text = "correlation " + ", ".join(f"{name} {with_interval(values, '+.2f')}" for name, values in found.items())
    if min(map(len, found.values())) < MIN_RUNS:
        return text, None
    ends = [interval(values) for values in found.values()]
    return text, True if all(high < 0.0 for _, high in ends) else False if any(low > 0.0 for low, _ in ends) else None


def _hardly_any_weight(data: Tables, *features: str) -> Verdict:
    shares = _shares(data)
    mine, least = shares[list(features)], shares[shares.columns[4]]
    larger = [interval((shares[name] - least).to_numpy()) for name in features]
    if len(shares) < MIN_RUNS:
        return _with_shares(mine), None
    low = any(low > 0.0 for low, _ in larger)
    return _with_shares(mine), False if low else True if all(high < 0.0 for _, high in larger) else None


def _directions(data: Tables) -> Verdict:
    rows = some(data["directions"], "not measured")
    errors = {name: (rows[name] - rows["published"]).abs().max() for name in ("formula", "whipple", "pybullet")}
    text = "largest difference " + ", ".join(f"{name} {error:.3f}°" for name, error in errors.items())
    return text, max(errors.values()) < 0.1


def _overshoot(data: Tables) -> Verdict:
    peaks = some(data["steering"], "not measured")[["whipple", "pybullet"]].max() / 70.0 - 1.0
    text = ", ".join(f"{name} {peak:.1%}" for name, peak in peaks.items())
    return text, bool(peaks.between(0.0, 0.1, inclusive="right").all())


def _rare_circles(data: Tables) -> Verdict:
    """Agree where Fisher's exact test of the two counts finds no difference at 5 %."""
    paths, circles = (int(some(data["chances"], "not drawn")[name].iloc[0]) for name in ("paths", "circles"))
    text = f"{circles} of {paths:,} paths ({circles / paths:.2%})"
    return text, float(fisher_exact([[circles, paths - circles], [20, 9_980]]).pvalue) > 0.05


STATEMENTS: Final = statements_of(PAPER, globals())
"""Statements that the experiments can answer."""


# --------------------------------------------------------------------------------------------------------- tables


def _settings(data: Tables) -> str:
    rows = []
    for name in data["runs"]["setting"].unique():
        done, rides = finished_at(data, name), select(data["rides"], setting=name)
        # Mean distance of each controller, over the rides that came to the end.
        means = select(rides, course="benchmark", completed=True).groupby("seed")["mean"].mean().to_numpy()
        ended = (select(rides, course=course)["completed"] for course in ("benchmark", "random"))
        cells = (f"{each.sum()} of {len(each)}" for each in ended)
        runs = f"{len(done)} of {len(runs_of(data, name))}"
        rows.append((name, runs, with_interval(done, ",.0f"), with_interval(means, ".3f"), *cells))
    head = ("setting", "curricula ended", "steps to the end", "T, benchmark path / m")
    return markdown([(*head, "rides ended, benchmark", "random"), *rows])


def _table_6(data: Tables) -> str:
    rows = []
    for name, (published_max, published_mean) in PAPER["published"]["table_6"].items():
        for by_maximum, by_mean in filter(None, [worst_of(data, name)]):
            found = f"{by_maximum['largest']:.2f} m at {by_maximum['speed']:g} m/s"
            rows.append((f"{name} (seed {by_maximum['seed']})", "largest maximum", published_max, found))
            found = f"{by_mean['mean']:.3f} m at {by_mean['speed']:g} m/s"
            rows.append(("", "largest mean", published_mean, found))
    return markdown([("controller 1 of", "", "published", "found"), *rows])


def _table_8(data: Tables) -> str:
    rows = [
        (*(f"{value:g}" for value in row[:3]), *(f"{value:.3f}" for value in row[3:]))
        for row in data["directions"].itertuples(index=False)
    ]
    return markdown([("roll", "steer", "published", "Eq. (A.10)", "compiled, rolled", "PyBullet, rolled"), *rows])


TABLES: Final = {
    "Settings, means with 95 % bootstrap intervals": _settings,
    "Table 6: controller 1 on the benchmark path": _table_6,
    "Table 8: direction of the front contact, degrees": _table_8,
}
"""All tables as Markdown, by their headings."""
