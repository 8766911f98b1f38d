"""The state of a bicycle from what its sensors measure: inertial unit, encoders, position by satellite.

An extended Kalman filter carries pose and roll with the measured rates and the rolling wheels, and finds the bias of
the gyroscope and the offset of the steering encoder. It knows the geometry of the bicycle and how it rolls, and neither
its masses nor its commands: a bicycle that is pushed or loaded is estimated as well as any. Four things correct it

- the **specific force** to the left: gravity in a leaning frame, less what the turn and the roll take of it;
- the **angular velocity** about the frame's y axis, which is the yaw rate seen from a leaning frame;
- the **yaw rate** about its z axis, which is that of the rolling wheels at this steering angle;
- the **position**, which comes late: the filter goes back to the instant at which it was measured, and on again.

Source of the filter: Simon (2006), Optimal State Estimation, Wiley, Sects. 13.2 and 10.5.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.bicycle.whipple import derivative
from bike_sim.physics.kinematics import Parameters
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import RawSensors
from bike_sim.sim.request import Preview
from bike_sim.sim.sensors import Measurement, angular_velocity, mounted, specific_force
from bike_sim.sim.snapshot import NO_FALL, TIPPED, Snapshot
from bike_sim.vehicles.bicycle import PARAMETER_NAMES, Vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

FOUND: Final = ("x", "y", "yaw", "roll", "gyro_bias_x", "gyro_bias_y", "gyro_bias_z", "steer_offset", "force_bias",
                "wheel_scale")  # fmt: skip
"""Quantities of the filter: m, rad, rad/s, m/s^2, and by how much the wheel seems to turn too fast, 1."""
_SIZE: Final = len(FOUND)
_FIRST: Final = np.array([0.05, 0.05, 0.1, 0.1, 0.01, 0.01, 0.01, 0.02, 0.1, 0.02])
"""Their standard deviations at the begin; those of the position also hold the antenna's lean."""
_WANDER: Final = np.array([1e-4, 1e-4, 5e-5, 5e-5, 2e-6, 2e-6, 2e-6, 2e-6, 2e-5, 2e-6])
"""Standard deviations of what a control period adds beside the noise of the sensors."""
_MODEL: Final = np.array([0.02, 1e-3, 3e-3, 0.05])
"""Standard deviations of specific force (m/s^2), angular velocity and yaw rate (rad/s) of a bicycle that is not quite
the known one."""
_STEER_SHARE: Final = 0.1
"""Roll rate that a change of the steering rate makes, of it."""
_USUAL_SPEED: Final = 4.0
"""Speed for which an error of the steering encoder counts as one of the yaw rate, m/s."""
MOST_LATE: Final = 40
"""Control periods by which a position may be late."""

_X, _Y, _YAW, _ROLL, _BIAS, _OFFSET, _FORCE_BIAS, _SCALE = 0, 1, 2, 3, 4, 7, 8, 9
_STEPS: Final = np.array([1e-4, 1e-4, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])
"""Of the differences that Jacobians are made of."""

_LAM, _RADIUS = (PARAMETER_NAMES.index(name) for name in ("lam", "rR"))
# What is measured, as the kernels take it.
_GYRO, _FORCE, _STEER, _STEER_RATE, _WHEEL = 0, 3, 6, 7, 8


@njit(cache=True)
def _motion(found: FloatArray, read: FloatArray, p: Parameters) -> FloatArray:
    """Return the motion (`sensors.mounted`) of estimates and readings; rates of roll and yaw are the gyroscope's."""
    roll, steer = found[_ROLL], read[_STEER] - found[_OFFSET]
    geometry = kinematics.steering_geometry(p)
    beta = kinematics.solve_beta(roll, -p[_LAM], steer, geometry)
    pitch = beta + p[_LAM]
    gx, gz = read[_GYRO] - found[_BIAS], read[_GYRO + 2] - found[_BIAS + 2]
    sp, cp = math.sin(pitch), math.cos(pitch)
    roll_rate, yaw_rate = cp * gx + sp * gz, (cp * gz - sp * gx) / math.cos(roll)
    _, speed, pitch_rate = kinematics.velocities(
        roll, beta, steer, roll_rate, read[_STEER_RATE], read[_WHEEL] / (1.0 + found[_SCALE]), geometry
    )
    return np.array((found[_X], found[_Y], found[_YAW], roll, pitch, yaw_rate, roll_rate, pitch_rate, speed))


@njit(cache=True)
def _moved(found: FloatArray, before: FloatArray, read: FloatArray, period: float, p: Parameters) -> FloatArray:
    """Return estimates a while (s) later, by the mean of the rates at both ends."""
    start = _motion(found, before, p)
    after = found.copy()
    after[_ROLL] += period * start[6]
    for _ in range(2):
        end = _motion(after, read, p)
        after[_ROLL] = found[_ROLL] + 0.5 * period * (start[6] + end[6])
    turned = 0.5 * period * (start[5] + end[5])
    way, middle = 0.5 * period * (start[8] + end[8]), found[_YAW] + 0.5 * turned
    # The heading midway differs from the mean one by what the yaw rate has changed.
    middle += 0.125 * period * (start[5] - end[5])
    chord = 1.0 - turned * turned / 24.0
    after[_X] += way * chord * math.cos(middle)
    after[_Y] += way * chord * math.sin(middle)
    after[_YAW] += turned
    return after


@njit(cache=True)
def _seen(
    first: FloatArray, found: FloatArray, before: FloatArray, read: FloatArray, period: float,
    unit: tuple[float, float], p: Parameters,
) -> FloatArray:  # fmt: skip
    """Return what is expected: specific force to the left, angular velocity about y and z, mean roll acceleration."""
    last, motion = _motion(first, before, p), _motion(found, read, p)
    state = np.zeros(10)
    state[st.ROLL], state[st.STEER] = found[_ROLL], read[_STEER] - found[_OFFSET]
    state[st.ROLL_RATE], state[st.STEER_RATE], state[st.FRONT_WHEEL_RATE] = motion[6], read[_STEER_RATE], read[_WHEEL]
    state[st.FRONT_WHEEL_RATE] /= 1.0 + found[_SCALE]
    force = specific_force(last, motion, period, unit[0], unit[1], p)[1] + found[_FORCE_BIAS]
    rolling = motion.copy()
    rolling[5] = kinematics.yaw_rate(state, p)
    _, about_y, about_z = angular_velocity(rolling)
    # The mean over the period of what changes with known rates at its ends, by Hermite's cubic.
    middle = state.copy()
    correction = period / 12.0
    start_steer = before[_STEER] - first[_OFFSET]
    middle[st.ROLL] = 0.5 * (first[_ROLL] + found[_ROLL]) + correction * (last[6] - motion[6])
    middle[st.STEER] = 0.5 * (start_steer + state[st.STEER]) + correction * (before[_STEER_RATE] - read[_STEER_RATE])
    middle[st.ROLL_RATE] = (found[_ROLL] - first[_ROLL]) / period
    middle[st.STEER_RATE] = (state[st.STEER] - start_steer) / period
    roll_acceleration = _roll_acceleration(middle, (read[_STEER_RATE] - before[_STEER_RATE]) / period, p)
    return np.array((force, about_y + found[_BIAS + 1], about_z + found[_BIAS + 2], roll_acceleration))


@njit(cache=True)
def _roll_acceleration(state: FloatArray, steer_acceleration: float, p: Parameters) -> float:
    """Return the roll acceleration of a rolling bicycle whose steering accelerates so, whatever turns it, rad/s^2."""
    free, turned = derivative(state, 0.0, p), derivative(state, 0.1, p)
    share = (steer_acceleration - free[st.STEER_RATE]) / (turned[st.STEER_RATE] - free[st.STEER_RATE])
    return float(free[st.ROLL_RATE] + share * (turned[st.ROLL_RATE] - free[st.ROLL_RATE]))


@njit(cache=True)
def _advance(
    found: FloatArray, spread: FloatArray, before: FloatArray, read: FloatArray, period: float,
    unit: tuple[float, float], added: FloatArray, slip: float, errors: FloatArray, p: Parameters,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return estimates and their covariance after a control period and what is measured at its end."""
    after = _moved(found, before, read, period, p)
    moves = np.empty((_SIZE, _SIZE))
    for k in range(_SIZE):
        varied = found.copy()
        varied[k] += _STEPS[k]
        moves[:, k] = (_moved(varied, before, read, period, p) - after) / _STEPS[k]
    spread = moves @ spread @ moves.T + np.diag(added)
    # A wheel's error moves the bicycle along its heading, and nothing moves it aside.
    cos, sin = math.cos(after[_YAW]), math.sin(after[_YAW])
    spread[_X, _X] += slip * slip * cos * cos
    spread[_Y, _Y] += slip * slip * sin * sin
    spread[_X, _Y] += slip * slip * cos * sin
    spread[_Y, _X] += slip * slip * cos * sin
    expected = _seen(found, after, before, read, period, unit, p)
    shown = np.empty((len(expected), _SIZE))
    for k in range(_SIZE):  # an error at the end of a control period was there at its begin
        first, varied = found.copy(), after.copy()
        first[k] += _STEPS[k]
        varied[k] += _STEPS[k]
        shown[:, k] = (_seen(first, varied, before, read, period, unit, p) - expected) / _STEPS[k]
    change = _motion(after, read, p)[6] - _motion(found, before, p)[6]
    measured = np.array((read[_FORCE + 1], read[_GYRO + 1], read[_GYRO + 2], change / period))
    return _corrected(after, spread, measured - expected, shown, errors)


@njit(cache=True)
def _corrected(
    found: FloatArray, spread: FloatArray, difference: FloatArray, shown: FloatArray, errors: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return estimates and their covariance after a measurement (Joseph's form)."""
    size = shown @ spread @ shown.T + np.diag(errors)
    gain = np.linalg.solve(size, shown @ spread).T
    rest = np.eye(_SIZE) - gain @ shown
    return found + gain @ difference, rest @ spread @ rest.T + gain @ np.diag(errors) @ gain.T


class _Instant(NamedTuple):
    """What is known of a control instant, so that a late position can change it."""

    step: int
    read: FloatArray
    found: FloatArray
    spread: FloatArray


class Estimator:
    """Follows one ride; see the module.

    Attributes:
        found: estimates (FOUND) at the last measurement.
        spread: their covariance.
    """

    found: FloatArray
    spread: FloatArray

    def __init__(self, vehicle: Vehicle, course: Course, period: float, preview: Preview, sensors: RawSensors) -> None:
        """Begin a ride.

        Args:
            vehicle: its geometry counts.
            course: path that is ridden; the first heading is that of its nearest point.
            period: control period, s.
            preview: that snapshots show.
            sensors: where they are mounted and their standard deviations; biases are found and not read.

        Raises:
            ValueError: a superbike.
        """
        if isinstance(vehicle, Superbike):
            raise ValueError(f"the state is estimated of bicycles, which roll without slip, not of {vehicle.name!r}")
        self._parameters, self._course, self._period, self._sensors = vehicle.parameters, course, period, sensors
        self._vehicle, self._points = vehicle, preview
        self._machine = lk.Machine(vehicle.parameters, True, vehicle.mass)
        self._form = lk.Points(preview.by_time, preview.interval)
        self._past: deque[_Instant] = deque(maxlen=MOST_LATE)
        self._unit = sensors.unit_ahead_m, sensors.unit_height_m
        arm = math.sqrt(2.0) * sensors.gyro / period * sensors.unit_height_m
        turned = math.hypot(sensors.gyro, _USUAL_SPEED / vehicle.w * sensors.steer)
        jump = math.sqrt(2.0) / period * math.hypot(sensors.gyro, _STEER_SHARE * sensors.steer_rate)
        noise = np.hypot([math.hypot(sensors.accelerometer, arm), sensors.gyro, turned, jump], _MODEL)
        self._errors = noise**2
        self._slip = sensors.wheel_speed * period
        rates = np.array([0.0, 0.0, sensors.gyro * period, sensors.gyro * period, *[0.0] * 6])
        self._added = rates**2 + _WANDER**2
        self._rear_wheel = self._front_wheel = 0.0
        self._look = np.zeros(lk.LOOK_SIZE)
        self._histories: deque[tuple[float, float]] = deque(maxlen=SimulatorConfig.history)

    def measure(self, measured: Measurement) -> st.StateVector | None:
        """Take a measurement and return the minimal state; None until the first position has come."""
        read = np.array((*measured.gyro, *measured.force, measured.steer, measured.steer_rate, measured.wheel_rate))
        if not np.isfinite(read).all():
            return None
        if not self._past:
            if measured.fix is None:
                return None
            self._begin(measured, read)
        else:
            self._append(measured.step, read)
            if measured.fix is not None:
                self._locate(measured)
        return self._state()

    def _begin(self, measured: Measurement, read: FloatArray) -> None:
        """Begin at a position, upright along the course."""
        course, fix = self._course, measured.fix
        assert fix is not None, "the ride begins with it"
        nearest = int(np.argmin((course.x - fix.x) ** 2 + (course.y - fix.y) ** 2))
        self.found, self.spread = np.zeros(_SIZE), np.diag(_FIRST**2)
        yaw = float(course.heading[nearest])
        ahead = self._sensors.antenna_ahead_m
        self.found[:4] = fix.x - ahead * math.cos(yaw), fix.y - ahead * math.sin(yaw), yaw, 0.0
        self._past.append(_Instant(measured.step, read, self.found, self.spread))
        self._relocate(fix.x, fix.y)

    def _append(self, step: int, read: FloatArray) -> None:
        """Go on to a later instant."""
        last = self._past[-1]
        motion = _motion(last.found, last.read, self._parameters)
        elapsed = max(step - last.step, 1) * self._period
        found, spread = _advance(
            last.found, last.spread, last.read, read, elapsed, self._unit, self._added, self._slip, self._errors,
            self._parameters,
        )  # fmt: skip
        if not (np.isfinite(found).all() and np.isfinite(spread).all()):
            found, spread = last.found, np.diag(_FIRST**2)  # a bicycle on its side has no rolling wheels
        speed = motion[8]
        self._rear_wheel += elapsed * float(speed) / float(self._parameters[_RADIUS])
        self._front_wheel += elapsed * float(read[_WHEEL]) / (1.0 + float(found[_SCALE]))
        self._past.append(_Instant(step, read, found, spread))

    def _locate(self, measured: Measurement) -> None:
        """Take a position at the instant of its measurement, and go on from there again."""
        fix = measured.fix
        assert fix is not None, "asked for"
        later: list[_Instant] = []
        while len(self._past) > 1 and self._past[-1].step > fix.step:
            later.append(self._past.pop())
        rear, front = self._rear_wheel, self._front_wheel
        if self._past[-1].step == fix.step:
            self._relocate(fix.x, fix.y)
        for instant in reversed(later):
            self._append(instant.step, instant.read)
        self._rear_wheel, self._front_wheel = rear, front

    def _relocate(self, x: float, y: float) -> None:
        """Correct the last instant by a position of the antenna, m."""
        step, read, found, spread = self._past.pop()
        mount = self._sensors.antenna_ahead_m, self._sensors.antenna_height_m

        def antenna(of: FloatArray) -> FloatArray:
            return np.array(mounted(_motion(of, read, self._parameters), *mount, self._parameters)[:2])

        expected = antenna(found)
        shown = np.column_stack([(antenna(found + row) - expected) / row.sum() for row in np.diag(_STEPS)])
        errors = np.full(2, self._sensors.position**2 + 1e-3**2)
        found, spread = _corrected(found, spread, np.array([x, y]) - expected, shown, errors)
        self._past.append(_Instant(step, read, found, spread))

    def _state(self) -> st.StateVector:
        """Return the minimal state at the last instant."""
        _, read, self.found, self.spread = self._past[-1]
        motion = _motion(self.found, read, self._parameters)
        state = np.zeros(st.STATE_SIZE)
        state[[st.X, st.Y, st.YAW, st.ROLL]] = self.found[:4]
        state[st.STEER] = read[_STEER] - self.found[_OFFSET]
        state[[st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]] = motion[6], read[_STEER_RATE], read[_WHEEL]
        state[st.FRONT_WHEEL_RATE] /= 1.0 + self.found[_SCALE]
        state[[st.REAR_WHEEL, st.FRONT_WHEEL]] = self._rear_wheel, self._front_wheel
        return state

    def figures(self) -> dict[str, float]:
        """Return what has been found of the sensors, and how sure position and roll are."""
        units = ("m", "m", "rad", "rad", "rad_s", "rad_s", "rad_s", "rad", "m_s2", "1")
        named = [f"{name}_{unit}" for name, unit in zip(FOUND, units, strict=True)]
        deviations = np.sqrt(np.diag(self.spread))
        found = dict(zip(named[_BIAS:], self.found[_BIAS:].tolist(), strict=True))
        return found | {f"deviation_{named[k]}": float(deviations[k]) for k in (_X, _Y, _YAW, _ROLL)}

    def snapshot(self, state: st.StateVector, episode: int, step: int) -> Snapshot:
        """Return what a rider is shown of a minimal state; applied commands and torques are not measured.

        Args:
            state: from :meth:`measure`.
            episode: number of the episode.
            step: control step.
        """
        course, fresh = self._course, not self._histories
        look, points = self._look, np.empty((2, self._points.count))
        if fresh:
            nearest = int(np.argmin((course.x - state[st.X]) ** 2 + (course.y - state[st.Y]) ** 2))
            look[lk.PROGRESS] = course.s[nearest]
        lk.derive_on_path(state, self._machine, course.samples, self._form, fresh, look, points)
        self._histories.append((float(state[st.ROLL]), float(state[st.STEER])))
        rolls, steers = zip(*self._histories, strict=True)
        fallen = abs(float(state[st.ROLL])) > self._vehicle.fall_roll
        return Snapshot(
            episode=episode,
            step=step,
            time=step * self._period,
            state=state,
            look=look.copy(),
            steering=0.0,
            throttle=0.0,
            steer_torque=0.0,
            preview_x=points[0],
            preview_y=points[1],
            roll_history=rolls,
            steer_history=steers,
            fallen=fallen,
            off_course=abs(float(look[lk.LATERAL_ERROR])) > course.off_course_limit,
            finished=not course.closed and bool(look[lk.PROGRESS] >= course.length),
            fall=TIPPED if fallen else NO_FALL,
        )
