"""What a sweep costs beside its runs: processor time of Ray's start, of a worker, and of each task in the head.

    python -m bench.sweep_costs [--tasks 300]

Processor times of all processes of the local Ray, so that other work on the machine does not count.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

from bike_training.sweeps.board import Board
from bike_training.sweeps.cluster import ray_cluster

RECORD = {"schema": "bike.sweep.run/1", "entries": {f"setting_{k}": float(k) for k in range(40)}, "status": "finished"}
"""A record as large as those of trainings, 1.2 kB as JSON."""


def processor_time() -> tuple[float, float]:
    """Return processor times so far, s: of the head's processes with the driver, and of the workers."""
    head, workers = 0.0, 0.0
    me = psutil.Process()
    for process in [me, *me.children(recursive=True)]:
        try:
            times = process.cpu_times()
            seconds = times.user + times.system
            if process.name().startswith("ray::") and "Agent" not in process.name():
                workers += seconds
            else:
                head += seconds
        except psutil.Error:
            continue
    return head, workers


def task(board: Any, number: int, told: int) -> dict[str, Any]:
    """Tell how far it is and end, as a run of no length."""
    for step in range(told):
        board.tell.remote(f"run-{number}", step, told, "")
    return RECORD


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tasks", type=int, default=300)
    parser.add_argument("--told", type=int, default=5, help="reports of progress of each task")
    args = parser.parse_args()
    tasks, told = args.tasks, args.told
    with tempfile.TemporaryDirectory() as folder:
        before, wall = processor_time()[0], time.perf_counter()
        with ray_cluster(Path(folder), None, os.cpu_count()) as ray:
            started, started_wall = processor_time()[0], time.perf_counter()
            board = ray.remote(Board).options(num_cpus=0).remote()
            remote = ray.remote(task)
            ray.get([remote.remote(board, k, told) for k in range(os.cpu_count() or 1)])
            head, workers = processor_time()
            began = time.perf_counter()
            waiting = [remote.remote(board, k, told) for k in range(tasks)]
            while waiting:
                _, waiting = ray.wait(waiting, num_returns=1)
                ray.get(board.take.remote())
            head_after, workers_after = processor_time()
            span = time.perf_counter() - began
    figures = {
        "ray_start_cpu_s": started - before,
        "ray_start_s": started_wall - wall,
        "first_workers_cpu_s": workers,
        "head_cpu_per_task_s": (head_after - head) / tasks,
        "worker_cpu_per_task_s": (workers_after - workers) / tasks,
        "tasks_per_s": tasks / span,
        "record_bytes": len(json.dumps(RECORD)),
        "load_average": os.getloadavg()[0],
    }
    print(json.dumps({name: round(value, 5) for name, value in figures.items()}, indent=1))


if __name__ == "__main__":
    main()
