"""A simulated schedule of a large sweep: how long it takes, what it costs, and where it saturates.

    python -m bench.sweep_schedule                        the table of docs/scaling.md
    python -m bench.sweep_schedule --runs 1000 --machines 100 --seconds 150

Event by event: a slot for each core takes the next run, waits for the head to hand it out, loads its packages once,
learns, and brings its checkpoints to the store. Head and store serve one at a time; who comes waits.
The costs are measured ones (`bench.sweep_costs`, docs/scaling.md), lengths of runs are drawn around their mean.
"""

from __future__ import annotations

import argparse
import heapq
import json
from dataclasses import asdict, dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Setting:
    """A sweep on a cluster.

    Attributes:
        runs: all of them. machines: of the cluster. cores: of a machine; one run each.
        seconds: mean length of a run, s. spread: standard deviation of its logarithm.
        boot: until a machine takes its first run, s. load: until a new worker has loaded its packages, s.
        head_seconds: of the head for each run, from hand-out to result, s.
        told_rate: reports of progress that a sweep makes at most, 1/s. told_seconds: of the head for each, s.
        checkpoint_every: time between checkpoints of a run, s. checkpoint_bytes: size of one.
        store_rate: what the store takes in all, bytes/s. uplink_rate: what a machine sends, bytes/s.
        price: of a core for an hour.
    """

    runs: int = 1000
    machines: int = 100
    cores: int = 2
    seconds: float = 150.0
    spread: float = 0.2
    boot: float = 90.0
    load: float = 14.0
    head_seconds: float = 0.005
    told_rate: float = 100.0
    told_seconds: float = 0.0013
    checkpoint_every: float = 100.0
    checkpoint_bytes: float = 12e6
    store_rate: float = 1e9
    uplink_rate: float = 100e6
    price: float = 0.04


def simulate(setting: Setting, seed: int = 0) -> dict[str, float]:
    """Return how the sweep goes.

    Returns:
        ``hours`` until the last run has ended, ``ideal_hours`` of the work on all cores without any loss, their ratio
        ``efficiency``, busy shares of head and store, ``money`` for all machines until the end.
    """
    rng = np.random.default_rng(seed)
    factors = rng.lognormal(-0.5 * setting.spread**2, setting.spread, setting.runs)
    lengths = np.sort(setting.seconds * factors)[::-1]  # the longest first, as `bike sweep` does
    slots = setting.machines * setting.cores
    # Reports are small and many: they slow the head down by their share of it instead of being events.
    reports = min(0.99, min(slots, setting.runs, setting.told_rate) * setting.told_seconds)
    head_free = store_free = head_busy = store_busy = last = 0.0
    events = [(setting.boot, k, -1, 0.0) for k in range(min(slots, setting.runs))]  # time, slot, run or -1, work left
    heapq.heapify(events)
    begun, fresh = 0, set(range(slots))
    upload = setting.checkpoint_bytes / setting.uplink_rate
    while events:
        now, slot, run, left = heapq.heappop(events)
        if run >= 0:  # a checkpoint, or the end
            store_free = max(store_free, now) + setting.checkpoint_bytes / setting.store_rate
            store_busy += setting.checkpoint_bytes / setting.store_rate
            now = max(store_free, now + upload)
            if left > 0.0:
                step = min(left, setting.checkpoint_every)
                heapq.heappush(events, (now + step, slot, run, left - step))
                continue
            last = max(last, now)
        if begun == setting.runs:
            continue
        serve = setting.head_seconds / (1.0 - reports)
        head_free = max(head_free, now) + serve
        head_busy += setting.head_seconds
        begin = head_free + (setting.load if slot in fresh else 0.0)
        fresh.discard(slot)
        step = min(float(lengths[begun]), setting.checkpoint_every)
        heapq.heappush(events, (begin + step, slot, begun, float(lengths[begun]) - step))
        begun += 1
    ideal = lengths.sum() / slots
    hours = last / 3600.0
    return {
        "hours": hours,
        "ideal_hours": ideal / 3600.0,
        "efficiency": ideal / last,
        "head_busy": head_busy / last + reports,
        "store_busy": store_busy / last,
        "money": hours * slots * setting.price,
    }


def main() -> None:
    """Print a schedule for given numbers, or the table."""
    parser = argparse.ArgumentParser()
    for name, value in asdict(Setting()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value))
    parser.add_argument("--json", action="store_true")
    args = vars(parser.parse_args())
    as_json = args.pop("json")
    given = {name: value for name, value in args.items() if value is not None}
    setting = replace(Setting(), **given)
    if as_json:
        print(json.dumps(simulate(setting)))
        return
    print("  runs machines  run s   hours  ideal  efficiency  head   store  money")
    counts = [setting.machines] if "machines" in given else [1, 10, 30, 100, 300, 1000, 3000, 10000]
    for seconds in [setting.seconds] if "seconds" in given else [15.0, 150.0, 1500.0]:
        for machines in counts:
            case = replace(setting, machines=machines, seconds=seconds)
            if "runs" not in given and machines > 100:
                case = replace(case, runs=10 * machines)
            f = simulate(case)
            print(
                f"{case.runs:6d} {machines:8d} {seconds:6.0f} {f['hours']:7.2f} {f['ideal_hours']:6.2f} "
                f"{f['efficiency']:10.2f} {f['head_busy']:6.2f} {f['store_busy']:6.2f} {f['money']:7.0f}"
            )


if __name__ == "__main__":
    main()
