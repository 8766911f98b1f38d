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
is fed forward through engine and brakes, and the error of speed fed back.

Time. A command is held for a control period and so acts half of it late; both previews look that much farther ahead.
The virtual rider's arms are late too: what is fed back is what e, e' and d will be when they have answered, at the
present roll rate.
The rate of e is the difference of two states. It is also late, and at full drive, with a light front wheel, a late one
feeds the weave (5 Hz). So when the state before is old, e' is an estimate that follows the difference slowly and e'',
which is d, at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.lap_plan import RiderSettings, SteadyLeans, plan_lap, smooth_around
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.physics.superbike_statics import engine_force, inertial_mass
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.theory.lap_limit import LapLimit
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

CLASSICAL: Final = "classical"
"""Name of this rider."""

LONGEST_GAP = 0.3
"""Time without states after which the last one is not used for the lateral error's rate, s."""


@dataclass(frozen=True)
class Seen:
    """Inputs of the rider at one control instant.

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
        settings: how it rides.
        leans: leans of the machine's steady turns.
        profile: the speed profile it follows, the machine's theoretical lap with its reserve.
    """

    def __init__(
        self,
        vehicle: Superbike,
        line: Course,
        control_period: float,
        settings: RiderSettings | None = None,
    ) -> None:
        """Plan the lap.

        Args:
            vehicle: the machine.
            line: closed line to follow.
            control_period: s.
            settings: how to ride.

        Raises:
            ValueError: the line is open.
        """
        self.settings = settings or RiderSettings()
        self._period = control_period
        self._length = line.length
        self._frequency = vehicle.virtual_rider.frequency
        late = 0.5 * (control_period - self.settings.period)
        self._arms = 2.0 / vehicle.virtual_rider.arm_frequency
        self._preview, self._speed_preview = (
            self.settings.preview + self._arms + late,
            self.settings.speed_preview + late,
        )
        self._max_lean = math.radians(vehicle.virtual_rider.max_lean_deg)
        self.leans = SteadyLeans(vehicle)
        self.profile: LapLimit = plan_lap(vehicle, line, self.settings)
        self._s = self.profile.s
        self._curvature = smooth_around(
            self.profile.lateral / self.profile.speed**2, float(self._s[1]), self.settings.smoothing
        )
        self._grade, self._crest = (np.interp(self._s, line.s, column) for column in (line.grade, line.crest))
        self._machine(vehicle)
        self._before: Seen | None = None
        self._rate = self._excess = 0.0
        self._answer = (0.0, 0.0)

    def _machine(self, vehicle: Superbike) -> None:
        """Keep what turns accelerations into throttle and brake."""
        self._mass = inertial_mass(vehicle)
        self._drag = 0.5 * vehicle.air.density * vehicle.air.drag_area
        self._gravity, self._weight = vehicle.g, vehicle.mass * vehicle.g
        self._rolling = vehicle.rear_tyre.rolling * self._weight
        self._above = vehicle.frame.height - vehicle.rear_tyre.crown
        self._engine_brake = vehicle.motor.engine_brake
        self._brake_force = vehicle.brakes.force
        self._engine_force = np.array([engine_force(vehicle, float(speed)) for speed in self.leans.speeds])

    def reset(self) -> None:
        """Forget the ride before."""
        self._before = None

    def command(self, seen: Seen) -> tuple[float, float]:
        """Return steering and throttle in [-1, 1]; the same ones again for a repeated state."""
        if seen != self._before:
            self._answer = (self._steer(seen), self._throttle(seen))
            self._before = seen
        return self._answer

    # ------------------------------------------------------------------------------------------------------------ lean

    def _at(self, column: FloatArray, s: float) -> float:
        return float(np.interp(s % self._length, self._s, column))

    def _wanted(self, seen: Seen, ahead: float) -> float:
        """Return the lateral acceleration that the line requires after a time, m/s^2."""
        here = self._at(self.profile.speed, seen.progress)
        s = seen.progress + seen.speed * ahead
        speed = max(1.0, seen.speed + self._at(self.profile.speed, s) - here)
        return self._at(self._curvature, s) * speed**2

    def _load(self, seen: Seen, ahead: float) -> float:
        """Return the load after a time by that on level ground: less over a crest, more in a dip."""
        s = seen.progress + seen.speed * ahead
        return max(0.3, 1.0 + self._at(self._crest, s) * seen.speed**2 / self._gravity)

    def _error_rate(self, seen: Seen) -> float:
        """Return the rate of the lateral error, m/s: measured, or of the heading at the first step.

        The heading alone is a poor measure: it knows nothing of the side slip.
        """
        before = self._before
        longest = max(LONGEST_GAP, 4.0 * self._period)
        if before is None or abs(seen.progress - before.progress) > longest * seen.speed + 1.0:
            return seen.speed * math.sin(seen.heading_error)
        # States in between may have been lost: the distance shows how many periods ago the previous one was.
        periods = round((seen.progress - before.progress) / (max(1.0, seen.speed) * self._period))
        elapsed = self._period * max(1, periods)
        measured = (seen.lateral_error - before.lateral_error) / elapsed
        if elapsed <= self.settings.period:
            return measured
        predicted = self._rate + elapsed * self._excess
        return measured + math.exp(-elapsed / self.settings.rate_memory) * (predicted - measured)

    def _steer(self, seen: Seen) -> float:
        settings, w = self.settings, self._frequency
        h, middle = settings.stencil, self._preview
        early, now, late = (self._wanted(seen, middle + k * h) for k in (-1.0, 0.0, 1.0))
        ahead = now + (late - early) / (h * w) + (late - 2.0 * now + early) / (h * w) ** 2
        row = self.leans.row(seen.speed)
        p = settings.bandwidth * w
        error, rate, excess = self._expected(seen, row)
        error = min(max(error, -settings.lateral_trust), settings.lateral_trust)
        rate = min(max(rate, -3.0 * settings.lateral_trust), 3.0 * settings.lateral_trust)
        back = -(p**4 * error + 4.0 * p**3 * rate) / w**2 - (6.0 * p**2 / w**2 - 1.0) * excess
        lateral = (ahead + back) / self._load(seen, middle)
        lean = min(float(np.interp(abs(lateral), row, self.leans.leans)), settings.largest_lean)
        return min(max(math.copysign(lean, lateral) / self._max_lean, -1.0), 1.0)

    def _turning(self, seen: Seen, row: FloatArray, ahead: float) -> float:
        """Return the lateral acceleration in excess of the line's after a time at the present roll rate, m/s^2."""
        roll = seen.roll + ahead * seen.roll_rate
        held = self._load(seen, ahead) * float(np.interp(abs(roll), self.leans.leans, row))
        return -math.copysign(held, roll) - self._wanted(seen, ahead)

    def _expected(self, seen: Seen, row: FloatArray) -> tuple[float, float, float]:
        """Return lateral error, its rate and the excess of lateral acceleration when the arms will have answered."""
        excess, late = self._turning(seen, row, 0.0), self._arms
        self._rate, self._excess = self._error_rate(seen), excess
        then = self._turning(seen, row, late)
        rate = self._rate + 0.5 * late * (excess + then)
        return seen.lateral_error + late * self._rate + late**2 * (excess / 3.0 + then / 6.0), rate, then

    # ----------------------------------------------------------------------------------------------------------- speed

    def rolled(self, seen: Seen) -> float:
        """Return the speed of the contacts, m/s: the frame leans inwards and is slower on a tight line."""
        inside = -self._above * math.sin(seen.roll)
        return seen.speed / max(0.5, 1.0 - self._at(self._curvature, seen.progress) * inside)

    def _throttle(self, seen: Seen) -> float:
        settings = self.settings
        s = seen.progress + seen.speed * self._speed_preview
        wanted = self._at(self.profile.speed, seen.progress)
        acceleration = self._at(self.profile.longitudinal, s) + settings.speed_gain * (wanted - self.rolled(seen))
        hill = self._weight * self._at(self._grade, s)
        force = self._mass * acceleration + self._drag * seen.speed**2 + self._rolling + hill
        if force >= 0.0:
            most = float(np.interp(seen.speed, self.leans.speeds, self._engine_force))
            # A closed throttle drags by the engine's brake, which fades as the throttle opens.
            return min(1.0, (force + self._engine_brake) / max(most + self._engine_brake, 1.0))
        return -min(1.0, max(0.0, (-force - self._engine_brake) / self._brake_force))


class ClassicalRider:
    """The classical rider of superbikes; implements `bike_policy.riders.rider.Rider`.

    Attributes:
        controller: of the present ride, or None before the first.
    """

    name = CLASSICAL
    preview: Preview | None = None

    def __init__(self, settings: RiderSettings | None = None) -> None:
        """Take the settings of the rider."""
        self._settings = settings
        self._ride: tuple[Vehicle, Course, float] | None = None
        self.controller: LineController | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Plan the lap; a repeated ride keeps the plan.

        Raises:
            ValueError: a vehicle that is no superbike, or an open line.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"the classical rider rides superbikes, and {vehicle.name!r} is none")
        same = self._ride is not None and self._ride[0] is vehicle and self._ride[1] is course
        if self.controller is not None and same and self._ride is not None and self._ride[2] == period:
            self.controller.reset()
            return
        self.controller = LineController(vehicle, course, period, self._settings)
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
        values = (
            seen.speed, seen.roll, seen.progress, seen.lateral_error, seen.heading_error, seen.roll_rate,
        )  # fmt: skip
        return self.controller.command(seen) if all(map(math.isfinite, values)) else None
