"""The plant: a vehicle with the engine that integrates it, behind one interface for bicycles and superbikes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.projection import point_at
from bike_sim.physics import state as st
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import make_bicycle_engine
from bike_sim.physics.ground import Ground
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import NO_CHANGES, Disturbances, RoadChanges
from bike_sim.sim.events import ENDS
from bike_sim.sim.request import Preview, Start, draw_start
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

if TYPE_CHECKING:
    from bike_sim.planning.envelope import Envelope

FloatArray = NDArray[np.float64]

_FORCES: Final = 0
"""Branch of the draws of disturbances."""


class Plant:
    """A vehicle with its engine; this one is a bicycle: steered by a set point, without drive, rolling without slip.

    Attributes:
        vehicle: its parameters.
        engine: that integrates it.
        rolling: whether it rolls without slip, so that its motion follows from the minimal state.
        preview: fixed preview of this kind of vehicle; None where a request chooses it.
        signal_names: names of the telemetry; empty where there is none.
        road: what differs of circuits' roads from the known ones.
    """

    rolling = True
    preview: Preview | None = None
    signal_names: tuple[str, ...] = ()
    road: RoadChanges = NO_CHANGES

    def __init__(self, vehicle: Vehicle, engine: Engine) -> None:
        """Take a vehicle and its engine."""
        self.vehicle = vehicle
        self.engine = engine

    @property
    def envelope(self) -> Envelope | None:
        """Largest accelerations of the vehicle, for ideal lines; None where only the path limits."""
        return None

    def draw(self, rng: np.random.Generator, speed: float) -> Start:
        """Draw all of a perturbed start (Table 3 of Weyrer et al. 2026) that does not depend on the course.

        Args:
            rng: draws.
            speed: m/s.
        """
        return draw_start(rng, speed, self.vehicle.rF)

    def place(self, start: Start, line: Course, s: float) -> st.StateVector:
        """Return the state of a start on a line, turned from its direction as far as was drawn.

        Args:
            start: as drawn.
            line: the line.
            s: arc length on it, m.

        Raises:
            ValueError: the vehicle cannot be there at this speed.
        """
        state = start.state.copy()
        if s == 0.0:
            x, y, heading = float(line.x[0]), float(line.y[0]), float(line.heading[0])
        else:
            x, y, along, across = point_at(line.samples, s)
            heading = math.atan2(across, along)
        state[[st.X, st.Y, st.YAW]] = x, y, heading - start.direction
        return state

    def reset(self, state: st.StateVector, ground: Ground) -> None:
        """Set a minimal state exactly; nothing of the earlier ride remains.

        Args:
            state: minimal state.
            ground: under the wheels; ignored where a bicycle rolls on a level plane.

        Raises:
            ValueError: no such configuration exists.
        """
        self.engine.reset(state, ground)

    def advance(self, steering: float, throttle: float, steps: int, ground: Ground) -> None:
        """Integrate with both commands in [-1, 1] held; a bicycle has no drive and ignores the throttle."""
        self.engine.advance(steering, throttle, steps, ground)

    def steer_torque(self, steering: float, state: st.StateVector, signals: FloatArray) -> float:
        """Return the torque on the fork, Nm, positive to the left: of the drive (Weyrer et al. 2026, Eq. 2)."""
        error = float(state[st.STEER]) - steering * self.vehicle.max_steer
        return -self.vehicle.P * error - self.vehicle.D * float(state[st.STEER_RATE])

    def fall(self) -> int:
        """Return how the vehicle has fallen, a code of `events.ENDS`."""
        return ENDS.index(self.engine.fall)


class DisturbedPlant(Plant):
    """A bicycle that wind and pushes act on, whose drive is weak, or whose parameters are not the known ones.

    Attributes:
        vehicle: as the rider knows it; the engine integrates the one that is ridden.
    """

    def __init__(self, vehicle: Vehicle, config: SimulatorConfig, disturbances: Disturbances) -> None:
        """Take a bicycle and start the engine of what is ridden in its place.

        Raises:
            ValueError: a parameter that cannot be wrong, or changes of a road, which only superbikes feel.
        """
        if disturbances.road != NO_CHANGES:
            raise ValueError(f"disturbances {disturbances.name!r} change a road, and {vehicle.name!r} is a bicycle")
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


def ridden_superbike(vehicle: Superbike, disturbances: Disturbances) -> Superbike:
    """Return the machine that is ridden in place of the one that the rider knows.

    Raises:
        ValueError: disturbances that only a bicycle can have, or a parameter that cannot be wrong.
    """
    if disturbances.pushes or math.isfinite(disturbances.drive_torque_nm):
        raise ValueError(
            f"disturbances {disturbances.name!r} push a bicycle or its steering drive, and {vehicle.name!r} is a "
            "superbike: its wind is the road's"
        )
    return disturbances.wrong(vehicle)
