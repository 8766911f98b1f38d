"""Kinds of vehicle in the simulator: which plant each is, and which slot steps it."""

from __future__ import annotations

from collections.abc import Sequence

from bike_sim.physics.engines import make_bicycle_engine, make_superbike_engine
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import NO_CHANGES, Disturbances
from bike_sim.sim.plant import DisturbedPlant, Plant, ridden_superbike
from bike_sim.sim.slots import BicycleSlot, EngineSlot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike


def make_plant(
    config: SimulatorConfig, disturbances: Disturbances | None = None, vehicle: Vehicle | None = None
) -> Plant:
    """Return a vehicle with its engine, disturbed where anything acts on it.

    Args:
        config: vehicle, engine and steps.
        disturbances: of what is ridden.
        vehicle: the config's vehicle where it is loaded already; None to load it.

    Raises:
        ValueError: an invalid parameter, an engine that cannot simulate the vehicle, or a bicycle's disturbances.
        FileNotFoundError: an unknown vehicle.
    """
    vehicle = vehicle or load_vehicle(config.vehicle)
    if disturbances is not None and not disturbances.acts_on_vehicle:
        disturbances = None
    if isinstance(vehicle, Superbike):
        ridden = vehicle if disturbances is None else ridden_superbike(vehicle, disturbances)
        # Late: a bicycle is spared tyres and lap theory, which take a good part of a node's start.
        from bike_sim.sim.superbike_plant import SuperbikePlant

        plant = SuperbikePlant(vehicle, make_superbike_engine(config.engine, ridden, config.time_step))
        plant.road = NO_CHANGES if disturbances is None else disturbances.road
        return plant
    if disturbances is not None:
        return DisturbedPlant(vehicle, config, disturbances)
    return Plant(vehicle, make_bicycle_engine(config.engine, vehicle, config.time_step))


def make_slot(plants: Sequence[Plant], config: SimulatorConfig, disturbed: bool) -> EngineSlot:
    """Return the slot of an engine for the plants of all rows, of which the compiled ones need one a vehicle."""
    if config.engine == "whipple" and not disturbed:
        return BicycleSlot(plants, config)
    if config.engine == "compiled":
        # Late: a bicycle is spared tyres.
        from bike_sim.sim.superbike_slot import SuperbikeSlot

        return SuperbikeSlot(plants, config)
    return EngineSlot(plants, config)
