"""How long superbikes shake on their laps: `python -m bench.lap_shake [CIRCUIT ...]`.

An out-lap and a flying lap of each machine on each circuit. Shake is what a mean over 0.2 s leaves of the lateral
acceleration, as in `bike validate superbike`; printed is the time a lap for which its root mean square over 0.5 s is
larger than 0.15 g, and the largest of these.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.making import make_rider
from bike_sim.course.files import shipped_tracks
from bike_sim.physics import superbike_forces as sf
from bike_sim.sim.snapshot import Snapshot
from bike_sim.validation.superbike import shaking
from bike_training.commands.lap import shipped_superbikes
from bike_training.rollout.laps import ride_laps

GRAVITY = 9.81
PERIOD = 0.02
"""Control period, s."""
WINDOW = 25
"""Control periods of the root mean square, 0.5 s."""
ALLOWED = 0.15
"""Shake above which the time counts, g rms."""


def shakes_of(lateral: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shake around each control period, g rms, from lateral accelerations in m/s^2."""
    return np.sqrt(np.convolve(shaking(lateral / GRAVITY) ** 2, np.full(WINDOW, 1.0 / WINDOW), mode="valid"))


def main() -> None:
    """Print a row for each machine and circuit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("circuits", nargs="*", default=list(shipped_tracks()))
    parser.add_argument("--rider", default="classical")
    args = parser.parse_args()
    print(f"{'machine':14s} {'circuit':16s} {'above, s a lap':>14s} {'largest, g':>10s}")
    for vehicle in shipped_superbikes():
        for circuit in args.circuits:
            lateral: list[float] = []

            def keep(snapshot: Snapshot, length: float, seen: list[float] = lateral) -> None:
                seen.append(float(snapshot.signals[sf.T_LATERAL]))

            ride = ride_laps(vehicle, circuit, 1, rider=make_rider(args.rider), engine="compiled", tell=keep)
            shakes = shakes_of(np.array(lateral))
            above = PERIOD * np.count_nonzero(shakes > ALLOWED) / 2.0
            end = "" if ride.end == "finished" else f"  {ride.end}"
            print(f"{vehicle:14s} {circuit:16s} {above:14.2f} {shakes.max():10.3f}{end}", flush=True)


if __name__ == "__main__":
    main()
