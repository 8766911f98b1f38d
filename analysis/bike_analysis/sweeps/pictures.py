"""Pictures of a sweep: curves with bands, intervals, and performance profiles; for files and for the page."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from typing import Final

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bike_analysis.page.style import RC, colour, colour_variables
from bike_analysis.page.view import SERIES_COLOURS
from bike_analysis.read.text import shown
from bike_analysis.sweeps.figures import LARGER_IS_BETTER, GroupFigure, curves_of, finished, values_of
from bike_analysis.sweeps.statistics import band, profile

WIDTH: Final = 9.2
"""Width of a picture, inches."""
DRAWN_GROUPS: Final = 6
"""Groups that are drawn, one in each colour; the tables have all."""
LOG_QUANTITIES: Final = ("mean_error_m", "max_error_m", "selection_rms_m")
"""Quantities with a logarithmic axis: they fall by orders of magnitude."""
_DIMENSION: Final = re.compile(rb'(<svg[^>]*?) width="[^"]*" height="[^"]*"|(<svg[^>]*?) height="[^"]*" width="[^"]*"')


def curves_figure(runs: pd.DataFrame, curves: pd.DataFrame, quantities: Sequence[str], axis: str) -> Figure:
    """Draw the curves of all groups: interquartile mean and 95 % interval, thin lines for the runs.

    Args:
        runs: table of runs.
        curves: table of curves.
        quantities: one panel each.
        axis: label of the horizontal axis.
    """
    groups = drawn_groups(runs)
    done = set(finished(runs)["run"])
    with mpl.rc_context(RC):
        figure, panels = _panels(len(quantities))
        for panel, quantity in zip(panels, quantities, strict=True):
            for name, group in zip(SERIES_COLOURS, groups, strict=False):
                members = [run for run in runs[runs["group"] == group]["run"] if run in done]
                known = curves_of(curves, quantity, group, members)
                hue = colour(name)
                for x, value in known:
                    panel.plot(x, value, color=hue, lw=0.5, alpha=0.35)
                mean = band(known)
                if mean is not None:
                    panel.fill_between(mean.x, mean.low, mean.high, color=hue, alpha=0.18, lw=0)
                    panel.plot(mean.x, mean.value, color=hue, lw=1.6, label=f"{shown(group)} ({len(known)})")
            if quantity in LOG_QUANTITIES:
                panel.set_yscale("log")
            panel.set(ylabel=label_of(quantity), xlabel=label_of(axis))
            panel.margins(x=0.01)
        if panels[0].get_legend_handles_labels()[0]:
            panels[0].legend(loc="best")
    return figure


def profiles_figure(runs: pd.DataFrame, figures: Sequence[str]) -> Figure:
    """Draw the share of runs that are at least as good as each value, with its interval."""
    groups, done = drawn_groups(runs), finished(runs)
    with mpl.rc_context(RC):
        figure, panels = _panels(len(figures))
        for panel, name in zip(panels, figures, strict=True):
            every = values_of(done, name)
            margin = 0.05 * (float(np.ptp(every)) or max(abs(float(every[0])), 1e-9))
            thresholds = np.linspace(every.min() - margin, every.max() + margin, 400)
            for hue_name, group in zip(SERIES_COLOURS, groups, strict=False):
                members = done[done["group"] == group]
                if not len(members):
                    continue
                values = np.full(len(members), np.nan)
                known = values_of(members, name)
                values[: len(known)] = known  # runs without the figure are worse than any threshold
                share, low, high = profile(values, thresholds, name in LARGER_IS_BETTER)
                hue = colour(hue_name)
                panel.fill_between(thresholds, low, high, color=hue, alpha=0.18, lw=0, step="mid")
                panel.step(thresholds, share, where="mid", color=hue, lw=1.6, label=shown(group))
            sign = "≥" if name in LARGER_IS_BETTER else "≤"
            panel.set(xlabel=label_of(name), ylabel=f"share of runs {sign}", ylim=(-0.02, 1.02))
        panels[0].legend(loc="best")
    return figure


def intervals_figure(figures: Sequence[GroupFigure], name: str) -> Figure:
    """Draw a figure of all groups, with its interval."""
    rows = [entry for entry in figures if entry["figure"] == name]
    with mpl.rc_context(RC):
        figure = Figure(figsize=(WIDTH, 0.9 + 0.32 * len(rows)), layout="constrained")
        FigureCanvasAgg(figure)
        panel = figure.subplots()
        for place, row in enumerate(rows):
            if row["low"] is not None and row["high"] is not None:
                panel.plot([row["low"], row["high"]], [place, place], color=colour("blue"), lw=5, alpha=0.3)
            panel.plot(row["iqm"], place, "o", color=colour("blue"), ms=5)
        panel.set_yticks(range(len(rows)), [shown(row["group"]) for row in rows])
        panel.set(xlabel=f"{label_of(name)}: interquartile mean and 95 % interval", ylim=(len(rows) - 0.5, -0.5))
    return figure


def drawn_groups(runs: pd.DataFrame) -> list[str]:
    """Return the groups that pictures show: those of finished runs, the first of them where there are many."""
    return [str(group) for group in finished(runs)["group"].unique()][:DRAWN_GROUPS]


def label_of(name: str) -> str:
    """Return a column's name for people: ``mean_error_m`` as ``mean error in m``."""
    stem, _, unit = name.rpartition("_")
    units = {"m": "m", "s": "s", "deg": "°"}
    if name == "speed_m_s":
        return "speed in m/s"
    return f"{stem.replace('_', ' ')} in {units[unit]}" if stem and unit in units else name.replace("_", " ")


def inline_svg(figure: Figure, label: str) -> str:
    """Return a picture as part of a page: it takes the page's colours, in light and dark, and its width."""
    target = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": label}):
        figure.savefig(target, format="svg", transparent=True, metadata={"Date": None})
    text = _DIMENSION.sub(rb"\1\2", target.getvalue(), count=1).decode()
    return colour_variables(text[text.index("<svg") :])


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    rows = -(-count // 2)
    figure = Figure(figsize=(WIDTH, 2.9 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(rows, min(count, 2), squeeze=False)).ravel().tolist()
    for spare in panels[count:]:
        spare.set_visible(False)
    return figure, panels[:count]
