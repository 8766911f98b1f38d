"""`bike bench`: speeds of this project, as ratios to peers in the same run."""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path
from typing import Any, Final

from bike_analysis.figures.cells import lines_of, table_text
from bike_sim.documents import alternatives, show

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


ENGINES: Final = {
    "engine": "{name}", "step s": "{time_step_s}", "control steps/s": "{control_steps_per_s:,.0f}",
    "weave error %": "{weave_speed_error_percent:+.3f}", "capsize error %": "{capsize_speed_error_percent:+.3f}",
}  # fmt: skip


def _print(figures: dict[str, Any]) -> None:
    if "engines" in figures:
        print("\n".join(table_text(ENGINES, figures["engines"])))
    single = {name: value for name, value in figures.items() if name != "engines"}
    rows = [[name, f"{value:,.4g}" if isinstance(value, float) else str(value)] for name, value in single.items()]
    print("\n".join(lines_of([["figure", "value"], *rows])))
