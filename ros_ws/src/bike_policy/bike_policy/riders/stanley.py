"""The Stanley law for bicycles: a cross-track law at the front axle, over a loop that balances.

The law steers a car by the heading error psi and by an angle that brings the axle back to the path,
``delta = psi - atan(k e / v)`` (Thrun et al. 2006, Stanley: the robot that won the DARPA grand challenge, Journal of
Field Robotics 23, Sect. 9.2). A car turns its wheel to that angle at once and is on the path after about a wheelbase. A
bicycle that did so would fall to the other side: it has to lean first, which takes most of a second. So here the angle
says which curvature is wanted beside the path's own,

    kappa = kappa_path + (psi - atan(k e / v)) / (v T),

with a time T in place of the car's wheelbase, and a linear-quadratic loop leans the bicycle as the steady turn of that
curvature asks, counter-steering on the way. There is no preview: the law sees the path at the front axle only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.lqr import SLOWEST, BicycleRider, lateral_model
from bike_sim.course.course import Course
from bike_sim.course.projection import curvature_at, point_at
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.steady_turn import SteadyTurns, steady_turns
from bike_sim.schema import GRAVITY
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

HANDS: Final = "hands"
"""Name of this rider in recordings."""
SHARE: Final = 0.55
"""Curvature of a whole manual command, by that of the sharpest turn of the loop."""
RATE: Final = 0.7
"""Largest change of the curvature by that of the sharpest turn, 1/s. With both, a whole command to one side after the
other, at any pace, throws nobody off from 2.5 to 6 m/s; without them it does at once, since the loop is linear."""

_BALANCE: Final = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)


@dataclass(frozen=True)
class StanleySettings:
    """Gains, tuned on random training paths only.

    Attributes:
        cross_track: k of the law, 1/s.
        time: T of the law, s.
        lean: weight of the squared error of the lean, 1/rad^2.
        steer_rate: weight of the squared steer rate, s^2/rad^2.
        drive: weight of the squared difference of set point and steering angle, 1/rad^2.
        steepest: lean up to which turns are asked for, rad.
    """

    cross_track: float = 0.7
    time: float = 1.0
    lean: float = 1.0
    steer_rate: float = 0.0003
    drive: float = 0.0005
    steepest: float = math.radians(40.0)


class Loop(NamedTuple):
    """The balance loop at one speed.

    Attributes:
        gains: of the differences in roll, steer and their rates.
        turns: what is balanced about.
        sharpest: largest curvature that is asked for, 1/m.
    """

    gains: FloatArray
    turns: SteadyTurns
    sharpest: float


class StanleyRider(BicycleRider):
    """Rides a bicycle along any line; implements `bike_policy.riders.base.Rider`."""

    name = "stanley"
    _settings = StanleySettings()

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the answer."""
        state = snapshot.state
        if not math.isfinite(snapshot.look.sum() + state.sum()):
            return None
        loop = self._nearest(self._loop, snapshot.speed)
        curvature = min(max(self.wanted(snapshot), -loop.sharpest), loop.sharpest)
        roll, steer, steer_set = (
            math.copysign(1.0, curvature) * float(np.interp(abs(curvature), loop.turns.curvature, values))
            for values in loop.turns[1:]
        )
        difference = state[list(_BALANCE)] - np.array([roll, steer, 0.0, 0.0])
        answer = steer_set - float(loop.gains @ difference)
        return min(max(answer / self._vehicle.max_steer, -1.0), 1.0), 0.0

    def wanted(self, snapshot: Snapshot) -> float:
        """Return the curvature that the law asks for, 1/m."""
        look, course = snapshot.look, self._course
        s = float(look[lk.FRONT_PROGRESS])
        *_, along, across = point_at(course.samples, s)
        path = curvature_at(course.samples, s)
        # In a steady turn the frame lags behind the path at the front axle by the turn of a wheelbase.
        yaw = float(snapshot.state[st.YAW]) + math.atan(self._vehicle.w * path)
        heading = math.remainder(math.atan2(across, along) - yaw, math.tau)
        speed = max(snapshot.speed, SLOWEST)
        back = math.atan(self._settings.cross_track * look[lk.FRONT_LATERAL_ERROR] / speed)
        return path + (heading - back) / (speed * self._settings.time)

    def _loop(self, speed: float) -> Loop:
        """Return the balance loop at a speed, m/s."""
        return balance(self._vehicle, speed, self._period, self._settings)


def balance(vehicle: Vehicle, speed: float, period: float, settings: StanleySettings) -> Loop:
    """Return the linear-quadratic loop that leans the bicycle.

    Args:
        vehicle: bicycle.
        speed: m/s.
        period: control period, s.
        settings: weights.
    """
    from scipy.linalg import expm, solve_discrete_are  # late: other riders are spared it

    a, b, _ = lateral_model(vehicle, speed)
    discrete = np.zeros((5, 5))
    discrete[:4, :4], discrete[:4, 4] = a[2:, 2:], b[2:]
    discrete = expm(discrete * period)
    a, b = discrete[:4, :4], discrete[:4, 4:]
    cost = np.diag([settings.lean, settings.drive, 0.0, settings.steer_rate])
    cross = np.array([[0.0], [-settings.drive], [0.0], [0.0]])
    control = np.array([[settings.drive + 1e-6]])
    p = solve_discrete_are(a, b, cost, control, s=cross)
    gains = (b.T @ p @ a + cross.T) / (control + b.T @ p @ b)
    turns = steady_turns(vehicle, speed)
    sharpest = float(np.interp(settings.steepest, -turns.roll, turns.curvature))
    return Loop(gains[0], turns, sharpest)


class ManualRider(StanleyRider):
    """Follows manual commands from keys, screen or gamepad; implements `bike_policy.riders.base.Rider`.

    A person cannot balance a bicycle by its steering angle at twenty commands a second through a screen. So the command
    is a lean: it becomes the curvature of the steady turn, and the balance loop of the Stanley rider leans the bicycle
    there, counter-steering on the way. Without balance the manual command is the set point of the steering angle
    itself. A superbike has a virtual rider that balances; its manual command goes through as it is.

    Attributes:
        steering: manual command in [-1, 1], positive to the left.
        throttle: manual command in [-1, 1].
        balances: whether a bicycle's manual command is a lean; else it is the set point of the steering angle.
    """

    name = HANDS
    races = True
    """A person sees the others."""
    steering = 0.0
    throttle = 0.0
    balances = True

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Take vehicle and line; see `Rider`."""
        self._direct = isinstance(vehicle, Superbike)
        self._leant: float | None = None
        self._most = RATE * period
        if not self._direct:
            super().begin(vehicle, course, period, preview)

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the answer."""
        if self._direct or not self.balances:
            return self.steering, self.throttle
        sharpest = self._nearest(self._loop, snapshot.speed).sharpest
        if self._leant is None:  # takes over a lean as it is
            now = -math.tan(float(snapshot.state[st.ROLL])) * GRAVITY / max(snapshot.speed, 1.0) ** 2
            self._leant = min(max(now / sharpest, -SHARE), SHARE)
        self._leant += min(max(SHARE * self.steering - self._leant, -self._most), self._most)
        return super().command(snapshot)

    def wanted(self, snapshot: Snapshot) -> float:
        """Return the curvature that is ridden towards the manual command, 1/m."""
        return (self._leant or 0.0) * self._nearest(self._loop, snapshot.speed).sharpest
