"""How much margin the superbikes have: laps with other steering dampers and other gains of the virtual rider.

Both are estimates, so laps that only their exact values allow would prove nothing. Each machine rides an out-lap and a
flying lap with each change.

    python -m bench.rider_margin cremona
    python -m bench.rider_margin barcelona --vehicle r1
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import yaml
from tqdm import tqdm

from bike_sim.vehicles.files import SHIPPED
from bike_training.commands.lap import shipped_superbikes
from bike_training.rollout.laps import LapRide, ride_laps

GAINS: Final = ("lean_bandwidth", "rate_time", "torso_damping")
DAMPERS: Final = ("damper_slow", "damper_fast")
CHANGES: Final[Mapping[str, tuple[str, Sequence[str], float]]] = {
    "as shipped": ("steering", (), 1.0),
    "gains -20 %": ("virtual_rider", GAINS, 0.8),
    "gains +20 %": ("virtual_rider", GAINS, 1.2),
    "damper -20 %": ("steering", DAMPERS, 0.8),
    "damper -10 %": ("steering", DAMPERS, 0.9),
    "damper +10 %": ("steering", DAMPERS, 1.1),
    "damper +20 %": ("steering", DAMPERS, 1.2),
}
"""Section, keys in it and factor of each change."""


def changed(document: dict[str, Any], section: str, keys: Sequence[str], factor: float) -> dict[str, Any]:
    """Return the content of a vehicle file with some values of a section multiplied."""
    values = document[section]
    return {**document, section: {**values, **{key: factor * values[key] for key in keys}}}


def ride(vehicle: str, circuit: str, change: str, folder: Path) -> LapRide:
    """Ride an out-lap and a flying lap on a machine with a change."""
    document = yaml.safe_load((SHIPPED / f"{vehicle}.yaml").read_text(encoding="utf-8"))
    path = folder / f"{vehicle}.yaml"
    path.write_text(yaml.safe_dump(changed(document, *CHANGES[change])), encoding="utf-8")
    return ride_laps(str(path), circuit, laps=1)


def told(lap: LapRide) -> str:
    """Return a lap time, or how the ride ended."""
    return f"{lap.laps[0].duration:.2f} s" if lap.end == "finished" else lap.end


def main(arguments: Sequence[str] | None = None) -> None:
    """Ride and print a table."""
    parser = argparse.ArgumentParser(description="Laps with other dampers and gains.")
    parser.add_argument("circuit", help="shipped circuit")
    parser.add_argument("--vehicle", action="append", choices=shipped_superbikes(), help="machine (default: all)")
    args = parser.parse_args(arguments)
    chosen = args.vehicle or shipped_superbikes()
    print(f"{args.circuit:14s}" + "".join(f"{name:>16s}" for name in chosen))
    with tempfile.TemporaryDirectory() as folder, tqdm(total=len(CHANGES) * len(chosen), unit="ride") as bar:
        for change in CHANGES:
            cells = []
            for name in chosen:
                cells.append(told(ride(name, args.circuit, change, Path(folder))))
                bar.update()
            tqdm.write(f"{change:14s}" + "".join(f"{cell:>16s}" for cell in cells))


if __name__ == "__main__":
    main()
