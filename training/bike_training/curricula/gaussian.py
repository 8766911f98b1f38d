"""Gaussian distributions of contexts: density, divergence, and their way through flat parameters."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Gaussian(NamedTuple):
    """A normal distribution.

    Attributes:
        mean: shape (d,).
        factor: lower triangular L of the covariance L L^T, shape (d, d).
    """

    mean: FloatArray
    factor: FloatArray

    @classmethod
    def with_std(cls, mean: Any, std: Any) -> Gaussian:
        """Return one with independent numbers."""
        return cls(np.array(mean, dtype=np.float64), np.diag(np.array(std, dtype=np.float64)))

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each number."""
        return np.asarray(np.sqrt(np.sum(self.factor**2, axis=1)))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Return the logarithm of the density at points, shape (n, d)."""
        scaled = np.linalg.solve(self.factor, (points - self.mean).T)
        log_volume = float(np.sum(np.log(np.diag(self.factor))))
        return -0.5 * np.sum(scaled**2, axis=0) - log_volume - 0.5 * len(self.mean) * math.log(2.0 * math.pi)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw a point, shape (d,)."""
        return np.asarray(self.mean + self.factor @ rng.standard_normal(len(self.mean)))

    def to_flat(self) -> FloatArray:
        """Return mean, logarithms of the diagonal of L, and what lies below it (Klink et al. 2021)."""
        below = self.factor[np.tril_indices(len(self.mean), -1)]
        return np.concatenate((self.mean, np.log(np.diag(self.factor)), below))

    @classmethod
    def from_flat(cls, flat: FloatArray) -> Gaussian:
        """Return the distribution of :meth:`to_flat`."""
        size = next(d for d in range(1, 100) if d + d * (d + 1) // 2 >= len(flat))
        factor = np.diag(np.exp(flat[size : 2 * size]))
        factor[np.tril_indices(size, -1)] = flat[2 * size :]
        return cls(flat[:size].copy(), factor)


def divergence(p: Gaussian, q: Gaussian) -> float:
    """Return the Kullback-Leibler divergence KL(p || q), nat, in closed form."""
    ratio = np.linalg.solve(q.factor, p.factor)
    apart = np.linalg.solve(q.factor, q.mean - p.mean)
    log_ratio = np.sum(np.log(np.diag(q.factor))) - np.sum(np.log(np.diag(p.factor)))
    return float(log_ratio + 0.5 * (np.sum(ratio**2) + np.sum(apart**2) - len(p.mean)))
