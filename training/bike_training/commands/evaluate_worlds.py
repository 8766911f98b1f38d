"""`bike evaluate --worlds`: a rider of superbikes in unknown worlds, beside the oracle."""

from __future__ import annotations

import argparse
import csv
import hashlib
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from bike_analysis.figures.cells import table_text
from bike_policy.contract.bundle import DEFAULT_RACER, Bundle, load_bundle
from bike_policy.planning.plan_verification import sources_digest
from bike_policy.riders.classical import SETTINGS
from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.sim.worlds import WorldRide, load_rides
from bike_training.arguments import make_folder
from bike_training.commands.declarations import SUPERBIKE
from bike_training.progress import progress_bar
from bike_training.rollout.worlds import (
    LAPS,
    ORACLE,
    read_records,
    record_of,
    ride_told,
    ride_worlds,
    summary,
    untold,
)

ORACLE_NAME: Final = "oracle"
ALONE: Final = ("vehicle", "course", "disturbances", "in_turn", "share", "engine", "time_step")
"""Options that the worlds decide."""
Records = list[dict[str, Any]]


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Ride worlds and write ``worlds.csv`` and ``worlds.json``; rides that the folder holds already are not repeated.

    Raises:
        ValueError: a wrong argument, or a policy that does not race. FileNotFoundError: an unknown name.
    """
    given = [name for name in ALONE if (value := getattr(args, name, None)) and value != SUPERBIKE_ENGINE]
    if given:
        raise ValueError(f"--worlds decides what --{given[0].replace('_', '-')} would: leave that out")
    rides = load_rides(args.worlds)
    rider = args.rider or DEFAULT_RACER
    bundle = load_bundle(rider) if args.subject == SUPERBIKE else None
    if bundle is not None and args.hold is not None:
        bundle = bundle.holding(args.hold)
    name = ORACLE_NAME if getattr(args, "oracle", False) else rider if bundle is None else bundle.name
    laps = max(LAPS, args.laps)
    make_folder("--out", args.out)
    records = _ridden(rides, bundle, name, laps, args.out / "worlds.csv", args.json)
    oracle = records if name == ORACLE_NAME else read_records(ORACLE) if ORACLE.is_file() else []
    found = summary(records, oracle)
    figures = {"policy": name, "laps": laps, "summary": found, "worlds": records}
    (args.out / "worlds.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    if not args.json:
        print(f"Unknown worlds, {name}")
        print("\n".join(table_text(COLUMNS, [{"kind": kind} | _texts(each) for kind, each in found.items()])))
        print(f"written to {args.out}")
    # Worlds are there to find out what a rider bears, so falls in them are no failure of the command.
    return {"schema": "bike.evaluate_worlds/1", "ok": True, "figures": figures}


def _ridden(
    rides: Sequence[WorldRide], bundle: Bundle | None, name: str, laps: int, path: Path, quiet: bool
) -> Records:
    """Return the records of all rides in their order, and write each machine's as soon as they are ridden."""
    actor = b"" if bundle is None else bundle.actor.digest() + repr((bundle.layout, bundle.action)).encode()
    key = f"# {name} {hashlib.sha256(sources_digest() + actor + repr(laps).encode()).hexdigest()[:16]}"
    known: dict[tuple[str, int], dict[str, Any]] = {}
    if path.is_file() and path.read_text(encoding="utf-8").startswith(f"{key}\n"):
        known = {(row["world"], row["start"]): row for row in read_records(path)}
    waiting = sorted((ride for ride in rides if ride.key not in known), key=lambda ride: ride.vehicle)
    with progress_bar(f"{name}, worlds", "world", len(rides), quiet=quiet) as bar:
        bar.update(len(rides) - len(waiting))
        for _, group in itertools.groupby(waiting, key=lambda ride: ride.vehicle):
            same, begun = list(group), bar.n

            def report(done: int, begun: int = begun) -> None:
                bar.update(begun + done - bar.n)

            if name == ORACLE_NAME:
                ridden = ride_told(same, laps, report)
            else:
                ridden = ride_worlds(same, untold(bundle or SETTINGS[name]), laps, report)
            known |= {ride.key: record_of(ride, each) for ride, each in zip(same, ridden, strict=True)}
            _write(path, key, [known[ride.key] for ride in rides if ride.key in known])
    return [known[ride.key] for ride in rides]


def _write(path: Path, key: str, records: Records) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(f"{key}\n")
        writer = csv.DictWriter(file, list(records[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)


def _texts(figures: dict[str, Any]) -> dict[str, Any]:
    """Return figures with the causes as one text."""
    causes = ", ".join(f"{cause} {count}" for cause, count in figures["causes"].items())
    return figures | {"causes": causes or "-"}


COLUMNS: Final = {
    "worlds": "{kind}", "count": "{counted} of {rides}", "whole": "{whole}", "share": "{share:.1%}",
    "95 %": "{share_low:.1%} to {share_high:.1%}",
    "lost in the first lap": "{lost_first}", "compared": "{compared}", "over the oracle": "{excess:+.2%}",
    "95 % ": "{excess_low:+.2%} to {excess_high:+.2%}", "lost": "{causes}",
}  # fmt: skip
"""Columns of the table of worlds."""
