"""The picture of `bike validate`: eigenvalues over speed, measured on published."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bike_sim.validation.report import Mode

COLOURS: Final = {"weave": "tab:blue", "wobble": "tab:orange", "capsize": "tab:green"}


def draw_modes(modes: Sequence[Mode], path: Path) -> Path:
    """Draw real parts and frequencies over speed, a row for each variant.

    Args:
        modes: of a report; lines are published values, markers those of the engine.
        path: PNG file to write.
    """
    variants = list(dict.fromkeys(mode.variant for mode in modes))
    figure = Figure(figsize=(9.0, max(4.0, 2.4 * len(variants))), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(variants), 2, sharex=True, squeeze=False)
    for variant, (real, frequency) in zip(variants, rows, strict=True):
        for name, colour in COLOURS.items():
            of_it = sorted((mode for mode in modes if (mode.variant, mode.name) == (variant, name)), key=lambda m: m[1])
            speeds = [mode.speed for mode in of_it]
            for values, style, label in (
                ([mode.published for mode in of_it], "-", f"{name}, published"),
                ([mode.measured for mode in of_it], "o", f"{name}, measured"),
            ):
                for axes, parts in ((real, np.real(values)), (frequency, np.imag(values) / math.tau)):
                    if np.isfinite(parts).any() and (axes is real or np.any(parts)):
                        axes.plot(speeds, parts, style, color=colour, markersize=4.5, fillstyle="none", label=label)
        real.axhline(0.0, color="0.7", linewidth=0.8)
        real.set(title=variant, ylabel="real part, 1/s")
        frequency.set(ylabel="frequency, Hz", ylim=(0.0, None))
        for axes in (real, frequency):
            axes.grid(alpha=0.3)
    for axes in rows[-1]:
        axes.set_xlabel("speed, m/s")
    rows[0, 0].legend(fontsize="x-small")
    figure.savefig(path, dpi=100)
    return path
