"""Limits of a machine: how much it turns, drives and brakes at the same time, over speed and load (g-g-g-v diagram).

`envelope` tabulates the quasi-steady equilibrium of `bike_sim.physics.superbike.equilibrium` with the full friction of
the tyres; a lap-time simulation needs nothing else of a machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.superbike import equilibrium as eq
from bike_sim.physics.superbike import statics
from bike_sim.physics.superbike.rider import steering_effort
from bike_sim.schema import GRAVITY
from bike_sim.vehicles.superbike import Record, Superbike

FloatArray = NDArray[np.float64]

LOADS: Final = (0.5, 1.0, 1.5)
"""Loads of the tables, in parts of that on level ground; between and beyond them values are linear."""
USE_SAMPLES: Final = 31
ROLL_RATES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Roll rates of the tables, rad/s; the electronics answer no more beyond the last."""

LEAN_RATE_REACHED: Final = 1.1
"""Lean rate that a machine reaches, by that of its rider's reference: it follows by feedback and so passes it at times;
over 0.4 s by at most 1.07 in rides."""

KEPT: Final = 256
"""Machines whose limits are kept: plans of many worlds ask for the same ones again."""

LATERAL, DRIVE, BRAKE = range(3)
_LEAST_EFFORT: Final = 1e-6
_LEANS: Final = 121
_LEAST_LOAD, _MOST_LOAD = 0.1, 2.5
_AIR_DENSITY = 1.2
_POINT_MASS: Final = 281.0  # kg
_POINT_MASS_POWER: Final = 151_800.0  # W, at the road
_POINT_MASS_DRAG_AREA: Final = 0.33  # m2
_POINT_MASS_WHEELIE_G, _POINT_MASS_STOPPIE_G = 1.13, 1.15  # g, at which a wheel lifts, without drag
_POINT_MASS_TOP_SPEED: Final = 110.0  # m/s, end of the tables


class Limits(NamedTuple):
    """An envelope as compiled code reads it: lowest speed and spacing of the speeds (m/s), and tables of `Envelope`."""

    first: float
    spacing: float
    loads: FloatArray
    lateral: FloatArray
    drive: FloatArray
    brake: FloatArray
    lean: FloatArray


@dataclass(frozen=True)
class Envelope:
    """Quasi-steady limits of a machine. Accelerations are those of its mass, in m/s^2.

    Use is the part of the largest lateral acceleration that a turn takes. It is tabulated over its arc sine, because
    what a friction ellipse leaves has an infinite slope over use itself.

    Attributes:
        name: the machine's name.
        speeds: m/s, increasing in equal steps, shape (n,).
        loads: loads of the tables in parts of that on level ground, shape (l,).
        lateral_table: largest lateral acceleration, shape (l, n).
        drive_table: largest net forward acceleration, resistance taken off, over load, speed, use (its arc sine
            from 0 to pi/2 in equal steps) and roll rate (0 to 1 rad/s in equal steps), shape
            (l, n, u, r); negative where the resistance is larger.
        brake_table: largest deceleration, resistance included, shape (l, n, u).
        lean_table: lean of the steady turn, rad, shape (l, n, u).
        drag: deceleration by the air and by rolling, upright, shape (n,).
        inside: how far the mass is inside the line of contacts, m, over lean from 0 to 90 deg in equal steps.
        height: how high it is, m, of the same shape; zeros for a point mass on the road.
        sway: length of the pendulum that the machine is about the line of contacts, m; 0 for a point mass.
        lean_rate: largest lean rate that the rider can ask for, rad/s, shape (n,).
    """

    name: str
    speeds: FloatArray
    loads: FloatArray
    lateral_table: FloatArray
    drive_table: FloatArray
    brake_table: FloatArray
    lean_table: FloatArray
    drag: FloatArray
    inside: FloatArray
    height: FloatArray
    sway: float
    lean_rate: FloatArray

    def __post_init__(self) -> None:
        """Make the arrays read-only.

        Raises:
            ValueError: naming an array that is not finite, or a limit that is not positive.
        """
        for field in fields(self):
            if field.name in ("name", "sway"):
                continue
            values = np.array(getattr(self, field.name), dtype=np.float64)
            positive = field.name not in ("lateral_table", "lean_rate") or (values > 0.0).all()
            if not (np.isfinite(values).all() and positive):
                raise ValueError(f"envelope '{self.name}': {field.name} must be finite, and a limit positive")
            values.setflags(write=False)
            object.__setattr__(self, field.name, values)

    @property
    def limits(self) -> Limits:
        """The tables for compiled code."""
        return Limits(
            float(self.speeds[0]),
            float(self.speeds[1] - self.speeds[0]),
            self.loads,
            self.lateral_table,
            self.drive_table,
            self.brake_table,
            self.lean_table,
        )

    @property
    def lateral_max(self) -> FloatArray:
        """Largest lateral acceleration on level ground over `speeds`, m/s^2."""
        return self.lateral(self.speeds)

    def lateral(self, speed: FloatArray | float, load: float = 1.0) -> FloatArray:
        """Return the largest lateral acceleration at a speed (m/s) and load (1 on level ground), m/s^2."""
        return self._look_up(LATERAL, speed, 0.0, load)

    def drive(
        self, speed: FloatArray | float, lateral: FloatArray | float = 0.0, load: float = 1.0, roll_rate: float = 0.0
    ) -> FloatArray:
        """Return the largest net forward acceleration, m/s^2; negative where resistance beats what the tyres have left.

        Args:
            speed: m/s.
            lateral: acceleration, m/s^2, of either sign.
            load: 1 on level ground.
            roll_rate: rad/s.
        """
        return self._look_up(DRIVE, speed, lateral, load, roll_rate)

    def brake(self, speed: FloatArray | float, lateral: FloatArray | float = 0.0, load: float = 1.0) -> FloatArray:
        """Return the largest deceleration, resistance included, m/s^2; see `drive`."""
        return self._look_up(BRAKE, speed, lateral, load)

    def _look_up(
        self, kind: int, speed: FloatArray | float, lateral: FloatArray | float, load: float, roll_rate: float = 0.0
    ) -> FloatArray:
        speeds, sides = np.broadcast_arrays(np.asarray(speed, dtype=np.float64), np.asarray(lateral, dtype=np.float64))
        # copies: an array that may not be written is another type to compiled code, which would compile once more
        found = _each(self.limits, kind, speeds.flatten(), np.abs(sides).flatten(), float(load), float(roll_rate))
        return found.reshape(speeds.shape)

    def within(self, share: float) -> Envelope:
        """Return the envelope of somebody who turns with no more than a share of the lateral limit.

        Raises:
            ValueError: a share outside 0 to 1.
        """
        if not 0.0 < share <= 1.0:
            raise ValueError(f"share of the lateral limit must lie in (0, 1], got {share!r}")
        count = self.brake_table.shape[2]
        use = np.arcsin(share * np.sin(np.linspace(0.0, 0.5 * math.pi, count)))
        at = use / (0.5 * math.pi) * (count - 1)
        i = np.minimum(at.astype(int), count - 2)

        def part(table: FloatArray) -> FloatArray:
            along = (at - i).reshape((1, 1, -1) + (1,) * (table.ndim - 3))
            return np.asarray((1.0 - along) * table[:, :, i] + along * table[:, :, i + 1])

        return replace(
            self,
            lateral_table=share * self.lateral_table,
            drive_table=part(self.drive_table),
            brake_table=part(self.brake_table),
            lean_table=part(self.lean_table),
        )

    def digest(self) -> bytes:
        """Return all numbers as bytes, for a hash."""
        return b"".join(
            np.ascontiguousarray(getattr(self, field.name), dtype=np.float64).tobytes()
            for field in fields(self)
            if field.name != "name"
        )


def left_by_turning(count: int, exponent: float, decline: float) -> FloatArray:
    """Return what turning leaves of driving or braking, ``(1 - use^exponent)^decline``, over the samples of a table.

    Args:
        count: samples of the used part of the lateral limit, see `Envelope.drive_table`.
        exponent: of the used part.
        decline: power of what it leaves; the inverse of the exponent makes a (super)ellipse.
    """
    use = np.sin(np.linspace(0.0, 0.5 * math.pi, count))
    return np.asarray(np.maximum(1.0 - use**exponent, 0.0) ** decline)


def ellipse_envelope(
    name: str,
    speeds: FloatArray,
    lateral_max: FloatArray,
    drive_max: FloatArray,
    brake_max: FloatArray,
    grip_drive_max: FloatArray,
    drag: FloatArray,
    exponent: float = 2.0,
) -> Envelope:
    """Return the envelope of a point mass whose limits combine as a (super)ellipse.

    While it turns with lateral acceleration ``a``, what the tyres can still do along the road shrinks as
    ``(1 - (a / lateral_max)^exponent)^(1 / exponent)``; what the engine and the air do does not.

    Args:
        name: the machine's name.
        speeds: m/s, in equal steps, shape (n,).
        lateral_max: largest lateral acceleration, m/s^2, shape (n,).
        drive_max: largest net forward acceleration going straight, drag taken off.
        brake_max: largest deceleration going straight, drag included.
        grip_drive_max: what the tyres would allow the engine to do, drag not taken off.
        drag: deceleration by the air alone.
        exponent: of the combination; 2 is an ellipse.

    Raises:
        ValueError: an array that is wrong, or an exponent that is not positive.
    """
    if not exponent > 0.0:
        raise ValueError(f"envelope '{name}': exponent = {exponent} must be positive")
    loads = np.array(LOADS)
    left = left_by_turning(USE_SAMPLES, exponent, 1.0 / exponent)
    grip = loads[:, None, None] * grip_drive_max[:, None] * left - drag[:, None]
    brake = loads[:, None, None] * (brake_max - drag)[:, None] * left + drag[:, None]
    return Envelope(
        name,
        speeds,
        loads,
        lateral_table=np.outer(loads, lateral_max),
        drive_table=np.repeat(np.minimum(drive_max[:, None], grip)[..., None], 2, axis=3),
        brake_table=brake,
        lean_table=np.arctan(np.sin(np.linspace(0.0, 0.5 * math.pi, USE_SAMPLES)) * lateral_max[:, None] / GRAVITY)
        * np.ones((len(loads), 1, 1)),
        drag=drag,
        inside=np.zeros(2),
        height=np.zeros(2),
        sway=0.0,
        lean_rate=np.full_like(speeds, 1e3),
    )


def point_mass_envelope(lateral_g: float = 1.4) -> Envelope:
    """Return the limits of a superbike reduced to a point mass, to compare circuits and lines with.

    A litre superbike with its rider: mass and drag area from the motorcycle simulators' parameter sets (Sharp &
    Limebeer 2001 among others), 165 kW at the crank with 92 % reaching the road, the wheelie limit of a centre of mass
    0.70 m ahead of the rear contact and 0.62 m high, a stoppie limit estimated the same way.

    Args:
        lateral_g: largest lateral acceleration, g.

    Raises:
        ValueError: it is not positive and finite.
    """
    if not math.isfinite(lateral_g) or lateral_g <= 0.0:
        raise ValueError(f"lateral_g of a point mass must be positive and finite, got {lateral_g!r}")
    speeds = np.arange(1.0, _POINT_MASS_TOP_SPEED + 1.0)
    drag = 0.5 * _AIR_DENSITY * _POINT_MASS_DRAG_AREA * speeds**2 / _POINT_MASS
    lifting = np.full_like(speeds, _POINT_MASS_WHEELIE_G * GRAVITY)
    return ellipse_envelope(
        name=f"point mass {lateral_g:g} g",
        speeds=speeds,
        lateral_max=np.full_like(speeds, lateral_g * GRAVITY),
        drive_max=np.minimum(lifting, _POINT_MASS_POWER / (_POINT_MASS * speeds)) - drag,
        brake_max=_POINT_MASS_STOPPIE_G * GRAVITY + drag,
        grip_drive_max=lifting,
        drag=drag,
    )


@lru_cache(maxsize=KEPT)
def envelope(vehicle: Superbike) -> Envelope:
    """Return the limits of a machine from 5 m/s to beyond its top speed, with all that tyres and electronics give."""
    speeds = np.arange(5.0, 1.1 * vehicle.top_gear_speed, 1.0)
    machine = vehicle.machine
    inertia = statics.inertial_mass(vehicle)
    engine = np.array([statics.engine_force(vehicle, float(speed)) for speed in speeds])
    lateral, drive, brake, lean = _tables(
        speeds, engine, np.array(LOADS), np.array(ROLL_RATES), statics.spread(vehicle), inertia, machine
    )
    drag = np.array([statics.rolling_drag(vehicle, float(speed)) for speed in speeds]) / inertia
    if vehicle.motor.shift_time > 0.0:
        # what a shift loses is spread over the speeds between it and its neighbours
        lost = vehicle.motor.shift_time * (drive + drag[:, None, None])
        span = _speeds_by_shift(vehicle, speeds)[:, None, None]
        drive = np.where(drive > 0.0, drive * span / (span + lost), drive)
    places = np.array([eq.turning_place(at, machine) for at in np.linspace(0.0, 0.5 * math.pi, 91)])
    rider = vehicle.virtual_rider
    effort = np.array([max(steering_effort(float(speed), machine)[0], _LEAST_EFFORT) for speed in speeds])
    return Envelope(
        vehicle.name,
        speeds,
        np.array(LOADS),
        lateral,
        drive,
        brake,
        lean,
        drag=drag,
        inside=places[:, 0],
        height=places[:, 1],
        sway=statics.sway_length(vehicle),
        lean_rate=LEAN_RATE_REACHED * np.minimum(rider.lean_rate, rider.gyro_share * rider.torque / effort),
    )


def _speeds_by_shift(vehicle: Superbike, speeds: FloatArray) -> FloatArray:
    """Return the span of speeds that belongs to the shift nearest to each speed, m/s."""
    shifts = np.flatnonzero(np.diff(vehicle.wheel_gear)) * vehicle.wheel_torque_spacing * vehicle.rR
    inner = 0.5 * (shifts[1:] + shifts[:-1])
    bounds = np.concatenate(([0.0], inner, [speeds[-1]]))
    return np.diff(bounds)[np.searchsorted(inner, speeds)]


@njit(cache=True)
def _tables(
    speeds: np.ndarray, engine: np.ndarray, loads: np.ndarray, rates: np.ndarray, spread: float, inertia: float,
    m: Record,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return the tables of a machine: lateral, drive, brake, lean; see `Envelope`."""
    nl, nv, nu, nr = len(loads), len(speeds), USE_SAMPLES, len(rates)
    lateral, drive = np.empty((nl, nv)), np.empty((nl, nv, nu, nr))
    brake, lean = np.empty((nl, nv, nu)), np.empty((nl, nv, nu))
    sides, leans = np.empty(_LEANS), np.empty(_LEANS)
    for i in range(nl):
        gravity = loads[i] * m.g
        for j in range(nv):
            speed = speeds[j]
            most = eq.steepest(speed, gravity, spread, inertia, m)
            for k in range(_LEANS):
                leans[k] = most * k / (_LEANS - 1)
                sides[k] = eq.steady_lateral(leans[k], speed, gravity, spread, m)
            lateral[i, j] = sides[-1]
            for k in range(nu):
                side = sides[-1] * math.sin(0.5 * math.pi * k / (nu - 1))
                lean[i, j, k] = np.interp(side, sides, leans)
                turn = eq.Turn(speed, lean[i, j, k], side, gravity, inertia)
                brake[i, j, k] = eq.most_brake(turn, m)
                for n in range(nr):
                    drive[i, j, k, n] = eq.most_drive(turn, engine[j], rates[n], m)
    return lateral, drive, brake, lean


# ---------------------------------------------------------------------------------------------------- compiled look-up


@njit(cache=True)
def _place(value: float, first: float, spacing: float, count: int) -> tuple[int, float]:
    """Return the sample before a value and the way to the next one, 0 to 1; values outside are held."""
    at = min(max((value - first) / spacing, 0.0), count - 1.0)
    i = min(int(at), count - 2)
    return i, at - i


@njit(cache=True)
def _load_place(load: float, loads: np.ndarray) -> tuple[int, float]:
    """Return the load before and the way to the next, which goes on beyond the ends."""
    load = min(max(load, _LEAST_LOAD), _MOST_LOAD)
    i = 0
    while i < len(loads) - 2 and load > loads[i + 1]:
        i += 1
    return i, (load - loads[i]) / (loads[i + 1] - loads[i])


@njit(cache=True)
def most_lateral(limits: Limits, speed: float, load: float) -> float:
    """Return the largest lateral acceleration, m/s^2."""
    i, p = _load_place(load, limits.loads)
    j, q = _place(speed, limits.first, limits.spacing, limits.lateral.shape[1])
    low = limits.lateral[i, j] + q * (limits.lateral[i, j + 1] - limits.lateral[i, j])
    high = limits.lateral[i + 1, j] + q * (limits.lateral[i + 1, j + 1] - limits.lateral[i + 1, j])
    return low + p * (high - low)


@njit(cache=True)
def _use_place(limits: Limits, speed: float, lateral: float, load: float) -> tuple[int, float]:
    used = min(abs(lateral) / most_lateral(limits, speed, load), 1.0)
    count = limits.brake.shape[2]
    return _place(math.asin(used), 0.0, 0.5 * math.pi / (count - 1), count)


@njit(cache=True)
def most_drive(limits: Limits, speed: float, lateral: float, load: float, roll_rate: float) -> float:
    """Return the largest net acceleration, m/s^2."""
    i, p = _load_place(load, limits.loads)
    j, q = _place(speed, limits.first, limits.spacing, limits.lateral.shape[1])
    k, t = _use_place(limits, speed, lateral, load)
    rates = limits.drive.shape[3]
    n, r = _place(abs(roll_rate), 0.0, 1.0 / max(rates - 1, 1), rates)
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = (p if a else 1.0 - p) * (q if b else 1.0 - q) * (t if c else 1.0 - t)
                row = limits.drive[i + a, j + b, k + c]
                total += weight * ((1.0 - r) * row[n] + r * row[n + 1])
    return total


@njit(cache=True)
def most_brake(limits: Limits, speed: float, lateral: float, load: float) -> float:
    """Return the largest deceleration, m/s^2."""
    i, p = _load_place(load, limits.loads)
    j, q = _place(speed, limits.first, limits.spacing, limits.lateral.shape[1])
    k, t = _use_place(limits, speed, lateral, load)
    total = 0.0
    for a in range(2):
        for b in range(2):
            weight = (p if a else 1.0 - p) * (q if b else 1.0 - q)
            row = limits.brake[i + a, j + b]
            total += weight * ((1.0 - t) * row[k] + t * row[k + 1])
    return total


@njit(cache=True)
def lateral_by_lean(limits: Limits, speed: float, lean: float) -> float:
    """Return the lateral acceleration of the steady turn at a lean (rad, >= 0) on level ground, m/s^2.

    Beyond the steepest lean it grows on as that lean's tangent.
    """
    i, p = _load_place(1.0, limits.loads)
    j, q = _place(speed, limits.first, limits.spacing, limits.lateral.shape[1])
    count = limits.lean.shape[2]
    spacing = 0.5 * math.pi / (count - 1)
    before = 0.0
    for k in range(1, count):
        low = limits.lean[i, j, k] + q * (limits.lean[i, j + 1, k] - limits.lean[i, j, k])
        high = limits.lean[i + 1, j, k] + q * (limits.lean[i + 1, j + 1, k] - limits.lean[i + 1, j, k])
        here = low + p * (high - low)
        if here >= lean or k == count - 1:
            share = (lean - before) / (here - before)
            if share <= 1.0:
                used = math.sin(spacing * (k - 1)) + share * (math.sin(spacing * k) - math.sin(spacing * (k - 1)))
                return used * most_lateral(limits, speed, 1.0)
            return most_lateral(limits, speed, 1.0) * math.tan(min(lean, 1.4)) / math.tan(here)
        before = here
    return 0.0


@njit(cache=True)
def _each(
    limits: Limits, kind: int, speed: np.ndarray, lateral: np.ndarray, load: float, roll_rate: float
) -> np.ndarray:
    """Return one of the largest accelerations for each speed and lateral acceleration, m/s^2."""
    found = np.empty(len(speed))
    for i in range(len(speed)):
        if kind == LATERAL:
            found[i] = most_lateral(limits, speed[i], load)
        elif kind == DRIVE:
            found[i] = most_drive(limits, speed[i], lateral[i], load, roll_rate)
        else:
            found[i] = most_brake(limits, speed[i], lateral[i], load)
    return found
