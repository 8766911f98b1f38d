"""A bicycle that wind and pushes act on, whose drive is weak, or whose parameters are not the known ones."""

from __future__ import annotations

import math
from typing import Final

from bike_sim.physics import state as st
from bike_sim.physics.engines import make_bicycle_engine
from bike_sim.physics.ground import Ground
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.plant import Plant, make_plant
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

_FORCES: Final = 0
"""Branch of the draws."""


class DisturbedPlant(Plant):
    """A disturbed bicycle; see `bike_sim.sim.plant.Plant`.

    Attributes:
        vehicle: as the rider knows it; the engine integrates the one that is ridden.
    """

    def __init__(self, vehicle: Vehicle, config: SimulatorConfig, disturbances: Disturbances) -> None:
        """Take a bicycle and start the engine of what is ridden in its place.

        Raises:
            ValueError: a parameter that cannot be wrong.
        """
        self._ridden = make_bicycle_engine(config.engine, disturbances.wrong(vehicle), config.time_step)
        super().__init__(vehicle, self._ridden)
        self._disturbances = disturbances
        self._time_step = config.time_step

    def reset(self, state: st.StateVector, ground: Ground) -> None:
        """Set a state and begin the draws of a ride."""
        super().reset(state, ground)
        self._draws = self._disturbances.generator(state, _FORCES)
        self._gust = self._disturbances.wind.gust_n * float(self._draws.standard_normal())
        self._steps = 0
        self._impulse, self._side = 0, 1.0

    def advance(self, steering: float, throttle: float, steps: int, ground: Ground) -> None:
        """Hold the set point, step by step where something acts; the gust is held for the control period."""
        wanted, known = steering * self.vehicle.max_steer, self._disturbances
        if not known.pushes and math.isinf(known.drive_torque_nm):
            self._ridden.hold(wanted, steps)
            return
        self._blow(steps * self._time_step)
        for _ in range(steps):
            state = self.engine.state()
            self._push(state)
            self._ridden.hold(self._reached(wanted, state), 1)
            self._steps += 1

    def _blow(self, period: float) -> None:
        """Change the gust: a first-order process whose standard deviation stays what it is."""
        wind = self._disturbances.wind
        kept = math.exp(-period / wind.gust_s)
        drawn = wind.gust_n * float(self._draws.standard_normal())
        self._gust = kept * self._gust + math.sqrt(1.0 - kept * kept) * drawn

    def _push(self, state: st.StateVector) -> None:
        """Apply wind and impulses to the engine's next step."""
        wind, impulses = self._disturbances.wind, self._disturbances.impulses
        force = wind.force_n + self._gust
        if force:
            angle = math.radians(wind.direction_deg) - float(state[st.YAW])
            self._ridden.push(force * math.cos(angle), force * math.sin(angle), wind.ahead_m, wind.height_m)
        if not impulses.impulse_ns:
            return
        count, since = divmod(self._steps * self._time_step + 1e-9, impulses.every_s)
        if count < 1.0 or since > impulses.lasting_s:
            return
        if count != self._impulse:
            self._impulse, self._side = int(count), float(self._draws.choice([-1.0, 1.0]))
        push = self._side * impulses.impulse_ns / impulses.lasting_s
        self._ridden.push(0.0, push, impulses.ahead_m, impulses.height_m)

    def _reached(self, wanted: float, state: st.StateVector) -> float:
        """Return the set point that a drive of limited torque acts as if it had been given."""
        limit, vehicle = self._disturbances.drive_torque_nm, self.engine.vehicle
        if math.isinf(limit):
            return wanted
        # The drive's torque is -P (steer - set) - D rate.
        rest = float(state[st.STEER]) + vehicle.D / vehicle.P * float(state[st.STEER_RATE])
        return min(max(wanted, rest - limit / vehicle.P), rest + limit / vehicle.P)


def make_disturbed_plant(
    config: SimulatorConfig, disturbances: Disturbances | None, vehicle: Vehicle | None = None
) -> Plant:
    """Return a vehicle with its engine, disturbed where anything acts on it.

    Args:
        config: vehicle, engine and steps.
        disturbances: of what is ridden.
        vehicle: the config's where it is loaded already; None to load it.

    Raises:
        ValueError: an invalid parameter, or a superbike: these disturbances are for bicycles.
        FileNotFoundError: an unknown vehicle.
    """
    if disturbances is None or not disturbances.acts_on_bicycle:
        return make_plant(config, vehicle)
    vehicle = vehicle or load_vehicle(config.vehicle)
    if isinstance(vehicle, Superbike):
        raise ValueError(f"disturbances {disturbances.name!r} act on bicycles, and {vehicle.name!r} is a superbike")
    return DisturbedPlant(vehicle, config, disturbances)
