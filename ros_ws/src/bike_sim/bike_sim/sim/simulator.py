"""One vehicle on one course, in control steps. The node, the training and the evaluation all ride through this."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.projection import AHEAD, project, window
from bike_sim.physics import state as st
from bike_sim.physics.engine import make_engine
from bike_sim.sim import look as ride
from bike_sim.sim.request import RANDOM_COURSE, ResetRequest, begin
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class SimulatorConfig:
    """What stays the same over all episodes of a simulator.

    Attributes:
        vehicle: name of a shipped vehicle or path of a YAML file.
        engine: ``"pybullet"`` or ``"whipple"``.
        time_step: integration step, s; the control period must be a whole number of them.
        control_period: time between two commands, s (h of Weyrer et al. 2026, Sect. 3.1).
        history: number of roll and steer angles kept.
    """

    vehicle: str = "whipple"
    engine: str = "pybullet"
    time_step: float = 0.001
    control_period: float = 0.05
    history: int = 10

    def __post_init__(self) -> None:
        """Refuse steps that do not fit into each other.

        Raises:
            ValueError: naming the value.
        """
        for name in ("time_step", "control_period"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise ValueError(f"{name} must be positive and finite, got {value!r} s")
        steps = self.control_period / self.time_step
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6:
            raise ValueError(
                f"control period {self.control_period} s is not a whole number of time steps of {self.time_step} s"
            )
        if self.history < 1:
            raise ValueError(f"history must be at least 1, got {self.history}")

    @property
    def substeps(self) -> int:
        """Integration steps in a control period."""
        return round(self.control_period / self.time_step)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything seen at one control instant. Units, frames and signs are those of ``bike_msgs/BikeState``.

    Attributes:
        episode: number of the reset, from 1.
        step: control steps since the reset.
        time: s since the reset.
        state: the ten minimal coordinates.
        seen: derived quantities in the order of :mod:`bike_sim.sim.look`.
        steering: applied steering command in [-1, 1]. throttle: the same for throttle and brake.
        steer_torque: torque of the steering drive, Nm, positive to the left.
        preview_x: m, base_link. preview_y: m, base_link.
        roll_history: rad, oldest first. steer_history: rad, oldest first.
        fallen: roll beyond the vehicle's limit, or lying. off_course: distance beyond the course's limit.
        finished: the end of an open course is reached, or a closed course was ridden once, from where the ride began.
    """

    episode: int
    step: int
    time: float
    state: FloatArray
    seen: FloatArray
    steering: float
    throttle: float
    steer_torque: float
    preview_x: FloatArray
    preview_y: FloatArray
    roll_history: tuple[float, ...]
    steer_history: tuple[float, ...]
    fallen: bool
    off_course: bool
    finished: bool

    @property
    def distance(self) -> float:
        """Distance of the rear contact to the course t_0 = d(P, P_P0), m."""
        return abs(float(self.seen[ride.LATERAL_ERROR]))

    @property
    def front_distance(self) -> float:
        """Distance of the front contact to the course d(Q, P_Q0), m."""
        return abs(float(self.seen[ride.FRONT_LATERAL_ERROR]))


class Simulator:
    """Rides one vehicle in control steps.

    A simulator is deterministic: the same request and the same commands give the same snapshots, bit for bit.
    """

    def __init__(self, config: SimulatorConfig | None = None) -> None:
        """Load the vehicle and start the engine.

        Raises:
            ValueError: a parameter that is wrong. FileNotFoundError: an unknown vehicle.
        """
        self.config = config or SimulatorConfig()
        self.vehicle: Vehicle = load_vehicle(self.config.vehicle)
        self.engine = make_engine(self.config.engine, self.vehicle, self.config.time_step)
        self.request = ResetRequest()
        self.course: Course | None = None
        self.episode = 0
        self._loaded: tuple[str, Course] | None = None

    def reset(self, request: ResetRequest) -> Snapshot:
        """Begin an episode.

        Raises:
            ValueError: a request that cannot be met; the episode before stays as it was.
            FileNotFoundError: an unknown course.
        """
        cached = self._loaded[1] if self._loaded and self._loaded[0] == request.course else None
        course, state = begin(request, self.vehicle, cached)
        if request.course != RANDOM_COURSE:
            self._loaded = (request.course, course)
        self.engine.reset(state)
        self.course = course
        self.request = request
        self.episode += 1
        self._step = 0
        self._seen = ride.blank_look()
        if request.initial_state is not None:
            self._seen[ride.PROGRESS] = course.nearest(*(float(state[k]) for k in (st.X, st.Y, st.YAW)))
        # The projection on an open course stops at its end.
        self._end = float(self._seen[ride.PROGRESS]) + course.length if course.closed else course.length - 1e-9
        self._rolls: deque[float] = deque(maxlen=self.config.history)
        self._steers: deque[float] = deque(maxlen=self.config.history)
        return self._look(0.0, 0.0, fresh=True)

    def step(self, steering: float, throttle: float = 0.0) -> Snapshot:
        """Hold a command for one control period.

        Args:
            steering: in [-1, 1], positive to the left; 1 is the vehicle's largest steering set value.
            throttle: in [-1, 1]; the bicycle has no drive and ignores it.

        Raises:
            ValueError: a command that is not finite or out of range.
            RuntimeError: no episode was begun.
        """
        if self.course is None:
            raise RuntimeError("call reset before step")
        if not -1.0 <= steering <= 1.0 or not -1.0 <= throttle <= 1.0:
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        self.engine.advance(steering * self.vehicle.max_steer, self.config.substeps)
        self._step += 1
        return self._look(steering, throttle, fresh=False)

    def close(self) -> None:
        """Release the engine."""
        self.engine.close()

    def _drive_torque(self, steering: float, state: FloatArray) -> float:
        """Return the torque of the steering drive on the fork, Nm (Weyrer et al. 2026, Eq. 2)."""
        error = float(state[st.STEER]) - steering * self.vehicle.max_steer
        return -self.vehicle.P * error - self.vehicle.D * float(state[st.STEER_RATE])

    def _catch_up(self, course: Course, rear: tuple[float, float], seen: FloatArray) -> None:
        """Search farther than `ride.look` does where the bicycle has moved farther, as in a long control period."""
        reach = window(AHEAD, math.dist(rear, self._rear), course.length)
        if reach > AHEAD:
            before = seen[ride.PROGRESS]
            s, _, _ = project(
                course.x, course.y, course.heading, course.spacing, course.closed, *rear, before, reach, reach
            )
            seen[ride.PROGRESS] = s
            seen[ride.FRONT_PROGRESS] += s - before

    def _look(self, steering: float, throttle: float, fresh: bool) -> Snapshot:
        course = self.course
        assert course is not None
        state = self.engine.state()
        preview = self.request.preview
        points = np.empty((2, preview.count))
        seen = self._seen.copy()
        rear = float(state[st.X]), float(state[st.Y])
        if not fresh:
            self._catch_up(course, rear, seen)
        self._rear = rear
        ride.look(
            state,
            self.vehicle.parameters,
            course.x,
            course.y,
            course.heading,
            course.curvature,
            course.spacing,
            course.closed,
            preview.by_time,
            preview.interval,
            fresh,
            seen,
            points[0],
            points[1],
        )
        self._seen = seen
        roll, steer = float(state[st.ROLL]), float(state[st.STEER])
        self._rolls.append(roll)
        self._steers.append(steer)
        progress = seen[ride.PROGRESS]
        # The compiled engine lies, and stays as it is, before its roll could reach a limit beyond its own.
        lying = getattr(self.engine, "lying", False)
        return Snapshot(
            episode=self.episode,
            step=self._step,
            time=self._step * self.config.control_period,
            state=state,
            seen=seen,
            steering=steering,
            throttle=throttle,
            steer_torque=self._drive_torque(steering, state),
            preview_x=points[0],
            preview_y=points[1],
            roll_history=tuple(self._rolls),
            steer_history=tuple(self._steers),
            fallen=bool(lying or abs(roll) > self.vehicle.fall_roll),
            off_course=bool(abs(seen[ride.LATERAL_ERROR]) > course.off_course_limit),
            finished=bool(progress >= self._end),
        )
