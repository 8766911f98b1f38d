"""Simulated superbikes measured against statics and closed formulas.

Every figure comes from riding the engine; nothing is adjusted for the occasion but where a check says so (electronics
off to find the limits they guard). `bike validate` prints the result; the tests hold the quick part of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.engine import NO_FALL
from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.superbike import statics
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.constants import holding_torque
from bike_sim.physics.superbike.engine import TIME_STEP, CompiledSuperbikeEngine, SuperbikeEngine
from bike_sim.physics.superbike.modes import SuperbikeModes, holding_throttle, measure_modes
from bike_sim.planning.envelope import envelope
from bike_sim.schema import GRAVITY, SIGNALS
from bike_sim.validation.report import Check, Report
from bike_sim.vehicles.superbike import Superbike

signal = SIGNALS.index

FloatArray = NDArray[np.float64]
Command = Callable[[float, FloatArray], tuple[float, float]]
"""Time (s) and telemetry to steering and throttle."""
Figures = Iterator[tuple[str, float]]
"""Names of `LIMITS` and values."""

MACHINES: Final = ("panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr")
SPEEDS: Final = (10.0, 20.0, 30.0, 40.0, 60.0, 80.0, 90.0)
LEANS: Final = (30.0, 50.0, 55.0)
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

LIMITS: Final[dict[str, tuple[str, float, float]]] = {
    "kick_lean_deg": ("straight running, kick of 0.3 rad/s: largest lean, deg", 0.0, 3.0),
    "kick_rest_deg": ("lean that moves after 3 s of it, deg", 0.0, 0.05),
    **{
        f"lean_step_{lean:.0f}_error_deg": (f"lean step to {lean:.0f} deg: largest error, deg", 0.0, 3.0)
        for lean in LEANS
    },
    **{
        f"lateral_{lean:.0f}_error": (
            f"steady lateral acceleration at {lean:.0f} deg, share off the formula",
            0.0,
            0.03,
        )
        for lean in LEANS
    },
    "slalom_error_deg": ("slalom of 45 deg in 4 s: largest error to the rider's reference, deg", 0.0, 5.0),
    "aided_falls": (f"falls in {len(TRAIL_BRAKING)} trail brakings and {len(DRIVE_OUT)} drives out", 0.0, 0.0),
    "bare_low_side": ("full brake at 50 deg without electronics is a low side", 1.0, 1.0),
    "stoppie_force_ratio": ("stoppie: force that lifts a wheel, by statics", 0.96, 1.04),
    "stoppie_named": ("squeezing on ends in a stoppie", 1.0, 1.0),
    "wheelie_force_ratio": ("wheelie: force that lifts a wheel, by statics", 0.96, 1.04),
    "wheelie_named": ("squeezing on ends in a wheelie", 1.0, 1.0),
    "holding_torque_error_nm": ("steering torque of steady turns, off the formula, N m", 0.0, 6.0),
    "shake_steady_g": ("shake upright on the brake and in turns without, g rms", 0.0, SHAKE_ALLOWED),
    "shake_g": (f"shake to {SHAKE_LEANS[-1]:.0f} deg with any brake, g rms", 0.0, SHAKE_ALLOWED),
    "shake_drive_g": ("shake at full drive out of a lean, g rms", 0.0, SHAKE_ALLOWED),
    "mirror_lean_deg": ("left against right slalom with throttle and brake, deg", 0.0, 1e-6),
    "convergence_order": ("order in which the error of lean falls with the step", 0.8, 2.2),
    "step_lean_error_deg": ("error of lean by the step over 5 s of brake, turn and drive, deg", 0.0, 0.5),
    "compiled_place_m": ("compiled engine against Bullet over 60 s: place, m", 0.0, 1e-6),
    "compiled_lean_deg": ("and lean, deg", 0.0, 1e-6),
    "machines_lean_error_deg": ("all machines, lean step to 50 deg: largest error, deg", 0.0, 3.5),
    "launch_time_error": ("time from 20 to 75 m/s, share off the envelope's", 0.0, 0.04),
    "stop_time_error": ("time from 75 to 20 m/s, share off the envelope's", 0.0, 0.04),
    "weave_real_1_s": ("weave, hands off, least damped, 10 to 90 m/s, 1/s", -math.inf, 0.0),
    "wobble_real_1_s": ("wobble, hands off, least damped, 10 to 90 m/s, 1/s", -math.inf, 0.0),
    "capsize_1_s": ("capsize, fastest, 1/s; a rider catches it easily", -math.inf, 3.5),
    "held_weave_real_1_s": ("weave, hands on, least damped, 10 to 90 m/s, 1/s", -math.inf, 0.0),
    "held_wobble_real_1_s": ("wobble, hands on, least damped, 10 to 90 m/s, 1/s", -math.inf, 0.0),
}
"""Titles and limits of all figures."""


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


@dataclass(frozen=True)
class Range:
    """A range of figures beside a published one, for a reader to judge; it fails no validation.

    Attributes:
        name: figure's name with its unit as suffix.
        title: description for people.
        low: smallest.
        high: largest.
        published_low: smallest published.
        published_high: largest published.
    """

    name: str
    title: str
    low: float
    high: float
    published_low: float
    published_high: float

    @property
    def within(self) -> bool:
        """Whether all of it lies in the published range."""
        return self.published_low <= self.low and self.high <= self.published_high


@dataclass(frozen=True)
class Performance:
    """Quantities that road tests measure.

    Attributes:
        vehicle: its name.
        to_100_s: from standstill to 100 km/h.
        quarter_mile_s: from standstill over 402.336 m.
        quarter_mile_km_h: speed there.
        top_km_h: largest speed in a minute at full throttle.
        stop_100_m: distance of a full stop from 100 km/h.
    """

    vehicle: str
    to_100_s: float
    quarter_mile_s: float
    quarter_mile_km_h: float
    top_km_h: float
    stop_100_m: float


@dataclass
class Validation(Report):
    """All that was measured.

    Attributes:
        machines: measured; most parts ride the first alone.
        steps: lean steps of the first machine, by lean (deg) and speed (m/s).
        launches: full throttle from 10 m/s, by machine.
        stops: full brake from 80 m/s, by machine.
        modes: over speed, hands off, by machine.
        ranges: frequencies beside published ones.
        turns: rows of lean (deg), speed (m/s), lateral acceleration measured and by formula (g).
        convergence: rows of step (s), largest error of lean (deg), error of position (m).
        performance: of each machine.
    """

    machines: tuple[Superbike, ...] = field(kw_only=True)
    steps: dict[tuple[float, float], ManoeuvreTrace] = field(default_factory=dict)
    launches: dict[str, ManoeuvreTrace] = field(default_factory=dict)
    stops: dict[str, ManoeuvreTrace] = field(default_factory=dict)
    modes: dict[str, list[SuperbikeModes]] = field(default_factory=dict)
    ranges: list[Range] = field(default_factory=list)
    turns: list[tuple[float, float, float, float]] = field(default_factory=list)
    convergence: list[tuple[float, float, float]] = field(default_factory=list)
    performance: list[Performance] = field(default_factory=list)


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


def holding(vehicle: Superbike, speed: float, lean: Callable[[float], float]) -> Command:
    """Return a command that holds a speed (m/s) and asks for a lean (deg) over time (s)."""
    largest, ahead = vehicle.virtual_rider.max_lean_deg, holding_throttle(vehicle, speed)
    integral = 0.0

    def command(now: float, telemetry: FloatArray) -> tuple[float, float]:
        nonlocal integral
        error = speed - telemetry[signal("speed")]
        integral = min(max(integral + 0.2 * error * _PERIOD, -0.5), 0.5)
        return -lean(now) / largest, min(max(ahead + 0.3 * error + integral, -0.3), 1.0)

    return command


def constant(vehicle: Superbike, lean: float, throttle: float) -> Command:
    """Return a command that holds a lean (deg) and a throttle."""
    steering = -lean / vehicle.virtual_rider.max_lean_deg
    return lambda now, telemetry: (steering, throttle)


def _always(lean: float) -> Callable[[float], float]:
    return lambda now: lean


def _squeezing(sign: float, duration: float) -> Command:
    """Return a command that goes straight and opens throttle (1) or brake (-1) in proportion to time."""
    return lambda now, telemetry: (0.0, sign * min(1.0, now / duration))


def _weaving(side: float) -> Command:
    """Return a slalom with throttle and brake that begins to the left (1) or to the right (-1)."""
    return lambda now, telemetry: (side * 0.7 * math.sin(2.0 * now), 0.5 * math.sin(now))


_Engine = TypeVar("_Engine", bound=SuperbikeEngine)


def at_speed(engine: _Engine, speed: float, lean: float = 0.0, settle: float = 1.0) -> _Engine:
    """Bring an engine to steady riding at a speed (m/s) and a lean (deg), for `settle` seconds."""
    engine.reset(st.upright_state(speed, engine.vehicle.rF))
    ride(engine, settle, holding(engine.vehicle, speed, lambda now: lean))
    return engine


def without_electronics(vehicle: Superbike) -> Superbike:
    """Return the machine with all aids off."""
    off = replace(
        vehicle.electronics, traction_control=0.0, wheelie_control=0.0, brake_control=0.0, stoppie_control=0.0
    )
    return replace(vehicle, electronics=off)


def validate(
    machines: Sequence[Superbike], time_step: float = TIME_STEP, progress: Callable[[str], None] = lambda part: None
) -> Validation:
    """Measure everything, about a minute for five machines.

    Args:
        machines: to measure; most parts ride the first alone.
        time_step: integration step, s.
        progress: called with a few words before each part.
    """
    parts = tuple((title, checks_of(part)) for title, part in PARTS)
    return Validation(time_step, machines=tuple(machines)).measure(parts, progress)


def checks_of(part: Callable[[Validation, Superbike], Figures]) -> Callable[[Validation], Iterator[Check]]:
    """Return a part of the validation as checks against `LIMITS`."""

    def checks(result: Validation) -> Iterator[Check]:
        for name, value in part(result, result.machines[0]):
            title, low, high = LIMITS[name]
            yield Check(name, title, float(value), low, high)

    return checks


def check_kick(result: Validation, vehicle: Superbike) -> Figures:
    """Straight running after a kick of 0.3 rad/s of roll rate: comes back, and stays."""
    largest, rest = 0.0, 0.0
    engine = BulletSuperbikeEngine(vehicle, result.time_step)
    for speed in SPEEDS:
        start = st.upright_state(speed, vehicle.rF)
        start[st.ROLL_RATE] = 0.3
        engine.reset(start)
        recorded = ride(engine, 4.0, holding(vehicle, speed, lambda now: 0.0))
        largest = max(largest, recorded.lean_error)
        rest = max(rest, float(np.degrees(np.ptp(recorded.lean[-50:]))))
    engine.close()
    yield "kick_lean_deg", largest
    yield "kick_rest_deg", rest


def check_lean_steps(result: Validation, vehicle: Superbike) -> Figures:
    """Lean from upright to 30, 50 and 55 deg, and the steady turn that follows against the closed formula."""
    engine = BulletSuperbikeEngine(vehicle, result.time_step)
    for lean in LEANS:
        worst, formula_error = 0.0, 0.0
        for speed in SPEEDS:
            at_speed(engine, speed)
            recorded = ride(engine, 6.0, holding(vehicle, speed, _always(lean)))
            result.steps[lean, speed] = recorded
            worst = max(worst, recorded.lean_error)
            tail = slice(-50, None)
            measured = -float(recorded.telemetry[tail, signal("acceleration_lat")].mean())
            at = float(recorded.speed[tail].mean())
            expected = statics.steady_lateral(vehicle, float(recorded.lean[tail].mean()), at)
            result.turns.append((lean, at, measured / GRAVITY, expected / GRAVITY))
            formula_error = max(formula_error, abs(measured / expected - 1.0))
        yield f"lean_step_{lean:.0f}_error_deg", worst
        yield f"lateral_{lean:.0f}_error", formula_error
    engine.close()


def check_slaloms(result: Validation, vehicle: Superbike) -> Figures:
    """Slalom of 45 deg to either side in 4 s, up to 80 m/s."""
    engine = BulletSuperbikeEngine(vehicle, result.time_step)
    worst = 0.0
    for speed in (10.0, 20.0, 40.0, 60.0, 80.0):
        at_speed(engine, speed)
        recorded = ride(engine, 10.0, holding(vehicle, speed, lambda now: 45.0 * math.sin(0.5 * math.pi * now)))
        worst = max(worst, recorded.lean_error)
    engine.close()
    yield "slalom_error_deg", worst


def check_trail_braking(result: Validation, vehicle: Superbike) -> Figures:
    """Braking into and driving out of turns with the electronics on: no falls; with them off: falls, by name."""
    falls = 0
    engine = BulletSuperbikeEngine(vehicle, result.time_step)
    for lean, brake in TRAIL_BRAKING:
        at_speed(engine, 50.0, lean, 2.5)
        falls += ride(engine, 2.0, constant(vehicle, lean, -brake)).fall != "none"
    for lean, throttle in DRIVE_OUT:
        at_speed(engine, 30.0, lean, 2.5)
        falls += ride(engine, 3.0, constant(vehicle, lean, throttle)).fall != "none"
    engine.close()
    yield "aided_falls", falls
    bare = without_electronics(vehicle)
    engine = BulletSuperbikeEngine(bare, result.time_step)
    at_speed(engine, 50.0, 50.0, 2.5)
    fall = ride(engine, 3.0, constant(bare, 50.0, -1.0)).fall
    engine.close()
    yield "bare_low_side", fall == "low_side"


def check_holding_torque(result: Validation, vehicle: Superbike) -> Figures:
    """Steering torque of steady turns against the closed formula."""
    engine, worst = CompiledSuperbikeEngine(vehicle, result.time_step), 0.0
    for speed in (20.0, 40.0, 80.0):
        for lean in (15.0, 30.0, 45.0, 55.0):
            tail = ride(at_speed(engine, speed), 6.0, holding(vehicle, speed, _always(lean))).tail(1.0)
            roll, now = float(tail.lean.mean()), float(tail.speed.mean())
            measured = float(tail.telemetry[:, signal("steer_torque")].mean())
            worst = max(worst, abs(measured - holding_torque(vehicle, roll, now)))
    yield "holding_torque_error_nm", worst


def check_shake(result: Validation, vehicle: Superbike) -> Figures:
    """Lateral acceleration above 3 Hz in turns, coasting, on the brake and at full drive, all machines."""
    leaning, upright, driven = 0.0, 0.0, 0.0
    for machine in result.machines:
        for (_, lean, brake), value in measure_shake(machine, result.time_step).items():
            leaning = max(leaning, value)
            if lean == 0.0 or brake == 0.0:
                upright = max(upright, value)
        driven = max([driven, *(drive_shake(machine, result.time_step, *swing) for swing in DRIVE_SWINGS)])
    yield "shake_steady_g", upright
    yield "shake_g", leaning
    yield "shake_drive_g", driven


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
                command = constant(vehicle, lean, -brake) if brake else holding(vehicle, speed, _always(lean))
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


def check_pitch_limits(result: Validation, vehicle: Superbike) -> Figures:
    """Braking force and thrust at which a wheel leaves the ground, squeezed slowly, against statics."""
    brakes = replace(vehicle.brakes, front_share=1.0, force=1.6 * vehicle.mass * GRAVITY)
    # a rear wheel that loses its load would spin down under engine braking and push the nose down besides
    bare = replace(without_electronics(vehicle), brakes=brakes, motor=replace(vehicle.motor, engine_brake=0.0))
    for title, start, load, duration, sign in (
        ("stoppie", 85.0, signal("rear_load"), 5.0, -1.0),
        ("wheelie", 15.0, signal("front_load"), 2.5, 1.0),
    ):
        engine = BulletSuperbikeEngine(bare, result.time_step)
        at_speed(engine, start, settle=0.5)
        squeeze = ride(engine, 2.0 * duration, _squeezing(sign, duration))
        engine.close()
        lifted = int(np.argmax(squeeze.telemetry[:, load] <= 0.0))
        row = squeeze.telemetry[max(0, lifted - 1)]
        speed = float(row[signal("speed")])
        expected = _lifting_force(bare, speed, sign)
        measured = abs(float(row[signal("front_force_long")] + row[signal("rear_force_long")])) if lifted else math.nan
        yield f"{title}_force_ratio", measured / expected
        yield f"{title}_named", squeeze.fall == title


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


def check_mirror(result: Validation, vehicle: Superbike) -> Figures:
    """The same ride to the left and to the right."""
    engine = BulletSuperbikeEngine(vehicle, result.time_step)
    rides = []
    for side in (1.0, -1.0):
        at_speed(engine, 35.0)
        rides.append(ride(engine, 5.0, _weaving(side)))
    engine.close()
    difference = np.abs(rides[0].states - rides[1].states * st.MIRROR_SIGNS)[:, st.ROLL].max()
    yield "mirror_lean_deg", math.degrees(difference)


def check_convergence(result: Validation, vehicle: Superbike) -> Figures:
    """Turn in, brake, drive out at several steps against a very fine one."""

    def lap_piece(step: float) -> ManoeuvreTrace:
        engine = BulletSuperbikeEngine(vehicle, step)
        at_speed(engine, 45.0, settle=0.2)

        def command(now: float, telemetry: FloatArray) -> tuple[float, float]:
            return (-0.75 if 0.5 < now < 3.0 else 0.4), (-0.5 if now < 1.0 else 0.3 if now < 2.0 else 0.6)

        recorded = ride(engine, 5.0, command)
        engine.close()
        return recorded

    reference = lap_piece(_REFERENCE_STEP)
    for step in CONVERGENCE_STEPS:
        recorded = lap_piece(step)
        rows = min(len(recorded.time), len(reference.time))
        lean = np.degrees(np.abs(recorded.lean[:rows] - reference.lean[:rows]).max())
        place = np.hypot(*(recorded.states[rows - 1, :2] - reference.states[rows - 1, :2]))
        same = recorded.fall == reference.fall == "none"
        result.convergence.append((step, float(lean) if same else math.inf, float(place) if same else math.inf))
    table = np.array(result.convergence)
    order = float(np.polyfit(np.log(table[:, 0]), np.log(table[:, 1]), 1)[0])
    yield "convergence_order", order
    at_step = float(np.interp(result.time_step, table[::-1, 0], table[::-1, 1]))
    yield "step_lean_error_deg", at_step


def check_compiled(result: Validation, vehicle: Superbike) -> Figures:
    """The same 60 s of slalom in Bullet and in the compiled engine, which share no dynamics."""
    rides = []
    for kind in (BulletSuperbikeEngine, CompiledSuperbikeEngine):
        engine = kind(vehicle, result.time_step)
        at_speed(engine, 35.0, settle=0.2)
        slalom = holding(vehicle, 35.0, lambda now: 45.0 * math.sin(0.5 * math.pi * now))
        rides.append(ride(engine, 60.0, slalom))
        engine.close()
    same = rides[0].states.shape == rides[1].states.shape and rides[0].fall == rides[1].fall == "none"
    difference = np.abs(rides[0].states - rides[1].states) if same else np.full((1, st.STATE_SIZE), math.inf)
    yield "compiled_place_m", difference[:, :2].max()
    yield "compiled_lean_deg", math.degrees(difference[:, st.ROLL].max())


def check_machines(result: Validation, vehicle: Superbike) -> Figures:
    """Full throttle from 10 m/s to top speed and full brake from 80 to 10 m/s, against the envelopes, all machines."""
    drive_error, brake_error, worst_step = 0.0, 0.0, 0.0
    for machine in result.machines:
        limits = envelope(machine)
        engine = BulletSuperbikeEngine(machine, result.time_step)
        at_speed(engine, 10.0)
        launch = ride(engine, 30.0, constant(machine, 0.0, 1.0))
        at_speed(engine, 80.0)
        stop = ride(engine, 12.0, lambda now, telemetry: (0.0, -1.0 if telemetry[signal("speed")] > 10.0 else 0.0))
        result.launches[machine.name], result.stops[machine.name] = launch, stop
        drive_error = max(drive_error, _time_error(launch, limits.drive, 20.0, 75.0))
        brake_error = max(brake_error, _time_error(stop, limits.brake, 75.0, 20.0))
        for speed in (10.0, 30.0, 60.0):
            at_speed(engine, speed)
            step = ride(engine, 4.0, holding(machine, speed, lambda now: 50.0))
            worst_step = max(worst_step, step.lean_error)
        engine.close()
    yield "machines_lean_error_deg", worst_step
    yield "launch_time_error", drive_error
    yield "stop_time_error", brake_error


def measure_performance(vehicle: Superbike, time_step: float = TIME_STEP) -> Performance:
    """Return what road tests measure: full throttle for a minute, then full brakes, with all electronics; level road.

    Args:
        vehicle: the machine.
        time_step: integration step, s.
    """
    engine = CompiledSuperbikeEngine(vehicle, time_step)
    engine.reset(st.upright_state(0.0, vehicle.rF))
    launch = ride(engine, 60.0, constant(vehicle, 0.0, 1.0))
    distance = np.cumsum(launch.speed) * _PERIOD
    quarter = float(np.interp(_QUARTER_MILE, distance, launch.time))
    at_speed(engine, _KM_H_100)
    first = float(engine.telemetry()[signal("speed")])
    stop = ride(engine, 10.0, lambda now, telemetry: (0.0, -1.0 if telemetry[signal("speed")] > _STANDING else 0.0))
    moving = np.minimum.accumulate(stop.speed > _STANDING)
    fell = launch.fall != NO_FALL, stop.fall != NO_FALL
    return Performance(
        vehicle.name,
        math.inf if fell[0] else float(np.interp(_KM_H_100, launch.speed, launch.time)),
        math.inf if fell[0] else quarter,
        3.6 * float(np.interp(quarter, launch.time, launch.speed)),
        3.6 * float(launch.speed.max()),
        math.inf if fell[1] else float(np.trapezoid([first, *stop.speed[moving]], dx=_PERIOD)),
    )


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
            yield ride(engine, _TURN_MEAN, holding(vehicle, speed, _always(lean)))


def lateral_error(vehicle: Superbike, speeds: Sequence[float], rolls: Sequence[float]) -> float:
    """Return the largest share by which steady turns miss the closed form of their lateral acceleration."""
    worst = 0.0
    for turn in steady_turns(vehicle, speeds, rolls):
        measured = -float(turn.telemetry[:, signal("acceleration_lat")].mean())
        expected = statics.steady_lateral(vehicle, float(turn.lean.mean()), float(turn.speed.mean()))
        worst = max(worst, abs(measured / expected - 1.0) if turn.fall == NO_FALL else math.inf)
    return worst


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


def check_modes(result: Validation, vehicle: Superbike) -> Figures:
    """Weave, wobble and capsize in straight running, with the hands off and on the bars."""
    for hands, prefix, how in ((False, "", "hands off"), (True, "held_", "hands on")):
        found = {
            machine.name: [measure_modes(machine, float(speed), hands=hands) for speed in MODE_SPEEDS]
            for machine in result.machines
        }
        points = [modes for row in found.values() for modes in row]
        fast = [modes for modes in points if modes.speed >= PUBLISHED_FROM]
        for mode, published in (("weave", WEAVE_HZ), ("wobble", WOBBLE_HZ)):
            yield f"{prefix}{mode}_real_1_s", max(getattr(modes, mode).real for modes in points)
            hertz = np.array([getattr(modes, mode) for modes in fast]).imag / (2.0 * math.pi)
            title = f"{mode}, {how}, 20 to 90 m/s, Hz"
            result.ranges.append(Range(f"{prefix}{mode}_hz", title, hertz.min(), hertz.max(), *published))
        if not hands:
            result.modes = found
            yield "capsize_1_s", max(modes.capsize for modes in points)


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
    ("modes", check_modes),
)
"""Parts of the validation."""
