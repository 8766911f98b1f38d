"""Self-paced distribution of contexts: as near to the target as the performance allows.

Source: Klink, Abdulsamad, Belousov, D'Eramo, Peters, Pajarinen (2021), A probabilistic interpretation of self-paced
learning with applications to reinforcement learning, JMLR 22(182), Sect. 6 (the version with one threshold, "v2" of
their code). Written from the description; values of contexts are the measured returns of their episodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bike_training.curricula.gaussian import Gaussian, divergence

FloatArray = NDArray[np.float64]

TOLERANCE: Final = 1e-3
"""By which a solution may violate a constraint, as a part of its bound: solvers report success with more."""
ITERATIONS: Final = 60
FARTHEST: Final = 5.0
"""Largest change of a parameter in an update."""


class Stage(Enum):
    """What an update did."""

    HARDER = "towards the target"
    EASIER = "towards contexts of higher value"
    WAITS = "waits for the agent"


class Update(NamedTuple):
    """Outcome of an update.

    Attributes:
        distribution: from now on. stage: what was done.
        value: expected value under it, estimated from the contexts. before: the same under the one before.
    """

    distribution: Gaussian
    stage: Stage
    value: float
    before: float


@dataclass(frozen=True)
class SelfPaced:
    """Settings of the updates.

    Attributes:
        target: distribution that all ends with.
        threshold: expected value that must be kept (delta).
        step: largest KL(old || new) of an update, nat (epsilon).
        least_std: least standard deviation of each number while the target is far, or None.
        far: KL(old || target) up to which it is not far, nat.
    """

    target: Gaussian
    threshold: float
    step: float = 0.05
    least_std: FloatArray | None = None
    far: float = 50.0

    def update(
        self, old: Gaussian, contexts: FloatArray, sampled: FloatArray, values: FloatArray, reached: bool
    ) -> Update:
        """Return the next distribution.

        Args:
            old: the present one.
            contexts: of episodes, shape (n, d).
            sampled: logarithm of the density that each was drawn with, shape (n,).
            values: of the episodes, shape (n,).
            reached: whether the threshold was ever met.
        """

        def value(distribution: Gaussian) -> float:
            ratio = distribution.log_density(contexts) - sampled
            weights = np.exp(ratio - np.max(ratio))  # normalised below, so that values may be shifted
            return float(np.sum(weights * values) / np.sum(weights))

        begin = self._widened(old)
        before = value(begin)
        if before >= self.threshold:
            found = self._solve(begin, old, lambda new: divergence(new, self.target), value)
            return Update(found, Stage.HARDER, value(found), before)
        if not reached:
            found = self._solve(begin, old, lambda new: -value(new), None)
            return Update(found, Stage.EASIER, value(found), before)
        return Update(old, Stage.WAITS, before, before)

    def _bounds(self, old: Gaussian) -> list[tuple[float, float]]:
        size = len(old.mean)
        flat = old.to_flat()
        # Far beyond any step that the divergence allows; keeps the solver's trials finite.
        bounds: list[tuple[float, float]] = [(value - FARTHEST, value + FARTHEST) for value in flat]
        if self.least_std is not None and divergence(old, self.target) > self.far:
            for k in range(size):
                low = math.log(self.least_std[k])
                bounds[size + k] = (low, max(low, flat[size + k]) + FARTHEST)
        return bounds

    def _widened(self, old: Gaussian) -> Gaussian:
        flat = old.to_flat()
        least = [low for low, _ in self._bounds(old)]
        return Gaussian.from_flat(np.maximum(flat, least))

    def _solve(
        self,
        begin: Gaussian,
        old: Gaussian,
        objective: Callable[[Gaussian], float],
        value: Callable[[Gaussian], float] | None,
    ) -> Gaussian:
        """Minimise an objective within the constraints; where nothing better keeps them, return the beginning."""

        def room(flat: FloatArray) -> FloatArray:
            new = Gaussian.from_flat(flat)
            left = [(self.step - divergence(old, new)) / self.step]
            if value is not None:
                left.append((value(new) - self.threshold) / max(abs(self.threshold), 1.0))
            return np.array(left)

        def cost(flat: FloatArray) -> float:
            return objective(Gaussian.from_flat(flat))

        first = begin.to_flat()
        found = minimize(
            cost,
            first,
            method="SLSQP",
            bounds=self._bounds(old),
            constraints={"type": "ineq", "fun": room},
            options={"maxiter": ITERATIONS, "ftol": 1e-6},
        ).x
        if not np.all(np.isfinite(found)):
            return begin
        # Where the solver ends outside, the way back to the beginning leads inside again.
        for _ in range(20):
            if np.all(room(found) >= -TOLERANCE) and cost(found) <= cost(first):
                return Gaussian.from_flat(found)
            found = 0.5 * (found + first)
        return begin
