"""Rows and time of the rides in a table of states: stamps that go back within a ride are not believed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def ride_bounds(episode: Integers, step: Integers) -> list[int]:
    """Find where rides begin.

    Args:
        episode: Number of the episode of each state.
        step: Control steps since its reset.

    Returns:
        First row of each ride, and at last the number of states. A ride begins where the episode changes or the step
        goes back (a simulator that was restarted counts its episodes from 1 again).
    """
    begins = np.flatnonzero((np.diff(episode) != 0) | (np.diff(step) < 0)) + 1
    return [0, *begins.tolist(), len(step)]


def forward_time(time_s: Floats, episode: Integers, step: Integers, period: Floats) -> tuple[Floats, list[str]]:
    """Make time run forward within each ride.

    A clock that was set back, or damage, would make laps shorter than they were. The steps are the simulator's own
    clock, so the time of such a ride is counted from them.

    Args:
        time_s: Stamps of states, s.
        episode: Number of the episode of each state.
        step: Control steps since its reset.
        period: Control period, s; NaN where it is not known.

    Returns:
        The time of each state, s, and a sentence for each ride whose stamps went back.
    """
    told: list[str] = []
    for ride, (first, last) in enumerate(pairwise(ride_bounds(episode, step)), start=1):
        stamps, steps = time_s[first:last], step[first:last]
        falls = np.flatnonzero(np.diff(stamps) < 0.0)
        if not len(falls):
            continue
        if not told:
            time_s = time_s.copy()
        time_s[first:last] = stamps[0] + (steps - steps[0]) * _usual_period(stamps, steps, period[first:last])
        times = "once" if len(falls) == 1 else f"{len(falls)} times"
        told.append(
            f"the stamps of ride {ride} go back in time {times}, first after step {steps[falls[0]]}: "
            "its time is counted from its steps"
        )
    return time_s, told


def _usual_period(stamps: Floats, steps: Integers, period: Floats) -> float:
    """Control period of a ride, s: as recorded, or else the usual one between stamps that go forward; 0 without any."""
    known = period[np.isfinite(period) & (period > 0.0)]
    if not len(known):
        across, along = np.diff(stamps), np.diff(steps)
        forward = (across > 0.0) & (along > 0)
        known = across[forward] / along[forward]
    return float(np.median(known)) if len(known) else 0.0
