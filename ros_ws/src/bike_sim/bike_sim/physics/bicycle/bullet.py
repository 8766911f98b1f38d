"""The Whipple bicycle as a tree of four bodies that rolls on Bullet's own contacts.

Bullet knows nothing of bicycles: rear frame, fork and two wheels hang together by three hinges, the
wheels touch a plane, and friction keeps them from slipping. That this becomes ideal rolling, as the
benchmark of Meijaard et al. (2007) assumes, hangs on a handful of settings; each is justified where
it is made. `bike validate` measures what they achieve.
"""

from __future__ import annotations

import math
import weakref
from typing import Final

import numpy as np

from bike_sim.physics import bodies as bd
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.bodies import FORK_JOINT, FRONT_JOINT, JOINTS, REAR_JOINT
from bike_sim.physics.engine import BicycleEngine
from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.multibody.bullet import AXLE_TO_Z, build_tree, bullet, connect, set_free
from bike_sim.physics.multibody.tree import principal_axes
from bike_sim.physics.multibody.vectors import conjugate, multiply, rotate
from bike_sim.physics.state import StateVector
from bike_sim.vehicles.bicycle import Vehicle

_MARGIN: Final = 1e-7
"""Collision margin, m. It rounds the wheel's edge to a torus of this radius; the benchmark's wheels are knife edges
(1e-5 m would already lower the capsize speed by 0.018 %)."""
_FRICTION: Final = 1e3
"""High enough that no loaded wheel ever slips. Contacts only push: in a violent fall a wheel can leave the ground."""
_SOLVER_ITERATIONS: Final = 10
"""Sweeps over the contacts; six gain a digit. Ten leave 2e-4 rad of steer after 8 s of hard slalom at 5 ms,
a fiftieth of what the step itself costs."""
_CONTACT_ACCELERATION: Final = 5.0
"""A contact lives while wheel and ground part by less than a third of this times the step squared, m/s2."""
_LIFT: Final = 1e3
"""Height, m, at which a vehicle surely touches nothing."""
_READ_INTERVAL: Final = 0.1
"""Longest time, s, between two readings of the yaw: far too short for half a turn, so that the yaw is never wrapped."""


class PyBulletEngine(BicycleEngine):
    """A bicycle in a Bullet world of its own.

    Engines in one process do not see each other, and the same reset and commands give the same states
    bit for bit, whatever the engine did before.

    Attributes:
        vehicle: its parameters, the steering drive included.
        time_step: integration step, s.
        client: number of the Bullet world, for those who want to look inside with PyBullet.
        body: Bullet's number of the vehicle.
    """

    def __init__(self, vehicle: Vehicle, time_step: float) -> None:
        """Build the world with the vehicle at rest in its upright reference configuration.

        Args:
            vehicle: the vehicle to simulate.
            time_step: integration step, s.

        Raises:
            ValueError: the time step is not positive and finite.
            RuntimeError: this process holds as many Bullet worlds as Bullet allows.
        """
        super().__init__(vehicle, time_step)
        self.client = connect()
        # A forgotten engine must not hold on to one of Bullet's limited number of worlds.
        self._disconnect = weakref.finalize(self, bullet.disconnect, self.client)
        reference = bd.layout(vehicle)
        offset = reference.centres[bd.REAR_WHEEL] - reference.centres[bd.REAR_FRAME]
        # Bullet knows the rear frame by its principal axes of inertia. The frame is symmetric about its xz plane, so
        # these come from its own axes by a turn about y, and the y axis that yaw and roll are read from is the same.
        self._principal, _ = principal_axes(bd.inertia_tensors(vehicle)[bd.REAR_FRAME])
        self._axle_offset = tuple(rotate(conjugate(self._principal), offset))
        self._chunk = max(1, int(_READ_INTERVAL / self.time_step))
        self.body = self._build_world()
        self.reset(st.upright_state(0.0, vehicle.rF))

    def reset(self, state: StateVector, ground: Ground = LEVEL) -> None:
        """Set any minimal state exactly, positions and velocities; nothing of the earlier ride remains.

        Raises:
            ValueError: the state has the wrong shape, is not finite, or no such configuration exists.
        """
        state = st.checked_state(state)
        bodies = bd.redundant_from_minimal(state, self.vehicle)
        client, body, frame = self.client, self.body, bd.REAR_FRAME
        # Bullet keeps contacts and their last impulses as a first guess. Lifting the vehicle off makes it forget them.
        bullet.resetBasePositionAndOrientation(body, (0.0, 0.0, _LIFT), (0.0, 0.0, 0.0, 1.0), client)
        bullet.performCollisionDetection(client)
        orientation = multiply(bodies.orientations[frame], self._principal)
        bullet.resetBasePositionAndOrientation(body, bodies.positions[frame], orientation, client)
        bullet.resetBaseVelocity(body, bodies.velocities[frame], bodies.angular_velocities[frame], client)
        rear_rate = kinematics.rear_wheel_rate(state, self.vehicle.parameters)
        for link, angle, rate in (
            (REAR_JOINT, state[st.REAR_WHEEL], rear_rate),
            (FORK_JOINT, state[st.STEER], state[st.STEER_RATE]),
            (FRONT_JOINT, state[st.FRONT_WHEEL], state[st.FRONT_WHEEL_RATE]),
        ):
            bullet.resetJointState(body, link, angle, rate, client)
        self._state = state.copy()
        self._read()

    def hold(self, steer_set: float, steps: int) -> None:
        """Integrate with the steering drive's set point held; see `engine.BicycleEngine`."""
        while steps > self._chunk:
            self._step(steer_set, self._chunk)
            self._read()
            steps -= self._chunk
        self._step(steer_set, steps)
        self._read()

    def bodies(self) -> bd.RedundantState:
        """Return pose and velocity of the four bodies as Bullet has them, fitting together or not."""
        position, orientation = bullet.getBasePositionAndOrientation(self.body, self.client)
        frame_orientation = multiply(np.array(orientation), conjugate(self._principal))
        frame = (position, frame_orientation, *bullet.getBaseVelocity(self.body, self.client))
        rear, fork, front = (
            # without forward kinematics the poses are those of the step before
            bullet.getLinkState(
                self.body, link, computeLinkVelocity=1, computeForwardKinematics=1, physicsClientId=self.client
            )
            for link in JOINTS
        )
        rows = [
            (rear[0], multiply(np.array(rear[5]), conjugate(AXLE_TO_Z)), *rear[6:8]),
            frame,
            (fork[0], fork[5], *fork[6:8]),
            (front[0], multiply(np.array(front[5]), conjugate(AXLE_TO_Z)), *front[6:8]),
        ]
        return bd.RedundantState(*(np.array(column) for column in zip(*rows, strict=True)))

    def press(self, force: float) -> None:
        """Pull each wheel down at its contact point during the next step, in place of the weight it may lack.

        A contact on which nothing rests neither guides nor holds a wheel. A force at the point where the wheel
        touches has no lever and does no work, so this is what makes the contacts hold both ways, as the benchmark's
        constraints do, where there is no gravity.

        Args:
            force: downward force on each wheel, N.
        """
        front = kinematics.front_contact(self._state, self.vehicle.parameters)
        for link, (x, y) in ((REAR_JOINT, self._state[: st.YAW]), (FRONT_JOINT, front)):
            bullet.applyExternalForce(self.body, link, (0.0, 0.0, -force), (x, y, 0.0), bullet.WORLD_FRAME, self.client)

    def push(self, along: float, left: float, ahead: float, height: float) -> None:
        """Push the rear frame during the next step; see `engine.BicycleEngine`."""
        x, y, yaw, roll = (float(value) for value in self._state[[st.X, st.Y, st.YAW, st.ROLL]])
        cos_yaw, sin_yaw, aside = math.cos(yaw), math.sin(yaw), -height * math.sin(roll)
        force = (cos_yaw * along - sin_yaw * left, sin_yaw * along + cos_yaw * left, 0.0)
        point = (
            x + cos_yaw * ahead - sin_yaw * aside,
            y + sin_yaw * ahead + cos_yaw * aside,
            height * math.cos(roll),
        )
        bullet.applyExternalForce(self.body, -1, force, point, bullet.WORLD_FRAME, self.client)

    def close(self) -> None:
        """Give the Bullet world back; a second call does nothing."""
        self._disconnect()

    def _step(self, steer_set: float, steps: int) -> None:
        """Step the world with the drive's torque. All time is spent here, hence the bound names and bare positions."""
        body, client, stiffness, damping = self.body, self.client, self.vehicle.P, self.vehicle.D
        read, push, step = bullet.getJointState, bullet.setJointMotorControl2, bullet.stepSimulation
        mode, fork = bullet.TORQUE_CONTROL, FORK_JOINT
        for _ in range(steps):
            steer, rate, _, _ = read(body, fork, client)
            torque = stiffness * (steer_set - steer) - damping * rate
            # Positions and gains (the zeros and ones) mean nothing in this mode; keywords would cost 0.2 us a step.
            push(body, fork, mode, 0.0, 0.0, torque, 0.0, 0.0, -1.0, client)
            step(client)

    def _read(self) -> None:
        """Read the minimal state out of Bullet, counting turns of yaw on from the last reading."""
        body, client, last = self.body, self.client, self._state
        position, orientation = bullet.getBasePositionAndOrientation(body, client)
        _, angular_velocity = bullet.getBaseVelocity(body, client)
        rear, fork, front = bullet.getJointStates(body, JOINTS, client)
        x, y, yaw, roll, roll_rate = bd.frame_coordinates(
            position, orientation, angular_velocity, self._axle_offset, self.vehicle.rR
        )
        yaw = st.nearest_turn(yaw, last[st.YAW])
        self._state = np.array((x, y, yaw, roll, fork[0], rear[0], front[0], roll_rate, fork[1], front[1]))

    def _build_world(self) -> int:
        """Fill the empty world with the ground and the vehicle, and return the vehicle's number."""
        client = self.client
        bullet.setTimeStep(self.time_step, client)
        bullet.setGravity(0.0, 0.0, -self.vehicle.g, client)
        bullet.setPhysicsEngineParameter(
            numSolverIterations=_SOLVER_ITERATIONS,
            # A threshold is absolute: it would solve large motions well and small ones, as around balance, badly.
            solverResidualThreshold=0.0,
            # A rolling wheel rises off its old contact by (v dt)^2 / 2 r, and a wheel that bears the vehicle jumps by
            # about a dt^2 / 2. The threshold (Bullet takes the fraction r of it) lies between the two, above 1 m/s:
            # with less a contact is missed now and then, with more old ones pile up, unloaded, at twice the time.
            contactBreakingThreshold=_CONTACT_ACCELERATION * self.time_step**2,
            contactSlop=0.0,
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
        ground = bullet.createMultiBody(0.0, plane, physicsClientId=client)
        bullet.changeDynamics(ground, -1, lateralFriction=_FRICTION, physicsClientId=client)
        wheels = [self._wheel_shape(radius) for radius in (self.vehicle.rR, self.vehicle.rF)]
        shapes = dict(zip((REAR_JOINT, FRONT_JOINT), wheels, strict=True))
        body = build_tree(client, bd.vehicle_tree(self.vehicle), shapes)
        set_free(client, body, _FRICTION)
        return body

    def _wheel_shape(self, radius: float) -> int:
        """Return a knife-edge wheel: an implicit cylinder (not a 32-gon) whose height is all margin.

        The margin can only be set through the base of a body, so a passing body carries the shape once.
        """
        client = self.client
        shape: int = bullet.createCollisionShape(
            bullet.GEOM_CYLINDER, radius=radius, height=2.0 * _MARGIN, physicsClientId=client
        )
        carrier = bullet.createMultiBody(0.0, shape, basePosition=(0.0, 0.0, -_LIFT), physicsClientId=client)
        bullet.changeDynamics(carrier, -1, collisionMargin=_MARGIN, physicsClientId=client)
        bullet.removeBody(carrier, client)
        return shape
