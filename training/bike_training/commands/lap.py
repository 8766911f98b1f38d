"""`bike lap`: a rider laps circuits on superbikes, compared with the theoretical laps."""

from __future__ import annotations

import argparse
import itertools
import math
import time
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bike_analysis.figures.lap_recording import LapRecording, Machine, Theory, load_laps
from bike_analysis.figures.numbers import lap_text
from bike_analysis.page.lap_page import lap_figures, write_lap_report
from bike_analysis.report import analyze
from bike_policy.contract.bundle import DEFAULT_RACER
from bike_policy.riders.classical import CLASSICAL
from bike_policy.riders.making import make_rider
from bike_policy.riders.rider import Rider
from bike_sim.course.files import shipped_tracks
from bike_sim.physics.engine import SUPERBIKE_ENGINES
from bike_sim.planning.envelope import Envelope, envelope
from bike_sim.planning.lap_limit import LapLimit, lap_limit
from bike_sim.planning.line_cache import track_with_line
from bike_sim.recording.in_use import claim_folder
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.files import load_vehicle, shipped_vehicles
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_whole, make_folder
from bike_training.progress import distance_progress_bar
from bike_training.rollout.laps import ALLOWED_EXCESS, pair_figures, ride_laps

SCHEMA: Final = "bike.lap/1"
LEARNED: Final = "learned"
"""Stands for the shipped policy that races."""

TABLE_WIDTH: Final = 130
GG_POINTS: Final = 25
"""Points of each half of a curve of the g-g diagram."""

_EXAMPLES: Final = """examples:
  bike lap                                                     the Panigale V4 R, three flying laps of Barcelona
  bike lap --vehicle r1 --course monza.csv --laps 1            a circuit from a CSV file
  bike lap --nodes --out out/lap                               through the nodes: lap.mcap and the report lap.html
  bike lap --rider runs/r/policy                               a learned rider
  bike lap --nodes --rider racer --beside classical            both through the nodes, and where each is faster
  bike lap --all --json                                        all machines on all circuits, as one JSON object

The first lap, from a rolling start, is not counted. Lines once computed are kept in $BIKE_CACHE, else ~/.cache/bike."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EXAMPLES
    parser.add_argument("--vehicle", default="panigale_v4r", help="superbike or YAML file (default: %(default)s)")
    parser.add_argument("--course", default="barcelona", help="circuit, YAML or CSV file (default: %(default)s)")
    parser.add_argument("--laps", type=int, default=3, help="flying laps (default: %(default)s)")
    parser.add_argument(
        "--rider",
        default=CLASSICAL,
        help=f"{CLASSICAL}, {LEARNED} (the shipped {DEFAULT_RACER}), a shipped policy that races, or the folder of one "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--engine", choices=SUPERBIKE_ENGINES, default=SUPERBIKE_ENGINES[0], help="in process (default: %(default)s)"
    )
    parser.add_argument(
        "--nodes", action="store_true", help="through simulator, policy and recorder nodes, with recording and report"
    )
    parser.add_argument(
        "--beside", metavar="RIDER", help="with --nodes: who laps as well, to be compared by arc length in ride.html"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/lap"), help="with --nodes: folder of recording and report (%(default)s)"
    )
    parser.add_argument("--all", action="store_true", help="all shipped superbikes on all shipped circuits")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Ride, print a table unless `args.json`, and return the figures.

    Raises:
        ValueError: a broken file. FileNotFoundError: an unknown vehicle or circuit.
    """
    check_whole("--laps", args.laps, 1)
    args.rider, args.beside = (DEFAULT_RACER if name == LEARNED else name for name in (args.rider, args.beside))
    if args.beside is not None and not args.nodes:
        raise ValueError(f"--beside {args.beside} compares recordings, which only --nodes makes")
    if args.nodes:
        if args.all:
            raise ValueError("--nodes rides one machine on one circuit; leave --all out")
        if args.engine != SUPERBIKE_ENGINES[0]:
            raise ValueError(f"--nodes rides in {SUPERBIKE_ENGINES[0]}; leave --engine {args.engine} out")
        make_folder("--out", args.out)
        with claim_folder(args.out):
            return _through_nodes(args)
    pairs = [(args.vehicle, args.course)]
    if args.all:
        pairs = list(itertools.product(shipped_superbikes(), shipped_tracks()))
    found = []
    for vehicle, circuit in pairs:
        found.append(_ride(vehicle, circuit, args, make_rider(args.rider)))
    figures = {"pairs": found}
    if not args.json:
        console = Console()
        console.width = max(console.width, TABLE_WIDTH)
        console.print(_table(found))
    return {"schema": SCHEMA, "ok": all(pair["ok"] for pair in found), "figures": figures, "pairs": found}


def _through_nodes(args: argparse.Namespace) -> dict[str, Any]:
    """Ride through the nodes, write the report, print the times unless `args.json`, and return the figures."""
    from bike_training.nodes.node_laps import ride_through_nodes  # only rides through nodes need ROS

    recording = args.out / "lap.mcap"
    machine = load_vehicle(args.vehicle)
    if not isinstance(machine, Superbike):
        raise ValueError(f"vehicle '{args.vehicle}' is no superbike")
    limits = envelope(machine)
    track = track_with_line(args.course, limits)
    line = track.line(1.0)
    limit = lap_limit(limits, line)
    wall = ride_through_nodes(args.vehicle, args.course, line.length, args.laps, recording, limit.lap_time, args.rider)
    other = args.out / "beside.mcap"
    if args.beside is not None:
        ride_through_nodes(args.vehicle, args.course, line.length, args.laps, other, limit.lap_time, args.beside)
    laps = load_laps(recording, track)
    theory = theory_of(machine, limits, limit)
    figures = lap_figures(laps, theory) | {"wall_s": round(wall, 1), "recording": str(recording)}
    figures["page"] = str(write_lap_report(laps, theory, args.out))
    if args.beside is not None:
        figures |= _beside(load_laps(other, track), theory, figures, analyze([recording, other], args.out))
    excess = figures["excess"]
    clean = figures["falls"] == 0 and figures["walls"] == 0 and len(figures["laps_s"]) >= args.laps
    figures["ok"] = bool(clean and excess is not None and excess <= ALLOWED_EXCESS and figures["timing_agrees"])
    if not args.json:
        for number, lap in enumerate(figures["laps_s"], start=2):  # the out-lap is lap 1, as in the events
            print(f"lap {number}: {lap_text(lap)}")
        if args.beside is not None:
            print(f"best lap: {lap_text(figures['lap_s'])}, {args.beside}'s: {lap_text(figures['beside_lap_s'])}")
            print(f"where each is faster: {figures['comparison']}")
        print(f"theoretical lap: {lap_text(limit.lap_time)}")
        print(f"timing of the recording equals the events: {'yes' if figures['timing_agrees'] else 'no'}")
        print(f"report: {figures['page']}")
    return {"schema": SCHEMA, "ok": figures["ok"], "figures": figures}


def _beside(laps: LapRecording, theory: Theory, figures: dict[str, Any], analysis: dict[str, Any]) -> dict[str, Any]:
    """Return what the other rider's laps were, by sectors as well, and where both are compared.

    Raises:
        ValueError: one of the two finished no flying lap.
    """
    other = lap_figures(laps, theory)
    for who, found in (("the rider", figures), ("who rides beside", other)):
        if found["lap_s"] is None:
            raise ValueError(f"{who} finished no flying lap; there is nothing to compare")
    gained = [theirs - own for own, theirs in zip(figures["sectors_s"], other["sectors_s"], strict=True)]
    return {"beside_lap_s": other["lap_s"], "sectors_gained_s": gained, "comparison": analysis["page"]}


def theory_of(machine: Superbike, limits: Envelope, limit: LapLimit) -> Theory:
    """Return a theoretical lap with what its machine can do, for a report."""
    times = (limit.lap_time, limit.sector_times)
    return Theory(limit.s, limit.speed, limit.lateral, limit.longitudinal, *times, described(machine, limits))


def described(machine: Superbike, limits: Envelope) -> Machine:
    """Return limits and gears of a machine, for reading its telemetry."""
    share = np.sin(np.linspace(-0.5 * np.pi, 0.5 * np.pi, GG_POINTS))  # denser where the curve is steep
    lateral = limits.lateral_max[:, None] * share
    speeds = limits.speeds[:, None]
    drive, brake = limits.drive(speeds, lateral), -limits.brake(speeds, lateral)
    spins = np.asarray(machine.wheel_torque_spacing * np.arange(len(machine.wheel_gear)), dtype=np.float64)
    return Machine(
        limits.speeds,
        np.hstack([lateral, lateral[:, ::-1], lateral[:, :1]]),
        np.hstack([drive, brake[:, ::-1], drive[:, :1]]),
        spins,
        machine.wheel_gear,
        machine.motor.ratios(),
    )


def shipped_superbikes() -> tuple[str, ...]:
    """Return the names of the superbikes that come with the package."""
    return tuple(name for name in shipped_vehicles() if isinstance(load_vehicle(name), Superbike))


def _ride(vehicle: str, circuit: str, args: argparse.Namespace, rider: Rider) -> dict[str, Any]:
    began, laps = time.monotonic(), args.laps
    with distance_progress_bar(f"{vehicle}, {circuit}", quiet=args.json, leave=False) as bar:

        def tell(snapshot: Snapshot, length: float) -> None:
            if snapshot.step % 50:
                return
            bar.total = round(length * (laps + 1))
            bar.set_postfix_str(f"{snapshot.speed:.0f} m/s, {math.degrees(snapshot.state[3]):+.0f}°", refresh=False)
            bar.update(round(snapshot.progress) - bar.n)

        ride = ride_laps(vehicle, circuit, laps, rider=rider, engine=args.engine, tell=tell)
    return pair_figures(ride, laps) | {"wall_s": round(time.monotonic() - began, 1)}


def _table(found: list[dict[str, Any]]) -> Table:
    table = Table(box=box.SIMPLE, title=f"Flying laps, rider: {found[0]['rider']}")
    columns = (
        "machine", "circuit", "best lap", "theoretical", "slowest over it", "closest", "over it", "laps", "valid",
        "off line", "end",
    )  # fmt: skip
    for name in columns:
        table.add_column(name, justify="left" if name in ("machine", "circuit", "end") else "right")
    for pair in found:
        table.add_row(
            pair["vehicle"],
            pair["course"],
            "-" if pair["lap_s"] is None else lap_text(pair["lap_s"]),
            lap_text(pair["limit_s"]),
            _percent(pair["excess"]),
            lap_text(pair["closest_limit_s"]),
            _percent(pair["closest_excess"]),
            f"{pair['laps']}",
            f"{pair['valid_laps']}",
            f"{pair['line_error_max_m']:.2f} m",
            pair["end"] if pair["ok"] else f"[red]{pair['end']}[/red]",
        )
    return table


def _percent(part: float | None) -> str:
    return "-" if part is None else f"{100.0 * part:+.1f} %"
