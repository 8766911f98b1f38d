"""One set of colours for the page, in light and in dark, and for the picture that matplotlib draws.

The line colours can be distinguished with colour-blindness (they differ in lightness and lie first of all on
the blue-orange axis); the scale of errors is viridis, with large errors farthest from the background in both schemes.
"""

from __future__ import annotations

from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.colors import ListedColormap, to_hex

INK: Final = "#1f2328"
MUTED: Final = "#5e6875"
GRID: Final = "#e3e6eb"
BAND: Final = "#c4cad2"
BLUE: Final = "#0b66ad"
ORANGE: Final = "#c4501b"

_LIGHT: Final = {
    "ink": INK,
    "muted": MUTED,
    "grid": GRID,
    "band": BAND,
    "blue": BLUE,
    "orange": ORANGE,
    "green": "#00795f",
    "violet": "#7a4cb8",
    "gold": "#8f6a00",
    "rose": "#b3306b",
    "aid1": "#e0218a",
    "aid2": "#6b8e00",
    "aid3": "#00a0b0",
    "aid4": "#8a5a44",
}
_DARK: Final = {
    "ink": "#e6e9ee",
    "muted": "#9aa5b3",
    "grid": "#29313a",
    "band": "#4b5563",
    "blue": "#62b0f4",
    "orange": "#f2915c",
    "green": "#43c9a3",
    "violet": "#bb9af0",
    "gold": "#e0b84a",
    "rose": "#f08ab8",
    "aid1": "#ff6ec0",
    "aid2": "#b9d94f",
    "aid3": "#4cd8e6",
    "aid4": "#d3a184",
}
_SURFACES_DARK: Final = {
    "page": "#0f1317",
    "card": "#181d23",
    "line": "#2c333c",
    "soft": "#9aa5b3",
    "good": "#43c9a3",
    "bad": "#f2915c",
    "press": "#252d37",
    "shade": "none",
}

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
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
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
    "text.parse_math": False,  # a name with dollar signs is no formula
    "lines.solid_joinstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


def colour(name: str) -> str:
    """Return a colour of the light scheme by its name."""
    return _LIGHT[name]


def colour_variables(svg: str) -> str:
    """Let a picture take the page's colours: those of the light scheme become the variables that the page declares."""
    for name, value in _LIGHT.items():
        svg = svg.replace(value, f"var(--{name})")
    return svg


def style_variables(dark: bool) -> str:
    """Declare the colours as CSS variables.

    Args:
        dark: For the dark scheme.

    Returns:
        Declarations, ``--ink: #...;`` and so on; in the dark scheme those of the page's surfaces, too.
    """
    variables = {**_SURFACES_DARK, **_DARK} if dark else dict(_LIGHT)
    variables |= {f"e{index}": colour for index, colour in enumerate(_ERROR_DARK if dark else _ERROR_LIGHT)}
    scheme = "color-scheme: dark; " if dark else ""
    return scheme + " ".join(f"--{name}: {value};" for name, value in variables.items())
