"""`bike analyze`: figures, comparisons, plots and pages of recordings and of sweeps, without ROS."""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from typing import Any, Final

from bike_analysis.figures.cells import cells, table_text
from bike_analysis.figures.results import SCHEMA
from bike_analysis.formats.topics import read_topic, write_topic
from bike_analysis.read.container import MAX_FAULT, shown
from bike_analysis.report import Video, analyze, keep_recordings
from bike_analysis.sweeps.report import COMPARISONS, GROUPS, labelled, report_sweep

SWEEP_SCHEMA: Final = "bike.analyze_sweep/1"
TOPIC_SCHEMA: Final = "bike.analyze_topic/1"
DATASET_SCHEMA: Final = "bike.analyze_dataset/1"
MOST_SECTORS: Final = 6
"""Sectors whose times fit beside a lap. A path has a section for each of its elements, told in lines of their own."""
MAX_LINE: Final = 10_000
"""Characters of a printed line; a table of many sectors is wide."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Analyze recordings, print their figures unless `args.json`, and return them, schema ``bike.analyze/4``.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If no file is a recording of a ride, or nothing of it can be read.
        ValueError: If the distance of rows is not positive, or a file to be written is one of the recordings.
        OSError: If a file cannot be read or written.
    """
    out, first = args.out, args.objects[0]
    if out is None and not args.json:
        out = first if first.is_dir() else first.parent
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of NumPy about damaged numbers
        figures = analyze(
            args.objects,
            out,
            namespace=args.namespace,
            csv=args.csv,
            parquet=args.parquet,
            station_m=args.station,
            ld=args.ld,
            video=None if args.video is None else Video(args.video, args.begin, args.duration),
        )
    for warning in figures["warnings"]:
        print(f"warning: {shown(warning, MAX_FAULT)}", file=sys.stderr)
    if not args.json:
        print(text_of(figures))
    return {"schema": SCHEMA, "ok": len(figures["recordings"]) == len(args.objects), "figures": figures}


def run_topic(args: argparse.Namespace) -> dict[str, Any]:
    """Write a topic of a recording as a table, or print its head and columns; any ROS 2 bag will do.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If there is no such topic, or nothing of it can be read.
        ValueError: If a file to be written is the recording.
        OSError: If a file cannot be read or written.
    """
    path, files = args.objects[0], {"csv": args.csv, "parquet": args.parquet}
    keep_recordings([path], [file for file in files.values() if file])
    table, warnings = read_topic(path, args.topic)
    for warning in warnings:
        print(f"warning: {shown(warning, MAX_FAULT)}", file=sys.stderr)
    written = {name: str(write_topic(table, file, parquet=name == "parquet")) for name, file in files.items() if file}
    columns = {name: str(kind) for name, kind in table.dtypes.items()}
    figures = {"topic": args.topic, "messages": len(table), "columns": columns, "warnings": list(warnings), **written}
    if not args.json:
        lines = [f"{len(table)} messages of {args.topic}", *table_text({"column": "{name}", "type": "{kind}"}, [
            {"name": name, "kind": kind} for name, kind in columns.items()
        ]), *(f"{name}: {file}" for name, file in written.items())]  # fmt: skip
        print("\n".join(shown(line, MAX_LINE) for line in lines))
    return {"schema": TOPIC_SCHEMA, "ok": True, "figures": figures}


def run_dataset(args: argparse.Namespace) -> dict[str, Any]:
    """Write recorded rides as data sets of learning.

    Raises:
        FileNotFoundError: there is no such recording.
        ModuleNotFoundError: a package that writes them is not installed.
        ValueError: a ride that is none of the task, or a data set that is there already.
    """
    from bike_training.exporting.datasets import TASK, read_episodes, write_lerobot, write_minari  # they load the tasks

    episodes = read_episodes(args.objects)
    figures: dict[str, Any] = {"task": TASK, "episodes": len(episodes)}
    figures["steps"] = sum(len(episode.rewards) for episode in episodes)
    figures["mean_reward"] = float(sum(episode.rewards.sum() for episode in episodes)) / figures["steps"]
    if args.minari is not None:
        figures["minari"] = write_minari(episodes, args.minari, args.name)
    if args.lerobot is not None:
        figures["lerobot"] = str(write_lerobot(episodes, args.lerobot))
    if not args.json:
        print("\n".join(shown(f"{name}: {value}", MAX_LINE) for name, value in figures.items()))
    return {"schema": DATASET_SCHEMA, "ok": True, "figures": figures}


def run_sweep(args: argparse.Namespace) -> dict[str, Any]:
    """Report a sweep, print tables with intervals unless `args.json`; not ok where a run has not finished.

    Raises:
        FileNotFoundError: there is no such sweep.
        ValueError: a damaged file of it.
        OSError: a file cannot be written.
    """
    sweep = args.objects[0]
    figures = report_sweep(sweep, args.out or sweep / "report")
    if not args.json:
        print("\n".join(shown(line, MAX_LINE) for line in _sweep(figures)))
    finished = figures["finished"] == figures["runs"]
    return {"schema": SWEEP_SCHEMA, "ok": finished, "figures": figures}


def text_of(figures: dict[str, Any]) -> str:
    """Return figures as tables for people.

    Args:
        figures: of `bike_analysis.report.analyze`.
    """
    rides, several = figures["rides"], len(figures["recordings"]) > 1
    named = [{**ride, "recording": Path(ride["recording"]).stem} for ride in rides]
    for ride in named:
        ride["ended_by"] = ride["ended_by"].replace("_", " ")
    lines = table_text({"recording": "{recording}", **RIDES} if several else RIDES, named)
    if rides and rides[0]["sections"]:
        lines += table_text(SECTIONS, rides[0]["sections"])
    for ride in rides:
        lines += _laps(ride)
    for comparison in figures["comparisons"]:
        lines += _comparison(comparison)
    for recording in figures["recordings"]:
        median, p99 = recording["latency_median_s"], recording["latency_p99_s"]
        name = f"{recording['recording']}: " if several else ""
        if median is not None and p99 is not None:
            times = f"{1e3 * median:.3f} ms (median), {1e3 * p99:.3f} ms (99th percentile)"
            lines.append(f"{name}the policy answered in {times}, by its last report")
        if recording["dropped_messages"]:
            lines.append(f"{name}the recorder dropped {recording['dropped_messages']} messages")
    lines += [f"{name}: {figures[name]}" for name in ("page", "csv", "parquet", "ld", "video") if name in figures]
    return "\n".join(shown(line, MAX_LINE) for line in lines)


RIDES: Final = {
    "ride": "{ride}", "course": "{course}", "m/s": "{speed_mean_m_s:.2f}", "s": "{duration_s:.1f}",
    "m": "{distance_m:.0f}", "mean m": "{mean_error_m:.3f}", "rms m": "{rms_error_m:.3f}", "max m": "{max_error_m:.3f}",
    "roll °": "{roll_min_deg:.0f}..{roll_max_deg:.0f}", "steer °": "{steer_min_deg:.0f}..{steer_max_deg:.0f}",
    "falls": "{falls}", "lost": "{lost_steps}", "end": "{ended_by}",
}  # fmt: skip
SECTIONS: Final = {"section": "{name}"} | {f"{kind} m": f"{{{kind}_error_m:.3f}}" for kind in ("mean", "rms", "max")}
LAPS: Final = {
    "off track s": "{off_track_s:.2f}", "mean m": "{mean_error_m:.2f}", "max m": "{max_error_m:.2f}",
    "max m/s": "{speed_max_m_s:.2f}",
}  # fmt: skip


def _sectors(count: int) -> dict[str, str]:
    """Return columns of the times of sectors, none where they do not fit."""
    return {f"sector {k + 1}": f"{{sectors[{k}]!l}}" for k in range(count if count <= MOST_SECTORS else 0)}


def _laps(ride: dict[str, Any]) -> list[str]:
    laps = ride["complete_laps"]
    if not laps:
        return []
    columns = _sectors(max(len(lap["sectors_s"]) for lap in laps))
    flying = not all(lap["out_lap"] for lap in laps)
    rows = [
        {**lap, "number": f"{lap['lap']} (out)" if flying and lap["out_lap"] else lap["lap"]}
        | {"sectors": [*lap["sectors_s"], *[None] * MOST_SECTORS]}
        for lap in laps
    ]
    table = table_text({"lap": "{number}", "time": "{lap_s!l}", **columns, **LAPS}, rows)
    if len(laps) == 1:
        return table
    best, together = cells(("{best_lap_s!l}", "{theoretical_lap_s!l}"), ride)
    text = f"{Path(ride['recording']).stem}, ride {ride['ride']}: best lap {best}"
    if columns and ride["theoretical_lap_s"] is not None:
        text += f", best sectors together {together}"
    return [text, *table]


def _comparison(comparison: dict[str, Any]) -> list[str]:
    sectors = comparison["sectors"]
    rows = [
        {**run, "time": run["duration_s"] if run["complete"] else None}
        | {"sectors": [sector["times_s"][place] for sector in sectors]}
        for place, run in enumerate(comparison["runs"])
    ]
    if comparison["theoretical_lap_s"] is not None:
        best = {"sectors": [sector["best_s"] for sector in sectors], "time": comparison["theoretical_lap_s"]}
        rows.append({"run": "best sectors", "delta_s": None, **best})
    columns = {"side by side": "{run}", "time": "{time!l}", "lost s": "{delta_s:.3f}"}
    return table_text(columns | _sectors(len(sectors)), rows)


def _sweep(figures: dict[str, Any]) -> list[str]:
    lines = [f"{figures['sweep']}: {figures['finished']} of {figures['runs']} runs finished"]
    lines += table_text(GROUPS.columns, labelled(figures["groups"]), GROUPS.left)
    if figures["comparisons"]:
        rows = labelled(figures["comparisons"])
        lines += ["each seed with itself", *table_text(COMPARISONS.columns, rows, COMPARISONS.left)]
    return [*lines, f"page: {figures['page']}"]
