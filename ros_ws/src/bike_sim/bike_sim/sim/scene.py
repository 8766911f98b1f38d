"""The surroundings of a vehicle, a path or a circuit, with the view and the events of each step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.projection import AHEAD, project, window
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics.ground import Ground, flat_ground
from bike_sim.sim import look as lk
from bike_sim.sim.events import Event, PathEvents, fall_event
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import Preview
from bike_sim.sim.snapshot import NO_FALL, TIPPED, CircuitView

FloatArray = NDArray[np.float64]


class View(NamedTuple):
    """View of a scene at one control instant; the fields are those of `bike_sim.sim.snapshot.Snapshot`."""

    look: FloatArray
    preview_x: FloatArray
    preview_y: FloatArray
    off_course: bool
    finished: bool
    fall: str
    circuit: CircuitView | None
    events: tuple[Event, ...]


class Scene(Protocol):
    """The surroundings of one episode.

    Attributes:
        course: the followed line.
        track: the circuit, or None.
        ground: under the wheels during the next control period.
        stopped: whether something holds the vehicle, so that its physics no longer runs.
    """

    course: Course
    track: Track | None
    ground: Ground
    stopped: bool

    def look(self, state: st.StateVector, signals: FloatArray, time: float, fall: str) -> View:
        """Return the view, and keep it for the next step.

        Args:
            state: minimal state; where the vehicle is stopped its rates are set to 0.
            signals: telemetry.
            time: s since the reset.
            fall: kind of fall reported by the plant, or NO_FALL.
        """
        ...


class PathScene:
    """A path, open or closed, without limits: the view relates to its line alone."""

    track: Track | None = None
    ground = flat_ground()
    stopped = False

    def __init__(self, plant: Plant, course: Course, preview: Preview, progress: float | None = None) -> None:
        """Begin an episode.

        Args:
            plant: what rides.
            course: the line.
            preview: which points of it are seen.
            progress: arc length of a start anywhere on the path, m; None at its beginning.
        """
        self.course = course
        self._plant, self._preview = plant, preview
        self._line = lk.columns(course)
        self._look = lk.blank_look()
        if progress is not None:
            self._look[lk.PROGRESS] = progress
        # The projection on an open course stops at its end.
        self._end = float(self._look[lk.PROGRESS]) + course.length if course.closed else course.length - 1e-9
        self._rear: tuple[float, float] | None = None
        self._events: PathEvents | None = None
        self._over = False

    def valid_laps(self) -> tuple[float, ...]:
        """Return no times: a path has no limits that a lap could be valid by."""
        return ()

    def blank_look(self) -> FloatArray:
        """Return a look that knows where the search for the nearest point begins, and nothing else."""
        return self._look.copy()

    def look(self, state: st.StateVector, signals: FloatArray, time: float, fall: str) -> View:
        """Return the view; see `Scene`."""
        course, preview, plant = self.course, self._preview, self._plant
        points = np.empty((2, preview.count))
        look = self._look.copy()
        rear = float(state[st.X]), float(state[st.Y])
        fresh = self._rear is None
        if self._rear is not None:
            self._catch_up(rear, self._rear, look)
        self._rear = rear
        if not plant.rolling:
            plant.move(signals, look)
        lk.look_at_path(
            state,
            plant.vehicle.parameters,
            plant.rolling,
            self._line,
            course.spacing,
            course.closed,
            preview.by_time,
            preview.interval,
            fresh,
            look,
            points[0],
            points[1],
        )
        self._look = look
        off_course, finished, events = self.judge(state, look, time, fall)
        return View(look, points[0], points[1], off_course, finished, fall, None, events)

    def judge(
        self, state: st.StateVector, look: FloatArray, time: float, fall: str
    ) -> tuple[bool, bool, tuple[Event, ...]]:
        """Return whether a look is off the course, whether the ride is finished, and what happened since the last one.

        Args:
            state: minimal state.
            look: of this instant.
            time: s since the reset.
            fall: kind of fall reported by the plant, or NO_FALL.
        """
        off_course = abs(float(look[lk.LATERAL_ERROR])) > self.course.off_course_limit
        events = self._happened(state, look, time, fall, off_course)
        return off_course, float(look[lk.PROGRESS]) >= self._end, events

    def to_card(self) -> dict[str, Any]:
        """Return what :meth:`judge` remembers as plain values."""
        return {"over": self._over, "events": None if self._events is None else self._events.to_card()}

    def restore(self, card: Mapping[str, Any]) -> None:
        """Go on where :meth:`to_card` was taken, in an episode that began with the same request."""
        self._over = bool(card["over"])
        if card["events"] is not None:
            self._events = PathEvents(self.course, 0.0, 0.0)
            self._events.restore(card["events"])

    def _happened(
        self, state: st.StateVector, look: FloatArray, time: float, fall: str, off_course: bool
    ) -> tuple[Event, ...]:
        progress, speed = float(look[lk.PROGRESS]), float(look[lk.SPEED])
        if self._events is None:
            self._events = PathEvents(self.course, time, progress)
            self._over = fall != NO_FALL
            return ()
        ended = []
        if fall != NO_FALL and not self._over:
            ended.append(fall_event(time, progress, float(state[st.ROLL]), "" if fall == TIPPED else fall, speed))
        self._over = fall != NO_FALL
        return tuple(self._events.look(time, progress, speed, float(look[lk.LATERAL_ERROR]), off_course, ended))

    def _catch_up(self, rear: tuple[float, float], before: tuple[float, float], look: FloatArray) -> None:
        """Search farther than the kernel does where the vehicle has moved farther, as in a long control period."""
        course = self.course
        reach = window(AHEAD, math.dist(rear, before), course.length)
        if reach > AHEAD:
            progress = look[lk.PROGRESS]
            s, _, _ = project(
                course.x, course.y, course.heading, course.spacing, course.closed, *rear, progress, reach, reach
            )
            look[lk.PROGRESS] = s
            look[lk.FRONT_PROGRESS] += s - progress
