"""Tables I to III of the superbike paper, and one of the runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from bike_analysis.figures.numbers import lap_text
from bike_training.reproduce.statement import FloatArray, interval, with_interval
from bike_training.reproduce.superbike.data import Data, Laps
from bike_training.reproduce.superbike.experiment import CIRCUITS, MACHINES, setting_of
from bike_training.reproduce.superbike.rides import ACTORS
from bike_training.reproduce.superbike.statements import of_whole, rows_of, transfers_of

PUBLISHED_1: Final = {
    ("spdl", "early"): ("1:32.85", "2.99", "1.74", "0", "0"),
    ("sac", "early"): ("-", "4.59", "9.22", "3", "0"),
    ("spdl", "late"): ("1:30.75", "3.15", "1.17", "0", "0"),
    ("sac", "late"): ("1:31.32", "2.89", "2.15", "0", "0"),
}
"""Published Table I: lap time, distance to the ideal line (m), off-track time (s), falls, collisions."""
PUBLISHED_2: Final = {
    "barcelona": ("1:32.85", "2.99", "1.74", "-"),
    "cremona": ("1:28.22", "3.73", "1.31", "1:29.14"),
    "phillip_island": ("1:27.49", "3.10", "4.35", "-"),
}
"""Published Table II: lap time, distance (m) and off-track time (s) of SPDL, lap time of SAC."""
PUBLISHED_3: Final = {
    "panigale_v4r": ("1:30.24", "1:27.80", "1:26.01"),
    "zx10rr": ("1:31.10", "1:27.98", "1:28.75"),
    "cbr1000rr_r": ("1:32.34", "1:28.81", "1:24.62"),
    "r1": ("1:32.53", "1:29.52", "1:24.29"),
    "m1000rr": ("1:33.13", "1:30.32", "-"),
}
"""Published Table III: best laps of each machine on the three circuits."""


def _lap_with_interval(values: FloatArray) -> str:
    if not len(values):
        return "-"
    low, high = interval(values)
    mean = lap_text(float(values.mean()))
    return mean if not np.isfinite(low) else f"{mean} ({lap_text(low)} to {lap_text(high)})"


def _runs(data: Data) -> str:
    lines = [
        "| setting | runs finished | decisions each | first whole validation, decisions | processor time a run / s |",
        "|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(run.setting for run in data.runs):
        runs = [run for run in data.runs if run.setting == name]
        whole = np.array([run.finished_at for run in runs if run.finished_at >= 0], float)
        done = [run for run in runs if run.status == "finished"]
        cpu = np.array([run.cpu_seconds for run in done if run.cpu_seconds >= 0.0], float)
        steps = ", ".join(f"{steps:,}" for steps in sorted({run.steps for run in done})) or "-"
        lines.append(
            f"| {name} | {len(done)} of {len(runs)} | {steps} | {len(whole)} of {len(runs)}: "
            f"{with_interval(whole, ',.0f')} | {with_interval(cpu, '.0f')} |"
        )
    return "\n".join(lines) + "\n"


_ROWS_1: Final[tuple[tuple[str, Callable[[list[Laps]], str]], ...]] = (
    ("rides whole", lambda rows: f"{sum(row.whole for row in rows)} of {sum(row.rides for row in rows)}"),
    ("lap time, mean", lambda rows: _lap_with_interval(of_whole(rows, "mean"))),
    ("lap time, best", lambda rows: lap_text(min(best)) if len(best := of_whole(rows, "best")) else "-"),
    ("distance to ideal / m", lambda rows: with_interval(np.array([row.line for row in rows]), ".2f")),
    ("off-track time a ride / s", lambda rows: with_interval(np.array([row.outside for row in rows]), ".2f")),
    ("falls", lambda rows: f"{sum(row.falls for row in rows)}"),
    ("collisions", lambda rows: f"{sum(row.walls for row in rows)}"),
)


def _table_1(data: Data) -> str:
    columns = [(kind, actor) for actor in ACTORS for kind in ("spdl", "sac")]
    lines = [
        "| | " + " | ".join(f"{kind.upper()} {actor}" for kind, actor in columns) + " |",
        "|---" * (len(columns) + 1) + "|",
    ]
    cells = [rows_of(data, kind, actor) for kind, actor in columns]
    steps = [sorted({row.step for row in rows}) for rows in cells]
    told = [f"{each[0]:,}" + (f" to {each[-1]:,}" if len(each) > 1 else "") if each else "-" for each in steps]
    lines.append("| decisions | " + " | ".join(told) + " |")
    for name, write in _ROWS_1:
        lines.append(f"| {name} | " + " | ".join(write(rows) if rows else "-" for rows in cells) + " |")
    published = [PUBLISHED_1.get(column, ("",) * 5) for column in columns]
    names = ("lap time", "distance / m", "off-track / s", "falls", "collisions")
    for place, name in enumerate(names):
        lines.append(f"| *paper: {name}* | " + " | ".join(each[place] for each in published) + " |")
    return "\n".join(lines) + "\n"


def _table_2(data: Data) -> str:
    lines = [
        "| circuit | actor | SPDL whole | lap | distance / m | off-track / s | SAC whole | lap |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for circuit in CIRCUITS:
        lap, line, off, sac = PUBLISHED_2[circuit]
        lines.append(f"| {circuit} | *paper, early* | | {lap} | {line} | {off} | | {sac} |")
        for actor in ACTORS:
            ours, others = (rows_of(data, setting_of(kind, circuit), actor) for kind in ("spdl", "sac"))
            if not (ours or others):
                continue
            by_name = dict(_ROWS_1)
            names = ("rides whole", "lap time, mean", "distance to ideal / m", "off-track time a ride / s")
            cells = [by_name[name](ours) if ours else "-" for name in names]
            cells += [by_name[name](others) if others else "-" for name in names[:2]]
            lines.append(f"| | {actor} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _table_3(data: Data) -> str:
    lines = ["| machine | | " + " | ".join(CIRCUITS) + " |", "|---" * (len(CIRCUITS) + 2) + "|"]
    found = {circuit: transfers_of(data, circuit) for circuit in CIRCUITS}
    for machine in MACHINES:
        lines.append(f"| {machine} | paper | " + " | ".join(PUBLISHED_3[machine]) + " |")
        cells = []
        for circuit in CIRCUITS:
            row = found[circuit].get(machine)
            lap = "-" if row is None or not row.whole else lap_text(row.best)
            cells.append("not ridden" if row is None else f"{lap} ({row.whole} of {row.rides})")
        lines.append("| | found | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


TABLES: Final = {
    "Runs, means with 95 % bootstrap intervals": _runs,
    "Table I: Panigale, Barcelona": _table_1,
    "Table II: three circuits, an actor learned on each": _table_2,
    "Table III: best laps of the best SPDL run of each circuit, on machines that it did not learn on": _table_3,
}
"""All tables as Markdown, by their headings."""
