"""Vehicles of any kind and engine, a simulator each, one after the other; see `batch.CircuitBatch`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.physics.state import STATE_SIZE
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.events import Event
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import NO_FALL, Snapshot
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]


class SimulatorBatch:
    """Vehicles of any kind and engine on paths and circuits, a simulator each, one after the other; see `batch.Batch`.

    Attributes:
        simulators: one a row.
        place: position relative to the centre line of a circuit, shape (n, 4); NaN where there is none.
        circuit: position relative to the limits, shape (n, lk.CIRCUIT_SIZE); NaN where there is no circuit.
        points: course points, shape (n, 3, lk.STATIONS, 3); NaN where there is no circuit.
    """

    def __init__(
        self, count: int, config: SimulatorConfig, preview: Preview, disturbances: Disturbances | None = None
    ) -> None:
        """Start the simulators; see `bicycle_batch.CompiledBatch`. Disturbances are as in `Simulator`."""
        self.count = count
        self.simulators = [Simulator(config, disturbances) for _ in range(count)]
        plant = self.simulators[0].plant
        self.preview = plant.preview or preview
        # One store of courses for all rows, so that a circuit's line is computed and kept once.
        for simulator in self.simulators[1:]:
            simulator.share_courses(self.simulators[0])
        self.state = np.zeros((count, STATE_SIZE))
        self.look = np.zeros((count, lk.LOOK_SIZE))
        self.signals = np.zeros((count, len(plant.signal_names)))
        self.fallen = np.zeros(count, dtype=np.bool_)
        self.preview_y = np.zeros((count, self.preview.count))
        self.place = np.full((count, lk.PLACE_SIZE), np.nan)
        self.circuit = np.full((count, lk.CIRCUIT_SIZE), np.nan)
        self.points = np.full((count, 3, lk.STATIONS, 3), np.nan)
        self._snapshots: list[Snapshot | None] = [None] * count

    @property
    def vehicle(self) -> Vehicle:
        """Their vehicle."""
        return self.simulators[0].vehicle

    @property
    def off_course(self) -> NDArray[np.bool_]:
        """Which are beyond the limits of their course; see `batch.CircuitBatch`."""
        return np.array([seen is not None and seen.off_course for seen in self._snapshots])

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Which have ridden their course to its end; see `batch.CircuitBatch`."""
        return np.array([seen is not None and seen.finished for seen in self._snapshots])

    @property
    def laps(self) -> tuple[tuple[float, ...], ...]:
        """Times of the valid laps finished since the reset, s; see `batch.CircuitBatch`."""
        return tuple(() if simulator.scene is None else simulator.scene.valid_laps() for simulator in self.simulators)

    def fall(self, index: int) -> str:
        """Return how a ride ended; see `batch.CircuitBatch`."""
        seen = self._snapshots[index]
        return NO_FALL if seen is None else seen.fall

    def events(self, index: int) -> tuple[Event, ...]:
        """Return what happened in the last step of a row; see `batch.CircuitBatch`."""
        seen = self._snapshots[index]
        return () if seen is None else seen.events

    def course(self, index: int) -> Course:
        """Return the followed line of a vehicle; see `batch.Batch`."""
        course = self.simulators[index].course
        assert course is not None, "an episode has begun"
        return course

    def reset(self, index: int, request: ResetRequest) -> None:
        """Begin an episode of one vehicle; see `batch.Batch`."""
        self.place[index] = self.circuit[index] = self.points[index] = np.nan
        self._show(index, self.simulators[index].reset(request))

    def step(self, commands: FloatArray) -> None:
        """Hold both commands for a control period; see `batch.Batch`."""
        for index, simulator in enumerate(self.simulators):
            self._show(index, simulator.step(float(commands[index, 0]), float(commands[index, 1])))

    def _show(self, index: int, snapshot: Snapshot) -> None:
        self.state[index], self.look[index], self.signals[index] = snapshot.state, snapshot.look, snapshot.signals
        self.fallen[index], self.preview_y[index] = snapshot.fallen, snapshot.preview_y
        self._snapshots[index] = snapshot
        if snapshot.circuit is not None:
            self.place[index], self.points[index] = snapshot.circuit.place, snapshot.circuit.points
            self.circuit[index] = snapshot.circuit.limits

    def state_dict(self) -> None:
        """Return None: the engines do not expose contacts and caches, so their rides cannot be continued."""

    def restore(self, stored: dict[str, Any]) -> None:
        """Refuse; see `batch.Batch`."""
        raise ValueError(f"rides on engine {self.simulators[0].config.engine!r} cannot be taken up in the middle")

    def close(self) -> None:
        """Release the engines."""
        for simulator in self.simulators:
            simulator.close()
