"""`bike bench`: speeds of this project, as ratios to peers in the same run."""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from bike_sim.documents import alternatives, show
from bike_training.progress import text_table

PARTS: Final = {
    "physics": "bench.physics_speed",
    "environment": "bench.environment_speed",
    "ros": "bench.ros_speed",
    "recorder": "bench.recorder_speed",
    "analysis": "bench.analysis_speed",
    "live": "bench.live_page",
}
"""Parts of the benchmark with the module whose function `measure` returns the figures."""
DEFAULT_PARTS: Final = ("physics", "environment", "ros")
"""Parts that are measured where none is named; the others take minutes."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure and return all figures."""
    unknown = [part for part in args.parts if part not in PARTS]
    if unknown:
        raise ValueError(f"unknown part {show(unknown[0])}; {alternatives(unknown[0], PARTS)}")
    figures: dict[str, Any] = {}
    for part in args.parts or DEFAULT_PARTS:
        print(f"measuring {part} ...", file=sys.stderr)
        figures.update(load_part(part).measure())
    if not args.json:
        _print(figures)
    return {"schema": "bike.bench/1", "ok": True, "figures": figures}


def load_part(part: str) -> Any:
    """Import the module of a part from the folder bench/ of the checkout that this package is run from.

    Raises:
        FileNotFoundError: there is no such folder.
    """
    root = Path(__file__).resolve().parents[3]
    if not (root / "bench").is_dir():
        raise FileNotFoundError(
            "bike bench needs a checkout of the project: the folder bench/ was not found beside training/"
        )
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    return importlib.import_module(PARTS[part])


def _print(figures: dict[str, Any]) -> None:
    rows = []
    for name, value in figures.items():
        for entry in value if isinstance(value, list) else ():
            errors = (f"{mode} {entry[f'{mode}_speed_error_percent']:+.3f} %" for mode in ("weave", "capsize"))
            speed = f"{entry['control_steps_per_s']:,.0f}/s"
            rows.append((f"{entry['name']}, {1e3 * entry['time_step_s']:g} ms", ", ".join((speed, *errors))))
        if not isinstance(value, list):
            rows.append((name, f"{value:,.4g}" if isinstance(value, float) else str(value)))
    table = text_table("speed", ("figure", "value"), rows, left=2)
    Console().print(table)
