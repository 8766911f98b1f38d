#!/usr/bin/env python
"""Draw the shake of superbikes on the brake in a lean, before and after the rider had arms.

    python tools/draw_shake.py docs/images/superbike_shakes.png

The numbers are `docs/data/superbike_shake.csv`: the rides of `bike validate superbike`, g rms, inf for a fall. The
column `before` was measured by the same rides at commit 828fec7.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DATA = Path(__file__).resolve().parent.parent / "docs" / "data" / "superbike_shake.csv"
ALLOWED = 0.05
FALL = 1.5
"""Where falls are drawn, g."""


def main(target: str) -> None:
    """Draw the largest shake of five machines and all speeds over the lean, a curve for each brake."""
    with DATA.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, column, title in zip(panels, ("before", "now"), ("without arms", "now"), strict=True):
        leans = sorted({float(row["lean_deg"]) for row in rows})
        for brake in sorted({float(row["brake"]) for row in rows}):
            worst = [
                max(
                    float(row[column])
                    for row in rows
                    if float(row["brake"]) == brake and float(row["lean_deg"]) == lean
                )
                for lean in leans
            ]
            axes.semilogy(leans, np.clip(worst, 1e-3, FALL), "o-", markersize=4, label=f"brake {brake:g}")
        axes.axhline(ALLOWED, color="0.4", linestyle="--", linewidth=0.9)
        axes.set(title=title, xlabel="lean, deg", ylim=(8e-4, 1.2 * FALL))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("shake, worst of five machines\nand 15 to 80 m/s, g rms (top: a fall)")
    panels[0].legend(fontsize="small")
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main(sys.argv[1])
