"""Which blocks of its observation make a racing policy decide as it does: SHAP values of groups of numbers.

An observation of a race has more than a hundred numbers, and neighbours in a block say much the same: lean now and
before, stations ahead. So a block is put in as a whole, and the values are those of the blocks (Owen values of one
level; Lundberg and Lee 2017 for the explainer).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_training.explain.shap_values import BACKGROUND, PERMUTATIONS, ShapValues, permute, spread

FloatArray = NDArray[np.float64]

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
