"""`bike sweep`: many runs from one file, on the cores of this machine or on a cluster."""

from __future__ import annotations

import argparse
import os
import shutil
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

from tqdm import tqdm

from bike_sim.recording.in_use import claim_folder
from bike_training.arguments import check_whole, make_folder

if TYPE_CHECKING:
    from bike_training.sweeps.runs import Plan
    from bike_training.sweeps.spec import Sweep

SCHEMA: Final = "bike.sweep/1"
SPEC_COPY: Final = "sweep.yaml"


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Do what is missing of a sweep; not ok where a run has not finished.

    Raises:
        FileNotFoundError: there is no such file, or a run names something that does not exist.
        ValueError: the file, or a run in it.
        OSError: the folder, or no cluster at the address.
        ModuleNotFoundError: the packages of sweeps are not installed.
    """
    if args.cores is not None:
        check_whole("--cores", args.cores, 1)

    if not args.json:
        print(f"{args.spec}: checking its runs", flush=True)
    # Late: learners and planners take seconds, and the first line comes at once.
    from bike_training.sweeps.runs import make_plan
    from bike_training.sweeps.spec import load_sweep

    sweep = load_sweep(args.spec, lambda runs: tqdm(runs, unit="run", disable=args.json or None, leave=False))
    plan = make_plan(sweep, args.out)
    cores = float(args.cores or os.cpu_count() or 1)
    if not args.json:
        print(_announcement(sweep, plan, cores, args.address))
    if args.plan:
        return _outcome(sweep, plan, args, cores, ok=True)
    for package in ("ray", "pyarrow"):
        if find_spec(package) is None:  # Ray itself reads its environment while it is imported, so only later
            raise ModuleNotFoundError(f"a sweep needs {package}", name=package)
    make_folder("--out", args.out)
    with claim_folder(args.out):
        return _do(sweep, plan, args, cores)


def _do(sweep: Sweep, plan: Plan, args: argparse.Namespace, cores: float) -> dict[str, Any]:
    from bike_training.sweeps import results
    from bike_training.sweeps.driver import do_runs
    from bike_training.sweeps.runs import RUNS_FOLDER, make_plan

    shutil.copyfile(args.spec, args.out / SPEC_COPY)
    interrupted = do_runs(plan, args.out, (args.address, args.cores), sweep.retries, args.json)
    plan = make_plan(sweep, args.out)
    results.write_tables(plan, args.out)
    outcome = _outcome(sweep, plan, args, cores, ok=all(run.finished for run in plan.runs))
    if not args.json:
        counts = outcome["figures"]["runs_by_status"]
        print(", ".join(f"{count} {status}" for status, count in counts.items() if count) + f"; tables in {args.out}")
        if not outcome["ok"]:
            print("the same command does what is missing")
        print(f"curves of all runs: tensorboard --logdir {args.out / RUNS_FOLDER}")
    if interrupted and not args.json:
        print("interrupted; runs that had begun go on from their checkpoints")
    return outcome


def _announcement(sweep: Sweep, plan: Plan, cores: float, address: str | None) -> str:
    missing = len(plan.missing)
    where = f"at {address}" if address else f"on {cores:g} cores"
    text = f"{sweep.name}: {len(plan.runs)} runs, {len(plan.runs) - missing} finished, {missing} to do"
    if not missing:
        return text
    work = sum(run.seconds for run in plan.missing) / 3600.0
    hours = "" if address else f", about {_hours(plan.hours(cores))}"
    return f"{text}; {_hours(work)} of work {where}{hours}"


def _hours(hours: float) -> str:
    return f"{hours:.1f} h" if hours >= 1.0 else f"{max(1.0, 60.0 * hours):.0f} min"


def _outcome(sweep: Sweep, plan: Plan, args: argparse.Namespace, cores: float, ok: bool) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "name": sweep.name,
        "out": str(args.out),
        "runs": len(plan.runs),
        "runs_by_status": plan.counts,
        "failures": {run.folder.name: run.error for run in plan.runs if run.error},
        "work_left_h": round(sum(run.seconds for run in plan.missing) / 3600.0, 4),
    }
    if not args.address:
        figures["estimate_h"] = round(plan.hours(cores), 4)
    return {"schema": SCHEMA, "ok": ok, "figures": figures}
