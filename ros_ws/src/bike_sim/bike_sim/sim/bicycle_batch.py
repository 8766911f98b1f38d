"""Bicycles on paths in one compiled loop; see `batch.Batch`."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numba.typed import List
from numpy import ndarray
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.physics.bicycle.whipple import WhippleEngine, advance
from bike_sim.physics.state import ROLL, STATE_SIZE
from bike_sim.sim import look as lk
from bike_sim.sim.beginning import Courses, begin
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.places import Places
from bike_sim.sim.plant import make_plant
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.scene import PathScene
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

COMPILED_ENGINE: Final = "whipple"
"""The engine that steps all bicycles of a batch in one compiled loop."""


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
        _look(
            states[i],
            parameters,
            tables[course_of[i]],
            spacings[i],
            closed[i],
            by_time,
            interval,
            False,
            looks[i],
            previews[i],
        )


class CompiledBatch:
    """Bicycles on paths, on the compiled Whipple engine, in one compiled loop; see `batch.Batch`."""

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
            raise ValueError(f"a compiled batch of bicycles needs one and engine {COMPILED_ENGINE!r}, got {config!r}")
        self.time_step, self.substeps = config.time_step, config.substeps
        self.state = np.zeros((count, STATE_SIZE))
        self.lying = np.zeros(count, dtype=np.bool_)
        self.look = np.zeros((count, lk.LOOK_SIZE))
        self.signals = np.zeros((count, 0))
        self.place = np.full((count, lk.PLACE_SIZE), np.nan)
        self.circuit = np.full((count, lk.CIRCUIT_SIZE), np.nan)
        self.points = np.full((count, 3, lk.STATIONS, 3), np.nan)
        self._ridden: list[Course | None] = [None] * count
        self._points = np.zeros((count, 2, preview.count))
        self._courses = Courses()
        self._requests: list[ResetRequest | None] = [None] * count
        self._tables = Places(count, np.zeros((4, 2)))
        self._course_of = np.zeros(count, dtype=np.int64)
        self._spacings = np.ones(count)
        self._closed = np.zeros(count, dtype=np.bool_)

    @property
    def vehicle(self) -> Vehicle:
        """Their vehicle."""
        return self._plant.vehicle

    @property
    def preview_x(self) -> FloatArray:
        """Their distances ahead, m, shape (n, preview.count)."""
        return self._points[:, 0]

    @property
    def preview_y(self) -> FloatArray:
        """Lateral offsets of the preview points, m, shape (n, preview.count)."""
        return self._points[:, 1]

    @property
    def fallen(self) -> NDArray[np.bool_]:
        """Which bicycles have fallen, or lean beyond the vehicle's limit, shape (n,)."""
        return self.lying | (np.abs(self.state[:, ROLL]) > self.vehicle.fall_roll)

    def course(self, index: int) -> Course:
        """Return the path of a bicycle; see `Batch`."""
        course = self._ridden[index]
        assert course is not None, "an episode has begun"
        return course

    def reset(self, index: int, request: ResetRequest) -> None:
        """Begin an episode of one bicycle; see `batch.Batch`.

        Raises:
            ValueError: a request that cannot be met, or a circuit: this loop has no limits and no laps.
        """
        scene, state = begin(request, self._plant, self._courses)
        if not isinstance(scene, PathScene):
            raise ValueError(f"course {request.course!r} is a circuit; a compiled batch of bicycles rides paths")
        course = scene.course
        self._ridden[index] = course
        self._course_of[index] = self._tables.put(index, course.table)
        self._spacings[index], self._closed[index] = course.spacing, course.closed
        self._requests[index] = request
        self.state[index] = state
        self.lying[index] = False
        self.look[index] = scene.blank_look()
        _look(
            self.state[index],
            self.vehicle.parameters,
            course.table,
            course.spacing,
            course.closed,
            self.preview.by_time,
            self.preview.interval,
            True,
            self.look[index],
            self._points[index],
        )

    def step(self, commands: FloatArray) -> None:
        """Hold steering commands for a control period; see `batch.Batch`."""
        _step(
            self.state,
            self.lying,
            commands[:, 0] * self.vehicle.max_steer,
            self.time_step,
            self.substeps,
            self.vehicle.parameters,
            self._tables.arrays,
            self._course_of,
            self._spacings,
            self._closed,
            self.preview.by_time,
            self.preview.interval,
            self.look,
            self._points,
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the state of all bicycles; courses follow from the requests. See `batch.Batch`."""
        return {
            "requests": [None if request is None else request.to_card() for request in self._requests],
            "state": self.state.copy(),
            "lying": self.lying.copy(),
            "look": self.look.copy(),
            "points": self._points.copy(),
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Lay the courses again and take the bicycles where they were; see `batch.Batch`."""
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
