"""The superbike without PyBullet: the same bodies and the same forces, integrated by compiled code alone."""

from __future__ import annotations

from bike_sim.physics import articulated
from bike_sim.physics import state as st
from bike_sim.physics.superbike.base import SuperbikeBase
from bike_sim.physics.superbike.compiled import advance_one
from bike_sim.vehicles.superbike import Superbike


class CompiledSuperbikeEngine(SuperbikeBase):
    """A superbike whose bodies are integrated by `bike_sim.physics.articulated`.

    It shares the forces with the engine in Bullet, but not a line of the dynamics, so each checks the other: their
    rides come together as the step shrinks. One step is a single compiled call, and batches step rows of many machines
    with the same code (`bike_sim.physics.superbike.compiled.advance_rows`).
    """

    def __init__(self, vehicle: Superbike, time_step: float) -> None:
        """Put the machine upright at rest.

        Args:
            vehicle: the machine to simulate.
            time_step: integration step, s.

        Raises:
            ValueError: the vehicle is no superbike, or the time step is not positive and finite.
        """
        super().__init__(vehicle, time_step)
        self._tree = articulated.tree_record(self.tree, vehicle.g)
        self._work = articulated.workspace(len(self.tree))
        self.reset(st.upright_state(0.0, vehicle.rF))

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def set_motion(self) -> None:
        """Do nothing: the record is the motion."""

    def _run(self, steering: float, throttle: float, steps: int) -> None:
        """Step until a fall or to the end, and fill the minimal state."""
        advance_one(
            self._state, self.motion, self._memory, self._telemetry, self._constants, self._tree, self._work,
            (steering, throttle, self.time_step), *self.ground, steps,
        )  # fmt: skip
