"""`bike report`: what came of a sweep, with intervals."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bike_analysis.figures.numbers import significant
from bike_analysis.sweeps.pictures import label_of
from bike_analysis.sweeps.report import report_sweep
from bike_analysis.sweeps.report_page import interval_text

SCHEMA: Final = "bike.report/1"
LEAST_WIDTH: Final = 110

_EXAMPLES: Final = """examples:
  bike report sweeps/seeds                        tables here; page, pictures and CSV files in sweeps/seeds/report
  bike report sweeps/seeds --json                 the same figures as one JSON object
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EXAMPLES
    parser.add_argument("sweep", type=Path, help="folder of a sweep")
    parser.add_argument("--out", type=Path, help="folder of page, pictures and CSV files (default: SWEEP/report)")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Report; not ok where a run has not finished.

    Raises:
        FileNotFoundError, ValueError, OSError: as `report_sweep`.
    """
    figures = report_sweep(args.sweep, args.out or args.sweep / "report")
    if not args.json:
        _print(figures)
    return {"schema": SCHEMA, "ok": figures["finished"] == figures["runs"], "figures": figures}


def _print(figures: dict[str, Any]) -> None:
    console = Console(highlight=False)
    console.width = max(console.width, LEAST_WIDTH)
    table = Table(box=box.SIMPLE, title=f"{figures['sweep']}: {figures['finished']} of {figures['runs']} runs finished")
    for name in ("group", "figure", "runs", "IQM", "95 % interval", "median", "least", "largest"):
        table.add_column(name, justify="left" if name in ("group", "figure") else "right")
    for entry in figures["groups"]:
        table.add_row(
            escape(entry["group"]),
            label_of(entry["figure"]),
            str(entry["runs"]),
            significant(entry["iqm"]),
            escape(interval_text(entry["low"], entry["high"])),
            *(significant(entry[name]) for name in ("median", "min", "max")),
        )
    console.print(table)
    if figures["comparisons"]:
        pairs = Table(box=box.SIMPLE, title="each seed with itself: second minus first")
        for name in ("figure", "first", "second", "seeds", "difference", "95 % interval"):
            pairs.add_column(name, justify="left" if name in ("figure", "first", "second") else "right")
        for entry in figures["comparisons"]:
            pairs.add_row(
                label_of(entry["figure"]),
                escape(entry["first"]),
                escape(entry["second"]),
                str(entry["seeds"]),
                significant(entry["difference"]),
                escape(interval_text(entry["low"], entry["high"])),
            )
        console.print(pairs)
    print(f"page: {figures['page']}")
