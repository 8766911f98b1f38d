"""Lap timing: laps, sectors, time off the track and distance to the ideal line, from the account of a ride."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any

from numba import njit
from numpy import float64
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.track import IDEAL, LEFT, RIGHT

FloatArray = NDArray[float64]

REACH = 4.0
"""The nearest point is searched this far forward and backward, m: over two control steps at top speed, less than to a
parallel road. Where a point moves farther in a step, the search follows it (`projection.window`)."""

EXACT = 0.05
"""Tolerance of a requested start, m: the projection from the centre line to the followed line and back
goes through tables."""


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


class EventKind(IntEnum):
    """Kinds of events; the numbers are those of ``bike_msgs/RideEvent``."""

    RESET = 0
    FALL = 1
    OFF_COURSE = acc.LEFT_TRACK
    WALL = 3
    LAP = acc.LAP
    FINISH = acc.FINISH
    SECTOR = acc.SECTOR
    BACK_ON_COURSE = acc.BACK_ON_TRACK
    SCRAPE = 8


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened.

    Attributes:
        kind: what.
        time: s since the reset, interpolated within the step where a line was crossed.
        progress: arc length, m: along the course, on a circuit along its centre line.
        value: time of the lap or sector (s), roll of a fall (rad), lateral error off the course or distance beyond the
            limits (m; 0 from samples), speed at a wall hit or scraped (m/s), time off the track on return (s), else 0.
        text: one sentence for people.
    """

    kind: EventKind
    time: float
    progress: float
    value: float
    text: str


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


class LapLog:
    """Finished laps and events of a ride, from the rows that its account writes.

    Attributes:
        laps: in order.
    """

    def __init__(self) -> None:
        self.laps: list[Lap] = []
        self._sectors: list[float] = []

    def take(self, row: Sequence[float]) -> Event:
        """Return a row of `timing_account` as an event, and keep the lap that it finishes."""
        kind, time, progress, value, number, began, off_track, distance = row
        if kind == EventKind.LAP:
            lap = Lap(int(number), began, value, tuple(self._sectors), off_track, distance)
            self.laps.append(lap)
            minutes, seconds = divmod(round(value, 3), 60.0)  # rounded first: never 60.000 s
            text = f"lap {lap.number} in {int(minutes)}:{seconds:06.3f}"
            if not lap.valid:
                text += f", invalid: {off_track:.2f} s outside the limits"
        elif kind == EventKind.SECTOR:
            if int(number) == 1:
                self._sectors.clear()
            self._sectors.append(value)
            text = f"sector {int(number)} in {value:.3f} s"
        elif kind == EventKind.OFF_COURSE:
            text = "both wheels left the track"
        else:
            text = f"back on the track after {value:.2f} s"
        return Event(EventKind(int(kind)), time, progress, value, text)

    def valid_laps(self) -> tuple[float, ...]:
        """Return the times of the valid laps, s."""
        return tuple(lap.duration for lap in self.laps if lap.valid)

    def to_card(self) -> dict[str, Any]:
        """Return plain values that :meth:`from_card` reads."""
        return {"laps": [asdict(lap) for lap in self.laps], "sectors": list(self._sectors)}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> LapLog:
        """Read what :meth:`to_card` wrote, also after a round trip through JSON."""
        log = cls()
        log.laps = [Lap(**{**lap, "sectors": tuple(lap["sectors"])}) for lap in card["laps"]]
        log._sectors = list(card["sectors"])
        return log

    def timing(self, account: Any, measured: bool) -> Timing:
        """Return the summary of a ride.

        Args:
            account: its record of `timing_account.ACCOUNT`.
            measured: whether there is an ideal line.
        """
        return Timing(
            tuple(self.laps),
            float(account["ride"]["off_track"]),
            float(acc.mean_distance(account["ride"], measured)),
            float(account["farthest"]) if measured and account["started"] else math.nan,
        )


@njit(cache=True)
def outside(table: FloatArray, spacing: float, length: float, progress: float, offset: float) -> float:
    """Return the distance of a point of a circuit beyond its limits, m; negative within.

    Args:
        table: `Track.table`.
        spacing: of its samples, m.
        length: of the centre line, m.
        progress: m.
        offset: m, positive to the left.
    """
    left = offset - acc.sample(table[LEFT], spacing, length, progress)
    right = -offset - acc.sample(table[RIGHT], spacing, length, progress)
    return max(left, right)


@njit(cache=True)
def ideal_distance(table: FloatArray, spacing: float, length: float, progress: float, offset: float) -> float:
    """Return the distance of a point to the ideal line, m; 0 without one. Arguments as those of `outside`."""
    if math.isnan(table[IDEAL, 0]):
        return 0.0
    return abs(offset - acc.sample(table[IDEAL], spacing, length, progress))
