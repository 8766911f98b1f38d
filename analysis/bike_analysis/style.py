"""One look for all figures, on paper and on the page, in light and in dark.

Figures are drawn once, in the light colours. On the page `themed_svg` replaces each of them by a CSS variable of the
same meaning, so that one drawing follows the reader's colour scheme. The line colours are told apart also by readers
with colour-blindness (they differ in lightness and lie on the blue-orange axis); the error scale is viridis, with large
errors farthest from the background in both schemes.
"""

from __future__ import annotations

import re
from io import StringIO
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import ListedColormap, to_hex
from matplotlib.figure import Figure

INK: Final = "#1f2328"
MUTED: Final = "#5e6875"
GRID: Final = "#dde1e6"
BAND: Final = "#c4cad2"
BLUE: Final = "#0b66ad"
ORANGE: Final = "#c4501b"
GREEN: Final = "#00795f"

_DARK: Final = {
    INK: "#e6e9ee",
    MUTED: "#9aa5b3",
    GRID: "#2c333c",
    BAND: "#4b5563",
    BLUE: "#62b0f4",
    ORANGE: "#f2915c",
    GREEN: "#43c9a3",
}
_NAMES: Final = {INK: "ink", MUTED: "muted", GRID: "grid", BAND: "band", BLUE: "blue", ORANGE: "orange", GREEN: "green"}

_DECIMALS: Final = re.compile(r"(\.\d\d)\d+")
_ERROR_LEVELS: Final = 16
_VIRIDIS: Final = mpl.colormaps["viridis"]
_ERROR_LIGHT: Final = [to_hex(_VIRIDIS(x)) for x in np.linspace(0.86, 0.0, _ERROR_LEVELS)]
_ERROR_DARK: Final = [to_hex(_VIRIDIS(x)) for x in np.linspace(0.28, 1.0, _ERROR_LEVELS)]
ERROR_MAP: Final = ListedColormap(_ERROR_LIGHT, name="ride_error")

RC: Final[dict[str, Any]] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "text.color": INK,
    "lines.linewidth": 1.3,
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "svg.fonttype": "none",
    "svg.hashsalt": "two-wheeler-lab",
    "path.simplify_threshold": 0.2,
}


def style_variables(dark: bool) -> str:
    """Declare the colours as CSS variables.

    Args:
        dark: For the dark scheme.

    Returns:
        Declarations, ``--ink: #...;`` and so on.
    """
    lines = {name: _DARK[colour] if dark else colour for colour, name in _NAMES.items()}
    levels = _ERROR_DARK if dark else _ERROR_LIGHT
    lines |= {f"e{index}": colour for index, colour in enumerate(levels)}
    return " ".join(f"--{name}: {colour};" for name, colour in lines.items())


def themed_svg(figure: Figure, label: str, prefix: str) -> str:
    """Render a figure as an SVG element for the page.

    Args:
        figure: What to draw.
        label: What it shows, for readers who do not see it.
        prefix: Put before all ids, which must differ within a page.

    Returns:
        An ``<svg>`` element without outside references, coloured by the page's variables and lettered in its font.
    """
    buffer = StringIO()
    with mpl.rc_context(RC):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{prefix}-\1"', text)
    text = re.sub(r"'DejaVu Sans'(, sans-serif)?", "var(--font)", text)
    text = re.sub(r'(?<=\bd=")[^"]+', lambda path: _DECIMALS.sub(r"\1", path[0]), text)
    for index, colour in enumerate(_ERROR_LIGHT):
        text = text.replace(colour, f"var(--e{index})")
    for colour, name in _NAMES.items():
        text = text.replace(colour, f"var(--{name})")
    box = re.search(r'viewBox="([^"]+)"', text)
    assert box is not None, "matplotlib gives every SVG a viewBox"
    inside = text[text.index(">", box.start()) + 1 :]
    return (
        f'<svg role="img" aria-label="{label}" viewBox="{box[1]}" xmlns:xlink="http://www.w3.org/1999/xlink">{inside}'
    ).strip()
