"""From the tables of a sweep to its report: figures, pictures, page and CSV files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd
from matplotlib.figure import Figure

from bike_analysis.sweeps.figures import GroupFigure, comparisons, figure_names, finished, group_figures
from bike_analysis.sweeps.pictures import STEP, curves_figure, inline_svg, intervals_figure, profiles_figure
from bike_analysis.sweeps.report_page import PictureSection, sweep_page
from bike_analysis.sweeps.tables import read_tables

PAGE_NAME: Final = "report.html"
CURVES_PICTURE: Final = "curves.png"
PROFILES_PICTURE: Final = "profiles.png"
INTERVALS_PICTURE: Final = "intervals.png"
FIGURES_CSV: Final = "figures.csv"
COMPARISONS_CSV: Final = "comparisons.csv"
DRAWN_QUANTITIES: Final = ("mean_error_m", "part", "episode_steps", "selection_rms_m")
"""Curves that pictures show where a sweep has them; else the first four it has."""
DRAWN_FIGURES: Final = 4
_LEAST_POINTS: Final = 2


def report_sweep(folder: str | os.PathLike[str], out: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """Make the report of a sweep.

    Args:
        folder: of the sweep.
        out: where page, pictures and CSV files go; None writes nothing.

    Returns:
        Figures ready for JSON: counts, ``groups`` and ``comparisons``, and the paths of what was written.

    Raises:
        FileNotFoundError: the folder holds no sweep. ValueError: a table is damaged. OSError: a file cannot be written.
    """
    runs, curves = read_tables(folder)
    name = Path(folder).resolve().name
    figures, compared = group_figures(runs), comparisons(runs)
    report: dict[str, Any] = {
        "sweep": name,
        "runs": len(runs),
        "finished": len(finished(runs)),
        "groups": list(figures),
        "comparisons": list(compared),
    }
    if out is None:
        return report
    target = Path(out)
    target.mkdir(parents=True, exist_ok=True)
    drawings = _draw(runs, curves, figures)
    for drawing in drawings:
        drawing.picture.savefig(target / drawing.file, dpi=160)
    (target / PAGE_NAME).write_text(
        sweep_page(name, runs, figures, compared, [drawing.section() for drawing in drawings]), encoding="utf-8"
    )
    pd.DataFrame(figures).to_csv(target / FIGURES_CSV, index=False, float_format="%.10g")
    pd.DataFrame(compared).to_csv(target / COMPARISONS_CSV, index=False, float_format="%.10g")
    pictures = [str(target / drawing.file) for drawing in drawings]
    return report | {"page": str(target / PAGE_NAME), "pictures": pictures}


@dataclass(frozen=True)
class _Drawing:
    """A picture as a file, and its panels one by one for the page, where they find their own places."""

    title: str
    caption: str
    file: str
    picture: Figure
    panels: Sequence[Figure]

    def section(self) -> PictureSection:
        svgs = [inline_svg(panel, f"{self.title} {place}") for place, panel in enumerate(self.panels)]
        return PictureSection(self.title, self.caption, svgs)


def _draw(runs: pd.DataFrame, curves: pd.DataFrame, figures: Sequence[GroupFigure]) -> list[_Drawing]:
    """Draw curves, profiles and intervals, as far as there is something to draw."""
    drawings = []
    for axis in map(str, curves["axis"].unique()):
        part = curves[curves["axis"] == axis]
        quantities = _quantities(part)
        if not quantities:
            continue
        title, file = ("Learning curves", CURVES_PICTURE) if axis == STEP else (f"Over the {axis.split('_')[0]}", "")
        caption = "Interquartile mean over runs with its 95 % bootstrap interval, as far as all have come; thin: runs."
        panels = [curves_figure(runs, part, [name], axis, legend=False) for name in quantities]
        picture = curves_figure(runs, part, quantities, axis)
        drawings.append(_Drawing(title, caption, file or f"curves_{axis}.png", picture, panels))
    names = _least_alike(runs)[:DRAWN_FIGURES]
    if names:
        caption = "Share of runs that are at least as good, with its 95 % bootstrap interval."
        panels = [profiles_figure(runs, [name], legend=False) for name in names]
        picture = profiles_figure(runs, names)
        drawings.append(_Drawing("Performance profiles", caption, PROFILES_PICTURE, picture, panels))
        interval = intervals_figure(figures, names[0])
        drawings.append(_Drawing("Intervals", "", INTERVALS_PICTURE, interval, [interval]))
    return drawings


def _least_alike(runs: pd.DataFrame) -> list[str]:
    """Return the figures in which runs differ: a picture of the others shows nothing."""
    done = finished(runs)
    return [name for name in figure_names(runs) if done[f"figure_{name}"].nunique() > 1]


def _quantities(curves: pd.DataFrame) -> Sequence[str]:
    """Return the curves to draw, at most four: those of which a run has more than one place."""
    places = curves.groupby(["quantity", "run"], sort=False)["x"].nunique().groupby("quantity", sort=False).max()
    known = [str(name) for name, count in places.items() if count >= _LEAST_POINTS]
    preferred = [name for name in DRAWN_QUANTITIES if name in known]
    return preferred or known[:4]
