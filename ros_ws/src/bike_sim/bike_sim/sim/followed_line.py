"""The followed line of a circuit: stations, relation to the centre line, theoretical lap, and what rows read of it."""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.track import Track
from bike_sim.planning.envelope import Envelope
from bike_sim.planning.lap_limit import LapLimit, lap_limit
from bike_sim.sim import look as lk
from bike_sim.sim.disturbances import NO_CHANGES, RoadChanges
from bike_sim.sim.ground import Road, road_of
from bike_sim.sim.observation import address_of, surroundings_of

FloatArray = NDArray[np.float64]

START_SPEED: Final = 35.0
"""Speed at which rides of a superbike begin by default, m/s."""
START_SHARE: Final = 0.8
"""The same as a fraction of the theoretical lap's speed there."""


class FollowedLine:
    """A line of a circuit and its relation to the centre line.

    Attributes:
        track: the circuit.
        lam: which of its lines, 0 the median, 1 the ideal line.
        line: the line.
        to_centre: progress along the centre line at the samples of the line, never decreasing, m.
        stations: what stations at its samples show, see `look.stations`.
    """

    def __init__(self, track: Track, lam: float) -> None:
        """Compute the line.

        Raises:
            ValueError: lambda outside 0 to 1.
        """
        self.track, self.lam, self.line = track, lam, track.line(lam)
        centre = track.centre.samples
        along = lk.centre_progress(centre, self.line.x, self.line.y)
        self.to_centre: FloatArray = np.maximum.accumulate(along)
        limits = track.width_left, track.width_right, track.elevation, track.bank
        self.stations: FloatArray = lk.stations(self.line.table, self.line.spacing, self.to_centre, centre, limits)
        self._limit: LapLimit | None = None
        self._changes, self._changed = NO_CHANGES, {NO_CHANGES: self}

    def changed(self, changes: RoadChanges) -> FollowedLine:
        """Return the same line on a road that differs from the known one; `track` stays the known circuit.

        Args:
            changes: of the road.
        """
        if changes not in self._changed:
            found = copy(self)
            for name in ("road", "surroundings"):
                found.__dict__.pop(name, None)
            found._changes = changes
            self._changed[changes] = found
        return self._changed[changes]

    @cached_property
    def road(self) -> Road:
        """The road that is ridden as compiled code reads it."""
        return road_of(self.track, self._changes.surface(self.track.surface))

    @cached_property
    def surroundings(self) -> NDArray[np.void]:
        """Its arrays as rows read them, without the form of the preview: `observation.SURROUNDINGS`, shape (1,)."""
        track, line, road = self.track, self.line, self.road
        arrays = {
            "line": line.table, "ahead": self.stations, "table": track.table, "marks": track.marks,
            "road": road.table, "bumps": road.bumps, "gusts": road.gusts,
        }  # fmt: skip
        values = {
            "kind": acc.CIRCUIT, "measured": track.ideal is not None, "line_samples": line.table.shape[1],
            "samples": track.table.shape[1], "mark_count": len(track.marks), "spacing": track.centre.spacing,
            "length": track.length, "line_spacing": line.spacing, "line_length": line.length,
        }  # fmt: skip
        return surroundings_of({**{name: address_of(array) for name, array in arrays.items()}, **values})

    def limit(self, envelope: Envelope) -> LapLimit:
        """Return the theoretical lap of the machine that the line was computed for."""
        if self._limit is None:
            self._limit = lap_limit(envelope, self.line)
        return self._limit

    def place(self, progress: float) -> float:
        """Return the arc length of the line, m, at a progress along the centre line, m.

        Raises:
            ValueError: the progress is beyond the length of the circuit.
        """
        track = self.track
        if progress >= track.length:
            raise ValueError(f"progress {progress!r} m lies beyond circuit {track.name!r} of {track.length:.1f} m")
        return float(np.interp(progress, self.to_centre, self.line.s))


def start_speed(followed: FollowedLine, limits: Envelope, progress: float = 0.0) -> float:
    """Return a start speed for a position on a circuit, m/s: START_SPEED, or less in a bend.

    Args:
        followed: the line that is ridden.
        limits: the machine's.
        progress: along the centre line, m.

    Raises:
        ValueError: a position beyond the circuit.
    """
    at = followed.place(progress)
    return min(START_SPEED, START_SHARE * float(followed.limit(limits).speed_at(at)))
