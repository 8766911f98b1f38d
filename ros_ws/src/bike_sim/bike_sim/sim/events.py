"""What happens in a ride: resets, falls, laps and sectors, found from one snapshot to the next."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.sim import look as ride
from bike_sim.sim.simulator import Snapshot


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


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes:
        kind: what.
        time: s since the reset, interpolated below the step where a line was crossed.
        progress: arc length of the course, m.
        value: time of the lap or sector (s), roll of a fall (rad), lateral error off the course (m), speed at a wall
            (m/s), time away of who comes back (s), else 0.
        text: one sentence for people.
    """

    kind: EventKind
    time: float
    progress: float
    value: float
    text: str


class EventWatch:
    """Watches one episode.

    A line across the course (the start of a section, the end of a lap) counts once, when it is first crossed forward.
    """

    def __init__(self, course: Course, first: Snapshot) -> None:
        """Begin at the first snapshot of an episode.

        Args:
            course: the course that is ridden.
            first: the snapshot that the reset returned.
        """
        self._course = course
        self._before = first
        self._marks = [(name, start) for name, start in course.sections if 0.0 < start < course.length]
        self._lap_began = first.time
        self._sector_began = first.time
        self._crossed = 0
        while self._next_line()[0] <= _progress(first):
            self._crossed += 1

    def begun(self) -> Event:
        """Return the event that opens the episode."""
        text = f"episode {self._before.episode} begins on course {self._course.name!r}"
        return Event(EventKind.RESET, self._before.time, _progress(self._before), 0.0, text)

    def look(self, snapshot: Snapshot) -> list[Event]:
        """Return what happened between the snapshot before and this one, in the order of time."""
        events = self._crossings(snapshot)
        if snapshot.fallen and not self._before.fallen:
            roll = float(snapshot.state[st.ROLL])
            events.append(self._now(EventKind.FALL, snapshot, roll, f"fell with a roll of {roll:.2f} rad"))
        if snapshot.off_course and not self._before.off_course:
            error = float(snapshot.seen[ride.LATERAL_ERROR])
            events.append(self._now(EventKind.OFF_COURSE, snapshot, error, f"off the course by {error:+.2f} m"))
        self._before = snapshot
        return events

    def _now(self, kind: EventKind, snapshot: Snapshot, value: float, text: str) -> Event:
        return Event(kind, snapshot.time, _progress(snapshot), value, text)

    def _next_line(self) -> tuple[float, str | None]:
        """Return the arc length of the line that is crossed next, and the sector that begins there or None."""
        lap, mark = divmod(self._crossed, len(self._marks) + 1)
        if lap and not self._course.closed:
            return float("inf"), None
        if mark < len(self._marks):
            name, start = self._marks[mark]
            return lap * self._course.length + start, name
        return (lap + 1) * self._course.length, None

    def _crossings(self, snapshot: Snapshot) -> list[Event]:
        events: list[Event] = []
        while True:
            line, sector = self._next_line()
            # The projection on an open course stops at its end, so the end counts as crossed when it is reached.
            if _progress(snapshot) < line - (0.0 if self._course.closed else 1e-9):
                return events
            time = self._crossing_time(snapshot, line)
            if sector is not None:
                text = f"sector {sector!r} begins"
                events.append(Event(EventKind.SECTOR, time, line, time - self._sector_began, text))
            elif self._course.closed:
                lap_time = time - self._lap_began
                number = self._crossed // (len(self._marks) + 1) + 1
                events.append(Event(EventKind.LAP, time, line, lap_time, f"lap {number} in {lap_time:.3f} s"))
                self._lap_began = time
            else:
                text = f"end of the course reached after {time:.3f} s"
                events.append(Event(EventKind.FINISH, time, line, 0.0, text))
            self._sector_began = time
            self._crossed += 1

    def _crossing_time(self, snapshot: Snapshot, line: float) -> float:
        """Return when a line was crossed since the snapshot before, s, at constant speed along the course."""
        before, after = _progress(self._before), _progress(snapshot)
        period = snapshot.time - self._before.time
        travelled = after - before
        if not self._course.closed and line >= self._course.length - 1e-9:
            travelled = max(travelled, float(snapshot.seen[ride.SPEED]) * period)
        share = (line - before) / travelled if travelled > 0.0 else 1.0
        return self._before.time + min(max(share, 0.0), 1.0) * period


def _progress(snapshot: Snapshot) -> float:
    return float(snapshot.seen[ride.PROGRESS])
