"""Events of a ride: resets, falls, laps and sectors, from the rows that observations write."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.course import Course
from bike_sim.course.lap_timing import Event as Event
from bike_sim.course.lap_timing import EventKind as EventKind
from bike_sim.course.lap_timing import LapLog
from bike_sim.course.track import Track
from bike_sim.physics.superbike.forces import FALL_NAMES

NO_FALL: Final = "none"
"""Value of `Snapshot.fall` while the ride continues."""
TIPPED: Final = "tip_over"
"""A bicycle on its side; superbikes have more kinds of falls (`superbike_forces.FALL_NAMES`)."""
WALL: Final = "wall"
"""A contact point met a wall."""
DIVERGED: Final = "diverged"
"""The integration gave values that are not finite."""

CONTACT: Final = "contact"
"""Another vehicle threw it down."""

ENDS: Final = (*FALL_NAMES, WALL, DIVERGED, CONTACT)
"""Ends of rides, by code; 0 while they go on."""

CAUSE, SPEED, ANGLE, ENERGY = acc.NUMBER, acc.BEGAN, acc.OFF_TRACK, acc.DISTANCE
"""Columns of rows of falls and walls: code of the end or 0, speed (m/s), and of a wall the angle to it (rad) and the
energy (J)."""


@dataclass(frozen=True, slots=True)
class WallHit:
    """A touch of a wall: a scrape, or the hit that ends a ride.

    Attributes:
        speed: m/s.
        angle: between velocity and wall, rad, 0 along it.
        energy: total kinetic energy, J.
    """

    speed: float
    angle: float
    energy: float

    @property
    def across(self) -> float:
        """Part of the kinetic energy that goes across the wall, J."""
        return self.energy * math.sin(self.angle) ** 2


def events_of(rows: NDArray[np.float64], log: LapLog, sections: Sequence[str] | None) -> tuple[Event, ...]:
    """Return rows of an observation as events, and keep the laps that they finish.

    Args:
        rows: as `bike_sim.sim.observation` wrote them.
        log: finished laps of the ride.
        sections: names of a path's sections behind its beginning; None on a circuit.
    """
    return tuple(_event(row, log, sections) for row in rows.tolist())


def _event(row: list[float], log: LapLog, sections: Sequence[str] | None) -> Event:
    kind, time, progress, value = EventKind(int(row[acc.KIND])), *row[acc.TIME : acc.NUMBER]
    if kind in (EventKind.WALL, EventKind.SCRAPE):
        hit = WallHit(row[SPEED], row[ANGLE], row[ENERGY])
        if kind is EventKind.WALL:
            energy = f"{hit.energy / 1e3:.0f} kJ, {hit.across / 1e3:.1f} kJ of it across"
            text = f"met a wall at {hit.speed:.1f} m/s, {math.degrees(hit.angle):.0f} deg, {energy}"
        else:
            energy = f"{hit.across / 1e3:.2f} kJ across it"
            text = f"scraped a wall at {hit.speed:.1f} m/s, {math.degrees(hit.angle):.1f} deg, {energy}"
        return Event(kind, time, progress, hit.speed, text)
    if kind is EventKind.FALL:
        cause = int(row[CAUSE])
        how = f" ({ENDS[cause].replace('_', ' ')}) at {row[SPEED]:.1f} m/s" if cause and ENDS[cause] else ""
        return Event(kind, time, progress, value, f"fell{how} with a roll of {math.degrees(value):.0f} deg")
    if sections is None:
        return log.take(row)
    number = int(row[acc.NUMBER])
    if kind is EventKind.SECTOR:
        text = f"sector {sections[number - 1]!r} begins"
    elif kind is EventKind.LAP:
        text = f"lap {number} in {value:.3f} s"
    elif kind is EventKind.FINISH:
        text = f"end of the course reached after {time:.3f} s"
    else:
        text = f"off the course by {value:+.2f} m"
    return Event(kind, time, progress, value, text)


def reset_event(episode: int, course: Course, track: Track | None, progress: float) -> Event:
    """Return the event that opens an episode at an arc length (m) of a course, or of a circuit where there is one."""
    where = f"course {course.name!r}" if track is None else f"circuit {track.name!r}"
    return Event(EventKind.RESET, 0.0, progress, 0.0, f"episode {episode} begins on {where}")
