"""`bike analyze` on runs: learning curves of several runs, as in Fig. 9 of Weyrer et al. (2026)."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from bike_analysis.sweeps.report import DRAWN_GROUPS, STEP, draw_curves, drawn_quantities
from bike_analysis.sweeps.tables import FINISHED
from bike_training.arguments import read_json
from bike_training.sweeps.jobs import TrainJob

PICTURE: Final = "learning_curves.png"
ERRORS: Final = {"mean_error_m": "last_errors_median_m", "mean_excess": "last_errors_median"}
"""Errors of validations on paths and in races, with the figure of the last ten."""
SHOWN: Final = ("finished_at_step", "finished_after_s", "steps", "seconds")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Draw the curves; not ok when a run has not finished its curriculum.

    Raises:
        FileNotFoundError: a folder holds no run.
        ValueError: a run has not been validated yet, or is damaged.
    """
    runs, curves = [], []
    for folder in args.objects:
        summary = read_json(folder / "run.json", ("seed", "preset", *SHOWN))
        curve = pd.DataFrame(TrainJob.curve(folder), columns=["quantity", "x", "value"])
        known = curve[curve["quantity"].isin(ERRORS)]
        if known.empty:
            raise ValueError(f"{folder} has no validation yet")
        runs.append({"run": folder.name, "seed": summary["seed"]} | {name: summary[name] for name in SHOWN})
        runs[-1][ERRORS[known["quantity"].iloc[0]]] = float(known["value"].tail(10).median())
        # Runs that are too many for a colour each are drawn by preset.
        group = folder.name if len(args.objects) <= DRAWN_GROUPS else summary["preset"]["name"]
        curves.append(curve.assign(run=folder.name, group=group))
    drawn, picture = pd.concat(curves), args.out if args.out.suffix else args.out / PICTURE
    picture.parent.mkdir(parents=True, exist_ok=True)
    members = drawn[["run", "group"]].drop_duplicates().assign(status=FINISHED)
    draw_curves(members, drawn, drawn_quantities(drawn) or list(ERRORS)[:1], STEP).savefig(picture, dpi=130)
    figures = {"runs": runs, **_spread(runs, "finished_at_step"), **_spread(runs, "finished_after_s")}
    if not args.json:
        for entry in runs:
            print(", ".join(f"{key} {value}" for key, value in entry.items()))
        print(f"picture: {picture}")
    return {"schema": "bike.analyze_runs/1", "ok": all(entry["finished_at_step"] for entry in runs), "figures": figures}


def _spread(runs: Sequence[dict[str, Any]], key: str) -> dict[str, Any]:
    values = [entry[key] for entry in runs if entry[key] is not None]
    if not values:
        return {}
    return {f"{key}_median": float(np.median(values)), f"{key}_min": min(values), f"{key}_max": max(values)}
