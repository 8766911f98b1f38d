"""A classical rider: laps a line by path preview and state feedback. No learning, no tuning per machine or circuit.

Lean. The virtual rider's reference model turns a lean command into lean as a second-order system of frequency w,
critically damped. So the lateral acceleration that the line will require shortly (when steering has reached the lean)
is fed forward through the inverse of that system, ``a + 2/w a' + a''/w^2``, and the remaining lateral error e, its
rate and the error of lateral acceleration d is fed back with all four poles at -p:

    u = -(k0 e + k1 e' + k2 d + k3 d'),   (s + p)^4 = s^4 + (2w + w^2 k3) s^3 + w^2 (1 + k2) s^2 + w^2 k1 s + w^2 k0

With p = w/2, k3 is zero and d' is not needed; `RiderSettings.bandwidth` is close to that. Preview in place of this
inverse is how Sharp et al. (2004), Advances in the modelling of motorcycle dynamics, Multibody System Dynamics 12,
steer; the rest is textbook pole placement.

Speed. The theoretical lap of the machine with some of its limits kept in reserve is the speed profile; its acceleration
is fed forward through engine and brakes, and the error of speed fed back. Where a verification of it on the compiled
engine ends in a fall, the profile is slower (`bike_policy.planning.plan_verification`).

Time. A command is held for a control period and so acts half of it late; both previews look that much farther ahead.
The virtual rider's arms are late too: what is fed back is what e, e' and d will be when they have answered, at the
present roll rate.
The rate of e is the difference of two states. It is also late, and at full drive, with a light front wheel, a late one
feeds the weave (5 Hz). So when the state before is old, e' is an estimate that follows the difference slowly and e'',
which is d, at once.

The law itself is compiled, in `bike_policy.planning.line_law`.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, LinePlan, RiderSettings, plan_line
from bike_policy.planning.line_law import LineLaw
from bike_policy.planning.plan_verification import verified_plan
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.planning.lap_limit import LapLimit
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

CLASSICAL: Final = "classical"
"""Name of this rider."""


class Seen(NamedTuple):
    """Inputs of the rider at one control instant, in the order of `bike_policy.planning.line_law`.

    Attributes:
        speed: m/s. roll: rad, positive to the right.
        progress: arc length of the line, m, of any lap.
        lateral_error: m, positive left of the line. heading_error: rad, positive to the left.
        roll_rate: rad/s, positive to the right.
    """

    speed: float
    roll: float
    progress: float
    lateral_error: float
    heading_error: float
    roll_rate: float = 0.0


class LineController:
    """Steers and drives one machine along one closed line.

    Attributes:
        plan: the line with the speed profile that is followed, the machine's theoretical lap with its reserve.
        law: that answers.
    """

    def __init__(
        self,
        vehicle: Superbike,
        line: Course,
        control_period: float,
        settings: RiderSettings | None = None,
        plan: LinePlan | None = None,
    ) -> None:
        """Plan the lap.

        Args:
            vehicle: the machine.
            line: closed line to follow.
            control_period: s.
            settings: how to ride.
            plan: of the line; None for the one that follows from the settings.

        Raises:
            ValueError: the line is open.
        """
        settings = settings or CLASSICAL_SETTINGS
        self.plan = plan or plan_line(vehicle, line, settings)
        self.law = LineLaw(vehicle, control_period, settings)
        self.reset()

    @property
    def profile(self) -> LapLimit:
        """The speed profile that is followed."""
        return self.plan.profile

    def reset(self) -> None:
        """Forget the ride before."""
        self.law.begin(0, self.plan)

    def command(self, seen: Seen) -> tuple[float, float]:
        """Return steering and throttle in [-1, 1]; the same ones again for a repeated state."""
        steering, throttle = self.law.commands(np.array([seen]))[0].tolist()
        return steering, throttle


class ClassicalRider:
    """The classical rider of superbikes; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        controller: of the present ride, or None before the first.
    """

    name = CLASSICAL
    preview: Preview | None = None

    def __init__(self, settings: RiderSettings | None = None) -> None:
        """Take the settings of the rider."""
        self._settings = settings or CLASSICAL_SETTINGS
        self._ride: tuple[Vehicle, Course, float] | None = None
        self.controller: LineController | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Plan the lap and verify it, a matter of seconds; a repeated ride keeps the plan.

        Raises:
            ValueError: a vehicle that is no superbike, or an open line.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"the classical rider rides superbikes, and {vehicle.name!r} is none")
        same = self._ride is not None and self._ride[0] is vehicle and self._ride[1] is course
        if self.controller is not None and same and self._ride is not None and self._ride[2] == period:
            self.controller.reset()
            return
        plan = verified_plan(vehicle, course, self._settings, period)
        self.controller = LineController(vehicle, course, period, self._settings, plan)
        self._ride = (vehicle, course, period)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the answer to a snapshot; None where it is not finite."""
        assert self.controller is not None, "begin comes first"
        look = snapshot.look
        seen = Seen(
            float(look[lk.SPEED]),
            float(snapshot.state[st.ROLL]),
            float(look[lk.PROGRESS]),
            float(look[lk.LATERAL_ERROR]),
            float(look[lk.HEADING_ERROR]),
            float(snapshot.state[st.ROLL_RATE]),
        )
        return self.controller.command(seen) if all(map(math.isfinite, seen)) else None
