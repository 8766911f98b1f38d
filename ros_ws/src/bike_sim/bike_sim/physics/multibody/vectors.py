"""Vectors of three numbers and rotations: as tuples in compiled code, where they live in registers, and as arrays."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Vec = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""A rotation: x, y, z, w."""


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


@njit(cache=True)
def turn_about(axis: Vec, angle: float) -> Quaternion:
    """Return the rotation by an angle (rad) about a unit vector."""
    sin = math.sin(0.5 * angle)
    return sin * axis[0], sin * axis[1], sin * axis[2], math.cos(0.5 * angle)


@njit(cache=True)
def after(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the quaternion product: the rotation `second`, then `first`."""
    x1, y1, z1, w1 = first
    x2, y2, z2, w2 = second
    return (
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )


@njit(cache=True)
def turned(q: Quaternion, v: Vec) -> Vec:
    """Return a vector turned by a unit quaternion."""
    x, y, z, w = q
    a, b, c = v
    ta, tb, tc = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * ta + (y * tc - z * tb), b + w * tb + (z * ta - x * tc), c + w * tc + (x * tb - y * ta)


# As arrays, for Python; the functions above in Python cost less for a few numbers than NumPy's.


def multiply(first: Vector, second: Vector) -> Vector:
    """Return the quaternion product: the rotation `second`, then `first`."""
    return np.array(after.py_func(map(float, first), map(float, second)))


def axis_angle(axis: Vector, angle: float) -> Vector:
    """Return the quaternion of a rotation by `angle` (rad) about a unit vector."""
    x, y, z = map(float, axis)
    sin = float(np.sin(0.5 * angle))
    return np.array([sin * x, sin * y, sin * z, math.cos(0.5 * angle)])


def rotate(quaternion: Vector, vector: Vector) -> Vector:
    """Return the vector turned by a unit quaternion."""
    return np.array(turned.py_func(map(float, quaternion), map(float, vector)))


def conjugate(quaternion: Vector) -> Vector:
    """Return the inverse of a unit quaternion."""
    return quaternion * np.array([-1.0, -1.0, -1.0, 1.0])
