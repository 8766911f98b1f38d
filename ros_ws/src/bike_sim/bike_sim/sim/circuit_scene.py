"""The scene of a circuit: followed line, limits, grip in the run-off, walls, lap timing, course points.

The ground is flat: the elevation of a circuit shows in the course points, not in the forces.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.lap_timing import LapTimer, Sample, Timing
from bike_sim.course.placing import EXACT, REACH
from bike_sim.course.projection import project, window
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics.ground import flat_ground
from bike_sim.sim import look as lk
from bike_sim.sim.events import CircuitEvents, Event, fall_event, wall_event
from bike_sim.sim.ground import Road, lay_ground, road_of
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import COURSE_POINTS, Preview
from bike_sim.sim.scene import View
from bike_sim.sim.snapshot import NO_FALL, WALL, CircuitView, WallHit
from bike_sim.theory.envelope import Envelope
from bike_sim.theory.lap_limit import LapLimit, lap_limit

FloatArray = NDArray[np.float64]

START_SPEED: Final = 35.0
"""Speed at which rides of a superbike begin by default, m/s."""
START_SHARE: Final = 0.8
"""The same as a fraction of the theoretical lap's speed there."""


class FollowedLine:
    """A line of a circuit and its relation to the centre line.

    Attributes:
        track: the circuit. lam: which of its lines, 0 the median, 1 the ideal line. line: the line.
        to_centre: progress along the centre line at the samples of the line, never decreasing, m.
    """

    def __init__(self, track: Track, lam: float) -> None:
        """Compute the line.

        Raises:
            ValueError: lambda outside 0 to 1.
        """
        self.track, self.lam, self.line = track, lam, track.line(lam)
        centre = track.centre
        along = lk.centre_progress(centre.x, centre.y, centre.heading, centre.spacing, self.line.x, self.line.y)
        self.to_centre: FloatArray = np.maximum.accumulate(along)
        self._limit: LapLimit | None = None

    @cached_property
    def road(self) -> Road:
        """The circuit as compiled code reads it."""
        return road_of(self.track)

    def limit(self, envelope: Envelope) -> LapLimit:
        """Return the theoretical lap of the machine that the line was computed for."""
        if self._limit is None:
            self._limit = lap_limit(envelope, self.line)
        return self._limit

    def place(self, progress: float) -> float:
        """Return the arc length of the line, m, at a progress along the centre line, m.

        Raises:
            ValueError: the progress is beyond the length of the circuit.
        """
        track = self.track
        if progress >= track.length:
            raise ValueError(f"progress {progress!r} m lies beyond circuit {track.name!r} of {track.length:.1f} m")
        return float(np.interp(progress, self.to_centre, self.line.s))


def start_speed(followed: FollowedLine, limits: Envelope, progress: float = 0.0) -> float:
    """Return a start speed for a position on a circuit, m/s: START_SPEED, or less in a bend.

    Args:
        followed: the line that is ridden.
        limits: the machine's.
        progress: along the centre line, m.

    Raises:
        ValueError: a position beyond the circuit.
    """
    at = followed.place(progress)
    return min(START_SPEED, START_SHARE * float(followed.limit(limits).speed_at(at)))


class CircuitScene:
    """One episode on a circuit; see `bike_sim.sim.scene.Scene`.

    Attributes:
        followed: the line that is followed.
    """

    def __init__(self, plant: Plant, followed: FollowedLine, preview: Preview | None, begin: float) -> None:
        """Take the surroundings; :meth:`start` begins.

        Args:
            plant: what rides.
            followed: the line.
            preview: which points of it are seen; None for the stations of the course points.
            begin: progress of the start along the centre line, m.
        """
        self.track: Track = followed.track
        self.followed = followed
        self.course: Course = followed.line
        self._plant, self._preview, self._asked = plant, preview, begin
        self._line, self._to_centre = lk.columns(followed.line), followed.to_centre
        self._centre = lk.columns(self.track.centre)
        self._limits = (self.track.width_left, self.track.width_right, self.track.elevation)
        self._road = followed.road
        self.ground = flat_ground()._replace(bumps=self._road.bumps)
        self._events = CircuitEvents(LapTimer(self.track))
        self._wall: WallHit | None = None
        self._over = False
        self._look, self._place = lk.blank_look(), np.zeros(lk.PLACE_SIZE)
        self._fresh = True
        self.stopped = False

    def start(self, s: float, state: st.StateVector, anywhere: bool) -> None:
        """Set where the search for the nearest points begins, and lay the ground there.

        Args:
            s: arc length of the followed line, m.
            state: first state.
            anywhere: whether it may be anywhere on the circuit; else it is at `s`.
        """
        wheelbase = self._plant.vehicle.w
        if anywhere:
            s = self.course.nearest(state[st.X], state[st.Y], state[st.YAW], s)
            self._place = self._look_up(state)
        else:
            self._place = np.array([self._asked, 0.0, self._asked + wheelbase, 0.0])
        self._look[lk.PROGRESS], self._look[lk.FRONT_PROGRESS] = s, s + wheelbase
        self._begin, self._rear = s, state[[st.X, st.Y]]
        x, y, yaw = (float(state[k]) for k in (st.X, st.Y, st.YAW))
        front = x + wheelbase * math.cos(yaw), y + wheelbase * math.sin(yaw)
        self._judge(state, front, 0.0)

    def _look_up(self, state: st.StateVector) -> FloatArray:
        """Return place of both contact points of a state that may lie anywhere, as if upright, m."""
        centre = self.track.centre
        x, y, yaw = (float(state[k]) for k in (st.X, st.Y, st.YAW))
        near = centre.nearest(x, y, yaw, self._asked)
        place: list[float] = []
        for ahead in (0.0, self._plant.vehicle.w):
            px, py, at = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), near + ahead
            place += project(centre.x, centre.y, centre.heading, centre.spacing, True, px, py, at, REACH, REACH)[:2]
        return np.array(place)

    def _judge(self, state: st.StateVector, front: tuple[float, float], time: float) -> int:
        """Lay the ground and keep the distance beyond the limits; return which contact point is at a wall, or -1."""
        x, y = float(state[st.X]), float(state[st.Y])
        rear, ahead, wall = lay_ground(x, y, *front, self._place, time, self._road, self.ground.record)
        self._outside = min(rear, ahead)
        return int(wall)

    def timing(self) -> Timing:
        """Return laps, sectors and distances so far."""
        return self._events.timer.timing()

    def look(self, state: st.StateVector, signals: FloatArray, time: float, fall: str) -> View:
        """Return the view; see `bike_sim.sim.scene.Scene`."""
        points = self._find(state, signals)
        look, place = self._look, self._place
        wall = self._judge(state, (float(look[lk.FRONT_X]), float(look[lk.FRONT_Y])), time)
        events = self._events.look(Sample(time, *place.tolist()), self._outside)
        if self.stopped:
            state[[st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]] = 0.0
        elif fall == NO_FALL and wall >= 0:
            self._hit(wall, state)
        fall = WALL if self._wall else fall
        if fall != NO_FALL and not self._over:
            self._over = True
            if time > 0.0:
                events.append(self._end(state, time, fall))
        preview_x, preview_y = self._see_line(state, look, points)
        return View(
            look=look,
            preview_x=preview_x,
            preview_y=preview_y,
            off_course=self._outside > 0.0,
            finished=bool(look[lk.PROGRESS] >= self._begin + self.course.length),
            fall=fall,
            circuit=CircuitView(place, self._outside, points, self._wall),
            events=tuple(events),
        )

    def _find(self, state: st.StateVector, signals: FloatArray) -> FloatArray:
        """Find the vehicle on the followed line and the centre line, and return the course points."""
        plant, track = self._plant, self.track
        look, place, points = self._look.copy(), self._place.copy(), np.empty((3, lk.STATIONS, 3))
        if not plant.rolling:
            plant.move(signals, look)
        rear = state[[st.X, st.Y]]
        lk.look_at_circuit(
            state,
            plant.vehicle.parameters,
            plant.rolling,
            self.stopped,
            self._line,
            self.course.spacing,
            self._to_centre,
            self._centre,
            track.centre.spacing,
            self._limits,
            COURSE_POINTS.interval,
            window(REACH, math.dist(rear, self._rear), track.centre.length),
            look,
            place,
            points,
        )
        if self._fresh and abs(place[lk.CENTRE_PROGRESS] - self._asked) < EXACT:
            place[lk.CENTRE_PROGRESS] = self._asked  # a start on the line is one
        self._fresh = False
        self._look, self._place, self._rear = look, place, rear
        return points

    def _see_line(self, state: st.StateVector, look: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the preview of the followed line."""
        preview = self._preview
        if preview is None:
            return points[lk.LINE, :, 0].copy(), points[lk.LINE, :, 1].copy()
        seen = np.empty((2, preview.count))
        lk.preview_line(
            state,
            self._plant.vehicle.parameters,
            self._plant.rolling,
            self._line,
            self.course.spacing,
            True,
            preview.by_time,
            preview.interval,
            look,
            seen[0],
            seen[1],
        )
        return seen[0], seen[1]

    def _hit(self, contact: int, state: st.StateVector) -> None:
        """Note the wall that a contact point has reached; it holds the vehicle from the next step on."""
        speed = float(self._look[lk.SPEED])
        heading = float(self.track.at(self.track.centre.heading, self._place[contact]))
        angle = abs(math.remainder(float(state[st.YAW]) - heading, math.pi))
        self._wall = WallHit(speed, angle, 0.5 * self._plant.vehicle.mass * speed**2)
        self.stopped = True

    def _end(self, state: st.StateVector, time: float, fall: str) -> Event:
        """Return the event of how the ride ended."""
        progress = float(self._place[lk.CENTRE_PROGRESS])
        if self._wall is not None:
            return wall_event(time, progress, self._wall)
        return fall_event(time, progress, float(state[st.ROLL]), fall, float(self._look[lk.SPEED]))
