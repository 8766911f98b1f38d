"""`bike analyze` on runs: learning curves of several runs, as in Fig. 9 of Weyrer et al. (2026)."""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from bike_training.curricula.parts import PARTS
from bike_training.tasks.path import VALIDATION_THRESHOLD

PICTURE: Final = "learning_curves.png"


@dataclass(frozen=True)
class Curve:
    """Validations of one run.

    Attributes:
        name: folder of the run.
        summary: contents of its run.json.
        steps: learning step of each validation.
        seconds: learning time until it, s.
        part: part of the curriculum after it; 5 once the last is passed.
        error: mean error of its rides: distance, m, or in races the excess over the planned time, as a part of it.
        of_races: whether it is of races.
    """

    name: str
    summary: dict[str, Any]
    steps: NDArray[np.float64]
    seconds: NDArray[np.float64]
    part: NDArray[np.float64]
    error: NDArray[np.float64]
    of_races: bool = False


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
            "last_errors_median" if curve.of_races else "last_errors_median_m": float(np.median(curve.error[-10:])),
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
    with (folder / "validations.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        raise ValueError(f"{folder} has no validation yet")

    def column(name: str) -> NDArray[np.float64]:
        try:
            return np.array([float(row[name]) for row in rows])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"{folder / 'validations.csv'}: a row has no number for {name}; was it cut off?"
            ) from error

    summary = _read_summary(folder / "run.json")
    ridden_in = column("part")
    part = ridden_in + column("passed") * (ridden_in <= PARTS)
    races = "mean_excess" in rows[0]
    error = column("mean_excess" if races else "mean_error_m")
    return Curve(folder.name, summary, column("step"), column("seconds"), part, error, races)


def _read_summary(path: Path) -> dict[str, Any]:
    needed = {"seed", "finished_at_step", "finished_after_s", "steps", "seconds"}
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as JSON ({error}); it is damaged or another file") from error
    if not isinstance(summary, dict) or not needed <= set(summary):
        raise ValueError(f"{path} must hold {', '.join(sorted(needed))}; it is not the summary of a run")
    return summary


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
            x = getattr(curve, quantity)
            (line,) = top.plot(x, curve.error, lw=1, label=curve.name)
            bottom.step(x, curve.part, where="post", lw=1.5, color=line.get_color())
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
