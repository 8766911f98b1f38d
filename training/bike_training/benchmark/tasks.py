"""The frozen tasks: what is ridden, where episodes begin, and how many decide the score.

A version never changes: a task that is to be different gets another one beside it. `tests/learning/test_benchmark.py`
holds the starts and a rollout of each by their digests.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, Final

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import VehicleRows
from bike_sim.course.random_courses import CURRICULUM_PATHS
from bike_sim.documents import alternatives, show
from bike_sim.physics import state as st
from bike_sim.schema import STATE
from bike_sim.sim import look as lk
from bike_sim.sim.batch import COMPILED_ENGINE
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.benchmark import kernels
from bike_training.curricula.base import Episodes
from bike_training.curricula.parts import RideRanges
from bike_training.curricula.race import CircuitSet, RaceCurriculum
from bike_training.envs.env import BikeEnv, config_of
from bike_training.gymnasium_ids import BENCHMARK_STEPS
from bike_training.tasks.base import StepResult, Task
from bike_training.tasks.path import DISTANCE_THRESHOLD, ROLL_THRESHOLD, PathState, PathTask
from bike_training.tasks.race import RaceTask

BICYCLE: Final = "whipple"
SUPERBIKE: Final = "panigale_v4r"
OBSERVATION_BOUND: Final = 20.0
"""Bound of each number of a bicycle's observation; those of a ride that has not failed stay below it."""
EPISODES: Final = 20
"""Episodes that decide a score, where a row says nothing else."""
WEIGHTS: Final = {"path_linear": 0.5, "path_peak": 0.5}
"""Of the terms of a bicycle's reward, which `kernels.evaluate` computes."""
SEED: Final = 2026
"""Of their starts."""


@dataclass(frozen=True, kw_only=True)
class BoundedPathTask(PathTask):
    """A path task with bounded observations, whose episodes are apart.

    Attributes:
        disturbances: see `Task`.
    """

    continues: ClassVar[bool] = False
    disturbances: tuple[str, ...] = ()

    @property
    def observation_high(self) -> NDArray[np.float32]:
        """Upper bounds of the observation."""
        return np.minimum(self.layout.high, np.float32(OBSERVATION_BOUND))

    def make_state(self, count: int, vehicle: Vehicle) -> PathState:
        """Return the state of the task for a number of bicycles."""
        return _BoundedState(self, count, vehicle.max_steer)


class _BoundedState(PathState):
    """State of a task whose observations are bounded; compiled, see `bike_training.benchmark.kernels`."""

    def __init__(self, task: BoundedPathTask, count: int, max_steer: float) -> None:
        """Prepare for a number of bicycles."""
        super().__init__(task, max_steer)
        layout = task.layout
        self._columns = np.array([STATE.index(name) for name in layout.terms[:-1]])
        self._step, self._gains = layout.preview_interval, layout.gains
        self._bounds = task.observation_high.astype(np.float64)
        self._sharpness = task.sharpness
        self._shape = count, layout.size

    def observe(self, rows: VehicleRows) -> NDArray[np.float32]:
        """Return the observations, those of a fall within the bounds as well."""
        seen = np.empty(self._shape, dtype=np.float32)
        kernels.observe(rows.state, rows.preview_xy[:, 1], self._columns, self._step, self._gains, self._bounds, seen)
        return seen

    def evaluate(self, rows: VehicleRows) -> StepResult:
        """Return the outcome of the decision."""
        count = self._shape[0]
        rewards, failed = np.empty((2, count)), np.empty(count, dtype=np.bool_)
        limits = DISTANCE_THRESHOLD, ROLL_THRESHOLD
        distance, roll = rows.look[:, lk.LATERAL_ERROR], rows.state[:, st.ROLL]
        kernels.evaluate(distance, roll, rows.fallen, limits, self._sharpness, rewards, failed)
        return StepResult(dict(zip(WEIGHTS, rewards, strict=True)), failed)


@dataclass(frozen=True, kw_only=True)
class BoundedRaceTask(RaceTask):
    """A race whose episodes are apart; its observations are bounded as they are."""

    continues: ClassVar[bool] = False


@dataclass(frozen=True)
class Starts:
    """Starts of a bicycle on a course: each number is drawn from its interval, to a side that is drawn.

    Attributes:
        course: that is ridden.
        speed: m/s.
        at: x and y of the start (m) and direction of the line there (rad).
        offset: from the line, m.
        yaw: to the line, rad.
        roll: rad.
        steer: rad.
        roll_rate: rad/s.
    """

    course: str
    speed: tuple[float, float]
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset: tuple[float, float] = (0.0, 0.0)
    yaw: tuple[float, float] = (0.0, 0.0)
    roll: tuple[float, float] = (0.0, 0.0)
    steer: tuple[float, float] = (0.0, 0.0)
    roll_rate: tuple[float, float] = (0.0, 0.0)

    def draw(self, rng: np.random.Generator, preview: Preview, row: int = 0) -> ResetRequest:
        """Draw a start; see `Episodes`."""
        speed = float(rng.uniform(*self.speed))
        intervals = np.array([self.offset, self.yaw, self.roll, self.steer, self.roll_rate])
        offset, yaw, *rest = rng.choice([-1.0, 1.0], 5) * rng.uniform(intervals[:, 0], intervals[:, 1])
        x, y, direction = self.at
        state = st.upright_state(speed, load_vehicle(BICYCLE).rF)
        state[st.X], state[st.Y] = x - offset * math.sin(direction), y + offset * math.cos(direction)
        state[st.YAW] = direction + yaw
        state[[st.ROLL, st.STEER, st.ROLL_RATE]] = rest
        start = tuple(state.tolist())
        return ResetRequest(course=self.course, speed_range=(speed, speed), initial_state=start, preview=preview)


@dataclass(frozen=True)
class Benchmark:
    """A frozen task.

    Attributes:
        summary: one line.
        vehicle: that is ridden.
        task: observation, action, reward, failure.
        episodes: returns where learning begins its episodes.
        judged: returns where those of the score begin.
        worlds: disturbances of these, taken in turn, in place of the task's.
        classical: rider that has score 0.
        classical_error: its error, as measured; the score's unit.
        count: episodes of the score.
    """

    summary: str
    vehicle: str
    task: Task
    episodes: Callable[[], Episodes]
    classical: str
    classical_error: float
    judged: Callable[[], Episodes] | None = None
    worlds: tuple[str, ...] = ()
    count: int = EPISODES

    @property
    def config(self) -> SimulatorConfig:
        """The compiled engine of the vehicle."""
        config = config_of(self.task, self.vehicle)
        if isinstance(self.task, RaceTask):
            return config
        return replace(config, engine=COMPILED_ENGINE, time_step=0.01)

    def judged_task(self) -> Task:
        """Return the task as the score's episodes ride it."""
        return replace(self.task, disturbances=self.worlds) if self.worlds else self.task  # type: ignore[type-var]

    def judged_requests(self) -> list[ResetRequest]:
        """Return the beginnings of the score's episodes, always the same."""
        episodes, rng = (self.judged or self.episodes)(), np.random.default_rng(SEED)
        return [episodes.draw(rng, self.task.preview, row) for row in range(self.count)]

    def score(self, error: float) -> float:
        """Return the score of an error: 0 that of the classical rider, 1 no error; below 0 where it is larger."""
        return 1.0 - error / self.classical_error


@lru_cache(8)
def _races(*circuits: str) -> Episodes:
    return RaceCurriculum(CircuitSet(load_vehicle(SUPERBIKE), circuits)).episodes(0)


def _path(steps: str, **settings: Any) -> BoundedPathTask:
    return BoundedPathTask(task="fine", weights=WEIGHTS, max_steps=BENCHMARK_STEPS[steps], **settings)


def _race(steps: str, **settings: Any) -> BoundedRaceTask:
    return BoundedRaceTask(max_steps=BENCHMARK_STEPS[steps], **settings)


_RANDOM_PATHS: Final = RideRanges((2.0, 7.0), CURRICULUM_PATHS[-1])
_LEARNED_CIRCUITS: Final = tuple(f"random_circuit:{seed}" for seed in range(4))
_JUDGED_CIRCUITS: Final = tuple(f"random_circuit:{seed}" for seed in range(1000, 1004))

BENCHMARKS: Final[Mapping[str, Benchmark]] = {
    "two_wheeler/Balance-v0": Benchmark(
        "a bicycle stays up on a straight, from any lean within 0.15 rad",
        BICYCLE,
        _path("two_wheeler/Balance-v0"),
        lambda: Starts("line", (2.0, 7.0), offset=(0.0, 0.5), yaw=(0.0, 0.1), roll=(0.0, 0.15), steer=(0.0, 0.1)),
        "lqr",
        0.019499,
    ),
    "two_wheeler/Path-v0": Benchmark(
        "a bicycle follows random paths at 2 to 7 m/s",
        BICYCLE,
        _path("two_wheeler/Path-v0"),
        lambda: _RANDOM_PATHS,
        "lqr",
        0.190650,
    ),
    "two_wheeler/Junction-v0": Benchmark(
        "a bicycle turns right by 90 degrees with a radius of 1 m, which none can follow",
        BICYCLE,
        _path("two_wheeler/Junction-v0"),
        lambda: Starts("junction", (3.0, 5.0), at=(0.0, -10.0, 0.5 * math.pi), offset=(0.0, 0.2), roll=(0.0, 0.05)),
        "lqr",
        1.971801,
    ),
    "two_wheeler/Pushes-v0": Benchmark(
        "a bicycle on a straight after a sideways push, which has left it a roll rate of 0.3 to 0.7 rad/s",
        BICYCLE,
        _path("two_wheeler/Pushes-v0"),
        lambda: Starts("line", (3.0, 7.0), roll=(0.0, 0.02), roll_rate=(0.3, 0.7)),
        "lqr",
        0.031281,
    ),
    "two_wheeler/LateCommands-v0": Benchmark(
        "a bicycle follows random paths with commands that act 100 ms late",
        BICYCLE,
        _path("two_wheeler/LateCommands-v0", disturbances=("delay_100",)),
        lambda: _RANDOM_PATHS,
        "lqr",
        2.107180,
    ),
    "two_wheeler/Lap-v0": Benchmark(
        "a superbike laps Barcelona from anywhere, for 120 s",
        SUPERBIKE,
        _race("two_wheeler/Lap-v0"),
        lambda: _races("barcelona"),
        "classical",
        0.054750,
    ),
    "two_wheeler/UnseenCircuits-v0": Benchmark(
        "a superbike laps circuits that learning has not seen",
        SUPERBIKE,
        _race("two_wheeler/UnseenCircuits-v0"),
        lambda: _races(*_LEARNED_CIRCUITS),
        "classical",
        0.056185,
        lambda: _races(*_JUDGED_CIRCUITS),
    ),
    "two_wheeler/UnknownWorlds-v0": Benchmark(
        "a superbike whose grip, mass, power, damper, road, wind and delay nobody tells laps Barcelona",
        SUPERBIKE,
        _race("two_wheeler/UnknownWorlds-v0", disturbances=("world:0-63",)),
        lambda: _races("barcelona"),
        "classical",
        0.467752,
        worlds=("world:1000-1019",),
    ),
}
"""The tasks by their ids in Gymnasium."""


def benchmark_of(name: str) -> Benchmark:
    """Return a frozen task by its id.

    Raises:
        ValueError: an unknown task or version.
    """
    if name not in BENCHMARKS:
        raise ValueError(f"unknown task or version {show(name)}; {alternatives(name, BENCHMARKS)}")
    return BENCHMARKS[name]


def make_env(name: str, render_mode: str | None = None) -> BikeEnv:
    """Return the environment of a frozen task; `gymnasium.make` calls this.

    Raises:
        ValueError: an unknown task, or way of rendering.
    """
    found = benchmark_of(name)
    return BikeEnv("local", found.task, found.episodes(), found.config, render_mode=render_mode)


def make_vector(name: str, num_envs: int = 1, seed: int = 0, **others: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
    """Return a frozen task in a number of rows of one compiled batch; `gymnasium.make_vec` calls this.

    Raises:
        ValueError: an unknown task, or an option that a batch does not have.
    """
    from bike_training.envs.vec_env import BatchVecEnv, BatchVectorEnv
    from bike_training.gymnasium_ids import check_options

    found = benchmark_of(name)
    check_options(others, found.task.max_steps)
    return BatchVectorEnv(BatchVecEnv(num_envs, found.task, found.episodes(), found.config, seed))
