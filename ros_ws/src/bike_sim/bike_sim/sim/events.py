"""Events of a ride: resets, falls, laps and sectors, from the rows that observations write."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.course import Course
from bike_sim.course.lap_timing import LapLog, TimingEvent, TimingKind
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

ENDS: Final = (*FALL_NAMES, WALL, DIVERGED)
"""How rides end, by code; 0 while they go on."""

CAUSE, SPEED, ANGLE, ENERGY = acc.NUMBER, acc.BEGAN, acc.OFF_TRACK, acc.DISTANCE
"""Columns of rows of falls and walls: code of the end or 0, speed (m/s), and of a wall the angle to it (rad) and the
energy (J)."""


class EventKind(IntEnum):
    """Kinds of events; the numbers are those of ``bike_msgs/RideEvent``."""

    RESET = 0
    FALL = 1
    OFF_COURSE = 2
    WALL = 3
    LAP = 4
    FINISH = 5
    SECTOR = 6
    BACK_ON_COURSE = 7
    SCRAPE = 8


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


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened.

    Attributes:
        kind: what.
        time: s since the reset, interpolated within the step where a line was crossed.
        progress: arc length, m: along the course, on a circuit along its centre line.
        value: time of the lap or sector (s), roll of a fall (rad), lateral error off the course or distance beyond the
            limits (m), speed at a wall hit or scraped (m/s), time off the track on return (s), else 0.
        text: one sentence for people.
    """

    kind: EventKind
    time: float
    progress: float
    value: float
    text: str


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
        event = wall_event if kind is EventKind.WALL else scrape_event
        return event(time, progress, WallHit(row[SPEED], row[ANGLE], row[ENERGY]))
    if kind is EventKind.FALL:
        cause = int(row[CAUSE])
        return fall_event(time, progress, value, ENDS[cause] if cause else "", row[SPEED])
    if sections is None:
        return Event(kind, time, progress, value, log.take(row).text)
    return Event(kind, time, progress, value, _text_on_path(kind, time, value, int(row[acc.NUMBER]), sections))


def _text_on_path(kind: EventKind, time: float, value: float, number: int, sections: Sequence[str]) -> str:
    if kind is EventKind.SECTOR:
        return f"sector {sections[number - 1]!r} begins"
    if kind is EventKind.LAP:
        return f"lap {number} in {value:.3f} s"
    if kind is EventKind.FINISH:
        return f"end of the course reached after {time:.3f} s"
    return f"off the course by {value:+.2f} m"


def timing_event(event: TimingEvent, outside: float) -> Event:
    """Return an event of the lap timing as an event of the ride.

    Args:
        event: of the lap timing.
        outside: distance beyond the limits at the end of the step, m.
    """
    value = outside if event.kind is TimingKind.LEFT_TRACK else event.value
    return Event(EventKind(event.kind), event.time, event.progress, value, event.text)


def reset_event(episode: int, course: Course, track: Track | None, progress: float) -> Event:
    """Return the event that opens an episode at an arc length (m) of a course, or of a circuit where there is one."""
    where = f"course {course.name!r}" if track is None else f"circuit {track.name!r}"
    text = f"episode {episode} begins on {where}"
    return Event(EventKind.RESET, 0.0, progress, 0.0, text)


def fall_event(time: float, progress: float, roll: float, fall: str = "", speed: float = 0.0) -> Event:
    """Return the event of a fall.

    Args:
        time: s.
        progress: m.
        roll: rad.
        fall: kind of the fall, where there are several.
        speed: m/s, mentioned if the fall has a name.
    """
    how = f" ({fall.replace('_', ' ')}) at {speed:.1f} m/s" if fall else ""
    return Event(EventKind.FALL, time, progress, roll, f"fell{how} with a roll of {math.degrees(roll):.0f} deg")


def wall_event(time: float, progress: float, hit: WallHit) -> Event:
    """Return the event of a collision with a wall at a time (s) and an arc length (m)."""
    energy = f"{hit.energy / 1e3:.0f} kJ, {hit.across / 1e3:.1f} kJ of it across"
    text = f"met a wall at {hit.speed:.1f} m/s, {math.degrees(hit.angle):.0f} deg, {energy}"
    return Event(EventKind.WALL, time, progress, hit.speed, text)


def scrape_event(time: float, progress: float, touch: WallHit) -> Event:
    """Return the event of a touch of a wall, at a time (s) and an arc length (m), after which the ride goes on."""
    how = f"{touch.speed:.1f} m/s, {math.degrees(touch.angle):.1f} deg, {touch.across / 1e3:.2f} kJ across it"
    text = f"scraped a wall at {how}"
    return Event(EventKind.SCRAPE, time, progress, touch.speed, text)
