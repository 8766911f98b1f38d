"""Which parts of an observation make a policy steer as it does: SHAP values of its actor.

A SHAP value says how much one feature of one observation moves the output away from the base value, which is the mean
output over a background. The values of an observation sum to its output minus the base value (Lundberg and Lee 2017).

Source: Weyrer et al. (2026), Sect. 5.5: the permutation explainer of the package ``shap`` on the observations of a
ride through a slalom.

Which blocks of its observation make a racing policy decide as it does: SHAP values of groups of numbers.

An observation of a race has more than a hundred numbers, and neighbours in a block say much the same: lean now and
before, stations ahead. So a block is put in as a whole, and the values are those of the blocks (Owen values of one
level; Lundberg and Lee 2017 for the explainer).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
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


OBSERVATIONS: Final = 200
"""Observations, evenly spread over the ride, that are explained at most."""


@dataclass(frozen=True, kw_only=True)
class BlockExplanation(ShapValues):
    """SHAP values of g blocks in the m numbers of an action, each in its own unit.

    Attributes:
        blocks: names, in the order of the observation.
        actions: meanings of the action's numbers.
        steady: blocks that stay the same through the ride. They have no value, for nothing else is put in for them.
    """

    blocks: tuple[str, ...]
    actions: tuple[str, ...]
    steady: tuple[str, ...]
    base: FloatArray

    @property
    def shares(self) -> FloatArray:
        """Part of each block in the sum of the mean magnitudes, shape (g, m)."""
        return self.mean_abs / np.maximum(self.mean_abs.sum(axis=0), np.finfo(float).tiny)


def explain_blocks(
    bundle: Bundle,
    observations: NDArray[np.float32],
    *,
    permutations: int = PERMUTATIONS,
    background: int = BACKGROUND,
    most: int = OBSERVATIONS,
    seed: int = 0,
    silent: bool = False,
) -> BlockExplanation:
    """Compute the SHAP values of a racing policy's blocks.

    Args:
        bundle: policy that races.
        observations: in the order of the ride, shape (n, size), at least 2.
        permutations: orders to try for each observation.
        background: how many of the observations, at most, stand for blocks that are not put in yet.
        most: how many of them, at most, are explained.
        seed: of the orders.
        silent: show no progress.
    """
    begun = time.monotonic()
    layout = bundle.layout
    inputs = np.asarray(observations, dtype=np.float64)
    explained, behind = spread(inputs, most), spread(inputs, background)
    places = [np.arange(layout.size)[place] for place in layout.places.values()]
    found = permute(
        lambda batch: _actions(bundle, batch),
        _Blocks(behind, places),
        explained,
        parts=len(layout.terms),
        permutations=permutations,
        seed=seed,
        silent=silent,
    )
    return BlockExplanation(
        blocks=layout.terms,
        actions=bundle.action.names,
        steady=tuple(
            name for name, own in zip(layout.terms, places, strict=True) if not np.ptp(inputs[:, own], axis=0).any()
        ),
        values=np.asarray(found.values, dtype=np.float64),
        base=np.asarray(found.base_values, dtype=np.float64)[0],
        outputs=_actions(bundle, explained),
        background=len(behind),
        permutations=permutations,
        seconds=time.monotonic() - begun,
    )


def _actions(bundle: Bundle, observations: FloatArray) -> FloatArray:
    """Return what a policy asks for, in the units of its action's columns, shape (n, m)."""
    actions = bundle.actor.act_batch(np.asarray(observations, dtype=np.float32))
    return np.asarray(actions, dtype=np.float64) * [column.scale for column in bundle.action.columns]


class _Blocks:
    """Masker of shap: the numbers of blocks that are not put in take the values of each background observation."""

    immutable_outputs = True  # spares shap a copy of each output

    def __init__(self, rows: FloatArray, places: Sequence[NDArray[np.intp]]) -> None:
        self._rows = rows
        self._block_of = np.concatenate([np.full(len(own), block) for block, own in enumerate(places)])
        self._count = len(places)

    def shape(self, observation: FloatArray) -> tuple[int, int]:
        """Return how many rows an answer has, and how many blocks there are."""
        return len(self._rows), self._count

    def mask_shapes(self, observation: FloatArray) -> list[tuple[int]]:
        """Return the shape of the values."""
        return [(self._count,)]

    def __call__(self, mask: NDArray[np.bool_], observation: FloatArray) -> tuple[FloatArray]:
        return (np.where(mask[self._block_of], observation, self._rows),)
