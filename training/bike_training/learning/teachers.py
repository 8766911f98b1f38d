"""Teachers of imitation: classical riders that are told what the actor is not, for rows side by side.

On circuits a teacher that knew the grip would brake late before anybody can know it. So it rides by the least of what
is true and what the actor may believe so far: at first carefully, then by what has been inferred. On a patch of less
grip, which nobody can foresee, it leans at once no more than holds there. Half of the rides begin as if a lap had been
ridden.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import LATERAL_ERROR, PROGRESS, SPEED, Rows
from bike_policy.planning.grip import AdaptiveLaw, GripMemory
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS
from bike_policy.planning.racecraft import road_ahead
from bike_policy.riders.lqr import LqrRider, LqrSettings
from bike_sim.vehicles.superbike import Superbike
from bike_training.envs.race_vec_env import RaceVecEnv
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.tasks.base import BatchTaskState
from bike_training.tasks.path import PathTask
from bike_training.tasks.race import RaceState, RaceTask

FloatArray = NDArray[np.float64]

STARTING_CAUTION: Final = 2.8
"""Standard deviations beyond `SURE` by which the teacher rides on less than the inferred grip."""
SURE: Final = 0.035
"""Standard deviation of the inferred grip that asks for no caution."""
RIDDEN: Final = 0.5
"""Part of the rides whose grip is known by place, as after a lap."""
RIDDEN_ERROR: Final = 0.015
"""Standard deviation of what is known of it."""
LATERAL: Final = (16.0, 4.0, 1.0, 0.1)
"""Weights of the lateral error of the riders of paths: the first one rides nearest to the line. Far from it, with more
than 0.1, they lean beyond 45 degrees where a ride begins perturbed in a sharp bend from 5.5 m/s on, or after a push."""
ASIDE: Final = ((0.005, 0.02, 0.05, 0.055, 0.15), (0.005, 0.02, 0.05, 0.3, 0.8))
RIDERS: Final = (0.0, 1.0, 2.0, 2.0, 3.0)
"""Distances from the line, m, in two rows, and which rider rides there."""
HAIRPINS: Final = ((2.7, 3.2, 5.0, 5.6), (0.0, 1.0, 1.0, 0.0))
"""Speeds, m/s, and how much the second row counts there. Far from the line the third rider falls after pushes
when it is slower, and on rides that begin perturbed when it is faster; between, hairpins leave such distances."""
BENDS: Final = ((0.3, 0.6, 0.9, 1.2), (0.0, 1.0, 2.0, 2.4))
"""Tangents of the lean that the line ahead asks for, and the gentlest rider that it is ridden by: nearest to it, the
first one falls in hairpins."""
AHEAD: Final = 1.5
"""Time for which it looks ahead for them, s."""
LANE: Final = 1.5
"""Least distance from the line that is held as a lane, m."""
MERGE: Final = 1.5
"""Time before the turn-in at which it is left, s."""
NEAR: Final = 60.0
"""Distance along the circuit at which another is near, m."""


def gentleness(distance: float, speed: float, bends: float) -> float:
    """Return which of the riders of paths rides, between two of them a mean of both.

    Args:
        distance: from the line, m.
        speed: m/s.
        bends: largest tangent of the lean that the line ahead asks for.
    """
    hairpins = np.interp(speed, *HAIRPINS)
    distances = (1.0 - hairpins) * np.array(ASIDE[0]) + hairpins * np.array(ASIDE[1])
    return float(max(np.interp(distance, distances, RIDERS), np.interp(bends, *BENDS)))


class Teacher(ABC):
    """Says what it would do in each row of an environment.

    Attributes:
        noise: standard deviation of what is added to each action of half of the rows, so that the actor sees how to
            come back.
        noise_memory: part of the noise that the next decision keeps.
        weights: of the cost of an error of each action.
        small: the cost is the square of errors below it and in proportion to those above, so that few large ones do
            not hide many small ones; squares throughout where it is infinite.
        misleads: whether some actors see at times other than what is, see `imitation.Misled`.
        longest: decisions after which a ride begins anew.
    """

    noise: tuple[float, ...]
    noise_memory: float
    weights: tuple[float, ...]
    small: float = math.inf
    misleads: bool = False
    longest: float = math.inf

    @abstractmethod
    def begin(self, row: int, rng: np.random.Generator) -> None:
        """Begin a ride of a row, after it has begun in the environment.

        Args:
            row: of the ride.
            rng: of what differs from ride to ride.
        """

    @abstractmethod
    def actions(self) -> NDArray[np.float32]:
        """Return what it would do in each row at this control period, actions in [-1, 1], shape (n, actions)."""


def teacher_of(env: BatchVecEnv) -> Teacher:
    """Return the teacher of an environment.

    Raises:
        ValueError: a race with a guide, alone.
    """
    if isinstance(env, RaceVecEnv):
        return RivalsTeacher(env)
    return PathTeacher(env) if isinstance(env.task, PathTask) else CircuitTeacher(env)


class PathTeacher(Teacher):
    """Linear-quadratic riders, told path and bicycle: the gentler the farther from it, and the sharper it bends."""

    noise: tuple[float, ...] = (0.02,)
    noise_memory = 0.9
    weights: tuple[float, ...] = (1.0,)
    small = 0.01

    def __init__(self, env: BatchVecEnv) -> None:
        """Make the riders of each row; all rows take the same designs."""
        assert isinstance(env.task, PathTask), "its rides are on paths"
        self._batch, self._scale = env.batch, env.batch.vehicle.max_steer / env.task.max_steer
        self._riders = [[LqrRider(LqrSettings(lateral=each)) for each in LATERAL] for _ in range(env.batch.count)]
        for riders in self._riders:
            for rider, first in zip(riders, self._riders[0], strict=True):
                rider.designs = first.designs
        self._preview = env.task.preview
        self._ahead = round(AHEAD / env.batch.config.control_period)

    def begin(self, row: int, rng: np.random.Generator) -> None:
        """Begin a ride; see `Teacher`."""
        batch = self._batch
        for rider in self._riders[row]:
            rider.begin(batch.vehicle, batch.course(row), batch.config.control_period, self._preview)

    def actions(self) -> NDArray[np.float32]:
        """Return the answers; see `Teacher`."""
        found = np.zeros((self._batch.count, 1))
        for row, riders in enumerate(self._riders):
            look, state = self._batch.look[row], self._batch.state[row]
            if np.isfinite(look.sum() + state.sum()):
                bends = np.abs(riders[0].ahead(look, self._ahead)).max() * look[SPEED] ** 2 / self._batch.vehicle.g
                place = gentleness(abs(look[LATERAL_ERROR]), look[SPEED], bends)
                first = min(int(place), len(riders) - 2)
                near, gentle = (rider.steering(look, state) for rider in riders[first : first + 2])
                found[row] = near + (place - first) * (gentle - near)
        return np.clip(self._scale * found, -1.0, 1.0).astype(np.float32)


class RivalsTeacher(Teacher):
    """Holds the lane of its place on the grid where others go to the line, and goes there before it has to turn in.

    Where others are near it asks for the most pace; alone it laps as planned.
    """

    noise: tuple[float, ...] = (0.1, 0.1)
    noise_memory = 0.9
    weights: tuple[float, ...] = (4.0, 1.0)

    def __init__(self, env: RaceVecEnv) -> None:
        """Take the environment, whose learners lead guides."""
        assert isinstance(env.task, RaceTask), "its rides are races"
        self._env, self._task = env, env.task
        self.longest = env.task.max_steps

    def begin(self, row: int, rng: np.random.Generator) -> None:
        """Begin a ride; there is nothing to remember."""

    def actions(self) -> NDArray[np.float32]:
        """Return the answers; see `Teacher`."""
        found = np.zeros((self._env.num_envs, 2))
        for part, rows in self._env.rides.each(self._env.batch):
            interface = part.state.interface
            places, speeds = np.nan_to_num(rows.look[:, PROGRESS]), np.nan_to_num(rows.look[:, SPEED])
            for place, env in enumerate(part.envs.tolist()):
                lane = interface.offsets[place]
                turn_in = road_ahead(interface.law.plans, place, places[place], speeds[place]).turn_in
                held = lane if abs(lane) > LANE and turn_in > MERGE else 0.0
                near = np.any((rows.opponents[place, :, 0] > 0.0) & (np.abs(rows.opponents[place, :, 1]) < NEAR))
                found[env] = held / self._task.offset, float(near)
        return np.clip(found, -1.0, 1.0).astype(np.float32)


def told_grip(true: FloatArray, inferred: GripMemory | None) -> tuple[FloatArray, FloatArray]:
    """Return the grip that a teacher leans by, here, and that it plans for, here and shortly ahead, shape (n,) each.

    Args:
        true: grip of the road under each row, shape (n,).
        inferred: by the actors; None for actors that infer nothing.
    """
    grip = np.minimum(true, 1.0)
    if inferred is None:
        return grip, grip
    caution = STARTING_CAUTION * np.maximum(np.sqrt(inferred.variance) - SURE, 0.0)
    grip = np.minimum(np.minimum(grip, inferred.grip), inferred.expected)
    return grip, np.minimum(grip, inferred.grip - caution) - (inferred.expected - inferred.planned)


class CircuitTeacher(Teacher):
    """The classical rider, told grip and delays."""

    noise: tuple[float, ...] = (0.008, 0.06)
    noise_memory = 0.97
    weights: tuple[float, ...] = (10.0, 1.0)
    misleads = True

    def __init__(self, env: BatchVecEnv) -> None:
        """Make a law for each machine of the rows.

        Raises:
            ValueError: the task is no race without a guide.
        """
        task, batch = env.task, env.batch
        if not isinstance(task, RaceTask) or task.guided:
            raise ValueError("imitation is for races whose actions command lean and drive, without a guide")
        self._batch, self._scale = batch, np.array([task.lean_scale, 1.0])
        states = env.rides.parts if isinstance(env.rides, BatchTaskState) else (env.rides,)
        self._interfaces = [state.interface for state in states if isinstance(state, RaceState)]
        self._kinds = len(self._interfaces)
        self._laws: list[AdaptiveLaw] = []
        self._grips = [np.ones(2)] * batch.count
        self._delays: list[FloatArray] = []
        worlds, period = batch.disturbances, batch.config.control_period
        # A decision is held, so it acts later than one of a control period by half of the rest.
        held = 0.5 * (task.repeat - 1) * period
        for part in range(self._kinds):
            vehicle = batch.plant(part).vehicle
            assert isinstance(vehicle, Superbike), "races are ridden on superbikes"
            own = worlds[part :: self._kinds]
            self._delays.append(np.array([held + world.command_delay_s for world in own]))
            # Without the reflex of careful riders, which stands behind the actor: what the actor sees must decide.
            self._laws.append(AdaptiveLaw(vehicle, period, CLASSICAL_SETTINGS, len(own)))
            # It learns with what its teacher rides by, so that what it is shown follows from what it sees.
            self._interfaces[part].show(self._laws[part].plans)

    def begin(self, row: int, rng: np.random.Generator) -> None:
        """Begin a ride, which may know the grip as after a lap.

        Args:
            row: of the ride.
            rng: whether it does, and by how much it errs.
        """
        place, part = divmod(row, self._kinds)
        line, begun = self._batch.course(row), self._batch.begun(row)
        self._laws[part].begin(place, None, line)
        assert begun is not None, "its ride has begun"
        assert begun.followed is not None, "races are on circuits"
        road = self._batch.disturbances[row].road.surface(begun.followed.track.surface)
        self._grips[row] = road.grip(begun.followed.to_centre)
        inferred = self._interfaces[part].grip_memory
        known, error = rng.random() < RIDDEN, RIDDEN_ERROR * rng.standard_normal()
        if inferred is not None and known:
            inferred.begin(place, line, np.minimum(self._grips[row] + error, 1.0))

    def actions(self) -> NDArray[np.float32]:
        """Return what the teacher would do in each row at this control period, actions in [-1, 1], shape (n, 2)."""
        found = np.zeros((self._batch.count, 2))
        true = np.array([self._grip_of(row) for row in range(self._batch.count)])
        for part, law in enumerate(self._laws):
            rows = Rows(*(getattr(self._batch, name)[part :: self._kinds] for name in Rows._fields))
            interface = self._interfaces[part]
            share = interface.references.share
            pace = np.stack((np.zeros(len(share)), share - 1.0), axis=1)
            inferred = interface.grip_memory
            grip, planned = told_grip(true[part :: self._kinds], inferred)
            pushes = None if inferred is None else inferred.push
            found[part :: self._kinds] = law.follow(rows, grip, planned, pace, delays=self._delays[part], pushes=pushes)
        return np.clip(np.nan_to_num(found) / self._scale, -1.0, 1.0).astype(np.float32)

    def _grip_of(self, row: int) -> float:
        """Return the true grip under a row."""
        grip, line = self._grips[row], self._batch.course(row)
        progress = float(np.nan_to_num(self._batch.look[row, PROGRESS]))
        return float(grip[int(progress % line.length / line.spacing)])
