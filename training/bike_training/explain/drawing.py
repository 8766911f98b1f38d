"""Pictures of SHAP values, as Fig. 14 of Weyrer et al. (2026): mean magnitudes, and a dot for each observation."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
import shap  # type: ignore[import-untyped]

from bike_policy.contract.observation import ObservationLayout
from bike_training.explain.shap_values import Explanation
from bike_training.explain.symbols import SYMBOLS

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
