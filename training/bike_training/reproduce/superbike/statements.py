"""What the superbike paper says of its experiments, and what the tables say of it."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Final

import numpy as np

from bike_analysis.figures.numbers import lap_text
from bike_sim.course.files import load_track
from bike_training.reproduce.statement import LEAST_RUNS, NO, OPEN, YES, FloatArray, Found, Statement, interval
from bike_training.reproduce.superbike.data import Context, Data, Laps, Transfer
from bike_training.reproduce.superbike.experiment import CIRCUITS, MACHINE, MACHINES, setting_of
from bike_training.reproduce.superbike.rides import best_run

OVERSHOOT: Final = 1.0
"""Distance to the outside of the ideal line that counts as running wide, m; ours."""
CONVERGED: Final = 1.0
"""Divergence below which a distribution has come to the target, nat; ours."""


def rows_of(data: Data, setting: str, actor: str) -> list[Laps]:
    """Return the rides of an actor of all runs of a setting."""
    return [row for row in data.laps if (row.setting, row.actor) == (setting, actor)]


def of_whole(rows: list[Laps], name: str) -> FloatArray:
    """Return a figure of each run that has laps of whole rides."""
    return np.array([getattr(row, name) for row in rows if row.whole], float)


def _told(rows: list[Laps]) -> str:
    """Return in words how the rides of some actors ended."""
    rides, whole = sum(row.rides for row in rows), sum(row.whole for row in rows)
    ends = ", ".join(f"{sum(getattr(row, name) for row in rows)} {name}" for name in ("falls", "walls"))
    return f"{whole} of {rides} rides whole, {ends} ({len(rows)} run{'s' if len(rows) != 1 else ''})"


def _all_whole(kind: str, actor: str, circuits: tuple[str, ...] = CIRCUITS[:1]) -> Callable[[Data], Found]:
    """Agree where every ride of every run is whole; one that is not denies it."""

    def find(data: Data) -> Found:
        each = {circuit: rows_of(data, setting_of(kind, circuit), actor) for circuit in circuits}
        if not any(each.values()):
            return Found("no run", OPEN)
        if len(each) == 1:
            text = _told(next(iter(each.values())))
        else:
            text = "; ".join(f"{circuit}: {_told(rows)}" for circuit, rows in each.items())
        if any(row.whole < row.rides for rows in each.values() for row in rows):
            return Found(text, NO)
        return Found(text, YES if all(len(rows) >= LEAST_RUNS for rows in each.values()) else OPEN)

    return find


def _no_lap(data: Data) -> Found:
    rows = rows_of(data, "sac", "early")
    if not rows:
        return Found("no run", OPEN)
    laps = sum(row.laps for row in rows)
    text = f"{laps} flying laps finished; {_told(rows)}"
    if laps:
        return Found(text, NO)
    return Found(text, YES if len(rows) >= LEAST_RUNS else OPEN)


def _less(name: str, actor: str, unit: str, first: str = "spdl") -> Callable[[Data], Found]:
    """Agree where the 95 % interval of the difference of the means over runs says that one is less than the other.

    Args:
        name: figure of `Laps`; a lap time is that of the runs that have whole rides.
        actor: which actors are compared.
        unit: of the figure.
        first: the one that has less in the paper.
    """
    second = "sac" if first == "spdl" else "spdl"

    def find(data: Data) -> Found:
        found = {}
        for kind in (first, second):
            rows = rows_of(data, kind, actor)
            found[kind] = of_whole(rows, name) if name == "mean" else np.array([getattr(row, name) for row in rows])
        if not all(len(values) for values in found.values()):
            missing = [kind for kind, values in found.items() if not len(values)]
            return Found(f"no run of {' and '.join(missing)} to compare", OPEN)
        form = lap_text if name == "mean" else lambda value: f"{value:.2f}"
        text = ", ".join(f"{kind} {form(float(values.mean()))}" for kind, values in found.items())
        low, high = interval(found[first], found[second], rule=operator.sub)
        if min(map(len, found.values())) < LEAST_RUNS:
            return Found(f"{text} {unit} ({', '.join(str(len(v)) for v in found.values())} runs)", OPEN)
        text += f" {unit}; difference {low:+.2f} to {high:+.2f}"
        return Found(text, OPEN if low <= 0.0 <= high else YES if high < 0.0 else NO)

    return find


def first_whole(data: Data, setting: str) -> FloatArray:
    """Return the step of the first whole validation of each run; all that it made, where there was none."""
    runs = [run for run in data.runs if run.setting == setting and run.steps]
    return np.array([run.finished_at if run.finished_at >= 0 else run.steps for run in runs], float)


def _sooner(data: Data) -> Found:
    """A run without a whole validation counts as one that had its first with its last step."""
    ours, others = first_whole(data, "spdl"), first_whole(data, "sac")
    if not (len(ours) and len(others)):
        return Found("no run", OPEN)
    runs = {kind: [run for run in data.runs if run.setting == kind and run.steps] for kind in ("spdl", "sac")}
    done = {kind: sum(run.finished_at >= 0 for run in each) for kind, each in runs.items()}
    text = ", ".join(
        f"{kind} {values.mean():,.0f} decisions ({done[kind]} of {len(values)} runs had one)"
        for kind, values in (("spdl", ours), ("sac", others))
    )
    low, high = interval(ours, others, rule=operator.truediv)
    if min(len(ours), len(others)) < LEAST_RUNS:
        return Found(f"first whole validation: {text}", OPEN)
    text += f"; ratio {low:.2f} to {high:.2f}"
    return Found(f"first whole validation: {text}", OPEN if low <= 1.0 <= high else YES if high < 1.0 else NO)


def _no_walls(data: Data) -> Found:
    rows = [row for row in data.laps if row.actor != "best"]
    walls, rides = sum(row.walls for row in rows), sum(row.rides for row in rows)
    if not rows:
        return Found("no run", OPEN)
    return Found(f"{walls} of {rides} rides ended at a wall", NO if walls else YES)


def _sac_elsewhere(data: Data) -> Found:
    """Table II: SAC alone has a lap on Cremona, and none on Phillip Island."""
    each = {circuit: rows_of(data, setting_of("sac", circuit), "early") for circuit in CIRCUITS[1:]}
    if not all(each.values()):
        return Found("no run of both", OPEN)
    laps = {circuit: sum(row.laps for row in rows) for circuit, rows in each.items()}
    text = ", ".join(f"{circuit}: {count} flying laps of {len(each[circuit])} runs" for circuit, count in laps.items())
    if laps[CIRCUITS[2]]:
        return Found(text, NO)
    return Found(text, YES if laps[CIRCUITS[1]] and min(map(len, each.values())) >= LEAST_RUNS else OPEN)


def transfers_of(data: Data, circuit: str) -> dict[str, Transfer]:
    """Return Table III on a circuit by machine: the rides of the best SPDL run there."""
    setting = setting_of("spdl", circuit)
    seed = best_run(data, setting)
    return {row.machine: row for row in data.transfers if (row.setting, row.seed) == (setting, seed)}


def _transfer(data: Data) -> Found:
    each = {circuit: transfers_of(data, circuit) for circuit in CIRCUITS}
    missing = [circuit for circuit, rows in each.items() if not rows]
    pairs = [row for rows in each.values() for row in rows.values()]
    lapped = sum(row.whole > 0 for row in pairs)
    text = (
        f"{lapped} of {len(pairs)} lapped, {sum(r.whole for r in pairs)} of {sum(r.rides for r in pairs)} rides whole"
    )
    if missing:
        return Found(f"{text}; no actor that laps {' and '.join(missing)}", OPEN)
    return Found(text, YES if lapped >= len(CIRCUITS) * len(MACHINES) - 1 else NO)


def _quickest_trained(data: Data) -> Found:
    rows = transfers_of(data, CIRCUITS[0])
    if MACHINE not in rows or not rows[MACHINE].whole:
        return Found("no actor that laps", OPEN)
    own = rows[MACHINE].best
    others = {name: row.best - own for name, row in rows.items() if name != MACHINE and row.whole}
    text = ", ".join(f"{name} {more:+.2f} s" for name, more in others.items()) or "no other machine laps"
    if len(others) < len(MACHINES) - 1:
        return Found(text, NO if any(more < 0.0 for more in others.values()) else OPEN)
    return Found(text, YES if min(others.values()) > 0.0 else NO)


def overshoots(data: Data, setting: str) -> dict[str, float]:
    """Return how far a lap runs to the outside of the ideal line in each corner, m; less than 0 where it cuts it."""
    track = load_track(CIRCUITS[0])
    rows = [row for row in data.moments if row.setting == setting]
    found = {}
    for corner in track.corners:
        sign = 1.0 if corner.angle > 0.0 else -1.0
        size = corner.end - corner.begin
        inside = [-sign * row.error for row in rows if (row.progress - corner.begin) % track.length <= size]
        if inside:
            found[corner.name] = max(inside)
    return found


def _runs_wide(data: Data) -> Found:
    found = overshoots(data, "spdl")
    if not found:
        return Found("no lap", OPEN)
    wide = {name: more for name, more in found.items() if more > OVERSHOOT}
    widest = max(found, key=lambda name: found[name])
    text = f"{len(wide)} of {len(found)} corners by more than {OVERSHOOT:g} m, most in corner {widest}: "
    return Found(text + f"{found[widest]:.2f} m", YES if wide else NO)


def path_of(data: Data, setting: str) -> dict[int, list[Context]]:
    """Return the distributions of each run of a setting, in the order of updates."""
    found: dict[int, list[Context]] = {}
    for row in sorted(data.contexts, key=lambda row: row.iteration):
        if row.setting == setting:
            found.setdefault(row.seed, []).append(row)
    return found


def _moves(data: Data) -> Found:
    """Agree where the distribution of every run has moved towards the target; tells how many have come to it."""
    paths = path_of(data, "spdl")
    if not paths:
        return Found("no run", OPEN)
    ends = [path[-1] for path in paths.values()]
    there = sum(end.kl < CONVERGED for end in ends)
    nearer = sum(path[-1].kl < path[0].kl for path in paths.values())
    low, high = min(end.kl for end in ends), max(end.kl for end in ends)
    speed = np.mean([end.v_max for end in ends])
    text = (
        f"nearer in {nearer} of {len(ends)} runs, there in {there}: divergence at the end {low:.3g} to {high:.3g} nat"
    )
    text += f", mean speed limit {speed:.0f} m/s"
    return Found(text, YES if nearer == len(ends) else NO)


STATEMENTS: Final = (
    Statement("Table I, early", "SPDL finishes all laps without a fall", _all_whole("spdl", "early")),
    Statement("Table I, early", "SAC finishes no lap", _no_lap),
    Statement("Table I, early", "SPDL is nearer to the ideal line: 2.99 against 4.59 m", _less("line", "early", "m")),
    Statement(
        "Table I, early", "SPDL is off the track for less time: 1.74 against 9.22 s", _less("outside", "early", "s")
    ),
    Statement("Table I, late", "SPDL finishes all laps without a fall", _all_whole("spdl", "late")),
    Statement("Table I, late", "SAC finishes all laps without a fall", _all_whole("sac", "late")),
    Statement("Table I, late", "SPDL laps faster, 1:30.75 against 1:31.32", _less("mean", "late", "s")),
    Statement(
        "Table I, late", "SAC is nearer to the ideal line: 2.89 against 3.15 m", _less("line", "late", "m", "sac")
    ),
    Statement(
        "Table I, late", "SPDL is off the track for less time: 1.17 against 2.15 s", _less("outside", "late", "s")
    ),
    Statement("Table I", "no collision", _no_walls),
    Statement("Sect. VI-B", "SPDL converges faster than SAC", _sooner),
    Statement("Table II", "SPDL finishes all laps on three circuits, early", _all_whole("spdl", "early", CIRCUITS)),
    Statement("Table II", "SAC laps Cremona early, and not Phillip Island", _sac_elsewhere),
    Statement("Table III", "the Panigale's actor laps 14 of 15 pairs of machine and circuit", _transfer),
    Statement("Table III", "in Barcelona the other machines are slower, by 0.87 to 2.89 s", _quickest_trained),
    Statement("Fig. 4", "the agent overshoots corners", _runs_wide),
    Statement("Sect. V", "SPDL moves the distribution towards the ideal line at full speed", _moves),
)
"""Statements that the experiments can answer."""
