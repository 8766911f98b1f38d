"""Lines across a course (starts of sections, ends of laps), crossed once each; the base of all timing."""

from __future__ import annotations

import math
from collections.abc import Sequence


def crossed_share(ahead: float, moved: float) -> float:
    """Return the part of a step after which a line is crossed, at constant speed along the course.

    Args:
        ahead: distance of the line at the beginning of the step, m.
        moved: distance ridden in the step, m.
    """
    return min(max(ahead / moved, 0.0), 1.0) if moved > 0.0 else 1.0


class LineCrossings:
    """Counts lines in the order in which a course has them; riding back over one and on again changes nothing.

    Attributes:
        next: index of the next line to cross.
    """

    def __init__(self, marks: Sequence[float], length: float, closed: bool) -> None:
        """Take the lines within a lap.

        Args:
            marks: arc lengths between 0 and `length`, m, growing.
            length: of a lap, or of an open course, m; its end is the last line.
            closed: whether laps follow each other.
        """
        self._marks = list(marks)
        self._length, self._closed = length, closed
        self.next = 0

    def line(self, index: int) -> float:
        """Return the arc length of a line, m; infinite behind the end of an open course."""
        lap, mark = divmod(index, len(self._marks) + 1)
        if lap and not self._closed:
            return math.inf
        return lap * self._length + self._marks[mark] if mark < len(self._marks) else (lap + 1) * self._length

    def skip_to(self, progress: float) -> None:
        """Leave out all lines up to an arc length, m."""
        while self.line(self.next) <= progress:
            self.next += 1

    def advance(
        self, time: float, progress: float, later: float, farther: float, beyond: float = 0.0
    ) -> list[tuple[int, float, float]]:
        """Return index, arc length (m) and time (s) of each line that was crossed between two instants.

        Args:
            time: of the first instant, s.
            progress: arc length there, m.
            later: time of the second instant, s.
            farther: arc length there, m.
            beyond: distance ridden meanwhile where that is more than the arc lengths say, as behind an open end, m.
        """
        found = []
        # The projection on an open course stops at its end, so the end counts as crossed when it is reached.
        slack = 0.0 if self._closed else 1e-9
        while farther >= (line := self.line(self.next)) - slack:
            at_end = not self._closed and line >= self._length - slack
            moved = max(farther - progress, beyond) if at_end else farther - progress
            found.append((self.next, line, time + crossed_share(line - progress, moved) * (later - time)))
            self.next += 1
        return found
