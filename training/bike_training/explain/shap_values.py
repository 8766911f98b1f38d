"""Which parts of an observation make a policy steer as it does: SHAP values of its actor.

A SHAP value says how much one feature of one observation moves the output away from the base value, which is the mean
output over a background. The values of an observation sum to its output minus the base value (Lundberg and Lee 2017).

Source: Weyrer et al. (2026), Sect. 5.5: the permutation explainer of the package ``shap`` on the observations of a
ride through a slalom.

An observation of a race has more than a hundred numbers, and neighbours in a term say much the same: lean now and
before, stations ahead. So a term is put in as a whole, and the values are those of terms (Owen values of one level).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import shap  # type: ignore[import-untyped]
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import ObservationLayout

FloatArray = NDArray[np.float64]

PERMUTATIONS: Final = 10
"""Orders, each also backwards, in which the features of an observation are put in."""
BACKGROUND: Final = 100
"""Observations, evenly spread over the section, that stand for features not put in yet."""


OBSERVATIONS: Final = 200
"""Observations of a race, evenly spread over the ride, that are explained at most."""


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """SHAP values of p parts of an observation in the output of a policy: of numbers on a path, of terms in a race.

    Attributes:
        layout: of the observation.
        parts: names of the parts.
        actions: meanings of the action's numbers.
        steady: parts that stay the same through the ride. They have no value, for nothing else is put in for them.
        observations: that were explained, shape (n, size).
        values: share of each part in the output, in the output's unit: rad on a path, shape (n, p), and in a race the
            unit of each of the m numbers of the action, shape (n, p, m).
        base: mean output over the background, a number or shape (m,).
        outputs: of the policy, shape (n,) or (n, m).
        background: observations in the background.
        permutations: orders tried for each observation.
        seconds: wall-clock time it took, s.
    """

    layout: ObservationLayout
    parts: tuple[str, ...]
    actions: tuple[str, ...]
    steady: tuple[str, ...]
    observations: FloatArray
    values: FloatArray
    base: Any
    outputs: FloatArray
    background: int
    permutations: int
    seconds: float

    @property
    def features(self) -> FloatArray:
        """Values of the observation's numbers in their own units (rad, rad/s, m, m/s, tangent), shape (n, size)."""
        return self.observations / self.layout.gains

    @property
    def mean_abs(self) -> FloatArray:
        """Mean magnitude of each part's values, in the output's unit, shape (p,) or (p, m)."""
        return np.abs(self.values).mean(axis=0)

    @property
    def shares(self) -> FloatArray:
        """Part of each part in the sum of the mean magnitudes, shape (p,) or (p, m)."""
        return self.mean_abs / np.maximum(self.mean_abs.sum(axis=0), np.finfo(float).tiny)

    @property
    def additivity_error(self) -> float:
        """Largest difference of base and values to the outputs; not zero by rounding only."""
        return float(np.abs(self.base + self.values.sum(axis=1) - self.outputs).max())


def outputs_of(bundle: Bundle, observations: NDArray[np.floating]) -> FloatArray:
    """Return what a policy asks for, in the units of its action's columns.

    Args:
        bundle: policy.
        observations: shape (n, size).

    Returns:
        On a path the set point of the steering angle, rad, shape (n,); in a race shape (n, m).
    """
    actions = bundle.actor.act_batch(np.asarray(observations, dtype=np.float32))
    outputs = np.asarray(actions, dtype=np.float64) * [column.scale for column in bundle.action.columns]
    return outputs if bundle.layout.races else outputs[:, 0]


def correlation(a: FloatArray, b: FloatArray) -> float:
    """Return Pearson's correlation of two columns, NaN where one of them is constant up to rounding."""
    if any(np.std(column) <= 1e-6 * np.abs(column).max() for column in (a, b)):
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])


def explain(
    bundle: Bundle,
    observations: NDArray[np.float32],
    *,
    permutations: int = PERMUTATIONS,
    background: int = BACKGROUND,
    most: int | None = None,
    seed: int = 0,
    silent: bool = False,
) -> Explanation:
    """Compute the SHAP values of a policy's output.

    Args:
        bundle: policy.
        observations: in the order of the ride, shape (n, size), at least 2.
        permutations: orders to try for each observation.
        background: how many of the observations, at most, stand for parts that are not put in yet.
        most: how many of them, at most, are explained; None for all, in races for OBSERVATIONS.
        seed: of the orders.
        silent: show no progress.
    """
    begun, layout = time.monotonic(), bundle.layout
    inputs = np.asarray(observations, dtype=np.float64)
    most = most or (OBSERVATIONS if layout.races else len(inputs))
    explained, behind = _spread(inputs, most), _spread(inputs, background)
    numbers = np.arange(layout.size)
    places = [numbers[place] for place in layout.places.values()] if layout.races else list(numbers[:, None])
    parts = layout.terms if layout.races else layout.names
    explainer = shap.explainers.Permutation(lambda rows: outputs_of(bundle, rows), _Parts(behind, places), seed=seed)
    # Many small products: threads of the linear algebra cost more than they give, six times as much on a busy machine.
    with threadpool_limits(1):
        found = explainer(explained, max_evals=permutations * (2 * len(parts) + 1), silent=silent)
    bases = np.asarray(found.base_values, dtype=np.float64)
    return Explanation(
        layout=layout,
        parts=parts,
        actions=bundle.action.names,
        steady=tuple(name for name, own in zip(parts, places, strict=True) if not np.ptp(inputs[:, own], axis=0).any()),
        observations=explained,
        values=np.asarray(found.values, dtype=np.float64),
        base=bases[0] if layout.races else float(bases.mean()),
        outputs=outputs_of(bundle, explained),
        background=len(behind),
        permutations=permutations,
        seconds=time.monotonic() - begun,
    )


def _spread(rows: FloatArray, most: int) -> FloatArray:
    """Return so many rows at most, evenly spread."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(np.intp))]


class _Parts:
    """Masker of shap: the numbers of parts that are not put in take the values of each background observation.

    Where each part is one number it is ``shap.maskers.Independent``, whose compilation takes 15 s in every process.
    """

    immutable_outputs = True  # spares shap a copy of each output

    def __init__(self, rows: FloatArray, places: Sequence[NDArray[np.intp]]) -> None:
        self._rows = rows
        self._part_of = np.concatenate([np.full(len(own), part) for part, own in enumerate(places)])
        self._count = len(places)

    def shape(self, observation: FloatArray) -> tuple[int, int]:
        """Return how many rows an answer has, and how many parts there are."""
        return len(self._rows), self._count

    def mask_shapes(self, observation: FloatArray) -> list[tuple[int]]:
        """Return the shape of the values."""
        return [(self._count,)]

    def __call__(self, mask: NDArray[np.bool_], observation: FloatArray) -> tuple[FloatArray]:
        return (np.where(mask[self._part_of], observation, self._rows),)
