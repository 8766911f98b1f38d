"""Vectors of three numbers in compiled code: tuples, which live in registers and need no memory."""

from __future__ import annotations

from numba import njit

Vec = tuple[float, float, float]


@njit(cache=True)
def scale(factor: float, a: Vec) -> Vec:
    """Return ``factor a``."""
    return factor * a[0], factor * a[1], factor * a[2]


@njit(cache=True)
def add(a: Vec, b: Vec) -> Vec:
    """Return ``a + b``."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True)
def mix(p: float, a: Vec, q: float, b: Vec) -> Vec:
    """Return ``p a + q b``."""
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@njit(cache=True)
def dot(a: Vec, b: Vec) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def cross(a: Vec, b: Vec) -> Vec:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
