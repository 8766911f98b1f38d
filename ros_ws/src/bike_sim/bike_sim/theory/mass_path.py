"""The path of the mass of a machine whose contacts follow a line, and the lean that it needs for that.

The machine is a pendulum upside down on the line of its contacts. To stay on a line whose lateral acceleration at the
contacts is ``a_c`` it needs a lean that solves

    A(lean) - L / cos(lean) d2(lean)/dt2 = a_c

with the lateral acceleration A of the steady turn at this lean and the length L of the pendulum. The bounded solution
looks ahead: the machine must begin to roll before the curve begins, by some sqrt(L / g) = 0.27 s, and what the line
asks within shorter times hardly moves the mass. The mass is inside of the contacts by some 0.5 m in a curve; its path
is that much shorter and tighter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.theory.envelope import Envelope, Limits, lateral_by_lean

FloatArray = NDArray[np.float64]

GRAVITY = 9.81
_LARGEST_LEAN = math.radians(80.0)
_LEANS = 81
_NEWTON = 4
_LEAST_LOAD = 0.1
_SMALL = 0.01
_RENEWED = 0.6


class MassPath(NamedTuple):
    """What the mass does while the contacts follow a line; values at its points, none repeated.

    Attributes:
        bend: lateral acceleration of the mass by its squared speed, 1/m, positive to the left.
        distance: of the mass from this point to the next, m.
        stretch: speed of the mass by that of the contacts.
        slope: rise of the mass (its energy of rolling included) by its distance, the road's slope included.
        lean: rad, positive to the left.
        roll_rate: rad/s.
    """

    bend: FloatArray
    distance: FloatArray
    stretch: FloatArray
    slope: FloatArray
    lean: FloatArray
    roll_rate: FloatArray


@dataclass(frozen=True)
class LeanModel:
    """A machine as a pendulum.

    Attributes:
        lateral: steady lateral acceleration (m/s^2) over speed and lean (0 to 80 deg in equal steps).
        speeds: m/s, in equal steps.
        envelope: the machine's.
    """

    lateral: FloatArray
    speeds: FloatArray
    envelope: Envelope

    def follow(
        self, bend: FloatArray, speed: FloatArray, step: float, slope: FloatArray, dip: FloatArray, before: MassPath
    ) -> MassPath:
        """Return the path of the mass.

        Args:
            bend: curvature of the line of the contacts, 1/m.
            speed: of the contacts, m/s.
            step: distance of the points, m.
            slope: of the road.
            dip: vertical curvature of the road, 1/m.
            before: the path of the round before, from which lean and roll rate are renewed in part.
        """
        spent = 2.0 * step / (speed + np.roll(speed, -1))
        # What presses on the road presses on the pendulum.
        load = np.maximum(1.0 + dip * speed**2 / GRAVITY, _LEAST_LOAD)
        turn = bend * speed**2 / load
        lean, lateral = _sway(turn, speed, spent, before.lean, self.envelope.sway, self.speeds, self.lateral)
        around = spent + np.roll(spent, 1)
        rate = (np.roll(lean, -1) - np.roll(lean, 1)) / around
        if before.lean.any():
            rate = before.roll_rate + _RENEWED * (rate - before.roll_rate)
        places = np.linspace(0.0, 0.5 * math.pi, len(self.envelope.inside))
        inside = np.copysign(np.interp(np.abs(lean), places, self.envelope.inside), lean)
        height = np.interp(np.abs(lean), places, self.envelope.height)
        sideways = (np.roll(inside, -1) - np.roll(inside, 1)) / (2.0 * step)
        stretch = np.hypot(1.0 - bend * inside, sideways)
        distance = 0.5 * step * (stretch + np.roll(stretch, -1))
        # Energy of rolling by weight: 1/2 L h rate^2 / g.
        risen = height + 0.5 * self.envelope.sway * self.envelope.height[0] * rate**2 / GRAVITY
        rise = 0.5 * (np.roll(risen, -1) - np.roll(risen, 1)) / distance
        return MassPath(load * lateral / (speed * stretch) ** 2, distance, stretch, slope + rise, lean, rate)


def lean_model(envelope: Envelope) -> LeanModel:
    """Return a machine as a pendulum."""
    speeds = np.linspace(envelope.speeds[0], envelope.speeds[-1], 24)
    leans = np.linspace(0.0, _LARGEST_LEAN, _LEANS)
    return LeanModel(_steady_turns(envelope.limits, speeds, leans), speeds, envelope)


@njit(cache=True)
def _steady_turns(limits: Limits, speeds: np.ndarray, leans: np.ndarray) -> np.ndarray:
    table = np.empty((len(speeds), len(leans)))
    for i in range(len(speeds)):
        for k in range(len(leans)):
            table[i, k] = lateral_by_lean(limits, speeds[i], leans[k])
    return table


@njit(cache=True)
def _steady(table: np.ndarray, speeds: np.ndarray, speed: float, lean: float) -> float:
    """Return the lateral acceleration of the steady turn at a lean (rad, >= 0), m/s^2."""
    at = min(max((speed - speeds[0]) / (speeds[1] - speeds[0]), 0.0), len(speeds) - 1.001)
    along = min(lean / _LARGEST_LEAN, 0.9999) * (_LEANS - 1)
    i, k = int(at), int(along)
    low = table[i, k] + (along - k) * (table[i, k + 1] - table[i, k])
    high = table[i + 1, k] + (along - k) * (table[i + 1, k + 1] - table[i + 1, k])
    return low + (at - i) * (high - low)


@njit(cache=True)
def _sway(
    turn: np.ndarray, speed: np.ndarray, spent: np.ndarray, start: np.ndarray, length: float, speeds: np.ndarray,
    table: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return leans (rad) and lateral accelerations of the mass (m/s^2) over a lap, by Newton's iteration.

    Args:
        turn: lateral acceleration of the contacts, m/s^2.
        speed: m/s.
        spent: time from each point to the next, s.
        start: leans to begin with, rad.
        length: of the pendulum, m.
        speeds: of the table, m/s.
        table: steady lateral acceleration over speed and lean.
    """
    n = len(turn)
    lean = start.copy()
    below, middle, above, right = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for _ in range(_NEWTON):
        for i in range(n):
            size = abs(lean[i])
            before, after = spent[i - 1], spent[i]
            reach = length / math.cos(size)
            here = _steady(table, speeds, speed[i], size)
            slope = (_steady(table, speeds, speed[i], size + _SMALL) - here) / _SMALL
            below[i] = -2.0 * reach / (before * (before + after))
            above[i] = -2.0 * reach / (after * (before + after))
            middle[i] = slope - below[i] - above[i]
            right[i] = turn[i] - math.copysign(1.0, lean[i]) * (here - slope * size)
        lean = _solve_around(below, middle, above, right)
        for i in range(n):
            lean[i] = min(max(lean[i], -1.3), 1.3)
    lateral = np.empty(n)
    for i in range(n):
        lateral[i] = math.copysign(_steady(table, speeds, speed[i], abs(lean[i])), lean[i])
    return lean, lateral


@njit(cache=True)
def _solve_around(below: np.ndarray, middle: np.ndarray, above: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution of a tridiagonal system that is closed around (Sherman and Morrison's formula)."""
    n = len(middle)
    gamma = -middle[0]
    diagonal = middle.copy()
    diagonal[0] -= gamma
    diagonal[-1] -= above[-1] * below[0] / gamma
    corner = np.zeros(n)
    corner[0], corner[-1] = gamma, above[-1]
    x, z = _solve_open(below, diagonal, above, right), _solve_open(below, diagonal, above, corner)
    share = (x[0] + below[0] * x[-1] / gamma) / (1.0 + z[0] + below[0] * z[-1] / gamma)
    return x - share * z


@njit(cache=True)
def _solve_open(below: np.ndarray, middle: np.ndarray, above: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution of a tridiagonal system (Thomas's algorithm)."""
    n = len(middle)
    ratio, x = np.empty(n), np.empty(n)
    ratio[0], x[0] = above[0] / middle[0], right[0] / middle[0]
    for i in range(1, n):
        pivot = middle[i] - below[i] * ratio[i - 1]
        ratio[i] = above[i] / pivot
        x[i] = (right[i] - below[i] * x[i - 1]) / pivot
    for i in range(n - 2, -1, -1):
        x[i] -= ratio[i] * x[i + 1]
    return x
