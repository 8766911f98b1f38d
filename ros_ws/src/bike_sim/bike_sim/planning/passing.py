"""Stretches on which a ride is faster than a theoretical lap, and whether the gain is lost again.

A theoretical lap is quasi-steady and a ride is not: a tyre that is loaded by the last bump of rolling holds more for a
tenth of a second. Such gains are lost again in what follows, or the bound is none. A rider who chooses where he rides
is compared with the theoretical lap of the path that he rode: beside the followed line a curve is wider or narrower.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from bike_sim.course.track import Track
from bike_sim.planning.envelope import Envelope
from bike_sim.planning.lap_limit import lap_limit

FloatArray = NDArray[np.float64]

OVER = 0.01
"""Part by which a speed must be above the theoretical one to count as passing it."""
REPAID_WITHIN = 200.0
"""Distance within which a gain must be lost again, m."""
SMOOTHED = 6.0
"""Standard deviation of the weights that the distance to the ideal line is smoothed with, m: a mass does not follow the
contacts in what is shorter."""
ROLL_FREEDOM = 0.2
"""Time by which a rider may roll sooner or later than his path asks for, s; half of `lap_limit.LEAN_SPAN`. The wheelie
aid answers the roll rate of the moment, and who comes upright a tenth of a second sooner has his throttle sooner."""
_CLOSED_OVER = 100.0
"""Distance over which the end of a lap is led to its beginning, m."""


@dataclass(frozen=True)
class Passing:
    """A stretch on which a ride is faster than the theoretical lap.

    Attributes:
        begin: progress at which it begins, m.
        end: m.
        excess: largest part by which the speed is above the theoretical one.
        gained: time gained on the stretch, s.
        repaid: whether it is lost again within `REPAID_WITHIN` of the end.
    """

    begin: float
    end: float
    excess: float
    gained: float
    repaid: bool


def speeds_of_own_path(track: Track, envelope: Envelope, progress: FloatArray, offset: FloatArray) -> FloatArray:
    """Return the speeds of the theoretical lap of a path that was ridden, at the instants of the ride, m/s.

    Args:
        track: the circuit.
        envelope: the machine's limits.
        progress: of the rear contact along the centre line on one lap, growing, of any lap, m.
        offset: of the rear contact from the centre line, positive left, m.

    Raises:
        ValueError: the machine cannot move.
    """
    s = track.centre.s
    progress = progress - track.length * np.floor(np.median(progress) / track.length)
    near = np.zeros(len(s)) if track.ideal is None else track.ideal
    aside = np.interp(s, progress, offset) - near
    aside[:-1] += (aside[0] - aside[-1]) * np.clip(1.0 - (track.length - s[:-1]) / _CLOSED_OVER, 0.0, 1.0)
    smooth = gaussian_filter1d(aside[:-1], SMOOTHED / track.centre.spacing, mode="wrap")
    smooth = near + np.append(smooth, smooth[0])
    limit = lap_limit(envelope, track.with_ideal(smooth).line(1.0), roll_freedom=ROLL_FREEDOM)
    ahead = np.hypot(1.0 - track.centre.curvature * smooth, np.gradient(smooth, track.centre.spacing))
    along = np.concatenate(([0.0], np.cumsum(0.5 * (ahead[1:] + ahead[:-1]))))
    return limit.speed_at(np.interp(progress, s, along / along[-1] * limit.s[-1]))


def passings(theoretical: FloatArray, progress: FloatArray, speed: FloatArray) -> tuple[Passing, ...]:
    """Return the stretches on which a ride passes a theoretical lap by more than `OVER`.

    Args:
        theoretical: speed of the theoretical lap at the instants of the ride, m/s.
        progress: at the instants of the ride, growing from lap to lap, m.
        speed: of the rear contact, m/s.
    """
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
