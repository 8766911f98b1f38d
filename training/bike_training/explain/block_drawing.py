"""Pictures of the SHAP values of a racing policy's blocks: mean magnitudes, one panel for each number of the action."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import matplotlib as mpl
import numpy as np

from bike_policy.contract.action import DRIVE, LEAN_REQUEST, LINE_OFFSET, PACE
from bike_training.explain.block_values import BlockExplanation


class Unit(NamedTuple):
    """How an action is shown: its name for people, a factor, and the unit after it."""

    name: str
    factor: float
    unit: str


UNITS: Final = {
    LINE_OFFSET: Unit("distance from the line", 1.0, "m"),
    PACE: Unit("change of pace", 100.0, "%"),
    LEAN_REQUEST: Unit("steering", 100.0, "%"),
    DRIVE: Unit("throttle and brake", 100.0, "%"),
}
"""Of the meanings that races know."""


def draw_blocks(explanation: BlockExplanation, title: str, path: Path) -> None:
    """Draw the blocks' mean magnitudes, the largest on top.

    Args:
        explanation: the values.
        title: line above.
        path: picture.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    count = len(explanation.actions)
    fig, panels = plt.subplots(
        1, count, figsize=(6.5 * count, 0.28 * len(explanation.blocks) + 1.6), layout="constrained", squeeze=False
    )
    for column, (panel, action) in enumerate(zip(panels[0], explanation.actions, strict=True)):
        unit = UNITS[action]
        size = unit.factor * explanation.mean_abs[:, column]
        order = np.argsort(size)
        bars = panel.barh([explanation.blocks[i].replace("_", " ") for i in order], size[order])
        panel.bar_label(bars, [f"{explanation.shares[i, column]:.0%}" for i in order], padding=3)
        panel.margins(x=0.12)
        panel.set_xlabel(f"{unit.name}: mean |SHAP value| / {unit.unit}, and its share")
    fig.suptitle(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(path, dpi=100)
    plt.close(fig)
