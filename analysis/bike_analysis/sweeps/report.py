"""The report of a sweep: figures with intervals, pictures, one page of Markdown, and CSV files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from bike_analysis.figures.cells import cells, markdown
from bike_analysis.page.document import RC, colour, program_version
from bike_analysis.page.view import SERIES_COLOURS
from bike_analysis.read.container import shown
from bike_analysis.sweeps.statistics import band
from bike_analysis.sweeps.tables import (
    comparisons,
    curves_of,
    finished,
    group_figures,
    read_tables,
)

PAGE_NAME: Final = "report.md"
MAX_ERROR: Final = 400
"""Characters of a cell."""
DRAWN_QUANTITIES: Final = ("mean_error_m", "mean_excess", "part", "episode_steps", "selection_rms_m")
"""Curves that pictures show where a sweep has them; else the first four it has."""
_MIN_POINTS: Final = 2
PANEL_WIDTH: Final = 4.6
"""Width of a panel, inches."""
STEP: Final = "step"
"""Axis of the curves of trainings."""
DRAWN_GROUPS: Final = 6
"""Groups that are drawn, one in each colour; the tables have all."""
LOG_QUANTITIES: Final = ("mean_error_m", "max_error_m", "selection_rms_m")
"""Quantities with a logarithmic axis: they fall by orders of magnitude."""
UNITS: Final = {"_m_s2": "m/s²", "_m_s": "m/s", "_deg_s": "°/s", "_nm": "N m", "_m": "m", "_s": "s", "_deg": "°"}
"""Units of columns by the ending of their names, the longer first."""


def report_sweep(folder: str | os.PathLike[str], out: str | os.PathLike[str] | None = None) -> dict[str, Any]:
    """Make the report of a sweep.

    Args:
        folder: of the sweep.
        out: where page, pictures and CSV files go; None writes nothing.

    Returns:
        Figures ready for JSON: counts, ``groups`` and ``comparisons``, and the paths of what was written.

    Raises:
        FileNotFoundError: the folder holds no sweep.
        ValueError: a table is damaged.
        OSError: a file cannot be written.
    """
    runs, curves = read_tables(folder)
    name = Path(folder).resolve().name
    report: dict[str, Any] = {"sweep": name, "runs": len(runs), "finished": len(finished(runs))}
    report |= {"groups": group_figures(runs), "comparisons": comparisons(runs)}
    if out is None:
        return report
    target = Path(out)
    target.mkdir(parents=True, exist_ok=True)
    pictures = []
    for axis in map(str, curves["axis"].unique()):
        part = curves[curves["axis"] == axis]
        quantities = drawn_quantities(part)
        if quantities:
            pictures.append(target / ("curves.png" if axis == STEP else f"curves_{axis}.png"))
            draw_curves(runs, part, quantities, axis).savefig(pictures[-1], dpi=160)
    page = target / PAGE_NAME
    page.write_text(_page(report, runs, [picture.name for picture in pictures]), encoding="utf-8")
    for kind, file in (("groups", "figures.csv"), ("comparisons", "comparisons.csv")):
        pd.DataFrame(report[kind]).to_csv(target / file, index=False, float_format="%.10g")
    return report | {"page": str(page), "pictures": list(map(str, pictures))}


def drawn_quantities(curves: pd.DataFrame) -> Sequence[str]:
    """Return the curves to draw, at most four: those of which a run has more than one place."""
    places = curves.groupby(["quantity", "run"], sort=False)["x"].nunique().groupby("quantity", sort=False).max()
    known = [str(name) for name, count in places.items() if count >= _MIN_POINTS]
    preferred = [name for name in DRAWN_QUANTITIES if name in known]
    return (preferred or known)[:4]


def draw_curves(runs: pd.DataFrame, curves: pd.DataFrame, quantities: Sequence[str], axis: str) -> Figure:
    """Draw the curves of all groups, a panel for each quantity: interquartile mean with its interval, and the runs."""
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
                    style = "steps-post" if axis == STEP else "default"  # a speed is no time for which a value holds
                    panel.plot(x, value, drawstyle=style, color=hue, lw=0.5, alpha=0.35)
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
        handles, labels = panels[0].get_legend_handles_labels()
        if handles:  # above all panels, where it hides no curve
            figure.legend(handles, labels, loc="outside upper left", ncols=min(len(labels), 3))
    return figure


def drawn_groups(runs: pd.DataFrame) -> list[str]:
    """Return the groups that pictures show: those of finished runs, the first of them where there are many."""
    return [str(group) for group in finished(runs)["group"].unique()][:DRAWN_GROUPS]


def label_of(name: str) -> str:
    """Return a column's name for people: ``mean_error_m`` as ``mean error, m``."""
    if name == STEP:
        return "learning step"
    for ending, unit in UNITS.items():
        if name.endswith(ending) and name != ending:
            return f"{name.removesuffix(ending).replace('_', ' ')}, {unit}"
    return name.replace("_", " ")


def _scale_by_decades(panel: Axes) -> None:
    """Take a logarithmic axis whose places are labelled in plain numbers; the usual ones take half of a small panel."""
    panel.set_yscale("log")
    for axis_locator, places in ((panel.yaxis.set_major_locator, (1.0,)), (panel.yaxis.set_minor_locator, (2.0, 5.0))):
        axis_locator(LogLocator(subs=places))
    for set_formatter in (panel.yaxis.set_major_formatter, panel.yaxis.set_minor_formatter):
        set_formatter(lambda value, _: f"{value:g}")


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    columns = min(count, 2)
    rows = -(-count // 2)
    figure = Figure(figsize=(PANEL_WIDTH * columns, 2.9 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel().tolist()
    for spare in panels[count:]:
        spare.set_visible(False)
    return figure, panels[:count]


# ------------------------------------------------------------------------------------------------------------ page

CAPTION: Final = "Interquartile mean over runs with its 95 % bootstrap interval, as far as all have come; thin: runs."


def _page(report: Mapping[str, Any], runs: pd.DataFrame, pictures: Sequence[str]) -> str:
    """Return the report as Markdown, with its pictures beside it."""
    hours = float(finished(runs)["cpu_seconds"].sum()) / 3600.0
    known: Any = runs.astype(object).where(runs.notna(), None).to_dict("records")
    failed = [{**run, "error": run["error"][:MAX_ERROR]} for run in known if run["status"] == "failed"]
    parts = [
        f"# {_plain(report['sweep'])}\n",
        f"{report['finished']} of {report['runs']} runs finished, {runs['group'].nunique()} groups, "
        f"{runs['seed'].nunique()} seeds; {hours:.2f} h of processor time in last attempts. {program_version()}\n",
        *(f"![{picture}]({picture})\n\n{CAPTION}\n" for picture in pictures),
    ]
    tables = (GROUPS, report["groups"]), (COMPARISONS, report["comparisons"]), (FAILURES, failed), (RUNS, known)
    for table, records in tables:
        rows = [cells(table.columns.values(), record) for record in labelled(records)]
        if rows:
            text = markdown([list(table.columns), *([_plain(cell) for cell in row] for row in rows)])
            parts.append(f"## {table.title}\n\n{table.note}\n\n{text}")
    return "\n".join(parts)


def _plain(text: str) -> str:
    """Return text of others as one line that Markdown and browsers take for text."""
    return escape(shown(text, MAX_ERROR)).replace("|", "&#124;")


class Table(NamedTuple):
    """Columns of a table of a report.

    Attributes:
        title: of its section.
        note: below the title.
        left: columns of text.
        columns: format strings by heading, as of `bike_analysis.figures.cells`.
    """

    title: str
    note: str
    left: int
    columns: Mapping[str, str]


GROUPS: Final = Table(
    "Figures",
    "interquartile mean over runs; in brackets its 95 % bootstrap interval",
    2,
    {
        "group": "{group}",
        "figure": "{label}",
        "runs": "{runs}",
        "IQM": "{iqm!g}",
        "95 % interval": "[{low!g}, {high!g}]",
    }
    | {"mean": "{mean!g}", "median": "{median!g}", "least": "{min!g}", "largest": "{max!g}"},
)
COMPARISONS: Final = Table(
    "Paired comparisons",
    "Each seed with itself: interquartile mean of the differences, and how often the second is larger.",
    3,
    {"figure": "{label}", "first": "{first}", "second": "{second}", "seeds": "{seeds}"}
    | {"second − first": "{difference!g}", "95 % interval": "[{low!g}, {high!g}]"}
    | {"second larger": "{share_larger:.0%}"},
)
RUNS: Final = Table(
    "Runs",
    "",
    2,
    {"run": "{run}", "status": "{status}", "attempts": "{attempts}", "last attempt, s": "{seconds}"}
    | {"machine": "{host}", "commit": "{commit}"},
)


FAILURES: Final = Table("Failures", "", 2, {"run": "{run}", "error": "{error}"})


def labelled(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows with a ``label`` of their figure for people."""
    return [{**row, "label": label_of(row.get("figure", ""))} for row in rows]
