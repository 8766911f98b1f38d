"""`bike evaluate --task` and `--verify`: scores in frozen tasks, and whether results are true."""

from __future__ import annotations

import argparse
from typing import Any

from bike_policy.contract.bundle import DEFAULT_POLICY, DEFAULT_RACER
from bike_training.arguments import make_folder
from bike_training.benchmark.evaluation import RESULTS_FILE, SCHEMA, record_rider, verify_results, write_results
from bike_training.benchmark.tasks import SUPERBIKE, benchmark_of
from bike_training.progress import progress_bar, setter


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Ride the episodes of a frozen task, write recordings and results, and return these.

    Raises:
        ValueError: an unknown task or version, or a rider of another kind of vehicle.
        FileNotFoundError: there is no such rider.
    """
    benchmark = benchmark_of(args.task)
    rider = args.rider or (DEFAULT_RACER if benchmark.vehicle == SUPERBIKE else DEFAULT_POLICY)
    make_folder("--out", args.out)
    with progress_bar(rider, "", 1, quiet=args.json) as bar:
        commands = record_rider(benchmark, rider, setter(bar))
    results = write_results(args.out, args.task, rider, commands)
    if not args.json:
        error = f"{results['error_name']} {results['error']:.4g}"
        print(f"{rider} in {args.task}: score {results['score']:.4f}, {error} over {benchmark.count} episodes")
        print(f"{results['failed']} failed; written to {args.out / RESULTS_FILE}")
    return {"schema": SCHEMA, "ok": True, "figures": results}


def run_verification(args: argparse.Namespace) -> dict[str, Any]:
    """Ride the recordings of results again; not ok where they do not give what is claimed.

    Raises:
        ValueError: results of another version or of an unknown task, or a damaged file.
        OSError: a file cannot be read.
    """
    found = verify_results(args.verify)
    if not args.json:
        verdict = "true" if not found["faults"] else "not true"
        head = f"{args.verify}: {found['rider']} in {found['task']}, score {found['score']:.4f}: {verdict}"
        print("\n".join([head, *found["faults"]]))
    return {"schema": "bike.verification/1", "ok": not found["faults"], "figures": found}
