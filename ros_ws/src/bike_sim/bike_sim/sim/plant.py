"""The plant: a vehicle with the engine that integrates it, behind one interface for bicycles and superbikes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.projection import point_at
from bike_sim.physics import state as st
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import make_bicycle_engine, make_superbike_engine
from bike_sim.physics.ground import Ground
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import ENDS
from bike_sim.sim.request import Preview, Start, draw_start
from bike_sim.sim.snapshot import NO_SIGNALS
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

if TYPE_CHECKING:
    from bike_sim.planning.envelope import Envelope

FloatArray = NDArray[np.float64]


class Plant:
    """A vehicle with its engine; this one is a bicycle: steered by a set point, without drive, rolling without slip.

    Attributes:
        vehicle: its parameters.
        engine: that integrates it.
        rolling: whether it rolls without slip, so that its motion follows from the minimal state.
        preview: fixed preview of this kind of vehicle; None where a request chooses it.
        signal_names: names of the telemetry; empty where there is none.
    """

    rolling = True
    preview: Preview | None = None
    signal_names: tuple[str, ...] = ()

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
            ground: under the wheels; ideal rolling knows level ground only.

        Raises:
            ValueError: no such configuration exists.
        """
        self.engine.reset(state)

    def advance(self, steering: float, throttle: float, steps: int, ground: Ground) -> None:
        """Integrate with both commands in [-1, 1] held; a bicycle has no drive and ignores the throttle."""
        self.engine.advance(steering, throttle, steps)

    def deflect(self, x: float, y: float, turn: float, share: float, dx: float, dy: float) -> None:
        """Refuse; every wall ends a bicycle's ride."""
        raise NotImplementedError("a bicycle that rolls without slip cannot be deflected")

    def state(self) -> st.StateVector:
        """Return the minimal state as a fresh vector."""
        return self.engine.state()

    def signals(self) -> FloatArray:
        """Return the telemetry of the last integration step as a fresh vector, in the order of `signal_names`."""
        return NO_SIGNALS

    def steer_torque(self, steering: float, state: st.StateVector, signals: FloatArray) -> float:
        """Return the torque on the fork, Nm, positive to the left: of the drive (Weyrer et al. 2026, Eq. 2)."""
        error = float(state[st.STEER]) - steering * self.vehicle.max_steer
        return -self.vehicle.P * error - self.vehicle.D * float(state[st.STEER_RATE])

    def fall(self) -> int:
        """Return how the vehicle has fallen, a code of `events.ENDS`."""
        return ENDS.index(self.engine.fall)

    def close(self) -> None:
        """Release the engine; a second call does nothing."""
        self.engine.close()


def make_plant(config: SimulatorConfig, vehicle: Vehicle | None = None) -> Plant:
    """Return a vehicle with its engine.

    Args:
        config: vehicle, engine and steps.
        vehicle: the config's vehicle where it is loaded already; None to load it.

    Raises:
        ValueError: an invalid parameter, or an engine that cannot simulate the vehicle.
        FileNotFoundError: an unknown vehicle.
    """
    vehicle = vehicle or load_vehicle(config.vehicle)
    if isinstance(vehicle, Superbike):
        # Late: a bicycle is spared tyres and lap theory, which take a good part of a node's start.
        from bike_sim.sim.superbike_plant import SuperbikePlant

        return SuperbikePlant(vehicle, make_superbike_engine(config.engine, vehicle, config.time_step))
    return Plant(vehicle, make_bicycle_engine(config.engine, vehicle, config.time_step))
