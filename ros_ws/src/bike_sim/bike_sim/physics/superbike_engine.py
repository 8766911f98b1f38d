"""The superbike in Bullet: four bodies and a sliding rider, with all forces from one compiled function.

Bullet integrates the tree of bodies; the wheels have no collision shape. At every step the motion is read with three
calls, `bike_sim.physics.superbike_forces.step` turns it into forces, and six calls hand these to Bullet as generalised
forces of frame and joints. (Forces on a link would need its pose, which Bullet holds one step late: at 40 m/s and 2 ms
the load would act 8 cm off the axle.)
"""

from __future__ import annotations

import math
import weakref
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import kinematics, mapping
from bike_sim.physics import state as st
from bike_sim.physics import superbike_forces as sf
from bike_sim.physics.pybullet_tree import (
    FORK,
    FRONT_WHEEL,
    REAR_WHEEL,
    SLIDER,
    Slider,
    build_tree,
    bullet,
    principal_axes,
    set_free,
)
from bike_sim.physics.state import StateVector
from bike_sim.physics.superbike.poses import read_state, settle
from bike_sim.physics.superbike.records import MEMORY, constants_of
from bike_sim.vehicles.superbike import Superbike

TIME_STEP: Final = 0.002
"""Integration step, s, that rides a lap far faster than real time; `bike validate superbike` shows what it costs."""

_JOINTS: Final = (REAR_WHEEL, FORK, FRONT_WHEEL, SLIDER)
_READ_INTERVAL: Final = 0.1
"""Longest time, s, between two readings of the yaw: far too short for half a turn, so that the yaw is never wrapped."""
_FRESH: Final = 1e3
"""s since the last slide after a reset: long ago."""


def without_rider(vehicle: Superbike) -> Superbike:
    """Return the machine whose rear body is the frame alone, for building trees in which the rider is a body."""
    frame = vehicle.frame
    return replace(
        vehicle,
        mB=frame.mass,
        xB=frame.x,
        zB=-frame.height,
        IBxx=frame.Ixx,
        IBxz=-frame.Ixz,
        IByy=frame.Iyy,
        IBzz=frame.Izz,
    )


class SuperbikeEngine:
    """A superbike in a Bullet world of its own; implements `bike_sim.physics.engine.Engine`.

    The same reset and commands give the same states bit for bit, whatever the engine did before. Once the machine has
    fallen, time passes but nothing moves any more.

    Attributes:
        vehicle: its parameters.
        time_step: integration step, s.
        client: number of the Bullet world.
        body: Bullet's number of the vehicle.
        memory: what the forces remember, in the order of `superbike_forces.MEMORY_NAMES`.
        rear_grip: factor on friction under the rear wheel, 1 on the track. front_grip: under the front wheel.
    """

    def __init__(self, vehicle: Superbike, time_step: float) -> None:
        """Build the world with the machine upright at rest.

        Args:
            vehicle: the machine to simulate.
            time_step: integration step, s.

        Raises:
            ValueError: the vehicle is no superbike, or the time step is not positive and finite.
            RuntimeError: this process holds as many Bullet worlds as Bullet allows.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"vehicle '{vehicle.name}' is no superbike: it has no tyres")
        if not (math.isfinite(time_step) and time_step > 0.0):
            raise ValueError(f"time step must be positive and finite, got {time_step} s")
        self.vehicle = vehicle
        self.time_step = float(time_step)
        self.rear_grip = self.front_grip = 1.0
        self.client: int = bullet.connect(bullet.DIRECT)
        if self.client < 0:
            raise RuntimeError("no further Bullet world can be made in this process; close engines no longer used")
        # A forgotten engine must not hold on to one of Bullet's limited number of worlds.
        self._disconnect = weakref.finalize(self, bullet.disconnect, self.client)
        bare = without_rider(vehicle)
        self._principal, _ = principal_axes(mapping.inertia_tensors(bare)[mapping.REAR_FRAME])
        self._constants = constants_of(vehicle, bare)
        self._chunk = max(1, int(_READ_INTERVAL / self.time_step))
        bullet.setTimeStep(self.time_step, self.client)
        bullet.setGravity(0.0, 0.0, -vehicle.g, self.client)
        rider = vehicle.rider
        slider = Slider(rider.mass, (rider.x, 0.0, rider.height), (rider.Ixx, rider.Iyy, rider.Izz))
        self.body = build_tree(self.client, bare, [-1, -1], slider)
        set_free(self.client, self.body)
        self.memory = np.zeros(len(sf.MEMORY_NAMES))
        self._memory = self.memory.view(MEMORY)  # the same numbers, by name
        self._telemetry = np.zeros(1, dtype=sf.TELEMETRY)
        self._state = np.zeros(st.STATE_SIZE)
        self.reset(st.upright_state(0.0, vehicle.rF))

    def reset(self, state: StateVector) -> None:
        """Set any minimal state, with the tyres carrying the standing machine and the rider riding to this lean.

        The rear wheel rolls without slip; yaw rate and sideways velocity are those of ideal rolling, which the tyres
        correct within a few tenths of a second.

        Raises:
            ValueError: the state has the wrong shape, is not finite, or no such configuration exists.
        """
        state = mapping.checked_state(state)
        vehicle, client, body = self.vehicle, self.client, self.body
        roll, steer = state[st.ROLL], state[st.STEER]
        pitch, height = settle(roll, steer, self._constants)
        if not math.isfinite(pitch):
            raise ValueError(
                f"no configuration with both wheels on the ground at roll {math.degrees(roll):.1f} deg and "
                f"steer {math.degrees(steer):.1f} deg of vehicle '{vehicle.name}'"
            )
        yaw_rate, _, pitch_rate = kinematics.rates(state, vehicle.parameters)
        if not (math.isfinite(yaw_rate) and math.isfinite(pitch_rate)):
            raise ValueError(
                f"no rolling motion at roll {math.degrees(roll):.1f} deg and steer {math.degrees(steer):.1f} deg of "
                f"vehicle '{vehicle.name}'"
            )
        lean = mapping.multiply(
            mapping.axis_angle(np.array([0.0, 0.0, 1.0]), state[st.YAW]),
            mapping.axis_angle(np.array([1.0, 0.0, 0.0]), roll),
        )
        frame = mapping.multiply(lean, mapping.axis_angle(np.array([0.0, 1.0, 0.0]), pitch))
        orientation = mapping.multiply(frame, self._principal)
        # Where the rear contact comes to lie with the frame at the origin says where the frame must be
        x, y, *_ = read_state((0.0, 0.0, height), tuple(orientation), (0.0, 0.0, 0.0), self._constants)
        position = np.array([state[st.X] - x, state[st.Y] - y, height])
        heading = np.array([math.cos(state[st.YAW]), math.sin(state[st.YAW]), 0.0])
        omega = state[st.ROLL_RATE] * heading + pitch_rate * mapping.rotate(frame, np.array([0.0, 1.0, 0.0]))
        omega[2] += yaw_rate
        front_radius = vehicle.rF - vehicle.front_tyre.crown * (1.0 - math.cos(roll))
        rear_radius = vehicle.rR - vehicle.rear_tyre.crown * (1.0 - math.cos(roll))
        speed = state[st.FRONT_WHEEL_RATE] * front_radius
        contact = np.array([state[st.X], state[st.Y], 0.0])
        velocity = speed * heading + np.cross(omega, position - contact)
        bullet.resetBasePositionAndOrientation(body, position, orientation, client)
        bullet.resetBaseVelocity(body, velocity, omega, client)
        slide = -vehicle.rider.slide * max(-1.0, min(1.0, math.degrees(roll) / vehicle.rider.slide_lean_deg))
        for link, value, rate in (
            (REAR_WHEEL, state[st.REAR_WHEEL], speed / rear_radius - pitch_rate),
            (FORK, steer, state[st.STEER_RATE]),
            (FRONT_WHEEL, state[st.FRONT_WHEEL], state[st.FRONT_WHEEL_RATE]),
            (SLIDER, slide, 0.0),
        ):
            bullet.resetJointState(body, link, value, rate, client)
        self.memory[:] = 0.0
        self._memory["lean_reference"] = roll
        self._memory["front_load"] = self._constants["geometry"]["front_static"] * vehicle.front_tyre.stiffness
        self._memory["slide_age"] = _FRESH
        self._state = state.copy()
        self._read()
        self._look()

    def advance(self, steer_set: float, steps: int) -> None:
        """Integrate with a steering set value in parts of `vehicle.max_steer`, without drive or brakes.

        The rider makes a lean of it: this is ``advance_commands(steer_set / vehicle.max_steer, 0, steps)``.
        """
        self.advance_commands(steer_set / self.vehicle.max_steer, 0.0, steps)

    def advance_commands(self, steering: float, throttle: float, steps: int) -> None:
        """Integrate with both commands held.

        Args:
            steering: in [-1, 1], positive to the left; the rider leans the machine that part of his largest lean.
            throttle: in [-1, 1]; above 0 part of the engine's torque, below 0 part of the brakes' force.
            steps: number of integration steps of `time_step`.

        Raises:
            ValueError: a command is not finite or out of range, or the number of steps is negative.
        """
        if not (-1.0 <= steering <= 1.0 and -1.0 <= throttle <= 1.0):
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        if steps < 0:
            raise ValueError(f"steps = {steps} must not be negative")
        while steps > 0 and not self.fall:
            chunk = min(steps, self._chunk)
            self._step(float(steering), float(throttle), chunk)
            self._read()
            steps -= chunk

    def state(self) -> StateVector:
        """Return the minimal state as a fresh vector; yaw and wheel angles are not wrapped."""
        return self._state.copy()

    def telemetry(self) -> NDArray[np.float64]:
        """Return what was measured at the last step, in the order of `superbike_forces.TELEMETRY_NAMES`."""
        return self._telemetry.view(np.float64).copy()

    @property
    def fall(self) -> int:
        """How the machine fell, an index of `superbike_forces.FALL_NAMES`; 0 while it rides."""
        return int(self._memory["fall"][0])

    @property
    def fall_name(self) -> str:
        """The same as a word."""
        return sf.FALL_NAMES[self.fall]

    def close(self) -> None:
        """Give the Bullet world back; a second call does nothing."""
        self._disconnect()

    def _step(self, steering: float, throttle: float, steps: int) -> None:
        """Step the world with all forces. All time is spent here, hence the bound names and bare positions."""
        body, client = self.body, self.client
        memory, telemetry, constants = self._memory, self._telemetry, self._constants
        command = (steering, throttle, self.rear_grip, self.front_grip, self.time_step)
        pose, twist, joints = bullet.getBasePositionAndOrientation, bullet.getBaseVelocity, bullet.getJointStates
        push, turn, joint, go = (
            bullet.applyExternalForce, bullet.applyExternalTorque, bullet.setJointMotorControl2, bullet.stepSimulation
        )  # fmt: skip
        world, mode, compute = bullet.WORLD_FRAME, bullet.TORQUE_CONTROL, sf.step
        for _ in range(steps):
            posed = pose(body, client)
            rear, fork, front, rider = joints(body, _JOINTS, client)
            force, torque, rear_moment, steer_moment, front_moment, rider_force, fall = compute(
                posed, twist(body, client), (rear[1], fork[0], fork[1], front[1], rider[0], rider[1]), command,
                memory, telemetry, constants,
            )  # fmt: skip
            if fall:
                return
            push(body, -1, force, posed[0], world, client)
            turn(body, -1, torque, world, client)
            # Positions and gains (the zeros and ones) mean nothing in this mode; keywords would cost 0.2 us a step.
            joint(body, REAR_WHEEL, mode, 0.0, 0.0, rear_moment, 0.0, 0.0, -1.0, client)
            joint(body, FORK, mode, 0.0, 0.0, steer_moment, 0.0, 0.0, -1.0, client)
            joint(body, FRONT_WHEEL, mode, 0.0, 0.0, front_moment, 0.0, 0.0, -1.0, client)
            joint(body, SLIDER, mode, 0.0, 0.0, rider_force, 0.0, 0.0, -1.0, client)
            go(client)

    def _look(self) -> None:
        """Fill the telemetry without moving anything: the memory is put back."""
        body, client = self.body, self.client
        rear, fork, front, rider = bullet.getJointStates(body, _JOINTS, client)
        sf.step(
            bullet.getBasePositionAndOrientation(body, client), bullet.getBaseVelocity(body, client),
            (rear[1], fork[0], fork[1], front[1], rider[0], rider[1]),
            (0.0, 0.0, self.rear_grip, self.front_grip, self.time_step),
            self._memory.copy(), self._telemetry, self._constants,
        )  # fmt: skip

    def _read(self) -> None:
        """Read the minimal state out of Bullet, counting turns of yaw on from the last reading."""
        body, client, last = self.body, self.client, self._state
        position, orientation = bullet.getBasePositionAndOrientation(body, client)
        _, omega = bullet.getBaseVelocity(body, client)
        rear, fork, front, _rider = bullet.getJointStates(body, _JOINTS, client)
        x, y, yaw, roll, roll_rate = read_state(position, orientation, omega, self._constants)
        yaw = mapping.nearest_turn(yaw, last[st.YAW])
        self._state = np.array((x, y, yaw, roll, fork[0], rear[0], front[0], roll_rate, fork[1], front[1]))
