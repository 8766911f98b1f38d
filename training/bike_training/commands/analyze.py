"""`bike analyze`: figures, comparisons, plots and pages of recordings and of sweeps, without ROS."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from bike_analysis.figures.numbers import lap_text, significant
from bike_analysis.figures.results import SCHEMA
from bike_analysis.read.container import MAX_FAULT, shown
from bike_analysis.report import Video, analyze
from bike_analysis.sweeps.report import interval_text, label_of, report_sweep

SWEEP_SCHEMA: Final = "bike.analyze_sweep/1"
MOST_SECTORS: Final = 6
"""Sectors whose times fit beside a lap. A path has a section for each of its elements, told in lines of their own."""
MAX_LINE: Final = 10_000
"""Characters of a printed line; a table of many sectors is wide."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Analyze recordings, print their figures unless `args.json`, and return them, schema ``bike.analyze/3``.

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
        warnings.simplefilter("ignore")  # of NumPy about damaged numbers, of Matplotlib about letters without a glyph
        figures = analyze(
            args.objects,
            out,
            namespace=args.namespace,
            csv=args.csv,
            parquet=args.parquet,
            station_m=args.station,
            video=None if args.video is None else Video(args.video, args.begin, args.duration),
        )
    for warning in figures["warnings"]:
        print(f"warning: {shown(warning, MAX_FAULT)}", file=sys.stderr)
    if not args.json:
        print(text_of(figures))
    return {"schema": SCHEMA, "ok": len(figures["recordings"]) == len(args.objects), "figures": figures}


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
    """Put the figures into tables for people.

    Args:
        figures: What `bike_analysis.report.analyze` returned.

    Returns:
        Lines of text.
    """
    rides, several = figures["rides"], len(figures["recordings"]) > 1
    lines = _ride_table(rides, several)
    for ride in rides[:1]:
        lines += _sections(ride["sections"])
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
    lines += [f"{name}: {figures[name]}" for name in ("page", "picture", "csv", "parquet", "video") if name in figures]
    return "\n".join(shown(line, MAX_LINE) for line in lines)


def _ride_table(rides: Sequence[dict[str, Any]], several: bool) -> list[str]:
    names = ("ride", "course", "m/s", "s", "m", "mean m", "rms m", "max m", "roll °", "steer °", "falls", "lost", "end")
    head = ("recording", *names) if several else names
    rows = []
    for ride in rides:
        roll = f"{_number(ride['roll_min_deg'], 0)}..{_number(ride['roll_max_deg'], 0)}"
        steer = f"{_number(ride['steer_min_deg'], 0)}..{_number(ride['steer_max_deg'], 0)}"
        cells = (
            str(ride["ride"]),
            ride["course"] or "-",
            _number(ride["speed_mean_m_s"], 2),
            _number(ride["duration_s"], 1),
            _number(ride["distance_m"], 0),
            _number(ride["mean_error_m"], 3),
            _number(ride["rms_error_m"], 3),
            _number(ride["max_error_m"], 3),
            *(roll, steer, str(ride["falls"]), str(ride["lost_steps"]), ride["ended_by"].replace("_", " ")),
        )
        rows.append((Path(ride["recording"]).stem, *cells) if several else cells)
    return _table(head, rows)


def _sections(sections: Sequence[dict[str, Any]]) -> list[str]:
    if not sections:
        return []
    rows = [(s["name"], *(_number(s[f"{kind}_error_m"], 3) for kind in ("mean", "rms", "max"))) for s in sections]
    return _table(("section", "mean m", "rms m", "max m"), rows)


def _laps(ride: dict[str, Any]) -> list[str]:
    laps = ride["complete_laps"]
    if not laps:
        return []
    sectors = max(len(lap["sectors_s"]) for lap in laps)
    if sectors > MOST_SECTORS:
        sectors = 0
    head = ("lap", "time", *(f"sector {k + 1}" for k in range(sectors)), "off track s", "mean m", "max m", "max m/s")
    flying = not all(lap["out_lap"] for lap in laps)
    rows = []
    for lap in laps:
        number = f"{lap['lap']} (out)" if flying and lap["out_lap"] else str(lap["lap"])
        times = [_lap_time(t) for t in lap["sectors_s"][:sectors]] or ["-"] * sectors
        figures = (_number(lap[n], 2) for n in ("off_track_s", "mean_error_m", "max_error_m", "speed_max_m_s"))
        rows.append((number, _lap_time(lap["lap_s"]), *times, *figures))
    if len(laps) == 1:
        return _table(head, rows)
    name = f"{Path(ride['recording']).stem}, ride {ride['ride']}"
    best = f"{name}: best lap {_lap_time(ride['best_lap_s'])}"
    if sectors and ride["theoretical_lap_s"] is not None:
        best += f", best sectors together {_lap_time(ride['theoretical_lap_s'])}"
    return [best, *_table(head, rows)]


def _comparison(comparison: dict[str, Any]) -> list[str]:
    runs, sectors = comparison["runs"], comparison["sectors"]
    if len(sectors) > MOST_SECTORS:
        sectors = []
    head = ("side by side", "time", "lost s", *(f"sector {k + 1}" for k in range(len(sectors))))
    rows = []
    for index, run in enumerate(runs):
        times = (_lap_time(sector["times_s"][index]) for sector in sectors)
        time = _lap_time(run["duration_s"]) if run["complete"] else "-"
        rows.append((run["run"], time, _number(run["delta_s"], 3), *times))
    if comparison["theoretical_lap_s"] is not None:
        best = (_lap_time(sector["best_s"]) for sector in sectors)
        rows.append(("best sectors", _lap_time(comparison["theoretical_lap_s"]), "", *best))
    return _table(head, rows)


def _sweep(figures: dict[str, Any]) -> list[str]:
    rows = []
    for entry in figures["groups"]:
        interval = interval_text(entry["low"], entry["high"])
        values = [significant(entry[name]) for name in ("median", "min", "max")]
        rows.append(
            (
                entry["group"],
                label_of(entry["figure"]),
                str(entry["runs"]),
                significant(entry["iqm"]),
                interval,
                *values,
            )
        )
    head = ("group", "figure", "runs", "IQM", "95 % interval", "median", "least", "largest")
    lines = [f"{figures['sweep']}: {figures['finished']} of {figures['runs']} runs finished", *_table(head, rows)]
    if figures["comparisons"]:
        pairs = []
        for entry in figures["comparisons"]:
            difference = significant(entry["difference"]), interval_text(entry["low"], entry["high"])
            pair = (label_of(entry["figure"]), entry["first"], entry["second"])
            pairs.append((*pair, str(entry["seeds"]), *difference))
        titles = ("figure", "first", "second", "seeds", "difference", "95 % interval")
        lines += ["each seed with itself: second minus first", *_table(titles, pairs)]
    return [*lines, f"page: {figures['page']}"]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table, the first column to the left and the others to the right."""
    whole = [[shown(cell) for cell in row] for row in (head, *rows)]
    widths = [max(len(row[i]) for row in whole) for i in range(len(head))]
    return [
        "  ".join(
            cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in whole
    ]


def _lap_time(seconds: float | None) -> str:
    return "-" if seconds is None else lap_text(seconds)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
