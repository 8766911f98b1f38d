"""`bike ride`: simulator, policy and recorder as processes on their own, one ride, one report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

from bike_analysis.commands.analyze import text_of
from bike_analysis.report import analyze
from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_policy.riders.making import bundle_of, make_rider
from bike_policy.riders.rider import Rider
from bike_sim.course.files import load_course
from bike_sim.recording.in_use import claim_folder
from bike_sim.ros.isolation import DomainLease
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import load_disturbances, shipped_disturbances
from bike_training.arguments import check_positive, check_whole, make_folder
from bike_training.rollout.riding import time_for

LARGEST_DOMAIN: Final = 232
"""ROS domain with the largest ports that there are."""

EXAMPLES = """examples:
  bike ride                                   the benchmark path at 4 m/s with the shipped policy
  bike ride --speed 6.5 --course junction --out out/junction
  bike ride --disturbances wind               in the wind, which the recording keeps for bike replay
  bike ride --real-time                       at the pace of the clock, to watch it in Foxglove or RViz
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--policy", default=DEFAULT_POLICY, help="name or folder of a policy (default: %(default)s)")
    parser.add_argument("--course", default="benchmark", help="name or file of a course (default: %(default)s)")
    parser.add_argument("--speed", type=float, default=4.0, help="forward speed, m/s (default: %(default)s)")
    parser.add_argument("--engine", choices=["pybullet", "whipple"], default="pybullet")
    parser.add_argument("--time-step", type=float, default=0.001, help="integration step, s (default: %(default)s)")
    parser.add_argument(
        "--disturbances", metavar="FILE", help=f"a YAML file, or {', '.join(shipped_disturbances())}; also recorded"
    )
    parser.add_argument(
        "--real-time", action="store_true", help="ride at the pace of the clock, not as fast as it goes"
    )
    parser.add_argument("--domain", type=int, help="ROS domain (default: a free one, so that rides do not meet)")
    parser.add_argument("--out", type=Path, default=Path("out/ride"), help="folder of recording and report")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Ride, record, analyse; not ok when the ride was not completed."""
    check_positive("--speed", args.speed, "m/s")
    if args.domain is not None:
        check_whole("--domain", args.domain, 0, LARGEST_DOMAIN)
    SimulatorConfig(engine=args.engine, time_step=args.time_step)  # refuses an invalid step
    if args.disturbances is not None:
        load_disturbances(args.disturbances)
    rider = make_rider(args.policy)
    warn_of_speed(rider, args.speed)
    course = load_course(args.course)
    longest = time_for(course, args.speed)
    make_folder("--out", args.out)
    recording = args.out / "ride.mcap"
    with claim_folder(args.out):
        if args.domain is None:
            with DomainLease() as lease:
                wall = _ride(args, lease.domain_id, recording, course.length, longest)
        else:
            wall = _ride(args, args.domain, recording, course.length, longest)
        figures = analyze(recording, args.out) | {"wall_s": round(wall, 2), "policy": rider.name}
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
        "course": args.course,
        "speed": args.speed,
        "engine": args.engine,
        "time_step": args.time_step,
        "mode": "free" if args.real_time else "lockstep",
        "auto_reset": "never",
    }
    disturbed = {} if args.disturbances is None else {"disturbances": args.disturbances}
    # By its full path, so that the note serves from anywhere; shipped policies by name.
    policy = str(Path(args.policy).resolve()) if Path(args.policy).is_dir() else args.policy
    record = {"path": str(recording.resolve()), "overwrite": True, "notes": [f"policy={policy}"]}
    from bike_training.nodes.ride_monitor import NEEDED_TOPICS, ride_recorded  # only rides through nodes need ROS

    needed = (*NEEDED_TOPICS, *disturbed)
    title = f"{args.course} at {args.speed:g} m/s"
    drive = {"policy": args.policy, **disturbed}
    return ride_recorded(
        domain, record, simulator | disturbed, drive, title=title, way=length, longest=longest, needed=needed
    )
