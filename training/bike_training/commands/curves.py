"""`bike analyze` on runs: learning curves of several runs, as in Fig. 9 of Weyrer et al. (2026)."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd

from bike_training.arguments import read_json
from bike_training.curricula.parts import PARTS
from bike_training.tasks.path import VALIDATION_THRESHOLD

PICTURE: Final = "learning_curves.png"


class Curve(NamedTuple):
    """Validations of one run.

    Attributes:
        name: folder of the run.
        summary: contents of its run.json.
        table: a row for each validation: learning ``steps``, ``seconds`` of learning until it, ``part`` of the
            curriculum after it (5 once the last is passed), and ``error``, the mean of its rides: distance, m, or in
            races the excess over the planned time, as a part of it.
        of_races: whether it is of races.
    """

    name: str
    summary: dict[str, Any]
    table: pd.DataFrame
    of_races: bool


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Draw the curves; not ok when a run has not finished its curriculum."""
    curves = [read_curve(folder) for folder in args.objects]
    if len({curve.of_races for curve in curves}) > 1:
        raise ValueError("runs on paths and runs of races have errors of different kinds; draw them apart")
    picture: Path = args.out if args.out.suffix else args.out / PICTURE
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw(curves, picture)
    runs = [
        {
            "run": curve.name,
            "seed": curve.summary["seed"],
            "finished_at_step": curve.summary["finished_at_step"],
            "finished_after_s": curve.summary["finished_after_s"],
            "steps": curve.summary["steps"],
            "seconds": curve.summary["seconds"],
            "last_errors_median" if curve.of_races else "last_errors_median_m": float(
                curve.table["error"].tail(10).median()
            ),
        }
        for curve in curves
    ]
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


def read_curve(folder: Path) -> Curve:
    """Read the validations of a run.

    Raises:
        FileNotFoundError: the folder holds no run.
        ValueError: it has not been validated yet, or is damaged.
    """
    path = folder / "validations.csv"
    try:
        found = pd.read_csv(path)
    except pd.errors.EmptyDataError:
        found = pd.DataFrame()
    except pd.errors.ParserError as error:
        raise ValueError(f"{path} is no table of validations ({str(error).strip()})") from None
    if found.empty:
        raise ValueError(f"{folder} has no validation yet")
    races = "mean_excess" in found
    names = {"step": "steps", "seconds": "seconds", "part": "part", "passed": "passed"}
    names["mean_excess" if races else "mean_error_m"] = "error"
    table = found.reindex(columns=list(names)).apply(pd.to_numeric, errors="coerce")
    for name in table.columns[table.isna().any()][:1]:
        raise ValueError(f"{path}: a row has no number for {name}; was it cut off?")
    table = table.rename(columns=names)
    table["part"] += table["passed"] * (table["part"] <= PARTS)
    needed = ("seed", "finished_at_step", "finished_after_s", "steps", "seconds")
    return Curve(folder.name, read_json(folder / "run.json", needed), table, races)


def draw(curves: Sequence[Curve], path: Path) -> None:
    """Draw validation error and part over steps and over time."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    fig, axes = plt.subplots(
        2, 2, figsize=(12, 7), sharex="col", sharey="row", height_ratios=(2, 1), layout="constrained"
    )
    for column, (quantity, label) in enumerate((("steps", "learning steps"), ("seconds", "learning time / s"))):
        top, bottom = axes[:, column]
        for curve in curves:
            x = curve.table[quantity]
            (line,) = top.plot(x, curve.table["error"], lw=1, label=curve.name)
            bottom.step(x, curve.table["part"], where="post", lw=1.5, color=line.get_color())
        races = all(curve.of_races for curve in curves)
        if not races:
            top.axhline(VALIDATION_THRESHOLD, color="0.5", ls=":", lw=1)
        ylabel = "excess over the planned time, mean of a validation" if races else "mean distance of a validation / m"
        top.set(yscale="log", ylabel=ylabel if column == 0 else "")
        bottom.set(xlabel=label, ylabel="part (5: finished)" if column == 0 else "", yticks=range(1, PARTS + 2))
        for axis in (top, bottom):
            axis.grid(alpha=0.3)
    axes[0, 0].legend()
    fig.savefig(path, dpi=130)
    plt.close(fig)
