"""A batch of vehicles, stepped together. Same kernels and same draws as the single simulator, bit for bit.

Courses are shared: rows on the same course refer to the same arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.sim.bicycle_batch import COMPILED_ENGINE as COMPILED_ENGINE
from bike_sim.sim.bicycle_batch import CompiledBatch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator_batch import SimulatorBatch
from bike_sim.vehicles.bicycle import Vehicle

if TYPE_CHECKING:
    from bike_sim.sim.events import Event

FloatArray = NDArray[np.float64]

SUPERBIKE_ENGINE: Final = "compiled"
"""The engine that steps all superbikes of a batch in one compiled loop."""


class Batch(Protocol):
    """Vehicles that are stepped together. The arrays have one row per vehicle; a step changes them in place.

    Attributes:
        count: number of vehicles.
        vehicle: their vehicle.
        state: minimal states, shape (n, 10).
        look: derived quantities in the order of :mod:`bike_sim.sim.look`, shape (n, lk.LOOK_SIZE).
        signals: telemetry, shape (n, signals); no columns where the vehicle has none.
        place: position of both contact points relative to the centre line, in the order of :mod:`bike_sim.sim.look`,
            shape (n, 4); NaN in rows that ride a path.
        circuit: position relative to the limits, in the order of `schema.LIMITS`, shape (n, k); the same.
        points: course points, shape (n, 3, STATIONS, 3); the same.
    """

    count: int
    state: FloatArray
    look: FloatArray
    signals: FloatArray
    place: FloatArray
    circuit: FloatArray
    points: FloatArray

    @property
    def fallen(self) -> NDArray[np.bool_]:
        """Which vehicles have fallen, shape (n,); they stay as they are until their next episode."""
        ...

    @property
    def vehicle(self) -> Vehicle:
        """Their vehicle."""
        ...

    @property
    def preview_y(self) -> FloatArray:
        """Lateral offsets of the preview points, m, shape (n, points)."""
        ...

    def course(self, index: int) -> Course:
        """Return the followed line of a vehicle's episode."""
        ...

    def reset(self, index: int, request: ResetRequest) -> None:
        """Begin an episode of one vehicle, drawn exactly as `Simulator.reset` draws it.

        Raises:
            ValueError: a request that cannot be met.
        """
        ...

    def step(self, commands: FloatArray) -> None:
        """Hold steering and throttle in [-1, 1], shape (n, 2), for a control period."""
        ...

    def state_dict(self) -> dict[str, Any] | None:
        """Return all that :meth:`restore` needs, as plain values and arrays; None where rides cannot be continued."""
        ...

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue with the rides that :meth:`state_dict` was taken of, bit for bit.

        Raises:
            ValueError: rides of another number of vehicles, or of an engine whose rides cannot be continued.
        """
        ...

    def close(self) -> None:
        """Release the engines."""
        ...


class CircuitBatch(Batch, Protocol):
    """A batch that also rides circuits."""

    @property
    def off_course(self) -> NDArray[np.bool_]:
        """Which are beyond the limits of their course, as `Snapshot.off_course`, shape (n,)."""
        ...

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Which have ridden their course to its end, as `Snapshot.finished`, shape (n,)."""
        ...

    @property
    def laps(self) -> tuple[tuple[float, ...], ...]:
        """Times of the valid laps finished since the reset, s, for each row."""
        ...

    def fall(self, index: int) -> str:
        """Return how a ride ended, as `Snapshot.fall`."""
        ...

    def events(self, index: int) -> tuple[Event, ...]:
        """Return what happened in the last step of a row, or with its reset after it, as `Snapshot.events`."""
        ...


def make_batch(
    count: int,
    config: SimulatorConfig,
    preview: Preview,
    disturbances: Disturbances | None = None,
    vehicles: Sequence[str] | None = None,
) -> Batch:
    """Return a batch of vehicles, compiled where the engine is and nothing disturbs its vehicles.

    Args:
        count: number of vehicles.
        config: vehicle, engine and steps.
        preview: points of the path ahead.
        disturbances: of what is ridden, drawn for each row as its `Simulator` draws them.
        vehicles: name or file of each row's machine, where they differ; compiled superbikes only.

    Raises:
        ValueError: an invalid parameter. FileNotFoundError: an unknown vehicle.
    """
    if disturbances is not None and disturbances.acts_on_bicycle:
        return SimulatorBatch(count, config, preview, disturbances)
    if config.engine == COMPILED_ENGINE and vehicles is None:
        return CompiledBatch(count, config, preview)
    return make_circuit_batch(count, config, preview, vehicles)


def make_circuit_batch(
    count: int, config: SimulatorConfig, preview: Preview, vehicles: Sequence[str] | None = None
) -> CircuitBatch:
    """Return a batch that rides circuits: compiled for superbikes on engine SUPERBIKE_ENGINE, else of simulators.

    Raises:
        ValueError: an invalid parameter. FileNotFoundError: an unknown vehicle.
    """
    if config.engine == SUPERBIKE_ENGINE:
        # Late: a bicycle is spared tyres and lap theory.
        from bike_sim.sim.superbike_batch import CompiledSuperbikeBatch

        return CompiledSuperbikeBatch(count, config, vehicles)
    if vehicles is not None:
        raise ValueError(f"engine {config.engine!r} steps vehicles of one kind side by side, not {', '.join(vehicles)}")
    return SimulatorBatch(count, config, preview)
