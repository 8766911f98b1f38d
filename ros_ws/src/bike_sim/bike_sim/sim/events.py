"""Events of a ride: resets, falls, laps and sectors, detected from one control instant to the next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

from bike_sim.course.course import Course
from bike_sim.course.lap_timing import TimingEvent, TimingKind
from bike_sim.course.line_crossings import LineCrossings
from bike_sim.course.track import Track


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


_REMEMBERED: Final = ("_lap_began", "_sector_began", "_time", "_progress", "_off_course")


class PathEvents:
    """Finds sectors, laps, the finish and leaving the course on a path.

    A line across the course (the start of a section, the end of a lap) counts once, when it is first crossed forward.
    """

    def __init__(self, course: Course, time: float, progress: float) -> None:
        """Begin an episode at a time (s) and an arc length (m)."""
        self._course = course
        self._marks = [(name, start) for name, start in course.sections if 0.0 < start < course.length]
        self._lines = LineCrossings([start for _, start in self._marks], course.length, course.closed)
        self._lines.skip_to(progress)
        self._lap_began = self._sector_began = time
        self._time, self._progress, self._off_course = time, progress, False

    def to_card(self) -> dict[str, Any]:
        """Return what is remembered as plain values."""
        remembered = {name: getattr(self, name) for name in _REMEMBERED}
        return {**remembered, "next": self._lines.next}

    def restore(self, card: Mapping[str, Any]) -> None:
        """Go on where :meth:`to_card` was taken."""
        for name in _REMEMBERED:
            setattr(self, name, card[name])
        self._lines.next = card["next"]

    def look(
        self, time: float, progress: float, speed: float, lateral_error: float, off_course: bool, ended: list[Event]
    ) -> list[Event]:
        """Return what happened since the instant before, in the order of time.

        Args:
            time: s.
            progress: arc length, m.
            speed: m/s.
            lateral_error: m, positive left.
            off_course: whether that is beyond the course's limit.
            ended: the event of a fall, if there was one.
        """
        # The projection on an open course stops at its end, so the last step may have gone farther than it says.
        beyond = 0.0 if self._course.closed else speed * (time - self._time)
        crossed = self._lines.advance(self._time, self._progress, time, progress, beyond)
        events = [self._crossing(index, line, at) for index, line, at in crossed] + ended
        if off_course and not self._off_course:
            events.append(
                Event(EventKind.OFF_COURSE, time, progress, lateral_error, f"off the course by {lateral_error:+.2f} m")
            )
        self._time, self._progress, self._off_course = time, progress, off_course
        return events

    def _crossing(self, index: int, line: float, time: float) -> Event:
        lap, mark = divmod(index, len(self._marks) + 1)
        began, self._sector_began = self._sector_began, time
        if mark < len(self._marks):
            text = f"sector {self._marks[mark][0]!r} begins"
            return Event(EventKind.SECTOR, time, line, time - began, text)
        if not self._course.closed:
            return Event(EventKind.FINISH, time, line, 0.0, f"end of the course reached after {time:.3f} s")
        duration = time - self._lap_began
        self._lap_began = time
        return Event(EventKind.LAP, time, line, duration, f"lap {lap + 1} in {duration:.3f} s")


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
    return Event(EventKind.FALL, time, progress, roll, f"fell{how} with a roll of {roll:.2f} rad")


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
