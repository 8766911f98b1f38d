"""The finish of an open course: a recorded ride is evaluated up to there.

A ride stops a sample or two behind the end of its course, depending on when its stop is noticed. There the projection
onto the course is the end point (:func:`bike_sim.course.projection.project` clips the arc length), so the distance to
the course is that to the end *point*: it grows with the distance travelled beyond the finish and is no lateral error.
Here the course is extended straight beyond its end, lateral errors are measured to that line, and the ride is cut where
it crosses the finish, with a last sample interpolated there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bike_sim.course.course import Course

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Finish:
    """The end of an open course.

    Attributes:
        length: arc length of the end, m.
        x: m, map frame.
        y: m, map frame.
        heading: direction of the course at its end, rad.
    """

    length: float
    x: float
    y: float
    heading: float

    @classmethod
    def of(cls, course: Course) -> Self | None:
        """Return the finish of a course, or None for a closed one, which has no end."""
        if course.closed:
            return None
        return cls(float(course.s[-1]), float(course.x[-1]), float(course.y[-1]), float(course.heading[-1]))

    def extend(
        self, progress: ArrayLike, lateral_error: ArrayLike, x: ArrayLike, y: ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Measure samples behind the finish against the course's straight continuation.

        Args:
            progress: arc length of the nearest point of the course, clipped at its end, m.
            lateral_error: signed distance to the nearest point, m, positive to the left.
            x: of the point that was projected, m, map frame.
            y: the same, m.

        Returns:
            Progress that continues beyond the end, m, and lateral error, m. Samples before the end and samples
            without a position are unchanged.
        """
        along_course = np.array(progress, dtype=np.float64)
        lateral = np.array(lateral_error, dtype=np.float64)
        dx, dy = np.asarray(x, dtype=np.float64) - self.x, np.asarray(y, dtype=np.float64) - self.y
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        beyond = dx * cos + dy * sin
        # At the end of a curve the nearest point may be the end although the sample lies a hair before its normal.
        clipped = (along_course >= self.length) & np.isfinite(beyond)
        along_course[clipped] = self.length + np.maximum(beyond[clipped], 0.0)
        lateral[clipped] = (dy * cos - dx * sin)[clipped]
        return along_course, lateral


@dataclass(frozen=True)
class FinishCut:
    """Crossing of the finish by a ride of samples.

    Attributes:
        rows: number of samples that are kept as they are.
        share: where between the sample before the finish and the one behind it the crossing lies, in (0, 1]; the
            sample itself at 1.
    """

    rows: int
    share: float

    def interpolate(self, column: ArrayLike) -> FloatArray:
        """Cut a column at the finish; its last value is interpolated linearly between the samples around it."""
        values = np.asarray(column, dtype=np.float64)
        before, behind = values[self.rows - 1], values[self.rows]
        last = behind if self.share == 1.0 else before + self.share * (behind - before)
        return np.append(values[: self.rows], last)

    def hold(self, column: NDArray[Any]) -> NDArray[Any]:
        """Cut a column that is constant over a step (a command, a flag); its last value is the one behind the line."""
        return column[: self.rows + 1]


def find_finish(length: float, progress: ArrayLike) -> FinishCut | None:
    """Find where a ride crosses the finish for the first time.

    Args:
        length: arc length of the finish, m.
        progress: arc length of each sample, m, going on behind the finish (`Finish.extend`); NaN where not known.

    Returns:
        The cut, or None where the finish is not crossed between two samples: it was not reached, or the first known
        sample lies behind it already.
    """
    arc_length = np.asarray(progress, dtype=np.float64)
    behind = np.flatnonzero(arc_length >= length)
    if not len(behind) or behind[0] == 0 or not arc_length[behind[0] - 1] < length:
        return None
    row = int(behind[0])
    before = arc_length[row - 1]
    return FinishCut(row, float((length - before) / (arc_length[row] - before)))


def up_to_finish(
    finish: Finish | None,
    progress: ArrayLike,
    lateral_error: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    *columns: ArrayLike,
) -> tuple[FloatArray, ...]:
    """Cut a ride at the finish, with a last sample interpolated there.

    Args:
        finish: end of the open course, or None for a closed course, whose columns come back as given.
        progress: arc length of the nearest point of the course, m, one value per sample.
        lateral_error: signed distance to the course, m, positive to the left.
        x: of the point that was projected, m, map frame.
        y: the same, m.
        columns: further columns of the same length, interpolated linearly (time, speed, ...).

    Returns:
        All columns in the order given, of equal length. A ride that does not reach the finish is returned whole.
    """
    given = tuple(np.asarray(column, dtype=np.float64) for column in (progress, lateral_error, x, y, *columns))
    if finish is None:
        return given
    arc_length, lateral = finish.extend(*given[:4])
    cut = find_finish(finish.length, arc_length)
    if cut is None:
        return given
    return tuple(cut.interpolate(column) for column in (arc_length, lateral, *given[2:]))
