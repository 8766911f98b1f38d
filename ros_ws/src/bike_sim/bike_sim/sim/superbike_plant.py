"""The superbike as a plant: a machine on tyres, steered by asking its virtual rider for a lean."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.projection import curvature_at, point_at
from bike_sim.physics import state as st
from bike_sim.physics.superbike import equilibrium
from bike_sim.physics.superbike import forces as sf
from bike_sim.physics.superbike.engine import SuperbikeEngine
from bike_sim.physics.superbike.statics import spread, turning_state
from bike_sim.planning.envelope import Envelope, envelope
from bike_sim.schema import SIGNALS
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import COURSE_POINTS, Preview, Start
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

ROLL_SPREAD: Final = 0.05
YAW_SPREAD: Final = 0.02
"""Half widths of a superbike's perturbed start, rad."""


class SuperbikePlant(Plant):
    """A superbike on tyres: steering asks the virtual rider for a lean, throttle for drive or brakes."""

    rolling = False
    preview: Preview | None = COURSE_POINTS
    signal_names = sf.TELEMETRY_NAMES

    vehicle: Superbike
    engine: SuperbikeEngine

    @cached_property
    def _spread(self) -> float:
        return spread(self.vehicle)

    @cached_property
    def _most_lean(self) -> float:
        return math.radians(self.vehicle.virtual_rider.max_lean_deg)

    @cached_property
    def envelope(self) -> Envelope:
        """The machine's limits."""
        return envelope(self.vehicle)

    def draw(self, rng: np.random.Generator, speed: float) -> Start:
        """Draw a small deviation of roll and yaw from the steady turn of the start; see `Plant`."""
        state = st.upright_state(speed, self.vehicle.rF)
        roll = float(rng.uniform(-ROLL_SPREAD, ROLL_SPREAD))
        return Start(state, speed, direction=-float(rng.uniform(-YAW_SPREAD, YAW_SPREAD)), roll=roll)

    def place(self, start: Start, line: Course, s: float) -> st.StateVector:
        """Place the machine on the line in the steady turn for its curvature and the speed; see `Plant`."""
        x, y, along, across = point_at(line.samples, s)
        bend = curvature_at(line.samples, s)
        speed = start.speed
        roll = -math.copysign(self._lean(abs(bend) * speed**2, speed, s), bend) + start.roll
        state = turning_state(self.vehicle, speed, roll, speed * bend)
        state[[st.X, st.Y, st.YAW]] = x, y, math.atan2(across, along) - start.direction
        return state

    def _lean(self, lateral: float, speed: float, s: float) -> float:
        """Return the lean at which a lateral acceleration is steady, rad."""
        if lateral == 0.0:
            return 0.0
        turn = lateral, self._most_lean, speed, self.vehicle.g, self._spread
        lean = float(equilibrium.steady_lean_one(*turn, self.engine.constants))
        if math.isnan(lean):
            raise ValueError(f"a start at {speed:.1f} m/s is too fast for the curve at {s:.0f} m of the followed line")
        return lean

    def steer_torque(self, steering: float, state: st.StateVector, signals: FloatArray) -> float:
        """Return the virtual rider's torque."""
        return float(signals[SIGNALS.index("steer_torque")])
