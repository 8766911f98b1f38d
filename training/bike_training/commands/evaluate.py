"""`bike evaluate`: a policy of bicycles at 21 speeds, a rider of superbikes from starts around circuits."""

from __future__ import annotations

import argparse
import csv
import itertools
import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any, Final

import numpy as np

from bike_analysis.figures.cells import lines_of, table_text
from bike_policy.contract.bundle import DEFAULT_RACER, load_bundle
from bike_policy.riders.base import Rider, bundle_of
from bike_policy.riders.classical import SETTINGS
from bike_policy.riders.disturbed import DisturbedRider
from bike_policy.riders.instruments import Instruments
from bike_policy.riders.rider import default_name, make_rider
from bike_sim.course.files import load_course
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.plant import ridden_superbike
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.worlds import load_disturbances
from bike_sim.vehicles.files import load_superbike, load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, check_whole, make_folder
from bike_training.commands import evaluate_worlds
from bike_training.commands.declarations import DEFAULT_SUPERBIKE, SUPERBIKE
from bike_training.envs.clients import make_client
from bike_training.progress import progress_bar, setter
from bike_training.rollout.evaluation import PAPER_MAX, PAPER_MEAN, SPEEDS, draw, evaluate
from bike_training.rollout.races import ride_races
from bike_training.rollout.rollout import RideResult, ride_through
from bike_training.rollout.stability import stability
from bike_training.tasks.base import round_robin


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Evaluate and return the figures; not ok when a ride was not completed."""
    args.speeds = args.speeds or list(SPEEDS)
    for speed in args.speeds:
        check_positive("--speeds", speed, "m/s")
    check_whole("--random-rides", args.random_rides, 0)
    check_whole("--seed", args.seed, 0)
    names = args.compare or [args.rider or default_name(load_vehicle(args.vehicle))]
    riders = [make_rider(name) for name in names]
    config = SimulatorConfig(vehicle=args.vehicle, engine=args.engine, time_step=args.time_step)
    for rider in riders:
        bundle = bundle_of(rider)
        if bundle is not None:
            bundle.check_fit(config.vehicle, config.control_period)
    disturbances = [load_disturbances(name) for name in args.disturbances]
    if disturbances and args.client != "local":
        raise ValueError(f"--disturbances act on rides in this process, not with --client {args.client}")
    load_course(args.course)  # before a node starts
    make_folder("--out", args.out)
    found = [_evaluate(args, rider, config, disturbances) for rider in riders]
    figures: dict[str, Any] = {"riders": found} if args.compare else found[0]
    (args.out / "evaluation.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    if not args.compare:
        draw(figures, riders[0].name, args.out / "evaluation.png")
    if not args.json:
        if not args.compare:
            _print_rides(figures)
        _print_comparison(found)
        print(f"written to {args.out}")
    # Disturbances are there to find out what a rider bears, so falls under them are no failure of the command.
    ok = all(ride["completed"] for each in found for ride in each["rides"] + each["random"])
    return {"schema": "bike.evaluate/1", "ok": ok, "figures": figures}


def _evaluate(
    args: argparse.Namespace, rider: Rider, config: SimulatorConfig, disturbances: Sequence[Disturbances]
) -> dict[str, Any]:
    """Return the figures of one rider."""
    total = len(args.speeds) * (1 + args.random_rides)
    times: list[float] = []

    def ride(request: ResetRequest, longest: float) -> RideResult:
        return ride_through(client, rider, request, longest, times)

    with (
        closing(make_client(args.client, config)) as client,
        progress_bar(rider.name, "ride", total, quiet=args.json) as bar,
    ):
        figures = evaluate(ride, args.course, args.speeds, args.random_rides, args.seed, bar.update)
    answers = 1e3 * np.percentile(times, (50.0, 99.0)) if times else ()
    return {
        "policy": rider.name,
        "client": args.client,
        "engine": args.engine,
        "time_step_s": args.time_step,
        **dict(zip(("answer_median_ms", "answer_p99_ms"), map(float, answers), strict=False)),
        **figures,
        **stability(rider),
        "disturbed": [_disturbed(args, rider, config, known) for known in disturbances],
    }


def _disturbed(
    args: argparse.Namespace, rider: Rider, config: SimulatorConfig, disturbances: Disturbances
) -> dict[str, Any]:
    """Return the figures of rides on the course under disturbances."""
    disturbances = replace(disturbances, seed=disturbances.seed + args.seed)
    client, between = Simulator(config, disturbances), DisturbedRider(rider, disturbances)
    try:
        figures = evaluate(
            lambda request, longest: ride_through(client, between, request, longest), args.course, args.speeds, 0
        )
    finally:
        client.close()
    return {"disturbances": disturbances.name, **figures}


COMPARED: Final[Mapping[str, str]] = {
    "completed_count": "rides completed on the course",
    "average_mean_m": "mean of the mean distances, m",
    "worst_mean_m": f"largest mean distance, m (paper's best controller: {PAPER_MEAN})",
    "worst_max_m": f"largest distance, m (paper's best controller: {PAPER_MAX})",
    "average_steer_rate_deg_s": "steer rate, RMS, °/s",
    "random_completed_count": "random rides completed",
    "random_average_mean_m": "mean of their mean distances, m",
    "random_worst_max_m": "largest distance in them, m",
    "worst_spectral_radius_upright": "spectral radius, upright, worst of 2 to 7 m/s",
    "worst_spectral_radius_turn": "spectral radius, turn of 20 m radius",
    "worst_swing_deg": "set value left swinging on a straight, °",
    "answer_median_ms": "answer, median, ms",
    "answer_p99_ms": "answer, 99th percentile, ms",
}
"""Figures of a comparison, with their headings."""
DISTURBED: Final = "{completed_count} of {rides_count}; {average_mean_m:.3f}, {worst_max_m:.3f}"


def _print_comparison(found: Sequence[Mapping[str, Any]]) -> None:
    """Print riders side by side."""
    first = found[0]
    rows = [
        [heading, *("-" if (cell := each.get(key)) is None else f"{cell:.4g}" for each in found)]
        for key, heading in COMPARED.items()
        if any(each.get(key) is not None for each in found)
    ]
    for place, known in enumerate(first["disturbed"]):
        heading = f"{known['disturbances']}: rides completed; mean of the mean distances, largest distance, m"
        rows.append([heading, *(DISTURBED.format(**of["disturbed"][place]) for of in found)])
    print(f"{first['course']} at {first['rides_count']} speeds and random paths, {first['engine']}")
    print("\n".join(lines_of([["figure", *(each["policy"] for each in found)], *rows])))


RIDES: Final = {
    "speed m/s": "{speed_m_s:.2f}", "ridden": "{completed}", "mean m": "{mean_m:.3f}", "max m": "{max_m:.3f}",
    "max roll °": "{max_roll_deg:.1f}", "worst section": "{section}", "random": "{random_completed}",
    "its mean m": "{random_mean_m:.3f}", "its max m": "{random_max_m:.3f}",
}  # fmt: skip
"""Columns of rides on the course and of those on random paths at the same speeds."""


def _print_rides(figures: dict[str, Any]) -> None:
    rows = []
    for ride, chance in itertools.zip_longest(figures["rides"], figures["random"][: len(figures["rides"])]):
        section = max(ride.get("sections", []), key=lambda part: part["max_m"], default={"section": ""})["section"]
        chance = chance or dict.fromkeys(("mean_m", "max_m", "completed"))
        beside = {f"random_{key}": value for key, value in chance.items()}
        rows.append({**ride, **beside, "section": section})
        for name in ("completed", "random_completed"):
            rows[-1][name] = {True: "yes", False: "NO", None: None}[rows[-1][name]]
    print("\n".join(table_text(RIDES, rows, left=0)))


CIRCUIT: Final = "barcelona"
LISTED_LOST: Final = 20
"""Lost rides that are printed."""


def run_races(args: argparse.Namespace) -> dict[str, Any]:
    """Ride, write ``races.json`` and ``races.csv``, and return the figures; not ok when a ride was not whole.

    Raises:
        ValueError: a wrong argument, or a policy that does not race. FileNotFoundError: an unknown name.
    """
    check_whole("--starts", args.starts, 1)
    check_whole("--laps", args.laps, 1)
    if args.worlds:
        return evaluate_worlds.run(args)
    if getattr(args, "oracle", False):
        raise ValueError("--oracle is told a world: give --worlds as well")
    if args.share is not None:
        check_positive("--share", args.share, "")
    rider = args.rider or DEFAULT_RACER
    bundle = load_bundle(rider) if args.subject == SUPERBIKE else None
    if bundle is not None and args.hold is not None:
        bundle = bundle.holding(args.hold)
    disturbances = [Disturbances(), *map(load_disturbances, args.disturbances)]
    name = rider if bundle is None else bundle.name
    machines, circuits = (args.vehicle or DEFAULT_SUPERBIKE).split(","), (args.course or CIRCUIT).split(",")
    pairs = _pairs(machines, circuits, args.in_turn)
    for machine in dict.fromkeys(machines):
        _check_disturbances(disturbances, load_superbike(machine))
    make_folder("--out", args.out)
    results = []
    for (machine, circuit), known in itertools.product(pairs, disturbances):
        title = f"{name}, {machine}, {circuit}" + (f", {known.name}" if known.name != "none" else "")
        with progress_bar(title, "s", quiet=args.json) as bar:
            chosen = args.starts, args.laps, args.share, setter(bar), known, args.engine, args.time_step
            results.append(ride_races(bundle or SETTINGS[name], machine, circuit, *chosen))
    lost = [
        {**{name: each[name] for name in ("vehicle", "circuit", "disturbances")}, **ride}
        for each in results
        for ride in each["lost"]
    ]
    detail = ("times_s", "finished", "lost")
    found = [{name: value for name, value in each.items() if name not in detail} for each in results]
    figures = {"policy": name, "races": found, "lost": lost}
    (args.out / "races.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    with (args.out / "races.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(found[0]))
        writer.writeheader()
        writer.writerows(found)
    if not args.json:
        print(f"Races of {name}")
        print("\n".join(table_text(RACES, found, left=3)))
        for ride in lost[:LISTED_LOST]:
            where = "" if ride["arc_length_m"] is None else f" at {ride['arc_length_m']:.0f} m"
            world = "" if ride["disturbances"] == "none" else f" under {ride['disturbances']}"
            print(f"lost: {ride['vehicle']} on {ride['circuit']}{world}, start {ride['start']}: {ride['cause']}{where}")
        if len(lost) > LISTED_LOST:
            print(f"and {len(lost) - LISTED_LOST} more lost rides, listed in {args.out / 'races.json'}")
    # Disturbances are there to find out what a rider bears, so falls under them are no failure of the command.
    ok = all(race["whole"] == race["rides"] for race in found if race["disturbances"] == "none")
    return {"schema": "bike.evaluate_races/1", "ok": ok, "figures": figures}


def _check_disturbances(disturbances: Sequence[Disturbances], machine: Superbike) -> None:
    """Check that a machine can be ridden under disturbances, so that no ride is lost to the last of them.

    Raises:
        ValueError: naming the option and the disturbances.
    """
    for known in disturbances:
        try:
            Instruments([known], [machine], machine.control_period)
            ridden_superbike(machine, known)
        except ValueError as error:
            raise ValueError(f"--disturbances {known.name}: {error}") from None


def _pairs(machines: Sequence[str], circuits: Sequence[str], taking_turns: bool) -> list[tuple[str, str]]:
    """Return which machine rides which circuit."""
    if taking_turns:
        return list(zip(round_robin(machines, len(circuits)), circuits, strict=True))
    return [(machine, circuit) for circuit in circuits for machine in machines]


RACES: Final = {
    "machine": "{vehicle}", "circuit": "{circuit}", "disturbances": "{disturbances}", "whole": "{whole} of {rides}",
    "falls": "{falls}", "walls": "{walls}", "best": "{best_s!l}", "median": "{median_s!l}", "theory": "{theory_s!l}",
    "over it": "{median_excess:+.1%}", "off line": "{line_distance_m:.2f} m", "off track": "{off_track_s:.1f} s",
}  # fmt: skip
"""Columns of the table of races."""
