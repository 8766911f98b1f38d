"""From the tables of a circuit to the ground under the wheels: compiled, the same for one simulator and for batches."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course.track import Track
from bike_sim.physics.ground import NO_BUMPS

FloatArray = NDArray[np.float64]
Record = Any

OFF_TRACK_GRIP: Final = 0.6
"""Factor on friction outside the limits: between dusty asphalt and grass (estimate)."""

LEFT, RIGHT, LEFT_WALL, RIGHT_WALL = range(4)
"""Columns of a road's table: distance to the left and the right limit, m; offset of the left and the right wall, m,
the latter negative."""
COLUMNS: Final = 4

FACTS: Final = np.dtype([("spacing", np.float64), ("length", np.float64)])
"""Distance of the samples of the centre line, and its length, m."""


class Road(NamedTuple):
    """A circuit as compiled code reads it.

    Attributes:
        table: a row a sample of the centre line, shape (samples, COLUMNS).
        facts: a record of `FACTS`, shape (1,).
        bumps: profiles of bumps, see `bike_sim.physics.ground.Ground`.
    """

    table: FloatArray
    facts: NDArray[np.void]
    bumps: FloatArray


def road_of(track: Track) -> Road:
    """Return a circuit's road."""
    left_wall, right_wall = track.walls()
    table = np.stack([track.width_left, track.width_right, left_wall, right_wall], axis=1)
    facts = np.zeros(1, dtype=FACTS)
    facts["spacing"], facts["length"] = track.centre.spacing, track.length
    return Road(np.ascontiguousarray(table), facts, NO_BUMPS)


@njit(cache=True)
def _beyond(progress: float, offset: float, road: Road) -> tuple[float, bool]:
    """Return the distance beyond the limits of a place on a circuit, m, negative within, and whether a wall is there.

    Args:
        progress: along the centre line, m, of any lap.
        offset: from it, m to the left.
        road: the circuit.
    """
    table, spacing = road.table, road.facts[0].spacing
    u = (progress % road.facts[0].length) / spacing
    i = min(int(u), len(table) - 2)
    here, there, part = table[i], table[i + 1], u - i
    left = here[LEFT] + part * (there[LEFT] - here[LEFT])
    right = here[RIGHT] + part * (there[RIGHT] - here[RIGHT])
    left_wall = here[LEFT_WALL] + part * (there[LEFT_WALL] - here[LEFT_WALL])
    right_wall = here[RIGHT_WALL] + part * (there[RIGHT_WALL] - here[RIGHT_WALL])
    return max(offset - left, -offset - right), not right_wall < offset < left_wall


@njit(cache=True)
def lay_ground(
    rear_x: float, rear_y: float, front_x: float, front_y: float, place: FloatArray, time: float, road: Road,
    grounds: Record,
) -> tuple[float, float, int]:  # fmt: skip
    """Write the ground under both wheels for the next control period, and tell where they are.

    Args:
        rear_x: of the rear contact point in the map, m.
        rear_y: the same, m.
        front_x: of the front contact point, m.
        front_y: the same, m.
        place: progress and offset of both contact points relative to the centre line, m, in the order of `sim.look`.
        time: s since the reset.
        road: the circuit, from `road_of`.
        grounds: of `bike_sim.physics.ground.GROUND`, shape (1,), written.

    Returns:
        Rear and front distance beyond the limits, m, negative within; index of the progress in `place` of the first
        contact point that has reached a wall, or -1.
    """
    ground = grounds[0]
    rear, rear_wall = _beyond(place[0], place[1], road)
    front, front_wall = _beyond(place[2], place[3], road)
    ground.rear.grip = OFF_TRACK_GRIP if rear > 0.0 else 1.0
    ground.front.grip = OFF_TRACK_GRIP if front > 0.0 else 1.0
    wall = 0 if rear_wall else (2 if front_wall else -1)
    return rear, front, wall
