"""Simulated superbikes measured against statics and closed formulas.

Every figure comes from riding the engine; nothing is adjusted for the occasion but where a check says so (electronics
off to find the limits they guard). `bike validate` prints the result; the tests hold the quick part of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.engine import NO_FALL
from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.superbike import statics
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.constants import holding_torque
from bike_sim.physics.superbike.engine import TIME_STEP, CompiledSuperbikeEngine, SuperbikeEngine
from bike_sim.physics.superbike.modes import holding_throttle, measure_modes
from bike_sim.planning.envelope import envelope
from bike_sim.schema import GRAVITY, SIGNALS
from bike_sim.validation.report import Check, Mode, Report
from bike_sim.vehicles.superbike import Superbike

signal = SIGNALS.index

FloatArray = NDArray[np.float64]
Pair = tuple[float, float]
Command = Callable[[float, FloatArray], Pair]
"""Time (s) and telemetry to steering and throttle."""
Machines = Sequence[Superbike]
"""Those that are measured; most parts ride the first alone."""

MACHINES: Final = ("panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr")
SPEEDS: Final = (10.0, 20.0, 30.0, 40.0, 60.0, 80.0, 90.0)
LEANS: Final = (30.0, 50.0, 55.0)
MODE_NAMES: Final = ("weave", "wobble", "capsize")
MODE_SPEEDS: Final = tuple(np.linspace(10.0, 90.0, 17))
PUBLISHED_FROM: Final = 20.0
"""Speed from which frequencies are compared with published ones, m/s; weave slows towards standstill."""
WEAVE_HZ: Final = (1.7, 4.5)
WOBBLE_HZ: Final = (7.0, 10.0)
"""Ranges of Sharp (1971, The stability and control of motorcycles, J. Mech. Eng. Sci. 13) and of Cossalter (2006,
Motorcycle Dynamics, chapter 7) at speed, Hz."""
TRAIL_BRAKING: Final = ((30.0, 0.8), (40.0, 0.6), (45.0, 0.5), (50.0, 0.5), (30.0, 1.0), (50.0, 1.0))
"""Lean, deg, and brake command, from 50 m/s."""
DRIVE_OUT: Final = ((30.0, 1.0), (45.0, 0.7), (45.0, 1.0), (50.0, 1.0))
"""Lean, deg, and throttle, from 30 m/s."""
SHAKE_SPEEDS: Final = (15.0, 20.0, 30.0, 45.0, 60.0, 80.0)
SHAKE_LEANS: Final = (0.0, 15.0, 30.0, 45.0, 55.0)
SHAKE_BRAKES: Final = (0.0, 0.2, 0.4, 0.7, 1.0)
SHAKE_LEAST_SPEED: Final = 8.0
"""Speed down to which it is measured, m/s; a machine that leans and brakes falls below it."""
SHAKE_ALLOWED: Final = 0.05
"""Largest shake, g rms."""
DRIVE_SWINGS: Final = ((45.0, 45.0, 15.0), (45.0, 15.0, 0.0), (55.0, 15.0, -5.0), (65.0, 10.0, 0.0))
"""Speed (m/s) and two leans (deg) between which a machine swings at full drive, with a light front wheel."""
_MEAN_ROWS: Final = 11  # control periods of a mean over 0.2 s
CONVERGENCE_STEPS: Final = (0.004, 0.002, 0.001, 0.0005)
_REFERENCE_STEP: Final = 0.000125
_PERIOD: Final = 0.02  # s between two commands
_KM_H_100: Final = 100.0 / 3.6
_QUARTER_MILE: Final = 402.336  # m
_STANDING: Final = 0.3  # m/s below which a machine stands
_TURN_STEP: Final = 0.001
_TURN_SETTLE: Final = 5.0
_TURN_MEAN: Final = 2.0  # s: integration step of a steady turn, time until it is steady, time of its mean


@dataclass(frozen=True)
class ManoeuvreTrace:
    """A recorded ride, one row a control period.

    Attributes:
        time: s.
        telemetry: columns `schema.SIGNALS`.
        states: columns `schema.STATE`.
        fall: one of `forces.FALL_NAMES`.
    """

    time: FloatArray
    telemetry: FloatArray
    states: FloatArray
    fall: str

    @property
    def lean_error(self) -> float:
        """Largest distance of the lean from the rider's reference, deg; infinite after a fall."""
        if self.fall != NO_FALL:
            return math.inf
        return float(np.degrees(np.abs(self.lean - self.telemetry[:, signal("lean_reference")]).max()))

    @property
    def lean(self) -> FloatArray:
        """Roll angle, rad."""
        return self.states[:, st.ROLL]

    @property
    def speed(self) -> FloatArray:
        """Forward speed, m/s."""
        return self.telemetry[:, signal("speed")]

    def tail(self, duration: float) -> ManoeuvreTrace:
        """Return the last part of it (s)."""
        rows = slice(-max(1, round(duration / _PERIOD)), None)
        return ManoeuvreTrace(self.time[rows], self.telemetry[rows], self.states[rows], self.fall)


def ride(engine: SuperbikeEngine, duration: float, command: Command, ground: Ground = LEVEL) -> ManoeuvreTrace:
    """Ride on from where the engine is and record each control period; a fall ends it."""
    steps = round(_PERIOD / engine.time_step)
    times, telemetry, states = [], [], []
    for k in range(round(duration / _PERIOD)):
        steering, throttle = command(k * _PERIOD, engine.telemetry())
        engine.advance(min(max(steering, -1.0), 1.0), min(max(throttle, -1.0), 1.0), steps, ground)
        times.append((k + 1) * _PERIOD)
        telemetry.append(engine.telemetry())
        states.append(engine.state())
        if engine.fall != NO_FALL:
            break
    return ManoeuvreTrace(np.array(times), np.array(telemetry), np.array(states), engine.fall)


def holding(vehicle: Superbike, speed: float, lean: float | Callable[[float], float]) -> Command:
    """Return a command that holds a speed (m/s) and asks for a lean (deg), constant or over time (s)."""
    largest, ahead = vehicle.virtual_rider.max_lean_deg, holding_throttle(vehicle, speed)
    integral = 0.0

    def command(now: float, telemetry: FloatArray) -> tuple[float, float]:
        nonlocal integral
        error = speed - telemetry[signal("speed")]
        integral = min(max(integral + 0.2 * error * _PERIOD, -0.5), 0.5)
        wanted = lean(now) if callable(lean) else lean
        return -wanted / largest, min(max(ahead + 0.3 * error + integral, -0.3), 1.0)

    return command


def constant(vehicle: Superbike, lean: float, throttle: float) -> Command:
    """Return a command that holds a lean (deg) and a throttle."""
    steering = -lean / vehicle.virtual_rider.max_lean_deg
    return lambda now, telemetry: (steering, throttle)


_Engine = TypeVar("_Engine", bound=SuperbikeEngine)


def at_speed(engine: _Engine, speed: float, lean: float = 0.0, settle: float = 1.0) -> _Engine:
    """Bring an engine to steady riding at a speed (m/s) and a lean (deg), for `settle` seconds."""
    engine.reset(st.upright_state(speed, engine.vehicle.rF))
    ride(engine, settle, holding(engine.vehicle, speed, lean))
    return engine


def without_electronics(vehicle: Superbike) -> Superbike:
    """Return the machine with all aids off."""
    off = replace(
        vehicle.electronics, traction_control=0.0, wheelie_control=0.0, brake_control=0.0, stoppie_control=0.0
    )
    return replace(vehicle, electronics=off)


def validate(
    machines: Sequence[Superbike], time_step: float = TIME_STEP, progress: Callable[[str], None] = lambda part: None
) -> Report:
    """Measure everything, about a minute for five machines.

    Args:
        machines: to measure; most parts ride the first alone.
        time_step: integration step, s.
        progress: called with a few words before each part.
    """
    report = Report()
    for title, part in PARTS:
        progress(title)
        report.checks += part(machines, time_step)
    progress("modes")
    ranges: list[dict[str, Any]] = []
    for hands in (False, True):
        found = measured_modes(machines, hands)
        report.checks += check_modes(found, hands)
        ranges += mode_ranges(found, hands)
        report.modes += [] if hands else found
    progress("road tests")
    report.tables = {"ranges": ranges, "performance": [measure_performance(each, time_step) for each in machines]}
    return report


def check_kick(machines: Machines, time_step: float) -> Iterator[Check]:
    """Straight running after a kick of 0.3 rad/s of roll rate: comes back, and stays."""
    vehicle, largest, rest = machines[0], 0.0, 0.0
    engine = BulletSuperbikeEngine(vehicle, time_step)
    for speed in SPEEDS:
        start = st.upright_state(speed, vehicle.rF)
        start[st.ROLL_RATE] = 0.3
        engine.reset(start)
        recorded = ride(engine, 4.0, holding(vehicle, speed, 0.0))
        largest = max(largest, recorded.lean_error)
        rest = max(rest, float(np.degrees(np.ptp(recorded.lean[-50:]))))
    title = "straight running, kick of 0.3 rad/s: largest lean, deg"
    yield Check("kick_lean_deg", title, largest, 0.0, 3.0)
    yield Check("kick_rest_deg", "lean that moves after 3 s of it, deg", rest, 0.0, 0.05)


def check_lean_steps(machines: Machines, time_step: float) -> Iterator[Check]:
    """Lean from upright to 30, 50 and 55 deg, and the steady turn that follows against the closed formula."""
    vehicle = machines[0]
    engine = BulletSuperbikeEngine(vehicle, time_step)
    for lean in LEANS:
        worst, formula_error = 0.0, 0.0
        for speed in SPEEDS:
            at_speed(engine, speed)
            recorded = ride(engine, 6.0, holding(vehicle, speed, lean))
            worst = max(worst, recorded.lean_error)
            formula_error = max(formula_error, lateral_error(vehicle, recorded.tail(1.0)))
        yield Check(
            f"lean_step_{lean:.0f}_error_deg", f"lean step to {lean:.0f} deg: largest error, deg", worst, 0.0, 3.0
        )
        title = f"steady lateral acceleration at {lean:.0f} deg, share off the formula"
        yield Check(f"lateral_{lean:.0f}_error", title, formula_error, 0.0, 0.03)


def lateral_error(vehicle: Superbike, turn: ManoeuvreTrace) -> float:
    """Return the share by which a steady turn misses the closed form of its lateral acceleration."""
    measured = -float(turn.telemetry[:, signal("acceleration_lat")].mean())
    expected = statics.steady_lateral(vehicle, float(turn.lean.mean()), float(turn.speed.mean()))
    return abs(measured / expected - 1.0) if turn.fall == NO_FALL else math.inf


def check_slaloms(machines: Machines, time_step: float) -> Iterator[Check]:
    """Slalom of 45 deg to either side in 4 s, up to 80 m/s."""
    vehicle, worst = machines[0], 0.0
    engine = BulletSuperbikeEngine(vehicle, time_step)
    for speed in (10.0, 20.0, 40.0, 60.0, 80.0):
        recorded = ride(at_speed(engine, speed), 10.0, holding(vehicle, speed, _slalom))
        worst = max(worst, recorded.lean_error)
    title = "slalom of 45 deg in 4 s: largest error to the rider's reference, deg"
    yield Check("slalom_error_deg", title, worst, 0.0, 5.0)


def _slalom(now: float) -> float:
    return 45.0 * math.sin(0.5 * math.pi * now)


def check_trail_braking(machines: Machines, time_step: float) -> Iterator[Check]:
    """Braking into and driving out of turns with the electronics on: no falls; with them off: falls, by name."""
    vehicle, falls = machines[0], 0
    engine = BulletSuperbikeEngine(vehicle, time_step)
    for lean, brake in TRAIL_BRAKING:
        at_speed(engine, 50.0, lean, 2.5)
        falls += ride(engine, 2.0, constant(vehicle, lean, -brake)).fall != NO_FALL
    for lean, throttle in DRIVE_OUT:
        at_speed(engine, 30.0, lean, 2.5)
        falls += ride(engine, 3.0, constant(vehicle, lean, throttle)).fall != NO_FALL
    title = f"falls in {len(TRAIL_BRAKING)} trail brakings and {len(DRIVE_OUT)} drives out"
    yield Check("aided_falls", title, float(falls), 0.0, 0.0)
    bare = without_electronics(vehicle)
    engine = at_speed(BulletSuperbikeEngine(bare, time_step), 50.0, 50.0, 2.5)
    slid = ride(engine, 3.0, constant(bare, 50.0, -1.0)).fall == "low_side"
    yield Check("bare_low_side", "full brake at 50 deg without electronics is a low side", float(slid), 1.0, 1.0)


def check_holding_torque(machines: Machines, time_step: float) -> Iterator[Check]:
    """Steering torque of steady turns against the closed formula."""
    vehicle, worst = machines[0], 0.0
    engine = CompiledSuperbikeEngine(vehicle, time_step)
    for speed in (20.0, 40.0, 80.0):
        for lean in (15.0, 30.0, 45.0, 55.0):
            tail = ride(at_speed(engine, speed), 6.0, holding(vehicle, speed, lean)).tail(1.0)
            roll, now = float(tail.lean.mean()), float(tail.speed.mean())
            measured = float(tail.telemetry[:, signal("steer_torque")].mean())
            worst = max(worst, abs(measured - holding_torque(vehicle, roll, now)))
    title = "steering torque of steady turns, off the formula, N m"
    yield Check("holding_torque_error_nm", title, worst, 0.0, 6.0)


def check_shake(machines: Machines, time_step: float) -> Iterator[Check]:
    """Lateral acceleration above 3 Hz in turns, coasting, on the brake and at full drive, all machines."""
    leaning, upright, driven = 0.0, 0.0, 0.0
    for machine in machines:
        for (_, lean, brake), value in measure_shake(machine, time_step).items():
            leaning = max(leaning, value)
            if lean == 0.0 or brake == 0.0:
                upright = max(upright, value)
        driven = max([driven, *(drive_shake(machine, time_step, *swing) for swing in DRIVE_SWINGS)])
    for name, title, value in (
        ("shake_steady_g", "shake upright on the brake and in turns without, g rms", upright),
        ("shake_g", f"shake to {SHAKE_LEANS[-1]:.0f} deg with any brake, g rms", leaning),
        ("shake_drive_g", "shake at full drive out of a lean, g rms", driven),
    ):
        yield Check(name, title, value, 0.0, SHAKE_ALLOWED)


def measure_shake(
    vehicle: Superbike, time_step: float, speeds: tuple[float, ...] = SHAKE_SPEEDS,
    leans: tuple[float, ...] = SHAKE_LEANS, brakes: tuple[float, ...] = SHAKE_BRAKES,
) -> dict[tuple[float, float, float], float]:  # fmt: skip
    """Return the shake of steady turns in which the brake is pulled, g rms, infinite after a fall.

    It is what a mean over 0.2 s leaves of the lateral acceleration, from 0.5 to 2 s after the brake was pulled or until
    the machine is down to 8 m/s.

    Args:
        vehicle: the machine.
        time_step: integration step, s.
        speeds: m/s.
        leans: deg.
        brakes: commands.

    Returns:
        By speed, lean and brake command.
    """
    engine, found = CompiledSuperbikeEngine(vehicle, time_step), {}
    for speed in speeds:
        for lean in leans:
            for brake in brakes:
                at_speed(engine, speed, lean, 2.0)
                command = constant(vehicle, lean, -brake) if brake else holding(vehicle, speed, lean)
                recorded = ride(engine, 2.0, command)
                down = recorded.fall != "none" and recorded.speed.min() > SHAKE_LEAST_SPEED
                found[speed, lean, brake] = math.inf if down else shake_of(recorded)
    return found


def drive_shake(vehicle: Superbike, time_step: float, speed: float, lean: float, after: float) -> float:
    """Return the shake of a swing from one lean to another (deg) at full drive from a speed (m/s), g rms."""
    engine, largest = CompiledSuperbikeEngine(vehicle, time_step), vehicle.virtual_rider.max_lean_deg
    at_speed(engine, speed, lean, 2.0)
    recorded = ride(engine, 4.0, lambda now, telemetry: (-(lean if now < 0.5 else after) / largest, 1.0))
    return math.inf if recorded.fall != "none" else shake_of(recorded, begin=1.3)


def shake_of(recorded: ManoeuvreTrace, begin: float = 0.5) -> float:
    """Return the lateral acceleration that a mean over 0.2 s leaves, g rms, from a time (s) on and above 8 m/s."""
    rows = (recorded.time > begin) & np.minimum.accumulate(recorded.speed > SHAKE_LEAST_SPEED)
    shaken = shaking(recorded.telemetry[rows, signal("acceleration_lat")] / GRAVITY)
    return float(np.sqrt(np.mean(shaken**2))) if len(shaken) else 0.0


def shaking(lateral: FloatArray) -> FloatArray:
    """Return what a mean over 0.2 s leaves of a lateral acceleration that is given each control period of 0.02 s.

    It is as many values shorter as the mean is long, less one, and empty where the ride is no longer than the mean.
    """
    if len(lateral) <= _MEAN_ROWS:
        return np.empty(0)
    half = _MEAN_ROWS // 2
    return lateral[half:-half] - np.convolve(lateral, np.full(_MEAN_ROWS, 1.0 / _MEAN_ROWS), mode="valid")


def check_pitch_limits(machines: Machines, time_step: float) -> Iterator[Check]:
    """Braking force and thrust at which a wheel leaves the ground, squeezed slowly, against statics."""
    vehicle = machines[0]
    brakes = replace(vehicle.brakes, front_share=1.0, force=1.6 * vehicle.mass * GRAVITY)
    # a rear wheel that loses its load would spin down under engine braking and push the nose down besides
    bare = replace(without_electronics(vehicle), brakes=brakes, motor=replace(vehicle.motor, engine_brake=0.0))
    for name, start, load, duration, sign in (
        ("stoppie", 85.0, signal("rear_load"), 5.0, -1.0),
        ("wheelie", 15.0, signal("front_load"), 2.5, 1.0),
    ):

        def squeezing(now: float, telemetry: FloatArray, sign: float = sign, duration: float = duration) -> Pair:
            return 0.0, sign * min(1.0, now / duration)

        engine = at_speed(BulletSuperbikeEngine(bare, time_step), start, settle=0.5)
        squeeze = ride(engine, 2.0 * duration, squeezing)
        lifted = int(np.argmax(squeeze.telemetry[:, load] <= 0.0))
        row = squeeze.telemetry[max(0, lifted - 1)]
        expected = _lifting_force(bare, float(row[signal("speed")]), sign)
        measured = abs(float(row[signal("front_force_long")] + row[signal("rear_force_long")])) if lifted else math.nan
        title = f"{name}: force that lifts a wheel, by statics"
        yield Check(f"{name}_force_ratio", title, measured / expected, 0.96, 1.04)
        yield Check(f"{name}_named", f"squeezing on ends in a {name}", float(squeeze.fall == name), 1.0, 1.0)


def _lifting_force(vehicle: Superbike, speed: float, sign: float) -> float:
    """Return the force at which a wheel lifts, N, by statics: the front with thrust (1), the rear with brakes (-1).

    The machine pitches on its tyres until one carries all, which moves its weight the same way.
    """
    loads = statics.wheel_loads(vehicle, 0.0, speed, 0.0)
    more = statics.wheel_loads(vehicle, 0.0, speed, sign * 1000.0)
    index = 1 if sign > 0.0 else 0
    tyres = (vehicle.rear_tyre, vehicle.front_tyre)
    # the other wheel gains what this one loses
    pitch = loads[index] * sum(1.0 / tyre.stiffness for tyre in tyres) / vehicle.w
    moved = vehicle.mass * vehicle.g * vehicle.centre_of_mass[1] * pitch / vehicle.w
    return 1000.0 * (loads[index] - moved) / (loads[index] - more[index])


def check_mirror(machines: Machines, time_step: float) -> Iterator[Check]:
    """The same ride to the left and to the right."""
    engine, rides = BulletSuperbikeEngine(machines[0], time_step), []
    for side in (1.0, -1.0):

        def weaving(now: float, telemetry: FloatArray, side: float = side) -> Pair:
            return side * 0.7 * math.sin(2.0 * now), 0.5 * math.sin(now)

        rides.append(ride(at_speed(engine, 35.0), 5.0, weaving).states)
    difference = math.degrees(np.abs(rides[0] - rides[1] * st.MIRROR_SIGNS)[:, st.ROLL].max())
    title = "left against right slalom with throttle and brake, deg"
    yield Check("mirror_lean_deg", title, difference, 0.0, 1e-6)


def check_convergence(machines: Machines, time_step: float) -> Iterator[Check]:
    """Turn in, brake, drive out at several steps against a very fine one."""

    def command(now: float, telemetry: FloatArray) -> Pair:
        return (-0.75 if 0.5 < now < 3.0 else 0.4), (-0.5 if now < 1.0 else 0.3 if now < 2.0 else 0.6)

    def lap_piece(step: float) -> ManoeuvreTrace:
        return ride(at_speed(BulletSuperbikeEngine(machines[0], step), 45.0, settle=0.2), 5.0, command)

    reference, errors = lap_piece(_REFERENCE_STEP), []
    for step in CONVERGENCE_STEPS:
        recorded = lap_piece(step)
        rows = min(len(recorded.time), len(reference.time))
        lean = np.degrees(np.abs(recorded.lean[:rows] - reference.lean[:rows]).max())
        errors.append(float(lean) if recorded.fall == reference.fall == NO_FALL else math.inf)
    order = float(np.polyfit(np.log(CONVERGENCE_STEPS), np.log(errors), 1)[0])
    yield Check("convergence_order", "order in which the error of lean falls with the step", order, 0.8, 2.2)
    at_step = float(np.interp(time_step, CONVERGENCE_STEPS[::-1], errors[::-1]))
    title = "error of lean by the step over 5 s of brake, turn and drive, deg"
    yield Check("step_lean_error_deg", title, at_step, 0.0, 0.5)


def check_compiled(machines: Machines, time_step: float) -> Iterator[Check]:
    """The same 60 s of slalom in Bullet and in the compiled engine, which share no dynamics."""
    vehicle, rides = machines[0], []
    for kind in (BulletSuperbikeEngine, CompiledSuperbikeEngine):
        engine: SuperbikeEngine = at_speed(kind(vehicle, time_step), 35.0, settle=0.2)
        rides.append(ride(engine, 60.0, holding(vehicle, 35.0, _slalom)))
    same = rides[0].states.shape == rides[1].states.shape and rides[0].fall == rides[1].fall == NO_FALL
    difference = np.abs(rides[0].states - rides[1].states) if same else np.full((1, st.STATE_SIZE), math.inf)
    place, lean = float(difference[:, :2].max()), math.degrees(difference[:, st.ROLL].max())
    yield Check("compiled_place_m", "compiled engine against Bullet over 60 s: place, m", place, 0.0, 1e-6)
    yield Check("compiled_lean_deg", "and lean, deg", lean, 0.0, 1e-6)


def check_machines(machines: Machines, time_step: float) -> Iterator[Check]:
    """Full throttle from 10 m/s to top speed and full brake from 80 to 10 m/s, against the envelopes, all machines."""
    drive_error, brake_error, worst_step = 0.0, 0.0, 0.0
    for machine in machines:
        limits, engine = envelope(machine), BulletSuperbikeEngine(machine, time_step)
        launch = ride(at_speed(engine, 10.0), 30.0, constant(machine, 0.0, 1.0))
        stop = ride(at_speed(engine, 80.0), 12.0, _braking(10.0))
        drive_error = max(drive_error, _time_error(launch, limits.drive, 20.0, 75.0))
        brake_error = max(brake_error, _time_error(stop, limits.brake, 75.0, 20.0))
        for speed in (10.0, 30.0, 60.0):
            step = ride(at_speed(engine, speed), 4.0, holding(machine, speed, 50.0))
            worst_step = max(worst_step, step.lean_error)
    title = "all machines, lean step to 50 deg: largest error, deg"
    yield Check("machines_lean_error_deg", title, worst_step, 0.0, 3.5)
    yield Check("launch_time_error", "time from 20 to 75 m/s, share off the envelope's", drive_error, 0.0, 0.04)
    yield Check("stop_time_error", "time from 75 to 20 m/s, share off the envelope's", brake_error, 0.0, 0.04)


def _braking(to: float) -> Command:
    """Return a command that brakes fully down to a speed, m/s."""
    return lambda now, telemetry: (0.0, -1.0 if telemetry[signal("speed")] > to else 0.0)


def measure_performance(vehicle: Superbike, time_step: float = TIME_STEP) -> dict[str, Any]:
    """Return what road tests measure: full throttle for a minute, then full brakes, with all electronics; level road.

    Args:
        vehicle: the machine.
        time_step: integration step, s.

    Returns:
        By name: seconds to 100 km/h and over a quarter mile from standstill, the speed there, the largest speed, and
        the distance of a full stop from 100 km/h.
    """
    engine = CompiledSuperbikeEngine(vehicle, time_step)
    engine.reset(st.upright_state(0.0, vehicle.rF))
    launch = ride(engine, 60.0, constant(vehicle, 0.0, 1.0))
    distance = np.cumsum(launch.speed) * _PERIOD
    quarter = float(np.interp(_QUARTER_MILE, distance, launch.time))
    first = float(at_speed(engine, _KM_H_100).telemetry()[signal("speed")])
    stop = ride(engine, 10.0, _braking(_STANDING))
    moving = np.minimum.accumulate(stop.speed > _STANDING)
    stands = launch.fall == NO_FALL
    return {
        "vehicle": vehicle.name,
        "to_100_s": float(np.interp(_KM_H_100, launch.speed, launch.time)) if stands else math.inf,
        "quarter_mile_s": quarter if stands else math.inf,
        "quarter_mile_km_h": 3.6 * float(np.interp(quarter, launch.time, launch.speed)),
        "top_km_h": 3.6 * float(launch.speed.max()),
        "stop_100_m": float(np.trapezoid([first, *stop.speed[moving]], dx=_PERIOD))
        if stop.fall == NO_FALL
        else math.inf,
    }


def steady_turns(vehicle: Superbike, speeds: Sequence[float], rolls: Sequence[float]) -> Iterator[ManoeuvreTrace]:
    """Yield the last two seconds of steady turns to the right at speeds (m/s) and leans (rad), on the compiled engine.

    Args:
        vehicle: the machine.
        speeds: m/s.
        rolls: at each of them, rad.
    """
    engine = CompiledSuperbikeEngine(vehicle, _TURN_STEP)
    for speed in speeds:
        for roll in rolls:
            lean = math.degrees(roll)
            at_speed(engine, speed, lean, _TURN_SETTLE)
            yield ride(engine, _TURN_MEAN, holding(vehicle, speed, lean))


def _time_error(
    recorded: ManoeuvreTrace, acceleration: Callable[[FloatArray], FloatArray], start: float, end: float
) -> float:
    """Return by which share the time between two speeds differs from that of an acceleration or a deceleration."""
    if recorded.fall != "none":
        return math.inf
    speeds = np.linspace(start, end, 500)
    expected = abs(float(np.trapezoid(1.0 / acceleration(speeds), speeds)))
    sign = math.copysign(1.0, end - start)
    measured = np.interp((sign * end, sign * start), sign * recorded.speed, recorded.time)
    return abs(float(measured[0] - measured[1]) / expected - 1.0)


def measured_modes(machines: Machines, hands: bool) -> list[Mode]:
    """Return weave, wobble and capsize in straight running, with the hands off or on the bars."""
    return [
        Mode(machine.name, float(speed), name, getattr(modes, name))
        for machine in machines
        for speed in MODE_SPEEDS
        for modes in (measure_modes(machine, float(speed), hands=hands),)
        for name in MODE_NAMES
    ]


def check_modes(found: Sequence[Mode], hands: bool) -> Iterator[Check]:
    """Weave, wobble and capsize in straight running, with the hands off or on the bars."""
    prefix, how = ("held_", "hands on") if hands else ("", "hands off")
    largest = {name: max(np.real([mode.measured for mode in found if mode.name == name])) for name in MODE_NAMES}
    for name in ("weave", "wobble"):
        title = f"{name}, {how}, least damped, 10 to 90 m/s, 1/s"
        yield Check(f"{prefix}{name}_real_1_s", title, largest[name], -math.inf, 0.0)
    if not hands:
        title = "capsize, fastest, 1/s; a rider catches it easily"
        yield Check("capsize_1_s", title, largest["capsize"], -math.inf, 3.5)


def mode_ranges(found: Sequence[Mode], hands: bool) -> Iterator[dict[str, Any]]:
    """Yield ranges of frequencies beside published ones, for a reader to judge; they fail no validation."""
    for name, published in (("weave", WEAVE_HZ), ("wobble", WOBBLE_HZ)):
        fast = [mode.measured for mode in found if mode.name == name and mode.speed >= PUBLISHED_FROM]
        hertz = np.imag(fast) / (2.0 * math.pi)
        low, high = float(hertz.min()), float(hertz.max())
        yield {
            "title": f"{name}, {'hands on' if hands else 'hands off'}, 20 to 90 m/s, Hz",
            "low": low,
            "high": high,
            "published_low": published[0],
            "published_high": published[1],
            "within": published[0] <= low and high <= published[1],
        }


PARTS: Final = (
    ("straight running", check_kick),
    ("lean steps", check_lean_steps),
    ("slaloms", check_slaloms),
    ("trail braking and driving out", check_trail_braking),
    ("limits of wheelie and stoppie", check_pitch_limits),
    ("steering torque of steady turns", check_holding_torque),
    ("shake", check_shake),
    ("mirror symmetry", check_mirror),
    ("convergence", check_convergence),
    ("compiled against Bullet", check_compiled),
    ("launch and stop", check_machines),
)
"""Parts of the validation but modes and road tests."""
