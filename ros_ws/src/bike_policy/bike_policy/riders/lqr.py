"""A linear-quadratic rider of bicycles with preview: the usual first design, and the baseline of a policy.

Model: the linearised bicycle of Meijaard et al. (2007) at the present speed with its steering drive, and rolling
without slip along the path. With e the lateral error of the rear contact, h the heading error, delta the steer, lambda
the tilt of the steering axis, c the trail and w the wheelbase,

    e' = v h,   h' = (v delta + c delta') cos(lambda) / w - v kappa,   (roll, steer)'' from the linear equations.

The curvature kappa of the path ahead, sampled at the control periods, is the preview: with it the optimal answer is
``u = -K x - sum_k G_k kappa_k`` (Sharp and Valtetsiotis 2001, Optimal preview car steering control, Vehicle System
Dynamics 35). The cost is on errors and on the torque of the drive, ``u - delta``, not on the set point itself, so that
a steady turn costs next to nothing and is ridden without an offset.

The bicycle itself is not linear: at 40 deg of lean it turns 15 % sharper than the linear model says, which is the
largest error of such a rider. So lean and steer enter the model as what they are worth in a steady turn of the ideal
bicycle (`bike_sim.physics.bicycle.steady_turn`): a lean counts as the curvature it holds, a steer as what it rides.

A command that acts late is known to the rider: the last answers are states of the model, one for each period of delay.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.linear import state_matrix
from bike_sim.physics.bicycle.steady_turn import steady_turns
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

SPEED_STEP: Final = 0.05
"""Gains are computed at multiples of this speed, m/s."""
SLOWEST: Final = 0.5
"""Below this speed the gains are those of this one, m/s."""


@dataclass(frozen=True)
class LqrSettings:
    """Weights of the cost, tuned on random training paths only.

    Attributes:
        lateral: of the squared lateral error, 1/m^2.
        heading: of the squared heading error, 1/rad^2.
        roll_rate: of the squared roll rate, s^2/rad^2.
        steer_rate: of the squared steer rate, s^2/rad^2.
        drive: of the squared difference of set point and steering angle, 1/rad^2.
        horizon: of the preview, s.
        delay: control periods by which a command acts late.
    """

    lateral: float = 1.0
    heading: float = 0.45
    roll_rate: float = 0.016
    steer_rate: float = 0.007
    drive: float = 0.03
    horizon: float = 3.0
    delay: int = 0


class Problem(NamedTuple):
    """The discrete control problem at one speed, with the delayed commands as further states.

    ``x' = a x + b u + curvature_effect kappa`` with the cost ``x Q x + 2 x cross u + control u^2`` a period.

    Attributes:
        a: shape (n, n), n = 6 + delay.
        b: shape (n,).
        curvature_effect: shape (n,).
        cost: Q, shape (n, n).
        cross: shape (n,).
        control: scalar weight.
    """

    a: FloatArray
    b: FloatArray
    curvature_effect: FloatArray
    cost: FloatArray
    cross: FloatArray
    control: float


class Gains(NamedTuple):
    """The optimal answer at one speed: ``u = -state @ x - preview @ kappa``.

    Attributes:
        state: of lateral error, heading error, roll, steer, roll rate, steer rate, and the delayed commands.
        preview: of the curvatures of the control periods ahead.
        to_go: P of the cost that is left from a state on, ``x P x`` where the path is straight.
        closed: transition of the states under the optimal answer.
    """

    state: FloatArray
    preview: FloatArray
    to_go: FloatArray
    closed: FloatArray


def lateral_model(vehicle: Vehicle, speed: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B and E of ``x' = A x + B u + E kappa`` with x = (e, h, roll, steer, roll rate, steer rate).

    Args:
        vehicle: bicycle with its steering drive.
        speed: m/s.
    """
    a, b, e = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    a[2:, 2:] = state_matrix(vehicle, speed)
    # The drive turns the fork as far from its set point as from zero: what P adds for steer it adds for -u.
    b[2:] = -(state_matrix(vehicle, speed)[:, 1] - state_matrix(replace(vehicle, P=0.0), speed)[:, 1])
    a[0, 1] = speed
    a[1, 3] = speed * math.cos(vehicle.lam) / vehicle.w
    a[1, 5] = vehicle.c * math.cos(vehicle.lam) / vehicle.w
    e[1] = -speed
    return a, b, e


def control_problem(vehicle: Vehicle, speed: float, period: float, settings: LqrSettings) -> Problem:
    """Return the discrete problem at a speed; command and curvature are held for a control period.

    Args:
        vehicle: bicycle.
        speed: m/s.
        period: control period, s.
        settings: weights and delay.
    """
    from scipy.linalg import expm  # late: other riders are spared it

    discrete = np.zeros((8, 8))
    discrete[:6, :6], discrete[:6, 6], discrete[:6, 7] = lateral_model(vehicle, speed)
    discrete = expm(discrete * period)
    delay, size = settings.delay, 6 + settings.delay
    a, b, curvature_effect = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    cost, cross, control = np.zeros((size, size)), np.zeros(size), 1e-6
    a[:6, :6], curvature_effect[:6] = discrete[:6, :6], discrete[:6, 7]
    weights = (settings.lateral, settings.heading, 0.0, settings.drive, settings.roll_rate, settings.steer_rate)
    np.fill_diagonal(cost[:6, :6], weights)
    # The drive's torque grows with acting command - steer; what acts is the oldest delayed command, or the new one.
    if delay:
        a[:6, 6], b[-1] = discrete[:6, 6], 1.0
        a[6 : size - 1, 7:] = np.eye(delay - 1)
        cost[6, 6] = settings.drive
        cost[3, 6] = cost[6, 3] = -settings.drive
    else:
        b[:6], control = discrete[:6, 6], control + settings.drive
        cross[3] = -settings.drive
    return Problem(a, b, curvature_effect, cost, cross, control)


def design(vehicle: Vehicle, speed: float, period: float, settings: LqrSettings) -> Gains:
    """Return the gains at a speed.

    Args:
        vehicle: bicycle.
        speed: m/s.
        period: control period, s.
        settings: weights.
    """
    from scipy.linalg import solve_discrete_are

    a, b, curvature_effect, cost, cross, control = control_problem(vehicle, speed, period, settings)
    p = solve_discrete_are(a, b[:, None], cost, np.array([[control]]), s=cross[:, None])
    inverse = 1.0 / (control + b @ p @ b)
    gain = inverse * (b @ p @ a + cross)
    closed = a - np.outer(b, gain)
    preview, weighted = [], p @ curvature_effect
    for _ in range(round(settings.horizon / period)):
        preview.append(inverse * float(b @ weighted))
        weighted = closed.T @ weighted
    return Gains(gain, np.array(preview), p, closed)


class Worth:
    """Worth of leans at one speed: a lean counts as the one that holds the same curvature in the linear model."""

    def __init__(self, vehicle: Vehicle, speed: float) -> None:
        """Compute the steady turns of a bicycle at a speed, m/s."""
        turns = steady_turns(vehicle, speed)
        tangent = -np.tan(turns.roll[1:])
        self._tangents = np.concatenate([[0.0], tangent])
        # The first turn of the family is the linear model: it leans by 2 deg at most.
        self._factors = np.ones(len(self._tangents))
        if len(tangent):
            self._factors[1:] = turns.curvature[1:] / tangent * (tangent[0] / turns.curvature[1])

    def of(self, roll: float) -> float:
        """Return the tangent of the lean that the linear model takes for a roll, rad."""
        tangent = math.tan(roll)
        return tangent * float(np.interp(abs(tangent), self._tangents, self._factors))


_Design = TypeVar("_Design")


class BicycleRider:
    """Part of `bike_policy.riders.base.Rider`: begins rides on bicycles, and keeps designs as long as they hold.

    Attributes:
        designs: by name and speed; riders of one bicycle may share them.
    """

    name: str
    preview: Preview | None = None

    def __init__(self) -> None:
        """Begin without designs."""
        self.designs: dict[tuple[str, int], Any] = {}
        self._machine: tuple[Vehicle, float] | None = None

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Take bicycle and line; see `Rider`.

        Raises:
            ValueError: a superbike, whose command is a lean and not a steering angle.
        """
        if isinstance(vehicle, Superbike):
            raise ValueError(f"rider {self.name!r} steers bicycles by set point, and {vehicle.name!r} is a superbike")
        if self._machine != (vehicle, period):
            self.designs.clear()
        self._machine = (vehicle, period)
        self._vehicle, self._course, self._period = vehicle, course, period

    def _nearest(self, design: Callable[[float], _Design], speed: float) -> _Design:
        """Return a design for the nearest multiple of SPEED_STEP, made once for a bicycle and control period."""
        step = round(max(speed, SLOWEST) / SPEED_STEP)
        key = design.__name__, step
        if key not in self.designs:
            self.designs[key] = design(step * SPEED_STEP)
        found: _Design = self.designs[key]
        return found


class LqrRider(BicycleRider):
    """Rides a bicycle along any line; implements `bike_policy.riders.base.Rider`."""

    name = "lqr"

    def __init__(self, settings: LqrSettings | None = None) -> None:
        """Take the weights."""
        self._settings = settings or LqrSettings()
        super().__init__()

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Take the line; nothing has been answered yet."""
        super().begin(vehicle, course, period, preview)
        self._sent: deque[float] = deque([0.0] * self._settings.delay, maxlen=self._settings.delay or 1)
        self._answered: tuple[int, float] | None = None

    def command(self, snapshot: Snapshot) -> tuple[float, float] | None:
        """Return the answer; the same again for a snapshot that is shown again."""
        if self._answered is not None and self._answered[0] == snapshot.step:
            return self._answered[1], 0.0
        look, state = snapshot.look, snapshot.state
        if not math.isfinite(look.sum() + state.sum()):
            return None
        steering = self.steering(look, state)
        self._answered = (snapshot.step, steering)
        return steering, 0.0

    def steering(self, look: FloatArray, state: st.StateVector) -> float:
        """Return the answer of a control period, a part of the largest set point, in [-1, 1].

        Args:
            look: derived quantities in the order of `bike_sim.sim.look`.
            state: the ten minimal coordinates.
        """
        turn = self.turn(look, state)
        self._sent.append(turn)
        level = math.cos(float(state[st.ROLL]))
        return min(max(math.atan(turn * level) / self._vehicle.max_steer, -1.0), 1.0)

    def turn(self, look: FloatArray, state: st.StateVector) -> float:
        """Return the optimal set value of the model; see `steering`."""
        gains = self._nearest(self._gains, look[lk.SPEED])
        ahead = self.ahead(look, len(gains.preview))
        return -float(gains.state @ self.deviations(look, state)) - float(gains.preview @ ahead)

    def deviations(self, look: FloatArray, state: st.StateVector) -> FloatArray:
        """Return the states of the model: errors, lean, steer and rates as the linear model takes them, late commands.

        Leaning, the machine turns as an upright one with a larger steering angle, and needs the tangent of the lean.
        See `steering`.
        """
        level = math.cos(float(state[st.ROLL]))
        now = [
            look[lk.LATERAL_ERROR],
            math.sin(look[lk.HEADING_ERROR]),
            self._nearest(self._worth, look[lk.SPEED]).of(float(state[st.ROLL])),
            math.tan(float(state[st.STEER])) / level,
            float(state[st.ROLL_RATE]) / level**2,
            float(state[st.STEER_RATE]) / level,
        ]
        return np.array([*now, *self._sent] if self._settings.delay else now)

    def ahead(self, look: FloatArray, count: int) -> FloatArray:
        """Return the curvature of the line in the middle of each of the next control periods, 1/m; see `steering`."""
        distance = look[lk.SPEED] * self._period * (np.arange(count) + 0.5)
        return self._curvature(look[lk.PROGRESS] + distance)

    def _worth(self, speed: float) -> Worth:
        """Return the worth of leans at a speed, m/s."""
        return Worth(self._vehicle, speed)

    def _gains(self, speed: float) -> Gains:
        """Return the gains at a speed, m/s."""
        return design(self._vehicle, speed, self._period, self._settings)

    def _curvature(self, s: FloatArray) -> FloatArray:
        """Return the curvature of the line at arc lengths (m); an open line is extended straight."""
        course = self._course
        if course.closed:
            return np.interp(s % course.length, course.s, course.curvature)
        return np.interp(s, course.s, course.curvature, right=0.0)
