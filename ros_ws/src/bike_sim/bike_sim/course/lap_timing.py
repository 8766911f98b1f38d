"""Lap timing: laps, sectors, time off the track and distance to the ideal line, from samples of a ride.

A pure account: fed sample by sample while riding, or with a whole recording afterwards, it gives the same numbers bit
for bit. Lines are crossed between samples; the time of crossing is interpolated in progress.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from bike_sim.course.line_crossings import crossed_share
from bike_sim.course.track import Track


@dataclass(frozen=True)
class Sample:
    """Where the machine is at one instant.

    Attributes:
        time: s, growing.
        progress: of the rear contact point along the centre line, m, growing over laps.
        offset: of the rear contact point from the centre line, m, positive to the left.
        front_progress: of the front contact point, m.
        front_offset: of the front contact point, m.
    """

    time: float
    progress: float
    offset: float
    front_progress: float
    front_offset: float


@dataclass(frozen=True)
class Lap:
    """A finished lap.

    Attributes:
        number: counted from 1.
        began: time at the start line, s.
        duration: s.
        sectors: durations, s, in the order of the circuit's sectors.
        off_track: time with both contact points outside the limits, s.
        ideal_distance: mean over time of the distance to the ideal line, m; NaN without one.
    """

    number: int
    began: float
    duration: float
    sectors: tuple[float, ...]
    off_track: float
    ideal_distance: float

    @property
    def valid(self) -> bool:
        """Whether at least one contact point was inside the limits all the time."""
        return self.off_track == 0.0


class TimingKind(Enum):
    """A report of the timing."""

    SECTOR = "sector"
    LAP = "lap"
    LEFT_TRACK = "left track"
    BACK_ON_TRACK = "back on track"


@dataclass(frozen=True)
class TimingEvent:
    """Something the timing noticed.

    Attributes:
        kind: what.
        time: when, interpolated between samples, s.
        progress: where, m, growing over laps.
        value: duration of the sector or lap, or of the time off the track, s; 0 when it is left.
        lap: the finished lap, for a lap.
        text: one sentence for people.
    """

    kind: TimingKind
    time: float
    progress: float
    value: float
    text: str
    lap: Lap | None = None


@dataclass(frozen=True)
class Timing:
    """Summary of a ride.

    Attributes:
        laps: finished laps in order.
        off_track: time with both contact points outside the limits, over the whole ride, s.
        ideal_distance: mean over the whole ride's time of the distance to the ideal line, m; NaN without one.
        farthest: largest distance to the ideal line at a sample, m; NaN without one.
    """

    laps: tuple[Lap, ...]
    off_track: float
    ideal_distance: float
    farthest: float

    @property
    def last(self) -> Lap | None:
        """The last finished lap."""
        return self.laps[-1] if self.laps else None

    @property
    def best(self) -> Lap | None:
        """The fastest valid lap."""
        return min((lap for lap in self.laps if lap.valid), key=lambda lap: lap.duration, default=None)


@dataclass(frozen=True)
class _Sums:
    """What adds up over time: time (s), time off the track (s), distance to the ideal line times time (m s)."""

    time: float = 0.0
    off_track: float = 0.0
    distance: float = 0.0

    def plus(self, other: _Sums) -> _Sums:
        return _Sums(self.time + other.time, self.off_track + other.off_track, self.distance + other.distance)

    def mean_distance(self, known: bool) -> float:
        return self.distance / self.time if known and self.time > 0.0 else math.nan


@dataclass(frozen=True)
class _Place:
    """A sample with the distances of both contact points beyond the limits (m) and to the ideal line."""

    time: float
    progress: float
    outside: float
    distance: float


class LapTimer:
    """Times one ride.

    Timing begins when the start line is first crossed (or with the first sample, if that lies on it). A line counts
    once, when it is first crossed forward: riding back over it and on again changes nothing.
    """

    def __init__(self, track: Track) -> None:
        """Begin a ride on a circuit; its ideal line is measured against if it has one."""
        self._track = track
        self._marks = [start for _, start in track.sectors if 0.0 < start < track.length]
        self._before: _Place | None = None
        self._next = 0  # Index of the next line to cross; line k * (marks + 1) is the start of lap k.
        self._lap_began: float | None = None
        self._sector_began = 0.0
        self._sectors: list[float] = []
        self._lap, self._ride = _Sums(), _Sums()
        self._left_at: float | None = None
        self._farthest = math.nan
        self._laps: list[Lap] = []

    def feed(self, sample: Sample) -> list[TimingEvent]:
        """Take the next sample and return what happened since the one before, in the order of time.

        Raises:
            ValueError: a value that is not finite, or time that does not grow.
        """
        values = (sample.time, sample.progress, sample.offset, sample.front_progress, sample.front_offset)
        if not all(math.isfinite(value) for value in values):
            raise ValueError(f"a sample of lap timing must be finite, got {sample}")
        place = self._place(sample)
        if self._track.ideal is not None:
            self._farthest = max(place.distance, 0.0 if math.isnan(self._farthest) else self._farthest)
        before, self._before = self._before, place
        if before is None:
            return self._begin(place)
        if place.time <= before.time:
            raise ValueError(f"time of lap timing must grow, got {place.time} s after {before.time} s")
        events = self._border_events(before, place)
        while self._line(self._next) <= place.progress:
            crossing = self._between(before, place, self._line(self._next))
            self._add(before, crossing)
            events += self._cross(crossing)
            before = crossing
        self._add(before, place)
        return sorted(events, key=lambda event: event.time)

    def timing(self) -> Timing:
        """Return the summary so far."""
        known = self._track.ideal is not None
        return Timing(tuple(self._laps), self._ride.off_track, self._ride.mean_distance(known), self._farthest)

    def _place(self, sample: Sample) -> _Place:
        rear = float(self._track.outside(sample.progress, sample.offset))
        front = float(self._track.outside(sample.front_progress, sample.front_offset))
        distance = 0.0
        if self._track.ideal is not None:
            distance = abs(sample.offset - float(self._track.at(self._track.ideal, sample.progress)))
        return _Place(sample.time, sample.progress, min(rear, front), distance)

    def _begin(self, place: _Place) -> list[TimingEvent]:
        lines = len(self._marks) + 1
        self._next = lines * math.floor(place.progress / self._track.length)
        while self._line(self._next) < place.progress:
            self._next += 1
        if place.outside > 0.0:
            self._left_at = place.time
        return self._cross(place) if self._line(self._next) == place.progress else []

    def _line(self, index: int) -> float:
        """Return the progress of a line, m."""
        lap, mark = divmod(index, len(self._marks) + 1)
        return lap * self._track.length + (self._marks[mark - 1] if mark else 0.0)

    @staticmethod
    def _between(before: _Place, after: _Place, progress: float) -> _Place:
        """Return the crossing of a line, everything linear in progress."""
        share = crossed_share(progress - before.progress, after.progress - before.progress)

        def mix(a: float, b: float) -> float:
            return a + share * (b - a)

        return _Place(
            mix(before.time, after.time),
            progress,
            mix(before.outside, after.outside),
            mix(before.distance, after.distance),
        )

    def _add(self, a: _Place, b: _Place) -> None:
        """Add the time between two samples to the sums of the lap and of the ride."""
        span = b.time - a.time
        if span <= 0.0:
            return
        outside = span * _share_above_zero(a.outside, b.outside)
        sums = _Sums(span, outside, 0.5 * span * (a.distance + b.distance))
        self._lap, self._ride = self._lap.plus(sums), self._ride.plus(sums)

    def _border_events(self, a: _Place, b: _Place) -> list[TimingEvent]:
        """Return the event of leaving the track or coming back between two samples."""
        if (a.outside > 0.0) == (b.outside > 0.0):
            return []
        share = a.outside / (a.outside - b.outside)
        time, progress = a.time + share * (b.time - a.time), a.progress + share * (b.progress - a.progress)
        if b.outside > 0.0:
            self._left_at = time
            return [TimingEvent(TimingKind.LEFT_TRACK, time, progress, 0.0, "both wheels left the track")]
        away = time - (time if self._left_at is None else self._left_at)
        self._left_at = None
        text = f"back on the track after {away:.2f} s"
        return [TimingEvent(TimingKind.BACK_ON_TRACK, time, progress, away, text)]

    def _cross(self, at: _Place) -> list[TimingEvent]:
        """Count a line and return the sector and the lap that end there."""
        starts_lap = self._next % (len(self._marks) + 1) == 0
        self._next += 1
        events = []
        if self._lap_began is not None:
            duration = at.time - self._sector_began
            self._sectors.append(duration)
            text = f"sector {len(self._sectors)} in {duration:.3f} s"
            events.append(TimingEvent(TimingKind.SECTOR, at.time, at.progress, duration, text))
        self._sector_began = at.time
        if starts_lap:
            if self._lap_began is not None:
                events.append(self._finish_lap(at))
            self._lap_began, self._sectors, self._lap = at.time, [], _Sums()
        return events

    def _finish_lap(self, at: _Place) -> TimingEvent:
        assert self._lap_began is not None
        lap = Lap(
            len(self._laps) + 1,
            self._lap_began,
            at.time - self._lap_began,
            tuple(self._sectors),
            self._lap.off_track,
            self._lap.mean_distance(self._track.ideal is not None),
        )
        self._laps.append(lap)
        minutes, seconds = divmod(round(lap.duration, 3), 60.0)  # rounded first: never 60.000 s
        text = f"lap {lap.number} in {int(minutes)}:{seconds:06.3f}"
        if not lap.valid:
            text += f", invalid: {lap.off_track:.2f} s outside the limits"
        return TimingEvent(TimingKind.LAP, at.time, at.progress, lap.duration, text, lap)


def _share_above_zero(a: float, b: float) -> float:
    """Return the fraction of a straight line from a to b that is above zero."""
    if a > 0.0 and b > 0.0:
        return 1.0
    if a <= 0.0 and b <= 0.0:
        return 0.0
    return max(a, b) / abs(a - b)


def time_laps(track: Track, samples: Iterable[Sample]) -> tuple[Timing, tuple[TimingEvent, ...]]:
    """Time a whole ride, as from a recording; the same as feeding its samples one by one."""
    timer = LapTimer(track)
    events = tuple(itertools.chain.from_iterable(timer.feed(sample) for sample in samples))
    return timer.timing(), events
