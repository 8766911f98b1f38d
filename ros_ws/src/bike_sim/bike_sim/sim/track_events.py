"""What happens in a ride on a circuit: laps and sectors, leaving the track and coming back, falls and walls."""

from __future__ import annotations

import math
from typing import Final

from bike_sim.course.lap_timing import TimingEvent, TimingKind
from bike_sim.physics import state as st
from bike_sim.sim import circuit_look as track_look
from bike_sim.sim.events import Event, EventKind
from bike_sim.sim.simulator import Snapshot
from bike_sim.sim.track_ride import TrackSnapshot

_KINDS: Final = {
    TimingKind.SECTOR: EventKind.SECTOR,
    TimingKind.LAP: EventKind.LAP,
    TimingKind.LEFT_TRACK: EventKind.OFF_COURSE,
    TimingKind.BACK_ON_TRACK: EventKind.BACK_ON_COURSE,
}


class TrackWatch:
    """Watches one episode; as `EventWatch` does. Progress is that of the centre line."""

    def __init__(self, circuit: str, first: TrackSnapshot) -> None:
        """Begin at the first snapshot of an episode."""
        self._circuit = circuit
        self._before = first

    def begun(self) -> Event:
        """Return the event that opens the episode."""
        first = self._before
        text = f"episode {first.episode} begins on circuit {self._circuit!r}"
        return Event(EventKind.RESET, first.time, float(first.place[track_look.PROGRESS]), 0.0, text)

    def look(self, snapshot: Snapshot) -> list[Event]:
        """Return what happened between the snapshot before and this one, in the order of time."""
        assert isinstance(snapshot, TrackSnapshot)
        events = [timing_event(event, snapshot) for event in snapshot.timing]
        if snapshot.fallen and not self._before.fallen:
            events.append(_end(snapshot))
        self._before = snapshot
        return events


def timing_event(event: TimingEvent, snapshot: TrackSnapshot) -> Event:
    """Return what the lap timing noticed as an event of the ride."""
    value = snapshot.outside if event.kind is TimingKind.LEFT_TRACK else event.value
    return Event(_KINDS[event.kind], event.time, event.progress, value, event.text)


def _end(snapshot: TrackSnapshot) -> Event:
    """Return how the ride ended."""
    progress, roll = float(snapshot.place[track_look.PROGRESS]), float(snapshot.state[st.ROLL])
    hit = snapshot.wall
    if hit is not None:
        text = f"met a wall at {hit.speed:.1f} m/s, {math.degrees(hit.angle):.0f} deg, {hit.energy / 1e3:.0f} kJ"
        return Event(EventKind.WALL, snapshot.time, progress, hit.speed, text)
    text = f"fell ({snapshot.fall.replace('_', ' ')}) at {snapshot.speed:.1f} m/s with a roll of {roll:.2f} rad"
    return Event(EventKind.FALL, snapshot.time, progress, roll, text)
