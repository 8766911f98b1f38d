"""Where a ride is faster than a theoretical lap for a moment, and whether it pays for it.

A theoretical lap is quasi-steady and a ride is not: a tyre that is loaded by the last bump of rolling holds more for a
tenth of a second, and a rider who runs wide has a wider curve. Such gains are lost again in what follows, or the bound
is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bike_sim.theory.lap_limit import LapLimit

FloatArray = NDArray[np.float64]

OVER = 0.01
"""Part by which a speed must be above the theoretical one to count as passing it."""
REPAID_WITHIN = 200.0
"""Distance within which a gain must be lost again, m."""


@dataclass(frozen=True)
class Passing:
    """A stretch on which a ride is faster than the theoretical lap.

    Attributes:
        begin: progress at which it begins, m. end: m.
        excess: largest part by which the speed is above the theoretical one.
        gained: time gained on the stretch, s.
        repaid: whether it is lost again within `REPAID_WITHIN` of the end.
    """

    begin: float
    end: float
    excess: float
    gained: float
    repaid: bool


def passings(limit: LapLimit, progress: FloatArray, speed: FloatArray) -> tuple[Passing, ...]:
    """Return the stretches on which a ride passes a theoretical lap by more than `OVER`.

    Args:
        limit: theoretical lap of the line that is followed.
        progress: arc length of the line at the instants of the ride, m; laps may begin at 0 again.
        speed: of the rear contact, m/s.
    """
    progress = np.unwrap(progress, period=limit.s[-1])
    theoretical = limit.speed_at(progress)
    excess = speed / theoretical - 1.0
    step = np.diff(progress)
    gained = np.concatenate(([0.0], np.cumsum(0.5 * step * (_slowness(theoretical) - _slowness(speed)))))
    above = np.concatenate(([False], excess > OVER, [False]))
    begins, ends = np.flatnonzero(above[1:] & ~above[:-1]), np.flatnonzero(above[:-1] & ~above[1:])
    found = []
    for first, stop in zip(begins, ends, strict=True):
        last = int(stop) - 1
        gain = float(gained[last] - gained[max(int(first) - 1, 0)])
        after = (progress > progress[last]) & (progress <= progress[last] + REPAID_WITHIN)
        least = float(np.min(gained[after], initial=gained[last]))
        repaid = gained[last] - least >= gain
        found.append(
            Passing(float(progress[first]), float(progress[last]), float(excess[first:stop].max()), gain, repaid)
        )
    return tuple(found)


def _slowness(speed: FloatArray) -> FloatArray:
    """Return twice the mean of 1 / speed over each step, s/m."""
    return 1.0 / speed[1:] + 1.0 / speed[:-1]
