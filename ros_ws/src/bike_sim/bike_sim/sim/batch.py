"""A batch of vehicles, stepped together. Same kernels and same draws as the single simulator, bit for bit.

Courses are shared by index: a row refers to a course, and rows on the same course refer to the same arrays.
"""

from __future__ import annotations

from typing import Any, Final, Protocol

import numpy as np
from numba import njit
from numba.typed import List
from numpy import ndarray
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.physics.state import ROLL, STATE_SIZE
from bike_sim.physics.whipple_engine import WhippleEngine, advance
from bike_sim.sim import look as lk
from bike_sim.sim.beginning import Courses, begin
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.plant import make_plant
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.scene import PathScene
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

COMPILED_ENGINE: Final = "whipple"
"""The engine that steps all vehicles of a batch in one compiled loop."""


class Batch(Protocol):
    """Vehicles that are stepped together. The arrays have one row per vehicle; a step changes them in place.

    Attributes:
        count: number of vehicles.
        vehicle: their vehicle.
        state: minimal states, shape (n, 10).
        look: derived quantities in the order of :mod:`bike_sim.sim.look`, shape (n, lk.LOOK_SIZE).
        signals: telemetry, shape (n, signals); no columns where the vehicle has none.
    """

    count: int
    state: FloatArray
    look: FloatArray
    signals: FloatArray

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


@njit(cache=True, inline="always")
def _look(
    state: ndarray,
    parameters: ndarray,
    table: ndarray,
    spacing: float,
    closed: bool,
    by_time: bool,
    interval: float,
    fresh: bool,
    look: ndarray,
    preview: ndarray,
) -> None:
    line = table[0], table[1], table[2], table[3]
    lk.look_at_path(
        state, parameters, True, line, spacing, closed, by_time, interval, fresh, look, preview[0], preview[1]
    )


@njit(cache=True)
def _step(
    states: ndarray,
    lying: ndarray,
    steer_set: ndarray,
    time_step: float,
    substeps: int,
    parameters: ndarray,
    tables: List,
    course_of: ndarray,
    spacings: ndarray,
    closed: ndarray,
    by_time: bool,
    interval: float,
    looks: ndarray,
    previews: ndarray,
) -> None:
    for i in range(len(states)):
        lying[i] = lying[i] or not advance(states[i], steer_set[i], time_step, substeps, parameters)
        course = course_of[i]
        _look(
            states[i],
            parameters,
            tables[course],
            spacings[course],
            closed[course],
            by_time,
            interval,
            False,
            looks[i],
            previews[i],
        )


class CompiledBatch:
    """Bicycles on paths, on the compiled Whipple engine, in one compiled loop; see `Batch`."""

    def __init__(self, count: int, config: SimulatorConfig, preview: Preview) -> None:
        """Make room for a number of bicycles.

        Args:
            count: number of bicycles.
            config: vehicle and steps; the engine must be COMPILED_ENGINE.
            preview: points of the path ahead.

        Raises:
            ValueError: a vehicle or an engine that this loop does not carry.
        """
        self.count, self.preview = count, preview
        self._plant = make_plant(config)
        if not isinstance(getattr(self._plant, "engine", None), WhippleEngine):
            raise ValueError(f"a compiled batch needs a bicycle and engine {COMPILED_ENGINE!r}, got {config!r}")
        self.time_step, self.substeps = config.time_step, config.substeps
        self.state = np.zeros((count, STATE_SIZE))
        self.lying = np.zeros(count, dtype=np.bool_)
        self.look = np.zeros((count, lk.LOOK_SIZE))
        self.signals = np.zeros((count, 0))
        self._points = np.zeros((count, 2, preview.count))
        self._courses = Courses()
        # At most one slot per row: a row on its own course takes its own slot, shared ones take that of the first.
        self._rows: list[Course | None] = [None] * count
        self._requests: list[ResetRequest | None] = [None] * count
        self._tables = List([np.zeros((4, 2)) for _ in range(count)])
        self._course_of = np.arange(count)
        self._spacings = np.ones(count)
        self._closed = np.zeros(count, dtype=np.bool_)

    @property
    def vehicle(self) -> Vehicle:
        """Their vehicle."""
        return self._plant.vehicle

    @property
    def preview_y(self) -> FloatArray:
        """Lateral offsets of the preview points, m, shape (n, preview.count)."""
        return self._points[:, 1]

    @property
    def fallen(self) -> NDArray[np.bool_]:
        """Which bicycles have fallen, or lean beyond the vehicle's limit, shape (n,)."""
        return self.lying | (np.abs(self.state[:, ROLL]) > self.vehicle.fall_roll)

    def reset(self, index: int, request: ResetRequest) -> None:
        """Begin an episode of one bicycle; see `Batch`.

        Raises:
            ValueError: a request that cannot be met, or a circuit: this loop has no limits and no laps.
        """
        scene, state = begin(request, self._plant, self._courses)
        if not isinstance(scene, PathScene):
            raise ValueError(f"course {request.course!r} is a circuit; a compiled batch of bicycles rides paths")
        place = self._put(index, scene.course)
        self._requests[index] = request
        self.state[index] = state
        self.lying[index] = False
        self.look[index] = scene.blank_look()
        _look(
            self.state[index],
            self.vehicle.parameters,
            self._tables[place],
            self._spacings[place],
            self._closed[place],
            self.preview.by_time,
            self.preview.interval,
            True,
            self.look[index],
            self._points[index],
        )

    def _put(self, index: int, course: Course) -> int:
        """Return the slot of a course for a row; a course that another row rides is not stored again."""
        self._rows[index] = None
        for row, other in enumerate(self._rows):
            if other is course:
                place = int(self._course_of[row])
                break
        else:
            taken = {int(self._course_of[row]) for row, other in enumerate(self._rows) if other is not None}
            place = next(free for free in range(self.count) if free not in taken)
            self._tables[place] = course.table
            self._spacings[place], self._closed[place] = course.spacing, course.closed
        self._rows[index] = course
        self._course_of[index] = place
        return place

    def step(self, commands: FloatArray) -> None:
        """Hold steering commands for a control period; see `Batch`."""
        _step(
            self.state,
            self.lying,
            commands[:, 0] * self.vehicle.max_steer,
            self.time_step,
            self.substeps,
            self.vehicle.parameters,
            self._tables,
            self._course_of,
            self._spacings,
            self._closed,
            self.preview.by_time,
            self.preview.interval,
            self.look,
            self._points,
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the state of all bicycles; courses are left out, for they follow from the requests. See `Batch`."""
        return {
            "requests": [None if request is None else request.to_card() for request in self._requests],
            "state": self.state.copy(),
            "lying": self.lying.copy(),
            "look": self.look.copy(),
            "points": self._points.copy(),
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Lay the courses again and take the bicycles where they were; see `Batch`."""
        if len(stored["requests"]) != self.count:
            raise ValueError(f"a batch of {self.count} bicycles cannot go on with {len(stored['requests'])}")
        for index, card in enumerate(stored["requests"]):
            if card is not None:
                self.reset(index, ResetRequest.from_card(card))
        for name, array in (("state", self.state), ("lying", self.lying), ("look", self.look)):
            array[...] = stored[name]
        self._points[...] = stored["points"]

    def close(self) -> None:
        """Release the engine that the starts are drawn with."""
        self._plant.close()


class SimulatorBatch:
    """Vehicles of any kind and engine on paths and circuits, a simulator each, one after the other; see `Batch`.

    Attributes:
        simulators: one a row.
        place: position relative to the centre line of a circuit, shape (n, 4); NaN where there is none.
        points: course points, shape (n, 3, lk.STATIONS, 3); NaN where there is no circuit.
    """

    def __init__(self, count: int, config: SimulatorConfig, preview: Preview) -> None:
        """Start the simulators; see `CompiledBatch`."""
        self.count = count
        self.simulators = [Simulator(config) for _ in range(count)]
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
        self.points = np.full((count, 3, lk.STATIONS, 3), np.nan)

    @property
    def vehicle(self) -> Vehicle:
        """Their vehicle."""
        return self.simulators[0].vehicle

    def reset(self, index: int, request: ResetRequest) -> None:
        """Begin an episode of one vehicle; see `Batch`."""
        self._show(index, self.simulators[index].reset(request))

    def step(self, commands: FloatArray) -> None:
        """Hold both commands for a control period; see `Batch`."""
        for index, simulator in enumerate(self.simulators):
            self._show(index, simulator.step(float(commands[index, 0]), float(commands[index, 1])))

    def _show(self, index: int, snapshot: Snapshot) -> None:
        self.state[index], self.look[index], self.signals[index] = snapshot.state, snapshot.look, snapshot.signals
        self.fallen[index], self.preview_y[index] = snapshot.fallen, snapshot.preview_y
        if snapshot.circuit is not None:
            self.place[index], self.points[index] = snapshot.circuit.place, snapshot.circuit.points

    def state_dict(self) -> None:
        """Return None: the engines do not expose contacts and caches, so their rides cannot be continued."""

    def restore(self, stored: dict[str, Any]) -> None:
        """Refuse; see `Batch`."""
        raise ValueError(f"rides on engine {self.simulators[0].config.engine!r} cannot be taken up in the middle")

    def close(self) -> None:
        """Release the engines."""
        for simulator in self.simulators:
            simulator.close()


def make_batch(count: int, config: SimulatorConfig, preview: Preview) -> Batch:
    """Return a batch of vehicles, compiled where the engine is.

    Raises:
        ValueError: an invalid parameter. FileNotFoundError: an unknown vehicle.
    """
    kind = CompiledBatch if config.engine == COMPILED_ENGINE else SimulatorBatch
    return kind(count, config, preview)
