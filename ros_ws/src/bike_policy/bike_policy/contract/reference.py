"""The reference of a circuit's followed line: curvature and a planned speed along it, for rows of vehicles.

What is followed and how fast it can be ridden is known before the ride; where the vehicle is on it comes with each
state. Observation and reward look both up here, so that they mean the same reference.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.line_tables import LineTables

FloatArray = NDArray[np.float64]

OPEN: Final = 1000.0
"""Speed limit of a ride without one, m/s: finite, so that it passes through every file and message."""


class Reference(NamedTuple):
    """A closed followed line, sampled evenly; the last sample repeats the first.

    Attributes:
        spacing: distance of the samples, m.
        curvature: 1/m, positive turning left.
        speed: planned speed, m/s.
    """

    spacing: float
    curvature: FloatArray
    speed: FloatArray


class ReferenceRows:
    """References of vehicles side by side; rows on the same line share its samples.

    Attributes:
        share: part of the planned speed that is asked of each row. cap: speed limit of each row, m/s.
        lines: that the rows follow.
    """

    def __init__(self, count: int) -> None:
        """Make room for a number of vehicles."""
        self.share = np.ones(count)
        self.cap = np.full(count, OPEN)
        self.lines = LineTables[Reference](
            count, (0.0, 1.0), lambda line: np.stack((line.curvature, line.speed), axis=1)
        )

    def begin(self, row: int, reference: Reference, share: float = 1.0, cap: float = OPEN) -> None:
        """Let a row follow a line from now on.

        Args:
            row: of the vehicle.
            reference: of the line.
            share: part of the planned speed that is asked.
            cap: speed limit, m/s.

        Raises:
            ValueError: a reference, share or limit that means nothing.
        """
        if len(reference.curvature) != len(reference.speed) or len(reference.speed) < 3:
            raise ValueError(
                f"a reference needs as many curvatures as speeds, at least 3, got {len(reference.curvature)} and "
                f"{len(reference.speed)}"
            )
        if not share > 0.0 or not cap > 0.0:
            raise ValueError(f"share of the planned speed and speed limit must be positive, got {share!r} and {cap!r}")
        self.lines.begin(row, reference, reference.spacing)
        self.share[row], self.cap[row] = share, cap

    def at(self, progress: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return curvature (1/m) and the speed that is asked (m/s), linear between samples.

        Args:
            progress: arc length of the line, of any lap, m, shape (n,) or (n, k).
        """
        many = (slice(None),) + (None,) * (progress.ndim - 1)
        lines = self.lines
        length = lines.spacing * (lines.last + 1)
        u = np.mod(progress, length[many]) / lines.spacing[many]
        i = np.minimum(u.astype(np.int64), lines.last[many])
        u -= i
        i += lines.offset[many]
        here, step = lines.samples[i], lines.samples[i + 1] - lines.samples[i]
        curvature, speed = np.moveaxis(here + u[..., None] * step, -1, 0)
        return curvature, np.minimum(self.share[many] * speed, self.cap[many])
