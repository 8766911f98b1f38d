"""Interactive views of a page: records of what is drawn, their data and their HTML.

A view has one cursor and one shown range for everything that it draws: panels over distance or time, a map, a cloud of
points, the ride seen from behind. ``view.js`` draws it; these records, as JSON, say what there is to draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from html import escape
from importlib.resources import files
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.page.document import embed, html_text
from bike_analysis.read.container import shown
from bike_analysis.read.messages import Floats
from bike_sim.documents import parse_yaml
from bike_sim.schema import Quantity

SERIES_COLOURS: Final = ("blue", "orange", "green", "violet", "gold", "rose")
"""Names of the colours of several series, in order; repeated if there are more."""
MAP_QUANTUM: Final = 1e-3
"""Places are kept to this, m."""
LINE_POINTS: Final = 6000
"""Points of a line behind the map, at most."""


@dataclass(frozen=True)
class Channel:
    """A quantity.

    Attributes:
        label: Readable name.
        unit: As it is shown; empty without one.
        digits: Decimals that are shown; two more are kept.
        source: Quantity of `bike_sim.schema` that it shows; empty where it is computed.
        absolute: Whether the map is coloured by its size alone.
    """

    label: str
    unit: str
    digits: int
    source: str = ""
    absolute: bool = False


_FACTORS: Final = {
    ("rad", "°"): 180.0 / np.pi,
    ("rad/s", "°/s"): 180.0 / np.pi,
    ("1", "%"): 100.0,
    ("N", "kN"): 1e-3,
    ("m/s", "km/h"): 3.6,
    ("m", "mm"): 1e3,
    ("m/s", "mm/s"): 1e3,
}
"""Factors from units of the schema to those that are shown."""


def factor(channel: Channel, quantity: Quantity) -> float:
    """Factor from a quantity's unit to that of the channel that shows it."""
    return _FACTORS.get((quantity.unit, channel.unit), 1.0)


Drawn = dict[str, Any]
"""Something that a view draws, by the names that `View` lists; JSON as it stands."""

_TABLES: Final = parse_yaml((files("bike_analysis.page") / "panels.yaml").read_text(encoding="utf-8"))
CHANNELS: Final = {name: Channel(*row) for name, row in _TABLES["channels"].items()}
"""Quantities that views show, by the name of their column."""
PANEL: Final[Drawn] = {"caption": "", "zero": True, "least": 0.0, "ends": None, "bands": (), "folded": False}
"""What a panel is where it does not say."""
PANELS: Final[dict[str, Drawn]] = {key: {"key": key} | PANEL | row for key, row in _TABLES["panels"].items()}
"""Panels that views show, by key; ``panels.yaml`` describes them."""
FAST_CHANNELS: Final = {name: replace(CHANNELS[name], unit="km/h", digits=1) for name in ("speed", "speed_delta")}
"""Speeds of machines that ride on roads and circuits."""
FOLLOWED: Final = ("speed", "roll", "steer", "throttle", "brake", "gear", "engine")
"""Columns of the instruments of the view from behind."""


@dataclass(frozen=True)
class Series:
    """A ride, a lap or a theory: columns of equal length, ``distance`` and ``time`` among them, neither falling.

    Attributes:
        name: For people.
        columns: By name.
        colour: Name of a colour.
        theory: Whether it was computed and not ridden.
        kind: Kind of lap; empty for a ride that is alone.
    """

    name: str
    columns: dict[str, Floats]
    colour: str = "blue"
    theory: bool = False
    kind: str = ""


@dataclass(frozen=True)
class MapLine:
    """A line behind the trajectory: ``reference`` or ``limit`` in `role`; positions in m."""

    name: str
    role: str
    x: Floats
    y: Floats


@dataclass(frozen=True)
class View:
    """All that one view draws.

    Attributes:
        key: Unique name on the page.
        title: Of exported pictures.
        series: The first one carries the cursor.
        panels: From top to bottom, as in `PANELS`.
        lines: Behind the map.
        marks: Known places on the map: ``name``, ``symbol`` (``triangle-up``, ``square``, ``x-thin``, ``circle-open``),
            ``colour``, and lists of ``x`` and ``y``, m.
        labels: On the map: ``x``, ``y`` and ``text``.
        sections: Ranges of the first series: ``label``, ``name``, rows ``first`` to ``last`` (exclusive), and
            ``shaded`` for those that stand alone.
        colours: Columns by which the path may be coloured; the first is chosen.
        map_caption: Below the map.
        channels: Differing from `CHANNELS`, as `FAST_CHANNELS`.
        cloud: Points of the column ``x`` over ``y`` with the same scale on both axes, or None: ``title``, ``x_label``,
            ``y_label``, ``box`` (ends of x and y), ``caption`` and ``limit``, the largest accelerations of a machine,
            or None: for each of ``speeds``, in ``unit``, closed ``curves`` of x and y.
        follow: Additional data of the follow view, or None.
        bands: When something acted on the first series: ``key``, ``name``, ``colour``, and ``rows``, ranges with their
            first and last row.
        histograms: Distributions over time, after the panels: ``key``, ``title``, ``label`` of the horizontal axis,
            ``edges`` of the bins, ``shares`` of the time in each bin, %, by name of the series, and ``caption``.
        moments: What happened at a ``row`` of a ``series``, as a fall, marked in the traces with its ``label``.
        reference: Index of the series that the page computes ``delta`` and ``speed_delta`` against until the reader
            chooses another; None where the columns are given, or there is nothing to compare.
        leads: Whether the reader may choose which series carries the cursor and is seen from behind.
    """

    key: str
    title: str
    series: tuple[Series, ...]
    panels: tuple[Drawn, ...]
    lines: tuple[MapLine, ...] = ()
    marks: tuple[Drawn, ...] = ()
    labels: tuple[Drawn, ...] = ()
    sections: tuple[Drawn, ...] = ()
    colours: tuple[str, ...] = ()
    map_caption: str = ""
    channels: dict[str, Channel] = field(default_factory=dict)
    cloud: Drawn | None = None
    follow: Drawn | None = None
    bands: tuple[Drawn, ...] = ()
    histograms: tuple[Drawn, ...] = ()
    moments: tuple[Drawn, ...] = ()
    reference: int | None = None
    leads: bool = False

    def channel(self, name: str) -> Channel:
        """The quantity of a column."""
        return self.channels.get(name, CHANNELS[name])

    def data(self) -> dict[str, Any]:
        """The view as plain values for JSON; all text is made fit to be shown."""
        names = self._drawn()
        channels = {name: self.channel(name) for name in sorted(names)}
        plain: dict[str, Any] = _plain(replace(self, series=(), lines=(), channels=channels))
        plain["axes"] = ["distance", "time"]
        for line in self.lines:
            every = max(1, -(-len(line.x) // LINE_POINTS))
            rows = (
                np.unique(np.append(np.arange(0, len(line.x), every), len(line.x) - 1)) if len(line.x) else np.arange(0)
            )
            plain["lines"].append(_plain(replace(line, x=line.x[rows], y=line.y[rows])))
        for series in self.series:
            columns = {
                n: embed(c, MAP_QUANTUM if n in ("x", "y") else 10.0 ** -(self.channel(n).digits + 2))
                for n, c in series.columns.items()
                if n in names
            }
            plain["series"].append(_plain(replace(series, columns={})) | {"columns": columns})
        return plain

    def _drawn(self) -> set[str]:
        """Names of the columns that something draws; the page carries no others."""
        names = {"distance", "time", "x", "y", "yaw", *self.colours}
        names |= {line["column"] for panel in self.panels for line in panel["lines"]}
        if self.cloud is not None:
            names |= {self.cloud["x"], self.cloud["y"], "speed"}
        if self.reference is not None:
            names.add("speed")  # the page computes differences of it
        return names | set(FOLLOWED) if self.follow is not None else names


def _plain(value: Any) -> Any:
    """Records as dictionaries, text fit to be shown, and positions as embedded columns; captions are in the frame."""
    if isinstance(value, str):
        return shown(value)
    if isinstance(value, np.ndarray):
        return embed(value, MAP_QUANTUM)
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, dict):
        return {shown(key): _plain(part) for key, part in value.items() if key != "caption"}
    return [_plain(part) for part in value] if isinstance(value, list | tuple) else value


def growing(values: NDArray[Any]) -> Floats:
    """The running maximum of a column; missing values take the last maximum."""
    filled = np.where(np.isfinite(values), values, -np.inf)
    highest = np.maximum.accumulate(filled) if len(filled) else filled
    return np.where(np.isfinite(highest), highest, values[np.isfinite(values)][0] if np.isfinite(values).any() else 0.0)


def series_colour(index: int) -> str:
    """Colour of the series with this index."""
    return SERIES_COLOURS[index % len(SERIES_COLOURS)]


# ---- as HTML --------------------------------------------------------------------------------------------------------

_FOLLOW: Final = (
    '<figure class="follow" data-plot="follow"><canvas width="960" height="540" role="img" '
    'aria-label="The ride seen from behind, at the cursor"></canvas></figure>'
)
_EXPORT: Final = '<span class="export"><button type="button" data-save aria-label="Save “@” as PNG">PNG</button></span>'


def view_html(view: View, pads: Sequence[str] = ()) -> str:
    """Return the frame of a view: its figures with titles, captions and buttons, into which the script draws.

    Args:
        view: The view.
        pads: HTML of what stands to the left and to the right of the map where it is touched.
    """
    map_html = _map_html(view) if "x" in view.series[0].columns else ""
    if pads:
        map_html = f'<div class="pads">{map_html.join(pads)}</div>'
    panels = [_panel_html(view, panel) for panel in view.panels]
    if view.cloud is not None:
        panels.append(_figure("cloud", view.cloud["title"], view.cloud["caption"], "cloud"))
    if view.histograms:
        figures = [_figure(h["key"], h["title"], h["caption"], "histogram") for h in view.histograms]
        panels.append(f'<div class="row">{"".join(figures)}</div>')
    return "\n".join(
        [
            f'<div class="view" id="{escape(view.key)}-view">',
            _tools_html(view),
            f'<div class="bench"><div class="side">{"" if view.follow is None else _FOLLOW}{map_html}</div>',
            f'<div class="traces">{"".join(panels)}</div></div></div>',
        ]
    )


def _figure(key: str, title: str, caption: str, kind: str, head: str = "", foot: str = "") -> str:
    """A drawing with its head; that of a panel is a button that folds it."""
    name = escape(title, quote=True)
    words = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    expanded = "false" if "folded" in kind else "true"
    fold = f'<button type="button" class="fold" aria-expanded="{expanded}">{name}</button>'
    heading = fold if kind.startswith("panel") else name
    return (
        f'<figure class="card {kind}" data-plot="{key}"><header><h4>{heading}</h4>{head}'
        f'<div class="legend"></div>{_EXPORT.replace("@", name)}</header><div class="plot"></div>{foot}{words}</figure>'
    )


def _panel_html(view: View, panel: Drawn) -> str:
    """A panel with the unit of its vertical axis next to the title, because the ticks leave no room for it."""
    unit = view.channel(panel["lines"][0]["column"]).unit
    head = f'<small class="soft">in {escape(unit)}</small>' if unit else ""
    return _figure(panel["key"], panel["title"], panel["caption"], "panel folded" if panel["folded"] else "panel", head)


def _map_html(view: View) -> str:
    several = len(view.series) > 1
    options = [f'<option value="{name}">{escape(view.channel(name).label)}</option>' for name in view.colours]
    if several:
        options.append('<option value="">which ride or lap</option>')
    choice = ""
    if len(options) > 1:
        choice = '<label class="choice"><span>coloured by </span><select aria-label="The path is coloured by">'
        choice += f"{''.join(options)}</select></label>"
    return _figure("map", "Map", view.map_caption, "map", choice, '<div class="scale"></div>')


def _tools_html(view: View) -> str:
    axis = "".join(
        f'<label><input type="radio" name="{escape(view.key)}-axis" value="{name}"{checked}>{name}</label>'
        for name, checked in (("distance", " checked"), ("time", ""))
    )
    rates = "".join(
        f'<option value="{rate}"{" selected" if rate == "1" else ""}>{rate} ×</option>'
        for rate in ("0.25", "1", "4", "16", "64")
    )
    buttons = (
        ("play", "Play", "Play or pause"),
        ("in", "+", "Zoom in"),
        ("out", "−", "Zoom out"),
        ("whole", "All", "Show the whole ride"),
    )
    shown = "".join(
        f'<button type="button" data-do="{key}" aria-label="{name}" title="{name}">{text}</button>'
        for key, text, name in buttons
    )
    series = '<div class="series" role="group" aria-label="Shown"></div>' if len(view.series) > 1 else ""
    if view.leads:
        series += _series_choice(view, 0, "from behind ", "leader", "Who carries the cursor and is seen from behind")
    if view.reference is not None:
        series += _series_choice(view, view.reference, "differences to ", "reference", "Reference of the differences")
    return (
        f'<div class="tools"><div class="transport"><div class="buttons">{shown}'
        f'<select class="rate" aria-label="Pace of playing">{rates}</select></div>'
        f'<p class="now"><span></span><span></span><span></span></p></div>'
        f'<fieldset class="switch"><legend>over</legend>{axis}</fieldset>{series}</div>'
    )


def _series_choice(view: View, chosen: int, words: str, kind: str, label: str) -> str:
    """A choice among the series."""
    options = "".join(
        f'<option value="{k}"{" selected" if k == chosen else ""}>{html_text(series.name)}</option>'
        for k, series in enumerate(view.series)
    )
    return f'<label class="choice">{words}<select class="{kind}" aria-label="{label}">{options}</select></label>'
