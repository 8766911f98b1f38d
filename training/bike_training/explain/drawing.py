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
"""Rows of all values; the features of least weight share the last one."""


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


def draw(explanation: Explanation, title: str, path: Path) -> None:
    """Draw the parts' mean magnitudes, the largest on top, a panel for each action; of a path all values beside them.

    Args:
        explanation: the values.
        title: line above.
        path: picture.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    races, count = explanation.layout.races, len(explanation.actions)
    names = [name.replace("_", " ") for name in explanation.parts] if races else labels(explanation.layout)
    means, shares = (each.reshape(len(names), count) for each in (explanation.mean_abs, explanation.shares))
    panels = count if races else count + 1
    size = (6.5 * panels, 0.28 * len(names) + 1.6)
    fig, axes = plt.subplots(1, panels, figsize=size, layout="constrained", squeeze=False)
    for column, action in enumerate(explanation.actions):
        panel, unit = axes[0][column], UNITS[action]
        order = np.argsort(means[:, column])
        bars = panel.barh([names[i] for i in order], unit.factor * means[order, column])
        panel.bar_label(bars, [f"{shares[i, column]:.0%}" for i in order], padding=3)
        panel.margins(x=0.12)
        panel.set_xlabel(f"{unit.name}: mean |SHAP value| / {unit.unit}, and its share")
    if not races:
        degrees = shap.Explanation(np.degrees(explanation.values), data=explanation.features, feature_names=names)
        shap.plots.beeswarm(degrees, max_display=SHOWN, ax=axes[0][-1], plot_size=None, show=False)
        axes[0][-1].set_xlabel("SHAP value: share in the steering set point, positive left / °")
    fig.suptitle(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(path, dpi=100)
    plt.close(fig)
