"""Rules of a race that can be judged: track limits, avoidable contact, and their penalties in seconds.

Track limits are those of the FIM MotoGP Stewards (protocol of 2019): both tyres outside at the same time is an
infraction, the third brings a warning, from the fifth on each costs a long lap. A long lap is given as time. Contact is
judged as racing codes of cars have it that the published races between learned drivers follow: who wants the inside
must be alongside the rider ahead, with the front wheel at least, when that one turns in; then both have a right to
their side of the track, up to the exit. Before that the line belongs to who is ahead. On a straight, who runs into a
machine from behind has to avoid it, and side by side who moves across.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

LONG_LAP: Final = 3.0
"""Time of a long lap, s: the Grand Prix Commission (2019) says 2 or more."""
WARNED_AT: Final = 3
ALLOWED_INFRACTIONS: Final = 4
"""Infractions of the track limits that bring a warning, and those that cost nothing."""
ALONGSIDE: Final = 0.85
"""Distance from rear wheel to rear wheel, m, up to which the front wheel of who is behind has reached the rider ahead,
who sits 0.6 m in front of the rear wheel's contact (wheelbases are 1.45 m)."""
NOSE_TO_TAIL: Final = 1.0
"""Distance by which who is ahead on a straight has been run into from behind, m."""
MOVED: Final = 0.5
"""Difference of both rates across the track from which one of them has moved into the other, m/s (estimate)."""
SAME_INCIDENT: Final = 1.0
"""Time for which touches of the same two machines belong together, s."""


@dataclass(frozen=True)
class Penalty:
    """A decision of the stewards.

    Attributes:
        time: of the race, s.
        row: of the machine.
        seconds: added to its time; 0 for a warning.
        reason: in words.
    """

    time: float
    row: int
    seconds: float
    reason: str


def at_fault(contact: Mapping[str, float]) -> tuple[int, str] | None:
    """Return which machine could have avoided a contact, and why; None for a racing incident.

    Args:
        contact: a row of `traffic.INCIDENT` by name.
    """
    ahead, behind = int(contact["row"]), int(contact["other"])
    if contact["lying"]:
        return None
    overlap = contact["overlap"]
    if math.isnan(overlap):
        if contact["along"] > NOSE_TO_TAIL:
            return behind, "ran into the machine ahead"
    elif overlap > ALONGSIDE:
        return behind, f"was {overlap:.1f} m behind at turn-in and had no right to the line"
    side = math.copysign(1.0, contact["across"])  # of who is ahead
    towards, other_towards = -side * contact["drift"], side * contact["other_drift"]
    if towards > other_towards + MOVED:
        return ahead, "moved into the machine beside"
    if other_towards > towards + MOVED:
        return behind, "moved into the machine beside"
    return None


@dataclass
class Stewards:
    """What the stewards have seen of a race.

    Attributes:
        penalties: in order.
        infractions: of the track limits, by row.
    """

    penalties: list[Penalty] = field(default_factory=list)
    infractions: dict[int, int] = field(default_factory=dict)
    _touched: dict[tuple[int, int], float] = field(default_factory=dict)

    def off_track(self, time: float, row: int) -> None:
        """Count both tyres of a machine outside the limits."""
        count = self.infractions[row] = self.infractions.get(row, 0) + 1
        if count == WARNED_AT:
            self.penalties.append(Penalty(time, row, 0.0, f"warned of the track limits after {count} infractions"))
        elif count > ALLOWED_INFRACTIONS:
            self.penalties.append(Penalty(time, row, LONG_LAP, f"track limits, infraction {count}"))

    def contact(self, time: float, contact: Mapping[str, float]) -> bool:
        """Judge a touch; return whether it begins an incident.

        Args:
            time: of the race, s.
            contact: a row of `traffic.INCIDENT` by name.
        """
        row, other = int(contact["row"]), int(contact["other"])
        pair = min(row, other), max(row, other)
        before = self._touched.get(pair, -math.inf)
        self._touched[pair] = time
        fresh = time - before > SAME_INCIDENT
        thrown = contact["thrown"] or contact["other_thrown"]
        fault = at_fault(contact)
        if fault is not None and (fresh or thrown):
            guilty, reason = fault
            victim_down = contact["other_thrown"] if guilty == row else contact["thrown"]
            seconds = LONG_LAP * (2.0 if victim_down else 1.0)
            self.penalties.append(Penalty(time, guilty, seconds, f"avoidable contact: {reason}"))
        return fresh

    def seconds(self, row: int) -> float:
        """Return the sum of a machine's penalties, s."""
        return sum(penalty.seconds for penalty in self.penalties if penalty.row == row)
