"""Vector environment of compiled bicycles for Stable-Baselines3 and sbx."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from bike_sim.physics.state import ROLL
from bike_sim.sim import look as ride
from bike_sim.sim.batch import RideBatch
from bike_sim.vehicles.files import load_vehicle
from bike_training.curricula.parts import RideRanges
from bike_training.envs.watch import RideWatch
from bike_training.tasks.path import Task, distances, failed


def task_spaces(task: Task) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Return the observation and action space of a task."""
    high = task.layout.high
    return gym.spaces.Box(-high, high, dtype=np.float32), gym.spaces.Box(-1.0, 1.0, (1,), dtype=np.float32)


class SimulatorVecEnv(DummyVecEnv):
    """Environments that have a simulator each, one after the other in this process."""

    def __init__(self, count: int, make: Callable[[], gym.Env[Any, Any]]) -> None:
        """Make the environments; where one cannot be made, those before it are closed."""
        with contextlib.ExitStack() as made:
            envs = []
            for _ in range(count):
                envs.append(make())
                made.callback(envs[-1].close)
            super().__init__([lambda env=env: env for env in envs])  # type: ignore[misc]
            self._open = made.pop_all()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the rides that begin with the next reset: each bicycle has draws that no other seed gives to any.

        DummyVecEnv counts upwards from the seed, so that neighbouring seeds would share rides.
        """
        children = np.random.SeedSequence(seed).spawn(self.num_envs)
        self._seeds = [int(child.generate_state(1, np.uint64)[0]) for child in children]
        return self._seeds

    def close(self) -> None:
        """Close all environments, also where closing one of them fails. A second call does nothing."""
        self._open.close()


class CompiledVecEnv(VecEnv):
    """The paper's environment over :class:`~bike_sim.sim.batch.RideBatch`.

    An episode ends after ``task.max_steps`` steps or when a threshold is exceeded or the bicycle lies on the ground.
    After a full episode the ride goes on into the next one; after two full episodes in a row it begins anew (Weyrer et
    al. 2026, Sect. 4.1).

    Attributes:
        watch: is told of the rides of the first bicycle; None for nobody.
    """

    watch: RideWatch | None = None

    def __init__(self, count: int, task: Task, ranges: RideRanges, seed: int, time_step: float = 0.01) -> None:
        """Make an environment of a number of bicycles.

        Args:
            count: number of bicycles.
            task: what is learned.
            ranges: intervals of new rides; :meth:`set_ranges` changes them.
            seed: seed of all rides.
            time_step: integration step, s.
        """
        self.render_mode = None
        super().__init__(count, *task_spaces(task))
        self.task = task
        self.ranges = ranges
        self.vehicle = load_vehicle("whipple")
        self.batch = RideBatch(count, self.vehicle, task.preview, self.vehicle.control_period, time_step)
        self.rng = np.random.default_rng(seed)
        self.steps = np.zeros(count, dtype=np.int64)
        self.full_episodes = np.zeros(count, dtype=np.int64)
        self.returns = np.zeros(count)
        self._chosen = 0.0
        self._actions = np.zeros(count)

    def set_ranges(self, ranges: RideRanges) -> None:
        """Draw new rides from other intervals from now on."""
        self.ranges = ranges

    def set_watch(self, watch: RideWatch | None) -> None:
        """Tell somebody of the rides of the first bicycle from now on, or nobody."""
        self.watch = watch

    def __getstate__(self) -> dict[str, Any]:
        """Leave the watch out of checkpoints."""
        return {name: value for name, value in self.__dict__.items() if name != "watch"}

    def reset(self) -> NDArray[np.float32]:
        """Begin a new ride of every bicycle and return the observations, shape (n, layout size).

        After :meth:`seed` the draws begin anew with that seed.
        """
        if self._seeds[0] is not None:
            self.rng = np.random.default_rng(self._seeds[0])
        self._reset_seeds()
        for index in range(self.num_envs):
            self._begin(index)
        return self._observe()

    def _begin(self, index: int) -> None:
        request = self.ranges.draw(self.rng, self.task.preview)
        self.batch.reset(index, request)
        if index == 0 and self.watch is not None:
            self.watch.begun(request)
        self.steps[index] = 0
        self.full_episodes[index] = 0
        self.returns[index] = 0.0

    def _observe(self) -> NDArray[np.float32]:
        return self.task.layout.observe(self.batch.states, self.batch.preview_y)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the rides that begin with the next reset; all bicycles draw from one generator."""
        self._seeds = [seed] * self.num_envs
        return self._seeds

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions of the next step, shape (n, 1)."""
        self._chosen = float(actions[0, 0])
        self._actions = self.task.action_scale.to_commands(actions[:, 0], self.vehicle.max_steer)

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step every bicycle; rides that ended have begun anew in the returned observations."""
        if self.watch is None:
            self.batch.step(self._actions)
        else:
            observation = self._observe()[0]
            self.batch.step(self._actions)
            self.watch.stepped(observation, self._chosen, float(self._actions[0]), self.batch.states[0].copy())
        self.steps += 1
        roll = self.batch.states[:, ROLL]
        rear = np.abs(self.batch.seen[:, ride.LATERAL_ERROR])
        rewards = self.task.rewards(distances(self.task, self.batch.seen), roll).astype(np.float32)
        self.returns += rewards
        terminated = failed(rear, roll, self.batch.lying)
        truncated = ~terminated & (self.steps >= self.task.max_steps)
        observations = self._observe()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = terminated | truncated
        for index in np.flatnonzero(ended):
            infos[index] = {
                "terminal_observation": observations[index].copy(),
                "TimeLimit.truncated": bool(truncated[index]),
                "episode": {"r": float(self.returns[index]), "l": int(self.steps[index]), "t": 0.0},
            }
            if truncated[index] and self.full_episodes[index] == 0:
                self.full_episodes[index] = 1
                self.steps[index] = 0
                self.returns[index] = 0.0
            else:
                self._begin(int(index))
        if ended.any():
            observations = self._observe()
        return observations, rewards, ended, infos

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of this environment once for each bicycle."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute for all bicycles together."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method once for all bicycles together and return its result once for each bicycle."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """No bicycle is wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[None]:
        """There are no pictures."""
        return [None] * self.num_envs
