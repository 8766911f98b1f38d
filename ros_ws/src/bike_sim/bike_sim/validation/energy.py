"""Account of the energy of a ride: the work of everything that acts on a superbike, and what of it is left over.

A ride is described by `Periods`: where the machine was at the start of each control period, and what it was given. The
account rides each period anew with the engine's own code and adds up, in each integration step, force times the mean of
the velocities before and after it. Their sum is the change of kinetic and potential energy, but for what the step
itself adds or takes: the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics.ground import GROUND
from bike_sim.physics.multibody import articulated
from bike_sim.physics.multibody.tree import Body, Joint, outward, principal_axes
from bike_sim.physics.multibody.vectors import Vec, add, axis_angle, conjugate, cross, dot, mix, multiply, rotate, scale
from bike_sim.physics.superbike.contact import Contact, Rolling, TyreForce, axes_of, rolling_wheels
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine, Model, Rides, advance, to_motion
from bike_sim.physics.superbike.forces import TELEMETRY, Acting, acting_at, air_force, at_wheel
from bike_sim.physics.superbike.pose import LARGEST_TREE
from bike_sim.physics.superbike.records import MEMORY, Motion, discretise_command
from bike_sim.physics.superbike.suspension import chain_load, strut_force, unit_at
from bike_sim.vehicles.joints import UNIT_SAMPLES
from bike_sim.vehicles.superbike import Superbike

Array = NDArray[np.float64]
Record = Any

ENTRIES: Final = (
    "engine", "brakes", "air", "tyres_longitudinal", "tyres_lateral", "tyres_rolling", "tyres_twisting", "tyres_load",
    "dampers", "springs", "rider",
)  # fmt: skip
"""Sources of work. The tyres' load presses them and climbs bumps; engine braking counts as brakes."""

LEDGER: Final = np.dtype([(name, np.float64) for name in ENTRIES])
ALLOWED: Final = 0.001
"""Largest rest, as a part of the engine's work."""
PERIOD_KINDS: Final = (articulated.motion_record(LARGEST_TREE), MEMORY, GROUND)
"""Kinds of the records of `Periods`, in a compiled batch of superbikes."""


class Periods(NamedTuple):
    """A ride, a row for each control period.

    Attributes:
        motion: at its start, records of `articulated.motion_record`.
        memory: at its start, records of `records.MEMORY`.
        ground: records of `ground.GROUND`.
        commands: steering and throttle, shape (n, 2).
        bumps: profiles, see `ground.Ground`.
    """

    motion: NDArray[np.void]
    memory: NDArray[np.void]
    ground: NDArray[np.void]
    commands: Array
    bumps: Array


@dataclass(frozen=True)
class Account:
    """Work over a ride, J.

    Attributes:
        work: by its name in `ENTRIES`.
        stored: change of kinetic and potential energy.
    """

    work: dict[str, float]
    stored: float

    @property
    def rest(self) -> float:
        """Residual, as a part of the engine's work."""
        return (sum(self.work.values()) - self.stored) / self.work["engine"]


def account(vehicle: Superbike, periods: Periods, time_step: float, substeps: int) -> Account:
    """Return the account of a ride.

    Args:
        vehicle: that was ridden.
        periods: of the ride.
        time_step: of the integration, s.
        substeps: steps of a control period.
    """
    engine = CompiledSuperbikeEngine(vehicle, time_step)
    tree, work = articulated.tree_record(engine.tree, vehicle.g), articulated.workspace(len(engine.tree))
    ledger = np.zeros(1, dtype=LEDGER)
    motion = np.zeros(len(periods.motion), dtype=engine.motion.dtype)
    for name in motion.dtype.names or ():
        motion[name] = periods.motion[name][:, : motion[name].shape[1]]
    start = motion[:1].copy()
    rides = Rides(np.zeros(10), motion[:1].copy(), periods.memory[:1].copy(), np.zeros(1, dtype=TELEMETRY))
    scratch = periods.memory[:1].copy()
    models = Model(engine.constants, tree, work)
    _add_up(rides, scratch, models, periods._replace(motion=motion), time_step, substeps, ledger)
    stored = energy(rides.motion[0], engine.tree, vehicle.g) - energy(start[0], engine.tree, vehicle.g)
    return Account({name: float(ledger[name][0]) for name in ENTRIES}, stored)


def energy(motion: Record, tree: Sequence[Body], gravity: float) -> float:
    """Return the kinetic and the potential energy of a tree of bodies, J; springs do not count.

    Args:
        motion: a record of `articulated.motion_record`.
        tree: its bodies.
        gravity: m/s2.
    """
    turn, _ = principal_axes(tree[0].inertia)
    frame = multiply(np.array(motion["orientation"]), conjugate(turn))
    places = {0: (frame, *(np.array(motion[name]) for name in ("position", "velocity", "omega")))}
    total = 0.0
    for i in outward(tree):
        body, point = tree[i], tree[i].point if i else tree[0].centre
        if i:
            carrier, place, speed, omega = places[body.parent]
            q, rate = motion["joints"][i - 1], motion["rates"][i - 1]
            arm = rotate(carrier, point - (tree[body.parent].point if body.parent else tree[0].centre))
            axis = rotate(carrier, body.axis)
            slides = body.joint is Joint.PRISMATIC
            arm = arm + q * axis if slides else arm
            place, speed = place + arm, speed + np.cross(omega, arm) + (rate * axis if slides else 0.0)
            turned = carrier if slides else multiply(carrier, axis_angle(body.axis, q))
            places[i] = turned, place, speed, omega if slides else omega + rate * axis
        orientation, place, speed, omega = places[i]
        arm = rotate(orientation, body.centre - point)
        local, moving = rotate(conjugate(orientation), omega), speed + np.cross(omega, arm)
        total += 0.5 * float(body.mass * moving @ moving + local @ body.inertia @ local)
        total += body.mass * gravity * float(place[2] + arm[2])
    return total


@njit(cache=True)
def _add_up(
    rides: Rides, scratch: Record, models: Model, periods: Periods, time_step: float, substeps: int, ledger: Record
) -> None:
    """Ride all periods step by step and add up the work of each."""
    model = Model(models.constants[0], models.tree[0], models.work[0])
    ride = Rides(rides.state, rides.motion[0], rides.memory[0], rides.telemetry[0])
    commands, grounds, bumps = periods.commands, periods.ground, periods.bumps
    for k in range(len(commands)):
        rides.motion[0], rides.memory[0] = periods.motion[k], periods.memory[k]
        command = discretise_command((commands[k, 0], commands[k, 1], time_step), model.constants)
        for _ in range(substeps):
            now = to_motion(ride.motion, model.constants.joints)
            scratch[0] = rides.memory[0]
            acting = acting_at(now, command, grounds[k], bumps, scratch[0], model.constants)
            joints, rates = ride.motion.joints.copy(), ride.motion.rates.copy()
            advance(ride, model, command, grounds[k], bumps, 1)
            after = to_motion(ride.motion, model.constants.joints)
            mean = _mean(now, after)
            _work(acting, now, mean, grounds[k], model.constants, time_step, ledger[0])
            tree = model.tree
            for i in range(1, tree.count):
                if tree.spring[i] != 0.0 or tree.damper[i] != 0.0:
                    rate = 0.5 * (rates[i - 1] + ride.motion.rates[i - 1])
                    ledger[0].springs -= time_step * tree.spring[i] * joints[i - 1] * rate
                    ledger[0].dampers -= time_step * tree.damper[i] * rates[i - 1] * rate


@njit(cache=True)
def _mean(a: Motion, b: Motion) -> Motion:
    """Return the pose of one motion with the mean of two motions' velocities."""
    return Motion(
        a.position, a.orientation, scale(0.5, add(a.velocity, b.velocity)), scale(0.5, add(a.omega, b.omega)),
        0.5 * (a.rear_rate + b.rear_rate), a.steer, 0.5 * (a.steer_rate + b.steer_rate),
        0.5 * (a.front_rate + b.front_rate), a.slide, 0.5 * (a.slide_rate + b.slide_rate), a.swing,
        0.5 * (a.swing_rate + b.swing_rate), a.travel, 0.5 * (a.travel_rate + b.travel_rate), a.head,
        0.5 * (a.head_rate + b.head_rate), a.bend, 0.5 * (a.bend_rate + b.bend_rate),
    )  # fmt: skip


@njit(cache=True)
def _work(
    acting: Acting, now: Motion, mean: Motion, ground: Record, constants: Record, dt: float, ledger: Record
) -> None:
    """Add the work of a step.

    Args:
        acting: at its start.
        now: motion at its start.
        mean: the same pose with the mean of the velocities before and after.
        ground: under the wheels.
        constants: of the machine.
        dt: its length, s.
        ledger: of `LEDGER`.
    """
    machine, joints, driven = constants.machine, constants.joints, acting.driven
    axes = axes_of(mean, constants.geometry, joints)
    wheels = rolling_wheels(mean, axes, acting.rear_contact, acting.front_contact, joints)
    _tyre_work(acting.rear_contact, acting.rear, wheels[0], acting.rear_centre, ground.rear.drag, dt, ledger)
    _tyre_work(acting.front_contact, acting.front, wheels[1], acting.front_centre, ground.front.drag, dt, ledger)
    rolling = machine.rear_tyre.rolling * acting.rear.fz * acting.rear_contact.radius
    _hold_work(driven.rear - driven.drive, rolling, mean.rear_rate, dt, ledger)
    rolling = machine.front_tyre.rolling * acting.front.fz * acting.front_contact.radius
    _hold_work(driven.front, rolling, mean.front_rate, dt, ledger)
    air = air_force(acting.wind, axes.ez, machine.air)
    arm = mix(constants.geometry.air_x, axes.ex, constants.geometry.air_z, axes.ez)
    ledger.air += dt * dot(air, add(mean.velocity, cross(mean.omega, arm)))
    ledger.engine += dt * driven.drive * mean.rear_rate
    ledger.rider += dt * (acting.steer_torque * mean.steer_rate + acting.rider_force * mean.slide_rate)
    ledger.dampers += dt * (acting.fork_torque - acting.steer_torque) * mean.steer_rate
    if joints.travel >= 0:
        _strut_work(now.travel, now.travel_rate, mean.travel_rate, joints.fork, dt, ledger)
    if joints.swing >= 0:
        ledger.engine += dt * chain_load(driven.drive, axes, joints) * mean.swing_rate
        length, ratio = unit_at(now.swing, joints)
        pressed = joints.unit_length[(UNIT_SAMPLES - 1) // 2] - length
        _strut_work(pressed, -ratio * now.swing_rate, -ratio * mean.swing_rate, joints.unit, dt, ledger)


@njit(cache=True)
def _tyre_work(
    contact: Contact, tyre: TyreForce, wheel: Rolling, centre: Vec, drag: float, dt: float, ledger: Record
) -> None:
    """Add what the ground does on a wheel in a step (s): each part of its force at the tread's own velocity."""
    tread = mix(1.0, wheel.velocity, wheel.rate, cross(wheel.axle, mix(1.0, contact.point, -1.0, centre)))
    turning = mix(1.0, wheel.carrier, wheel.rate, wheel.axle)
    ledger.tyres_longitudinal += dt * tyre.fx * dot(contact.heading, tread)
    ledger.tyres_lateral += dt * tyre.fy * dot(contact.left, tread)
    ledger.tyres_load += dt * tyre.fz * dot(contact.normal, tread)
    ledger.tyres_twisting += dt * tyre.mz * dot(contact.normal, turning)
    if drag != 0.0:
        loose, _ = at_wheel(contact, tyre, wheel, centre, drag)
        bare, _ = at_wheel(contact, tyre, wheel, centre, 0.0)
        ledger.tyres_rolling += dt * dot(mix(1.0, loose, -1.0, bare), wheel.velocity)


@njit(cache=True)
def _hold_work(torque: float, rolling: float, rate: float, dt: float, ledger: Record) -> None:
    """Add what brakes and rolling resistance (N m) do together on a wheel that turns with a rate (rad/s)."""
    size = abs(torque)
    share = min(rolling / size, 1.0) if size > 0.0 else 0.0
    ledger.tyres_rolling += dt * share * torque * rate
    ledger.brakes += dt * (1.0 - share) * torque * rate


@njit(cache=True)
def _strut_work(pressed: float, rate: float, mean: float, strut: Record, dt: float, ledger: Record) -> None:
    """Add what a spring unit does: pressed (m) at a rate (m/s), moving with a mean rate."""
    spring = strut_force(pressed, 0.0, strut)
    ledger.springs -= dt * spring * mean
    ledger.dampers -= dt * (strut_force(pressed, rate, strut) - spring) * mean
