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
from matplotlib.ticker import LogLocator

from bike_analysis.page.document import RC, colour, colour_variables
from bike_analysis.page.view import SERIES_COLOURS
from bike_analysis.read.container import shown
from bike_analysis.sweeps.figures import LARGER_IS_BETTER, GroupFigure, curves_of, finished, values_of
from bike_analysis.sweeps.statistics import band, profile

PANEL_WIDTH: Final = 4.6
"""Width of a panel, inches; on a page they stand side by side where there is room."""
LONGEST_LABEL: Final = 36
"""Characters of a group's name beside a panel; tables have all of it."""
STEP: Final = "step"
"""Axis of the curves of trainings."""
DRAWN_GROUPS: Final = 6
"""Groups that are drawn, one in each colour; the tables have all."""
LOG_QUANTITIES: Final = ("mean_error_m", "max_error_m", "selection_rms_m")
"""Quantities with a logarithmic axis: they fall by orders of magnitude."""
_DIMENSION: Final = re.compile(rb'(<svg[^>]*?) width="[^"]*" height="[^"]*"|(<svg[^>]*?) height="[^"]*" width="[^"]*"')


def curves_figure(
    runs: pd.DataFrame, curves: pd.DataFrame, quantities: Sequence[str], axis: str, legend: bool = True
) -> Figure:
    """Draw the curves of all groups: interquartile mean and 95 % interval, thin lines for the runs.

    Args:
        runs: table of runs.
        curves: table of curves.
        quantities: one panel each.
        axis: label of the horizontal axis.
        legend: whether the picture says which colour is which group.
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
                    panel.step(x, value, where="post", color=hue, lw=0.5, alpha=0.35)
                mean = band(known)
                if mean is not None:
                    panel.fill_between(mean.x, mean.low, mean.high, color=hue, alpha=0.18, lw=0)
                    panel.plot(mean.x, mean.value, color=hue, lw=1.6, label=f"{shown(group)} ({len(known)})")
            if quantity in LOG_QUANTITIES:
                _scale_by_decades(panel)
            panel.set(ylabel=label_of(quantity), xlabel=label_of(axis))
            if axis == STEP:
                panel.xaxis.set_major_formatter(lambda x, _: f"{x:,.0f}")
            panel.margins(x=0.01)
        if legend:
            _add_legend(figure, panels[0])
    return figure


def profiles_figure(runs: pd.DataFrame, figures: Sequence[str], legend: bool = True) -> Figure:
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
        if legend:
            _add_legend(figure, panels[0])
    return figure


def intervals_figure(figures: Sequence[GroupFigure], name: str) -> Figure:
    """Draw a figure of all groups, with its interval."""
    rows = [entry for entry in figures if entry["figure"] == name]
    with mpl.rc_context(RC):
        figure = Figure(figsize=(PANEL_WIDTH, 0.9 + 0.32 * len(rows)), layout="constrained")
        FigureCanvasAgg(figure)
        panel = figure.subplots()
        for place, row in enumerate(rows):
            if row["low"] is not None and row["high"] is not None:
                panel.plot([row["low"], row["high"]], [place, place], color=colour("blue"), lw=5, alpha=0.3)
            panel.plot(row["iqm"], place, "o", color=colour("blue"), ms=5)
        panel.set_yticks(range(len(rows)), [shown(row["group"], LONGEST_LABEL) for row in rows])
        panel.set(xlabel=f"{label_of(name)}: IQM and 95 % interval", ylim=(len(rows) - 0.5, -0.5))
    return figure


def group_colours(runs: pd.DataFrame) -> list[tuple[str, str]]:
    """Return the groups that pictures show, each with the name of its colour."""
    return [(group, name) for name, group in zip(SERIES_COLOURS, drawn_groups(runs), strict=False)]


def drawn_groups(runs: pd.DataFrame) -> list[str]:
    """Return the groups that pictures show: those of finished runs, the first of them where there are many."""
    return [str(group) for group in finished(runs)["group"].unique()][:DRAWN_GROUPS]


def label_of(name: str) -> str:
    """Return a column's name for people: ``mean_error_m`` as ``mean error in m``."""
    stem, _, unit = name.rpartition("_")
    units = {"m": "m", "s": "s", "deg": "°"}
    named = {"speed_m_s": "speed in m/s", STEP: "learning step"}
    if name in named:
        return named[name]
    return f"{stem.replace('_', ' ')} in {units[unit]}" if stem and unit in units else name.replace("_", " ")


def inline_svg(figure: Figure, label: str) -> str:
    """Return a picture as part of a page: it takes the page's colours, in light and dark, and its width."""
    target = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": label}):
        figure.savefig(target, format="svg", transparent=True, metadata={"Date": None})
    text = _DIMENSION.sub(rb"\1\2", target.getvalue(), count=1).decode()
    return colour_variables(text[text.index("<svg") :])


def _scale_by_decades(panel: Axes) -> None:
    """Take a logarithmic axis whose places are labelled in plain numbers; the usual ones take half of a small panel."""
    panel.set_yscale("log")
    for axis_locator, places in ((panel.yaxis.set_major_locator, (1.0,)), (panel.yaxis.set_minor_locator, (2.0, 5.0))):
        axis_locator(LogLocator(subs=places))
    for set_formatter in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
        set_formatter(lambda value, _: f"{value:g}")


def _add_legend(figure: Figure, panel: Axes) -> None:
    """Add the legend of a panel above all panels, where it hides no curve."""
    handles, labels = panel.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside upper left", ncols=min(len(labels), 3))


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    columns = min(count, 2)
    rows = -(-count // 2)
    figure = Figure(figsize=(PANEL_WIDTH * columns, 2.9 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel().tolist()
    for spare in panels[count:]:
        spare.set_visible(False)
    return figure, panels[:count]
