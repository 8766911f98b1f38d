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

from typing import Final

import numpy as np

from bike_policy.contract.observation import rows_of
from bike_policy.planning.grip import AdaptiveLaw, GripMemory
from bike_policy.planning.lap_plan import CAREFUL_SETTINGS, CLASSICAL_SETTINGS, LinePlan, RiderSettings
from bike_policy.planning.line_law import seen_of
from bike_policy.planning.racecraft import Racecraft
from bike_sim.course.course import Course
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

CLASSICAL: Final = "classical"
"""Name of this rider."""
CAREFUL: Final = "careful"
"""Name of the same rider where it keeps grip in reserve on road that it has not ridden yet."""
SETTINGS: Final = {CLASSICAL: CLASSICAL_SETTINGS, CAREFUL: CAREFUL_SETTINGS}
"""Settings of both."""


class ClassicalRider:
    """The classical rider of superbikes; implements `bike_policy.riders.base.Rider`.

    Where its snapshots show others, it races them by rule (`bike_policy.planning.racecraft`).

    Attributes:
        plan: of the present ride, the machine's theoretical lap with its reserve; None before the first.
    """

    name = CLASSICAL
    preview: Preview | None = None
    races = True
    """It sees others."""

    def __init__(self, settings: RiderSettings | None = None) -> None:
        """Take the settings of the rider."""
        self._settings = settings or CLASSICAL_SETTINGS
        self._ride: tuple[Vehicle, Course, float] | None = None
        self.plan: LinePlan | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Plan the lap and verify it, a matter of seconds; a repeated ride keeps the plan.

        Raises:
            ValueError: a vehicle that is no superbike, or an open line.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"the classical rider rides superbikes, and {vehicle.name!r} is none")
        known, self._period = self._ride, period
        if known is None or known[0] is not vehicle or known[1] is not course or known[2] != period:
            self._law = AdaptiveLaw(vehicle, period, self._settings)
            plans = self._law.plans(course)
            plans.solve()
            self.plan = plans.on(1.0)
            self._ride = (vehicle, course, period)
        self._law.begin(0, None, course)
        self._craft: Racecraft | None = None

    @property
    def grip_memory(self) -> GripMemory | None:
        """What is known of the grip; None before the first ride."""
        return None if self._ride is None else self._law.memory

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the law's command; None where the snapshot is not finite."""
        if not np.isfinite(seen_of(snapshot.state[None], snapshot.look[None])).all():
            return None
        rows, targets = rows_of(snapshot), None
        if snapshot.opponents is not None:
            if self._craft is None:
                self._craft = Racecraft(self._law.law, 1)
                self._craft.begin(0, rows)
            targets = self._craft.targets(rows, self._period)
        steering, throttle = self._law.commands(rows, targets=targets)[0].tolist()
        return steering, throttle


class CarefulRider(ClassicalRider):
    """The same, for a road that nobody tells of."""

    name = CAREFUL

    def __init__(self) -> None:
        """Take the settings of the rider."""
        super().__init__(CAREFUL_SETTINGS)
