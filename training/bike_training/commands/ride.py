"""`bike ride` on bicycles: simulator, policy and recorder as processes on their own, one ride, one report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from bike_analysis.report import analyze
from bike_policy.riders.rider import Rider, bundle_of, make_rider
from bike_sim.course.files import load_course
from bike_sim.ros.isolation import DomainLease
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import load_disturbances
from bike_training.arguments import check_positive, check_whole, recording_folder
from bike_training.commands.analyze import text_of
from bike_training.commands.declarations import LARGEST_DOMAIN
from bike_training.rollout.riding import time_for


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Ride, record, analyse; not ok when the ride was not completed."""
    check_positive("--speed", args.speed, "m/s")
    if args.domain is not None:
        check_whole("--domain", args.domain, 0, LARGEST_DOMAIN)
    SimulatorConfig(vehicle=args.vehicle, engine=args.engine, time_step=args.time_step)  # refuses an invalid step
    if args.disturbances is not None:
        load_disturbances(args.disturbances)
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
    return ride_recorded(
        domain, record, simulator | disturbed, drive, title=title, way=length, longest=longest, needed=needed
    )
