"""Make the data of the documents' tables anew: ``make measure``, or ``tools/measure.py [CLASS] [--only NAME]``.

It runs the command in the head of each file of `TABLES`, one on each core, and writes the file with its head. What is
no older than its sources is left alone, so that the same call goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Final, NamedTuple

from figures import DATA, ROOT, SOURCES, changed_sources, read_head

from bike_policy.contract.bundle import shipped_policies
from bike_training.gymnasium_ids import BENCHMARK_STEPS
from bike_training.rollout.evaluation import summary

CLASSES: Final[Mapping[str, float]] = {"minutes": 900.0, "hour": 7200.0, "days": float("inf")}
"""Longest duration of a measurement, s."""
Rows = list[list[Any]]


def columns(item: str, **texts: str) -> Callable[[Sequence[Any]], Rows]:
    """Return what makes a row of each entry of a list of figures, of all answers, by format strings."""

    def rows(answers: Sequence[Any]) -> Rows:
        found = [answer["figures"] for answer in answers]
        entries = [figures | entry | _more(entry, figures) for figures in found for entry in figures[item]]
        return [list(texts), *([text.format(**entry) for text in texts.values()] for entry in entries)]

    return rows


def _more(entry: Mapping[str, Any], figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures of an entry that its command does not write."""
    paths = [path for path in figures.get("random", ()) if path["speed_m_s"] == entry["speed_m_s"]]
    found: dict[str, Any] = {f"random_{key}": max(path[key] for path in paths) for key in ("mean_m", "max_m") if paths}
    if "sections" in entry:
        found["section"] = max(entry["sections"], key=lambda part: part["max_m"])["section"]
    return found | ({"slowest_s": max(entry["laps_s"], default=float("nan"))} if "laps_s" in entry else {})


ROAD_TESTS: Final = {
    "to_100_s": "0 to 100 km/h, s",
    "quarter_mile_s": "quarter mile, s",
    "quarter_mile_km_h": "speed there, km/h",
    "top_km_h": "top speed, km/h",
    "stop_100_m": "stop from 100 km/h, m",
}


def checks(answers: Sequence[Any]) -> Rows:
    """Return the checks of a validation, a column for each answer, and ranges of modes beside published ones."""
    found = [{check["name"]: check["measured"] for check in answer["checks"]} for answer in answers]
    rows = []
    for name, title in ((check["name"], check["title"]) for check in answers[0]["checks"]):
        same = [check for answer in answers for check in answer["checks"] if check["name"] == name]
        allowed = " or ".join(dict.fromkeys(_allowed(check) for check in same))
        label = f"`{name}`" if len(answers) > 1 else title
        rows.append([label, *(_short(each.get(name)) for each in found), allowed])
    for mode in answers[0]["figures"].get("ranges", ()):
        low, high, *published = (_short(mode[key]) for key in ("low", "high", "published_low", "published_high"))
        rows.append([mode["title"], f"{low} to {high}", f"published: {published[0]} to {published[1]}"])
    machines = answers[0]["figures"].get("performance", ())
    for machine in machines if len(machines) > 1 else ():
        rows += [[f"{machine['vehicle']}: {title}", _short(machine[key]), "-"] for key, title in ROAD_TESTS.items()]
    engines = [f"`{a.get('engine', 'measured')}` {1e3 * a['time_step_s']:g} ms" for a in answers]
    return [["figure", *(engines if len(answers) > 1 else ["measured"]), "published or allowed"], *rows]


def _allowed(check: Mapping[str, Any]) -> str:
    low, high, reference = (_short(check[key]) for key in ("low", "high", "reference"))
    limits = f"at most {high}" if low in ("-", "0") else f"{low} at least" if high == "-" else f"{low} to {high}"
    return reference if reference != "-" else high if low == high else limits


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.6g}" if 1.0 <= abs(value) < 1e5 else f"{value:.2g}"


RIDERS: Final = (
    ("speeds ridden to the end", "21 of 21", "{completed_count} of {rides_count}"),
    ("mean of the mean distances", "", "{average_mean_m:.4f} m"),
    ("largest mean distance", "0.09 m", "{worst_mean_m:.4f} m"),
    ("largest distance", "0.69 m", "{worst_max_m:.3f} m"),
    ("steer rate, RMS", "", "{average_steer_rate_deg_s:.2f} °/s"),
    ("random rides", "all", "{random_completed_count} of {random_rides_count}"),
    ("mean of their mean distances", "", "{random_average_mean_m:.4f} m"),
    ("largest distance in them", "", "{random_worst_max_m:.3f} m"),
    ("spectral radius on a straight, worst of 2 to 7 m/s", "", "{worst_spectral_radius_upright:.3f}"),
    ("the same in a turn of 20 m", "", "{worst_spectral_radius_turn:.3f}"),
    ("set point left swinging on a straight, standard deviation", "", "{worst_swing_deg:.1g}°"),
)
RIDDEN: Final = "{completed_count} of {rides_count}; {average_mean_m:.4f}, {worst_mean_m:.4f}, {worst_max_m:.3f} m"


def ridden_by(rider: str) -> str:
    """Return the heading of a column of `RIDDEN`."""
    return f"`{rider}`: rides; mean, worst mean, largest"


def riders(answers: Sequence[Any]) -> Rows:
    """Return riders of the bicycle side by side: of one ride, under disturbances, or on several courses."""
    first = answers[0]["figures"]["riders"]
    names = [rider["policy"] for rider in first]
    if not first[0]["disturbed"] and len(answers) == 1:
        rows = [[title, paper, *(text.format(**rider) for rider in first)] for title, paper, text in RIDERS]
        return [["figure", "paper's best controller", *(f"`{name}`" for name in names)], *rows]
    groups = [(Path(a["figures"]["riders"][0]["course"]).stem, a["figures"]["riders"]) for a in answers]
    if len(answers) == 1:
        groups = [(each[0]["disturbances"], each) for each in zip(*(r["disturbed"] for r in first), strict=True)]
    rows = [[name, *(RIDDEN.format(**rider) for rider in each), nearer(*each)] for name, each in groups]
    kind = "disturbances" if len(answers) == 1 else "path"
    return [[kind, *map(ridden_by, names), f"`{names[0]}` is nearer"], *rows]


def nearer(rider: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Return in how many rides a rider has a smaller mean distance than another one, or comes to the end alone."""
    pairs = list(zip(rider["rides"], other["rides"], strict=True))
    smaller = [a["completed"] and (a["mean_m"] < b["mean_m"] or not b["completed"]) for a, b in pairs]
    return f"{sum(smaller)} of {len(pairs)}"


def draws(answers: Sequence[Any]) -> Rows:
    """Return riders of the bicycle under draws of the same disturbances, a row for each speed."""
    found: dict[float, dict[str, list[Any]]] = {}
    for rider in (rider for answer in answers for rider in answer["figures"]["riders"]):
        for ride in (ride for each in rider["disturbed"] for ride in each["rides"]):
            found.setdefault(ride["speed_m_s"], {}).setdefault(rider["policy"], []).append(ride)
    rows = [
        [f"{speed:g}", *(RIDDEN.format(**summary("", rides)) for rides in of.values())]
        for speed, of in sorted(found.items())
    ]
    return [["speed, m/s", *map(ridden_by, next(iter(found.values())))], *rows]


def estimates(answers: Sequence[Any]) -> Rows:
    """Return riders of the bicycle on the true state, and on estimates of it from sensors."""
    rows = []
    for rider in answers[0]["figures"]["riders"]:
        for source, rides in (("the true state", rider), *((f"`{d['disturbances']}`", d) for d in rider["disturbed"])):
            ratio = rides["average_mean_m"] / rider["average_mean_m"]
            worst = max(a["mean_m"] / b["mean_m"] for a, b in zip(rides["rides"], rider["rides"], strict=True))
            ratios = f"{ratio:.2f}", f"{worst:.2f}"
            rows.append([f"`{rider['policy']}`", source, *RIDDEN.format(**rides).split("; "), *ratios])
    names = ("mean over that of the true state", "the same at the worst speed")
    return [["rider", "rides on", "rides", "mean, worst mean, largest", *names], *rows]


def races(answers: Sequence[Any]) -> Rows:
    """Return laps of superbikes as ``bike evaluate`` writes them."""
    found = answers[0]["figures"]["races"]
    return [list(found[0]), *(list(race.values()) for race in found)]


ENGINES: Final = {
    "compiled, 1 ms": "--time-step 0.001", "compiled, 2 ms": "--time-step 0.002",
    "compiled, 4 ms": "--time-step 0.004", "PyBullet, 2 ms": "--engine pybullet",
}  # fmt: skip


def engines(answers: Sequence[Any]) -> Rows:
    """Return rides of the same starts on each of `ENGINES`, a row for each rider, machine and circuit."""
    found: dict[tuple[str, ...], list[str]] = {}
    for figures in (answer["figures"] for answer in answers):
        for race in figures["races"]:
            texts = found.setdefault((f"`{figures['policy']}`", race["vehicle"], race["circuit"]), [])
            texts.append("{whole} of {rides}; {median_s:.2f} s".format(**race))
    return [["rider", "machine", "circuit", *ENGINES], *([*key, *texts] for key, texts in found.items())]


def speeds(answers: Sequence[Any]) -> Rows:
    """Return all single figures of the benchmark."""
    figures = {key: value for key, value in answers[0]["figures"].items() if isinstance(value, float)}
    return [["figure", "value"], *([f"`{key}`", f"{value:,.4g}"] for key, value in figures.items())]


def scores(answers: Sequence[Any]) -> Rows:
    """Return scores of riders in frozen tasks."""
    rows = [
        [
            f"`{f['task']}`",
            f"`{f['rider']}`",
            f"{f['error']:.4f}",
            f"{f['failed']}",
            f"{f['score'] + 0.0:.3f}".replace("-0.000", "0.000"),
        ]
        for f in (answer["figures"] for answer in answers)
    ]
    return [["task", "rider", "error", "failed episodes of 20", "score"], *rows]


def bicycles(answers: Sequence[Any]) -> Rows:
    """Return measured bicycles: where they balance themselves, and the largest error of their eigenvalues."""
    keys = ("stable_from_m_s", "stable_to_m_s", "error_1_s")
    rows = [[b["bicycle"], *(_short(b[key]) for key in keys)] for b in answers[0]["figures"]["bicycles"]]
    return [["bicycle", "balances itself from, m/s", "to, m/s", "eigenvalues, largest error, 1/s"], *rows]


def worlds(answers: Sequence[Any]) -> Rows:
    """Return how riders met unknown worlds, a row for each rider and kind of world."""
    rows = []
    for found in (answer["figures"] for answer in answers):
        for kind, each in found["summary"].items():
            texts = [text.format(**each) for text in WORLDS.values()]
            over = "{excess:+.1%}".format(**each) if each["compared"] else "-"
            over += " ({excess_low:+.1%} to {excess_high:+.1%})".format(**each) if each["compared"] > 1 else ""
            rows.append([kind if kind == "worlds" else f"`{kind}`", f"`{found['policy']}`", *texts, over])
    return [["worlds", "rider", *WORLDS, "median lap over the oracle's (95 %)"], *sorted(rows, key=lambda row: row[0])]


class Table(NamedTuple):
    """A data file.

    Attributes:
        rows: makes its rows of the commands' answers.
        variants: words behind the command of its head, a run each; one that does not begin with an option replaces its
            first argument.
    """

    rows: Callable[[Sequence[Any]], Rows]
    variants: tuple[str, ...] = ("",)


def _circuits(first: int, last: int) -> tuple[str]:
    return ("--course " + ",".join(f"random_circuit:{seed}" for seed in range(first, last + 1)),)


WORLDS: Final = {
    "rides that count": "{counted} of {rides}", "whole": "{whole}",
    "share (95 %)": "{share:.1%} ({share_low:.1%} to {share_high:.1%})", "lost in the first lap": "{lost_first}",
}  # fmt: skip
EVALUATION: Final = {
    "speed, m/s": "{speed_m_s:.2f}", "mean, m": "{mean_m:.4f}", "largest, m": "{max_m:.3f}",
    "roll, °": "{max_roll_deg:.0f}", "worst section": "{section}", "random paths: mean, m": "{random_mean_m:.3f}",
    "random paths: largest, m": "{random_max_m:.3f}",
}  # fmt: skip
LAPS: Final = {
    "machine": "{vehicle}", "circuit": "{course}", "slowest of three laps, s": "{slowest_s:.2f}",
    "followed line, s": "{limit_s:.2f}", "excess": "{excess:.1%}", "closest line, s": "{closest_limit_s:.2f}",
    "excess of closest": "{closest_excess:.1%}", "falls": "{falls}", "walls": "{walls}",
}  # fmt: skip
TORQUES: Final = {
    "speed, m/s": "{speed_m_s:.0f}", "roll, °": "{roll_deg:.0f}", "measured, N m": "{torque_nm:.2f}",
    "published, N m": "{published_nm:.2f}", "miss": "{miss:.0%}", "by the tyre's own moment": "{miss_by_twist:.0%}",
}  # fmt: skip
ENERGY: Final = {
    "step, s": "{step_s:g}", "engine": "{engine_j:.0f}", "brakes": "{brakes_j:.0f}", "air": "{air_j:.0f}",
    "along": "{tyres_longitudinal_j:.0f}", "across": "{tyres_lateral_j:.0f}", "rolling": "{tyres_rolling_j:.0f}",
    "twisting": "{tyres_twisting_j:.0f}", "load": "{tyres_load_j:.0f}", "dampers": "{dampers_j:.0f}",
    "springs": "{springs_j:.0f}", "rider": "{rider_j:.0f}", "stored": "{stored_j:.0f}", "rest": "{rest:.1e}",
}  # fmt: skip
SUSPENDED_LAPS: Final = {
    "machine": "{vehicle}", "circuit": "{course}", "flying lap, s": "{lap_s:.2f}",
    "closest line, s": "{closest_limit_s:.2f}", "excess of closest": "{closest_excess:.2%}", "falls": "{falls}",
    "largest distance to the line, m": "{line_error_max_m:.1f}",
}  # fmt: skip
SHAKE: Final = {
    "machine": "{vehicle}", "to 55° with any brake, g": "{shake_g:.3f}",
    "upright on the brake and in turns without, g": "{shake_steady_g:.3f}",
    "full drive out of a lean, g": "{shake_drive_g:.3f}", "weave hands off, 1/s": "{weave_real_1_s:.2f}",
    "wobble hands off, 1/s": "{wobble_real_1_s:.2f}", "weave hands on, 1/s": "{held_weave_real_1_s:.2f}",
    "wobble hands on, 1/s": "{held_wobble_real_1_s:.2f}", "0 to 100 km/h, s": "{to_100_s:.2f}",
    "end of a quarter mile, km/h": "{quarter_mile_km_h:.0f}", "top speed, km/h": "{top_km_h:.0f}",
}  # fmt: skip
EXPORTED: Final = {
    "policy": "`{name}`", "weights": "{weights}", "bytes": "{weight_bytes:,}", "multiply-adds": "{multiply_adds:,}",
    "ONNX, largest difference": "{onnx_difference:.1e}", "C, largest difference": "{difference:.1e}",
    "of which rounding, RMS": "{rounding_rms:.1e}", "µs an answer, here": "{answer_us:.1f}",
    "ms counted, Cortex-M4": "{cortex_m4_ms:.2f}",
}  # fmt: skip
SUSPENDED: Final = [f"{name}_suspended" for name in ("panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr")]
CIRCUITS: Final = ("barcelona", "cremona", "phillip_island")
STEPS: Final = ("", "--time-step 0.005", "--engine whipple", "--engine whipple --time-step 0.005")
TABLES: Final[Mapping[str, Table]] = {
    "bicycle_validation": Table(checks, STEPS),
    "bicycle_evaluation": Table(columns("rides", **EVALUATION)),
    "bicycle_riders": Table(riders),
    "bicycle_disturbances": Table(riders),
    "bicycle_noise": Table(draws, tuple(f"--seed {seed}" for seed in range(20))),
    "bicycle_estimates": Table(estimates),
    "outside_paths": Table(
        riders, tuple(f"--course {path.relative_to(ROOT)}" for path in sorted(DATA.glob("paths/*")))
    ),
    "gsxr1000_validation": Table(checks),
    "gsxr1000_torques": Table(columns("torques", **TORQUES)),
    "gsxr1000_energy": Table(columns("energy", **ENERGY)),
    "measured_bicycles": Table(bicycles),
    "superbike_validation": Table(checks),
    "suspended_laps": Table(
        columns("pairs", **SUSPENDED_LAPS),
        tuple(f"--vehicle {name} --course {circuit}" for name in SUSPENDED for circuit in CIRCUITS),
    ),
    "suspended_shake": Table(columns("performance", **SHAKE), tuple(f"--vehicle {name}" for name in SUSPENDED)),
    "classical_laps": Table(columns("pairs", **LAPS)),
    "racer_pairs": Table(races),
    "racer_100_starts": Table(races),
    "classical_pairs": Table(races),
    "guide_pairs": Table(races),
    "adaptive_disturbed": Table(races),
    "adaptive_pairs": Table(races),
    "adaptive_engines": Table(
        engines, tuple(f"{rider} {words}" for rider in ("adaptive", "classical") for words in ENGINES.values())
    ),
    "adaptive_random": Table(races, _circuits(100, 199)),
    "classical_disturbed": Table(races),
    "worlds": Table(worlds, ("careful", "adaptive")),
    "held_pairs": Table(races),
    "racer_random": Table(races, _circuits(100, 139)),
    "generalist_pairs": Table(races),
    "generalist_random": Table(races, _circuits(100, 199)),
    "speed": Table(speeds),
    "benchmark_scores": Table(
        scores,
        tuple(
            f"{rider} --task {task}"
            for task, steps in BENCHMARK_STEPS.items()
            for rider in (("lqr", "whipple", "stanley") if steps < 1000 else ("classical", "racer", "adaptive"))
        ),
    ),
    "exported_policies": Table(
        columns("headers", **EXPORTED),
        tuple(f"{name} --weights {kind}" for name in shipped_policies() for kind in ("float", "int8")),
    ),
}
"""Data that one command makes. Trainings and papers take days: theirs is what ``bike reproduce`` and ``bike sweep``
leave, which go on where they were stopped too."""


def _git(*words: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True).stdout.strip()


def _sources(name: str) -> list[str]:
    return [path for source in read_head(DATA / f"{name}.csv")["depends"].split() for path in SOURCES[source]]


def words_of(name: str, variant: str) -> list[str]:
    """Return the words of the command in a head, behind ``bike``, and of a variant of it."""
    words = read_head(DATA / f"{name}.csv")["command"].removeprefix("bike ").split()
    own = variant.split()
    if variant and not variant.startswith("-"):
        words[1] = own.pop(0)
    return [*words, *own]


def answer(name: str, variant: str) -> tuple[Any, float]:
    """Give a command, and return what it answered and the seconds that it took."""
    words = words_of(name, variant)
    words += [] if "--json" in words else ["--json"]
    with tempfile.TemporaryDirectory() as folder:
        out = ["--out", folder] if words[0] == "evaluate" else []
        began = time.monotonic()
        bike = [sys.executable, "-m", "bike_training.cli", *words, *out]
        done = subprocess.run(bike, cwd=ROOT, capture_output=True, text=True, check=False)
    if not done.stdout.startswith("{"):
        raise RuntimeError(f"{name}: bike {' '.join(words)}: {done.stderr.strip().splitlines()[-1:]}")
    return json.loads(done.stdout), time.monotonic() - began


def write(name: str, answers: Sequence[tuple[Any, float]]) -> None:
    """Write a data file with its head."""
    path = DATA / f"{name}.csv"
    commit, date = _git("log", "-1", "--format=%h %cs", "--", *_sources(name)).split()
    head = read_head(path) | {"commit": commit, "date": date, "duration": f"{sum(s for _, s in answers):.0f} s"}
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"# {key}: {value}\n" for key, value in head.items())
        csv.writer(file, lineterminator="\n").writerows(TABLES[name].rows([found for found, _ in answers]))


def measure(name: str) -> None:
    """Make a data file anew."""
    write(name, [answer(name, variant) for variant in TABLES[name].variants])


def duration(name: str) -> float:
    """Return how long the measurement took last time, s."""
    return float(read_head(DATA / f"{name}.csv").get("duration", "600 s").removesuffix(" s"))


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("duration", nargs="?", choices=CLASSES, default="hour", help="longest measurements")
    parser.add_argument("--only", choices=TABLES, help="one data file, also where it is not out of date")
    args = parser.parse_args()
    old = [name for name in TABLES if changed_sources(read_head(DATA / f"{name}.csv"))]
    names = [args.only] if args.only else [name for name in old if duration(name) <= CLASSES[args.duration]]
    sources = {
        path for name in names for s in read_head(DATA / f"{name}.csv")["depends"].split() for path in SOURCES[s]
    }
    if sources and (dirty := _git("status", "--porcelain", "--", *sources)):
        parser.error(
            f"sources are not committed, so the data would name a commit that it is not of: {dirty.split()[1]}"
        )
    waiting = {name: duration(name) for name in sorted(names, key=duration, reverse=True)}
    cores = os.cpu_count() or 1
    # Speeds last and alone: what runs beside them would be in them.
    for group, beside in (([n for n in waiting if n != "speed"], cores), ([n for n in waiting if n == "speed"], 1)):
        with ThreadPoolExecutor(beside) as pool:
            runs = {pool.submit(measure, name): name for name in group}
            for run in as_completed(runs):
                run.result()
                del waiting[runs[run]]
                left = sum(waiting.values()) / 60.0 / cores
                print(f"{runs[run]} written; about {left:.0f} minutes left", flush=True)


if __name__ == "__main__":
    main()
