"""The superbike in Bullet: four bodies and a sliding rider, with all forces from one compiled function.

Bullet integrates the tree of bodies; the wheels have no collision shape. At every step the motion is read with three
calls, `bike_sim.physics.superbike_forces.step` turns it into forces, and six calls hand these to Bullet as generalised
forces of frame and joints. (Forces on a link would need its pose, which Bullet holds one step late: at 40 m/s and 2 ms
the load would act 8 cm off the axle.)
"""

from __future__ import annotations

import weakref
from typing import Final

import numpy as np

from bike_sim.physics import articulated, mapping
from bike_sim.physics import state as st
from bike_sim.physics import superbike_forces as sf
from bike_sim.physics.pybullet_tree import build_tree, bullet, set_free
from bike_sim.physics.superbike.base import SuperbikeBase
from bike_sim.physics.superbike.deflection import deflect
from bike_sim.physics.superbike.poses import read_state
from bike_sim.physics.superbike.start import Start
from bike_sim.physics.tree import FORK, FRONT_WHEEL, REAR_WHEEL, SLIDER
from bike_sim.vehicles.superbike import Superbike

TIME_STEP: Final = 0.002
"""Integration step, s, that rides a lap far faster than real time; `bike validate superbike` shows what it costs."""

_JOINTS: Final = (REAR_WHEEL, FORK, FRONT_WHEEL, SLIDER)
_READ_INTERVAL: Final = 0.1
"""Longest time, s, between two readings of the yaw: far too short for half a turn, so that the yaw is never wrapped."""


class SuperbikeEngine(SuperbikeBase):
    """A superbike in a Bullet world of its own.

    Attributes:
        client: number of the Bullet world.
        body: Bullet's number of the vehicle.
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
        super().__init__(vehicle, time_step)
        self.client: int = bullet.connect(bullet.DIRECT)
        if self.client < 0:
            raise RuntimeError("no further Bullet world can be made in this process; close engines no longer used")
        # A forgotten engine must not hold on to one of Bullet's limited number of worlds.
        self._disconnect = weakref.finalize(self, bullet.disconnect, self.client)
        self._chunk = max(1, int(_READ_INTERVAL / self.time_step))
        bullet.setTimeStep(self.time_step, self.client)
        bullet.setGravity(0.0, 0.0, -vehicle.g, self.client)
        self.body = build_tree(self.client, self.tree)
        set_free(self.client, self.body)
        self.reset(st.upright_state(0.0, vehicle.rF))

    def close(self) -> None:
        """Give the Bullet world back; a second call does nothing."""
        self._disconnect()

    def _place(self, start: Start) -> None:
        """Set the motion of the bodies, and fill minimal state and telemetry from it."""
        self._set(start)
        self._read()
        self._look()

    def _set(self, start: Start) -> None:
        """Set the motion of the bodies."""
        body, client = self.body, self.client
        bullet.resetBasePositionAndOrientation(body, start.position, start.orientation, client)
        bullet.resetBaseVelocity(body, start.velocity, start.omega, client)
        for link, value, rate in zip(_JOINTS, start.joints, start.rates, strict=True):
            bullet.resetJointState(body, link, value, rate, client)

    def deflect(self, x: float, y: float, turn: float, share: float, dx: float, dy: float) -> None:
        """Turn the machine at a wall; see `SuperbikeBase`."""
        body, client = self.body, self.client
        motion = np.zeros(1, dtype=articulated.motion_record(len(self.tree)))
        motion["position"], motion["orientation"] = bullet.getBasePositionAndOrientation(body, client)
        motion["velocity"], motion["omega"] = bullet.getBaseVelocity(body, client)
        joints = bullet.getJointStates(body, _JOINTS, client)
        motion["joints"], motion["rates"] = [joint[0] for joint in joints], [joint[1] for joint in joints]
        deflect(motion, x, y, turn, share, dx, dy)
        self._set(Start(*motion[0].tolist()))

    def _run(self, steering: float, throttle: float, steps: int) -> None:
        """Step until a fall or to the end, and fill the minimal state."""
        while steps > 0 and not self.fall:
            chunk = min(steps, self._chunk)
            self._step(steering, throttle, chunk)
            self._read()
            steps -= chunk

    def _step(self, steering: float, throttle: float, steps: int) -> None:
        """Step the world with all forces. All time is spent here, hence the bound names and bare positions."""
        body, client = self.body, self.client
        memory, telemetry, constants = self._memory, self._telemetry, self._constants
        command = (steering, throttle, self.time_step)
        ground, bumps = self.ground
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
                ground, bumps, memory, telemetry, constants,
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
            (0.0, 0.0, self.time_step), *self.ground,
            self._memory.copy(), self._telemetry, self._constants,
        )  # fmt: skip

    def _read(self) -> None:
        """Read the minimal state out of Bullet, counting turns of yaw on from the last reading."""
        body, client, last = self.body, self.client, self._state
        position, orientation = bullet.getBasePositionAndOrientation(body, client)
        _, omega = bullet.getBaseVelocity(body, client)
        rear, fork, front, _rider = bullet.getJointStates(body, _JOINTS, client)
        x, y, yaw, roll, roll_rate = read_state(position, orientation, omega, self.ground.record, self._constants)
        yaw = mapping.nearest_turn(yaw, last[st.YAW])
        self._state = np.array((x, y, yaw, roll, fork[0], rear[0], front[0], roll_rate, fork[1], front[1]))
