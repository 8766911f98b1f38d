"""What a lap did in each corner of a circuit, and where it lost time on a reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from bike_analysis.read.tables import Floats
from bike_sim.course.track import Corner

BRAKING: Final = 5.0
"""Brake from which on a rider counts as braking, %."""
PHASES: Final = ("braking", "entry", "exit", "straight after")
"""Parts of a corner's stretch: up to where it begins, up to its apex, up to its end, and from there on."""


@dataclass(frozen=True)
class LapTrace:
    """A lap over arc length along the centre line; columns of equal length.

    Attributes:
        distance_m: Since the start line, never falling.
        time_s: Since the start line.
        speed: In any unit; speeds of corners have the same.
        lean_deg: Either sign; empty for a theory.
        brake: 0 to 100 %; empty for a theory.
    """

    distance_m: Floats
    time_s: Floats
    speed: Floats
    lean_deg: Floats
    brake: Floats

    def at(self, values: Floats, place_m: float) -> float:
        """A column's value at a place."""
        return float(np.interp(place_m, self.distance_m, values))


@dataclass(frozen=True)
class CornerFigures:
    """One corner of a lap.

    Attributes:
        name: Of the corner.
        direction: ``left`` or ``right``.
        braking_m: Where braking for it began, m from the start line; None if it was not braked for.
        before_apex_m: The same as a distance before the apex.
        entry_speed: At the corner's beginning.
        least_speed: The lowest in it.
        exit_speed: At its end.
        lean_deg: The largest lean in it, without sign.
        lost_s: Time lost on the reference over the corner's stretch, which reaches to the middle of the straights
            before and after it, so that all corners together make up the lap; negative where time was won.
        lost_in: The one of `PHASES` in which most was lost; empty if nothing was.
    """

    name: str
    direction: str
    braking_m: float | None
    before_apex_m: float | None
    entry_speed: float
    least_speed: float
    exit_speed: float
    lean_deg: float
    lost_s: float
    lost_in: str


def corner_figures(
    corners: Sequence[Corner], length_m: float, lap: LapTrace, reference: LapTrace
) -> tuple[CornerFigures, ...]:
    """Compute the figures of each corner.

    Args:
        corners: In the order of the lap.
        length_m: Length of the circuit.
        lap: The lap.
        reference: What it is measured against, over the same arc length.

    Returns:
        One record per corner.
    """
    middles = [0.5 * (before.end + after.begin) for before, after in pairwise(corners)]
    bounds = [0.0, *middles, length_m]
    found = []
    for corner, (first, last) in zip(corners, pairwise(bounds), strict=True):
        end = min(corner.end, length_m)
        inside = (lap.distance_m >= corner.begin) & (lap.distance_m <= end)
        if not inside.any():
            inside[np.argmin(np.abs(lap.distance_m - corner.apex))] = True
        braking = _braking_point(lap, first, corner.apex)
        losses = [_lost(lap, reference, a, b) for a, b in pairwise((first, corner.begin, corner.apex, end, last))]
        found.append(
            CornerFigures(
                name=corner.name,
                direction=corner.direction,
                braking_m=braking,
                before_apex_m=None if braking is None else corner.apex - braking,
                entry_speed=lap.at(lap.speed, corner.begin),
                least_speed=float(np.min(lap.speed[inside])),
                exit_speed=lap.at(lap.speed, end),
                lean_deg=float(np.max(np.abs(lap.lean_deg[inside]))),
                lost_s=sum(losses),
                lost_in=PHASES[int(np.argmax(losses))] if max(losses) > 0.0 else "",
            )
        )
    return tuple(found)


def _lost(lap: LapTrace, reference: LapTrace, begin_m: float, end_m: float) -> float:
    """Time lost between two places, s; none where they are in the wrong order, as corners may overlap."""
    if end_m <= begin_m:
        return 0.0
    own = lap.at(lap.time_s, end_m) - lap.at(lap.time_s, begin_m)
    return own - (reference.at(reference.time_s, end_m) - reference.at(reference.time_s, begin_m))


def _braking_point(lap: LapTrace, first_m: float, apex_m: float) -> float | None:
    """Where the last stretch of braking before the apex began, m; None without any between the two places."""
    rows = np.flatnonzero((lap.distance_m >= first_m) & (lap.distance_m <= apex_m) & (lap.brake >= BRAKING))
    if not len(rows):
        return None
    row = int(rows[-1])
    while row > 0 and lap.brake[row - 1] >= BRAKING:
        row -= 1
    return float(lap.distance_m[row])
