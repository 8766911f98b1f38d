"""Steps of a superbike whose bodies move in a Bullet world, in one compiled call; `compiled` is the same without it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.physics import bullet_world
from bike_sim.physics.superbike.compiled import felt, read, reading_interval
from bike_sim.physics.superbike.lags import held
from bike_sim.physics.superbike_forces import loads_at

Record = Any
Array = NDArray[np.float64]


@njit(cache=True)
def advance_in_bullet(
    state: Array, motions: Record, memories: Record, telemetries: Record, constants: Record, world: int, body: int,
    command: tuple[float, float, float], grounds: Record, bumps: Array, steps: int,
) -> None:  # fmt: skip
    """Step a machine until a fall or to the end; see `compiled.advance_one`.

    Args:
        state: minimal state, written.
        motions: of the bodies as Bullet holds it, advanced.
        memories: of the forces, advanced.
        telemetries: of the last step, written.
        constants: of the machine.
        world: Bullet's world, from `bullet_world.make_world`.
        body: Bullet's number of the machine.
        command: steering, throttle and time step, s.
        grounds: of `ground.GROUND`.
        bumps: profiles, see `ground.Ground`.
        steps: number of steps.
    """
    motion, memory, ground, known = motions[0], memories[0], grounds[0], constants[0]
    if memory.fall != 0.0 or steps == 0:
        return  # what lies there is seen as it was, whatever is said of the ground since
    hold, chunk = held(command, known), reading_interval(command[2])
    for done in range(steps):
        telling = done == steps - 1
        loads = loads_at(felt(motion), hold, ground, bumps, memory, telemetries[0], known, telling)
        if loads.fall != 0:
            break
        joints = (loads.rear, loads.steer, loads.front, loads.slide)
        bullet_world.step(world, body, motion, loads.force, loads.torque, joints)
        if (done + 1) % chunk == 0:
            read(motion, ground, known, state)
    read(motion, ground, known, state)
