"""The report of a sweep: figures with intervals, pictures, one HTML page without network, and CSV files."""

from __future__ import annotations

import io
import os
import re
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

from bike_analysis.figures.cells import cells
from bike_analysis.page.document import (
    RC,
    colour,
    colour_variables,
    html_text,
    key_html,
    page_shell,
    program_version,
    table_html,
)
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

PAGE_NAME: Final = "report.html"
DRAWN_QUANTITIES: Final = ("mean_error_m", "part", "episode_steps", "selection_rms_m")
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
_DIMENSION: Final = re.compile(rb'(<svg[^>]*?) width="[^"]*" height="[^"]*"|(<svg[^>]*?) height="[^"]*" width="[^"]*"')


class Picture(NamedTuple):
    """A picture as a file and on the page.

    Attributes:
        title: headline of its section.
        caption: below it.
        file: name.
        figure: all panels, with a legend.
    """

    title: str
    caption: str
    file: str
    figure: Figure


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
    figures, compared = group_figures(runs), comparisons(runs)
    report: dict[str, Any] = {"sweep": name, "runs": len(runs), "finished": len(finished(runs))}
    report |= {"groups": figures, "comparisons": compared}
    if out is None:
        return report
    target = Path(out)
    target.mkdir(parents=True, exist_ok=True)
    pictures = _draw(runs, curves)
    for picture in pictures:
        picture.figure.savefig(target / picture.file, dpi=160)
    (target / PAGE_NAME).write_text(_page(name, runs, figures, compared, pictures), encoding="utf-8")
    for rows, file in ((figures, "figures.csv"), (compared, "comparisons.csv")):
        pd.DataFrame(rows).to_csv(target / file, index=False, float_format="%.10g")
    return report | {"page": str(target / PAGE_NAME), "pictures": [str(target / each.file) for each in pictures]}


# -------------------------------------------------------------------------------------------------------- pictures


def _draw(runs: pd.DataFrame, curves: pd.DataFrame) -> list[Picture]:
    """Draw the curves, as far as there is something to draw."""
    pictures = []
    for axis in map(str, curves["axis"].unique()):
        part = curves[curves["axis"] == axis]
        quantities = _quantities(part)
        if not quantities:
            continue
        title, file = (
            ("Learning curves", "curves") if axis == STEP else (f"Over the {axis.split('_')[0]}", f"curves_{axis}")
        )
        caption = "Interquartile mean over runs with its 95 % bootstrap interval, as far as all have come; thin: runs."
        pictures.append(Picture(title, caption, f"{file}.png", _curves_figure(runs, part, quantities, axis)))
    return pictures


def _quantities(curves: pd.DataFrame) -> Sequence[str]:
    """Return the curves to draw, at most four: those of which a run has more than one place."""
    places = curves.groupby(["quantity", "run"], sort=False)["x"].nunique().groupby("quantity", sort=False).max()
    known = [str(name) for name, count in places.items() if count >= _MIN_POINTS]
    preferred = [name for name in DRAWN_QUANTITIES if name in known]
    return preferred or known[:4]


def _curves_figure(runs: pd.DataFrame, curves: pd.DataFrame, quantities: Sequence[str], axis: str) -> Figure:
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
        _add_legend(figure, panels[0])
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


# ------------------------------------------------------------------------------------------------------------ page


def _page(
    name: str,
    runs: pd.DataFrame,
    figures: Sequence[dict[str, Any]],
    compared: Sequence[dict[str, Any]],
    pictures: Sequence[Picture],
) -> str:
    """Return HTML without any reference to the outside."""
    done = finished(runs)
    hours = float(done["cpu_seconds"].sum()) / 3600.0
    key = [
        ("runs finished", f"{len(done)} of {len(runs)}", ""),
        ("groups", str(runs["group"].nunique()), ""),
        ("seeds", str(runs["seed"].nunique()), ""),
        ("processor time of last attempts", f"{hours:.2f}", "h"),
    ]
    failed = runs[runs["status"] == "failed"]
    failures = "".join(f"<p>{html_text(f'{row.run}: {row.error}', 400)}</p>" for row in failed.itertuples())
    parts = [key_html(key), f'<div class="warning" role="status">{failures}</div>' if failures else ""]
    parts += [_picture(picture) for picture in pictures]
    parts.append(GROUPS.html(labelled(figures)) if figures else _NO_FIGURES)
    parts.append(COMPARISONS.html(labelled(compared)) if compared else "")
    parts.append(RUNS.html(runs.astype(object).where(runs.notna(), None).to_dict("records")))
    below = f'<p class="soft">{html_text(f"{len(runs)} runs · {program_version()}")}</p>'
    return page_shell(name, below, parts, [])


def _picture(picture: Picture) -> str:
    """Return a picture as a section of a page: it takes the page's colours, in light and dark, and its width."""
    target = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": picture.title}):
        picture.figure.savefig(target, format="svg", transparent=True, metadata={"Date": None})
    text = _DIMENSION.sub(rb"\1\2", target.getvalue(), count=1).decode()
    svg = colour_variables(text[text.index("<svg") :])
    figure = f"<div class=scroll>{svg}</div><figcaption>{escape(picture.caption)}</figcaption>"
    return f'<section><h2>{escape(picture.title)}</h2><figure class="card">{figure}</figure></section>'


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

    def html(self, records: Sequence[Mapping[str, Any]]) -> str:
        """Return it as a section of a page."""
        kinds = ["" if place == 0 or place >= self.left else " class=text" for place in range(len(self.columns))]
        head = "".join(
            f"<th{' class=text' if place < self.left else ''}>{escape(name)}</th>"
            for place, name in enumerate(self.columns)
        )
        rows = (zip(kinds, cells(self.columns.values(), record), strict=True) for record in records)
        lines = [f"<tr>{''.join(f'<td{kind}>{html_text(cell)}</td>' for kind, cell in row)}</tr>" for row in rows]
        above = f"<p class=soft>{self.note}</p>" if self.note else ""
        return f"<section><h2>{self.title}</h2>{above}{table_html(head, lines)}</section>"


_NO_FIGURES: Final = '<p class="soft">No run has finished with a figure yet.</p>'
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


def labelled(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of figures with a ``label`` for people."""
    return [{**row, "label": label_of(row["figure"])} for row in rows]
