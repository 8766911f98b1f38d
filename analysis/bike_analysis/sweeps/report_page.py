"""The report page of a sweep: figures with intervals, curves, profiles and comparisons in one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import pandas as pd

from bike_analysis.figures.numbers import significant
from bike_analysis.page.document import html_text, key_html, page_shell, program_version, table_html
from bike_analysis.sweeps.figures import Comparison, GroupFigure, finished
from bike_analysis.sweeps.pictures import group_colours, label_of


class PictureSection(NamedTuple):
    """A section of the page with the panels of a picture.

    Attributes:
        title: its headline. caption: below the panels, or empty. svgs: the panels.
    """

    title: str
    caption: str
    svgs: Sequence[str]


_INTERVAL = "interquartile mean over runs; in brackets its 95 % bootstrap interval"


def sweep_page(
    name: str,
    runs: pd.DataFrame,
    figures: Sequence[GroupFigure],
    compared: Sequence[Comparison],
    pictures: Sequence[PictureSection],
) -> str:
    """Make the page.

    Args:
        name: of the sweep.
        runs: its table of runs.
        figures: of its groups.
        compared: groups that share seeds.
        pictures: in the order of the page.

    Returns:
        HTML without any reference to the outside.
    """
    legend = _legend(runs)
    parts = [_key(runs), _failures(runs), *(_picture(section, legend) for section in pictures)]
    parts += [_figure_table(figures), _comparison_table(compared), _run_table(runs)]
    below = f'<p class="soft">{html_text(f"{len(runs)} runs · {program_version()}")}</p>'
    return page_shell(name, below, parts, [])


def _picture(section: PictureSection, legend: str) -> str:
    caption = f"<figcaption>{escape(section.caption)}</figcaption>" if section.caption else ""
    above = legend if len(section.svgs) > 1 or section.caption else ""
    panels = f'<div class="panels">{"".join(section.svgs)}</div>'
    return f'<section><h2>{escape(section.title)}</h2><figure class="card">{above}{panels}{caption}</figure></section>'


def _legend(runs: pd.DataFrame) -> str:
    """Say which colour is which group, where there are several."""
    groups = group_colours(runs)
    if len(groups) < 2:
        return ""
    counts = finished(runs)["group"].value_counts()
    entries = "".join(
        f'<span><i style="background:var(--{colour})"></i>{html_text(group)} ({counts[group]} runs)</span>'
        for group, colour in groups
    )
    return f'<div class="legend">{entries}</div>'


def _key(runs: pd.DataFrame) -> str:
    done = finished(runs)
    entries = [
        ("runs finished", f"{len(done)} of {len(runs)}", ""),
        ("groups", str(runs["group"].nunique()), ""),
        ("seeds", str(runs["seed"].nunique()), ""),
        ("processor time of last attempts", f"{float(done['cpu_seconds'].sum()) / 3600.0:.2f}", "h"),
    ]
    return key_html(entries)


def _failures(runs: pd.DataFrame) -> str:
    failed = runs[runs["status"] == "failed"]
    lines = "".join(f"<p>{html_text(f'{row.run}: {row.error}', 400)}</p>" for row in failed.itertuples())
    return f'<div class="warning" role="status">{lines}</div>' if lines else ""


def _figure_table(figures: Sequence[GroupFigure]) -> str:
    if not figures:
        return '<p class="soft">No run has finished with a figure yet.</p>'
    names = ("group", "figure", "runs", "IQM", "95 % interval", "mean", "median", "least", "largest")
    rows = [
        "<tr>"
        + f"<td>{html_text(entry['group'])}</td><td class=text>{escape(label_of(entry['figure']))}</td>"
        + f"<td>{entry['runs']}</td><td>{significant(entry['iqm'])}</td>"
        + f"<td>{interval_text(entry['low'], entry['high'])}</td>"
        + "".join(
            f"<td>{significant(value)}</td>" for value in (entry["mean"], entry["median"], entry["min"], entry["max"])
        )
        + "</tr>"
        for entry in figures
    ]
    return f"<section><h2>Figures</h2><p class=soft>{_INTERVAL}</p>{table_html(_head(names, 2), rows)}</section>"


def _comparison_table(compared: Sequence[Comparison]) -> str:
    if not compared:
        return ""
    names = ("figure", "first", "second", "seeds", "second − first", "95 % interval", "second larger")
    rows = [
        f"<tr><td>{escape(label_of(entry['figure']))}</td><td class=text>{html_text(entry['first'])}</td>"
        f"<td class=text>{html_text(entry['second'])}</td><td>{entry['seeds']}</td>"
        f"<td>{significant(entry['difference'])}</td><td>{interval_text(entry['low'], entry['high'])}</td>"
        f"<td>{100.0 * entry['share_larger']:.0f} %</td></tr>"
        for entry in compared
    ]
    words = "Each seed with itself: interquartile mean of the differences, and how often the second is larger."
    return f"<section><h2>Paired comparisons</h2><p class=soft>{words}</p>{table_html(_head(names, 3), rows)}</section>"


def _run_table(runs: pd.DataFrame) -> str:
    names = ("run", "status", "attempts", "last attempt s", "machine", "commit")
    rows = []
    for _, row in runs.iterrows():
        cells = [html_text(str(row["run"])), html_text(str(row["status"]))]
        cells += [
            "–" if pd.isna(row[name]) else html_text(str(row[name]))
            for name in ("attempts", "seconds", "host", "commit")
        ]
        first, second, *rest = cells
        rows.append(
            f"<tr><td>{first}</td><td class=text>{second}</td>{''.join(f'<td>{cell}</td>' for cell in rest)}</tr>"
        )
    return f"<section><h2>Runs</h2>{table_html(_head(names, 2), rows)}</section>"


def _head(names: Sequence[str], texts: int) -> str:
    """Return the head of a table whose first columns are text."""
    return "".join(f"<th{' class=text' if k < texts else ''}>{escape(name)}</th>" for k, name in enumerate(names))


def interval_text(low: float | None, high: float | None) -> str:
    """Return an interval for people; a dash where one run has none."""
    return "–" if low is None or high is None else f"[{significant(low)}, {significant(high)}]"
