"""A superbike: the four rigid bodies of `Vehicle` plus tyres, air, engine, brakes, electronics and a rider.

One YAML file, one frozen dataclass made of small frozen sections, and records for compiled code. Because a
superbike *is* a `Vehicle`, everything that works on the four bodies (layout, mapping, kinematics) works on it; there
the rider is fixed in the middle of the rear body. In the engine the rider can slide sideways.

Files are z-up and in SI units: heights are positive. The inherited fields keep the published z-down signs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Final, Self, get_type_hints

import numpy as np
from numpy.typing import NDArray

from bike_sim.schema import GRAVITY
from bike_sim.vehicles.bicycle import Vehicle, VehicleFile
from bike_sim.vehicles.joints import Joints, Part
from bike_sim.vehicles.magic_formula import MagicFormula
from bike_sim.vehicles.parameters import VehicleError, number, positive, read_record, signed
from bike_sim.vehicles.trim import TORSO_TRIM, TRIM, TorsoTrim, Trim, trims

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Record = Any
"""A NumPy record in compiled code: numba finds its fields by their names when it compiles."""

HIGHEST_SPEED: Final = 200.0
"""Largest road speed at the limiter, m/s: limits are tabulated up to it, and a larger one is a mistake of units."""
TORQUE_SAMPLES: Final = 256
"""Samples of the table of wheel torque over wheel speed that compiled code interpolates."""
_RPM: Final = math.pi / 30.0
"""One revolution a minute, rad/s."""
_OVER_REV: Final = 12.0
"""Curvature of the power beyond its peak, by engine speed, both relative to the peak's (estimate)."""
_CLUTCH_SPEED_SHARE: Final = 0.3
"""Part of the limiter's engine speed below which the clutch slips: torque there is that at this speed."""


@dataclass(frozen=True)
class Tyre:
    """A motorcycle tyre; formulas in `bike_sim.physics.superbike.tyres`."""

    crown: float = field(metadata=positive("m", "radius of the cross-section"))
    stiffness: float = field(metadata=positive("N/m", "vertical, with the suspension in series: the frame is rigid"))
    damping: float = field(metadata=number("N s/m", "vertical"))
    nominal_load: float = field(metadata=positive("N", "Fz0 of the load dependence"))
    cornering: float = field(metadata=positive("1/rad", "cornering stiffness by load at the nominal load"))
    cornering_slope: float = field(metadata=number("1/rad", "derivative of cornering stiffness by load, the smaller"))
    camber: float = field(metadata=number("1/rad", "camber stiffness by load"))
    friction: float = field(metadata=positive("", "largest lateral force by load, upright"))
    friction_ratio: float = field(metadata=positive("", "longitudinal by lateral friction"))
    camber_fade: float = field(metadata=number("1/rad2", "friction falls as 1 / (1 + camber_fade camber^2)"))
    shape: float = field(metadata=number("", "C of the Magic Formula"))
    slip_stiffness: float = field(metadata=positive("", "longitudinal slip stiffness by load"))
    relaxation: float = field(metadata=positive("m", "relaxation length of lateral slip"))
    slip_relaxation: float = field(metadata=positive("m", "relaxation length of longitudinal slip"))
    trail: float = field(metadata=number("m", "pneumatic trail of the side slip's force at small slip"))
    twist: float = field(metadata=number("m/rad", "twisting torque by load and camber, towards the wheel's lean"))
    rolling: float = field(metadata=number("", "rolling resistance coefficient"))
    friction_slope: float = field(
        default=0.0, metadata=number("", "friction falls as exp(-friction_slope (load / nominal_load - 1))")
    )
    camber_lag: float = field(default=0.0, metadata=number("", "1: camber thrust lags like that of side slip, 0: none"))
    magic_formula: MagicFormula | None = None  # type: ignore[valid-type]

    @property
    def sag(self) -> float:
        """Compression by the standing machine beyond the radius of its file, m: none."""
        return 0.0

    @property
    def peak(self) -> float:
        """Normalised slip at which the force is largest: ``C tan(pi / 2 C)``."""
        return self.shape * math.tan(0.5 * math.pi / self.shape)


@dataclass(frozen=True)
class RiderBody:
    """The rider's body, sliding across the machine; inertias about the own centre of mass."""

    mass: float = field(metadata=positive("kg", "with leathers"))
    x: float = field(metadata=number("m", "centre of mass ahead of the rear contact"))
    height: float = field(metadata=positive("m", "of the centre of mass"))
    Ixx: float = field(metadata=positive("kg m2", "roll"))
    Iyy: float = field(metadata=positive("kg m2", "pitch"))
    Izz: float = field(metadata=positive("kg m2", "yaw"))
    slide: float = field(metadata=number("m", "largest distance of the centre of mass from the middle plane"))
    slide_lean_deg: float = field(metadata=positive("deg", "lean from which on the slide is largest, linear below"))
    slide_frequency: float = field(metadata=positive("rad/s", "of the body's critically damped motion"))
    Ixz: float = field(default=0.0, metadata=signed("kg m2", "element xz of the tensor, z up"))


@dataclass(frozen=True)
class Air:
    """Drag and downforce."""

    density: float = field(metadata=number("kg/m3", "of the air"))
    drag_area: float = field(metadata=number("m2", "Cd A"))
    down_area: float = field(metadata=signed("m2", "-Cl A, positive pressing down in the machine's own plane"))
    x: float = field(metadata=number("m", "of the centre of pressure, ahead of the rear contact"))
    height: float = field(metadata=positive("m", "of the centre of pressure"))


@dataclass(frozen=True)
class Motor:
    """Engine and driveline: a torque curve with the published peaks, and the gearbox; the gear is always the best one.

    A machine of fewer than six gears repeats its last.
    """

    peak_power: float = field(metadata=positive("W", "at the crank"))
    peak_power_rpm: float = field(metadata=number("1/min", "engine speed of the peak power"))
    peak_torque: float = field(metadata=positive("N m", "at the crank"))
    peak_torque_rpm: float = field(metadata=positive("1/min", "engine speed of the peak torque"))
    limiter_rpm: float = field(metadata=number("1/min", "above it there is no torque"))
    low_torque: float = field(metadata=number("", "part of the peak torque at a third of its engine speed"))
    efficiency: float = field(metadata=positive("", "of the driveline"))
    primary_ratio: float = field(metadata=positive("", "turns of the crank for one of the gearbox's input"))
    gear_1: float = field(metadata=positive("", "turns of the gearbox's input for one of its output"))
    gear_2: float = field(metadata=positive("", "the same"))
    gear_3: float = field(metadata=positive("", "the same"))
    gear_4: float = field(metadata=positive("", "the same"))
    gear_5: float = field(metadata=positive("", "the same"))
    gear_6: float = field(metadata=positive("", "the same"))
    final_ratio: float = field(metadata=positive("", "turns of the gearbox's output for one of the rear wheel"))
    lag: float = field(metadata=positive("s", "time constant of the torque"))
    engine_brake: float = field(metadata=number("N", "force at the rear tyre with the throttle closed"))
    crank_momentum: float = field(metadata=signed("N m s", "spin at racing speed; negative when it turns backwards"))
    shift_time: float = field(default=0.0, metadata=number("s", "without drive at every shift to a higher gear"))

    @property
    def torque_at_peak_power(self) -> float:
        """Torque at the speed of the peak power, N m."""
        return self.peak_power / (self.peak_power_rpm * _RPM)

    def crank_torque(self, rpm: FloatArray) -> FloatArray:
        """Return the full-throttle torque, N m, zero above the limiter.

        A parabola up to the peak torque; from there to the peak power a cubic, level at the first and with level
        power at the second; beyond it power falls as a parabola, by 3 % where the engine turns 5 % faster.
        """
        span = self.peak_power_rpm - self.peak_torque_rpm
        drop = self.peak_torque - self.torque_at_peak_power
        # The slope that makes power level; more than three times the chord's would overshoot the peak torque
        slope = min(self.torque_at_peak_power * span / self.peak_power_rpm, 3.0 * drop)
        u = (rpm - self.peak_torque_rpm) / span
        low = self.peak_torque * (1.0 - (1.0 - self.low_torque) * (1.5 * (1.0 - rpm / self.peak_torque_rpm)) ** 2)
        middle = self.peak_torque - u * u * ((3.0 * drop - slope) + u * (slope - 2.0 * drop))
        ratio = np.maximum(rpm / self.peak_power_rpm, 1.0)
        over = self.torque_at_peak_power * (1.0 - _OVER_REV * (ratio - 1.0) ** 2) / ratio
        torque = np.where(u < 0.0, low, np.where(u < 1.0, middle, over))
        return np.where(rpm <= self.limiter_rpm, np.maximum(torque, 0.0), 0.0)

    def ratios(self) -> FloatArray:
        """Return the turns of the crank for one of the rear wheel, first gear first."""
        gears = (self.gear_1, self.gear_2, self.gear_3, self.gear_4, self.gear_5, self.gear_6)
        return self.primary_ratio * self.final_ratio * np.array(gears)


@dataclass(frozen=True)
class Brakes:
    """Both brakes behind one lever."""

    force: float = field(metadata=positive("N", "sum of both tyres' braking forces at full command"))
    front_share: float = field(metadata=number("", "part of it at the front"))
    lag: float = field(metadata=positive("s", "time constant"))


@dataclass(frozen=True)
class Steering:
    """Steering damper, linear over speed between two values, and the stop."""

    damper_slow: float = field(metadata=number("N m s/rad", "at and below `slow`"))
    damper_fast: float = field(metadata=number("N m s/rad", "at and above `fast`"))
    slow: float = field(metadata=number("m/s", "speed"))
    fast: float = field(metadata=number("m/s", "speed"))
    stop_deg: float = field(metadata=positive("deg", "largest steering angle"))


@dataclass(frozen=True)
class VirtualRider:
    """The controller that turns the steering command into lean by steering torque.

    The arms are a critically damped system from the torque that the rider wants to that on the bars.
    """

    max_lean_deg: float = field(metadata=positive("deg", "lean at a steering command of 1"))
    frequency: float = field(metadata=positive("rad/s", "of the critically damped reference model"))
    lean_rate: float = field(metadata=positive("rad/s", "largest rate of the reference"))
    lean_acceleration: float = field(metadata=positive("rad/s2", "largest change of that rate"))
    gyro_share: float = field(metadata=number("", "of the largest torque for the gyroscopic one of the reference"))
    torque: float = field(metadata=positive("N m", "largest steering torque"))
    arm_frequency: float = field(metadata=positive("rad/s", "of the arms"))
    grip_stiffness: float = field(metadata=number("N m/rad", "of arms against the steering angle they are used to"))
    grip_damping: float = field(metadata=number("N m s/rad", "of arms"))
    grip_memory: float = field(metadata=positive("s", "time in which they get used to another angle"))
    torso_damping: float = field(metadata=number("N m s/rad", "by a roll rate that the torso does not follow"))
    torso_time: float = field(metadata=positive("s", "time in which it follows"))
    twist_time: float = field(metadata=positive("s", "time in which its yaw inertia follows a turn of the frame"))
    spin_effort: float = field(metadata=positive("", "torque by lean rate, by that of the front wheel's spin"))
    trail_time: float = field(
        metadata=number("s", "relief of that at any speed, by the front load's torque at the trail")
    )
    throw: float = field(metadata=number("N m s2/rad", "torque by acceleration of the lean"))
    lean_bandwidth: float = field(metadata=positive("1/s", "rate at which an error of lean is steered out"))
    lean_time: float = field(metadata=number("s", "effort by an error of lean, by the load's torque at the trail"))
    rate_time: float = field(metadata=number("s", "effort by an error of lean rate, by the load's torque at the trail"))
    integral_rate: float = field(metadata=number("1/s", "rate at which a steady error is steered out"))
    integral_torque: float = field(metadata=number("N m", "largest torque of the integral part"))


@dataclass(frozen=True)
class Electronics:
    """Aids that know speed, lean, loads and slips exactly (idealised); each can be switched off with a 0.

    Each works twice: ahead, by a limit on the force computed from lean and statics, and after the fact, by a cut in
    proportion between two thresholds. Slips are normalised by friction: 1 is where a linear tyre would reach it, and
    the peak lies at 2.6 for a shape of 1.5. Loads `_lean` are kept besides at full lean or at a roll rate of 1 rad/s,
    in proportion below.
    """

    traction_control: float = field(metadata=number("", "1 on, 0 off"))
    traction_share: float = field(metadata=number("", "of the friction that the lean leaves, for the drive"))
    traction_slip_on: float = field(metadata=number("", "normalised slip where the cut begins"))
    traction_slip_off: float = field(metadata=number("", "normalised slip where no drive is left"))
    wheelie_control: float = field(metadata=number("", "1 on, 0 off"))
    wheelie_load: float = field(metadata=number("N", "kept on the front wheel by the limit"))
    wheelie_load_lean: float = field(metadata=number("N", "kept besides"))
    wheelie_load_on: float = field(metadata=number("N", "front load where the cut begins"))
    wheelie_load_off: float = field(metadata=number("N", "front load where no drive is left"))
    brake_control: float = field(metadata=number("", "1 on, 0 off"))
    brake_share: float = field(
        metadata=number("", "of the friction that the lean leaves, for the front brake, upright")
    )
    brake_share_lean: float = field(metadata=number("", "the same from 45 deg of lean on"))
    brake_slip_on: float = field(metadata=number("", "normalised slip where the cut begins"))
    brake_slip_off: float = field(metadata=number("", "normalised slip where no brake on that wheel is left"))
    stoppie_control: float = field(metadata=number("", "1 on, 0 off"))
    stoppie_load: float = field(metadata=number("N", "kept on the rear wheel by the limit"))
    stoppie_load_lean: float = field(metadata=number("N", "kept besides"))
    stoppie_load_on: float = field(metadata=number("N", "rear load where the cut begins"))
    stoppie_load_off: float = field(metadata=number("N", "rear load where no brake is left"))
    reference_mass: float = field(
        default=0.0, metadata=number("kg", "mass with rider that the loads are meant for, which grow with it; 0: fixed")
    )


@dataclass(frozen=True)
class Sections:
    """Sections that stand in the file as they stand in the dataclass.

    Attributes:
        front_tyre: the front tyre.
        rear_tyre: the rear tyre.
        rider: the rider's body.
        air: drag and downforce.
        motor: engine and driveline.
        brakes: both brakes.
        steering: damper and stop.
        virtual_rider: from command to lean.
        electronics: rider aids.
    """

    front_tyre: Tyre
    rear_tyre: Tyre
    rider: RiderBody
    air: Air
    motor: Motor
    brakes: Brakes
    steering: Steering
    virtual_rider: VirtualRider
    electronics: Electronics


@dataclass(frozen=True)
class Superbike(Vehicle, Sections):
    """A racing motorcycle with its rider.

    In the inherited `Vehicle` the rear body B is frame and rider together, `D` is the steering damper at low speed,
    `P` is 0 and `max_steer` the steering stop.

    Attributes:
        frame: rear frame without fork, wheels and rider (swingarm, engine, tank with fuel).
        joints: compliant joints; None is a rigid machine.
    """

    frame: Part
    joints: Joints | None = None

    def __post_init__(self) -> None:
        """Check that the numbers describe a machine that can exist.

        Raises:
            VehicleError: naming the first invalid value.
        """
        super().__post_init__()
        for name, tyre, radius in (("front", self.front_tyre, self.rF), ("rear", self.rear_tyre, self.rR)):
            if tyre.crown >= radius:
                self._refuse(f"{name}_tyre.crown = {tyre.crown} m must stay below the wheel's radius of {radius} m")
            if not 1.0 < tyre.shape < 2.0:
                self._refuse(f"{name}_tyre.shape = {tyre.shape} must lie between 1 and 2, or the tyre has no peak")
        if not 0.0 <= self.brakes.front_share <= 1.0:
            self._refuse(f"brakes.front_share = {self.brakes.front_share} must lie between 0 and 1")
        self._check_order("steering", self.steering, ("slow", "fast"))
        self._check_order("motor", self.motor, ("peak_torque_rpm", "peak_power_rpm", "limiter_rpm"))
        for aid in ("traction_slip", "brake_slip"):
            self._check_order("electronics", self.electronics, (f"{aid}_on", f"{aid}_off"))
        for aid in ("wheelie_load", "stoppie_load"):
            self._check_order("electronics", self.electronics, (f"{aid}_off", f"{aid}_on"))
        self._check_motor()
        if not self.virtual_rider.max_lean_deg < math.degrees(self.fall_roll):
            self._refuse(
                f"virtual_rider.max_lean_deg = {self.virtual_rider.max_lean_deg} must stay below the fall at "
                f"{math.degrees(self.fall_roll):.6g} deg"
            )

    @property
    def scalable(self) -> tuple[str, ...]:
        """Names of the parameters of `scaled`, each as ``section.name``."""
        return tuple(
            f"{section}.{name}"
            for section in ("frame", *get_type_hints(Sections))
            for name, value in vars(getattr(self, section)).items()
            if isinstance(value, float)
        )

    def scaled(self, factors: Mapping[str, float]) -> Self:
        """Return the machine with numbers of its sections times factors; what follows from them changes as well.

        Raises:
            VehicleError: no such machine can exist.
        """
        sections: dict[str, Any] = {}
        for path, factor in factors.items():
            section, name = path.split(".")
            part = sections.get(section, getattr(self, section))
            changed: dict[str, Any] = {name: getattr(part, name) * factor}
            if name == "friction" and isinstance(part, Tyre) and part.magic_formula is not None:
                # Its peaks are those of the other tyre law's friction.
                formula = part.magic_formula
                peaks: dict[str, float] = {peak: getattr(formula, peak) * factor for peak in ("pDx1", "pDx2", "pDy1")}
                changed["magic_formula"] = replace(formula, **peaks)
            sections[section] = replace(part, **changed)
        rear = _rear_body(sections.get("frame", self.frame), sections.get("rider", self.rider))
        return replace(self, **sections, **rear, D=sections.get("steering", self.steering).damper_slow)

    def _check_motor(self) -> None:
        """Check that peaks and gears belong together.

        Raises:
            VehicleError: naming the values.
        """
        motor = self.motor
        if motor.torque_at_peak_power > motor.peak_torque:
            self._refuse(
                f"motor.peak_power = {motor.peak_power:.6g} W at {motor.peak_power_rpm:.6g} 1/min needs "
                f"{motor.torque_at_peak_power:.6g} N m, more than motor.peak_torque = {motor.peak_torque:.6g}"
            )
        if np.any(np.diff(motor.ratios()) > 0.0):
            self._refuse("motor must have gear_1 >= gear_2 >= ... >= gear_6: turns in for one turn out")
        if self.top_gear_speed > HIGHEST_SPEED:
            self._refuse(
                f"motor's ratios give {self.top_gear_speed:.6g} m/s at the limiter in top gear; at most "
                f"{HIGHEST_SPEED:g} m/s, so look for a wrong unit or ratio"
            )

    @property
    def centre_of_mass(self) -> tuple[float, float]:
        """Distance ahead of the rear contact and height of the common centre of mass, upright, m."""
        x = (self.mB * self.xB + self.mH * self.xH + self.mF * self.w) / self.mass
        height = (self.mR * self.rR - self.mB * self.zB - self.mH * self.zH + self.mF * self.rF) / self.mass
        return x, height

    @property
    def com_x(self) -> float:
        """Distance of the common centre of mass ahead of the rear contact, m."""
        return self.centre_of_mass[0]

    @property
    def com_height(self) -> float:
        """Height of the common centre of mass, upright, m."""
        return self.centre_of_mass[1]

    @cached_property
    def _trims(self) -> tuple[Trim, Trim]:
        if self.joints is None:
            return Trim(), Trim()
        tyres = self.rear_tyre.stiffness, self.front_tyre.stiffness
        return trims(self, self.joints, tyres, self.mass * self.g * (1.0 - self.com_x / self.w))

    @property
    def rear_trim(self) -> Trim:
        """What the rear suspension gives way."""
        return self._trims[0]

    @property
    def front_trim(self) -> Trim:
        """What the front suspension gives way."""
        return self._trims[1]

    @property
    def torso_trim(self) -> TorsoTrim:
        """How the rider's torso rolls."""
        torso = None if self.joints is None else self.joints.torso
        if torso is None:
            return TorsoTrim()
        return TorsoTrim(torso.part.mass * (torso.part.height - torso.height), torso.stiffness)

    @property
    def gear_speeds(self) -> FloatArray:
        """Road speeds at the limiter, upright and without slip, m/s, first gear first."""
        return self.motor.limiter_rpm * _RPM / self.motor.ratios() * self.rR

    @property
    def top_gear_speed(self) -> float:
        """Road speed at the limiter in top gear, m/s."""
        return float(self.gear_speeds[-1])

    @cached_property
    def wheel_torque(self) -> FloatArray:
        """Full-throttle torque at the rear wheel, N m, over wheel speeds of `wheel_torque_spacing`; best gear each."""
        table: FloatArray = self._torque_by_gear().max(axis=1)
        table.setflags(write=False)
        return table

    @cached_property
    def wheel_gear(self) -> IntArray:
        """The gear of each torque of `wheel_torque`, 1 for the first; where none drives any more, the last."""
        table = np.maximum.accumulate(1 + self._torque_by_gear().argmax(axis=1))
        table.setflags(write=False)
        return table

    def _torque_by_gear(self) -> FloatArray:
        """Full-throttle torque at the rear wheel, N m, shape (wheel speeds, gears)."""
        spin = self.wheel_torque_spacing * np.arange(TORQUE_SAMPLES)
        limiter = self.motor.limiter_rpm
        ratio = self.motor.ratios()
        rpm = np.maximum(spin[:, None] * ratio[None, :] / _RPM, _CLUTCH_SPEED_SHARE * limiter)
        torque: FloatArray = self.motor.crank_torque(rpm) * ratio * self.motor.efficiency
        return torque

    @property
    def wheel_torque_spacing(self) -> float:
        """Spacing of `wheel_torque`, rad/s; the table ends 5 % above the limiter in top gear."""
        return 1.05 * self.top_gear_speed / self.rR / (TORQUE_SAMPLES - 1)

    @cached_property
    def machine(self) -> Record:
        """All numbers for compiled code: a record of `MACHINE`."""
        table = np.zeros(1, dtype=MACHINE)
        _fill(table[0], self)
        aids = table[0]["electronics"]
        if aids["reference_mass"] > 0.0:
            for name in (name for name in aids.dtype.names if "_load" in name):
                aids[name] *= self.mass / aids["reference_mass"]
        table.setflags(write=False)
        return table[0]

    def _check_order(self, section: str, values: Any, keys: tuple[str, ...]) -> None:
        numbers = [getattr(values, key) for key in keys]
        if any(low >= high for low, high in itertools.pairwise(numbers)):
            text = " < ".join(f"{key} ({number:.6g})" for key, number in zip(keys, numbers, strict=True))
            self._refuse(f"{section} must have {text}")


def record_of(kind: type) -> np.dtype[np.void]:
    """Return the record that carries a dataclass of numbers into compiled code: its fields by their names."""
    return np.dtype([(entry.name, np.float64) for entry in fields(kind) if entry.metadata])


MAGIC_FORMULA: Final = np.dtype([*record_of(MagicFormula).descr, ("on", np.float64)])
"""Record of a tyre's coefficients of the Magic Formula, all 0 without."""

TYRE: Final = np.dtype(
    [*record_of(Tyre).descr, ("peak", np.float64), ("sag", np.float64), ("magic_formula", MAGIC_FORMULA)]
)
"""Record of a tyre, with its `peak`, how far the standing machine presses it in beyond the radius of its file, m, and
the coefficients of the Magic Formula."""

MACHINE: Final = np.dtype(
    [
        *((name, np.float64) for name in ("w", "c", "lam", "g", "rR", "rF", "IRyy", "IFyy", "fall_roll", "max_steer")),
        *((name, np.float64) for name in ("mass", "com_x", "com_height")),
        *((name, TRIM) for name in ("rear_trim", "front_trim")),
        ("torso_trim", TORSO_TRIM),
        *((name, TYRE if kind is Tyre else record_of(kind)) for name, kind in get_type_hints(Sections).items()),
    ]
)
"""Record of a machine: numbers of `Superbike` and its sections. Compiled code reads them by name, never by position."""


def _fill(record: Record, source: Any) -> None:
    """Copy the attributes of an object into a record whose fields have their names, sections into theirs."""
    for name in record.dtype.names:
        value = getattr(source, name)
        if record.dtype[name].names is None:
            record[name] = value
        elif value is not None:
            _fill(record[name], value)


@dataclass(frozen=True)
class _Geometry:
    wheelbase: float = field(metadata=positive("m", "of the standing machine"))
    caster_deg: float = field(metadata=signed("deg", "tilt of the steering axis"))
    trail: float = field(metadata=signed("m", "at the front contact"))
    front_radius: float = field(metadata=positive("m", "of the front wheel with tyre"))
    rear_radius: float = field(metadata=positive("m", "of the rear wheel with tyre"))


@dataclass(frozen=True)
class _Bodies:
    """Published values of the machine on its wheels without rider; the frame is what fork and wheels leave."""

    wet_mass: float = field(metadata=positive("kg", "with fuel"))
    front_load_share: float = field(metadata=number("", "part of the weight on the front wheel"))
    centre_height: float = field(metadata=positive("m", "of the centre of mass"))
    frame_Ixx: float = field(metadata=positive("kg m2", "about the frame's own centre of mass"))
    frame_Iyy: float = field(metadata=positive("kg m2", "the same"))
    frame_Izz: float = field(metadata=positive("kg m2", "the same"))
    frame_Ixz: float = field(metadata=signed("kg m2", "the same"))
    fork_mass: float = field(metadata=positive("kg", "all that steers but the wheel"))
    fork_x: float = field(metadata=signed("m", "centre of mass"))
    fork_height: float = field(metadata=positive("m", "centre of mass"))
    fork_Ixx: float = field(metadata=positive("kg m2", "about the fork's own centre of mass"))
    fork_Iyy: float = field(metadata=positive("kg m2", "the same"))
    fork_Izz: float = field(metadata=positive("kg m2", "the same"))
    fork_Ixz: float = field(metadata=signed("kg m2", "the same"))
    front_wheel_mass: float = field(metadata=positive("kg", "with tyre"))
    front_wheel_spin: float = field(metadata=positive("kg m2", "about the axle"))
    front_wheel_diameter: float = field(metadata=positive("kg m2", "about a diameter"))
    rear_wheel_mass: float = field(metadata=positive("kg", "with tyre"))
    rear_wheel_spin: float = field(metadata=positive("kg m2", "about the axle"))
    rear_wheel_diameter: float = field(metadata=positive("kg m2", "about a diameter"))


@dataclass(frozen=True)
class SuperbikeFile(VehicleFile, Sections):
    """Content of the file of a superbike."""

    type: Any
    geometry: _Geometry
    bodies: _Bodies
    joints: Joints | None = None


def superbike_from_document(document: Any, origin: str) -> Superbike:
    """Build a superbike from the parsed content of a vehicle file of ``type: superbike``.

    Args:
        document: result of the YAML parser.
        origin: name or path for error messages.

    Raises:
        VehicleError: a key is missing or unknown, or a value is invalid.
    """
    file = read_record(SuperbikeFile, document, origin)
    geometry, bodies = file.geometry, file.bodies
    frame = _frame(geometry, bodies, origin)
    return Superbike(
        **{entry.name: getattr(file, entry.name) for entry in fields(Sections)},
        name=str(file.name),
        description=str(file.description),
        w=geometry.wheelbase,
        c=geometry.trail,
        lam=math.radians(geometry.caster_deg),
        g=GRAVITY,
        rR=geometry.rear_radius,
        mR=bodies.rear_wheel_mass,
        IRxx=bodies.rear_wheel_diameter,
        IRyy=bodies.rear_wheel_spin,
        **_rear_body(frame, file.rider),
        xH=bodies.fork_x,
        zH=-bodies.fork_height,
        mH=bodies.fork_mass,
        IHxx=bodies.fork_Ixx,
        IHxz=-bodies.fork_Ixz,
        IHyy=bodies.fork_Iyy,
        IHzz=bodies.fork_Izz,
        rF=geometry.front_radius,
        mF=bodies.front_wheel_mass,
        IFxx=bodies.front_wheel_diameter,
        IFyy=bodies.front_wheel_spin,
        P=0.0,
        D=file.steering.damper_slow,
        max_steer=math.radians(file.steering.stop_deg),
        fall_roll=math.radians(file.limits.fall_roll_deg),
        control_period=file.control_period_s,
        frame=frame,
        joints=file.joints,
    )


def _frame(geometry: _Geometry, bodies: _Bodies, origin: str) -> Part:
    """Return the rear frame: the standing machine less fork and wheels."""
    parts = (
        (bodies.fork_mass, bodies.fork_x, bodies.fork_height),
        (bodies.front_wheel_mass, geometry.wheelbase, geometry.front_radius),
        (bodies.rear_wheel_mass, 0.0, geometry.rear_radius),
    )
    wet = bodies.wet_mass
    mass = wet - sum(part[0] for part in parts)
    if mass <= 0.0:
        raise VehicleError(
            f"vehicle '{origin}': bodies.wet_mass = {wet} kg leaves no mass for the frame beside fork and wheels"
        )
    moment_x = wet * bodies.front_load_share * geometry.wheelbase - sum(part[0] * part[1] for part in parts)
    moment_z = wet * bodies.centre_height - sum(part[0] * part[2] for part in parts)
    inertia = bodies.frame_Ixx, bodies.frame_Iyy, bodies.frame_Izz, bodies.frame_Ixz
    return Part(mass, moment_x / mass, moment_z / mass, *inertia)


def _rear_body(frame: Part, rider: RiderBody) -> dict[str, Any]:
    """Return frame and rider as the body B of `Vehicle`, whose z points down."""
    rear = _join(frame, rider)
    return {
        "xB": rear.x,
        "zB": -rear.height,
        "mB": rear.mass,
        "IBxx": rear.Ixx,
        "IBxz": -rear.Ixz,
        "IByy": rear.Iyy,
        "IBzz": rear.Izz,
    }


def _join(frame: Part, rider: RiderBody) -> Part:
    """Return frame and rider as one rigid body (parallel axes)."""
    mass = frame.mass + rider.mass
    reduced = frame.mass * rider.mass / mass
    dx, dz = frame.x - rider.x, frame.height - rider.height
    return Part(
        mass,
        (frame.mass * frame.x + rider.mass * rider.x) / mass,
        (frame.mass * frame.height + rider.mass * rider.height) / mass,
        frame.Ixx + rider.Ixx + reduced * dz * dz,
        frame.Iyy + rider.Iyy + reduced * (dx * dx + dz * dz),
        frame.Izz + rider.Izz + reduced * dx * dx,
        frame.Ixz + rider.Ixz - reduced * dx * dz,
    )
