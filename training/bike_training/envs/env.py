"""The Gymnasium environment of a task over a simulator client; it needs no learner."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import rows_of
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.sim.worlds import load_worlds
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.curricula.base import Episodes
from bike_training.curricula.parts import PartsCurriculum
from bike_training.curricula.race import CircuitSet, RaceCurriculum
from bike_training.envs.clients import Client, make_client
from bike_training.tasks.base import Task, TaskState, state_of, sum_of
from bike_training.tasks.path import TASKS
from bike_training.tasks.race import RaceTask

CIRCUITS: Final = ("barcelona",)
"""Circuits of races by default."""


def task_of(task: Task | str) -> Task:
    """Return a task: ``race``, or one of the names in :data:`bike_training.tasks.path.TASKS`.

    Raises:
        ValueError: an unknown name.
    """
    if not isinstance(task, str):
        return task
    if task != "race" and task not in TASKS:
        raise ValueError(f"unknown task {task!r}; there are race, {', '.join(TASKS)}")
    return RaceTask() if task == "race" else TASKS[task]


def config_of(task: Task, vehicle: str | None = None) -> SimulatorConfig:
    """Return the simulator of a task: of paths PyBullet at the paper's step of 5 ms, of races the compiled engine."""
    if isinstance(task, RaceTask):
        return replace(superbike_config(vehicle or "panigale_v4r"), engine=SUPERBIKE_ENGINE)
    config = SimulatorConfig(time_step=0.005)
    return config if vehicle is None else replace(config, vehicle=vehicle)


def episodes_of(task: Task, vehicle: Vehicle, circuits: tuple[str, ...] = CIRCUITS) -> Episodes:
    """Return where episodes begin: on paths as in the first part of the paper's curriculum, in races on circuits."""
    if isinstance(task, RaceTask):
        return RaceCurriculum(CircuitSet(vehicle, circuits)).episodes(0)
    return PartsCurriculum().episodes(0)


def task_spaces(task: Task) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Return the observation and action space of a task."""
    high = task.observation_high
    return gym.spaces.Box(-high, high, dtype=np.float32), gym.spaces.Box(
        -1.0, 1.0, (task.action.size,), dtype=np.float32
    )


class BikeEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One vehicle that rides a task: by default the bicycle on a random path.

    An episode is terminated when the task has failed (a threshold is exceeded, the vehicle lies on the
    ground, its physics diverges), and truncated after ``task.max_steps`` steps. After a truncated episode a plain
    ``reset()`` continues with the same ride once, as in the paper (Weyrer et al. 2026, Sect. 4.1); ``reset(seed=...)``
    and ``reset(options=...)`` always begin a new one.

    ``info`` holds distance to the path, progress, speed and simulated time; ``snapshot`` all that the simulator shows.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 (Gymnasium's own declaration)

    def __init__(
        self,
        client: Client | str = "local",
        task: Task | str = "prop",
        episodes: Episodes | None = None,
        config: SimulatorConfig | None = None,
        row: int = 0,
        vehicle: str | None = None,
        circuits: tuple[str, ...] = CIRCUITS,
        render_mode: str | None = None,
    ) -> None:
        """Make the environment.

        Args:
            client: a client, or ``local`` or ``ros`` to make one.
            task: a task or its name, see `task_of`.
            episodes: distribution of new episodes; those of `episodes_of` by default.
            config: of the client's simulator if it makes its own; that of `config_of` by default.
            row: its number among environments side by side, for `episodes`.
            vehicle: name or file, where neither a client nor a configuration is given.
            circuits: of races, where no episodes are given.
            render_mode: ``rgb_array``, or None.

        Raises:
            ValueError: the task is not for the vehicle, or an unknown way of rendering.
            FileNotFoundError: an unknown vehicle or circuit.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode must be rgb_array or None, got {render_mode!r}")
        self.task = task_of(task)
        self._worlds = load_worlds(self.task.disturbances)
        self._simulators: dict[int, tuple[Client, TaskState]] = {}
        if isinstance(client, str):
            config = config or config_of(self.task, vehicle)
            if self._worlds and client == "local":
                self._config, client = config, Simulator(config, self._worlds[0])
            else:
                client = make_client(client, config)
        self.client, self.render_mode = client, render_mode
        self.metadata = self.metadata | {"render_fps": 1.0 / (client.config.control_period * self.task.repeat)}
        self.episodes = episodes or episodes_of(self.task, client.vehicle, circuits)
        self._row = row
        self.observation_space, self.action_space = task_spaces(self.task)  # type: ignore[assignment]
        self._steps = 0
        self._full_episodes = 0
        self._goes_on = False
        self.rides = state_of(self.task, 1, [self.client.vehicle], self._worlds[:1])
        self._simulators[0] = self.client, self.rides
        self.snapshot: Snapshot | None = None
        self._request = ResetRequest()

    def request(self) -> ResetRequest:
        """Return the request of the present ride."""
        return self._request

    def set_episodes(self, episodes: Episodes) -> None:
        """Draw new episodes from elsewhere from now on."""
        self.episodes = episodes

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: seed of this and all later draws.
            options: ``{"request": ResetRequest(...)}`` requests a certain ride; its preview is replaced by the task's.
        """
        super().reset(seed=seed)
        goes_on = self._goes_on and seed is None and not options
        self._goes_on = False
        self._steps = 0
        if not goes_on:
            self._enter_world()
            request = (options or {}).get("request") or self.episodes.draw(self.np_random, self.task.preview, self._row)
            request = replace(request, preview=self.task.preview)
            self.snapshot = self.client.reset(request)
            assert self.client.course is not None
            self.rides.begin(0, rows_of(self.snapshot), request, self.client.course)
            self._request = request
            self._full_episodes = 0
        assert self.snapshot is not None
        return self.rides.observe(rows_of(self.snapshot))[0], self._info(self.snapshot)

    def _enter_world(self) -> None:
        """Ride in one of the task's worlds, where it has several."""
        if len(self._worlds) < 2:
            return
        chosen = int(self.np_random.integers(len(self._worlds)))
        if chosen not in self._simulators:
            client = Simulator(self._config, self._worlds[chosen])
            worlds = self._worlds[chosen : chosen + 1]
            state = state_of(self.task, 1, [client.vehicle], worlds)
            self._simulators[chosen] = client, state
        self.client, self.rides = self._simulators[chosen]

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold an action in [-1, 1], one number per column of the task's action, for one decision."""
        before = self.snapshot
        if before is None:
            raise RuntimeError("call reset before step")
        row = rows_of(before)
        self.rides.act(row, np.asarray(action)[None])
        snapshot = before
        for _ in range(self.task.repeat):
            if snapshot.fallen:
                break  # a node ends its ride with the fall
            snapshot = self.client.step(*self.rides.commands(row)[0].tolist())
            row = rows_of(snapshot)
            self.rides.advance(row)
        self.snapshot = snapshot
        self._steps += 1
        terms, failed = self.rides.evaluate(row)
        reward, terminated = float(sum_of(terms)[0]), bool(failed[0])
        truncated = not terminated and self._steps >= self.task.max_steps
        if truncated:
            self._full_episodes += 1
            self._goes_on = self.task.continues and self._full_episodes == 1
        info = self._info(snapshot)
        if terminated or truncated:
            info |= {"request": self._request, "progress": float(snapshot.look[lk.PROGRESS])}
        return self.rides.observe(row)[0], reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Return the vehicle on its course from behind, shape (height, width, 3); None without ``rgb_array``."""
        if self.render_mode is None:
            return None
        snapshot, course = self.snapshot, self.client.course
        if snapshot is None or course is None:
            raise RuntimeError("call reset before render")
        from bike_analysis.page.video import Pose, draw_frame  # late: only pictures pay for it

        x, y, yaw, roll = (float(snapshot.state[place]) for place in (st.X, st.Y, st.YAW, st.ROLL))
        pose = Pose(x, y, yaw, yaw, roll, snapshot.speed, float(snapshot.look[lk.PROGRESS]))
        superbike = isinstance(self.client.vehicle, Superbike)
        return np.asarray(draw_frame(course, self.client.vehicle.name, pose, snapshot.time, superbike))

    def close(self) -> None:
        """Release the simulators."""
        for client, _ in self._simulators.values():
            client.close()

    def _info(self, snapshot: Snapshot) -> dict[str, Any]:
        return {
            "distance_m": snapshot.distance,
            "progress_m": float(snapshot.look[lk.PROGRESS]),
            "speed_m_s": snapshot.speed,
            "time_s": snapshot.time,
        }
