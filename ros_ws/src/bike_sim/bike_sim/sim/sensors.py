"""What the sensors of a real bicycle measure: angular velocity, specific force, encoders, position by satellite.

An inertial unit and an antenna sit on the rear frame. Angular velocity and encoders are those of the instant; the
specific force is its mean over the control period, as a unit gives that filters for a slower reader. `raw_sensors` of
the disturbances says how they err, and the draws depend on the seed and on the first state of the ride alone.

The position by satellite is latitude and longitude on the WGS 84 ellipsoid (NIMA TR8350.2, 2000), about a datum that
lies in the origin of the map, with x to the east and y to the north.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.kinematics import Parameters
from bike_sim.sim.disturbances import Disturbances, RawSensors
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import PARAMETER_NAMES, Vehicle

FloatArray = NDArray[np.float64]

BRANCH: Final = 3
"""Branch of the draws; forces and sensors of the state have others."""
DATUM: Final = (47.0, 15.0)
"""Latitude and longitude of the map's origin where none is given, deg."""
GRAVITY: Final = 9.81

_EQUATOR: Final = 6378137.0
_ECCENTRICITY_2: Final = 6.69437999014e-3
"""Semi-major axis, m, and first eccentricity squared of WGS 84."""
_RADIUS: Final = PARAMETER_NAMES.index("rR")


class Fix(NamedTuple):
    """A position by satellite.

    Attributes:
        step: control step at which it was measured.
        x: of the antenna in map, m.
        y: m.
    """

    step: int
    x: float
    y: float


class Measurement(NamedTuple):
    """What the sensors show at a control step.

    Attributes:
        step: the control step.
        gyro: angular velocity of the rear frame in its axes, rad/s, shape (3,).
        force: specific force there, mean since the last measurement, m/s^2, shape (3,).
        steer: rad.
        steer_rate: rad/s.
        wheel_rate: of the front wheel to the fork, rad/s.
        fix: the position that arrived, or None.
    """

    step: int
    gyro: FloatArray
    force: FloatArray
    steer: float
    steer_rate: float
    wheel_rate: float
    fix: Fix | None


@njit(cache=True)
def mounted(motion: FloatArray, ahead: float, height: float, p: Parameters) -> tuple[float, float, float, float]:
    """Return the place and the velocity of a point of the rear frame, in map but for their heights, m and m/s.

    Args:
        motion: x, y, yaw, roll, pitch, their rates without x and y, and the rear contact's speed, shape (9,).
        ahead: of the point, of the rear contact in the upright pose, m.
        height: of it there, m.
        p: flat vehicle parameters.
    """
    x, y, yaw, roll, pitch, yaw_rate, roll_rate, pitch_rate, speed = motion
    sp, cp = math.sin(pitch), math.cos(pitch)
    above = height - p[_RADIUS]  # the frame pitches about the rear axle
    along, up = cp * ahead + sp * above, p[_RADIUS] - sp * ahead + cp * above
    along_rate, up_rate = pitch_rate * (up - p[_RADIUS]), -pitch_rate * along
    sr, cr = math.sin(roll), math.cos(roll)
    left, left_rate = -sr * up, -cr * roll_rate * up - sr * up_rate
    forward, aside = speed + along_rate - yaw_rate * left, left_rate + yaw_rate * along
    sy, cy = math.sin(yaw), math.cos(yaw)
    return x + cy * along - sy * left, y + sy * along + cy * left, cy * forward - sy * aside, sy * forward + cy * aside


@njit(cache=True)
def climb_rate(motion: FloatArray, ahead: float, height: float, p: Parameters) -> float:
    """Return the vertical velocity of a point of the rear frame, m/s; see :func:`mounted`."""
    roll, pitch, roll_rate, pitch_rate = motion[3], motion[4], motion[6], motion[7]
    sp, cp = math.sin(pitch), math.cos(pitch)
    above = height - p[_RADIUS]
    along, up = cp * ahead + sp * above, p[_RADIUS] - sp * ahead + cp * above
    return -math.sin(roll) * roll_rate * up - math.cos(roll) * pitch_rate * along


@njit(cache=True)
def motion_of(state: FloatArray, p: Parameters) -> FloatArray:
    """Return the motion of a minimal state, see :func:`mounted`."""
    yaw_rate, speed, pitch_rate = kinematics.rates(state, p)
    pitch = kinematics.pitch(state[st.ROLL], state[st.STEER], p)
    place = (state[st.X], state[st.Y], state[st.YAW], state[st.ROLL], pitch)
    return np.array((*place, yaw_rate, state[st.ROLL_RATE], pitch_rate, speed))


@njit(cache=True)
def angular_velocity(motion: FloatArray) -> tuple[float, float, float]:
    """Return the angular velocity of the rear frame in its axes, rad/s; see :func:`mounted`."""
    roll, pitch, yaw_rate, roll_rate, pitch_rate = motion[3], motion[4], motion[5], motion[6], motion[7]
    upright = yaw_rate * math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    return cp * roll_rate - sp * upright, yaw_rate * math.sin(roll) + pitch_rate, sp * roll_rate + cp * upright


@njit(cache=True)
def specific_force(
    before: FloatArray, after: FloatArray, duration: float, ahead: float, height: float, p: Parameters
) -> tuple[float, float, float]:
    """Return the mean specific force on a point of the rear frame between two motions, in its axes midway, m/s^2."""
    _, _, vx, vy = mounted(before, ahead, height, p)
    _, _, wx, wy = mounted(after, ahead, height, p)
    ax, ay = (wx - vx) / duration, (wy - vy) / duration
    az = (climb_rate(after, ahead, height, p) - climb_rate(before, ahead, height, p)) / duration + GRAVITY
    yaw, roll, pitch = 0.5 * (before[2] + after[2]), 0.5 * (before[3] + after[3]), 0.5 * (before[4] + after[4])
    sy, cy, sr, cr = math.sin(yaw), math.cos(yaw), math.sin(roll), math.cos(roll)
    forward, left = cy * ax + sy * ay, cy * ay - sy * ax
    left, up = cr * left + sr * az, cr * az - sr * left
    sp, cp = math.sin(pitch), math.cos(pitch)
    return cp * forward - sp * up, left, sp * forward + cp * up


class BicycleSensors:
    """Sensors of one bicycle, ride by ride."""

    def __init__(self, vehicle: Vehicle, disturbances: Disturbances, period: float) -> None:
        """Mount them.

        Args:
            vehicle: that is ridden.
            disturbances: how they err; without `raw_sensors` they are exact.
            period: control period, s.

        Raises:
            ValueError: a superbike, or times that are not whole numbers of control periods.
        """
        self._disturbances, self._period = disturbances, period
        self._known = disturbances.raw_sensors or RawSensors()
        disturbances.check_sensors(vehicle)
        self._between = disturbances.fix_periods(period)
        self._late = disturbances.periods(self._known.position_delay_s, period)
        self._parameters, self._radius = vehicle.parameters, vehicle.rF
        self._last: tuple[int, FloatArray] | None = None

    def begin(self, snapshot: Snapshot) -> None:
        """Begin a ride with its first snapshot."""
        self._draws = self._disturbances.generator(snapshot.state, BRANCH)
        self._drawn = snapshot.step - 1
        self._fixes: list[Fix] = []
        self._last = None

    def measure(self, snapshot: Snapshot) -> Measurement:
        """Return what is measured at a later snapshot, or at the first; draws of missed steps are passed over."""
        known, step = self._known, snapshot.step
        drawn = self._draws.standard_normal((max(step - self._drawn, 1), 11))
        self._drawn = step
        noise = drawn[-1]
        motion = motion_of(snapshot.state, self._parameters)
        steps, before = (1, motion) if self._last is None else (step - self._last[0], self._last[1])
        unit = known.unit_ahead_m, known.unit_height_m
        force = np.array(specific_force(before, motion, max(steps, 1) * self._period, *unit, self._parameters))
        self._last = step, motion
        first = steps == 1 and before is motion
        if step % self._between == 0 or first:
            x, y, _, _ = mounted(motion, known.antenna_ahead_m, known.antenna_height_m, self._parameters)
            self._fixes.append(Fix(step, x + known.position * noise[9], y + known.position * noise[10]))
        arrived = [fix for fix in self._fixes if first or fix.step <= step - self._late]
        self._fixes = [] if first else [fix for fix in self._fixes if fix.step > step - self._late]
        return Measurement(
            step,
            np.array(angular_velocity(motion)) + known.gyro_bias + known.gyro * noise[:3],
            force + known.accelerometer_bias + known.accelerometer * noise[3:6],
            float(snapshot.state[st.STEER] + known.steer_bias + known.steer * noise[6]),
            float(snapshot.state[st.STEER_RATE] + known.steer_rate * noise[7]),
            float(
                snapshot.state[st.FRONT_WHEEL_RATE] * known.wheel_scale + known.wheel_speed * noise[8] / self._radius
            ),
            arrived[-1] if arrived else None,
        )


def _to_earth(latitude: float, longitude: float) -> FloatArray:
    """Return a point of the ellipsoid in Earth's axes, m; angles in rad."""
    across = _EQUATOR / math.sqrt(1.0 - _ECCENTRICITY_2 * math.sin(latitude) ** 2)
    level = across * math.cos(latitude)
    height = across * (1.0 - _ECCENTRICITY_2) * math.sin(latitude)
    return np.array([level * math.cos(longitude), level * math.sin(longitude), height])


def _axes(latitude: float, longitude: float) -> FloatArray:
    """Return east, north and up at a point in Earth's axes, shape (3, 3); angles in rad."""
    sb, cb, sl, cl = math.sin(latitude), math.cos(latitude), math.sin(longitude), math.cos(longitude)
    return np.array([[-sl, cl, 0.0], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]])


def to_geodetic(x: float, y: float, datum: tuple[float, float] = DATUM) -> tuple[float, float]:
    """Return latitude and longitude of a place of the map, deg.

    Args:
        x: m to the east of the datum.
        y: m to the north.
        datum: latitude and longitude of the map's origin, deg.
    """
    origin = math.radians(datum[0]), math.radians(datum[1])
    latitude, longitude = origin
    for _ in range(5):  # Newton on the tangent plane of the last guess: three rounds end below 1e-9 m
        found = _axes(*origin) @ (_to_earth(latitude, longitude) - _to_earth(*origin))
        across = _EQUATOR / math.sqrt(1.0 - _ECCENTRICITY_2 * math.sin(latitude) ** 2)
        along = across * (1.0 - _ECCENTRICITY_2) / (1.0 - _ECCENTRICITY_2 * math.sin(latitude) ** 2)
        longitude += (x - float(found[0])) / (across * math.cos(latitude))
        latitude += (y - float(found[1])) / along
    return math.degrees(latitude), math.degrees(longitude)


def from_geodetic(latitude: float, longitude: float, datum: tuple[float, float] = DATUM) -> tuple[float, float]:
    """Return the place in the map of a latitude and a longitude in deg, m; see :func:`to_geodetic`."""
    origin = math.radians(datum[0]), math.radians(datum[1])
    here = _to_earth(math.radians(latitude), math.radians(longitude))
    east, north, _ = (_axes(*origin) @ (here - _to_earth(*origin))).tolist()
    return east, north
