"""How close a sweep comes to the ideal time: that of its runs, shared out over the cores.

    python -m bench.sweep_ratio [--runs 12] [--steps 12000] [--cores 2]

Both times are of the same sweep, so other work on the machine slows both. The ideal time is the sum of what the runs
say that they took, over the cores; what lies beyond it is the start of the command, of Ray and of its workers, the
unevenness at the end, and the tables. Processor times are given as well: those of all processes of the sweep, over
those of its runs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
import psutil
import yaml


def processor_times(process: psutil.Process) -> dict[int, float]:
    """Return the processor time of a process and of all below it, s, by process id."""
    found: dict[int, float] = {}
    try:
        family = [process, *process.children(recursive=True)]
    except psutil.Error:
        return found
    for member in family:
        try:
            times = member.cpu_times()
        except psutil.Error:
            continue
        found[member.pid] = times.user + times.system
    return found


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--steps", type=int, default=12_000, help="learning steps of each run")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    document = {"base": {"vehicle": "whipple", "steps": args.steps}, "grid": {"seed": list(range(args.runs))}}
    with tempfile.TemporaryDirectory() as folder:
        spec, out = Path(folder) / "twelve.yaml", Path(folder) / "out"
        spec.write_text(yaml.safe_dump(document))
        command = [sys.executable, "-m", "bike_training.cli", "sweep", str(spec), "--out", str(out)]
        began, load = time.perf_counter(), os.getloadavg()[0]
        sweep = subprocess.Popen([*command, "--cores", str(args.cores), "--json"], stdout=subprocess.DEVNULL)
        watched, processor = psutil.Process(sweep.pid), {}
        while sweep.poll() is None:
            processor |= processor_times(watched)
            time.sleep(0.25)
        wall = time.perf_counter() - began
        runs = pd.read_parquet(out / "runs.parquet")
    work, used = float(runs["seconds"].sum()), float(runs["cpu_seconds"].sum())
    ideal = work / args.cores
    figures = {
        "runs_finished": int((runs["status"] == "finished").sum()),
        "wall_s": wall,
        "ideal_s": ideal,
        "ratio": wall / ideal,
        "slowest_run_s": float(runs["seconds"].max()),
        "processor_ratio": sum(processor.values()) / used,
        "load_before": load,
        "load_after": os.getloadavg()[0],
    }
    print(json.dumps({name: round(value, 3) for name, value in figures.items()}, indent=1))


if __name__ == "__main__":
    main()
