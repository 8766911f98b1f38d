"""`bike reproduce`: do the experiments of a publication again and set its statements beside what comes out."""

from __future__ import annotations

import argparse
import csv
import os
import sys
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import yaml
from tqdm import tqdm

from bike_policy.contract.bundle import Bundle, load_bundle
from bike_policy.riders.learned import LearnedRider
from bike_sim.recording.in_use import claim_folder
from bike_training.arguments import check_whole, make_folder
from bike_training.reproduce.data import (
    Data,
    Impact,
    Instant,
    Rides,
    Run,
    Validation,
    read_data,
    read_rows,
    write_data,
    write_rows,
)
from bike_training.reproduce.detail import (
    front_directions,
    full_circles,
    impacts,
    instants,
    ride_benchmark,
    steering_step,
)
from bike_training.reproduce.experiment import (
    QUICK,
    SETTINGS,
    Experiment,
    classical_riders,
    controller,
    ride_all,
    ride_junction,
    setting_of,
)
from bike_training.reproduce.figures import draw_all
from bike_training.reproduce.statements import NO, OPEN, STATEMENTS, YES, controller_1, table
from bike_training.reproduce.tables import all_tables
from bike_training.sweeps.display import Display
from bike_training.sweeps.driver import Place, do_runs
from bike_training.sweeps.plan import Plan, PlannedRun, make_plan, schedule, slots_of
from bike_training.sweeps.training_job import TrainJob
from bike_training.tasks.path import DISTANCE_THRESHOLD

DATA: Final = "data"
RIDES: Final = "rides.csv"
"""Rides of the controller of a run, in its folder."""
STATEMENTS_FILE: Final = "statements.md"
TABLES_FILE: Final = "tables.md"
SHIPPED: Final = "whipple"
"""Actor that is explained beside controller 1 of prop."""

EXAMPLES: Final = """examples:
  bike reproduce bicycle --out runs/paper --plan             how long it will take; starts nothing
  bike reproduce bicycle --out runs/paper                    all settings, five seeds; the same command goes on
  bike reproduce bicycle --out runs/paper --settings prop alt3 --seeds 2 --steps 200000
  bike reproduce bicycle --out drawn --data runs/paper/data  draw figures and tables again, without learning
  bike reproduce bicycle --out tried --quick                 the whole way in seconds; learns nothing
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.epilog = EXAMPLES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("paper", choices=["bicycle"], help="Weyrer et al. (2026), Sects. 5.1 to 5.5")
    parser.add_argument("--out", type=Path, required=True, help="folder; what it holds already is kept")
    parser.add_argument("--settings", nargs="+", choices=SETTINGS, help="of Table 5 (default: all)")
    parser.add_argument("--seeds", type=int, help="runs of each setting (default: 5)")
    parser.add_argument("--steps", type=int, help="most learning steps of a run (default: 4,000,000, as published)")
    parser.add_argument("--cores", type=int, help="processor cores to use (default: all)")
    parser.add_argument("--plan", action="store_true", help="say how long it will take, and start nothing")
    parser.add_argument("--quick", action="store_true", help="try the whole way with a run that learns nothing")
    parser.add_argument("--data", type=Path, help="draw from the tables of this folder; nothing is learned or ridden")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Learn what is missing, ride, write tables, draw; not ok where a run has not finished.

    Raises:
        ValueError, FileNotFoundError: an argument, or a table. ModuleNotFoundError: packages of sweeps are missing.
    """
    for name, least in (("seeds", 1), ("steps", 1), ("cores", 1)):
        value = getattr(args, name)
        if value is not None:
            check_whole(f"--{name}", value, least)
    if args.data is not None:
        make_folder("--out", args.out)
        return _outcome(args, read_data(args.data), ok=True)
    experiment = QUICK if args.quick else Experiment()
    asked = {"settings": args.settings and tuple(args.settings), "seeds": args.seeds, "steps": args.steps}
    experiment = replace(experiment, **{name: value for name, value in asked.items() if value})
    sweep = experiment.sweep()
    plan = make_plan(sweep, args.out)
    cores = float(args.cores or os.cpu_count() or 1)
    most = _longest(plan, cores)
    if not args.json:
        print(f"{len(plan.runs)} runs, {len(plan.missing)} to do, at most {most:.1f} h on {cores:g} cores")
    if args.plan:
        figures = {"runs": len(plan.runs), "runs_missing": len(plan.missing), "at_most_h": most}
        return {"schema": "bike.reproduce/1", "ok": True, "figures": figures}
    if find_spec("ray") is None:
        raise ModuleNotFoundError("experiments need ray", name="ray")
    make_folder("--out", args.out)
    with claim_folder(args.out):
        (args.out / "sweep.yaml").write_text(yaml.safe_dump(experiment.document(), sort_keys=False), encoding="utf-8")
        interrupted = False
        if plan.missing:
            with Display(len(plan.runs), len(plan.missing), quiet=args.json) as display:
                interrupted = do_runs(plan.missing, args.out, Place(cores=args.cores), sweep.retries, display)
        plan = make_plan(sweep, args.out)
        data = _collect(plan, experiment, quiet=args.json)
        make_folder("--out", args.out / DATA)
        write_data(args.out / DATA, data)
        return _outcome(args, data, ok=not interrupted and all(each.finished for each in plan.runs))


def _longest(plan: Plan, cores: float) -> float:
    """Return the time that the missing runs take where none ends its curriculum, h."""
    jobs = [each.run.job() for each in plan.missing]
    whole = [TrainJob(replace(job.settings, until_finished=False)) for job in jobs if isinstance(job, TrainJob)]
    seconds = [plan.scale * job.estimate() for job in whole]
    return schedule(seconds, slots_of(cores, [TrainJob.cores])) / 3600.0


def _collect(plan: Plan, experiment: Experiment, quiet: bool) -> Data:
    """Return the tables of what has been learned, and ride the controllers that have not ridden yet."""
    runs: list[Run] = []
    validations: list[Validation] = []
    rides: list[Rides] = []
    bundles: dict[tuple[str, int], Bundle] = {}
    total = 2 * len(experiment.speeds) * len(plan.runs)
    with tqdm(total=total, unit="ride", desc="controllers", disable=True if quiet else None, file=sys.stderr) as bar:
        for planned in plan.runs:
            setting, seed = _name_of(planned)
            rows = _validations(planned.folder, setting, seed)
            validations += rows
            runs.append(_run_row(planned, setting, seed, rows))
            bundle = controller(planned.folder, setting, experiment.which)
            if bundle is None:
                bar.update(2 * len(experiment.speeds))
                continue
            bundles[setting, seed] = bundle
            path = planned.folder / RIDES
            newer = path.is_file() and path.stat().st_mtime >= (planned.folder / "run.json").stat().st_mtime
            if newer:
                bar.update(2 * len(experiment.speeds))
            else:
                write_rows(path, Rides, ride_all(bundle, setting, seed, experiment, partial(_advance, bar)))
            rides += read_rows(path, Rides)
    data = Data(tuple(runs), tuple(validations), tuple(rides))
    chosen = [(name, controller_1(data, name)) for name in ("prop", "alt3")]
    best = {name: bundles[name, seed] for name, seed in chosen if seed is not None}
    return _look_closely(data, best, experiment)


def _look_closely(data: Data, best: dict[str, Bundle], experiment: Experiment) -> Data:
    """Return the tables with those of Figs. 11 to 14 and 16, Table 8 and Sect. 6.

    Args:
        data: of runs and rides.
        best: controllers 1 by setting.
        experiment: what is done.
    """
    riders = [(name, LearnedRider(bundle)) for name, bundle in best.items()]
    ride: tuple[Instant, ...] = ()
    shares: list[Impact] = []
    for name, bundle in {**({"prop": best["prop"]} if "prop" in best else {}), SHIPPED: load_bundle(SHIPPED)}.items():
        ridden = ride_benchmark(bundle, experiment.longest)
        if name == "prop":
            ride = tuple(instants(ridden))
        shares += impacts(name, bundle, ridden, experiment.explained, experiment.permutations)
    return replace(
        data,
        tracks=tuple(ride_junction([*riders, *classical_riders()])),
        ride=ride,
        impacts=tuple(shares),
        directions=tuple(front_directions()),
        steering=tuple(steering_step()),
        chances=(full_circles(experiment.paths),),
    )


def _advance(bar: Any) -> None:
    bar.update()


def _name_of(planned: PlannedRun) -> tuple[str, int]:
    entries = planned.run.entries
    return setting_of(str(entries["preset"])), int(entries["seed"])


def _run_row(planned: PlannedRun, setting: str, seed: int, rows: list[Validation]) -> Run:
    """Return how a run stands; the steps of one that was interrupted are those of its last validation at least."""
    summary: dict[str, Any] = {}
    with suppress(FileNotFoundError, ValueError):
        summary = yaml.safe_load((planned.folder / "run.json").read_text(encoding="utf-8"))
    result: dict[str, Any] = {}
    with suppress(FileNotFoundError, ValueError):
        result = yaml.safe_load((planned.folder / "result.json").read_text(encoding="utf-8"))
    finished = summary.get("finished_at_step")
    steps = int(summary.get("steps", rows[-1].step if rows else 0))
    cpu = float(result.get("cpu_seconds", -1.0))
    return Run(setting, seed, planned.status, steps, -1 if finished is None else int(finished), cpu)


def _validations(folder: Path, setting: str, seed: int) -> list[Validation]:
    rows = []
    with suppress(FileNotFoundError), (folder / "validations.csv").open(newline="", encoding="utf-8") as file:
        for record in csv.DictReader(file):
            with suppress(KeyError, TypeError, ValueError):  # a line that a kill has cut short
                error = float(record["mean_error_m"]) / DISTANCE_THRESHOLD
                rows.append(Validation(setting, seed, int(record["step"]), int(float(record["part"])), error))
    return rows


def _outcome(args: argparse.Namespace, data: Data, ok: bool) -> dict[str, Any]:
    """Draw, write the statements, and return the figures."""
    drawn = draw_all(data, args.out)
    text = table(data)
    (args.out / STATEMENTS_FILE).write_text(text, encoding="utf-8")
    (args.out / TABLES_FILE).write_text(all_tables(data), encoding="utf-8")
    verdicts = [statement.find(data).agrees for statement in STATEMENTS]
    if not args.json:
        print(text)
        print(f"figures, {STATEMENTS_FILE} and {TABLES_FILE} in {args.out}")
        if not ok:
            print("the same command does what is missing")
    figures = {
        "runs": len(data.runs),
        "runs_finished": sum(run.status == "finished" for run in data.runs),
        "curricula_finished": sum(run.finished_at >= 0 for run in data.runs),
        "rides": len(data.rides),
        "rides_completed": sum(ride.completed for ride in data.rides),
        "statements": {verdict: verdicts.count(verdict) for verdict in (YES, NO, OPEN)},
        "files": [str(path) for path in drawn],
    }
    return {"schema": "bike.reproduce/1", "ok": ok, "figures": figures}
