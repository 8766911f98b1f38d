"""Engines of bicycles measured against published figures.

Every check runs an engine and compares with a published figure, with the closed formulas of
`bike_sim.physics.bicycle.linear`, or with the compiled nonlinear bicycle. Nothing is adjusted between engines except
limits that follow from the integration step. `bike validate` prints the result; the tests hold it.

References: Meijaard et al. (2007), the benchmark bicycle; Weyrer et al. (2026), appendices A to C.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import bodies as bd
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.bicycle import linear
from bike_sim.physics.bicycle.bullet import PyBulletEngine
from bike_sim.physics.engine import BicycleEngine
from bike_sim.physics.engines import make_bicycle_engine
from bike_sim.physics.multibody import vectors
from bike_sim.physics.state import StateVector
from bike_sim.validation.report import Check, Mode, Report
from bike_sim.vehicles.bicycle import Vehicle

MODE_SPEEDS: Final = (3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
"""Speeds, m/s, at which the modes are compared."""

TABLE_8: Final = (
    (0.0, 0.0, 0.0),
    (0.0, 60.0, 58.8),
    (0.0, 70.0, 69.11),
    (-45.0, 0.0, 0.0),
    (-45.0, 60.0, 81.66),
    (-45.0, 70.0, 92.16),
    (45.0, 0.0, 0.0),
    (45.0, -60.0, -81.66),
    (45.0, -70.0, -92.16),
)
"""Roll, steer and direction of motion of the front contact, deg: Table 8 of Weyrer et al. (2026), benchmark bicycle."""

_ORDER_STEPS: Final = {"pybullet": (0.0025, 0.00125, 0.000625), "whipple": (0.05, 0.025, 0.0125)}
"""Integration steps, s, over which an engine's error is watched falling: small enough for its leading term to rule,
large enough for that term to stand out of rounding."""
_ORDER: Final = {"pybullet": 1.0, "whipple": 4.0}
_ORDER_TOLERANCE: Final = 0.1
"""Share of the order by which a fit over three steps may differ from it."""
_REFERENCE_STEP: Final = 0.0005
"""Step, s, of the compiled engine where it is the reference; its own error is then of the order of 1e-12."""

_PRESS: Final = 200.0
"""Force, N, that holds each wheel to the ground where there is no gravity: what the fork's swing asks for, twice."""


class Run(NamedTuple):
    """What is measured: a bicycle, the kind of its engine, and the integration step, s."""

    vehicle: Vehicle
    kind: str
    time_step: float


def validate(
    vehicle: Vehicle, kind: str = "pybullet", time_step: float = 0.001, progress: Callable[[str], None] = lambda _: None
) -> Report:
    """Measure an engine against everything published about its bicycle.

    Args:
        vehicle: the bicycle, with its steering drive.
        kind: engine kind of `bike_sim.physics.engines.make_engine`.
        time_step: integration step, s. Limits on the modes hold for 1 ms and grow with larger steps.
        progress: called with a few words before each part.

    Raises:
        ValueError: unknown engine kind, a step that cannot be, or a vehicle without the benchmark's modes.
    """
    report, run = Report(), Run(vehicle, kind, time_step)
    progress("modes over speed")
    report.modes += measured_modes(run)
    for title, part in (
        ("weave and capsize speed", stability_limits),
        ("errors of the modes", lambda run: _mode_errors(report.modes, run.time_step)),
        ("order of convergence", _mode_order),
        ("direction of the front contact", _front_directions),
        ("steering step", _steering_step),
        ("straight riding", _speed_loss),
        ("coasting with a hard start", _coasting),
        ("against the compiled bicycle", _violent_start),
    ):
        progress(title)
        report.checks += part(run)
    return report


def free_of_drive(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with its steering drive switched off, as the benchmark has none."""
    return replace(vehicle, P=0.0, D=0.0)


def _coaster(run: Run, time_step: float | None = None) -> BicycleEngine:
    """Return a new engine without steering drive."""
    return make_bicycle_engine(run.kind, free_of_drive(run.vehicle), run.time_step if time_step is None else time_step)


def _step_limit(at_1_ms: float, at_5_ms: float, time_step: float) -> float:
    """Return the limit of an error of first order: constant to 1 ms, linear to 5 ms, proportional beyond."""
    if time_step > 0.005:
        return at_5_ms * time_step / 0.005
    return float(np.interp(time_step, (0.001, 0.005), (at_1_ms, at_5_ms)))


def stability_limits(run: Run) -> Iterator[Check]:
    """Weave and capsize speed by bisection, within 0.25 % at 1 ms and 1 % at 5 ms."""
    engine = _coaster(run)
    share = _step_limit(0.0025, 0.01, run.time_step)
    weave, capsize = linear.weave_speed(run.vehicle), linear.capsize_speed(run.vehicle)
    for name, exact, measured in (
        ("weave", weave, linear.measured_speed(engine, "weave", 0.8 * weave, 1.1 * weave)),
        ("capsize", capsize, linear.measured_speed(engine, "capsize", 0.9 * capsize, 1.1 * capsize)),
    ):
        low, high = exact * (1 - share), exact * (1 + share)
        yield Check(f"{name}_speed_m_s", f"{name} speed, m/s", measured, low, high, exact)


def measured_modes(run: Run) -> Iterator[Mode]:
    """Measure the modes at the speeds of `MODE_SPEEDS`, beside those of the closed formulas."""
    engine = _coaster(run)
    for speed in MODE_SPEEDS:
        measured, published = linear.measured_modes(engine, speed), linear.modes(run.vehicle, speed)
        for name in ("weave", "capsize"):
            yield Mode(run.vehicle.name, speed, name, getattr(measured, name), getattr(published, name))


def _mode_errors(modes: Sequence[Mode], time_step: float) -> Iterator[Check]:
    """Weave and capsize eigenvalues, within 0.04 1/s at 1 ms and 0.2 1/s at 5 ms."""
    limit = _step_limit(0.04, 0.2, time_step)
    for name, title, mode, part in (
        ("weave_real", "weave real part", "weave", np.real),
        ("weave_imaginary", "weave imaginary part", "weave", np.imag),
        ("capsize", "capsize", "capsize", np.real),
    ):
        errors = [part(each.measured) - part(each.published) for each in modes if each.name == mode]
        worst = float(np.abs(errors).max())
        yield Check(f"{name}_error_max_1_s", f"{title}, error, 1/s", worst, 0.0, limit, 0.0)


def _order_check(name: str, title: str, steps: tuple[float, ...], errors: list[float], wanted: float) -> Check:
    """Return the check of an order of convergence: the slope of the error over the step in logarithmic scales."""
    order = float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
    return Check(name, title, order, wanted * (1.0 - _ORDER_TOLERANCE), wanted * (1.0 + _ORDER_TOLERANCE), wanted)


def _mode_order(run: Run) -> Iterator[Check]:
    """The error of the weave falls with the power of the step that belongs to the method of integration."""
    steps, speed = _ORDER_STEPS[run.kind], 6.0
    published = linear.modes(run.vehicle, speed).weave
    errors = []
    for step in steps:
        engine = _coaster(run, step)
        errors.append(abs(linear.measured_modes(engine, speed).weave - published))
    yield _order_check("mode_error_order", "weave, order of the error", steps, errors, _ORDER[run.kind])


def front_direction(engine: BicycleEngine, roll: float, steer: float) -> float:
    """Return in which direction the front contact moves against the rear frame's yaw, measured by rolling a step.

    Args:
        engine: an engine whose vehicle has no gravity.
        roll: roll angle, rad.
        steer: steering angle, rad, which the drive holds.
    """
    state = np.zeros(st.STATE_SIZE)
    state[st.ROLL], state[st.STEER], state[st.FRONT_WHEEL_RATE] = roll, steer, 1.0
    engine.reset(state)
    _press(engine)
    engine.hold(steer, 1)
    after = engine.state()
    p = engine.vehicle.parameters
    (x0, y0), (x1, y1) = kinematics.front_contact(state, p), kinematics.front_contact(after, p)
    # the mean of the yaw: within the step the frame turns along
    return math.atan2(y1 - y0, x1 - x0) - 0.5 * after[st.YAW]


def _front_directions(run: Run) -> Iterator[Check]:
    """Table 8, by rolling; for other vehicles than its own, Eq. (A.10) is what they are compared with."""
    engine = make_bicycle_engine(run.kind, replace(run.vehicle, g=0.0), min(run.time_step, 0.001))
    errors = []
    for roll_deg, steer_deg, published in TABLE_8:
        roll, steer = math.radians(roll_deg), math.radians(steer_deg)
        if run.vehicle.name != "whipple":
            published = math.degrees(kinematics.front_direction(roll, steer, run.vehicle.parameters))
        errors.append(abs(math.degrees(front_direction(engine, roll, steer)) - published))
    title = "Table 8, error, deg"
    yield Check("front_direction_error_max_deg", title, max(errors), 0.0, 0.1, 0.0)


def _press(engine: BicycleEngine) -> None:
    """Hold the wheels to the ground for the next step where contacts are one-sided."""
    if isinstance(engine, PyBulletEngine):
        engine.press(_PRESS)


def steering_step(engine: BicycleEngine, steer_set: float, duration: float) -> NDArray[np.float64]:
    """Return the steering angle, rad, after each step from standstill at a constant set point.

    Args:
        engine: an engine whose vehicle has no gravity.
        steer_set: set point, rad.
        duration: s.
    """
    engine.reset(np.zeros(st.STATE_SIZE))
    angles = []
    for _ in range(round(duration / engine.time_step)):
        _press(engine)
        engine.hold(steer_set, 1)
        angles.append(engine.state()[st.STEER])
    return np.array(angles)


def _steering_step(run: Run) -> Iterator[Check]:
    """Appendix B: from standstill, without gravity, to 70 degrees, with at most 10 % of overshoot."""
    target = math.radians(70.0)
    peaks = []
    for kind, step in ((run.kind, run.time_step), ("whipple", _REFERENCE_STEP)):
        engine = make_bicycle_engine(kind, replace(run.vehicle, g=0.0), step)
        peaks.append(100.0 * (float(steering_step(engine, target, 1.5).max()) / target - 1.0))
    yield Check("steering_overshoot_percent", "steering step, overshoot, %", peaks[0], 0.0, 10.0, peaks[1])


def _speed_loss(run: Run) -> Iterator[Check]:
    """Speed lost in 60 s of straight coasting where the bicycle balances itself, under 0.01 %."""
    speed = 0.5 * (linear.weave_speed(run.vehicle) + linear.capsize_speed(run.vehicle))
    engine = _coaster(run)
    engine.reset(st.upright_state(speed, run.vehicle.rF))
    engine.hold(0.0, round(60.0 / run.time_step))
    left = engine.state()[st.FRONT_WHEEL_RATE] * run.vehicle.rF
    loss = 100.0 * abs(1.0 - left / speed)
    yield Check("speed_loss_60_s_percent", "speed lost in 60 s, %", loss, 0.0, 0.01, 0.0)


def violent_start(vehicle: Vehicle) -> StateVector:
    """Return the hard start: 4.6 m/s, just above the weave speed, and a roll rate of 0.5 rad/s."""
    state = st.upright_state(4.6, vehicle.rF)
    state[st.ROLL_RATE] = 0.5
    return state


def coast(engine: BicycleEngine, start: StateVector, duration: float, interval: float = 0.05) -> NDArray[np.float64]:
    """Return the states of a ride with set point zero at each interval, the start first, shape (n, 10)."""
    steps = max(1, round(interval / engine.time_step))
    engine.reset(start)
    states = [engine.state()]
    for _ in range(round(duration / (steps * engine.time_step))):
        engine.hold(0.0, steps)
        states.append(engine.state())
    return np.array(states)


def _coasting(run: Run) -> Iterator[Check]:
    """Energy, mirror image and ground constraint over 10 s after the hard start."""
    start = violent_start(run.vehicle)
    engine = _coaster(run)
    ride = coast(engine, start, 10.0)
    mirrored = coast(engine, start * st.MIRROR_SIGNS, 10.0)
    energies = np.array([bd.energy(state, run.vehicle) for state in ride])
    rest = bd.energy(np.zeros(st.STATE_SIZE), run.vehicle)
    drift = 100.0 * float(np.abs(energies / energies[0] - 1.0).max()) * energies[0] / (energies[0] - rest)
    limit = _step_limit(0.05, 0.25, run.time_step)
    yield Check("energy_drift_percent", "energy drift, % of kinetic", drift, 0.0, limit, 0.0)
    asymmetry = float(np.abs(mirrored * st.MIRROR_SIGNS - ride).max())
    yield Check("mirror_error_max", "mirror image of a ride, error", asymmetry, 0.0, 1e-6, 0.0)
    if isinstance(engine, PyBulletEngine):  # the other engine has no pitch of its own
        error = math.degrees(_pitch_error(engine, start))
        yield Check("pitch_error_max_deg", "pitch to touch ground, error, deg", error, 0.0, 0.001, 0.0)


def _pitch_error(engine: PyBulletEngine, start: StateVector) -> float:
    """Return the largest difference, rad, of Bullet's pitch and Eq. (C.7) in 2 s after the start."""
    engine.reset(start)
    worst = 0.0
    for _ in range(round(2.0 / engine.time_step)):
        engine.hold(0.0, 1)
        state = engine.state()
        nose = vectors.rotate(engine.bodies().orientations[bd.REAR_FRAME], np.array([1.0, 0.0, 0.0]))
        # the x axis of Rz(yaw) Rx(roll) Ry(pitch) points down by sin(pitch) cos(roll)
        pitch = math.asin(-nose[2] / math.cos(state[st.ROLL]))
        worst = max(worst, abs(pitch - kinematics.pitch(state[st.ROLL], state[st.STEER], engine.vehicle.parameters)))
    return worst


def _violent_start(run: Run) -> Iterator[Check]:
    """2 s after the hard start converge to the compiled bicycle: with the right order, and to nothing else."""
    start, steps = violent_start(run.vehicle), _ORDER_STEPS[run.kind]
    oracle = make_bicycle_engine("whipple", free_of_drive(run.vehicle), _REFERENCE_STEP)
    wanted = coast(oracle, start, 2.0)
    watched = [st.YAW, st.ROLL, st.STEER]
    rides = []
    for step in steps:
        engine = _coaster(run, step)
        rides.append(coast(engine, start, 2.0)[:, watched])
    errors = [float(np.abs(ride - wanted[:, watched]).max()) for ride in rides]
    expected = _ORDER[run.kind]
    yield _order_check("violent_start_order", "hard start, order of the error", steps, errors, expected)
    # Two steps and the order give the limit for a vanishing step (Richardson), which must be the other engine's ride.
    gain = 2.0**expected
    limit = (gain * rides[-1] - rides[-2]) / (gain - 1.0)
    remaining = math.degrees(float(np.abs(limit - wanted[:, watched]).max()))
    title = "hard start, step to 0, error, deg"
    yield Check("violent_start_limit_error_max_deg", title, remaining, 0.0, 0.1, 0.0)
