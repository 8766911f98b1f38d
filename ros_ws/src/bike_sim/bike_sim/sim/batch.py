"""Many bicycles on their own random paths, stepped by one compiled loop."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy import ndarray
from numpy.typing import NDArray

from bike_sim.physics.state import STATE_SIZE
from bike_sim.physics.whipple_engine import advance
from bike_sim.sim import look as ride
from bike_sim.sim.request import Preview, ResetRequest, begin
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

_MAX_SAMPLES = 20_000
"""Course samples kept for each bicycle: 2 km, more than two episodes at 7 m/s need."""


@njit(cache=True)
def _step(
    states: ndarray,
    lying: ndarray,
    steer_set: ndarray,
    time_step: float,
    substeps: int,
    parameters: ndarray,
    courses: ndarray,
    counts: ndarray,
    spacings: ndarray,
    closed: ndarray,
    by_time: bool,
    interval: float,
    seen: ndarray,
    preview: ndarray,
) -> None:
    for i in range(len(states)):
        lying[i] = lying[i] or not advance(states[i], steer_set[i], time_step, substeps, parameters)
        _look(
            states[i],
            parameters,
            courses[i],
            counts[i],
            spacings[i],
            closed[i],
            by_time,
            interval,
            False,
            seen[i],
            preview[i],
        )


@njit(cache=True)
def _look(
    state: ndarray,
    parameters: ndarray,
    course: ndarray,
    count: int,
    spacing: float,
    closed: bool,
    by_time: bool,
    interval: float,
    fresh: bool,
    seen: ndarray,
    preview: ndarray,
) -> None:
    ride.look(
        state,
        parameters,
        course[0, :count],
        course[1, :count],
        course[2, :count],
        course[3, :count],
        spacing,
        closed,
        by_time,
        interval,
        fresh,
        seen,
        preview[0],
        preview[1],
    )


class RideBatch:
    """Bicycles that ride side by side on the compiled Whipple engine.

    Attributes:
        states: minimal states, shape (n, 10).
        lying: which bicycles lie on the ground, shape (n,); they stay as they are until they begin a new ride.
        seen: derived quantities in the order of :mod:`bike_sim.sim.look`, shape (n, ride.LOOK_SIZE).
        preview_y: lateral offsets of the preview points, m, shape (n, preview.count).
    """

    def __init__(
        self, count: int, vehicle: Vehicle, preview: Preview, control_period: float = 0.05, time_step: float = 0.01
    ) -> None:
        """Make room for a number of bicycles.

        Args:
            count: number of bicycles.
            vehicle: their vehicle.
            preview: what they see of the path.
            control_period: s.
            time_step: integration step of the compiled engine, s.
        """
        self.count = count
        self.vehicle = vehicle
        self.preview = preview
        self.time_step = time_step
        self.substeps = round(control_period / time_step)
        self.states = np.zeros((count, STATE_SIZE))
        self.lying = np.zeros(count, dtype=np.bool_)
        self.seen = np.zeros((count, ride.LOOK_SIZE))
        self._points = np.zeros((count, 2, preview.count))
        self._courses = np.zeros((count, 4, _MAX_SAMPLES))
        self._counts = np.full(count, 2, dtype=np.int64)
        self._spacings = np.ones(count)
        self._closed = np.zeros(count, dtype=np.bool_)

    @property
    def preview_y(self) -> FloatArray:
        """Lateral offsets of the preview points, m, shape (n, preview.count)."""
        return self._points[:, 1]

    def reset(self, index: int, request: ResetRequest) -> None:
        """Begin a new ride of one bicycle, drawn exactly as :class:`bike_sim.sim.simulator.Simulator` draws it.

        Raises:
            ValueError: a course that is longer than there is room for.
        """
        course, state = begin(request, self.vehicle)
        count = len(course.s)
        if count > _MAX_SAMPLES:
            raise ValueError(f"a batch has room for {_MAX_SAMPLES} samples, course {course.name!r} has {count}")
        self.states[index] = state
        self.lying[index] = False
        self._courses[index, :, :count] = course.x, course.y, course.heading, course.curvature
        self._counts[index] = count
        self._spacings[index] = course.spacing
        self._closed[index] = course.closed
        self.seen[index] = ride.blank_look()
        _look(
            self.states[index],
            self.vehicle.parameters,
            self._courses[index],
            count,
            course.spacing,
            course.closed,
            self.preview.by_time,
            self.preview.interval,
            True,
            self.seen[index],
            self._points[index],
        )

    def step(self, commands: FloatArray) -> None:
        """Hold one steering command a bicycle for a control period.

        Args:
            commands: in [-1, 1], shape (n,).
        """
        _step(
            self.states,
            self.lying,
            np.asarray(commands, dtype=np.float64) * self.vehicle.max_steer,
            self.time_step,
            self.substeps,
            self.vehicle.parameters,
            self._courses,
            self._counts,
            self._spacings,
            self._closed,
            self.preview.by_time,
            self.preview.interval,
            self.seen,
            self._points,
        )
