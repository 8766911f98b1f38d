"""The superbike in Bullet: four bodies and a sliding rider, with all forces from one compiled function.

Bullet integrates the tree of bodies; the wheels have no collision shape. At every step
`bike_sim.physics.superbike.forces` turns the motion into forces, which Bullet gets as generalised forces of frame and
joints. (Forces on a link would need its pose, which Bullet holds one step late: at 40 m/s and 2 ms the load would act
8 cm off the axle.)
"""

from __future__ import annotations

from bike_sim.physics import state as st
from bike_sim.physics.ground import Ground
from bike_sim.physics.multibody.bullet import BulletTree
from bike_sim.physics.superbike.engine import SuperbikeEngine, reading_interval
from bike_sim.vehicles.superbike import Superbike


class BulletSuperbikeEngine(SuperbikeEngine):
    """A superbike in a Bullet world of its own."""

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
        self._bodies = BulletTree(self.tree, vehicle.g, self.time_step)
        self.reset(st.upright_state(0.0, vehicle.rF))

    def close(self) -> None:
        """Give the Bullet world back; a second call does nothing."""
        self._bodies.close()

    def _check_open(self) -> None:
        """Refuse to go on in a world that is given back.

        Raises:
            RuntimeError: the engine is closed.
        """
        if not self._bodies.is_open:
            raise RuntimeError(f"the engine of vehicle '{self.vehicle.name}' is closed")

    def set_motion(self) -> None:
        """Have Bullet's bodies move as the record says, which then says what Bullet holds."""
        self._check_open()
        self._bodies.place(self.motion)

    def _run(self, steering: float, throttle: float, steps: int, ground: Ground) -> None:
        """Step until a fall or to the end, and fill the minimal state."""
        self._check_open()
        command = steering, throttle, self.time_step
        motion, ride, constants, load, loads = self.motion, self._ride, self.constants, self._load, self._loads
        if self.memory["fall"][0] != 0.0 or steps == 0:
            return  # a fallen machine is not read again on another ground
        chunk = reading_interval(self.time_step)
        for done in range(steps):
            last = done == steps - 1
            force, torque, fall = load(ride, constants, command, *ground, loads, last)
            if fall != 0:
                break
            self._bodies.step(motion, force, torque, loads.tolist())
            if (done + 1) % chunk == 0:
                self._read(ride, constants, ground.record)
        self._read(ride, constants, ground.record)
