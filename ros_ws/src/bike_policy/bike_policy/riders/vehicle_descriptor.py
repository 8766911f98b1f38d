"""What a policy of many machines is told of the one that it rides."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.race import MACHINE_FACTS
from bike_sim.physics.superbike_statics import engine_force
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

DRIVE_SPEEDS: Final = (20.0, 40.0, 60.0, 80.0)
"""Speeds at which the engine's force is told, m/s."""
FEATURE_MEAN: Final = np.array([280.0, 1.45, 0.63, 0.70, 0.33, 1.2, 1.2, 0.8, 0.6])
"""About the middle of today's superbikes: kg, m, m, m, m^2, and forces by weight."""
FEATURE_SCALE: Final = np.array([20.0, 0.05, 0.05, 0.05, 0.03, 0.4, 0.2, 0.2, 0.15])
"""What counts as 1 beside it, in the same units; more is clipped with the rest of an observation."""


def vehicle_descriptor(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return what is told of a machine, scaled, in the order of `MACHINE_FACTS`.

    Mass with rider, wheelbase, height of the centre of mass and its distance from the rear contact, drag area, and the
    largest force of the engine by weight at DRIVE_SPEEDS.

    Raises:
        ValueError: a vehicle that is no superbike.
    """
    if not isinstance(vehicle, Superbike):
        raise ValueError(f"policies of races are told of superbikes, and {vehicle.name!r} is none")
    weight = vehicle.mass * vehicle.g
    drive = [engine_force(vehicle, speed) / weight for speed in DRIVE_SPEEDS]
    facts = np.array([vehicle.mass, vehicle.w, vehicle.com_height, vehicle.com_x, vehicle.air.drag_area, *drive])
    assert len(facts) == len(MACHINE_FACTS)
    return (facts - FEATURE_MEAN) / FEATURE_SCALE
