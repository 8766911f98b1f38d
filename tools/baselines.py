"""Learn baselines of frozen tasks: ``tools/baselines.py --id two_wheeler/Balance-v0 --seeds 10``.

Each seed learns as ``examples/gymnasium_sb3.py`` does. Its results are verified and become a row of
docs/data/benchmark_baselines.csv at once; a seed that has its row is left out, so that the same call goes on where it
was stopped.
"""

from __future__ import annotations

import argparse
import csv
import runpy
import time
from pathlib import Path

from figures import DATA, ROOT, changed_sources, read_head, read_records

from bike_training.benchmark.evaluation import RESULTS_FILE, verify_results

NAME = "benchmark_baselines"


def main() -> None:
    """Learn what the table lacks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--library", choices=["sb3", "sbx"], default="sb3", help="PyTorch or JAX")
    parser.add_argument("--algorithm", choices=["PPO", "SAC"], default="PPO")
    parser.add_argument("--id", default="two_wheeler/Balance-v0", help="one of the frozen tasks")
    parser.add_argument("--count", type=int, default=64, help="vehicles side by side")
    parser.add_argument("--steps", type=int, default=200000, help="decisions of all vehicles together")
    parser.add_argument("--seeds", type=int, default=10, help="how many, from 0 on")
    parser.add_argument("--out", type=Path, default=Path("out/baselines"), help="folder of results and recordings")
    args = parser.parse_args()
    table = DATA / f"{NAME}.csv"
    if changed := changed_sources(read_head(table)):
        parser.error(f"{table} has rows of other sources ({', '.join(changed)}): empty it, and name the commit anew")
    learn = runpy.run_path(str(ROOT / "examples" / "gymnasium_sb3.py"))["learn"]
    learner = f"{args.library} {args.algorithm}"
    for seed in range(args.seeds):
        key = {"task": args.id, "learner": learner, "vehicles": args.count, "decisions": args.steps, "seed": seed}
        if any(all(row[name] == str(value) for name, value in key.items()) for row in read_records(NAME)):
            continue
        out = args.out / args.id.split("/")[1] / learner.replace(" ", "_") / f"{args.steps}_{seed}"
        began = time.process_time()
        found = learn(args.library, args.algorithm, args.id, args.count, args.steps, seed, out)
        spent = time.process_time() - began
        if faults := verify_results(out / RESULTS_FILE)["faults"]:
            raise RuntimeError(f"{out}: {faults[0]}")
        figures = [f"{found['error']:.6f}", found["failed"], f"{found['score']:.6f}", f"{spent:.1f}"]
        with table.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow([*key.values(), *figures])
        print(f"{args.id}, {learner}, seed {seed}: score {found['score']:.3f}, {found['failed']} failed", flush=True)


if __name__ == "__main__":
    main()
