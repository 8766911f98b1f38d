"""``bike analyze``: figures, plots and a report page of a recording, without ROS."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from bike_analysis.report import analyze

EPILOG = """examples:
  bike analyze ride.mcap                    print the figures, write ride.html and ride.png beside the recording
  bike analyze ride.mcap --out report       write them into report/
  bike analyze ride.mcap --json             the figures as JSON, and no files
  bike analyze recordings/ride_1 --json     a rosbag2 directory

A recording that was torn off (recorder killed, disk full) is analyzed up to its last whole chunk, with a warning.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments.

    Args:
        parser: Parser of the subcommand.
    """
    parser.description = "Read a recorded ride and report how well it followed its path. Needs no ROS."
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("recording", type=Path, help="an .mcap file or a rosbag2 directory")
    parser.add_argument("--out", type=Path, metavar="DIR", help="directory for ride.html and ride.png")
    parser.add_argument("--vehicle", metavar="NAMESPACE", help="which vehicle, if several were recorded")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Analyze a recording and print its figures.

    Args:
        args: Parsed arguments, with ``json`` from the central command.

    Returns:
        The result object, schema ``bike.analyze/1``.

    Raises:
        FileNotFoundError: If there is no such recording.
        RecordingError: If it is not a recording of a ride, or nothing of it can be read.
        OSError: If a file cannot be read or written.
    """
    as_json = bool(getattr(args, "json", False))
    out = args.out
    if out is None and not as_json:
        out = args.recording if args.recording.is_dir() else args.recording.parent
    figures = analyze(args.recording, out, namespace=args.vehicle)
    for warning in figures["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    if not as_json:
        print(text_of(figures))
    return {"schema": "bike.analyze/1", "ok": True, "figures": figures}


def text_of(figures: dict[str, Any]) -> str:
    """Put the figures into a table for people.

    Args:
        figures: What `bike_analysis.report.analyze` returned.

    Returns:
        Lines of text.
    """
    head = ("ride", "course", "m/s", "s", "m", "mean m", "rms m", "max m", "roll °", "steer °", "falls", "lost", "end")
    rows = [head, *(_row(ride) for ride in figures["rides"])]
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    for ride in figures["rides"][:1]:
        lines += _sections(ride["sections"])
    median, p99 = figures["latency_median_s"], figures["latency_p99_s"]
    if median is not None and p99 is not None:
        lines.append(f"the policy answered in {1e3 * median:.3f} ms (median), {1e3 * p99:.3f} ms (99th percentile)")
    lines += [f"{name}: {figures[name]}" for name in ("page", "picture") if name in figures]
    return "\n".join(lines)


def _row(ride: dict[str, Any]) -> tuple[str, ...]:
    return (
        str(ride["ride"]),
        ride["course"] or "-",
        _number(ride["speed_mean_m_s"], 2),
        _number(ride["duration_s"], 1),
        _number(ride["distance_m"], 0),
        _number(ride["mean_error_m"], 3),
        _number(ride["rms_error_m"], 3),
        _number(ride["max_error_m"], 3),
        f"{_number(ride['roll_min_deg'], 0)}..{_number(ride['roll_max_deg'], 0)}",
        f"{_number(ride['steer_min_deg'], 0)}..{_number(ride['steer_max_deg'], 0)}",
        str(ride["falls"]),
        str(ride["lost_steps"]),
        ride["ended_by"].replace("_", " "),
    )


def _sections(sections: list[dict[str, Any]]) -> list[str]:
    if not sections:
        return []
    width = max(len(section["name"]) for section in sections)
    lines = [f"{'section'.ljust(width)}  mean m   rms m   max m"]
    for section in sections:
        numbers = "  ".join(_number(section[f"{kind}_error_m"], 3).rjust(6) for kind in ("mean", "rms", "max"))
        lines.append(f"{section['name'].ljust(width)}  {numbers}")
    return lines


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
