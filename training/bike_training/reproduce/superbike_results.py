"""Tables of the superbike paper's experiments, its statements, and its tables as Markdown."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from bike_analysis.figures.numbers import lap_text
from bike_sim.course.files import load_track
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

MACHINE: Final = "panigale_v4r"
MACHINES: Final = (MACHINE, "zx10rr", "cbr1000rr_r", "r1", "m1000rr")
"""Of Table III; the first one learns."""
CIRCUITS: Final = ("barcelona", "cremona", "phillip_island")
KINDS: Final = ("spdl", "sac")
"""Curricula that are compared; the first part of a setting's name."""
ACTORS: Final = ("early", "late", "best")


def kind_of(setting: str) -> str:
    """Return the kind of curriculum of a setting."""
    return setting.partition("_")[0]


def circuit_of(setting: str) -> str:
    """Return the circuit of a setting."""
    return setting.partition("_")[2] or CIRCUITS[0]


def setting_of(kind: str, circuit: str) -> str:
    """Return the setting of a kind of curriculum on a circuit."""
    return kind if circuit == CIRCUITS[0] else f"{kind}_{circuit}"


PAPER: Final = read_paper("superbike")
Data: Final = tables_of(PAPER)
"""All tables; the error of a validation is its rides' mean excess over the planned lap, 1 of one not whole."""
Laps, Transfer, Context, Episodes, Moment = row_kinds(Data)


# -------------------------------------------------------------------------------------------------------- verdicts

OVERSHOOT: Final = 1.0
"""Distance to the outside of the ideal line that counts as running wide, m; ours."""
CONVERGED: Final = 1.0
"""Divergence below which a distribution has come to the target, nat; ours."""
NO_RUN: Final = "no run"


def rows_of(data: Tables, setting: str, actor: str) -> list[Any]:
    """Return the rides of an actor of all runs of a setting."""
    return [row for row in data.laps if (row.setting, row.actor) == (setting, actor)]


def of_whole(rows: list[Any], name: str) -> FloatArray:
    """Return a figure of each run that has laps of whole rides."""
    return np.array([getattr(row, name) for row in rows if row.whole], float)


def _endings(rows: list[Any]) -> str:
    """Return the endings of the rides of some actors as text."""
    rides, whole = sum(row.rides for row in rows), sum(row.whole for row in rows)
    ends = ", ".join(f"{sum(getattr(row, name) for row in rows)} {name}" for name in ("falls", "walls"))
    return f"{whole} of {rides} rides whole, {ends} ({len(rows)} run{'s' if len(rows) != 1 else ''})"


def _all_whole(data: Tables, kind: str, actor: str, circuits: tuple[str, ...] = CIRCUITS[:1]) -> Verdict:
    """Agree where every ride of every run is whole; one that is not denies it."""
    each = {circuit: rows_of(data, setting_of(kind, circuit), actor) for circuit in circuits}
    some([row for rows in each.values() for row in rows], NO_RUN)
    texts = [_endings(rows) if len(each) == 1 else f"{circuit}: {_endings(rows)}" for circuit, rows in each.items()]
    if any(row.whole < row.rides for rows in each.values() for row in rows):
        return "; ".join(texts), False
    return "; ".join(texts), True if all(len(rows) >= MIN_RUNS for rows in each.values()) else None


def _no_lap(data: Tables) -> Verdict:
    rows = some(rows_of(data, "sac", "early"), NO_RUN)
    laps = sum(row.laps for row in rows)
    text = f"{laps} flying laps finished; {_endings(rows)}"
    return text, False if laps else True if len(rows) >= MIN_RUNS else None


def _less(data: Tables, name: str, actor: str, unit: str, first: str = "spdl") -> Verdict:
    """Agree where the 95 % interval of the difference of the means over runs says that one is less than the other.

    Args:
        data: the tables.
        name: figure of `Laps`; a lap time is that of the runs that have whole rides.
        actor: of both curricula.
        unit: of the figure.
        first: curriculum that has less in the paper.
    """
    found = {}
    for kind in (first, *(kind for kind in KINDS if kind != first)):
        rows = rows_of(data, kind, actor)
        found[kind] = of_whole(rows, name) if name == "mean" else np.array([getattr(row, name) for row in rows])
    missing = [kind for kind, values in found.items() if not len(values)]
    if missing:
        raise NothingFound(f"no run of {' and '.join(missing)} to compare")
    form = lap_text if name == "mean" else lambda value: f"{value:.2f}"
    text = ", ".join(f"{kind} {form(float(values.mean()))}" for kind, values in found.items())
    if min(map(len, found.values())) < MIN_RUNS:
        return f"{text} {unit} ({', '.join(str(len(v)) for v in found.values())} runs)", None
    low, high = interval(*found.values(), rule=operator.sub)
    return f"{text} {unit}; difference {low:+.2f} to {high:+.2f}", None if low <= 0.0 <= high else high < 0.0


def _sooner(data: Tables) -> Verdict:
    """A run without a whole validation counts as one that had its first with its last step."""
    runs = {kind: [run for run in data.runs if run.setting == kind and run.steps] for kind in KINDS}
    if not all(runs.values()):
        raise NothingFound(NO_RUN)

    def first_whole(run: Run) -> int:
        return run.finished_at if run.finished_at >= 0 else run.steps

    first = {kind: np.array([first_whole(run) for run in each], float) for kind, each in runs.items()}
    text = "first whole validation: " + ", ".join(
        f"{kind} {values.mean():,.0f} decisions ({sum(run.finished_at >= 0 for run in runs[kind])} of {len(values)} "
        "runs had one)"
        for kind, values in first.items()
    )
    if min(map(len, first.values())) < MIN_RUNS:
        return text, None
    low, high = interval(*first.values(), rule=operator.truediv)
    return f"{text}; ratio {low:.2f} to {high:.2f}", None if low <= 1.0 <= high else high < 1.0


def _no_walls(data: Tables) -> Verdict:
    rows = some([row for row in data.laps if row.actor != "best"], NO_RUN)
    walls, rides = sum(row.walls for row in rows), sum(row.rides for row in rows)
    return f"{walls} of {rides} rides ended at a wall", not walls


def _sac_elsewhere(data: Tables) -> Verdict:
    """Table II: SAC alone has a lap on Cremona, and none on Phillip Island."""
    each = {circuit: rows_of(data, setting_of("sac", circuit), "early") for circuit in CIRCUITS[1:]}
    if not all(each.values()):
        raise NothingFound("no run of both")
    laps = {circuit: sum(row.laps for row in rows) for circuit, rows in each.items()}
    text = ", ".join(f"{circuit}: {count} flying laps of {len(each[circuit])} runs" for circuit, count in laps.items())
    if laps[CIRCUITS[2]]:
        return text, False
    return text, True if laps[CIRCUITS[1]] and min(map(len, each.values())) >= MIN_RUNS else None


def best_run(data: Tables, setting: str, actor: str = "best") -> int | None:
    """Return the seed of the run whose actor rode most rides whole, and of these the quickest; None without one."""
    rows = [row for row in rows_of(data, setting, actor) if row.whole]
    return min(rows, key=lambda row: (-row.whole / row.rides, row.mean)).seed if rows else None


def transfers_of(data: Tables, circuit: str) -> dict[str, Any]:
    """Return Table III on a circuit by machine: the rides of the best SPDL run there."""
    setting = setting_of("spdl", circuit)
    seed = best_run(data, setting)
    return {row.machine: row for row in data.transfers if (row.setting, row.seed) == (setting, seed)}


def _transfer(data: Tables) -> Verdict:
    each = {circuit: transfers_of(data, circuit) for circuit in CIRCUITS}
    missing = [circuit for circuit, rows in each.items() if not rows]
    pairs = [row for rows in each.values() for row in rows.values()]
    lapped = sum(row.whole > 0 for row in pairs)
    rides = f"{sum(row.whole for row in pairs)} of {sum(row.rides for row in pairs)} rides whole"
    text = f"{lapped} of {len(pairs)} lapped, {rides}"
    if missing:
        return f"{text}; no actor that laps {' and '.join(missing)}", None
    return text, lapped >= len(CIRCUITS) * len(MACHINES) - 1


def _quickest_trained(data: Tables) -> Verdict:
    rows = transfers_of(data, CIRCUITS[0])
    if MACHINE not in rows or not rows[MACHINE].whole:
        raise NothingFound("no actor that laps")
    own = rows[MACHINE].best
    others = {name: row.best - own for name, row in rows.items() if name != MACHINE and row.whole}
    text = ", ".join(f"{name} {more:+.2f} s" for name, more in others.items()) or "no other machine laps"
    if any(more < 0.0 for more in others.values()):
        return text, False
    return text, None if len(others) < len(MACHINES) - 1 else min(others.values()) > 0.0


def gains(data: Tables, circuit: str) -> dict[str, FloatArray]:
    """Return how much quicker each machine's best lap is than the trained one's, s, by the actors that lap with both.

    The actors are those of all SPDL runs on a circuit.
    """
    setting = setting_of("spdl", circuit)
    best: dict[int, dict[str, float]] = {}
    for row in data.transfers:
        if row.setting == setting and row.whole:
            best.setdefault(row.seed, {})[row.machine] = row.best
    both = [laps for laps in best.values() if MACHINE in laps]
    others = [machine for machine in MACHINES if machine != MACHINE]
    return {name: np.array([laps[MACHINE] - laps[name] for laps in both if name in laps]) for name in others}


def _transfers_best(data: Tables, machine: str, circuit: str) -> Verdict:
    """Agree where a machine's loss to the trained one is less than that of every other."""
    found = gains(data, circuit)
    others = [name for name in found if name != machine]
    return _all_above(found, lambda: [interval(found[machine], found[name], rule=operator.sub) for name in others])


def _quicker_there(data: Tables, circuit: str, machines: Sequence[str]) -> Verdict:
    """Agree where some machines lap a circuit faster than the trained one."""
    found = {name: values for name, values in gains(data, circuit).items() if name in machines}
    return _all_above(found, lambda: [interval(values) for values in found.values()])


def _all_above(found: Mapping[str, FloatArray], intervals: Callable[[], list[tuple[float, float]]]) -> Verdict:
    """Agree where all intervals lie above 0, deny where one lies below it.

    Args:
        found: gains of machines, s, one a run.
        intervals: of them, asked for where each has enough runs.
    """
    lapped = {name: values for name, values in found.items() if len(values)}
    some(lapped, "no actor that laps on two machines")
    text = ", ".join(f"{name} {with_interval(values, '+.2f')} s" for name, values in lapped.items())
    if min(map(len, found.values())) < MIN_RUNS:
        return text, None
    ends = intervals()
    if any(high < 0.0 for _, high in ends):
        return text, False
    return text, True if all(low > 0.0 for low, _ in ends) else None


def _three_laps(data: Tables) -> Verdict:
    """Three consecutive laps; in which third of a lap the best runs differ is of one lap each, and decides nothing."""
    means = [of_whole(rows_of(data, kind, "late"), "mean") for kind in KINDS]
    if not all(map(len, means)):
        raise NothingFound("no whole rides of both")
    low, high = interval(*(3.0 * values for values in means), rule=operator.sub)
    text = f"difference {3.0 * (means[0].mean() - means[1].mean()):+.2f} s"
    text += f", {low:+.2f} to {high:+.2f}" if np.isfinite(low) else f" ({', '.join(str(len(v)) for v in means)} runs)"
    thirds = [_times_at_thirds(data, kind) for kind in KINDS]
    if all(len(times) == 3 for times in thirds):
        apart = np.diff(np.subtract(*thirds), prepend=0.0)
        text += f"; best laps by thirds of the lap: {', '.join(f'{value:+.2f}' for value in apart)} s"
    if min(map(len, means)) < MIN_RUNS:
        return text, None
    return text, None if low <= 0.0 <= high else high < 0.0


def _times_at_thirds(data: Tables, kind: str) -> FloatArray:
    """Return when a flying lap of the best run has passed each third of the circuit, s after the start line."""
    rows = [row for row in data.moments if row.setting == kind]
    if len(rows) < 2 or rows[-1].progress - rows[0].progress < 0.9 * load_track(CIRCUITS[0]).length:
        return np.array([])
    along = np.array([row.progress - rows[0].progress for row in rows])
    return np.interp(along[-1] * np.arange(1, 4) / 3.0, along, [row.time for row in rows])


def overshoots(data: Tables, setting: str) -> dict[str, float]:
    """Return the distance of a lap to the outside of the ideal line in each corner, m; less than 0 where it cuts it."""
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


def _runs_wide(data: Tables) -> Verdict:
    found = some(overshoots(data, "spdl"), "no lap")
    wide = {name: more for name, more in found.items() if more > OVERSHOOT}
    widest = max(found, key=lambda name: found[name])
    text = f"{len(wide)} of {len(found)} corners by more than {OVERSHOOT:g} m, most in corner {widest}: "
    return f"{text}{found[widest]:.2f} m", bool(wide)


def path_of(data: Tables, setting: str) -> dict[int, list[Any]]:
    """Return the distributions of each run of a setting, in the order of updates."""
    found: dict[int, list[Any]] = {}
    for row in sorted(data.contexts, key=lambda row: row.iteration):
        if row.setting == setting:
            found.setdefault(row.seed, []).append(row)
    return found


def _moves(data: Tables) -> Verdict:
    """Agree where the distribution of every run has moved towards the target; the text counts those at the target."""
    paths = some(path_of(data, "spdl"), NO_RUN)
    ends = [path[-1] for path in paths.values()]
    there = sum(end.kl < CONVERGED for end in ends)
    nearer = sum(path[-1].kl < path[0].kl for path in paths.values())
    low, high = min(end.kl for end in ends), max(end.kl for end in ends)
    speed = np.mean([end.v_max for end in ends])
    text = (
        f"nearer in {nearer} of {len(ends)} runs, there in {there}: divergence at the end {low:.3g} to {high:.3g} nat"
    )
    return f"{text}, mean speed limit {speed:.0f} m/s", nearer == len(ends)


STATEMENTS: Final = statements_of(
    PAPER,
    _all_whole,
    _less,
    _moves,
    _no_lap,
    _no_walls,
    _quicker_there,
    _quickest_trained,
    _runs_wide,
    _sac_elsewhere,
    _sooner,
    _three_laps,
    _transfer,
    _transfers_best,
)
"""Statements that the experiments can answer."""

# --------------------------------------------------------------------------------------------------------- tables

PUBLISHED: Final[Mapping[str, Mapping[str, Sequence[str]]]] = PAPER["published"]


_ROWS_1: Final[dict[str, Callable[[list[Any]], str]]] = {
    "rides whole": lambda rows: f"{sum(row.whole for row in rows)} of {sum(row.rides for row in rows)}",
    "lap time, mean": lambda rows: with_interval(of_whole(rows, "mean"), lap_text),
    "lap time, best": lambda rows: lap_text(min(best)) if len(best := of_whole(rows, "best")) else "-",
    "distance to ideal / m": lambda rows: with_interval(np.array([row.line for row in rows]), ".2f"),
    "off-track time a ride / s": lambda rows: with_interval(np.array([row.outside for row in rows]), ".2f"),
    "falls": lambda rows: f"{sum(row.falls for row in rows)}",
    "collisions": lambda rows: f"{sum(row.walls for row in rows)}",
}


def _cell(rows: list[Any], name: str) -> str:
    return _ROWS_1[name](rows) if rows else "-"


def _runs(data: Tables) -> str:
    rows = []
    for name in dict.fromkeys(run.setting for run in data.runs):
        runs = [run for run in data.runs if run.setting == name]
        whole = np.array([run.finished_at for run in runs if run.finished_at >= 0], float)
        done = [run for run in runs if run.status == "finished"]
        cpu = np.array([run.cpu_seconds for run in done if run.cpu_seconds >= 0.0], float)
        steps = ", ".join(f"{steps:,}" for steps in sorted({run.steps for run in done})) or "-"
        first = f"{len(whole)} of {len(runs)}: {with_interval(whole, ',.0f')}"
        rows.append((name, f"{len(done)} of {len(runs)}", steps, first, with_interval(cpu, ".0f")))
    head = ("setting", "runs finished", "decisions each", "first whole validation, decisions")
    return markdown((*head, "processor time a run / s"), rows)


def _arms(data: Tables) -> str:
    """Every curriculum in Barcelona beside the fixed schedule: differences of the means with their intervals."""
    kinds = [name for name in dict.fromkeys(run.setting for run in data.runs) if circuit_of(name) == CIRCUITS[0]]
    share = {}
    for kind in kinds:
        found = [
            np.array([row.error < 1.0 for row in data.validations if (row.setting, row.seed) == (kind, run.seed)])
            for run in data.runs
            if run.setting == kind
        ]
        share[kind] = np.array([100.0 * whole.mean() for whole in found if len(whole)])
    late = {kind: np.array([100.0 * row.whole / row.rides for row in rows_of(data, kind, "late")]) for kind in kinds}
    rows = []
    for kind in kinds:
        cells = [kind, str(len(late[kind]))]
        for values in (share, late):
            cells.append(with_interval(values[kind], ".0f"))
            other = values.get("schedule", np.array([]))
            known = kind != "schedule" and min(len(values[kind]), len(other)) > 1
            low, high = interval(values[kind], other, rule=operator.sub) if known else (0.0, 0.0)
            cells.append(f"{low:+.0f} to {high:+.0f}" if known else "")
        rows.append((*cells, with_interval(of_whole(rows_of(data, kind, "late"), "mean"), lap_text)))
    head = ("curriculum", "runs", "whole validations / %", "less the schedule's", "rides whole, late / %")
    return markdown((*head, "less the schedule's", "lap time, late"), rows)


def _table_1(data: Tables) -> str:
    columns = [(kind, actor) for actor in ACTORS for kind in KINDS]
    each = [rows_of(data, kind, actor) for kind, actor in columns]
    steps = [sorted({row.step for row in rows}) for rows in each]
    cells = [f"{of[0]:,}" + (f" to {of[-1]:,}" if len(of) > 1 else "") if of else "-" for of in steps]
    lines: list[Sequence[str]] = [("decisions", *cells)]
    lines += [(name, *(_cell(rows, name) for rows in each)) for name in _ROWS_1]
    names = ("lap time", "distance / m", "off-track / s", "falls", "collisions")
    published = [PUBLISHED["table_1"].get(" ".join(column), ("",) * 5) for column in columns]
    lines += [(f"*paper: {name}*", *(of[place] for of in published)) for place, name in enumerate(names)]
    return markdown(("", *(f"{kind.upper()} {actor}" for kind, actor in columns)), lines)


def _table_2(data: Tables) -> str:
    lines: list[Sequence[str]] = []
    names = ("rides whole", "lap time, mean", "distance to ideal / m", "off-track time a ride / s")
    for circuit in CIRCUITS:
        lap, line, off, sac = PUBLISHED["table_2"][circuit]
        lines.append((circuit, "*paper, early*", "", lap, line, off, "", sac))
        for actor in ACTORS:
            ours, others = (rows_of(data, setting_of(kind, circuit), actor) for kind in KINDS)
            if ours or others:
                cells = [_cell(ours, name) for name in names] + [_cell(others, name) for name in names[:2]]
                lines.append(("", actor, *cells))
    head = ("circuit", "actor", "SPDL whole", "lap", "distance / m", "off-track / s", "SAC whole", "lap")
    return markdown(head, lines)


def _table_3(data: Tables) -> str:
    found = {circuit: transfers_of(data, circuit) for circuit in CIRCUITS}
    lines: list[Sequence[str]] = []

    def cell(row: Any | None) -> str:
        if row is None:
            return "not ridden"
        return f"{lap_text(row.best) if row.whole else '-'} ({row.whole} of {row.rides})"

    for machine in MACHINES:
        lines.append((machine, "paper", *PUBLISHED["table_3"][machine]))
        lines.append(("", "found", *(cell(found[circuit].get(machine)) for circuit in CIRCUITS)))
    return markdown(("machine", "", *CIRCUITS), lines)


TABLES: Final = {
    "Runs, means with 95 % bootstrap intervals": _runs,
    "Curricula: Panigale, Barcelona": _arms,
    "Table I: Panigale, Barcelona": _table_1,
    "Table II: three circuits, an actor learned on each": _table_2,
    "Table III: best laps of the best SPDL run of each circuit, on machines that it did not learn on": _table_3,
}
"""All tables as Markdown, by their headings."""
