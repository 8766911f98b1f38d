"""Tables of the superbike paper's experiments, its statements, and its tables as Markdown."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from bike_analysis.figures.cells import markdown
from bike_analysis.figures.numbers import lap_text
from bike_sim.course.files import load_track
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

MACHINE: Final = "panigale_v4r"
MACHINES: Final = (MACHINE, "zx10rr", "cbr1000rr_r", "r1", "m1000rr")
"""Of Table III; the first one learns."""
CIRCUITS: Final = ("barcelona", "cremona", "phillip_island")
KINDS: Final = ("spdl", "sac")
"""Curricula that are compared; the first part of a setting's name."""
ABLATIONS: Final = (
    "swings", "unplanned-reward", "unplanned-observation", "points-ahead", "no-lean-history", "no-failures",
    "no-mirror",
)  # fmt: skip
"""The same of SAC alone with one thing changed."""
UNPLANNED: Final = ("plain-spdl", "plain-sac", "plain-schedule")
"""The same, and a fixed schedule, without a plan in reward or observation."""
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
"""Its tables and statements; the error of a validation is its rides' mean excess over the planned lap, 1 of one not
whole."""


# -------------------------------------------------------------------------------------------------------- verdicts

OVERSHOOT: Final = 1.0
"""Distance to the outside of the ideal line that counts as running wide, m; ours."""
CONVERGED: Final = 1.0
"""Divergence below which a distribution has come to the target, nat; ours."""
NO_RUN: Final = "no run"


def rows_of(data: Tables, setting: str, actor: str) -> pd.DataFrame:
    """Return the rides of an actor of all runs of a setting."""
    return select(data["laps"], setting=setting, actor=actor)


def of_whole(rows: pd.DataFrame, name: str) -> FloatArray:
    """Return a figure of each run that has laps of whole rides."""
    return rows[rows["whole"] > 0][name].to_numpy(float)


def _endings(rows: pd.DataFrame) -> str:
    """Return the endings of the rides of some actors as text."""
    ends = rows[["rides", "whole", "falls", "walls"]].sum()
    if rows.empty:
        return NO_RUN
    text = f"{ends['whole']} of {ends['rides']} rides whole, {ends['falls']} falls, {ends['walls']} walls"
    return f"{text} ({len(rows)} run{'s' if len(rows) != 1 else ''})"


def _all_whole(data: Tables, kind: str, actor: str, circuits: Sequence[str] = CIRCUITS[:1]) -> Verdict:
    """Agree where every ride of every run is whole; one that is not denies it. Fewer than `MIN_RUNS` say neither."""
    each = {circuit: rows_of(data, setting_of(kind, circuit), actor) for circuit in circuits}
    rides = some(pd.concat(each.values()), NO_RUN)
    texts = [_endings(rows) if len(each) == 1 else f"{circuit}: {_endings(rows)}" for circuit, rows in each.items()]
    enough = min(map(len, each.values())) >= MIN_RUNS
    return "; ".join(texts), not (rides["whole"] < rides["rides"]).any() if enough else None


def _no_lap(data: Tables) -> Verdict:
    rows = some(rows_of(data, "sac", "early"), NO_RUN)
    laps = rows["laps"].sum()
    text = f"{laps} flying laps finished; {_endings(rows)}"
    return text, not laps if len(rows) >= MIN_RUNS else None


def _less(data: Tables, name: str, actor: str, unit: str, first: str = "spdl") -> Verdict:
    """Agree where the 95 % interval of the difference of the means over runs says that one is less than the other.

    Args:
        data: the tables.
        name: figure of ``laps``; a lap time is that of the runs that have whole rides.
        actor: of both curricula.
        unit: of the figure.
        first: curriculum that has less in the paper.
    """
    each = {kind: rows_of(data, kind, actor) for kind in (first, *(kind for kind in KINDS if kind != first))}
    found = {kind: of_whole(rows, name) if name == "mean" else rows[name].to_numpy() for kind, rows in each.items()}
    missing = [kind for kind, values in found.items() if not len(values)]
    if missing:
        raise NothingFound(f"no run of {' and '.join(missing)} to compare")
    form = lap_text if name == "mean" else lambda value: f"{value:.2f}"
    text = ", ".join(f"{kind} {form(float(values.mean()))}" for kind, values in found.items())
    text = f"{text} {unit} ({' and '.join(str(len(values)) for values in found.values())} runs)"
    if min(map(len, found.values())) < MIN_RUNS:
        return text, None
    low, high, less = compare(found.values())
    return f"{text}; difference {low:+.2f} to {high:+.2f}", less


def _sooner(data: Tables) -> Verdict:
    """A run without a whole validation counts as one that had its first with its last step."""
    each = {kind: select(data["runs"], setting=kind) for kind in KINDS}
    first = {kind: last_steps(runs[runs["steps"] > 0]) for kind, runs in each.items()}
    whole = {kind: (runs["finished_at"] >= 0).sum() for kind, runs in each.items()}
    if not all(map(len, first.values())):
        raise NothingFound(NO_RUN)
    text = "first whole validation: " + ", ".join(
        f"{kind} {values.mean():,.0f} decisions ({whole[kind]} of {len(values)} runs had one)"
        for kind, values in first.items()
    )
    if min(map(len, first.values())) < MIN_RUNS:
        return text, None
    low, high, less = compare(first.values(), operator.truediv, 1.0)
    return f"{text}; ratio {low:.2f} to {high:.2f}", less


def _no_walls(data: Tables) -> Verdict:
    rows = some(data["laps"][data["laps"]["actor"] != "best"], NO_RUN)
    runs = len(rows[["setting", "seed"]].drop_duplicates())
    text = f"{rows['walls'].sum()} of {rows['rides'].sum()} rides ended at a wall ({runs} runs)"
    enough = rows.groupby("setting")["seed"].nunique().min() >= MIN_RUNS
    return text, not rows["walls"].any() if enough else None


def _sac_elsewhere(data: Tables) -> Verdict:
    """Table II: SAC alone has a lap on Cremona, and none on Phillip Island."""
    each = {circuit: rows_of(data, setting_of("sac", circuit), "early") for circuit in CIRCUITS[1:]}
    if not all(map(len, each.values())):
        raise NothingFound("no run of both")
    laps = {circuit: rows["laps"].sum() for circuit, rows in each.items()}
    text = ", ".join(f"{circuit}: {count} flying laps of {len(each[circuit])} runs" for circuit, count in laps.items())
    enough = min(map(len, each.values())) >= MIN_RUNS
    return text, bool(laps[CIRCUITS[1]]) and not laps[CIRCUITS[2]] if enough else None


def best_run(data: Tables, setting: str, actor: str = "best") -> int | None:
    """Return the seed of the run whose actor rode most rides whole, and of these the quickest; None without one."""
    rows = rows_of(data, setting, actor)
    rows = rows[rows["whole"] > 0].assign(share=lambda found: -found["whole"] / found["rides"])
    return None if rows.empty else int(rows.sort_values(["share", "mean"])["seed"].iloc[0])


def transfers_of(data: Tables, circuit: str) -> pd.DataFrame:
    """Return Table III on a circuit by machine: the rides of the best SPDL run there."""
    setting = setting_of("spdl", circuit)
    return select(data["transfers"], setting=setting, seed=best_run(data, setting)).set_index("machine")


def _transfer(data: Tables) -> Verdict:
    """Agree where the SPDL actors of a seed, one for each circuit, lap as many pairs as in the paper in the mean."""
    rows = select(data["transfers"], setting=[setting_of("spdl", circuit) for circuit in CIRCUITS])
    each = some(rows, "no actor").groupby("seed")
    lapped = each["whole"].agg(lambda whole: int((whole > 0).sum()))[each["circuit"].nunique() == len(CIRCUITS)]
    some(lapped, "no actor of each circuit")
    pairs = len(CIRCUITS) * len(MACHINES)
    text = f"{with_interval(lapped.to_numpy(float), '.1f')} of {pairs} lapped ({len(lapped)} actors of each circuit)"
    if len(lapped) < MIN_RUNS:
        return text, None
    low, high = interval(lapped.to_numpy(float))
    return text, True if low >= pairs - 1 else False if high < pairs - 1 else None


def _quickest_trained(data: Tables) -> Verdict:
    found = gains(data, CIRCUITS[0])
    return _all_above(found, [(np.zeros(len(values)), values) for values in found.values()])


def gains(data: Tables, circuit: str) -> dict[str, FloatArray]:
    """Return how much quicker each machine's best lap is than the trained one's, s, by the actors that lap with both.

    The actors are those of all SPDL runs on a circuit.
    """
    rows = select(data["transfers"], setting=setting_of("spdl", circuit))
    best = rows[rows["whole"] > 0].pivot(index="seed", columns="machine", values="best").reindex(columns=list(MACHINES))
    return {name: (best[MACHINE] - best[name]).dropna().to_numpy() for name in MACHINES if name != MACHINE}


def _transfers_best(data: Tables, machine: str, circuit: str) -> Verdict:
    """Agree where a machine's loss to the trained one is less than that of every other."""
    found = gains(data, circuit)
    others = [name for name in found if name != machine]
    return _all_above(found, [(found[machine], found[name]) for name in others])


def _quicker_there(data: Tables, circuit: str, machines: Sequence[str]) -> Verdict:
    """Agree where some machines lap a circuit faster than the trained one."""
    found = {name: values for name, values in gains(data, circuit).items() if name in machines}
    return _all_above(found, [(values, np.zeros(len(values))) for values in found.values()])


def _all_above(found: Mapping[str, FloatArray], pairs: Iterable[tuple[FloatArray, FloatArray]]) -> Verdict:
    """Agree where all differences lie above 0, deny where one lies below it.

    Args:
        found: gains of machines, s, one a run.
        pairs: of them, of which the first are to be the larger.
    """
    lapped = {name: values for name, values in found.items() if len(values)}
    some(lapped, "no actor that laps on two machines")
    text = ", ".join(f"{name} {with_interval(values, '+.2f')} s" for name, values in lapped.items())
    counts = sorted({*map(len, lapped.values())})
    text += f" ({' to '.join(map(str, dict.fromkeys((counts[0], counts[-1]))))} runs)"
    less = [compare(pair)[2] for pair in pairs]
    return text, False if any(less) else True if all(each is False for each in less) else None


def overshoots(data: Tables, setting: str) -> dict[str, float]:
    """Return the distance of a lap to the outside of the ideal line in each corner, m; less than 0 where it cuts it."""
    track, rows = load_track(CIRCUITS[0]), select(data["moments"], setting=setting)
    found = {}
    for corner in track.corners:
        inside = rows[(rows["progress"] - corner.begin) % track.length <= corner.end - corner.begin]
        if not inside.empty:
            found[corner.name] = float(((-1.0 if corner.angle > 0.0 else 1.0) * inside["error"]).max())
    return found


def _runs_wide(data: Tables) -> Verdict:
    found = some(overshoots(data, "spdl"), "no lap")
    wide = {name: more for name, more in found.items() if more > OVERSHOOT}
    widest = max(found, key=lambda name: found[name])
    text = f"{len(wide)} of {len(found)} corners by more than {OVERSHOOT:g} m, most in corner {widest}: "
    text += f"{found[widest]:.2f} m"
    laps = select(data["moments"], setting="spdl")["seed"].nunique()
    return text, bool(wide) if laps >= MIN_RUNS else None


def _gains_early(data: Tables) -> Verdict:
    """Agree where laps of SPDL gain more on those of SAC in the first third of the circuit than in the rest."""
    length = load_track(CIRCUITS[0]).length
    times: dict[str, FloatArray] = {}
    for kind in KINDS:
        laps = [lap for _, lap in select(data["moments"], setting=kind).groupby("seed") if len(lap) > 1]
        place = [np.unwrap(lap["progress"].to_numpy(), period=length) for lap in laps]
        parts = [
            np.interp(way[0] + np.array([length / 3.0, length]), way, lap["time"])
            for lap, way in zip(laps, place, strict=True)
            if way[-1] - way[0] > 0.95 * length
        ]
        times[kind] = np.array(parts).reshape(-1, 2)
        some(times[kind], f"no lap of {kind}")
    spdl, sac = (times[kind].mean(axis=0) for kind in KINDS)
    early, whole = sac - spdl
    counts = " and ".join(str(len(times[kind])) for kind in KINDS)
    text = f"{early:+.2f} s in the first third, {whole - early:+.2f} s in the rest ({counts} laps)"
    early_less_rest = [2.0 * each[:, 0] - each[:, 1] for each in times.values()]
    return text, compare(early_less_rest)[2]


def _moves(data: Tables) -> Verdict:
    """Agree where the distribution of every run has moved towards the target; the text counts those at the target."""
    rows = some(select(data["contexts"], setting="spdl"), NO_RUN).sort_values("iteration").groupby("seed")
    kl, speed = rows["kl"].last(), rows["v_max"].last().mean()
    nearer, there = int((kl < rows["kl"].first()).sum()), int((kl < CONVERGED).sum())
    text = f"nearer in {nearer} of {len(kl)} runs, there in {there}: divergence at the end "
    text += f"{kl.min():.3g} to {kl.max():.3g} nat, mean speed limit {speed:.0f} m/s"
    return text, nearer == len(kl)


STATEMENTS: Final = statements_of(PAPER, globals())
"""Statements that the experiments can answer."""

# --------------------------------------------------------------------------------------------------------- tables

PUBLISHED: Final[Mapping[str, Mapping[str, Sequence[str]]]] = PAPER["published"]


_ROWS_1: Final[dict[str, Callable[[pd.DataFrame], str]]] = {
    "rides whole": lambda rows: f"{rows['whole'].sum()} of {rows['rides'].sum()}",
    "lap time, mean": lambda rows: with_interval(of_whole(rows, "mean"), lap_text),
    "lap time, best": lambda rows: lap_text(min(best)) if len(best := of_whole(rows, "best")) else "-",
    "distance to ideal / m": lambda rows: with_interval(rows["line"].to_numpy(), ".2f"),
    "off-track time a ride / s": lambda rows: with_interval(rows["outside"].to_numpy(), ".2f"),
    "falls": lambda rows: f"{rows['falls'].sum()}",
    "collisions": lambda rows: f"{rows['walls'].sum()}",
}


def _cell(rows: pd.DataFrame, name: str) -> str:
    return _ROWS_1[name](rows) if len(rows) else "-"


def _runs(data: Tables) -> str:
    rows = []
    for name, runs in data["runs"].groupby("setting", sort=False):
        whole = runs[runs["finished_at"] >= 0]["finished_at"].to_numpy(float)
        done = select(runs, status="finished")
        cpu = done[done["cpu_seconds"] >= 0.0]["cpu_seconds"].to_numpy()
        steps = ", ".join(f"{steps:,}" for steps in sorted(done["steps"].unique())) or "-"
        first = f"{len(whole)} of {len(runs)}: {with_interval(whole, ',.0f')}"
        rows.append((name, f"{len(done)} of {len(runs)}", steps, first, with_interval(cpu, ".0f")))
    head = ("setting", "runs finished", "decisions each", "first whole validation, decisions")
    return markdown([(*head, "processor time a run / s"), *rows])


def _curricula(data: Tables) -> str:
    """Every curriculum in Barcelona beside the fixed schedule."""
    kinds = [name for name in data["runs"]["setting"].unique() if circuit_of(name) == CIRCUITS[0]]
    return _arms(data, [kind for kind in kinds if kind not in (*ABLATIONS, *UNPLANNED)], "schedule")


def _unplanned(data: Tables) -> str:
    """Both curricula without a plan, in Barcelona.

    A validation waits for an episode that reaches its end, and in most of these runs none does: the last ones stand in.
    """
    last = data["episodes"].sort_values("step").groupby(["setting", "seed"], as_index=False).last()
    measures = {
        heading: {kind: select(last, setting=kind)[name].to_numpy(float) for kind in UNPLANNED}
        for name, heading in (("total", "return, last episodes"), ("length", "their length, decisions"))
    }
    return _beside(data, UNPLANNED, "plain-sac", measures)


def _ablations(data: Tables) -> str:
    """SAC alone in Barcelona, and with one thing changed."""
    return _arms(data, ("sac", *ABLATIONS), "sac")


def _arms(data: Tables, kinds: Sequence[str], base: str) -> str:
    """Return the whole validations of settings beside those of one of them; see `_beside`."""
    whole = data["validations"].assign(whole=lambda found: found["error"] < 1.0)
    share = {kind: 100.0 * select(whole, setting=kind).groupby("seed")["whole"].mean().to_numpy() for kind in kinds}
    return _beside(data, kinds, base, {"whole validations / %": share})


def _beside(data: Tables, kinds: Sequence[str], base: str, measures: Mapping[str, Mapping[str, FloatArray]]) -> str:
    """Return measures and late rides of settings beside one of them: differences of means with their intervals.

    Args:
        data: with the runs; a setting without any is left out.
        kinds: settings.
        base: the setting that the others are compared with.
        measures: by their headings; of each setting, one value a run.
    """
    kinds = [kind for kind in kinds if kind in set(data["runs"]["setting"])]
    rides = {kind: rows_of(data, kind, "late") for kind in kinds}
    late = {kind: (100.0 * of["whole"] / of["rides"]).to_numpy() for kind, of in rides.items()}
    measures = {**measures, "rides whole, late / %": late}
    rows = []
    for kind in kinds:
        cells = [kind, str(len(late[kind]))]
        for values in measures.values():
            cells.append(with_interval(values[kind], ".0f"))
            other = values.get(base, np.array([]))
            known = kind != base and min(len(values[kind]), len(other)) > 1
            low, high = interval(values[kind], other, rule=operator.sub) if known else (0.0, 0.0)
            cells.append(f"{low:+.0f} to {high:+.0f}" if known else "")
        rows.append((*cells, with_interval(of_whole(rides[kind], "mean"), lap_text)))
    head = [title for name in measures for title in (name, f"less those of {base}")]
    return markdown([("setting", "runs", *head, "lap time, late"), *rows])


def _table_1(data: Tables) -> str:
    columns = [(kind, actor) for actor in ACTORS for kind in KINDS]
    each = [rows_of(data, kind, actor) for kind, actor in columns]
    steps = [sorted(rows["step"].unique()) for rows in each]
    cells = [f"{of[0]:,}" + (f" to {of[-1]:,}" if len(of) > 1 else "") if of else "-" for of in steps]
    lines: list[Sequence[str]] = [("decisions", *cells)]
    lines += [(name, *(_cell(rows, name) for rows in each)) for name in _ROWS_1]
    names = ("lap time", "distance / m", "off-track / s", "falls", "collisions")
    published = [PUBLISHED["table_1"].get(" ".join(column), ("",) * 5) for column in columns]
    lines += [(f"*paper: {name}*", *(of[place] for of in published)) for place, name in enumerate(names)]
    return markdown([("", *(f"{kind.upper()} {actor}" for kind, actor in columns)), *lines])


def _table_2(data: Tables) -> str:
    lines: list[Sequence[str]] = []
    names = ("rides whole", "lap time, mean", "distance to ideal / m", "off-track time a ride / s")
    for circuit in CIRCUITS:
        lap, line, off, sac = PUBLISHED["table_2"][circuit]
        lines.append((circuit, "*paper, early*", "", lap, line, off, "", sac))
        for actor in ACTORS:
            ours, others = (rows_of(data, setting_of(kind, circuit), actor) for kind in KINDS)
            if len(ours) or len(others):
                cells = [_cell(ours, name) for name in names] + [_cell(others, name) for name in names[:2]]
                lines.append(("", actor, *cells))
    head = ("circuit", "actor", "SPDL whole", "lap", "distance / m", "off-track / s", "SAC whole", "lap")
    return markdown([head, *lines])


def _table_3(data: Tables) -> str:
    found = {circuit: transfers_of(data, circuit) for circuit in CIRCUITS}
    lines: list[Sequence[str]] = []

    def cell(rows: pd.DataFrame, machine: str) -> str:
        if machine not in rows.index:
            return "not ridden"
        best, whole, rides = (rows[name][machine] for name in ("best", "whole", "rides"))
        return f"{lap_text(best) if whole else '-'} ({whole} of {rides})"

    for machine in MACHINES:
        lines.append((machine, "paper", *PUBLISHED["table_3"][machine]))
        lines.append(("", "found", *(cell(found[circuit], machine) for circuit in CIRCUITS)))
    return markdown([("machine", "", *CIRCUITS), *lines])


TABLES: Final = {
    "Runs, means with 95 % bootstrap intervals": _runs,
    "Curricula: Panigale, Barcelona": _curricula,
    "Ablations: Panigale, Barcelona": _ablations,
    "Without a plan: Panigale, Barcelona": _unplanned,
    "Table I: Panigale, Barcelona": _table_1,
    "Table II: three circuits, an actor learned on each": _table_2,
    "Table III: best laps of the best SPDL run of each circuit, on machines that it did not learn on": _table_3,
}
"""All tables as Markdown, by their headings."""
