"""Which parts of an observation make a policy steer as it does: SHAP values of its actor.

A SHAP value says how much one feature of one observation moves the output away from the base value, which is the mean
output over a background. The values of an observation sum to its output minus the base value (Lundberg and Lee 2017).

Source: Weyrer et al. (2026), Sect. 5.5: the permutation explainer of the package ``shap`` on the observations of a
ride through a slalom.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import shap  # type: ignore[import-untyped]
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import ObservationLayout
from bike_training.explain.observations import path_layout

FloatArray = NDArray[np.float64]

PERMUTATIONS: Final = 10
"""Orders, each also backwards, in which the features of an observation are put in."""
BACKGROUND: Final = 100
"""Observations, evenly spread over the section, that stand for features not put in yet."""


@dataclass(frozen=True, kw_only=True)
class ShapValues:
    """SHAP values of a policy on n observations.

    Attributes:
        values: share of each part of an observation in the output, in the output's unit, shape (n, parts, ...).
        base: mean output over the background.
        outputs: of the policy, shape (n, ...).
        background: observations in the background.
        permutations: orders tried for each observation.
        seconds: wall-clock time it took, s.
    """

    values: FloatArray
    base: FloatArray | float
    outputs: FloatArray
    background: int
    permutations: int
    seconds: float

    @property
    def mean_abs(self) -> FloatArray:
        """Mean magnitude of each part's values, in the output's unit, shape (parts, ...)."""
        return np.abs(self.values).mean(axis=0)

    @property
    def additivity_error(self) -> float:
        """Largest difference of base and values to the outputs; not zero by rounding only."""
        return float(np.abs(self.base + self.values.sum(axis=1) - self.outputs).max())


@dataclass(frozen=True, kw_only=True)
class Explanation(ShapValues):
    """SHAP values of k features in the set point of the steering angle, rad.

    Attributes:
        layout: of the observation.
        features: values of the features in their own units (rad, rad/s, m, m/s, tangent), shape (n, k).
    """

    layout: ObservationLayout
    features: FloatArray
    base: float


def set_values(bundle: Bundle, observations: NDArray[np.floating]) -> FloatArray:
    """Return the set point of the steering angle that a policy requests, rad.

    Args:
        bundle: policy.
        observations: shape (n, size).
    """
    actions = bundle.actor.act_batch(np.asarray(observations, dtype=np.float32))
    return np.asarray(actions[:, 0], dtype=np.float64) * bundle.action.columns[0].scale


def explain(
    bundle: Bundle,
    observations: NDArray[np.float32],
    *,
    permutations: int = PERMUTATIONS,
    background: int = BACKGROUND,
    seed: int = 0,
    silent: bool = False,
) -> Explanation:
    """Compute the SHAP values of a policy's output.

    Args:
        bundle: policy.
        observations: in the order of the ride, shape (n, size), at least 2.
        permutations: orders to try for each observation.
        background: how many of the observations, at most, stand for features that are not put in yet.
        seed: of the orders.
        silent: show no progress.
    """
    begun = time.monotonic()
    inputs = np.asarray(observations, dtype=np.float64)
    behind = spread(inputs, background)
    found = permute(
        lambda batch: set_values(bundle, batch),
        _Background(behind),
        inputs,
        parts=inputs.shape[1],
        permutations=permutations,
        seed=seed,
        silent=silent,
    )
    return Explanation(
        layout=path_layout(bundle),
        features=inputs / path_layout(bundle).gains,
        values=np.asarray(found.values, dtype=np.float64),
        base=float(np.mean(found.base_values)),
        outputs=set_values(bundle, observations),
        background=len(behind),
        permutations=permutations,
        seconds=time.monotonic() - begun,
    )


def spread(rows: FloatArray, most: int) -> FloatArray:
    """Return so many rows at most, evenly spread."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(np.intp))]


def permute(
    model: Callable[[FloatArray], FloatArray],
    masker: Any,
    rows: FloatArray,
    *,
    parts: int,
    permutations: int,
    seed: int,
    silent: bool,
) -> Any:
    """Return what shap's permutation explainer finds.

    Args:
        model: to be explained.
        masker: takes out what is not put in.
        rows: inputs to explain it on.
        parts: of an input, that are put in one after the other.
        permutations: orders to try for each row.
        seed: of the orders.
        silent: show no progress.
    """
    explainer = shap.explainers.Permutation(model, masker, seed=seed)
    # Many small products: threads of the linear algebra cost more than they give, six times as much on a busy machine.
    with threadpool_limits(1):
        return explainer(rows, max_evals=permutations * (2 * parts + 1), silent=silent)


class _Background:
    """Masker of shap: features that are not put in take the values of each background observation.

    The same as ``shap.maskers.Independent``, whose compilation alone takes 15 s in every process.
    """

    immutable_outputs = True  # spares shap a copy of each output

    def __init__(self, rows: FloatArray) -> None:
        self._rows = rows

    def __call__(self, mask: NDArray[np.bool_], observation: FloatArray) -> tuple[FloatArray]:
        return (np.where(mask, observation, self._rows),)
