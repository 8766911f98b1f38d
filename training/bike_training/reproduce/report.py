"""What is written of tables: figures, and text as Markdown."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

from bike_training.reproduce.paper import Paper


def draw_all(paper: Paper[Any, Any], data: Any, out: Path) -> list[Path]:
    """Draw all figures of a paper from its tables and return their files."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    paths = []
    for name, draw in paper.figures.items():
        figure = draw(data, plt)
        figure.savefig(out / name, dpi=90)
        plt.close(figure)
        paths.append(out / name)
    return paths


def all_tables(paper: Paper[Any, Any], data: Any) -> str:
    """Return all tables of a paper as Markdown, with headings."""
    return "\n".join(f"### {title}\n\n{write(data)}" for title, write in paper.written.items())
