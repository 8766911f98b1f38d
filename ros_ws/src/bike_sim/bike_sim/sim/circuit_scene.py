"""The scene of a circuit: followed line, limits, grip in the run-off, walls, lap timing, course points.

A superbike stands on the road with its hills, banking, bumps and run-off; a bicycle, which rolls without slip, rides as
if it were level and smooth.
"""

from __future__ import annotations

from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.course import Course
from bike_sim.course.lap_timing import LapLog, Timing
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics.ground import Ground, flat_ground
from bike_sim.planning.envelope import Envelope
from bike_sim.planning.lap_limit import LapLimit, lap_limit
from bike_sim.sim import circuit_look as cl
from bike_sim.sim import look as lk
from bike_sim.sim.circuit_events import circuit_events
from bike_sim.sim.events import WallHit
from bike_sim.sim.ground import Road, road_of
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import Preview
from bike_sim.sim.scene import View
from bike_sim.sim.snapshot import CircuitView

FloatArray = NDArray[np.float64]

START_SPEED: Final = 35.0
"""Speed at which rides of a superbike begin by default, m/s."""
START_SHARE: Final = 0.8
"""The same as a fraction of the theoretical lap's speed there."""

_LEVEL: Final = flat_ground()


class FollowedLine:
    """A line of a circuit and its relation to the centre line.

    Attributes:
        track: the circuit. lam: which of its lines, 0 the median, 1 the ideal line. line: the line.
        to_centre: progress along the centre line at the samples of the line, never decreasing, m.
        stations: what stations at its samples show, see `look.stations`.
        rows: where a look writes what happened.
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
        limits = track.width_left, track.width_right, track.elevation, track.bank
        self.stations: FloatArray = lk.stations(
            self.line.table, self.line.spacing, self.to_centre, lk.columns(centre), centre.spacing, limits
        )
        # A step moves the search for the nearest point by a lap at most; one row more for the end of the ride.
        self.rows = np.empty((acc.rows_for(len(track.marks), 1.0) + 1, acc.ROW_SIZE))
        self._limit: LapLimit | None = None
        self._facts: dict[float, NDArray[np.void]] = {}

    @cached_property
    def road(self) -> Road:
        """The circuit as compiled code reads it."""
        return road_of(self.track)

    def facts(self, mass: float) -> NDArray[np.void]:
        """Return the record of `circuit_look.SCENE_CONSTANTS` for the line and a vehicle (mass in kg)."""
        if mass in self._facts:
            return self._facts[mass]
        track, line = self.track, self.line
        facts = self._facts[mass] = np.zeros(1, dtype=cl.SCENE_CONSTANTS)
        facts["spacing"], facts["length"] = track.centre.spacing, track.length
        facts["line_spacing"], facts["line_length"] = line.spacing, line.length
        facts["measured"], facts["mass"] = track.ideal is not None, mass
        return facts

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
    """One episode on a circuit; see `bike_sim.sim.scene.Scene`. The work is done by `bike_sim.sim.circuit_look`.

    Attributes:
        followed: the line that is followed.
        facts: what the kernel knows of circuit and vehicle, a record of `circuit_look.SCENE_CONSTANTS`, shape (1,).
        ride: what the ride remembers, a record of `circuit_look.RIDE`, shape (1,).
        log: finished laps.
        view: the last view as `circuit_look` lays it out.
        ground: under the wheels during the next control period. stopped: whether a wall holds the vehicle.
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
        self.facts = followed.facts(plant.vehicle.mass)
        self.ride = np.zeros(1, dtype=cl.RIDE)
        self.log = LapLog()
        self.ground = Ground(_LEVEL.record.copy(), followed.road.bumps)
        self.stopped = False

    def start(self, s: float, state: st.StateVector, anywhere: bool) -> None:
        """Set where the search for the nearest points begins, and lay the ground there.

        Args:
            s: arc length of the followed line, m.
            state: first state.
            anywhere: whether it may be anywhere on the circuit; else it is at `s`.
        """
        near, track = self._asked, self.track
        if anywhere:
            s = self.course.nearest(state[st.X], state[st.Y], state[st.YAW], s)
            near = track.centre.nearest(state[st.X], state[st.Y], state[st.YAW], self._asked)
        cl.begin_ride(
            state, float(self._plant.vehicle.w), self._asked, float(near), float(s), track.table, self.facts,
            *self.followed.road, self.ground.record, self.ride,
        )  # fmt: skip

    def timing(self) -> Timing:
        """Return laps, sectors and distances so far."""
        return self.log.timing(self.ride[0]["account"], self.track.ideal is not None)

    def look(self, state: st.StateVector, signals: FloatArray, time: float, fall: str) -> View:
        """Return the view; see `bike_sim.sim.scene.Scene`."""
        plant, track = self._plant, self.track
        view = self.view = np.empty(cl.VIEW_SIZE)
        if not plant.rolling:
            plant.move(signals, view)
        count, end, off_course, finished, self.stopped = cl.look_one(
            state, plant.vehicle.parameters, plant.rolling, cl.ENDS.index(fall), time, track.table,
            self.course.table, self.followed.stations, track.marks,
            self.facts, *self.followed.road, self.ground.record, self.ride, view, self.followed.rows,
        )  # fmt: skip
        if self.ride["touched"][0]:
            plant.deflect(float(state[st.X]), float(state[st.Y]), *self.ride["scrape"][0].tolist())
        look, points = view[: cl.PLACE], view[cl.POINTS :].reshape(3, lk.STATIONS, 3)
        preview_x, preview_y = self._see_line(state, look, points)
        return View(
            look=look,
            preview_x=preview_x,
            preview_y=preview_y,
            off_course=off_course,
            finished=finished,
            fall=cl.ENDS[end],
            circuit=CircuitView(view[cl.PLACE : cl.CIRCUIT], view[cl.CIRCUIT : cl.POINTS], points, self.wall),
            events=circuit_events(self.followed.rows[:count], self.log) if count > 0 else (),
        )

    def valid_laps(self) -> tuple[float, ...]:
        """Return the times of the valid laps finished so far, s."""
        return self.log.valid_laps()

    @property
    def wall(self) -> WallHit | None:
        """The touch of a wall in the last look, or the one that ended the ride, or None."""
        return WallHit(*self.ride["hit"][0].tolist()) if self.stopped or self.ride["touched"][0] else None

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
            lk.columns(self.course),
            self.course.spacing,
            True,
            preview.by_time,
            preview.interval,
            look,
            seen[0],
            seen[1],
        )
        return seen[0], seen[1]
