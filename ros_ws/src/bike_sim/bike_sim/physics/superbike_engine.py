"""The superbike in Bullet: four bodies and a sliding rider, with all forces from one compiled function.

Bullet integrates the tree of bodies; the wheels have no collision shape. At every step
`bike_sim.physics.superbike_forces` turns the motion into forces, which Bullet gets as generalised forces of frame and
joints. (Forces on a link would need its pose, which Bullet holds one step late: at 40 m/s and 2 ms the load would act
8 cm off the axle.) All steps of a control period are one compiled call, see `bike_sim.physics.bullet_world`.
"""

from __future__ import annotations

import weakref
from typing import Final

from bike_sim.physics import state as st
from bike_sim.physics.bullet_world import close_world, make_world, place
from bike_sim.physics.superbike.base import SuperbikeBase
from bike_sim.physics.superbike.in_bullet import advance_in_bullet
from bike_sim.vehicles.superbike import Superbike

TIME_STEP: Final = 0.002
"""Integration step, s, that rides a lap far faster than real time; `bike validate` shows what it costs."""


class SuperbikeEngine(SuperbikeBase):
    """A superbike in a Bullet world of its own."""

    def __init__(self, vehicle: Superbike, time_step: float) -> None:
        """Build the world with the machine upright at rest.

        Args:
            vehicle: the machine to simulate.
            time_step: integration step, s.

        Raises:
            ValueError: the vehicle is no superbike, or the time step is not positive and finite.
        """
        super().__init__(vehicle, time_step)
        self._world, self._body = make_world(self.tree, vehicle.g, self.time_step)
        # a forgotten engine must not hold on to its world, which takes megabytes
        self._close = weakref.finalize(self, close_world, self._world)
        self.reset(st.upright_state(0.0, vehicle.rF))

    def close(self) -> None:
        """Give the Bullet world back; a second call does nothing."""
        self._close()

    def _check_open(self) -> None:
        """Refuse to go on in a world that is given back.

        Raises:
            RuntimeError: the engine is closed.
        """
        if not self._close.alive:
            raise RuntimeError(f"the engine of vehicle '{self.vehicle.name}' is closed")

    def set_motion(self) -> None:
        """Have Bullet's bodies move as the record says, which then says what Bullet holds."""
        self._check_open()
        place(self._world, self._body, self.motion)

    def _run(self, steering: float, throttle: float, steps: int) -> None:
        """Step until a fall or to the end, and fill the minimal state."""
        self._check_open()
        advance_in_bullet(
            self._state, self.motion, self._memory, self._telemetry, self._constants, self._world, self._body,
            (steering, throttle, self.time_step), *self.ground, steps,
        )  # fmt: skip
