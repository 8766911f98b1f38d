"""The lap that the classical rider plans: the machine's theoretical lap with a reserve, limited by roll rate.

A theoretical lap neglects roll rate. Between two opposite curves it requires more than any machine can do, and where
the machine is raised under power it requires more drive than the electronics allow, which keep load on the front wheel
of a machine that rolls. Both are corrected iteratively: leans and roll rates of a profile limit speed and drive of the
next one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.physics.superbike_forces import force_limits
from bike_sim.physics.superbike_statics import inertial_mass, steady_lateral
from bike_sim.theory.envelope import Envelope
from bike_sim.theory.lap_limit import LapLimit, lap_limit
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

ROUNDS = 25
LEAST_ROUNDS = 5
"""The drive is half renewed in a round; after this number of them little changes any more."""
PLANNED = 1.02
"""Excess of the roll rate at which the rounds end."""
DRIVE_SPAN = 0.3
"""Time over which the roll rate is averaged that the electronics will see, s."""


@dataclass(frozen=True)
class RiderSettings:
    """How a classical rider rides; the same for all machines and circuits.

    Attributes:
        lateral: part of the machine's lateral limit that the speed profile uses.
        drive: part of what tyres and wheelie limit allow the engine. brake: part of the braking limit.
        exponent: of the combination of accelerations; smaller than the machine's is more careful in mixing them.
        preview: time from steering to lean beyond the reference model's own, s.
        stencil: time step of the derivatives along the line, s.
        smoothing: distance over which the line's curvature is averaged, m.
        lateral_trust: largest lateral error that feedback answers in full, m.
        speed_gain: acceleration by error of speed, 1/s.
        speed_preview: time from throttle to force, s.
        period: control period for which both previews are meant; also the age up to which the difference of two states
            is the rate of the lateral error, s.
        rate_memory: time constant of the estimate that replaces it when the previous state is older, s.
        largest_lean: largest lean that is requested, rad.
        roll_rate: largest roll rate that the profile requires, averaged over `roll_span`, rad/s.
        roll_span: s.
    """

    lateral: float = 0.965
    drive: float = 1.0
    brake: float = 0.92
    exponent: float = 1.9
    preview: float = 0.15
    stencil: float = 0.2
    smoothing: float = 6.0
    lateral_trust: float = 2.0
    speed_gain: float = 3.0
    speed_preview: float = 0.10
    period: float = 0.02
    rate_memory: float = 0.1
    largest_lean: float = math.radians(58.0)
    roll_rate: float = 1.5
    roll_span: float = 0.6


def reserved(limits: Envelope, settings: RiderSettings) -> Envelope:
    """Return a machine's limits minus the rider's reserve."""
    return replace(
        limits,
        lateral_max=settings.lateral * limits.lateral_max,
        grip_drive_max=settings.drive * limits.grip_drive_max,
        drive_max=settings.drive * limits.drive_max,
        brake_max=settings.brake * (limits.brake_max - limits.drag) + limits.drag,
        exponent=settings.exponent,
    )


class SteadyLeans:
    """Lateral accelerations of a machine's steady turns, tabulated over speed and lean.

    Attributes:
        speeds: m/s. leans: rad, from 0 to the largest that the rider may request.
    """

    def __init__(self, vehicle: Superbike) -> None:
        """Compute the table."""
        self.speeds = np.linspace(5.0, 1.1 * vehicle.top_gear_speed, 24)
        self.leans = np.linspace(0.0, math.radians(vehicle.virtual_rider.max_lean_deg), 31)
        self._table = np.array([[steady_lateral(vehicle, lean, speed) for lean in self.leans] for speed in self.speeds])

    def row(self, speed: float) -> FloatArray:
        """Return the lateral accelerations of the leans at a speed, m/s^2."""
        u = float(np.interp(speed, self.speeds, np.arange(len(self.speeds))))
        i = min(int(u), len(self.speeds) - 2)
        return np.asarray(self._table[i] + (u - i) * (self._table[i + 1] - self._table[i]))

    def of(self, lateral: FloatArray, speed: FloatArray) -> FloatArray:
        """Return the leans at which lateral accelerations (m/s^2, positive left) are steady, rad, positive left."""
        found = [np.interp(abs(a), self.row(float(v)), self.leans) for a, v in zip(lateral, speed, strict=True)]
        return np.asarray(np.copysign(found, lateral))


def plan_lap(
    vehicle: Superbike, line: Course, limits: Envelope, settings: RiderSettings, leans: SteadyLeans
) -> LapLimit:
    """Return the fastest profile with the rider's reserve that the machine can be rolled and driven through.

    Args:
        vehicle: the machine.
        line: closed line to follow.
        limits: the machine's, without reserve.
        settings: how to ride.
        leans: the machine's.

    Raises:
        ValueError: the line is open.
    """
    limits = reserved(limits, settings)
    profile = lap_limit(limits, line)
    cap, push = np.full(len(profile.s) - 1, np.inf), None
    for number in range(ROUNDS):
        speed = profile.speed[:-1]
        lean = leans.of(profile.lateral, profile.speed)
        rate = _roll_rate(profile, lean, settings.roll_span)
        excess = _largest_around(profile, np.abs(rate), settings.roll_span)[:-1] / settings.roll_rate
        if excess.max() <= PLANNED and number >= LEAST_ROUNDS:
            break
        # Going slower both lowers the lean and takes more time for it, hence the square root.
        cap = np.minimum(cap, np.where(excess > 1.0, speed / np.sqrt(np.maximum(excess, 1.0)), np.inf))
        left = _drive_left(vehicle, limits, speed, lean[:-1], _roll_rate(profile, lean, DRIVE_SPAN)[:-1])
        push = left if push is None else 0.5 * (push + left)
        profile = lap_limit(limits, line, cap=cap, push=push)
    return profile


def smooth_around(values: FloatArray, spacing: float, distance: float) -> FloatArray:
    """Return values around a lap averaged over a distance, the last repeating the first.

    Args:
        values: at even distances.
        spacing: m.
        distance: m.
    """
    count = max(1, round(distance / spacing))
    window = np.hanning(count + 2)[1:-1]
    lap = values[:-1]
    padded = np.concatenate((lap[-count:], lap, lap[:count]))
    smooth = np.convolve(padded, window / window.sum(), mode="same")[count:-count]
    return np.append(smooth, smooth[0])


def _drive_left(
    vehicle: Superbike, limits: Envelope, speed: FloatArray, lean: FloatArray, rate: FloatArray
) -> FloatArray:
    """Return the acceleration that the electronics leave at speeds (m/s), leans (rad) and roll rates (rad/s), m/s^2."""
    thrust = _thrust_left(lean, rate, speed, vehicle.machine, vehicle.tyres)
    drag = np.interp(speed, limits.speeds, limits.drag)
    return np.asarray(thrust / inertial_mass(vehicle) - drag)


@njit(cache=True)
def _thrust_left(lean: np.ndarray, rate: np.ndarray, speed: np.ndarray, m: np.ndarray, tyre: np.ndarray) -> np.ndarray:
    """Return the drive that the electronics leave, N."""
    left = np.empty(len(lean))
    for i in range(len(lean)):
        left[i] = force_limits(lean[i], rate[i], speed[i] ** 2, m, tyre)[0]
    return left


def _roll_rate(profile: LapLimit, lean: FloatArray, span: float) -> FloatArray:
    """Return the rate of the lean around the lap, averaged over a time (s), rad/s."""
    ahead, behind = (_around(profile, lean, sign * 0.5 * span) for sign in (1.0, -1.0))
    return (ahead - behind) / span


def _largest_around(profile: LapLimit, values: FloatArray, span: float) -> FloatArray:
    """Return the largest of values within half a time (s) of each point.

    Every point within the span contributes to the span's roll rate.
    """
    return np.asarray(np.max([_around(profile, values, shift) for shift in np.linspace(-0.5, 0.5, 5) * span], axis=0))


def _around(profile: LapLimit, values: FloatArray, shift: float) -> FloatArray:
    """Return values of the profile's points as they are a time (s) later, around the lap."""
    laps = np.concatenate([profile.time[:-1] - profile.time[-1], profile.time, profile.time[1:] + profile.time[-1]])
    return np.interp(profile.time + shift, laps, np.concatenate([values[:-1], values, values[1:]]))
