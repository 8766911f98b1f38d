"""Tables I to III of the superbike paper for one policy: its rides beside what is published."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from bike_analysis.figures.numbers import lap_text
from bike_training.reproduce.superbike.experiment import CIRCUITS, MACHINE, MACHINES
from bike_training.reproduce.superbike.tables import PUBLISHED_1, PUBLISHED_2, PUBLISHED_3
from bike_training.rollout.races import RaceResult

NOT_RIDDEN: Final = "not ridden"


def bundle_tables(name: str, results: Sequence[RaceResult]) -> str:
    """Return the three tables as Markdown.

    Table I is of the paper's machine on its first circuit, Table II of that machine on all, Table III of all machines.
    What was not ridden is said to be so.

    Args:
        name: of the policy.
        results: a machine on a circuit each.
    """
    ridden = {(result.vehicle, result.circuit): result for result in results}
    parts = (_table_1(name, ridden), _table_2(name, ridden), _table_3(name, ridden))
    return "\n".join(parts)


Ridden = dict[tuple[str, str], RaceResult]


def _mean_lap(result: RaceResult) -> str:
    return lap_text(float(np.mean(result.times))) if result.times else "-"


def _figures(result: RaceResult) -> tuple[str, ...]:
    """Return lap time, distance, off-track time a ride, falls and collisions, as Table I has them."""
    off = result.outside / result.rides
    return _mean_lap(result), f"{result.line:.2f}", f"{off:.2f}", str(result.falls), str(result.walls)


def _table_1(name: str, ridden: Ridden) -> str:
    result = ridden.get((MACHINE, CIRCUITS[0]))
    found = (NOT_RIDDEN,) * 5 if result is None else _figures(result)
    rides = "" if result is None else f", {result.rides} rides of {result.laps} flying laps, {result.whole} whole"
    published = [PUBLISHED_1[kind, "late"] for kind in ("spdl", "sac")]
    rows = ("lap time, mean", "distance to the line / m", "off-track time a ride / s", "falls", "collisions")
    lines = [
        f"Table I: {MACHINE}, {CIRCUITS[0]}{rides}",
        "",
        f"| | {name} | paper, SPDL | paper, SAC |",
        "|---" * 4 + "|",
    ]
    for place, row in enumerate(rows):
        lines.append(f"| {row} | {found[place]} | {published[0][place]} | {published[1][place]} |")
    return "\n".join(lines) + "\n"


def _table_2(name: str, ridden: Ridden) -> str:
    head = "| circuit | lap time, mean | paper | distance / m | paper | off-track / s | paper | paper's SAC |"
    lines = [f"Table II: {MACHINE}, {name}", "", head, "|---" * 8 + "|"]
    for circuit in CIRCUITS:
        result, published = ridden.get((MACHINE, circuit)), PUBLISHED_2[circuit]
        found = (NOT_RIDDEN,) * 3 if result is None else _figures(result)[:3]
        pairs = [cell for pair in zip(found, published[:3], strict=True) for cell in pair]
        lines.append(f"| {circuit} | " + " | ".join([*pairs, published[3]]) + " |")
    return "\n".join(lines) + "\n"


def _table_3(name: str, ridden: Ridden) -> str:
    head = "| machine | " + " | ".join(f"{circuit} | paper" for circuit in CIRCUITS) + " |"
    lines = [f"Table III: best laps, {name}", "", head, "|---" * (1 + 2 * len(CIRCUITS)) + "|"]
    for machine in MACHINES:
        cells = []
        for circuit, published in zip(CIRCUITS, PUBLISHED_3[machine], strict=True):
            result = ridden.get((machine, circuit))
            best = NOT_RIDDEN if result is None else lap_text(result.times[0]) if result.times else "-"
            cells += [best, published]
        lines.append(f"| {machine} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"
