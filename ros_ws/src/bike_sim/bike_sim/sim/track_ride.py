"""One superbike on one circuit, in control steps; the sibling of :class:`bike_sim.sim.simulator.Simulator`.

The ground is flat: the elevation of a circuit shows in the course points, not in the forces.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.lap_timing import LapTimer, Sample, Timing, TimingEvent
from bike_sim.course.placing import EXACT, REACH
from bike_sim.course.projection import curvature_at, point_at, project, window
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics import superbike_forces as sf
from bike_sim.physics.engine import make_engine
from bike_sim.physics.superbike_engine import TIME_STEP, SuperbikeEngine
from bike_sim.physics.superbike_statics import steady_lateral, turning_state
from bike_sim.sim import circuit_look as track_look
from bike_sim.sim import look as ride
from bike_sim.sim.request import IDEAL, Preview, ResetRequest
from bike_sim.sim.simulator import Simulator, SimulatorConfig, Snapshot
from bike_sim.theory.envelope import Envelope, envelope
from bike_sim.theory.lap_limit import lap_limit
from bike_sim.theory.line_cache import track_with_line
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

HORIZON: Final = 6.0
"""Time that the course points look ahead, s."""

PREVIEW: Final = Preview(by_time=True, interval=HORIZON / (track_look.STATIONS - 1), count=track_look.STATIONS)
"""Stations of the course points: the nearest point and then one each interval, at the present speed."""

OFF_TRACK_GRIP: Final = 0.6
"""Factor on friction outside the limits: between dusty asphalt and grass (estimate)."""

START_SPEED: Final = 35.0
"""Speed at which rides begin if nothing else is asked for, m/s."""
START_SHARE: Final = 0.8
"""The same as a part of what the theoretical lap has there."""

WALL: Final = "wall"


@dataclass(frozen=True)
class WallHit:
    """A machine that met a wall.

    Attributes:
        speed: m/s.
        angle: between way and wall, rad, 0 along it.
        energy: of the whole motion, J.
    """

    speed: float
    angle: float
    energy: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackSnapshot(Snapshot):
    """A control instant on a circuit. What `Snapshot` tells of a course relates to the followed line.

    Attributes:
        telemetry: in the order of `superbike_forces.TELEMETRY_NAMES`.
        place: progress and offset of the rear, then of the front contact point on the centre line, m.
        outside: how far the contact point that is less far out lies outside the limits, m; negative: on the track.
        points: the followed line and both limits ahead, x, y, z in base_link, m, shape (3, 20, 3).
        fall: why the ride is over, a name of `superbike_forces.FALL_NAMES` or ``"wall"``; ``"none"`` while it goes on.
        wall: the wall that was met, or None.
        timing: what the lap timing noticed since the snapshot before.
    """

    telemetry: FloatArray
    place: FloatArray
    outside: float
    points: FloatArray
    fall: str
    wall: WallHit | None
    timing: tuple[TimingEvent, ...]

    @property
    def speed(self) -> float:
        """Forward speed, m/s."""
        return float(self.seen[ride.SPEED])


def make_simulator(config: SimulatorConfig) -> Simulator | TrackRide:
    """Return what rides the vehicle: a bicycle on a course, or a superbike on a circuit.

    Raises:
        ValueError: a parameter that is wrong. FileNotFoundError: an unknown vehicle.
    """
    if isinstance(load_vehicle(config.vehicle), Superbike):
        return TrackRide(config)
    return Simulator(config)


def superbike_config(vehicle: str = "panigale_v4r", time_step: float = TIME_STEP) -> SimulatorConfig:
    """Return the settings with which a superbike rides: its own control period.

    Raises:
        ValueError: a vehicle file that is wrong. FileNotFoundError: an unknown vehicle.
    """
    return SimulatorConfig(vehicle=vehicle, time_step=time_step, control_period=load_vehicle(vehicle).control_period)


def start_speed(circuit: str | Path, limits: Envelope, lam: float = IDEAL, progress: float = 0.0) -> float:
    """Return a speed at which a ride may begin at a place of a circuit: START_SPEED, or less in a bend.

    Args:
        circuit: name or file.
        limits: the machine's.
        lam: line that is followed, 0 the median of the circuit, 1 the ideal line.
        progress: along the centre line, m.

    Raises:
        ValueError: a broken file, or a place beyond the circuit. FileNotFoundError: no such circuit.
    """
    track = track_with_line(circuit, limits)
    line = track.line(lam)
    limit = lap_limit(limits, line)
    at = start_place(track, line, along_centre(track, line), progress)
    return min(START_SPEED, START_SHARE * float(limit.speed_at(at)))


def along_centre(track: Track, line: Course) -> FloatArray:
    """Return the progress along the centre line at the samples of a line of the circuit, never decreasing, m."""
    centre = track.centre
    along = track_look.centre_progress(centre.x, centre.y, centre.heading, centre.spacing, line.x, line.y)
    return np.maximum.accumulate(along)


def start_place(track: Track, line: Course, along: FloatArray, progress: float) -> float:
    """Return where on a line a ride begins that is to begin at a progress along the centre line, m.

    Args:
        track: the circuit.
        line: one of its lines.
        along: from :func:`along_centre`.
        progress: m.

    Raises:
        ValueError: the progress lies beyond the circuit.
    """
    if progress >= track.length:
        raise ValueError(f"progress {progress!r} m lies beyond circuit {track.name!r} of {track.length:.1f} m")
    return float(np.interp(progress, along, line.s))


class TrackRide:
    """Rides one superbike in control steps.

    Deterministic: the same request and the same commands give the same snapshots, bit for bit.

    Attributes:
        config: steps. vehicle: the machine. engine: its engine. envelope: its limits.
        track: the circuit of the episode, or None before the first. course: the followed line.
    """

    def __init__(self, config: SimulatorConfig) -> None:
        """Load the machine and start the engine.

        Raises:
            ValueError: a parameter that is wrong, or a vehicle that is no superbike. FileNotFoundError: an unknown one.
        """
        self.config = config
        vehicle = load_vehicle(config.vehicle)
        if not isinstance(vehicle, Superbike):
            raise ValueError(f"vehicle '{config.vehicle}' is no superbike; circuits are for those")
        self.vehicle = vehicle
        self.envelope = envelope(vehicle)
        engine = make_engine(config.engine, vehicle, config.time_step)
        assert isinstance(engine, SuperbikeEngine)
        self.engine = engine
        self.request = ResetRequest()
        self.track: Track | None = None
        self.course: Course | None = None
        self.episode = 0
        self._tracks: dict[str, Track] = {}
        self._line: tuple[Track, float, Course, FloatArray] | None = None

    def reset(self, request: ResetRequest) -> TrackSnapshot:
        """Begin an episode on the followed line, in the steady turn that its curvature and the speed ask for.

        An initial state is looked for on the whole circuit, wherever it lies.

        Raises:
            ValueError: a request that cannot be met; the episode before stays as it was.
            FileNotFoundError: an unknown circuit.
        """
        track = self._track(request.course)
        line, to_centre = self._follow(track, request.line)
        s = start_place(track, line, to_centre, request.progress)
        if request.initial_state is None:
            state = self._first_state(request, line, s)
            place = np.array([request.progress, 0.0, request.progress + self.vehicle.w, 0.0])
        else:
            state = np.array(request.initial_state, dtype=np.float64)
            s = line.nearest(state[st.X], state[st.Y], state[st.YAW], s)
            place = self._look_up(track.centre, state, request.progress)
        self._set_grips(track, place)
        self.engine.reset(state)
        self.track, self.course, self.request = track, line, request
        self._to_centre = to_centre
        self._limits = (track.width_left, track.width_right, track.elevation)
        self._left_wall, self._right_wall = track.walls()
        self._seen = ride.blank_look()
        self._seen[ride.PROGRESS] = s
        self._seen[ride.FRONT_PROGRESS] = s + self.vehicle.w
        self._place, self._begin, self._rear = place, s, state[[st.X, st.Y]]
        self._timer = LapTimer(track)
        self._wall: WallHit | None = None
        self.episode += 1
        self._step = 0
        self._rolls: deque[float] = deque(maxlen=self.config.history)
        self._steers: deque[float] = deque(maxlen=self.config.history)
        return self._look(0.0, 0.0)

    def step(self, steering: float, throttle: float = 0.0) -> TrackSnapshot:
        """Hold both commands for one control period.

        Args:
            steering: in [-1, 1], positive to the left; 1 asks for the virtual rider's largest lean.
            throttle: in [-1, 1]; above 0 part of the engine's torque, below 0 part of the brakes' force.

        Raises:
            ValueError: a command that is not finite or out of range.
            RuntimeError: no episode was begun.
        """
        if self.course is None:
            raise RuntimeError("call reset before step")
        if not -1.0 <= steering <= 1.0 or not -1.0 <= throttle <= 1.0:
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        if self._wall is None:
            assert self.track is not None
            self._set_grips(self.track, self._place)
            self.engine.advance_commands(steering, throttle, self.config.substeps)
        self._step += 1
        return self._look(steering, throttle)

    def timing(self) -> Timing:
        """Return laps, sectors and distances so far."""
        return self._timer.timing()

    def close(self) -> None:
        """Release the engine."""
        self.engine.close()

    # ------------------------------------------------------------------------------------------------------- beginning

    def _track(self, circuit: str) -> Track:
        if circuit not in self._tracks:
            self._tracks[circuit] = track_with_line(circuit, self.envelope)
        return self._tracks[circuit]

    def _follow(self, track: Track, lam: float) -> tuple[Course, FloatArray]:
        """Return a line of the circuit and the progress along the centre line at its samples."""
        if self._line is None or self._line[:2] != (track, lam):
            line = track.line(lam)
            self._line = (track, lam, line, along_centre(track, line))
        return self._line[2:]

    def _first_state(self, request: ResetRequest, line: Course, s: float) -> st.StateVector:
        rng = np.random.default_rng(request.seed)
        speed = float(rng.uniform(*request.speed_range))
        x, y, along, across = point_at(line.x, line.y, line.heading, line.spacing, True, s)
        yaw = math.atan2(across, along)
        bend = curvature_at(line.curvature, line.spacing, True, s)
        roll = -math.copysign(self._lean(abs(bend) * speed**2, speed, s), bend)
        if request.perturb:
            roll += rng.uniform(-0.05, 0.05)
            yaw += rng.uniform(-0.02, 0.02)
        state = turning_state(self.vehicle, speed, roll, speed * bend)
        state[[st.X, st.Y, st.YAW]] = x, y, yaw
        return state

    def _look_up(self, centre: Course, state: st.StateVector, asked: float) -> FloatArray:
        """Return progress and offset of both contact points of a state that may lie anywhere, as if upright, m."""
        x, y, yaw = (float(state[k]) for k in (st.X, st.Y, st.YAW))
        near = centre.nearest(x, y, yaw, asked)
        place: list[float] = []
        for ahead in (0.0, self.vehicle.w):
            px, py, at = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), near + ahead
            place += project(centre.x, centre.y, centre.heading, centre.spacing, True, px, py, at, REACH, REACH)[:2]
        return np.array(place)

    def _lean(self, lateral: float, speed: float, s: float) -> float:
        """Return the lean at which a lateral acceleration is steady, rad."""
        low, high = 0.0, math.radians(self.vehicle.virtual_rider.max_lean_deg)
        if lateral > steady_lateral(self.vehicle, high, speed):
            raise ValueError(f"a start at {speed:.1f} m/s is too fast for the curve at {s:.0f} m of the followed line")
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if steady_lateral(self.vehicle, middle, speed) < lateral else (low, middle)
        return high if lateral > 0.0 else 0.0

    # --------------------------------------------------------------------------------------------------------- looking

    def _set_grips(self, track: Track, place: FloatArray) -> None:
        """Give the engine the factors on friction under both contact points."""
        self.engine.rear_grip, self.engine.front_grip = (
            OFF_TRACK_GRIP if track.outside(place[contact], place[contact + 1]) > 0.0 else 1.0
            for contact in (track_look.PROGRESS, track_look.FRONT_PROGRESS)
        )

    def _meet_wall(self, state: st.StateVector, telemetry: FloatArray) -> None:
        """Note the wall if a contact point has reached one."""
        track = self.track
        assert track is not None
        for contact in (track_look.PROGRESS, track_look.FRONT_PROGRESS):
            progress, offset = self._place[contact], self._place[contact + 1]
            left, right = track.at(self._left_wall, progress), track.at(self._right_wall, progress)
            if right < offset < left:
                continue
            speed = float(telemetry[sf.T_SPEED])
            heading = float(track.at(track.centre.heading, progress))
            angle = abs(math.remainder(float(state[st.YAW]) - heading, math.pi))
            self._wall = WallHit(speed, angle, 0.5 * self.vehicle.mass * speed**2)
            return

    def _place_on_lines(self, state: st.StateVector, telemetry: FloatArray) -> FloatArray:
        """Find the machine on the followed line and the centre line, and return the course points."""
        track, line = self.track, self.course
        assert track is not None
        assert line is not None
        centre = track.centre
        seen, place, points = self._seen.copy(), self._place.copy(), np.empty((3, track_look.STATIONS, 3))
        stopped = self._wall is not None
        rear = state[[st.X, st.Y]]
        track_look.look(
            state,
            0.0 if stopped else float(telemetry[sf.T_SPEED]),
            float(telemetry[sf.T_PITCH]),
            0.0 if stopped else float(telemetry[sf.T_YAW_RATE]),
            self.vehicle.parameters,
            track_look.columns(line),
            line.spacing,
            self._to_centre,
            (centre.x, centre.y, centre.heading),
            centre.spacing,
            self._limits,
            PREVIEW.interval,
            window(REACH, math.dist(rear, self._rear), centre.length),
            seen,
            place,
            points,
        )
        if self._step == 0 and abs(place[track_look.PROGRESS] - self.request.progress) < EXACT:
            place[track_look.PROGRESS] = self.request.progress  # a start on the line is one
        self._seen, self._place, self._rear = seen, place, rear
        return points

    def _look(self, steering: float, throttle: float) -> TrackSnapshot:
        track, line = self.track, self.course
        assert track is not None
        assert line is not None
        state, telemetry = self.engine.state(), self.engine.telemetry()
        points = self._place_on_lines(state, telemetry)
        seen, place = self._seen, self._place
        stopped = self._wall is not None
        time = self._step * self.config.control_period
        timing = tuple(self._timer.feed(Sample(time, *(float(value) for value in place))))
        if not stopped and self.engine.fall == sf.NO_FALL:
            self._meet_wall(state, telemetry)
        fall = WALL if self._wall else self.engine.fall_name
        if stopped:
            state[[st.ROLL_RATE, st.STEER_RATE, st.FRONT_WHEEL_RATE]] = 0.0
        self._rolls.append(float(state[st.ROLL]))
        self._steers.append(float(state[st.STEER]))
        outside = min(float(track.outside(place[k], place[k + 1])) for k in (0, 2))
        return TrackSnapshot(
            episode=self.episode,
            step=self._step,
            time=time,
            state=state,
            seen=seen,
            steering=steering,
            throttle=throttle,
            steer_torque=float(telemetry[sf.T_STEER_TORQUE]),
            preview_x=points[track_look.LINE, :, 0].copy(),
            preview_y=points[track_look.LINE, :, 1].copy(),
            roll_history=tuple(self._rolls),
            steer_history=tuple(self._steers),
            fallen=fall != "none",
            off_course=outside > 0.0,
            finished=bool(seen[ride.PROGRESS] >= self._begin + line.length),
            telemetry=telemetry,
            place=place,
            outside=outside,
            points=points,
            fall=fall,
            wall=self._wall,
            timing=timing,
        )
