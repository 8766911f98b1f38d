"""Engines of a superbike: their common part, and the compiled one.

A machine is five records: minimal state (a vector), motion (`articulated.motion_record`), memory and telemetry (see
`bike_sim.physics.superbike.forces`), and its constants (`records.CONSTANTS`, `articulated.tree_record`). The same
compiled code steps one machine and rows of many, bit for bit.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.bodies import FORK_JOINT, FRONT_JOINT, REAR_JOINT, SLIDE_JOINT
from bike_sim.physics.engine import Engine, compiled_entry
from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.multibody import articulated
from bike_sim.physics.multibody.tree import principal_axes
from bike_sim.physics.multibody.vectors import Quaternion, Vec
from bike_sim.physics.superbike.constants import constants_of
from bike_sim.physics.superbike.forces import FALL_NAMES, TELEMETRY, Loads, loads_at
from bike_sim.physics.superbike.pose import begin, deflect, state_at, superbike_tree
from bike_sim.physics.superbike.records import MEMORY, Command, Motion, discretise_command
from bike_sim.vehicles.superbike import Superbike

Record = Any
Array = NDArray[np.float64]

TIME_STEP: Final = 0.002
"""Integration step, s, that rides a lap far faster than real time; `bike validate` shows what it costs."""

_LONGEST: Final = 0.1
"""Longest time, s, between two readings of the yaw: far too short for half a turn, so that the yaw is never wrapped."""


@njit(cache=True)
def reading_interval(dt: float) -> int:
    """Return after how many steps of a length (s) the yaw must be read."""
    return max(1, int(_LONGEST / dt))


@njit(cache=True)
def _coordinate(values: Array, number: int) -> float:
    """Return a joint's coordinate, 0 where it is rigid."""
    return values[number] if number >= 0 else 0.0


@njit(cache=True)
def to_motion(motion: Record, numbers: Record) -> Motion:
    """Return the motion of frame and joints as the forces take it; the numbers are those of `records.JOINTS`."""
    p, q, v, w = motion.position, motion.orientation, motion.velocity, motion.omega
    joints, rates = motion.joints, motion.rates
    return Motion(
        (p[0], p[1], p[2]),
        (q[0], q[1], q[2], q[3]),
        (v[0], v[1], v[2]),
        (w[0], w[1], w[2]),
        rates[REAR_JOINT],
        joints[FORK_JOINT],
        rates[FORK_JOINT],
        rates[FRONT_JOINT],
        joints[SLIDE_JOINT],
        rates[SLIDE_JOINT],
        _coordinate(joints, numbers.swing),
        _coordinate(rates, numbers.swing),
        _coordinate(joints, numbers.travel),
        _coordinate(rates, numbers.travel),
        _coordinate(joints, numbers.head),
        _coordinate(rates, numbers.head),
        _coordinate(joints, numbers.bend),
        _coordinate(rates, numbers.bend),
    )


@njit(cache=True)
def read(motion: Record, ground: Record, constants: Record, state: Array) -> None:
    """Write the minimal state, counting turns of yaw on from what stands there."""
    now = to_motion(motion, constants.joints)
    x, y, yaw, roll, roll_rate = state_at(now.position, now.orientation, now.omega, now.swing, ground.rear, constants)
    turns = round((state[st.YAW] - yaw) / (2.0 * math.pi))
    state[st.X], state[st.Y], state[st.YAW], state[st.ROLL] = x, y, yaw + 2.0 * math.pi * turns, roll
    state[st.STEER], state[st.STEER_RATE] = now.steer, now.steer_rate
    state[st.REAR_WHEEL], state[st.FRONT_WHEEL] = motion.joints[REAR_JOINT], motion.joints[FRONT_JOINT]
    state[st.ROLL_RATE], state[st.FRONT_WHEEL_RATE] = roll_rate, now.front_rate


class Rides(NamedTuple):
    """Changing records of rides: one each, or arrays of them.

    Attributes:
        state: minimal states.
        motion: of the bodies, of `articulated.motion_record`.
        memory: of the forces, of `records.MEMORY`.
        telemetry: of the last step, of `forces.TELEMETRY`.
    """

    state: Any
    motion: Any
    memory: Any
    telemetry: Any


class Model(NamedTuple):
    """Constant records of a machine and its work space: one each, or arrays of one.

    Attributes:
        constants: of the forces, of `records.CONSTANTS`.
        tree: of the bodies, of `articulated.tree_record`.
        work: scratch memory, of `articulated.workspace`.
    """

    constants: Any
    tree: Any
    work: Any


@njit(cache=True)
def write_loads(loads: Loads, numbers: Record, joints: Array) -> None:
    """Write the moments (N m) and forces (N) on the joints by number."""
    joints[REAR_JOINT], joints[FORK_JOINT] = loads.rear, loads.steer
    joints[FRONT_JOINT], joints[SLIDE_JOINT] = loads.front, loads.slide
    if numbers.any:
        if numbers.swing >= 0:
            joints[numbers.swing] = loads.swing
        if numbers.travel >= 0:
            joints[numbers.travel] = loads.travel
        if numbers.head >= 0:
            joints[numbers.head] = loads.head
        if numbers.bend >= 0:
            joints[numbers.bend] = loads.bend
        if numbers.torso >= 0:
            joints[numbers.torso] = 0.0


@njit(cache=True)
def advance(ride: Rides, model: Model, command: Command, ground: Record, bumps: Array, steps: int) -> int:
    """Step a machine until a fall or to the end, and return the fall, an index of `forces.FALL_NAMES`.

    Args:
        ride: of the machine, advanced.
        model: of the machine.
        command: of the steps, with their length.
        ground: a record of `ground.GROUND`.
        bumps: profiles, see `ground.Ground`.
        steps: number of steps.
    """
    state, motion, memory, telemetry = ride
    constants, tree, work = model
    chunk = reading_interval(command.dt)
    for done in range(steps):
        if memory.fall != 0.0:
            break
        now = to_motion(motion, constants.joints)
        last = done == steps - 1
        loads = loads_at(now, command, ground, bumps, memory, telemetry, constants, last)
        if loads.fall != 0:
            break
        write_loads(loads, constants.joints, work.loads)
        articulated.accelerate(motion, loads.force, loads.torque, work.loads, tree, work)
        articulated.integrate(motion, work, command.dt)
        if (done + 1) % chunk == 0:
            read(motion, ground, constants, state)
    read(motion, ground, constants, state)
    return int(memory.fall)


@njit(cache=True)
def _advance_one(
    rides: Rides, models: Model, command: tuple[float, float, float], grounds: Record, bumps: Array, steps: int
) -> None:
    """Do as `advance` with arrays of one record each, which cost a caller in Python less than records."""
    ride = Rides(rides.state, rides.motion[0], rides.memory[0], rides.telemetry[0])
    model = Model(models.constants[0], models.tree[0], models.work[0])
    advance(ride, model, discretise_command(command, model.constants), grounds[0], bumps, steps)


@njit(cache=True)
def loads_one(
    rides: Rides,
    constants: Record,
    command: tuple[float, float, float],
    grounds: Record,
    bumps: Array,
    joints: Array,
    log: bool,
) -> tuple[Vec, Vec, int]:
    """Return force, torque and fall of `forces.loads_at` for arrays of one record each; write the joints' loads."""
    discrete, motion = discretise_command(command, constants[0]), to_motion(rides.motion[0], constants[0].joints)
    loads = loads_at(motion, discrete, grounds[0], bumps, rides.memory[0], rides.telemetry[0], constants[0], log)
    write_loads(loads, constants[0].joints, joints)
    return loads.force, loads.torque, loads.fall


@njit(cache=True)
def read_one(rides: Rides, constants: Record, grounds: Record) -> None:
    """Do as `read` with arrays of one record each."""
    read(rides.motion[0], grounds[0], constants[0], rides.state)


class SuperbikeEngine(Engine):
    """A superbike that is stepped with a fixed integration step.

    The same reset and commands give the same states bit for bit, whatever the engine did before. Once the machine has
    fallen, time passes but nothing moves any more.

    Attributes:
        tree: its bodies and joints.
        motion: of the bodies, a record of `articulated.motion_record`, shape (1,).
        memory: of the forces, a record of `records.MEMORY`, shape (1,).
        constants: of the forces, a record of `records.CONSTANTS`, shape (1,), read-only.
    """

    vehicle: Superbike

    def __init__(self, vehicle: Superbike, time_step: float) -> None:
        """Check the arguments and make the records; a subclass sets up its integrator and resets.

        Args:
            vehicle: the machine to simulate.
            time_step: integration step, s.

        Raises:
            ValueError: the vehicle is no superbike, or the time step is not positive and finite.
        """
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"vehicle '{vehicle.name}' is no superbike: it has no tyres")
        super().__init__(vehicle, time_step)
        self.tree = superbike_tree(vehicle)
        self._principal: Quaternion = tuple(principal_axes(self.tree[0].inertia)[0].tolist())
        self.motion = np.zeros(1, dtype=articulated.motion_record(len(self.tree)))
        self.memory = np.zeros(1, dtype=MEMORY)
        self.constants = constants_of(vehicle, self.tree)
        self._telemetry = np.zeros(1, dtype=TELEMETRY)
        self._signals = self._telemetry.view(np.float64)
        self._loads = np.zeros(len(self.tree) - 1)  # on the joints
        self._ride = Rides(self._state, self.motion, self.memory, self._telemetry)
        self._read = compiled_entry(read_one, self._ride, self.constants, LEVEL.record)
        self._load = compiled_entry(loads_one, self._ride, self.constants, (0.0, 0.0, 0.0), *LEVEL, self._loads, False)

    @property
    def fall(self) -> str:
        """Kind of the fall, one of `forces.FALL_NAMES`."""
        return FALL_NAMES[int(self.memory["fall"][0])]

    def reset(self, state: st.StateVector, ground: Ground = LEVEL) -> None:
        """Set any minimal state, with the tyres carrying the standing machine and the rider riding to this lean.

        The rear wheel rolls without slip; yaw rate and sideways velocity are those of ideal rolling, which the tyres
        correct within a few tenths of a second.

        Args:
            state: minimal state, shape (10,).
            ground: under the wheels.

        Raises:
            ValueError: the state has the wrong shape, is not finite, or no such configuration exists.
        """
        state = st.checked_state(state)
        begin(self.vehicle, self.constants, self._principal, state, ground, self.motion, self.memory)
        self._state[:] = state
        self.set_motion()
        self._read(self._ride, self.constants, ground.record)
        # the memory is a copy that nobody needs afterwards
        unmoved = self._ride._replace(memory=self.memory.copy())
        self._load(unmoved, self.constants, (0.0, 0.0, self.time_step), *ground, self._loads, True)

    def deflect(self, x: float, y: float, turn: float, share: float, dx: float, dy: float) -> None:
        """Turn the machine at a wall; see `pose.deflect`. State and telemetry show it from the next step on."""
        deflect(self.motion, x, y, turn, share, dx, dy)
        self.set_motion()

    def telemetry(self) -> Array:
        """Return the signals of the last step as a fresh vector, in the order of `forces.TELEMETRY_NAMES`."""
        return self._signals.copy()

    @abstractmethod
    def set_motion(self) -> None:
        """Have the integrator go on from `motion`, and write there the motion that it holds."""


class CompiledSuperbikeEngine(SuperbikeEngine):
    """A superbike whose bodies are integrated by `bike_sim.physics.multibody.articulated`.

    It shares the forces with the engine in Bullet, but not a line of the dynamics, so each checks the other: their
    rides come together as the step shrinks. One step is a single compiled call, and batches step rows of many machines
    with the same code (`advance`).
    """

    def __init__(self, vehicle: Superbike, time_step: float) -> None:
        """Put the machine upright at rest; see `SuperbikeEngine`."""
        super().__init__(vehicle, time_step)
        tree, work = articulated.tree_record(self.tree, vehicle.g), articulated.workspace(len(self.tree))
        self._model = Model(self.constants, tree, work)
        self.reset(st.upright_state(0.0, vehicle.rF))

    def set_motion(self) -> None:
        """Do nothing: the record is the motion."""

    def _run(self, steering: float, throttle: float, steps: int, ground: Ground) -> None:
        """Step until a fall or to the end, and fill the minimal state."""
        _advance_one(self._ride, self._model, (steering, throttle, self.time_step), *ground, steps)
