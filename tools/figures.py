"""Fill the tables of the documents from data files and from the code: ``make figures``. Nothing is measured here.

A page marks a table by ``<!-- figures: NAME -->`` and ``<!-- /figures -->``; what stands between them is written by
`filled`. A data file in ``docs/data`` begins with lines ``# key: value``, a folder of them has these in ``head.txt``:

    command  that made the data
    commit   of the sources that it ran on
    date     of that commit
    machine  that it ran on
    depends  on which sources, names of `SOURCES`
    note     what the command does not say (optional)
    rider    that rode (of tables that stand beside others)
    duration of the measurement (optional; `tools/measure.py` writes it)

Below a table stands where it is from. Where a source has changed since, the line says so.
"""

from __future__ import annotations

import csv
import io
import math
import re
import subprocess
from argparse import Action, HelpFormatter
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from textwrap import dedent, fill
from typing import Any, Final

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from bike_analysis.figures.cells import cells, markdown
from bike_analysis.sweeps.statistics import bootstrap
from bike_training.gymnasium_ids import BENCHMARK_STEPS

ROOT: Final = Path(__file__).resolve().parents[1]
DATA: Final = ROOT / "docs" / "data"
PAGES: Final = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
BLOCK: Final = re.compile(r"(<!-- figures: ([^>]+?) -->\n).*?(<!-- /figures -->)", re.DOTALL)
_SIM: Final = "ros_ws/src/bike_sim/bike_sim"
_POLICY: Final = "ros_ws/src/bike_policy/bike_policy"
_ROLLOUT: Final = "training/bike_training/rollout"
_SHARED: Final = f":(glob){_SIM}/physics/*.py"
_SUPERBIKE: Final = (_SHARED, f"{_SIM}/physics/multibody", f"{_SIM}/physics/superbike")
_CONTRACT: Final = (
    *(f"{_POLICY}/contract", f"{_POLICY}/riders/rider.py", f"{_POLICY}/riders/disturbed.py"),
    f"{_POLICY}/riders/instruments.py",
)
SOURCES: Final[Mapping[str, tuple[str, ...]]] = {
    "bicycle": (
        *(_SHARED, f"{_SIM}/physics/multibody", f"{_SIM}/physics/bicycle", f"{_SIM}/config/vehicles/whipple.yaml"),
        *(f"{_SIM}/sim", f"{_SIM}/course", f"{_SIM}/config/courses"),
    ),
    "bicycle_riders": (
        *(*_CONTRACT, *(f"{_POLICY}/policies/{name}" for name in ("whipple", "whipple_exact"))),
        *(f"{_ROLLOUT}/{name}.py" for name in ("rollout", "evaluation")),
        *(f"{_POLICY}/riders/{name}.py" for name in ("estimator", "lqr", "mpc", "observer", "stanley")),
    ),
    "superbike": (*_SUPERBIKE, f":(glob){_SIM}/config/vehicles/*.yaml", f"{_SIM}/sim"),
    "suspended": (*_SUPERBIKE, f"{_SIM}/config/vehicles"),
    "lines": (f"{_SIM}/course", f"{_SIM}/planning", f"{_SIM}/config/tracks"),
    "superbike_riders": (
        *(*_CONTRACT, f"{_POLICY}/planning", f"{_POLICY}/policies/racer", f"{_POLICY}/policies/generalist"),
        *(f"{_ROLLOUT}/{name}.py" for name in ("laps", "races", "worlds")),
        *(f"{_POLICY}/riders/{name}.py" for name in ("classical", "racing")),
        f":(exclude){_POLICY}/planning/racecraft.py",  # the lone rider does without it
    ),
    "adaptive": (f"{_POLICY}/policies/adaptive",),
    "optimum": (f"{_POLICY}/riders/optimum.py", f"{_ROLLOUT}/optimum.py"),
    "learning": tuple(f"training/bike_training/{name}" for name in ("tasks", "curricula", "learning", "presets")),
    "exporting": (_CONTRACT[0], f"{_POLICY}/policies", "training/bike_training/exporting"),
    "benchmark": ("training/bike_training/benchmark",),
    "baselines": ("examples/gymnasium_sb3.py",),
    "ros": (f"{_SIM}/ros", *(f"{_POLICY}/{name}.py" for name in ("drive", "estimate"))),
    "racecraft": (f"{_POLICY}/planning/racecraft.py", f"{_POLICY}/riders/wheel_to_wheel.py"),
}
"""Paths of each source, as git takes them."""
HEAD: Final = ("command", "commit", "date", "machine", "depends")


def data_heads() -> Iterator[Path]:
    """Yield the files in ``docs/data`` that have a head: tables, and ``head.txt`` of folders."""
    yield from sorted(DATA.glob("*.csv"))
    yield from sorted(DATA.glob("*/head.txt"))


def read_head(path: Path) -> dict[str, str]:
    """Return the head of a data file, or of a folder of data.

    Raises:
        ValueError: an entry is missing, or a source is unknown.
    """
    path = path / "head.txt" if path.is_dir() else path
    head = dict(re.findall(r"^# (\w+): (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE))
    missing = [key for key in HEAD if key not in head]
    unknown = [name for name in head.get("depends", "").split() if name not in SOURCES]
    if missing or unknown:
        raise ValueError(f"{path}: the head lacks {missing}, and does not know the sources {unknown}")
    return head


def read_rows(name: str) -> list[list[str]]:
    """Return the rows of a table in ``docs/data``, its column names first."""
    text = (DATA / f"{name}.csv").read_text(encoding="utf-8")
    return list(csv.reader(io.StringIO("".join(line for line in text.splitlines(True) if not line.startswith("#")))))


def read_records(name: str) -> list[dict[str, str]]:
    """Return the rows of a table in ``docs/data`` by column."""
    names, *rows = read_rows(name)
    return [dict(zip(names, row, strict=True)) for row in rows]


def changed_sources(head: Mapping[str, str]) -> list[str]:
    """Return the sources of data that have changed since its commit; none where the history does not reach it.

    What is not committed yet counts, so that a change and the pages that it makes older are one commit.
    """
    found = []
    for name in head["depends"].split():
        words = ["git", "-C", str(ROOT), "diff", "--shortstat", head["commit"], "--", *SOURCES[name]]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode == 0 and done.stdout:
            found.append(name)
    return found


def origin(path: Path) -> str:
    """Return the line that says where data is from, and whether it is older than its sources."""
    head = read_head(path)
    note = f"; {head['note']}" if "note" in head else ""
    line = f"`{head['command']}`{note}. {head['machine']}. *Measured at commit {head['commit']} ({head['date']})"
    changed = changed_sources(head)
    line += f"; changed since: {', '.join(changed)}*" if changed else "*"
    return f"\n{fill(line, 120, break_long_words=False, break_on_hyphens=False)}\n"


def shipped(name: str) -> str:
    """Return a table as it is in its file."""
    names, *rows = read_rows(name)
    return markdown([names, *rows]) + origin(DATA / f"{name}.csv")


PAIRS: Final = {
    "machine": "{vehicle}", "circuit": "{circuit}", "rides whole": "{whole} of {rides}", "best, s": "{best_s:.2f}",
    "median, s": "{median_s:.2f}", "over the closest line": "{median_excess:.1f} %",
    "off the line": "{line_distance_m:.2f} m",
}  # fmt: skip


def median_lap(row: dict[str, str]) -> str:
    """Return the median lap of rides, s, as text; of several flying laps that after the first; empty without one."""
    return row.get("later_s") or row["median_s"]


def over_closest(row: dict[str, str]) -> float:
    """Return by how much that lap is over the theoretical one of the closest line, %."""
    return 100.0 * (float(median_lap(row)) / float(row["theory_s"]) - 1.0)


def pairs(name: str) -> str:
    """Return a table of a rider's laps, one line for each machine and circuit."""
    rows = []
    for row in read_records(name):
        numbers = {key: float(row[key]) for key in ("best_s", "line_distance_m")} | {"median_s": float(median_lap(row))}
        rows.append(cells(PAIRS.values(), row | numbers | {"median_excess": over_closest(row)}))
    return markdown([list(PAIRS), *rows]) + origin(DATA / f"{name}.csv")


GAINS: Final = ("rider", "rides whole", "median over the closest line, mean of the pairs", "faster than the first")


def gains(name: str) -> str:
    """Return riders of the same pairs of machine and circuit, and by how much their medians are below the first's.

    Differences are paired; behind them stands half of their 95 % interval over the pairs (Student's t).
    """
    table: list[list[str]] = []
    files = name.split(",")
    tables = {rider: {(row["vehicle"], row["circuit"]): row for row in read_records(rider)} for rider in files}
    first = tables[files[0]]
    for rider, rows in tables.items():
        whole, rides = (sum(int(row[key]) for row in rows.values()) for key in ("whole", "rides"))
        excess = np.mean([over_closest(row) for row in rows.values()])
        gain = np.array([100.0 * (1.0 - float(median_lap(rows[p])) / float(median_lap(first[p]))) for p in first])
        half = student.ppf(0.975, len(gain) - 1) * gain.std(ddof=1) / len(gain) ** 0.5
        paired = "-" if rows is first else f"{gain.mean():.2f} ± {half:.2f} %"
        table.append([read_head(DATA / f"{rider}.csv")["rider"], f"{whole} of {rides}", f"{excess:.2f} %", paired])
    return markdown([GAINS, *table]) + "".join(origin(DATA / f"{rider}.csv") for rider in files)


def disturbed(name: str) -> str:
    """Return riders of one machine on one circuit under disturbances: rides that were whole, and their median lap."""
    files = name.split(",")
    tables = {rider: {row["disturbances"]: row for row in read_records(rider)} for rider in files}
    rows = []
    for world in tables[files[0]]:
        laps = [tables[rider][world] for rider in files]
        texts = [f"{lap['whole']} of {lap['rides']}" for lap in laps]
        times = [f", {float(median):.1f} s" if median else "" for median in map(median_lap, laps)]
        title = "as known" if world == "none" else f"`{world}`"
        rows.append([title, *(whole + time for whole, time in zip(texts, times, strict=True))])
    names = [read_head(DATA / f"{rider}.csv")["rider"] for rider in files]
    return markdown([["disturbances", *names], *rows]) + "".join(origin(DATA / f"{rider}.csv") for rider in files)


OPTIMA: Final = {
    "machine": "{machine}", "circuit": "{circuit}", "closest line, s": "{closest:.2f}", "best found, s": "{lap:.2f}",
    "over the closest line": "{excess:.2f} %", "`racer`, s": "{racer:.2f}", "over the best found": "{racer_loss:.2f} %",
    "classical, s": "{classical:.2f}", "over it": "{classical_loss:.2f} %",
}  # fmt: skip


def _best_laps(laps: str, racer: str, classical: str) -> list[dict[str, Any]]:
    """Return the best laps found beside the best ones of two riders, all names of data; losses in per cent."""
    bests = [
        {(row["vehicle"], row["circuit"]): float(row["best_s"]) for row in read_records(n)} for n in (racer, classical)
    ]
    found = []
    last = {(row["machine"], row["circuit"], row["seed"]): row for row in read_records(laps)}  # by round, rising
    fastest = {key[:2]: row for key, row in sorted(last.items(), key=lambda item: -float(item[1]["lap_s"]))}
    for _, row in sorted(fastest.items()):
        lap, closest = float(row["lap_s"]), float(row["closest_s"])
        numbers = {"lap": lap, "closest": closest, "excess": 100.0 * (lap / closest - 1.0)}
        for rider, best in zip(("racer", "classical"), bests, strict=True):
            time = best[row["machine"], row["circuit"]]
            numbers |= {rider: time, f"{rider}_loss": 100.0 * (time / lap - 1.0)}
        found.append(row | numbers)
    return found


def optima(name: str) -> str:
    """Return the best laps found, and by how much the best ones of other riders of the same pairs are slower."""
    files = name.split(",")
    rows = [cells(OPTIMA.values(), row) for row in _best_laps(*files)]
    return markdown([list(OPTIMA), *rows]) + "".join(origin(DATA / f"{file}.csv") for file in files)


CURVE_STEPS: Final = (0, 5, 10, 15, 20, 30, 40, 60, 80)


def lap_curves(name: str) -> str:
    """Return the best lap of each search after some of its rounds, and the processor time of all of them."""
    searches: dict[tuple[str, ...], list[dict[str, str]]] = defaultdict(list)
    for row in read_records(name):
        searches[row["machine"], row["circuit"], row["seed"]].append(row)
    last = max(len(points) for points in searches.values()) - 1
    steps = [step for step in CURVE_STEPS if step <= last]
    rows = []
    for key, points in searches.items():
        laps = [f"{float(points[step]['lap_s']):.2f}" if step < len(points) else "" for step in steps]
        laps.append(f"{float(points[-1]['lap_s']):.2f}")
        rows.append([*key, *laps, f"{float(points[-1]['seconds']) / 60.0:.1f} min"])
    names = ("machine", "circuit", "seed", *(f"round {step}, s" for step in steps), "last, s", "processor time")
    return markdown([names, *rows]) + origin(DATA / f"{name}.csv")


def random_circuits(name: str) -> str:
    """Return a table of laps of random circuits, one line for each machine."""
    by_machine: dict[str, list[dict[str, str]]] = defaultdict(list)
    for row in read_records(name):
        by_machine[row["vehicle"]].append(row)
        by_machine["all"].append(row)
    by_machine["all"] = by_machine.pop("all")
    rows = []
    for machine, laps in by_machine.items():
        rides, whole = (sum(int(lap[key]) for lap in laps) for key in ("rides", "whole"))
        excess = sorted(over_closest(lap) for lap in laps if median_lap(lap))
        middle = 0.5 * (excess[(len(excess) - 1) // 2] + excess[len(excess) // 2])
        rows.append([machine, f"{whole} of {rides}", *(f"{value:.1f} %" for value in (middle, excess[0], excess[-1]))])
    names = ("machine", "rides whole", "median over the closest line", "least", "largest")
    return markdown([names, *rows]) + origin(DATA / f"{name}.csv")


RACE_SUMS: Final = {
    "thrown": "machines that a contact threw down", "other_falls": "other falls", "passes": "passes",
    "contacts": "contacts", "avoidable": "avoidable contacts", "passed_through": "passed through each other unnoticed",
}  # fmt: skip


def race_totals(name: str) -> str:
    """Return totals of races, and rates with their exact 95 % intervals of a Poisson process."""
    races, rows = read_records(name), []
    for key, title in RACE_SUMS.items():
        total = sum(int(row[key]) for row in races)
        rows.append([title, str(total), "{:.2f} ({:.2f} to {:.2f})".format(*_rate(total, len(races)))])
    ended, same = sum(row["ended"] == "True" for row in races), sum(row["replay"] == "same" for row in races)
    rows.append(["races that ended; the same again from their commands", f"{ended}; {same} of {len(races)}", ""])
    finished = sum(int(row["finished"]) for row in races)
    rows.append(["machines that finished", f"{finished} of {6 * len(races)}", ""])
    return markdown([["figure", "sum", "a race"], *rows]) + origin(DATA / f"{name}.csv")


def race_back(name: str) -> str:
    """Return what riders gain from the back of the grid: means with 95 % intervals, of Student and of Poisson."""
    riders: dict[str, list[dict[str, str]]] = defaultdict(list)
    for row in read_records(name):
        riders[row["rider"]].append(row)
    rows = []
    for rider, races in riders.items():
        gained = np.array([int(race["gained"]) for race in races])
        half = student.ppf(0.975, len(races) - 1) * gained.std(ddof=1) / math.sqrt(len(races))
        texts = [f"{gained.mean():.2f} ({gained.mean() - half:.2f} to {gained.mean() + half:.2f})"]
        falls = sum(race["end"] not in ("finished", "running") for race in races)
        sums = [sum(int(race[key]) for race in races) for key in ("contacts", "avoidable")]
        for total in (*sums, falls):
            texts.append("{:.2f} ({:.2f} to {:.2f})".format(*_rate(total, len(races))))
        rows.append([f"`{rider}`", str(len(races)), *texts])
    names = ("last on the grid", "races", "places gained", "contacts", "avoidable", "own falls")
    return markdown([names, *rows]) + origin(DATA / f"{name}.csv")


def _rate(total: int, count: int) -> tuple[float, float, float]:
    """Return a rate with its exact 95 % interval of a Poisson process."""
    low = 0.5 * chi2.ppf(0.025, 2 * total) if total else 0.0
    return total / count, low / count, 0.5 * chi2.ppf(0.975, 2 * total + 2) / count


def baselines(name: str) -> str:
    """Return learners of frozen tasks: interquartile means over seeds, with their bootstrap intervals."""
    groups: dict[tuple[str, ...], list[dict[str, str]]] = defaultdict(list)
    for row in read_records(name):
        groups[row["task"], row["learner"]].append(row)
    rows = []
    order = list(BENCHMARK_STEPS)
    for (task, learner), points in sorted(groups.items(), key=lambda group: (order.index(group[0][0]), group[0][1])):
        decisions = max((row["decisions"] for row in points), key=int)
        runs = [row for row in points if row["decisions"] == decisions]
        found = [bootstrap([float(run[key]) for run in runs]) for key in ("error", "score")]
        text = "{:.3f} ({:.3f} to {:.3f})" if len(runs) > 1 else "{:.3f}"
        texts = [text.format(*interval) for interval in found]
        failed = np.mean([int(run["failed"]) for run in runs])
        spent = np.median([float(run["processor_s"]) for run in runs])
        steps = f"{int(decisions):,}"
        rows.append([f"`{task}`", learner, steps, str(len(runs)), *texts, f"{failed:.1f}", f"{spent:.0f} s"])
    names = ("task", "learner", "decisions", "seeds", "error (95 %)", "score (95 %)", "failed of 20", "processor time")
    return markdown([names, *rows]) + origin(DATA / f"{name}.csv")


def headline(name: str) -> str:
    """Return the table of README: the ends of the tables of the results' page."""
    from bike_training.commands.reproduce import PAPERS
    from bike_training.reproduce.data import read_data

    found = PAPERS["bicycle"]
    statement = next(each for each in found.statements if each.source == "Table 6")
    of_paper = statement.find(read_data(found.file, DATA / "bicycle_paper")).text
    riders = {row["figure"]: row for row in read_records("bicycle_riders")}
    modes = {row["figure"]: row["`pybullet` 1 ms"] for row in read_records("bicycle_validation")}
    engines = {row["figure"]: float(row["value"].replace(",", "")) for row in read_records("speed")}
    pairs_ = read_records("racer_pairs")
    racer = [over_closest(row) for row in pairs_]
    machines = {row["vehicle"] for row in pairs_}
    classical = [
        float(row["excess of closest"].rstrip("%"))
        for row in read_records("classical_laps")
        if row["machine"] in machines
    ]
    lapped = f"{sum(row['whole'] == row['rides'] for row in pairs_)} of {len(pairs_)}"
    sac, exact = (
        f"{riders['largest distance'][f'`{rider}`']}, {riders['largest mean distance'][f'`{rider}`']}"
        for rider in ("whipple", "whipple_exact")
    )
    speeds = f"{modes['`weave_speed_m_s`']}, {modes['`capsize_speed_m_s`']} m/s"
    ratios = [f"{engines[f'`{kind}_to_exudyn_ratio`']:.1f}" for kind in ("pybullet", "whipple")]
    rows = [
        [
            "Bicycle, SAC: largest distance, largest mean distance",
            re.sub(r" at [\d.]+ m/s", "", of_paper),
            "0.69 m, 0.09 m",
            "`bike reproduce bicycle`",
        ],
        ["Bicycle, SAC from an imitation: the same", sac, "-", "`bike evaluate`"],
        ["Bicycle, learned through gradients: the same", exact, "-", "`bike evaluate whipple_exact`"],
        ["Bicycle, PyBullet at 1 ms: weave, capsize speed", speeds, "4.29, 6.02 m/s", "`bike validate`"],
        ["Superbikes, one guided actor: pairs lapped", lapped, "14 of 15", "`bike evaluate racer`"],
        ["`racer` over the closest line's theoretical lap", f"{min(racer):.1f} to {max(racer):.1f} %", "-", "the same"],
        ["classical rider over it", f"{min(classical):.1f} to {max(classical):.1f} %", "-", "`bike ride --all`"],
        ["Speed against Exudyn: PyBullet, compiled", f"{' and '.join(ratios)} times", "-", "`bike bench`"],
    ]
    files = [DATA / file if (DATA / file).is_dir() else DATA / f"{file}.csv" for file in name.split(",")]
    heads = {file: read_head(file) for file in files}
    old = sorted({source for head in heads.values() for source in changed_sources(head)})
    line = "Measured at commits " + ", ".join(dict.fromkeys(f"{h['commit']} ({h['date']})" for h in heads.values()))
    line = f"*{line}{'; changed since: ' + ', '.join(old) if old else ''}*"
    table = markdown([("figure", "here", "published", "command"), *rows])
    return f"{table}\n{fill(line, 120, break_long_words=False, break_on_hyphens=False)}\n"


def paper(name: str) -> str:
    """Return a table of a paper's experiments: FOLDER statements, or FOLDER and the heading of a table."""
    from bike_training.commands.reproduce import PAPERS
    from bike_training.reproduce.data import read_data
    from bike_training.reproduce.statement import verdict_table

    folder, _, title = name.partition(" ")
    found = PAPERS[folder.split("_")[0]]
    data = read_data(found.file, DATA / folder)
    if title == "statements":
        return verdict_table(found.statements, data) + origin(DATA / folder)
    written = {re.split("[:,]", heading)[0]: write for heading, write in found.written.items()}
    return written[title](data) + origin(DATA / folder)


def command(name: str) -> str:
    """Return summary, options and examples of a command."""
    from bike_training.commands.declarations import COMMANDS, CommandParser

    declared = COMMANDS[name]
    parser = CommandParser(name)
    formatter = HelpFormatter(parser.prog)
    lines = [f"- {_written(each)}: {_help(formatter, each)}" for each in parser._actions if each.dest != "help"]
    intro = _wrapped(f"{parser.description} Duration: {declared.duration}.", "")
    return f"{intro}\n{''.join(map(_wrapped, lines))}\n```text\n{dedent(declared.examples).strip()}\n```\n"


def _wrapped(text: str, indent: str = "  ") -> str:
    return fill(text, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False) + "\n"


def _help(formatter: HelpFormatter, action: Action) -> str:
    return re.sub(r"\s+", " ", formatter._expand_help(action)).replace("<", "&lt;")


def _written(action: Action) -> str:
    values = f"{{{','.join(map(str, action.choices))}}}" if action.choices else action.metavar or action.dest.upper()
    value = "" if action.nargs == 0 else values if isinstance(values, str) else " ".join(values)
    return f"`{' '.join(filter(None, [', '.join(action.option_strings), value]))}`"


def parameters(node: str) -> str:
    """Return the parameters of a node."""
    from bike_policy import drive, estimate, joy
    from bike_sim.ros import race_node, record, sim_node

    nodes = {"sim_node": sim_node, "race_node": race_node, "drive": drive, "joystick": joy, "record": record}
    nodes["estimate"] = estimate
    specs: Any = nodes[node].SPECS
    text = ""
    for spec in specs:
        default = "none" if spec.default in ("", ()) else str(spec.default)
        default = default.lower() if isinstance(spec.default, bool) else default
        meaning = spec.text + (f" One of {', '.join(spec.choices)}." if spec.choices else "")
        text += _wrapped(f"- `{spec.name}` ({default}; {'start' if spec.fixed else 'any time'}): {meaning}")
    return text


KINDS: Final[Mapping[str, Callable[[str], str]]] = {
    function.__name__: function
    for function in (
        shipped,
        pairs,
        gains,
        optima,
        lap_curves,
        disturbed,
        random_circuits,
        race_totals,
        race_back,
        baselines,
        headline,
        paper,
        command,
        parameters,
    )
}


def filled(text: str) -> str:
    """Return a page with all its marked tables.

    Raises:
        KeyError, OSError, ValueError: a table that is not known, or data that cannot be read.
    """

    def write(match: re.Match[str]) -> str:
        kind, _, name = match[2].partition(" ")
        return f"{match[1]}\n{KINDS[kind](name).strip()}\n\n{match[3]}"

    return BLOCK.sub(write, text)


def main() -> None:
    """Fill all pages, and name those that changed."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        if (new := filled(text)) != text:
            page.write_text(new, encoding="utf-8")
            print(page.relative_to(ROOT))


if __name__ == "__main__":
    main()
