"""Vector environments for Stable-Baselines3, sbx and Gymnasium: simulators one by one, and compiled batches."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.curricula.base import Episodes
from bike_training.envs.env import task_spaces
from bike_training.tasks.base import Task, batch_of, sum_of


class SimulatorVecEnv(DummyVecEnv):
    """Environments that have a simulator each, one after the other in this process."""

    def __init__(self, count: int, make: Callable[[int], gym.Env[Any, Any]]) -> None:
        """Make the environments by their number; where one cannot be made, those before it are closed."""
        with contextlib.ExitStack() as made:
            envs = []
            for row in range(count):
                envs.append(make(row))
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


class BatchVecEnv(VecEnv):
    """Episodes of a task over a :class:`~bike_sim.sim.batch.Batch`.

    An episode ends after ``task.max_steps`` steps or where the task says that it has failed. After a full episode the
    ride continues into the next one; after two full episodes in a row it starts again (Weyrer et al. 2026, Sect. 4.1).

    Attributes:
        task: to be learned.
        batch: of vehicles.
        rides: state of the task for the learners.
        rows: row of each learner in the batch, shape (n,).
        starts: number of rides that begin apart from each other.
    """

    def __init__(
        self,
        count: int,
        task: Task,
        episodes: Episodes,
        config: SimulatorConfig,
        seed: int,
        machines: Sequence[str] = (),
    ) -> None:
        """Make an environment of a number of vehicles.

        Args:
            count: number of vehicles.
            task: to be learned.
            episodes: distribution of new episodes; :meth:`set_episodes` changes it.
            config: vehicle, engine and steps.
            seed: seed of all rides.
            machines: names or files that the rows take in turn, where there are several; none for the config's.
        """
        self.render_mode = None
        VecEnv.__init__(self, count, *task_spaces(task))
        self.task = task
        self.episodes = episodes
        self.rng = np.random.default_rng(seed)
        self.steps = np.zeros(count, dtype=np.int64)
        self.full_episodes = np.zeros(count, dtype=np.int64)
        self.returns = np.zeros(count)
        self._requests: list[ResetRequest] = [ResetRequest()] * count
        self._actions = np.zeros((count, task.action.size), dtype=np.float32)
        self._open(config, machines)

    def _open(self, config: SimulatorConfig, machines: Sequence[str]) -> None:
        """Make the batch and the state of the task for its learners; `begin` starts each of its `starts`."""
        self.batch, self.rides = batch_of(self.task, self.num_envs, config, machines)
        self.rows, self.starts = np.arange(self.num_envs), self.num_envs

    def set_episodes(self, episodes: Episodes) -> None:
        """Draw new episodes from elsewhere from now on."""
        self.episodes = episodes

    def request(self) -> ResetRequest:
        """Return the request of the present ride of the first vehicle."""
        return self._requests[0]

    def state_dict(self) -> dict[str, Any] | None:
        """Return all that :meth:`restore` needs, as plain values and arrays; None where rides cannot be continued."""
        batch = self.batch.state_dict()
        if batch is None:
            return None
        return {
            "batch": batch,
            "rng": self.rng.bit_generator.state,
            "steps": self.steps.copy(),
            "full_episodes": self.full_episodes.copy(),
            "returns": self.returns.copy(),
            "requests": [request.to_card() for request in self._requests],
            "rides": self.rides.state_dict(),
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue with the episodes that :meth:`state_dict` was taken of, bit for bit.

        Raises:
            ValueError: episodes of another number of vehicles, or of rides that cannot be continued.
        """
        self.batch.restore(stored["batch"])
        self.rng = np.random.default_rng()
        self.rng.bit_generator.state = stored["rng"]
        for name in ("steps", "full_episodes", "returns"):
            getattr(self, name)[...] = stored[name]
        self._requests = [ResetRequest.from_card(card) for card in stored["requests"]]
        for row, request in enumerate(self._requests):
            self.rides.begin(row, self.batch, request, self.batch.course(row))
        self.rides.restore(stored["rides"])
        self._reset_seeds()

    def reset(self) -> NDArray[np.float32]:
        """Begin a new ride of every vehicle and return the observations, shape (n, layout size).

        After :meth:`seed` the draws start again with that seed.
        """
        if self._seeds[0] is not None:
            self.rng = np.random.default_rng(self._seeds[0])
        self._reset_seeds()
        for index in range(self.starts):
            self.begin(index)
        return self.rides.observe(self.batch)

    def begin(self, index: int) -> None:
        """Begin a new ride of a vehicle."""
        request = self.episodes.draw(self.rng, self.task.preview, index)
        self.batch.reset(index, request)
        self.rides.begin(index, self.batch, request, self.batch.course(index))
        self._requests[index] = request
        self.steps[index] = 0
        self.full_episodes[index] = 0
        self.returns[index] = 0.0

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the rides that begin with the next reset; all vehicles draw from one generator."""
        self._seeds = [seed] * self.num_envs
        return self._seeds

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions of the next step, shape (n, columns of the action)."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step every vehicle; rides that ended have started again in the returned observations."""
        self.rides.act(self.batch, self._actions)
        for _ in range(self.task.repeat):
            self.batch.step(self.commands())
            self.rides.advance(self.batch)
        self.steps += 1
        terms, failed = self.rides.evaluate(self.batch)
        rewards = sum_of(terms).astype(np.float32)
        self.returns += rewards
        observations = self.rides.observe(self.batch)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = self._ended(failed | (self.steps >= self.task.max_steps))
        for index in np.flatnonzero(ended):
            infos[index] = {
                "terminal_observation": observations[index].copy(),
                "TimeLimit.truncated": not failed[index],
                "episode": {"r": float(self.returns[index]), "l": int(self.steps[index]), "t": 0.0},
                "request": self._requests[index],
                "progress": float(self.batch.look[self.rows[index], lk.PROGRESS]),
            }
        if ended.any():
            self._go_on(ended, failed)
            observations = self.rides.observe(self.batch)
        return observations, rewards, ended, infos

    def commands(self) -> NDArray[np.float64]:
        """Return the commands of all vehicles of the batch in a control period."""
        return self.rides.commands(self.batch)

    def _ended(self, over: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return whose episodes end where those of some are over."""
        return over

    def _go_on(self, ended: NDArray[np.bool_], failed: NDArray[np.bool_]) -> None:
        """Continue full episodes that may go on, and begin the other ended ones."""
        for index in np.flatnonzero(ended).tolist():
            if not failed[index] and self.task.continues and self.full_episodes[index] == 0:
                self.full_episodes[index] = 1
                self.steps[index] = 0
                self.returns[index] = 0.0
            else:
                self.begin(index)

    def begin_again(self, over: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Begin the rides that are over, and those that end with them; return which."""
        ended = self._ended(over)
        self._go_on(ended, np.ones_like(ended))
        return np.flatnonzero(ended)

    def close(self) -> None:
        """Release the engines."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of this environment once for each vehicle."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute for all vehicles together."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method once for all vehicles together and return its result once for each vehicle."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None) -> list[bool]:
        """No vehicle is wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[None]:
        """There are no pictures."""
        return [None] * self.num_envs


class BatchVectorEnv(gym.vector.VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """Vector environment of Gymnasium over the compiled batch: one call steps all vehicles.

    An episode that ends has begun again in the returned observation; the last observation of the one before is in
    ``info["final_obs"]``.
    """

    metadata = {"render_modes": [], "autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, env: BatchVecEnv) -> None:
        """Take the environment of a batch, which is closed with this one."""
        self._env = env
        self.num_envs = env.num_envs
        self.single_observation_space, self.single_action_space = task_spaces(env.task)
        self.observation_space = gym.vector.utils.batch_space(self.single_observation_space, self.num_envs)
        self.action_space = gym.vector.utils.batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new ride of every vehicle.

        Args:
            seed: of this and all later draws.
            options: not used.
        """
        super().reset(seed=seed)
        if seed is not None:
            self._env.seed(seed)
        return self._env.reset(), {}

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold actions for one decision of every vehicle, shape (n, columns of the action)."""
        observations, rewards, ended, infos = self._env.step(np.asarray(actions, dtype=np.float32))
        truncated, found = np.zeros(self.num_envs, dtype=np.bool_), dict[str, Any]()
        if ended.any():
            truncated = np.array([bool(info.get("TimeLimit.truncated", False)) for info in infos])
            found["final_obs"] = np.array([info.get("terminal_observation") for info in infos], dtype=object)
            found["_final_obs"] = ended.copy()
        return observations, rewards, ended & ~truncated, truncated, found

    def close_extras(self, **kwargs: Any) -> None:
        """Release the engines."""
        self._env.close()
