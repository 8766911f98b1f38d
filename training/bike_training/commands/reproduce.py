"""`bike reproduce`: do the experiments of a publication again and set its statements beside what comes out."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from importlib.util import find_spec
from typing import Any, Final

import yaml

from bike_sim.recording.in_use import claim_folder
from bike_training.arguments import check_whole, make_folder, seeds_of
from bike_training.reproduce.bicycle import BICYCLE
from bike_training.reproduce.data import read_data, write_data
from bike_training.reproduce.paper import Experiment, Paper, all_tables, collect, draw_all
from bike_training.reproduce.statement import NO, OPEN, YES, verdict_table
from bike_training.reproduce.superbike import SUPERBIKE
from bike_training.sweeps.driver import do_runs
from bike_training.sweeps.runs import make_plan

PAPERS: Final[dict[str, Paper[Any]]] = {paper.name: paper for paper in (BICYCLE, SUPERBIKE)}
DATA: Final = "data"
STATEMENTS_FILE: Final = "statements.md"
TABLES_FILE: Final = "tables.md"


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Learn what is missing, ride, write tables, draw; not ok where a run has not finished.

    Raises:
        ValueError: an argument.
        ModuleNotFoundError: packages of sweeps are missing.
    """
    for name, least in (("steps", 1), ("cores", 1)):
        value = getattr(args, name)
        if value is not None:
            check_whole(f"--{name}", value, least)
    paper = PAPERS[args.paper]
    experiment = _experiment(args)
    sweep = experiment.sweep()
    plan = make_plan(sweep, args.out)
    cores = float(args.cores or os.cpu_count() or 1)
    hours = plan.hours(cores)
    if not args.json:
        print(f"{len(plan.runs)} runs, {len(plan.missing)} to do, about {hours:.1f} h on {cores:g} cores")
    if args.plan:
        figures = {"runs": len(plan.runs), "runs_missing": len(plan.missing), "estimate_h": hours}
        return {"schema": "bike.reproduce/1", "ok": True, "figures": figures}
    if find_spec("ray") is None:
        raise ModuleNotFoundError("experiments need ray", name="ray")
    make_folder("--out", args.out)
    with claim_folder(args.out):
        (args.out / "sweep.yaml").write_text(yaml.safe_dump(experiment.document(), sort_keys=False), encoding="utf-8")
        interrupted = do_runs(plan, args.out, (None, args.cores), sweep.retries, args.json)
        plan = make_plan(sweep, args.out)
        data = collect(paper, plan, experiment, quiet=args.json)
        make_folder("--out", args.out / DATA)
        write_data(paper.file, args.out / DATA, data)
        return _outcome(args, data, ok=not interrupted and all(each.finished for each in plan.runs))


def _experiment(args: argparse.Namespace) -> Experiment:
    """Return what is asked for.

    Raises:
        ValueError: a setting that the paper does not have.
    """
    paper = PAPERS[args.paper]
    known = paper.experiment.settings
    unknown = [name for name in args.settings or () if name not in known]
    if unknown:
        raise ValueError(f"--settings {unknown[0]}: the {paper.name} paper has {', '.join(known)}")
    asked: dict[str, Any] = {"settings": args.settings and tuple(args.settings), "steps": args.steps}
    if args.seeds is not None:
        asked["seeds"] = seeds_of("--seeds", args.seeds)
    experiment: Experiment = paper.quick if args.quick else paper.experiment
    return replace(experiment, **{name: value for name, value in asked.items() if value})


def run_drawing(args: argparse.Namespace) -> dict[str, Any]:
    """Draw from tables.

    Raises:
        ValueError: a table is another one.
        FileNotFoundError: one is missing.
    """
    data = read_data(PAPERS[args.paper].file, args.data)
    make_folder("--out", args.out)
    return _outcome(args, data, ok=True)


def _outcome(args: argparse.Namespace, data: Any, ok: bool) -> dict[str, Any]:
    """Draw, write the statements, and return the figures."""
    paper = PAPERS[args.paper]
    drawn = draw_all(paper, data, args.out)
    text = verdict_table(paper.statements, data)
    (args.out / STATEMENTS_FILE).write_text(text, encoding="utf-8")
    (args.out / TABLES_FILE).write_text(all_tables(paper, data), encoding="utf-8")
    verdicts = [statement.find(data).agrees for statement in paper.statements]
    if not args.json:
        print(text)
        print(f"figures, {STATEMENTS_FILE} and {TABLES_FILE} in {args.out}")
        if not ok:
            print("the same command does what is missing")
    figures = {
        "runs": len(data["runs"]),
        "runs_finished": int((data["runs"]["status"] == "finished").sum()),
        "curricula_finished": int((data["runs"]["finished_at"] >= 0).sum()),
        **paper.counts(data),
        "statements": {verdict: verdicts.count(verdict) for verdict in (YES, NO, OPEN)},
        "files": [str(path) for path in drawn],
    }
    return {"schema": "bike.reproduce/1", "ok": ok, "figures": figures}
