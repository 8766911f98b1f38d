"""The road's surface under one wheel: height and normal at a point, from a patch of `bike_sim.physics.ground`.

Around the patch's origin the surface is of second order along the road and a plane across it, with a periodic profile
of bumps on top that is the same over the whole width. On a level, smooth patch all numbers are exactly those of flat
ground.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.ground import BUMP_SAMPLES, BUMP_SPACING
from bike_sim.physics.vectors import Vec
from bike_sim.vehicles.superbike import Record


class Surface(NamedTuple):
    """The surface at one point.

    Attributes:
        height: m, in the map.
        normal: unit vector, upward.
        smooth: the same as if there were no bumps.
    """

    height: float
    normal: Vec
    smooth: Vec


@njit(cache=True)
def bump_at(arc: float, profile: NDArray) -> tuple[float, float]:
    """Return height (m) and slope of a profile of bumps at an arc length (m) of any lap.

    Cubic between samples (Catmull-Rom), so that the slope has no steps for a tyre to hammer on.
    """
    u = arc / BUMP_SPACING
    floor = math.floor(u)
    i, t = int(floor) % BUMP_SAMPLES, u - floor
    a, b = profile[i - 1], profile[i]
    c, d = profile[(i + 1) % BUMP_SAMPLES], profile[(i + 2) % BUMP_SAMPLES]
    first, second, third = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
    height = b + t * (first + t * (second + t * third))
    return height, (first + t * (2.0 * second + 3.0 * t * third)) / BUMP_SPACING


@njit(cache=True)
def surface_at(x: float, y: float, patch: Record, profile: NDArray) -> Surface:
    """Return the surface at a point of the map, bumps included.

    Args:
        x: m.
        y: m.
        patch: a record of `ground.PATCH`.
        profile: of bumps, shape (BUMP_SAMPLES,).
    """
    dx, dy = x - patch.x, y - patch.y
    along, left = patch.cos * dx + patch.sin * dy, patch.cos * dy - patch.sin * dx
    height = patch.height + (patch.grade + 0.5 * patch.crest * along) * along + patch.bank * left
    slope = patch.grade + patch.crest * along
    smooth = normal = _normal(slope, patch)
    if patch.bumps != 0.0:
        bump, tilt = bump_at(patch.arc + patch.stretch * along, profile)
        height += patch.bumps * bump
        normal = _normal(slope + patch.bumps * patch.stretch * tilt, patch)
    return Surface(height, normal, smooth)


@njit(cache=True)
def smooth_normal(x: float, y: float, patch: Record) -> Vec:
    """Return the normal at a point of the map (m) as if there were no bumps."""
    along = patch.cos * (x - patch.x) + patch.sin * (y - patch.y)
    return _normal(patch.grade + patch.crest * along, patch)


@njit(cache=True)
def _normal(slope: float, patch: Record) -> Vec:
    """Return the upward normal where the road rises by `slope` per m along and by the bank per m to the left."""
    east, north = slope * patch.cos - patch.bank * patch.sin, slope * patch.sin + patch.bank * patch.cos
    up = 1.0 / math.sqrt(1.0 + east * east + north * north)
    return -east * up, -north * up, up
