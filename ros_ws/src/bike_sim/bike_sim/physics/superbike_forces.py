"""All forces on a superbike at one instant, in one compiled function: tyres, air, engine, brakes, rider.

The engine hands in the motion of the rear frame and the joints, and gets forces and torques back; who integrates the
bodies does not matter here. Everything that has a memory (transient slips, lags, the rider's reference, the history
of slides) lives in one vector and is advanced by one step in the same call.

Vectors are in map axes (z up). ``n`` is a wheel's axle, to the left; ``t`` its heading on the ground, ``l`` left of it.
Geometry of the toroidal tyre: the lowest point lies one crown radius straight below the lowest point of the ring
through the middles of its cross-sections, and it has the velocity of the wheel carrier's material there plus that of
the wheel's rotation about its axle, ``-R_e spin`` along t, with ``R_e = R - crown (1 - cos camber)``.

Falls are named by what went before:

* low side: the machine lies on the side it was leaning to when a tyre slid, or slides broadside;
* high side: after a slide it is thrown over to the other side;
* stoppie, wheelie: it went over the front or the rear wheel, past the point of balance;
* tip over: it fell to a side with both tyres holding, as when it is too slow.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import mapping, tyres
from bike_sim.physics.pybullet_tree import principal_axes
from bike_sim.vehicles.superbike import MACHINE_NAMES, Superbike

FloatArray = NDArray[np.float64]
Vec = tuple[float, float, float]
Wheel = tuple[float, float, float, float, float]

# --- memory -----------------------------------------------------------------------------------------------------------
MEMORY_NAMES: Final = (
    "rear_slip", "rear_drift", "front_slip", "front_drift", "lean_reference", "lean_reference_rate", "integral",
    "drive", "brake", "front_load", "slide_side", "slide_age", "fall",
)  # fmt: skip
"""What the forces remember from step to step; `fall` is an index of `FALL_NAMES`."""
(
    M_REAR_SLIP, M_REAR_DRIFT, M_FRONT_SLIP, M_FRONT_DRIFT, M_LEAN, M_LEAN_RATE, M_INTEGRAL, M_DRIVE, M_BRAKE,
    M_FRONT_LOAD, M_SLIDE_SIDE, M_SLIDE_AGE, M_FALL,
) = range(len(MEMORY_NAMES))  # fmt: skip

FALL_NAMES: Final = ("none", "low_side", "high_side", "tip_over", "stoppie", "wheelie")
NO_FALL, LOW_SIDE, HIGH_SIDE, TIP_OVER, STOPPIE, WHEELIE = range(len(FALL_NAMES))

# --- telemetry --------------------------------------------------------------------------------------------------------
TELEMETRY_NAMES: Final = (
    "speed_m_s", "pitch_rad", "acceleration_long_m_s2", "acceleration_lat_m_s2", "yaw_rate_rad_s",
    "rear_load_n", "front_load_n", "rear_slip", "front_slip", "rear_slip_angle_rad", "front_slip_angle_rad",
    "rear_camber_rad", "front_camber_rad",
    "rear_force_long_n", "rear_force_lat_n", "front_force_long_n", "front_force_lat_n",
    "rear_use", "front_use", "steer_torque_nm", "lean_reference_rad", "rider_slide_m",
    "drive_torque_nm", "engine_power_w", "front_brake_nm", "rear_brake_nm",
    "traction_cut", "wheelie_cut", "front_brake_cut", "rear_brake_cut", "drag_n", "fall",
    "traction_active", "wheelie_active", "brake_active", "stoppie_active",
)  # fmt: skip
"""What is measured at every step: forces on the machine along the wheel's heading and to its left; `*_use` is the
normalised slip (1 is linear saturation, the peak lies at `tyres.peak_slip`); cuts are 1 for none, 0 for all; an aid is
active (1, else 0) where it allows less than the command asks for, by its limit ahead or its cut after the fact."""
(
    T_SPEED, T_PITCH, T_ALONG, T_LATERAL, T_YAW_RATE, T_REAR_LOAD, T_FRONT_LOAD, T_REAR_SLIP, T_FRONT_SLIP,
    T_REAR_DRIFT, T_FRONT_DRIFT, T_REAR_CAMBER, T_FRONT_CAMBER, T_REAR_FX, T_REAR_FY, T_FRONT_FX, T_FRONT_FY,
    T_REAR_USE, T_FRONT_USE, T_STEER_TORQUE, T_LEAN_REFERENCE, T_SLIDE, T_DRIVE, T_POWER, T_FRONT_BRAKE, T_REAR_BRAKE,
    T_TRACTION_CUT, T_WHEELIE_CUT, T_FRONT_CUT, T_REAR_CUT, T_DRAG, T_FALL,
    T_TRACTION_ACTIVE, T_WHEELIE_ACTIVE, T_BRAKE_ACTIVE, T_STOPPIE_ACTIVE,
) = range(len(TELEMETRY_NAMES))  # fmt: skip

# --- constants of the machine (Superbike.machine) ---------------------------------------------------------------------
(
    _W, _C, _LAM, _G, _RR, _RF, _IRYY, _IFYY, _FALL_ROLL, _MAX_STEER, _MASS, _COM_X, _COM_H,
    _RIDER_MASS, _RIDER_X, _RIDER_H, _RIDER_IXX, _RIDER_IYY, _RIDER_IZZ, _SLIDE, _SLIDE_LEAN, _SLIDE_FREQUENCY,
    _DENSITY, _DRAG_AREA, _DOWN_AREA, _AIR_X, _AIR_H,
    _POWER, _POWER_RPM, _TORQUE, _TORQUE_RPM, _LIMITER, _LOW_TORQUE, _EFFICIENCY, _GEARS, _FIRST, _TOP, _DRIVE_LAG,
    _ENGINE_BRAKE, _CRANK,
    _BRAKE_FORCE, _FRONT_SHARE, _BRAKE_LAG,
    _DAMPER_SLOW, _DAMPER_FAST, _SLOW, _FAST, _STOP,
    _MAX_LEAN, _FREQUENCY, _LEAN_RATE, _LEAN_ACCELERATION, _GYRO_SHARE, _MAX_TORQUE, _HOLD, _LEAN_GAIN,
    _RATE_GAIN_SLOW, _RATE_GAIN_FAST, _INTEGRAL_GAIN, _INTEGRAL_TORQUE,
    _TC, _TC_SHARE, _TC_ON, _TC_OFF, _WC, _WC_KEEP, _WC_LEAN, _WC_ON, _WC_OFF,
    _BC, _BC_SHARE, _BC_ON, _BC_OFF, _SC, _SC_KEEP, _SC_ON, _SC_OFF,
) = range(len(MACHINE_NAMES))  # fmt: skip

_STOP_STIFFNESS: Final = 4000.0  # N m/rad of the steering stop
_STOP_DAMPING: Final = 20.0  # N m s/rad
_FEELING_LAG: Final = 0.2  # s until the rider feels a change of the front wheel's load
_ARM_STIFFNESS: Final = 300.0  # N m/rad of arms that hold the bars straight while the front wheel is in the air
_ARM_DAMPING: Final = 20.0  # N m s/rad
_THROW_RATE: Final = 1.0  # rad/s of roll at which the electronics keep the front wheel as loaded as lying flat
_ASKS: Final = 0.01  # part of full throttle or full brake below which an aid has nothing to hold back
_LIGHT: Final = 0.5  # part of the standing machine's front load below which the wheel feels light
_LIGHTEST_HAND: Final = 0.25  # part of the gains left when the front wheel is in the air
_SLIDING: Final = 1.15  # times the peak slip from which a tyre counts as sliding
_SLIDE_LEAN_MIN: Final = 0.15  # rad; upright a slide has no side
_SLIDE_MEMORY: Final = 1.5  # s a slide explains a fall
_THROWN_RATE: Final = 6.0  # rad/s of roll away from the slide at which nobody stays on
_SPUN: Final = math.cos(math.radians(60.0))  # of the angle between heading and way at which a slide is a crash
_SLIDE_SPEED: Final = 4.0  # m/s; what slips while falling over at a walk is no slide
_OVER: Final = math.sin(math.radians(55.0))  # pitch beyond every machine's point of balance


# --- geometry in the rear frame's principal axes ----------------------------------------------------------------------
GEOMETRY_SIZE: Final = 14
(
    _COS_P, _SIN_P, _AXLE_X, _AXLE_Z, _HEAD_X, _HEAD_Z, _FRONT_U, _COS_T, _SIN_T, _AIR_DX, _AIR_DZ, G_REAR_STATIC,
    G_FRONT_STATIC, _TORQUE_SPACING,
) = range(GEOMETRY_SIZE)  # fmt: skip


def bare_geometry(vehicle: Superbike, bare: Superbike) -> FloatArray:
    """Return the constants of `step` that come from where the bodies are, shape (GEOMETRY_SIZE,).

    Args:
        vehicle: the machine.
        bare: the same whose rear body is the frame without rider; its centre of mass is the origin here.
    """
    reference = mapping.layout(bare)
    origin = reference.centres[mapping.REAR_FRAME]
    axle, head = reference.centres[mapping.REAR_WHEEL] - origin, reference.head - origin
    hub = reference.centres[mapping.FRONT_WHEEL] - reference.head
    cos_tilt, sin_tilt = math.cos(vehicle.lam), math.sin(vehicle.lam)
    quaternion, _ = principal_axes(mapping.inertia_tensors(bare)[mapping.REAR_FRAME])
    angle = 2.0 * math.atan2(quaternion[1], quaternion[3])
    x, _ = vehicle.centre_of_mass
    weight = vehicle.mass * vehicle.g
    front = weight * x / vehicle.w
    return np.array(
        [
            math.cos(angle), math.sin(angle), axle[0], axle[2], head[0], head[2],
            hub[0] * cos_tilt + hub[2] * sin_tilt, cos_tilt, sin_tilt,
            vehicle.air.x - origin[0], vehicle.air.height - origin[2],
            (weight - front) / vehicle.rear_tyre.stiffness, front / vehicle.front_tyre.stiffness,
            vehicle.wheel_torque_spacing,
        ]
    )  # fmt: skip


@njit(cache=True)
def _scale(factor: float, a: Vec) -> Vec:
    return factor * a[0], factor * a[1], factor * a[2]


@njit(cache=True)
def _add(a: Vec, b: Vec) -> Vec:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True)
def _mix(p: float, a: Vec, q: float, b: Vec) -> Vec:
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@njit(cache=True)
def _dot(a: Vec, b: Vec) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _cross(a: Vec, b: Vec) -> Vec:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def frame_axes(q: tuple[float, float, float, float], geometry: FloatArray) -> tuple[Vec, Vec, Vec]:
    """Return the rear frame's x, y and z axes in the map, from the orientation of its principal axes."""
    x, y, z, w = q
    px = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)
    ey = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)
    pz = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    c, s = geometry[_COS_P], geometry[_SIN_P]
    return _mix(c, px, s, pz), ey, _mix(-s, px, c, pz)


@njit(cache=True)
def fork_axes(ex: Vec, ey: Vec, ez: Vec, steer: float, geometry: FloatArray) -> tuple[Vec, Vec, Vec]:
    """Return the fork's axes: across the steering axis forward, the front axle, and the steering axis upward."""
    c, s = geometry[_COS_T], geometry[_SIN_T]
    axis = _mix(-s, ex, c, ez)
    ahead = _mix(c, ex, s, ez)
    cs, ss = math.cos(steer), math.sin(steer)
    return _mix(cs, ahead, ss, ey), _mix(cs, ey, -ss, ahead), axis


@njit(cache=True)
def wheel_contact(centre: Vec, n: Vec, radius: float, crown: float) -> tuple[Vec, Vec, Vec, float]:
    """Return ``(point, t, l, R_e)``: where a torus meets the ground, its heading, its left and its rolling radius.

    The point is the lowest of the undeformed tyre; its height is the gap, negative when pressed in.
    """
    k = math.sqrt(max(1e-12, n[0] * n[0] + n[1] * n[1]))
    ring = radius - crown
    # down in the wheel's plane: -(z - n_z n) / k
    down = n[2] * n[0] / k, n[2] * n[1] / k, -k
    point = centre[0] + ring * down[0], centre[1] + ring * down[1], centre[2] + ring * down[2] - crown
    heading = n[1] / k, -n[0] / k, 0.0
    left = n[0] / k, n[1] / k, 0.0
    return point, heading, left, ring + crown * k


@njit(cache=True)
def _between(value: float, low: float, high: float) -> float:
    """Return 0 at and below `low`, 1 at and above `high`, linear between."""
    return min(max((value - low) / (high - low), 0.0), 1.0)


@njit(cache=True)
def _lookup(table: FloatArray, position: float) -> float:
    """Return a table at a fractional index, 0 beyond its end."""
    if position <= 0.0:
        return table[0]
    i = int(position)
    if i >= table.size - 1:
        return 0.0
    return table[i] + (position - i) * (table[i + 1] - table[i])


@njit(cache=True)
def _wheel(
    memory: FloatArray, first: int, point: Vec, velocity: Vec, carrier_rate: Vec, n: Vec, t: Vec, l: Vec,  # noqa: E741
    rolling_radius: float, spin: float, grip: float, step: float, tyre: FloatArray,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Return ``(Fx, Fy, Fz, Mz, s)`` of a tyre and advance its transient slips.

    Args:
        memory: of the machine.
        first: index of the longitudinal slip in it, the lateral follows.
        point: lowest point, m.
        velocity: of the carrier's material there, m/s.
        carrier_rate: its angular velocity, rad/s.
        n: axle.
        t: heading.
        l: left.
        rolling_radius: m.
        spin: of the wheel relative to its carrier, rad/s.
        grip: factor on friction.
        step: s.
        tyre: its parameters.
    """
    load = tyres.normal_load(point[2], velocity[2], tyre)
    along = _dot(velocity, t)
    # the contact wanders along the ground with the wheel's centre, whatever the pitch rate of its carrier
    speed = abs(along + _dot(carrier_rate, n) * rolling_radius)
    memory[first] = tyres.relax(memory[first], spin * rolling_radius - along, speed, tyre[tyres.SLIP_RELAXATION], step)
    memory[first + 1] = tyres.relax(memory[first + 1], _dot(velocity, l), speed, tyre[tyres.RELAXATION], step)
    if load <= 0.0:
        memory[first] = memory[first + 1] = 0.0  # a tyre in the air forgets
    camber = math.asin(min(max(n[2], -1.0), 1.0))
    fx, fy, mz, use = tyres.forces(memory[first], memory[first + 1], camber, load, grip, tyre)
    return fx, fy, load, mz, use


@njit(cache=True)
def _ride(
    memory: FloatArray, steering: float, roll: float, roll_rate: float, steer: float, steer_rate: float, speed: float,
    front_fx: float, step: float, m: FloatArray, front_crown: float, load_share: float,
) -> float:  # fmt: skip
    """Advance the virtual rider's reference and return the steering torque, N m, positive to the left.

    Countersteering is in the sign: a torque to the left makes the machine lean to the right. What the front tyre does
    with steering goes with its load, and so do the rider's hands: `load_share` is that load by the standing machine's.
    When the wheel is light he holds the bars straight, so that it does not land across.
    """
    fast = _between(speed, m[_SLOW], m[_FAST])
    gyro = m[_IFYY] / m[_RF] * math.cos(m[_LAM]) * abs(speed)
    # Reference model, critically damped, no faster than the torque can follow
    limit = min(m[_LEAN_RATE], m[_GYRO_SHARE] * m[_MAX_TORQUE] / max(gyro, 1e-6))
    target = -steering * math.radians(m[_MAX_LEAN])
    lean, rate, wn = memory[M_LEAN], memory[M_LEAN_RATE], m[_FREQUENCY]
    change = wn * (wn * (target - lean) - 2.0 * rate)
    rate += step * min(max(change, -m[_LEAN_ACCELERATION]), m[_LEAN_ACCELERATION])
    rate = min(max(rate, -limit), limit)
    lean += step * rate
    memory[M_LEAN], memory[M_LEAN_RATE] = lean, rate
    error = lean - roll
    bound = m[_INTEGRAL_TORQUE]
    integral = min(max(memory[M_INTEGRAL] + step * m[_INTEGRAL_GAIN] * error, -bound), bound)
    memory[M_INTEGRAL] = integral
    damping = m[_RATE_GAIN_SLOW] + fast * (m[_RATE_GAIN_FAST] - m[_RATE_GAIN_SLOW])
    braking = -min(front_fx, 0.0) * front_crown * math.sin(roll) * math.cos(m[_LAM])
    hand = min(max(load_share / _LIGHT, _LIGHTEST_HAND), 1.0)
    ahead = hand * gyro * rate + braking - load_share * m[_HOLD] * math.sin(lean)
    arms = (1.0 - hand) * (_ARM_STIFFNESS * steer + _ARM_DAMPING * steer_rate)
    torque = hand * (m[_LEAN_GAIN] * error + damping * (rate - roll_rate) + integral) + ahead - arms
    return min(max(torque, -m[_MAX_TORQUE]), m[_MAX_TORQUE])


@njit(cache=True)
def force_limits(
    roll: float, roll_rate: float, squared_speed: float, m: FloatArray, tyre: FloatArray
) -> tuple[float, float]:
    """Return what the electronics together allow: drive and front brake force, N; see :func:`aid_limits`."""
    traction, wheelie, braking, stoppie = aid_limits(roll, roll_rate, squared_speed, m, tyre)
    return min(wheelie, traction), min(stoppie, braking)


@njit(cache=True)
def aid_limits(
    roll: float, roll_rate: float, squared_speed: float, m: FloatArray, tyre: FloatArray
) -> tuple[float, float, float, float]:
    """Return what each of the electronics allows at this lean and roll rate, N.

    These are the drive by traction and by wheelie control, and the front brake by brake and by stoppie control.

    Statics of the machine as a mass on two wheels, with its centre of mass lowered by the lean, drag and downforce;
    the turn takes its part of the friction ellipse, and `traction_share` of the rest is free. Without a control its
    limit is infinite.
    """
    sin_lean, cos_lean = abs(math.sin(roll)), max(math.cos(roll), 0.2)
    pressure = 0.5 * m[_DENSITY] * squared_speed
    drag, down = pressure * m[_DRAG_AREA], pressure * m[_DOWN_AREA] * cos_lean
    height, air_height = m[_COM_H] * cos_lean, m[_AIR_H] * cos_lean
    weight = m[_MASS] * m[_G]
    # With thrust T the machine accelerates by (T - drag) / mass, and the front load is front - T height / w
    front = (weight * m[_COM_X] + down * m[_AIR_X] - drag * (air_height - height)) / m[_W]
    rear = weight + down - front
    traction, wheelie, braking, stoppie = math.inf, math.inf, math.inf, math.inf
    if m[_WC] > 0.0:
        # a front wheel must also steer, most of all when the machine is thrown over
        keep = m[_WC_KEEP] + m[_WC_LEAN] * min(1.0, sin_lean + abs(roll_rate) / _THROW_RATE)
        wheelie = max(0.0, (front - keep) * m[_W] / height)
    if m[_SC] > 0.0:
        stoppie = max(0.0, (rear - m[_SC_KEEP]) * m[_W] / height)
    turn = sin_lean / cos_lean
    if m[_TC] > 0.0:
        mu = tyres.friction(roll, tyre[0])
        left = m[_TC_SHARE] * mu * tyre[0, tyres.FRICTION_RATIO] * math.sqrt(max(0.0, 1.0 - (turn / mu) ** 2))
        # the thrust itself loads the rear wheel; no more than all of the weight
        transfer = left * height / m[_W]
        traction = left * rear / (1.0 - transfer) if transfer < 1.0 else math.inf
    if m[_BC] > 0.0:
        mu = tyres.friction(roll, tyre[1])
        left = m[_BC_SHARE] * mu * tyre[1, tyres.FRICTION_RATIO] * math.sqrt(max(0.0, 1.0 - (turn / mu) ** 2))
        transfer = left * height / m[_W]
        braking = left * front / (1.0 - transfer) if transfer < 1.0 else math.inf
    return traction, wheelie, braking, stoppie


@njit(cache=True)
def _brake_torque(limit: float, spin: float, inertia: float, tyre_torque: float, step: float) -> float:
    """Return the torque of a brake that can hold up to `limit`, N m: it stops a wheel but never turns it back."""
    return min(max(-(inertia * spin / step + tyre_torque), -limit), limit)


@njit(cache=True)
def _drive_and_brake(
    memory: FloatArray, telemetry: FloatArray, throttle: float, roll: float, roll_rate: float, squared_speed: float,
    rear: Wheel, front: Wheel, dt: float, m: FloatArray, geometry: FloatArray, wheel_torque: FloatArray,
    tyre: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Return the torques of engine and brakes on the rear and the front wheel, N m, and write down what they did.

    ``rear`` and ``front`` are (spin, rolling radius, Fx, Fz, normalised slip) of the wheels.
    """
    rear_spin, rear_radius, rfx, rfz, rear_use = rear
    front_spin, front_radius, ffx, ffz, front_use = front
    memory[M_DRIVE] += (max(throttle, 0.0) - memory[M_DRIVE]) * -math.expm1(-dt / m[_DRIVE_LAG])
    memory[M_BRAKE] += (max(-throttle, 0.0) - memory[M_BRAKE]) * -math.expm1(-dt / m[_BRAKE_LAG])
    drive, brake = memory[M_DRIVE], memory[M_BRAKE]
    traction, wheelie, braking, stoppie = aid_limits(roll, roll_rate, squared_speed, m, tyre)
    traction_cut = wheelie_cut = front_cut = rear_cut = stoppie_cut = 1.0
    if m[_TC] > 0.0 and memory[M_REAR_SLIP] > 0.0:
        traction_cut = 1.0 - _between(rear_use, m[_TC_ON], m[_TC_OFF])
    if m[_WC] > 0.0:
        wheelie_cut = _between(ffz, m[_WC_OFF], m[_WC_ON])
    if m[_BC] > 0.0:
        front_cut = 1.0 - _between(front_use, m[_BC_ON], m[_BC_OFF])
        rear_cut = 1.0 - _between(rear_use, m[_BC_ON], m[_BC_OFF])
    if m[_SC] > 0.0:
        stoppie_cut = _between(rfz, m[_SC_OFF], m[_SC_ON])

    available = drive * _lookup(wheel_torque, rear_spin / geometry[_TORQUE_SPACING])
    drive_torque = traction_cut * wheelie_cut * min(available, min(wheelie, traction) * rear_radius)
    rear_brake = (1.0 - m[_FRONT_SHARE]) * brake * rear_cut * m[_BRAKE_FORCE] * m[_RR]
    asked = m[_FRONT_SHARE] * brake * m[_BRAKE_FORCE]
    front_brake = front_cut * stoppie_cut * min(asked, min(stoppie, braking)) * m[_RF]
    # closed throttle drags like a brake, and is eased like one where the rear tyre slips; so does rolling resistance
    engine_brake = rear_cut * (1.0 - drive) * m[_ENGINE_BRAKE] * m[_RR]
    rear_hold = rear_brake + engine_brake + tyre[0, tyres.ROLLING] * rfz * rear_radius
    front_hold = front_brake + tyre[1, tyres.ROLLING] * ffz * front_radius
    rear_torque = drive_torque + _brake_torque(rear_hold, rear_spin, m[_IRYY], drive_torque - rfx * rear_radius, dt)
    front_torque = _brake_torque(front_hold, front_spin, m[_IFYY], -ffx * front_radius, dt)

    telemetry[T_DRIVE], telemetry[T_POWER] = drive_torque, drive_torque * rear_spin / m[_EFFICIENCY]
    telemetry[T_FRONT_BRAKE], telemetry[T_REAR_BRAKE] = front_brake, rear_brake
    telemetry[T_TRACTION_CUT], telemetry[T_WHEELIE_CUT] = traction_cut, wheelie_cut
    telemetry[T_FRONT_CUT], telemetry[T_REAR_CUT] = front_cut * stoppie_cut, rear_cut
    drives, brakes = drive > _ASKS, brake > _ASKS
    telemetry[T_TRACTION_ACTIVE] = drives and (traction_cut < 1.0 or available > traction * rear_radius)
    telemetry[T_WHEELIE_ACTIVE] = drives and (wheelie_cut < 1.0 or available > wheelie * rear_radius)
    telemetry[T_BRAKE_ACTIVE] = brakes and (min(front_cut, rear_cut) < 1.0 or asked > braking)
    telemetry[T_STOPPIE_ACTIVE] = brakes and (stoppie_cut < 1.0 or asked > stoppie)
    return rear_torque, front_torque


@njit(cache=True)
def _damper_and_stop(steer: float, steer_rate: float, speed: float, m: FloatArray) -> float:
    """Return the torque of the steering damper and, beyond the largest angle, of the stop, N m."""
    fast = _between(speed, m[_SLOW], m[_FAST])
    torque = -(m[_DAMPER_SLOW] + fast * (m[_DAMPER_FAST] - m[_DAMPER_SLOW])) * steer_rate
    if abs(steer) > m[_MAX_STEER]:
        torque -= _STOP_STIFFNESS * (steer - math.copysign(m[_MAX_STEER], steer)) + _STOP_DAMPING * steer_rate
    return torque


@njit(cache=True)
def _air(velocity: Vec, up: Vec, m: FloatArray) -> Vec:
    """Return drag against the velocity and downforce in the machine's own plane, N."""
    squared = _dot(velocity, velocity)
    against = -0.5 * m[_DENSITY] * m[_DRAG_AREA] * math.sqrt(squared)
    return _mix(against, velocity, -0.5 * m[_DENSITY] * m[_DOWN_AREA] * squared, up)


@njit(cache=True)
def _fall(
    memory: FloatArray, roll: float, roll_rate: float, nose_up: float, rear_load: float, front_load: float,
    sliding: bool, sideways: bool, step: float, fall_roll: float,
) -> int:  # fmt: skip
    """Return how the machine falls at this instant, or `NO_FALL`, and remember slides."""
    if sliding and abs(roll) > _SLIDE_LEAN_MIN:
        memory[M_SLIDE_SIDE], memory[M_SLIDE_AGE] = math.copysign(1.0, roll), 0.0
    else:
        memory[M_SLIDE_AGE] += step
    slid = memory[M_SLIDE_AGE] < _SLIDE_MEMORY
    side = memory[M_SLIDE_SIDE]
    if nose_up < -_OVER and rear_load <= 0.0:
        return STOPPIE
    if nose_up > _OVER and front_load <= 0.0:
        return WHEELIE
    if slid and roll_rate * side < -_THROWN_RATE:
        return HIGH_SIDE
    if sideways:
        return LOW_SIDE
    if abs(roll) > fall_roll:
        if not slid:
            return TIP_OVER
        return LOW_SIDE if roll * side > 0.0 else HIGH_SIDE
    return NO_FALL


@njit(cache=True)
def read_state(
    position: Vec, orientation: tuple[float, float, float, float], omega: Vec, m: FloatArray, geometry: FloatArray,
    tyre: FloatArray,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Return ``(x, y, yaw, roll, roll_rate)``: the rear contact point in the map and the frame's angles."""
    ex, ey, ez = frame_axes(orientation, geometry)
    centre = _add(position, _mix(geometry[_AXLE_X], ex, geometry[_AXLE_Z], ez))
    point, t, _l, _radius = wheel_contact(centre, ey, m[_RR], tyre[0, tyres.CROWN])
    roll = math.atan2(ey[2], math.hypot(ey[0], ey[1]))
    return point[0], point[1], math.atan2(t[1], t[0]), roll, t[0] * omega[0] + t[1] * omega[1]


@njit(cache=True)
def settle(roll: float, steer: float, m: FloatArray, geometry: FloatArray, tyre: FloatArray) -> tuple[float, float]:
    """Return ``(pitch, height)`` of the frame at which both tyres carry the standing machine's loads.

    Pitch in rad, positive nose down; height of the frame's centre of mass in m. Nan where there is no such pose.
    The loads of a steady turn are nearly these, so a ride that starts leaning starts without a bounce.
    """
    sr, cr = math.sin(roll), math.cos(roll)
    ey = 0.0, cr, sr
    pitch = 0.0
    for _ in range(60):
        cp, sp = math.cos(pitch), math.sin(pitch)
        ex = cp, sr * sp, -cr * sp
        ez = sp, -sr * cp, cr * cp
        ahead, fy_axis, _axis = fork_axes(ex, ey, ez, steer, geometry)
        rear = _mix(geometry[_AXLE_X], ex, geometry[_AXLE_Z], ez)
        front = _add(_mix(geometry[_HEAD_X], ex, geometry[_HEAD_Z], ez), _scale(geometry[_FRONT_U], ahead))
        rear_low, _t, _l, _r = wheel_contact(rear, ey, m[_RR], tyre[0, tyres.CROWN])
        front_low, _t, _l, _r = wheel_contact(front, fy_axis, m[_RF], tyre[1, tyres.CROWN])
        height = -geometry[G_REAR_STATIC] - rear_low[2]
        gap = height + front_low[2] + geometry[G_FRONT_STATIC]
        # the nose turns about the rear axle: a unit of pitch lowers the front contact by its distance ahead
        change = gap / (cr * (front_low[0] - rear_low[0]))
        pitch += change
        if abs(change) < 1e-14:
            return pitch, height
    return math.nan, math.nan


@njit(cache=True)
def step(
    position: Vec,
    orientation: tuple[float, float, float, float],
    velocity: Vec,
    omega: Vec,
    rear_rate: float,
    steer: float,
    steer_rate: float,
    front_rate: float,
    slide: float,
    slide_rate: float,
    steering: float,
    throttle: float,
    rear_grip: float,
    front_grip: float,
    dt: float,
    memory: FloatArray,
    telemetry: FloatArray,
    m: FloatArray,
    geometry: FloatArray,
    wheel_torque: FloatArray,
    tyre: FloatArray,
) -> tuple[Vec, Vec, float, float, float, float, int]:
    """Return all forces at this instant and advance the memory by one step.

    They come as generalised forces: whatever acts on a link acts on the frame as if the joints were locked, and on
    each joint on the way by its moment about that joint's axis. What two bodies do to each other shows on their joint
    only. So nobody needs the links' poses but this function.

    Args:
        position: centre of mass of the frame without rider, m.
        orientation: of its principal axes (x, y, z, w).
        velocity: m/s.
        omega: angular velocity, rad/s, in map axes.
        rear_rate: of the rear wheel relative to the frame, rad/s.
        steer: rad.
        steer_rate: rad/s.
        front_rate: of the front wheel relative to the fork, rad/s.
        slide: of the rider, m to the left.
        slide_rate: m/s.
        steering: command in [-1, 1], positive to the left.
        throttle: drive above 0, brakes below.
        rear_grip: factor on friction under the rear wheel.
        front_grip: under the front wheel.
        dt: time step, s.
        memory: see `MEMORY_NAMES`.
        telemetry: written, see `TELEMETRY_NAMES`.
        m: `Superbike.machine`.
        geometry: from `bare_geometry`.
        wheel_torque: `Superbike.wheel_torque`.
        tyre: `Superbike.tyres`.

    Returns:
        Force and torque on the whole machine about the frame's centre of mass, in the map; moments on the joints of
        the rear wheel, the steering and the front wheel; the force on the rider's slide; the fall.
    """
    ex, ey, ez = frame_axes(orientation, geometry)
    ahead, fy_axis, axis = fork_axes(ex, ey, ez, steer, geometry)
    rear_arm = _mix(geometry[_AXLE_X], ex, geometry[_AXLE_Z], ez)
    head_arm = _mix(geometry[_HEAD_X], ex, geometry[_HEAD_Z], ez)
    hub_arm = _scale(geometry[_FRONT_U], ahead)
    rear_centre = _add(position, rear_arm)
    front_centre = _add(_add(position, head_arm), hub_arm)
    fork_omega = _mix(1.0, omega, steer_rate, axis)

    rear_point, rear_t, rear_l, rear_radius = wheel_contact(rear_centre, ey, m[_RR], tyre[0, tyres.CROWN])
    front_point, front_t, front_l, front_radius = wheel_contact(front_centre, fy_axis, m[_RF], tyre[1, tyres.CROWN])
    rear_v = _add(velocity, _cross(omega, _mix(1.0, rear_point, -1.0, position)))
    head_v = _add(velocity, _cross(omega, head_arm))
    front_v = _add(head_v, _cross(fork_omega, _mix(1.0, front_point, -1.0, _add(position, head_arm))))
    rear_spin = _dot(omega, ey) + rear_rate
    front_spin = _dot(fork_omega, fy_axis) + front_rate

    rfx, rfy, rfz, rmz, rear_use = _wheel(
        memory, M_REAR_SLIP, rear_point, rear_v, omega, ey, rear_t, rear_l, rear_radius, rear_rate, rear_grip, dt,
        tyre[0],
    )  # fmt: skip
    ffx, ffy, ffz, fmz, front_use = _wheel(
        memory, M_FRONT_SLIP, front_point, front_v, fork_omega, fy_axis, front_t, front_l, front_radius, front_rate,
        front_grip, dt, tyre[1],
    )  # fmt: skip

    # what the rider and the electronics feel
    level = math.hypot(ey[0], ey[1])
    roll = math.atan2(ey[2], level)
    cos_yaw, sin_yaw = ey[1] / level, -ey[0] / level
    roll_rate = cos_yaw * omega[0] + sin_yaw * omega[1]
    speed = cos_yaw * velocity[0] + sin_yaw * velocity[1]

    rear_wheel = rear_spin, rear_radius, rfx, rfz, rear_use
    front_wheel = front_spin, front_radius, ffx, ffz, front_use
    rear_torque, front_torque = _drive_and_brake(
        memory, telemetry, throttle, roll, roll_rate, _dot(velocity, velocity), rear_wheel, front_wheel, dt, m,
        geometry, wheel_torque, tyre,
    )  # fmt: skip

    memory[M_FRONT_LOAD] += (ffz - memory[M_FRONT_LOAD]) * -math.expm1(-dt / _FEELING_LAG)
    share = memory[M_FRONT_LOAD] / (geometry[G_FRONT_STATIC] * tyre[1, tyres.STIFFNESS])
    steer_torque = _ride(
        memory, steering, roll, roll_rate, steer, steer_rate, speed, ffx, dt, m, tyre[1, tyres.CROWN], share
    )
    fork_torque = steer_torque + _damper_and_stop(steer, steer_rate, speed, m)

    air = _air(velocity, ez, m)
    air_point = _add(position, _mix(geometry[_AIR_DX], ex, geometry[_AIR_DZ], ez))

    # rider across the machine: leads with the reference he rides to
    lean_share = min(max(memory[M_LEAN] / math.radians(m[_SLIDE_LEAN]), -1.0), 1.0)
    ws = m[_SLIDE_FREQUENCY]
    slide_force = m[_RIDER_MASS] * ws * (ws * (-m[_SLIDE] * lean_share - slide) - 2.0 * slide_rate)

    # the crankshaft's spin momentum turns with the frame
    crank = _scale(m[_CRANK], _cross(ey, omega))

    rear_force = _add(_mix(rfx, rear_t, rfy, rear_l), (0.0, 0.0, rfz))
    front_force = _add(_mix(ffx, front_t, ffy, front_l), (0.0, 0.0, ffz))
    rear_moment = _add(_cross(_mix(1.0, rear_point, -1.0, rear_centre), rear_force), (0.0, 0.0, rmz))
    front_moment = _add(_cross(_mix(1.0, front_point, -1.0, front_centre), front_force), (0.0, 0.0, fmz))
    total = _add(_add(rear_force, front_force), air)
    torque = _add(_add(rear_moment, _cross(rear_arm, rear_force)), _cross(_mix(1.0, air_point, -1.0, position), air))
    torque = _add(torque, _add(front_moment, _cross(_add(head_arm, hub_arm), front_force)))
    torque = _add(torque, crank)
    rear_joint = rear_torque + _dot(ey, rear_moment)
    front_joint = front_torque + _dot(fy_axis, front_moment)
    steer_joint = fork_torque + _dot(axis, _add(front_moment, _cross(hub_arm, front_force)))

    size = math.sqrt(_dot(velocity, velocity))
    slip = max(rear_use / tyres.peak_slip(tyre[0]), front_use / tyres.peak_slip(tyre[1]))
    sliding = size > _SLIDE_SPEED and slip > _SLIDING
    sideways = size > _SLIDE_SPEED and speed < _SPUN * size
    if memory[M_FALL] == NO_FALL:
        memory[M_FALL] = _fall(memory, roll, roll_rate, ex[2], rfz, ffz, sliding, sideways, dt, m[_FALL_ROLL])

    telemetry[T_SPEED], telemetry[T_YAW_RATE] = speed, omega[2]
    telemetry[T_PITCH] = -math.asin(min(max(ex[2], -1.0), 1.0))
    # acceleration by the forces on the whole machine, along and to the left of its heading
    telemetry[T_ALONG] = (cos_yaw * total[0] + sin_yaw * total[1]) / m[_MASS]
    telemetry[T_LATERAL] = (cos_yaw * total[1] - sin_yaw * total[0]) / m[_MASS]
    telemetry[T_REAR_LOAD], telemetry[T_FRONT_LOAD] = rfz, ffz
    telemetry[T_REAR_SLIP], telemetry[T_FRONT_SLIP] = memory[M_REAR_SLIP], memory[M_FRONT_SLIP]
    telemetry[T_REAR_DRIFT], telemetry[T_FRONT_DRIFT] = (
        math.atan(memory[M_REAR_DRIFT]),
        math.atan(memory[M_FRONT_DRIFT]),
    )
    telemetry[T_REAR_CAMBER], telemetry[T_FRONT_CAMBER] = roll, math.asin(min(max(fy_axis[2], -1.0), 1.0))
    telemetry[T_REAR_FX], telemetry[T_REAR_FY] = rfx, rfy
    telemetry[T_FRONT_FX], telemetry[T_FRONT_FY] = ffx, ffy
    telemetry[T_REAR_USE], telemetry[T_FRONT_USE] = rear_use, front_use
    telemetry[T_STEER_TORQUE], telemetry[T_LEAN_REFERENCE] = steer_torque, memory[M_LEAN]
    telemetry[T_SLIDE], telemetry[T_FALL] = slide, memory[M_FALL]
    telemetry[T_DRAG] = 0.5 * m[_DENSITY] * m[_DRAG_AREA] * size * size

    return total, torque, rear_joint, steer_joint, front_joint, slide_force, int(memory[M_FALL])
