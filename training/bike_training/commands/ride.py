"""`bike ride`: a bicycle through its nodes, or laps of superbikes beside the theoretical ones; recording and report."""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from bike_analysis.figures.cells import table_text
from bike_analysis.figures.circuit import Machine, Theory
from bike_analysis.figures.numbers import lap_text
from bike_analysis.report import analyze, analyze_laps
from bike_policy.riders.base import Rider, bundle_of
from bike_policy.riders.rider import make_rider
from bike_sim.course.files import load_course, shipped_tracks
from bike_sim.physics.engines import check_superbike_engine
from bike_sim.planning.envelope import Envelope, envelope
from bike_sim.planning.lap_limit import lap_limit
from bike_sim.planning.line_cache import track_with_line
from bike_sim.ros.isolation import DomainLease
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.plant import ridden_superbike
from bike_sim.sim.snapshot import Snapshot
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle, shipped_superbikes
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, check_whole, recording_folder
from bike_training.commands.analyze import text_of
from bike_training.commands.declarations import LARGEST_DOMAIN
from bike_training.progress import progress_bar
from bike_training.rollout.laps import ALLOWED_EXCESS, ride_laps
from bike_training.rollout.rollout import time_for


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Ride, record, analyse; not ok when the ride was not completed."""
    check_positive("--speed", args.speed, "m/s")
    if args.domain is not None:
        check_whole("--domain", args.domain, 0, LARGEST_DOMAIN)
    SimulatorConfig(vehicle=args.vehicle, engine=args.engine, time_step=args.time_step)  # refuses an invalid step
    _disturbances(args.disturbances, load_vehicle(args.vehicle))
    rider = make_rider(args.rider)
    warn_of_speed(rider, args.speed)
    course = load_course(args.course)
    longest = time_for(course, args.speed)
    with recording_folder(args.out, "ride", args.overwrite) as out:
        recording = out / "ride.mcap"
        if args.domain is None:
            with DomainLease() as lease:
                wall = _ride(args, lease.domain_id, recording, course.length, longest)
        else:
            wall = _ride(args, args.domain, recording, course.length, longest)
        figures = analyze(recording, out) | {"wall_s": round(wall, 2), "policy": rider.name}
    if not args.json:
        print(text_of(figures))
        print(f"recording: {recording}")
    completed = bool(figures["rides"]) and all(ride["completed"] for ride in figures["rides"])
    return {"schema": "bike.ride/1", "ok": completed, "figures": figures}


def warn_of_speed(rider: Rider, speed: float) -> None:
    """Print a warning where a learned rider was not trained for a speed, m/s."""
    bundle = bundle_of(rider)
    warning = None if bundle is None else bundle.speed_warning(speed)
    if warning is not None:
        print(f"warning: {warning}", file=sys.stderr)


def _ride(args: argparse.Namespace, domain: int, recording: Path, length: float, longest: float) -> float:
    """Start the nodes, wait for the end of the ride, stop them; return the wall-clock time of the ride, s."""
    simulator = {
        "vehicle": args.vehicle,
        "course": args.course,
        "speed": args.speed,
        "engine": args.engine,
        "time_step": args.time_step,
        "mode": "free" if args.real_time else "lockstep",
        "auto_reset": "never",
    }
    disturbed = {} if args.disturbances is None else {"disturbances": args.disturbances}
    # By its full path, so that the note serves from anywhere; shipped policies by name.
    policy = str(Path(args.rider).resolve()) if Path(args.rider).is_dir() else args.rider
    record = {"path": str(recording.resolve()), "overwrite": True, "notes": [f"policy={policy}"]}
    from bike_training.nodes.node_rides import NEEDED_TOPICS, ride_recorded  # only rides through nodes need ROS

    needed = (*NEEDED_TOPICS, *disturbed)
    title = f"{args.course} at {args.speed:g} m/s"
    drive = {"policy": args.rider, **disturbed}
    if args.vehicle.endswith((".yaml", ".yml")):
        drive["vehicle"] = args.vehicle
    parameters = {"record": record, "sim_node": simulator | disturbed, "drive": drive}
    return ride_recorded(domain, parameters, title=title, distance=length, longest=longest, needed=needed)


LAP_SCHEMA: Final = "bike.ride_laps/1"
PAIRS: Final = {
    "machine": "{vehicle}", "circuit": "{course}", "end": "{end}", "best lap": "{lap_s!l}",
    "theoretical": "{limit_s!l}", "slowest over it": "{excess:+.1%}", "closest": "{closest_limit_s!l}",
    "over it": "{closest_excess:+.1%}", "laps": "{laps}", "valid": "{valid_laps}",
    "most off line": "{line_error_max_m:.2f} m",
}  # fmt: skip
"""Columns of the table of laps."""
GG_POINTS: Final = 25
"""Points of each half of a curve of the g-g diagram."""


def run_laps(args: argparse.Namespace) -> dict[str, Any]:
    """Ride in this process, print a table unless `args.json`, and return the figures.

    Raises:
        ValueError: a broken file.
        FileNotFoundError: an unknown vehicle or circuit.
    """
    check_whole("--laps", args.laps, 1)
    pairs = [(args.vehicle, args.course)]
    if args.all:
        pairs = list(itertools.product(shipped_superbikes(), shipped_tracks()))
    found = [_lap_figures(vehicle, circuit, args) for vehicle, circuit in pairs]
    if not args.json:
        print(f"Flying laps, rider: {found[0]['rider']}")
        print("\n".join(table_text(PAIRS, found, left=3)))
    return {"schema": LAP_SCHEMA, "ok": all(pair["ok"] for pair in found), "figures": {"pairs": found}}


def run_through_nodes(args: argparse.Namespace) -> dict[str, Any]:
    """Ride through the nodes, write the report, print the times unless `args.json`, and return the figures.

    Raises:
        ValueError: a broken file, or two riders to be compared of whom one finished no flying lap.
        FileNotFoundError: an unknown vehicle or circuit.
        NodeLost: a node ended.
    """
    check_whole("--laps", args.laps, 1)
    with recording_folder(args.out, "lap", args.overwrite) as args.out:
        return _through_nodes(args)


def _through_nodes(args: argparse.Namespace) -> dict[str, Any]:
    from bike_training.nodes.node_rides import ride_through_nodes  # only rides through nodes need ROS

    machine = load_vehicle(args.vehicle)
    assert isinstance(machine, Superbike)
    disturbances = _disturbances(args.disturbances, machine)
    limits = envelope(machine)
    track = track_with_line(args.course, limits)
    line = track.line(1.0)
    limit = lap_limit(limits, line)
    times = (limit.lap_time, limit.sector_times)
    theory = Theory(track, limit.s, limit.speed, limit.lateral, limit.longitudinal, *times, described(machine, limits))

    def ride(name: str, rider: str) -> tuple[Path, float]:
        recording = args.out / f"{name}.mcap"
        wall = ride_through_nodes(
            args.vehicle,
            args.course,
            line.length,
            args.laps,
            recording,
            limit.lap_time,
            rider,
            args.disturbances,
        )
        return recording, wall

    recording, wall = ride("lap", args.rider)
    figures = analyze_laps(recording, theory, args.out)
    figures |= {"wall_s": round(wall, 1), "recording": str(recording)}
    riders = args.beside or ()
    others = [ride(f"beside{number}" if number else "beside", rider)[0] for number, rider in enumerate(riders)]
    if others:
        found = [analyze_laps(other, theory) for other in others]
        for who, laps in ((args.rider, figures), *zip(riders, found, strict=True)):
            if laps["lap_s"] is None:
                raise ValueError(f"rider {who!r} finished no flying lap; there is nothing to compare")
        gained = [
            [theirs - own for own, theirs in zip(figures["sectors_s"], laps["sectors_s"], strict=True)]
            for laps in found
        ]
        figures |= {"beside_laps_s": [laps["lap_s"] for laps in found], "sectors_gained_s": gained}
        figures["comparison"] = analyze([recording, *others], args.out)["page"]
    excess = figures["excess"]
    clean = figures["falls"] == 0 and figures["walls"] == 0 and len(figures["laps_s"]) >= args.laps
    figures["ok"] = bool(clean and excess is not None and (disturbances is not None or excess <= ALLOWED_EXCESS))
    if not args.json:
        for number, lap in enumerate(figures["laps_s"], start=2):  # the out-lap is lap 1, as in the events
            print(f"lap {number}: {lap_text(lap)}")
        if others:
            beside = zip(riders, map(lap_text, figures["beside_laps_s"]), strict=True)
            print(f"best lap: {lap_text(figures['lap_s'])}" + "".join(f", {who}'s: {lap}" for who, lap in beside))
            print(f"where each is faster: {figures['comparison']}")
        print(f"theoretical lap: {lap_text(limit.lap_time)}")
        print(f"report: {figures['page']}")
    return {"schema": LAP_SCHEMA, "ok": figures["ok"], "figures": figures}


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


def _disturbances(name: str | None, vehicle: Vehicle) -> Disturbances | None:
    """Load disturbances by name, and refuse those that a vehicle cannot have before anything starts.

    Raises:
        ValueError: of another kind of vehicle. FileNotFoundError: there are none of that name.
    """
    if name is None:
        return None
    known = load_disturbances(name)
    known.check_sensors(vehicle)
    if isinstance(vehicle, Superbike):
        ridden_superbike(vehicle, known)
    return known


def _lap_figures(vehicle: str, circuit: str, args: argparse.Namespace) -> dict[str, Any]:
    disturbances = _disturbances(args.disturbances, load_vehicle(vehicle))
    began, laps, rider = time.monotonic(), args.laps, make_rider(args.rider)
    check_superbike_engine(args.engine, load_vehicle(vehicle))
    with progress_bar(f"{vehicle}, {circuit}", "m", quiet=args.json, leave=False) as bar:

        def report(snapshot: Snapshot, length: float) -> None:
            if snapshot.step % 50:
                return
            bar.total = round(length * (laps + 1))
            bar.set_postfix_str(f"{snapshot.speed:.0f} m/s, {math.degrees(snapshot.state[3]):+.0f}°", refresh=False)
            bar.update(round(snapshot.progress) - bar.n)

        figures, _ = ride_laps(
            vehicle, circuit, laps, rider=rider, engine=args.engine, disturbances=disturbances, report=report
        )
    return figures | {"wall_s": round(time.monotonic() - began, 1)}
