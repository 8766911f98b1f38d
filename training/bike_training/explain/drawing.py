"""Pictures of SHAP values: of paths as Fig. 14 of Weyrer et al. (2026), of races a panel for each part of an action."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import matplotlib as mpl
import numpy as np
import shap  # type: ignore[import-untyped]

from bike_policy.contract.action import DRIVE, LEAN_REQUEST, LINE_OFFSET, PACE, STEERING_SET_VALUE
from bike_policy.contract.observation import ObservationLayout
from bike_training.explain.shap_values import Explanation

SYMBOLS: Final = {
    "roll": "roll φ",
    "steer": "steer δ",
    "roll_rate": "roll rate dφ/dt",
    "steer_rate": "steer rate dδ/dt",
    "rear_wheel": "rear wheel angle",
    "front_wheel": "front wheel angle",
    "front_wheel_rate": "front wheel rate",
    "yaw_cos": "cos ψ",
    "yaw_sin": "sin ψ",
}
"""Readable names of features."""


SHOWN: Final = 10
"""Rows of the picture; the features of least weight share the last one."""


def labels(layout: ObservationLayout) -> list[str]:
    """Return one readable label for each number of an observation."""
    unit = "s" if layout.preview_by_time else "m"
    ahead = [f"{k * layout.preview_interval:g} {unit}" for k in range(layout.preview_count)]
    if "preview_points" in layout.terms:
        preview = [f"t_p{k}: line {distance} ahead" for k, distance in enumerate(ahead)]
    else:  # a second difference belongs to its middle point
        preview = ["t_p0: offset", "t_p1: lateral velocity"]
        preview += [f"t_p{k}: lean {ahead[k - 1]} ahead" for k in range(2, layout.preview_count)]
    return [SYMBOLS.get(feature, feature) for feature in layout.terms[:-1]] + preview


def draw(explanation: Explanation, title: str, path: Path) -> None:
    """Draw bar and beeswarm plot side by side.

    Args:
        explanation: the values.
        title: line above.
        path: picture.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    degrees = shap.Explanation(
        np.degrees(explanation.values),
        base_values=np.full(len(explanation.values), np.degrees(explanation.base)),
        data=explanation.features,
        feature_names=labels(explanation.layout),
    )
    fig, (bars, swarm) = plt.subplots(1, 2, figsize=(14, 5.5), layout="constrained", width_ratios=(2, 3))
    shap.plots.bar(degrees, max_display=SHOWN, ax=bars, show=False)
    shap.plots.beeswarm(degrees, max_display=SHOWN, ax=swarm, plot_size=None, show=False)
    bars.set_xlabel("mean |SHAP value| / °")
    swarm.set_xlabel("SHAP value: share in the steering set point, positive left / °")
    fig.suptitle(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(path, dpi=100)
    plt.close(fig)


class Unit(NamedTuple):
    """Display of an action: its name for people, a factor, and the unit after it."""

    name: str
    factor: float
    unit: str


UNITS: Final = {
    STEERING_SET_VALUE: Unit("steering set point", 180.0 / np.pi, "°"),
    LINE_OFFSET: Unit("distance from the line", 1.0, "m"),
    PACE: Unit("change of pace", 100.0, "%"),
    LEAN_REQUEST: Unit("steering", 100.0, "%"),
    DRIVE: Unit("throttle and brake", 100.0, "%"),
}
"""Of the meanings of actions."""


def draw_blocks(explanation: Explanation, title: str, path: Path) -> None:
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
        1, count, figsize=(6.5 * count, 0.28 * len(explanation.parts) + 1.6), layout="constrained", squeeze=False
    )
    for column, (panel, action) in enumerate(zip(panels[0], explanation.actions, strict=True)):
        unit = UNITS[action]
        size = unit.factor * explanation.mean_abs[:, column]
        order = np.argsort(size)
        bars = panel.barh([explanation.parts[i].replace("_", " ") for i in order], size[order])
        panel.bar_label(bars, [f"{explanation.shares[i, column]:.0%}" for i in order], padding=3)
        panel.margins(x=0.12)
        panel.set_xlabel(f"{unit.name}: mean |SHAP value| / {unit.unit}, and its share")
    fig.suptitle(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(path, dpi=100)
    plt.close(fig)
