"""How long superbikes shake on their laps, and how busy their riders are: `python -m bench.lap_shake [CIRCUIT ...]`.

An out-lap and a flying lap of each machine on each circuit. Shake is what a mean over 0.2 s leaves of the lateral
acceleration, as in `bike validate superbike`; printed is the time a lap for which its root mean square over 0.5 s is
larger than 0.15 g, and the largest of these. A rider's activity is the mean change of steering and of throttle or
brake, both in [-1, 1], from one control period of 20 ms to the next, in thousandths.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.making import make_rider
from bike_sim.course.files import shipped_tracks
from bike_sim.physics import superbike_forces as sf
from bike_sim.schema import GRAVITY
from bike_sim.sim.snapshot import Snapshot
from bike_sim.validation.superbike import shaking
from bike_training.commands.lap import shipped_superbikes
from bike_training.rollout.laps import ride_laps

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
    print(
        f"{'machine':14s} {'circuit':16s} {'above, s a lap':>14s} {'largest, g':>10s} {'steering':>9s} {'throttle':>9s}"
    )
    for vehicle in shipped_superbikes():
        for circuit in args.circuits:
            moments: list[tuple[float, float, float]] = []

            def keep(snapshot: Snapshot, length: float, seen: list[tuple[float, float, float]] = moments) -> None:
                seen.append((float(snapshot.signals[sf.T_LATERAL]), snapshot.steering, snapshot.throttle))

            ride = ride_laps(vehicle, circuit, 1, rider=make_rider(args.rider), engine="compiled", tell=keep)
            ridden = np.array(moments)
            shakes = shakes_of(ridden[:, 0])
            steering, throttle = 1000.0 * np.abs(np.diff(ridden[:, 1:], axis=0)).mean(axis=0)
            above = PERIOD * np.count_nonzero(shakes > ALLOWED) / 2.0
            end = "" if ride.end == "finished" else f"  {ride.end}"
            row = f"{vehicle:14s} {circuit:16s} {above:14.2f} {shakes.max():10.3f} {steering:9.2f} {throttle:9.2f}{end}"
            print(row, flush=True)


if __name__ == "__main__":
    main()
