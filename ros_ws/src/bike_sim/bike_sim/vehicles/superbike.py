"""A superbike: the four rigid bodies of `Vehicle` plus tyres, air, engine, brakes, electronics and a rider.

One YAML file, one frozen dataclass made of small frozen sections, and flat vectors for compiled code. Because a
superbike *is* a `Vehicle`, everything that works on the four bodies (layout, mapping, kinematics) works on it; there
the rider is fixed in the middle of the rear body. In the engine the rider can slide sideways.

Files are z-up and in SI units: heights are positive. The inherited fields keep the published z-down signs.

One file although it is long: sections, their keys in files and their flat records change together, field by field.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_sim.schema import GRAVITY
from bike_sim.vehicles.bicycle import FORMAT, Vehicle, VehicleError, require_finite, require_keys

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
_SHIFT_FLOOR: Final = 0.3
"""Part of the limiter's engine speed below which the clutch slips: torque there is that at this speed."""


@dataclass(frozen=True)
class Tyre:
    """A motorcycle tyre; formulas in `bike_sim.physics.superbike.tyres`.

    Attributes:
        crown: radius of the tyre's cross-section, m.
        stiffness: vertical, N/m (with the suspension in series, as the frame is rigid).
        damping: vertical, N s/m.
        nominal_load: Fz0 of the load dependence, N.
        cornering: cornering stiffness by load at the nominal load, 1/rad.
        cornering_slope: derivative of cornering stiffness by load, 1/rad (smaller than `cornering`: it falls off).
        camber: camber stiffness by load, 1/rad.
        friction: largest lateral force by load, upright.
        friction_ratio: longitudinal by lateral friction.
        camber_fade: friction falls as 1 / (1 + camber_fade camber^2), 1/rad^2.
        shape: C of the Magic Formula.
        slip_stiffness: longitudinal slip stiffness by load.
        relaxation: relaxation length of lateral slip, m.
        slip_relaxation: relaxation length of longitudinal slip, m.
        trail: pneumatic trail of the side slip's force at small slip, m.
        twist: twisting torque by load and small camber, m/rad; it turns the wheel towards its lean.
        rolling: rolling resistance coefficient.
    """

    crown: float
    stiffness: float
    damping: float
    nominal_load: float
    cornering: float
    cornering_slope: float
    camber: float
    friction: float
    friction_ratio: float
    camber_fade: float
    shape: float
    slip_stiffness: float
    relaxation: float
    slip_relaxation: float
    trail: float
    twist: float
    rolling: float

    @property
    def peak(self) -> float:
        """Normalised slip at which the force is largest: ``C tan(pi / 2 C)``."""
        return self.shape * math.tan(0.5 * math.pi / self.shape)


@dataclass(frozen=True)
class RiderBody:
    """The rider's body, sliding across the machine.

    Attributes:
        mass: kg, with leathers.
        x: centre of mass ahead of the rear contact, m.
        height: of the centre of mass, m.
        Ixx: about the own centre of mass, kg m2. Iyy: as Ixx. Izz: as Ixx.
        slide: largest distance of the centre of mass from the middle plane, m.
        slide_lean_deg: lean at which all of it is used, deg; in proportion below.
        slide_frequency: of the body's critically damped motion, rad/s.
    """

    mass: float
    x: float
    height: float
    Ixx: float
    Iyy: float
    Izz: float
    slide: float
    slide_lean_deg: float
    slide_frequency: float


@dataclass(frozen=True)
class Air:
    """Drag and downforce.

    Attributes:
        density: kg/m3.
        drag_area: Cd A, m2.
        down_area: -Cl A, m2, positive pressing down in the machine's own plane.
        x: of the centre of pressure, ahead of the rear contact, m.
        height: of the centre of pressure, m.
    """

    density: float
    drag_area: float
    down_area: float
    x: float
    height: float


@dataclass(frozen=True)
class Motor:
    """Engine and driveline: a torque curve with the published peaks, and the gearbox; the gear is always the best one.

    Attributes:
        peak_power: W, at the crank.
        peak_power_rpm: 1/min.
        peak_torque: N m, at the crank.
        peak_torque_rpm: 1/min.
        limiter_rpm: 1/min; above it there is no torque.
        low_torque: part of the peak torque at a third of its engine speed.
        efficiency: of the driveline.
        primary_ratio: turns of the crank for one of the gearbox's input.
        gear_1: turns of the gearbox's input for one of its output, first gear. gear_2: as gear_1. gear_3: as gear_1.
        gear_4: as gear_1. gear_5: as gear_1. gear_6: as gear_1; a machine of fewer gears repeats its last.
        final_ratio: turns of the gearbox's output for one of the rear wheel.
        lag: time constant of the torque, s.
        engine_brake: force at the rear tyre with the throttle closed, N.
        crank_momentum: spin momentum of the crankshaft at racing speed, N m s; negative when it turns backwards.
    """

    peak_power: float
    peak_power_rpm: float
    peak_torque: float
    peak_torque_rpm: float
    limiter_rpm: float
    low_torque: float
    efficiency: float
    primary_ratio: float
    gear_1: float
    gear_2: float
    gear_3: float
    gear_4: float
    gear_5: float
    gear_6: float
    final_ratio: float
    lag: float
    engine_brake: float
    crank_momentum: float

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
    """Both brakes behind one lever.

    Attributes:
        force: sum of both tyres' braking forces at full command, N.
        front_share: part of it at the front.
        lag: time constant, s.
    """

    force: float
    front_share: float
    lag: float


@dataclass(frozen=True)
class Steering:
    """Steering damper, its schedule over speed, and the stop.

    Attributes:
        damper_slow: N m s/rad at and below `slow`. damper_fast: at and above `fast`; linear between.
        slow: m/s. fast: m/s.
        stop_deg: largest steering angle, deg.
    """

    damper_slow: float
    damper_fast: float
    slow: float
    fast: float
    stop_deg: float


@dataclass(frozen=True)
class VirtualRider:
    """The controller that turns the steering command into lean by steering torque.

    Attributes:
        max_lean_deg: lean at a steering command of 1, deg.
        frequency: of the critically damped reference model, rad/s.
        lean_rate: largest rate of the reference, rad/s.
        lean_acceleration: largest change of that rate, rad/s2.
        gyro_share: the reference is also slow enough for its gyroscopic torque to stay below this part of the limit.
        torque: largest steering torque, N m.
        arm_frequency: of the arms, a critically damped system from the torque that he wants to that on the bars, rad/s.
        grip_stiffness: of arms that hold the bars at the steering angle that they are used to, N m/rad.
        grip_damping: N m s/rad.
        grip_memory: time in which they get used to another, s.
        torso_damping: torque by a roll rate that the torso does not follow, N m s/rad.
        torso_time: time in which it follows, s.
        twist_time: time in which its yaw inertia follows a turn of the frame, s.
        spin_effort: torque by lean rate that rolls the machine, by that of the front wheel's spin.
        trail_time: how much less that is at any speed, by the torque of the standing front load at the trail, s.
        throw: torque by acceleration of the lean, N m s2/rad.
        lean_bandwidth: rate at which an error of lean is steered out, 1/s.
        lean_time: effort with which an error of lean is met at any speed, by the load's torque at the trail, s.
        rate_time: effort with which an error of lean rate is met, by the load's torque at the trail, s.
        integral_rate: rate at which a steady error is steered out, 1/s.
        integral_torque: largest torque of the integral part, N m.
    """

    max_lean_deg: float
    frequency: float
    lean_rate: float
    lean_acceleration: float
    gyro_share: float
    torque: float
    arm_frequency: float
    grip_stiffness: float
    grip_damping: float
    grip_memory: float
    torso_damping: float
    torso_time: float
    twist_time: float
    spin_effort: float
    trail_time: float
    throw: float
    lean_bandwidth: float
    lean_time: float
    rate_time: float
    integral_rate: float
    integral_torque: float


@dataclass(frozen=True)
class Electronics:
    """Aids that know speed, lean, loads and slips exactly (idealised); each can be switched off with a 0.

    Each works twice: ahead, by a limit on the force computed from lean and statics, and after the fact, by a cut in
    proportion between two thresholds. Slips are normalised by friction: 1 is where a linear tyre would reach it, and
    the peak lies at 2.6 for a shape of 1.5.

    Attributes:
        traction_control: 1 on, 0 off.
        traction_share: part of the friction that the lean leaves which the drive may use.
        traction_slip_on: cut begins. traction_slip_off: no drive is left.
        wheelie_control: 1 on, 0 off.
        wheelie_load: kept on the front wheel by the limit, N.
        wheelie_load_lean: kept in addition at full lean or at a roll rate of 1 rad/s, proportional below, N.
        wheelie_load_on: front load where the cut begins, N. wheelie_load_off: no drive.
        brake_control: 1 on, 0 off.
        brake_share: part of the friction that the lean leaves which the front brake may use, upright.
        brake_share_lean: the same from 45 deg of lean on.
        brake_slip_on: cut begins. brake_slip_off: no brake on that wheel is left.
        stoppie_control: 1 on, 0 off.
        stoppie_load: kept on the rear wheel by the limit, N.
        stoppie_load_lean: kept in addition at full lean or at a roll rate of 1 rad/s, proportional below, N.
        stoppie_load_on: rear load where the cut begins, N. stoppie_load_off: no brake.
    """

    traction_control: float
    traction_share: float
    traction_slip_on: float
    traction_slip_off: float
    wheelie_control: float
    wheelie_load: float
    wheelie_load_lean: float
    wheelie_load_on: float
    wheelie_load_off: float
    brake_control: float
    brake_share: float
    brake_share_lean: float
    brake_slip_on: float
    brake_slip_off: float
    stoppie_control: float
    stoppie_load: float
    stoppie_load_lean: float
    stoppie_load_on: float
    stoppie_load_off: float


@dataclass(frozen=True)
class Frame:
    """The rear frame without rider (swingarm, engine, tank with fuel); x from the rear contact, z up.

    Attributes:
        mass: kg. x: m. height: m.
        Ixx: kg m2 about the own centre of mass. Iyy: as Ixx. Izz: as Ixx.
        Ixz: element xz of the inertia tensor, z up, kg m2.
    """

    mass: float
    x: float
    height: float
    Ixx: float
    Iyy: float
    Izz: float
    Ixz: float


@dataclass(frozen=True)
class Superbike(Vehicle):
    """A racing motorcycle with its rider.

    In the inherited `Vehicle` the rear body B is frame and rider together, `D` is the steering damper at low speed,
    `P` is 0 and `max_steer` the steering stop.

    Attributes:
        frame: rear frame without rider.
        rider: the rider's body.
        front_tyre: the front tyre. rear_tyre: the rear tyre.
        air: drag and downforce.
        motor: engine and driveline.
        brakes: both brakes.
        steering: damper and stop.
        virtual_rider: from command to lean.
        electronics: rider aids.
    """

    frame: Frame
    rider: RiderBody
    front_tyre: Tyre
    rear_tyre: Tyre
    air: Air
    motor: Motor
    brakes: Brakes
    steering: Steering
    virtual_rider: VirtualRider
    electronics: Electronics

    def __post_init__(self) -> None:
        """Check that the numbers describe a machine that can exist.

        Raises:
            VehicleError: naming the first invalid value.
        """
        super().__post_init__()
        for name, section in self.sections.items():
            for field in fields(section):
                value = getattr(section, field.name)
                require_finite(self.name, f"{name}.{field.name}", value)
                if field.name not in _SIGNED and value < 0.0:
                    raise VehicleError(f"vehicle '{self.name}': {name}.{field.name} = {value} must not be negative")
                if field.name in _POSITIVE and value <= 0.0:
                    raise VehicleError(f"vehicle '{self.name}': {name}.{field.name} = {value} must be positive")
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
    def sections(self) -> dict[str, Any]:
        """The sections by name, in the order of the file."""
        names = [field.name for field in fields(self) if field.name not in _VEHICLE_FIELDS]
        return {name: getattr(self, name) for name in names}

    @property
    def mass(self) -> float:
        """Mass of machine and rider, kg."""
        return self.mR + self.mB + self.mH + self.mF

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
        rpm = np.maximum(spin[:, None] * ratio[None, :] / _RPM, _SHIFT_FLOOR * limiter)
        torque: FloatArray = self.motor.crank_torque(rpm) * ratio * self.motor.efficiency
        return torque

    @property
    def wheel_torque_spacing(self) -> float:
        """Spacing of `wheel_torque`, rad/s; the table ends 5 % above the limiter in top gear."""
        return 1.05 * self.top_gear_speed / self.rR / (TORQUE_SAMPLES - 1)

    @cached_property
    def tyres(self) -> NDArray[np.void]:
        """Both tyres for compiled code, rear first: records of `TYRE`, shape (2,)."""
        table = np.empty(2, dtype=TYRE)
        for i, tyre in enumerate((self.rear_tyre, self.front_tyre)):
            _fill(table[i], tyre)
        table.setflags(write=False)
        return table

    @cached_property
    def machine(self) -> Record:
        """All else for compiled code: a record of `MACHINE`."""
        table = np.empty(1, dtype=MACHINE)
        _fill(table[0], self)
        table.setflags(write=False)
        return table[0]

    def _refuse(self, text: str) -> None:
        raise VehicleError(f"vehicle '{self.name}': {text}")

    def _check_order(self, section: str, values: Any, keys: tuple[str, ...]) -> None:
        numbers = [getattr(values, key) for key in keys]
        if any(low >= high for low, high in itertools.pairwise(numbers)):
            text = " < ".join(f"{key} ({number:.6g})" for key, number in zip(keys, numbers, strict=True))
            self._refuse(f"{section} must have {text}")


_VEHICLE_FIELDS: Final = frozenset(field.name for field in fields(Vehicle))
_SIGNED: Final = frozenset({"crank_momentum", "Ixz"})
_POSITIVE: Final = frozenset(
    {
        "crown", "stiffness", "nominal_load", "cornering", "friction", "friction_ratio", "slip_stiffness", "relaxation",
        "slip_relaxation", "mass", "height", "Ixx", "Iyy", "Izz", "slide_lean_deg", "slide_frequency", "peak_power",
        "peak_torque", "peak_torque_rpm", "efficiency", "primary_ratio", "final_ratio", "gear_1", "gear_2", "gear_3",
        "gear_4", "gear_5", "gear_6", "lag", "force", "frequency", "lean_rate", "lean_acceleration", "torque",
        "max_lean_deg", "stop_deg", "arm_frequency", "grip_memory", "torso_time", "twist_time",
        "spin_effort", "lean_bandwidth",
    }
)  # fmt: skip
"""Values that must not be zero either, in any section."""

_SECTION_TYPES: Final[dict[str, type]] = {
    "rider": RiderBody,
    "air": Air,
    "motor": Motor,
    "brakes": Brakes,
    "steering": Steering,
    "virtual_rider": VirtualRider,
    "electronics": Electronics,
}
"""Sections that stand in the file as they stand in the dataclass."""


def record_of(kind: type) -> np.dtype[np.void]:
    """Return the record that carries a dataclass of numbers into compiled code: its fields by their names."""
    return np.dtype([(field.name, np.float64) for field in fields(kind)])


TYRE: Final = np.dtype([*((field.name, np.float64) for field in fields(Tyre)), ("peak", np.float64)])
"""Record of a tyre, with its `peak`."""

MACHINE: Final = np.dtype(
    [
        *((name, np.float64) for name in ("w", "c", "lam", "g", "rR", "rF", "IRyy", "IFyy", "fall_roll", "max_steer")),
        *((name, np.float64) for name in ("mass", "com_x", "com_height")),
        *((name, record_of(kind)) for name, kind in _SECTION_TYPES.items()),
    ]
)
"""Record of a machine: numbers of `Superbike` and its sections. Compiled code reads them by name, never by position."""


def _fill(record: Record, source: Any) -> None:
    """Copy the attributes of an object into a record whose fields have their names, sections into theirs."""
    for name in record.dtype.names:
        value = getattr(source, name)
        if record.dtype[name].names is None:
            record[name] = value
        else:
            _fill(record[name], value)


_TOP_LEVEL: Final = (
    "format", "type", "name", "description", "sources", "geometry", "bodies", "front_tyre", "rear_tyre",
    *_SECTION_TYPES, "limits", "control_period_s",
)  # fmt: skip
_GEOMETRY: Final = ("wheelbase", "caster_deg", "trail", "front_radius", "rear_radius")
_FORK: Final = ("fork_mass", "fork_x", "fork_height", "fork_Ixx", "fork_Iyy", "fork_Izz", "fork_Ixz")
_WHEELS: Final = ("front_wheel_mass", "front_wheel_spin", "front_wheel_diameter",
                  "rear_wheel_mass", "rear_wheel_spin", "rear_wheel_diameter")  # fmt: skip
_BODIES: Final = ("wet_mass", "front_load_share", "centre_height", "frame_Ixx", "frame_Iyy", "frame_Izz", "frame_Ixz",
                  *_FORK, *_WHEELS)  # fmt: skip

_Section = TypeVar("_Section")


def superbike_from_document(document: Any, origin: str) -> Superbike:
    """Build a superbike from the parsed content of a vehicle file of ``type: superbike``.

    The file states published values of the machine on its wheels without rider: wet mass, share of the
    front wheel, height of the centre of mass. The frame is what remains without fork and wheels.

    Args:
        document: what the YAML parser returned.
        origin: name or path for error messages.

    Raises:
        VehicleError: a key is missing or unknown, or a value is invalid.
    """
    where = f"vehicle '{origin}'"
    top = require_keys(document, _TOP_LEVEL, where)
    if top["format"] != FORMAT:
        raise VehicleError(f"{where}: format is '{top['format']}', this version reads '{FORMAT}'")
    geometry = _numbers(top["geometry"], _GEOMETRY, where, "geometry")
    bodies = _numbers(top["bodies"], _BODIES, where, "bodies")
    limits = _numbers(top["limits"], ("fall_roll_deg",), where, "limits")
    sections: dict[str, Any] = {name: _section(top[name], kind, where, name) for name, kind in _SECTION_TYPES.items()}
    front_tyre, rear_tyre = (_section(top[name], Tyre, where, name) for name in ("front_tyre", "rear_tyre"))
    require_finite(origin, "control_period_s", top["control_period_s"])
    frame = _frame(geometry, bodies, where)
    return Superbike(
        name=str(top["name"]),
        description=str(top["description"]),
        **_four_bodies(geometry, bodies, _join(frame, sections["rider"])),
        P=0.0,
        D=sections["steering"].damper_slow,
        max_steer=math.radians(sections["steering"].stop_deg),
        fall_roll=math.radians(limits["fall_roll_deg"]),
        control_period=float(top["control_period_s"]),
        frame=frame,
        front_tyre=front_tyre,
        rear_tyre=rear_tyre,
        **sections,
    )


def _four_bodies(geometry: dict[str, float], bodies: dict[str, float], rear: Frame) -> dict[str, Any]:
    """Return the inherited numbers, z down, of the machine whose rear body is frame and rider together."""
    return {
        "w": geometry["wheelbase"],
        "c": geometry["trail"],
        "lam": math.radians(geometry["caster_deg"]),
        "g": GRAVITY,
        "rR": geometry["rear_radius"],
        "mR": bodies["rear_wheel_mass"],
        "IRxx": bodies["rear_wheel_diameter"],
        "IRyy": bodies["rear_wheel_spin"],
        "xB": rear.x,
        "zB": -rear.height,
        "mB": rear.mass,
        "IBxx": rear.Ixx,
        "IBxz": -rear.Ixz,
        "IByy": rear.Iyy,
        "IBzz": rear.Izz,
        "xH": bodies["fork_x"],
        "zH": -bodies["fork_height"],
        "mH": bodies["fork_mass"],
        "IHxx": bodies["fork_Ixx"],
        "IHxz": -bodies["fork_Ixz"],
        "IHyy": bodies["fork_Iyy"],
        "IHzz": bodies["fork_Izz"],
        "rF": geometry["front_radius"],
        "mF": bodies["front_wheel_mass"],
        "IFxx": bodies["front_wheel_diameter"],
        "IFyy": bodies["front_wheel_spin"],
    }


def _frame(geometry: dict[str, float], bodies: dict[str, float], where: str) -> Frame:
    """Return the rear frame: the standing machine less fork and wheels."""
    parts = (
        (bodies["fork_mass"], bodies["fork_x"], bodies["fork_height"]),
        (bodies["front_wheel_mass"], geometry["wheelbase"], geometry["front_radius"]),
        (bodies["rear_wheel_mass"], 0.0, geometry["rear_radius"]),
    )
    wet = bodies["wet_mass"]
    mass = wet - sum(part[0] for part in parts)
    if mass <= 0.0:
        raise VehicleError(f"{where}: wet_mass = {wet} kg leaves no mass for the frame beside fork and wheels")
    moment_x = wet * bodies["front_load_share"] * geometry["wheelbase"] - sum(part[0] * part[1] for part in parts)
    moment_z = wet * bodies["centre_height"] - sum(part[0] * part[2] for part in parts)
    inertia = (bodies[f"frame_{axes}"] for axes in ("Ixx", "Iyy", "Izz", "Ixz"))
    return Frame(mass, moment_x / mass, moment_z / mass, *inertia)


def _join(frame: Frame, rider: RiderBody) -> Frame:
    """Return frame and rider as one rigid body (parallel axes)."""
    mass = frame.mass + rider.mass
    reduced = frame.mass * rider.mass / mass
    dx, dz = frame.x - rider.x, frame.height - rider.height
    return Frame(
        mass,
        (frame.mass * frame.x + rider.mass * rider.x) / mass,
        (frame.mass * frame.height + rider.mass * rider.height) / mass,
        frame.Ixx + rider.Ixx + reduced * dz * dz,
        frame.Iyy + rider.Iyy + reduced * (dx * dx + dz * dz),
        frame.Izz + rider.Izz + reduced * dx * dx,
        frame.Ixz - reduced * dx * dz,
    )


def _numbers(mapping: Any, keys: tuple[str, ...], where: str, section: str) -> dict[str, float]:
    """Return a section of plain numbers."""
    values = require_keys(mapping, keys, f"{where}, section '{section}'")
    for key, value in values.items():
        require_finite(where.removeprefix("vehicle '").removesuffix("'"), f"{section}.{key}", value)
    return {key: float(value) for key, value in values.items()}


def _section(mapping: Any, kind: type[_Section], where: str, section: str) -> _Section:
    """Return a section of the file as its dataclass."""
    return kind(**_numbers(mapping, tuple(f.name for f in fields(kind)), where, section))  # type: ignore[arg-type]
