"""`bike evaluate`: ride a policy at 21 speeds and write down how well."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_policy.riders.learned import LearnedRider
from bike_policy.riders.rider import Rider, make_rider
from bike_sim.course.files import load_course
from bike_sim.sim.config import SimulatorConfig
from bike_training.arguments import check_positive, check_whole, make_folder
from bike_training.envs.clients import CLIENT_KINDS, make_client
from bike_training.rollout.evaluation import PAPER_MAX, PAPER_MEAN, SPEEDS, Ride, draw, evaluate
from bike_training.rollout.riding import ride_through

NODES = "nodes"

EXAMPLES = """examples:
  bike evaluate                                the shipped policy, in process, PyBullet at 1 ms
  bike evaluate runs/a/policy --client nodes   through the simulator node and the policy node
  bike evaluate whipple --course junction --speeds 4
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("policy", nargs="?", default=DEFAULT_POLICY, help="name or folder (default: %(default)s)")
    parser.add_argument(
        "--client",
        choices=[*CLIENT_KINDS, NODES],
        default="local",
        help="local: in this process; ros: simulator node, policy here; nodes: simulator node and policy node",
    )
    parser.add_argument("--engine", choices=["pybullet", "whipple"], default="pybullet")
    parser.add_argument("--time-step", type=float, default=0.001, help="integration step, s (default: %(default)s)")
    parser.add_argument("--course", default="benchmark", help="fixed course (default: %(default)s)")
    parser.add_argument("--speeds", type=float, nargs="+", default=list(SPEEDS), help="m/s (default: 2 to 7 by 0.25)")
    parser.add_argument("--random-rides", type=int, default=1, help="30 s rides on random paths at each speed")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random paths")
    parser.add_argument("--out", type=Path, default=Path("out/evaluate"), help="folder of evaluation.json and .png")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Evaluate and return the figures; not ok when a ride was not completed."""
    for speed in args.speeds:
        check_positive("--speeds", speed, "m/s")
    check_whole("--random-rides", args.random_rides, 0)
    check_whole("--seed", args.seed, 0)
    rider = make_rider(args.policy)
    config = SimulatorConfig(engine=args.engine, time_step=args.time_step)
    if isinstance(rider, LearnedRider):
        rider.bundle.check_fit(config.vehicle, config.control_period)
    load_course(args.course)  # before the nodes start
    make_folder("--out", args.out)
    total = len(args.speeds) * (1 + args.random_rides)
    with _rides(args, rider, config) as ride, tqdm(total=total, unit="ride", desc=rider.name, disable=None) as bar:

        def tick() -> None:
            bar.update()

        figures = evaluate(ride, args.course, args.speeds, args.random_rides, args.seed, tick)
    figures = {
        "policy": rider.name,
        "client": args.client,
        "engine": args.engine,
        "time_step_s": args.time_step,
        **figures,
    }
    (args.out / "evaluation.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    draw(figures, rider.name, args.out / "evaluation.png")
    if not args.json:
        _print(figures, rider.name, args.out)
    ok = all(ride["completed"] for ride in figures["rides"] + figures["random"])
    return {"schema": "bike.evaluate/1", "ok": ok, "figures": figures}


@contextmanager
def _rides(args: argparse.Namespace, rider: Rider, config: SimulatorConfig) -> Iterator[Ride]:
    """Open what rides, and close it."""
    if args.client == NODES:
        from bike_training.nodes.node_rides import NodeRides  # only rides through nodes need ROS

        with NodeRides(args.policy, config) as nodes:
            yield nodes.ride
        return
    client = make_client(args.client, config)
    try:
        yield lambda request, longest: ride_through(client, rider, request, longest)
    finally:
        client.close()


def _print(figures: dict[str, Any], name: str, out: Path) -> None:
    table = Table(title=f"{name}: {figures['course']} and random paths, {figures['engine']}")
    for heading in ("speed m/s", "ridden", "mean m", "max m", "max roll °", "worst section", "random mean m", "max m"):
        table.add_column(heading, justify="right")
    randoms = figures["random"]
    for place, ride in enumerate(figures["rides"]):
        worst = max(ride.get("sections", []), key=lambda part: part["max_m"], default={"section": ""})
        chance = randoms[place] if place < len(randoms) else None
        table.add_row(
            f"{ride['speed_m_s']:.2f}",
            "yes" if ride["completed"] else "NO",
            f"{ride['mean_m']:.3f}",
            f"{ride['max_m']:.3f}",
            f"{ride['max_roll_deg']:.1f}",
            worst["section"],
            f"{chance['mean_m']:.3f}" if chance else "",
            f"{chance['max_m']:.3f}" + ("" if chance["completed"] else " NO") if chance else "",
        )
    console = Console(width=max(100, Console().width))
    console.print(table)
    console.print(
        f"worst mean {figures['worst_mean_m']:.3f} m (paper's best controller {PAPER_MEAN}), "
        f"worst maximum {figures['worst_max_m']:.3f} m ({PAPER_MAX}); written to {out}"
    )
