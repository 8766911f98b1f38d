"""What each effect of the theoretical lap is worth: `python -m bench.lap_theory [CIRCUIT ...]`.

Prints the theoretical lap of a machine on its fastest line (0.5 m from the limits), and how it changes on the same line
without the answer of the electronics to the roll rate, without a limit of the lean rate, without both, and besides with
the mass on the path of the contacts.
"""

from __future__ import annotations

import argparse

from bike_sim.course.files import shipped_tracks
from bike_sim.course.racing_line import MARGIN
from bike_sim.planning.envelope import envelope
from bike_sim.planning.lap_limit import lap_limit
from bike_sim.planning.line_cache import track_with_line
from bike_sim.planning.minimum_time import ROLL_COST
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

CHANGES = {
    "rolling": ("rolling",),
    "lean rate": ("lean rate",),
    "both": ("rolling", "lean rate"),
    "and mass": ("rolling", "lean rate", "mass"),
}
"""Effects that are left out, by the heading of the column."""


def main() -> None:
    """Print a row for each circuit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("circuits", nargs="*", default=list(shipped_tracks()))
    parser.add_argument("--vehicle", default="panigale_v4r")
    args = parser.parse_args()
    machine = load_vehicle(args.vehicle)
    assert isinstance(machine, Superbike)
    limits = envelope(machine)
    print(f"{machine.name:16s} {'lap, s':>8s} " + " ".join(f"{heading:>10s}" for heading in CHANGES))
    for circuit in args.circuits:
        line = track_with_line(circuit, limits, MARGIN, ROLL_COST).line(1.0)
        whole = lap_limit(limits, line).lap_time
        changes = []
        for effects in CHANGES.values():
            bare = limits
            for effect in effects:
                bare = bare.without(effect)
            changes.append(lap_limit(bare, line).lap_time - whole)
        print(f"{circuit:16s} {whole:8.2f} " + " ".join(f"{change:+10.2f}" for change in changes))


if __name__ == "__main__":
    main()
