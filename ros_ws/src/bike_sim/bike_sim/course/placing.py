"""Where a ride was on a circuit, from recorded contact points: what lap timing is computed again from."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.lap_timing import Sample
from bike_sim.course.projection import project, window
from bike_sim.course.track import Track

FloatArray = NDArray[np.float64]

REACH = 4.0
"""The nearest point is searched this far forward and backward, m: over two control steps at top speed, less than to a
parallel road. Where a point moves farther in a step, the search follows it (`projection.window`)."""

EXACT = 0.05
"""Tolerance of a requested start, m: the projection from the centre line to the followed line and back
goes through tables."""


def samples_of(
    track: Track, time: FloatArray, rear: FloatArray, front: FloatArray, begin: float, front_begin: float
) -> Iterator[Sample]:
    """Yield where a ride was, one sample for each instant.

    Args:
        track: the circuit.
        time: s.
        rear: rear contact points in the map, m, shape (n, 2).
        front: front contact points, shape (n, 2).
        begin: progress of the first rear contact point, m, as the ride was begun with.
        front_begin: progress near the first front contact point, m.
    """
    centre = track.centre
    near, front_near = float(begin), float(front_begin)  # what times laps is compiled for floats
    for k in range(len(time)):
        reach = window(REACH, math.dist(rear[k], rear[max(k - 1, 0)]), centre.length)
        found = [
            project(centre.x, centre.y, centre.heading, centre.spacing, True, float(x), float(y), s, reach, reach)
            for (x, y), s in ((rear[k], near), (front[k], front_near))
        ]
        (near, offset, _), (front_near, front_offset, _) = found
        if k == 0 and abs(near - begin) < EXACT:
            near = begin
        yield Sample(float(time[k]), near, offset, front_near, front_offset)
