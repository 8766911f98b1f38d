"""How the shipped superbikes differ, from their files in closed form: `python -m bench.machines`."""

from __future__ import annotations

import numpy as np

from bike_sim.planning.envelope import envelope
from bike_sim.validation.superbike import MACHINES
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

COLUMNS = ("machine", "W/kg", "wheelie g", "stoppie g", "20-75 s", "75-20 s", "lateral g", "gears m/s", "yaw kg m2")


def row(vehicle: Superbike) -> tuple[str, ...]:
    """Return the cells of a machine with its rider.

    Wheelie and stoppie: acceleration at which a wheel lifts, without air and electronics. Times: full drive and full
    brake of the envelope, with them. Lateral: held at a constant 30 m/s. Gears: road speeds at the limiter, first and
    last. Yaw: inertia of frame and rider.
    """
    x, height = vehicle.centre_of_mass
    limits, speeds = envelope(vehicle), np.linspace(20.0, 75.0, 200)
    gears, sides = vehicle.gear_speeds, np.linspace(0.0, float(limits.lateral(30.0)), 2001)
    return (
        vehicle.name,
        f"{vehicle.motor.peak_power / vehicle.mass:.0f}",
        f"{x / height:.3f}",
        f"{(vehicle.w - x) / height:.3f}",
        f"{np.trapezoid(1.0 / limits.drive(speeds), speeds):.2f}",
        f"{np.trapezoid(1.0 / limits.brake(speeds), speeds):.2f}",
        f"{sides[limits.drive(30.0, sides) >= 0.0].max() / vehicle.g:.3f}",
        f"{gears[0]:.1f} to {gears[-1]:.1f}",
        f"{vehicle.IBzz:.1f}",
    )


def main() -> None:
    """Print the table."""
    print("| " + " | ".join(COLUMNS) + " |")
    print("|" + "---|" * len(COLUMNS))
    for name in MACHINES:
        vehicle = load_vehicle(name)
        assert isinstance(vehicle, Superbike)
        print("| " + " | ".join(row(vehicle)) + " |")


if __name__ == "__main__":
    main()
