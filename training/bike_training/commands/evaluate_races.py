"""`bike evaluate` on superbikes: a rider on machines and circuits."""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from typing import Any, Final

from rich import box
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from bike_analysis.figures.numbers import lap_text
from bike_policy.contract.bundle import DEFAULT_RACER, load_bundle
from bike_training.arguments import check_positive, check_whole, make_folder
from bike_training.commands.declarations import DEFAULT_SUPERBIKE
from bike_training.rollout.races import RaceResult, ride_races
from bike_training.tasks.base import round_robin

CIRCUIT: Final = "barcelona"


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Ride, write ``races.json`` and ``races.csv``, and return the figures; not ok when a ride was not whole.

    Raises:
        ValueError: a wrong argument, or a policy that does not race. FileNotFoundError: an unknown name.
    """
    check_whole("--starts", args.starts, 1)
    check_whole("--laps", args.laps, 1)
    if args.share is not None:
        check_positive("--share", args.share, "")
    bundle = load_bundle(args.rider or DEFAULT_RACER)
    make_folder("--out", args.out)
    pairs = _pairs(*_asked(args), args.in_turn)
    results = [
        ride_races(bundle, machine, circuit, args.starts, args.laps, args.share)
        for machine, circuit in tqdm(pairs, unit="pair", disable=args.json or len(pairs) == 1)
    ]
    found = [result.figures() for result in results]
    figures = {"policy": bundle.name, "races": found}
    (args.out / "races.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    with (args.out / "races.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(found[0]))
        writer.writeheader()
        writer.writerows(found)
    tables = _tables(bundle.name, results) if args.tables else ""
    if tables:
        (args.out / "tables.md").write_text(tables, encoding="utf-8")
    if not args.json:
        Console(width=120).print(_table(bundle.name, found))
        print(tables)
    ok = all(race["whole"] == race["rides"] for race in found)
    return {"schema": "bike.evaluate_races/1", "ok": ok, "figures": figures}


def _asked(args: argparse.Namespace) -> tuple[list[str], list[str]]:
    """Return the machines and the circuits that are asked for."""
    machines, circuits = [DEFAULT_SUPERBIKE], [CIRCUIT]
    if args.tables:
        from bike_training.reproduce.superbike.experiment import CIRCUITS, MACHINES  # late: it loads the presets

        machines, circuits = list(MACHINES), list(CIRCUITS)
    return (args.vehicle.split(",") if args.vehicle else machines), (
        args.course.split(",") if args.course else circuits
    )


def _tables(name: str, results: Sequence[RaceResult]) -> str:
    from bike_training.reproduce.superbike.bundle_tables import bundle_tables  # late: it loads the presets

    return bundle_tables(name, results)


def _pairs(machines: Sequence[str], circuits: Sequence[str], taking_turns: bool) -> list[tuple[str, str]]:
    """Return which machine rides which circuit."""
    if taking_turns:
        return list(zip(round_robin(machines, len(circuits)), circuits, strict=True))
    return [(machine, circuit) for circuit in circuits for machine in machines]


def _table(name: str, found: list[dict[str, Any]]) -> Table:
    table = Table(box=box.SIMPLE, title=f"Races of {name}")
    for column in (
        "machine",
        "circuit",
        "whole",
        "falls",
        "best",
        "median",
        "theory",
        "over it",
        "off line",
        "off track",
    ):
        table.add_column(column, justify="left" if column in ("machine", "circuit") else "right")
    for race in found:
        table.add_row(
            race["vehicle"],
            race["circuit"],
            f"{race['whole']} of {race['rides']}",
            f"{race['falls'] + race['walls']}",
            "-" if race["best_s"] is None else lap_text(race["best_s"]),
            "-" if race["median_s"] is None else lap_text(race["median_s"]),
            lap_text(race["theory_s"]),
            "-" if race["median_excess"] is None else f"{100.0 * race['median_excess']:+.1f} %",
            f"{race['line_distance_m']:.2f} m",
            f"{race['off_track_s']:.1f} s",
        )
    return table
