"""Learn baselines of the frozen tasks: ``tools/baselines.py``, or some of them by its options.

Each seed learns as ``examples/gymnasium_sb3.py`` does. Its results are verified and become rows of
docs/data/benchmark_baselines.csv at once; a seed that has its rows is left out, so that the same call goes on where it
was stopped. At the end all learning curves are drawn.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import runpy
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
from figures import DATA, ROOT, changed_sources, read_head, read_records
from matplotlib.ticker import MaxNLocator, NullFormatter

from bike_analysis.page.document import RC, colour
from bike_analysis.page.view import SERIES_COLOURS
from bike_analysis.sweeps.statistics import bootstrap
from bike_training.benchmark.evaluation import RESULTS_FILE, verify_results
from bike_training.benchmark.tasks import BENCHMARKS

NAME = "benchmark_baselines"
LEARNERS = "sb3 PPO", "sbx SAC", "sbx TD3"
VEHICLES = {"PPO": 64, "SAC": 32, "TD3": 32}
"""Side by side."""
STEPS = 100_000
"""Decisions of all vehicles together: the same for all rows, for the curves are means over seeds."""
SCORES = 4
"""Points of a learning curve."""
Learn = Callable[..., list[dict[str, Any]]]
PICTURE = ROOT / "docs" / "images" / "baselines.png"


def draw(rows: list[dict[str, str]], picture: Path) -> None:
    """Draw the error over decisions, a panel for each task: interquartile means over seeds with their intervals."""
    tasks = [name for name in BENCHMARKS if any(row["task"] == name for row in rows)]
    with mpl.rc_context(RC):
        figure, axes = plt.subplots(-(-len(tasks) // 2), 2, figsize=(9, 2.4 * -(-len(tasks) // 2)), squeeze=False)
        for panel, task in itertools.zip_longest(axes.flat, tasks):
            if task is None:
                panel.set_axis_off()
                continue
            for name, learner in zip(SERIES_COLOURS, LEARNERS, strict=False):
                points: dict[int, list[float]] = defaultdict(list)
                for row in rows:
                    if (row["task"], row["learner"]) == (task, learner):
                        points[int(row["decisions"])].append(float(row["error"]))
                if points:
                    decisions = sorted(points)
                    middle, low, high = zip(*(bootstrap(points[each]) for each in decisions), strict=True)
                    panel.fill_between(decisions, low, high, color=colour(name), alpha=0.18, lw=0)
                    label = f"{learner} ({len(points[decisions[-1]])})"
                    panel.plot(decisions, middle, color=colour(name), marker="o", ms=3, label=label)
            benchmark = BENCHMARKS[task]
            panel.axhline(benchmark.classical_error, color=colour("muted"), lw=1, ls=":", label=benchmark.classical)
            panel.set(yscale="log", ylabel=f"{task.removeprefix('two_wheeler/')}, error", xlabel="decisions")
            panel.xaxis.set_major_locator(MaxNLocator(5))
            panel.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}")
            panel.yaxis.set_major_formatter(lambda y, _: f"{y:g}")
            panel.yaxis.set_minor_formatter(NullFormatter())
            panel.legend(fontsize=7)
        figure.tight_layout()
        figure.savefig(picture, dpi=110)
        plt.close(figure)


def main() -> None:
    """Learn what the table lacks, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--id", nargs="+", default=list(BENCHMARKS), help="some of the frozen tasks")
    parser.add_argument("--learner", nargs="+", default=list(LEARNERS), help="library and algorithm")
    parser.add_argument("--seeds", type=int, default=10, help="how many, from 0 on")
    parser.add_argument("--out", type=Path, default=Path("out/baselines"), help="folder of results and recordings")
    args = parser.parse_args()
    table = DATA / f"{NAME}.csv"
    if changed := changed_sources(read_head(table)):
        parser.error(f"{table} has rows of other sources ({', '.join(changed)}): empty it, and name the commit anew")
    learn = runpy.run_path(str(ROOT / "examples" / "gymnasium_sb3.py"))["learn"]
    for seed in range(args.seeds):
        for task in args.id:
            for learner in args.learner:
                if not _known(task, learner, seed):
                    _learn(learn, table, task, learner, seed, args.out)
    draw(read_records(NAME), PICTURE)


def _known(task: str, learner: str, seed: int) -> bool:
    """Whether the table has a seed."""
    key = {"task": task, "learner": learner, "seed": str(seed)}
    return any(all(row[name] == value for name, value in key.items()) for row in read_records(NAME))


def _learn(learn: Learn, table: Path, task: str, learner: str, seed: int, folder: Path) -> None:
    """Learn a seed and append its rows."""
    library, algorithm = learner.split()
    out = folder / task.split("/")[1] / f"{library}_{algorithm}" / f"{seed}"
    points = learn(library, algorithm, task, VEHICLES[algorithm], STEPS, seed, out, SCORES)
    if faults := verify_results(out / RESULTS_FILE)["faults"]:
        raise RuntimeError(f"{out}: {faults[0]}")
    with table.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        for each in points:
            found = f"{each['error']:.6f}", each["failed"], f"{each['score']:.6f}", f"{each['processor_s']:.1f}"
            writer.writerow((task, learner, VEHICLES[algorithm], each["decisions"], seed, *found))
    last = points[-1]
    print(f"{task}, {learner}, seed {seed}: score {last['score']:.3f}, {last['failed']} failed", flush=True)


if __name__ == "__main__":
    main()
