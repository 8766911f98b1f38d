"""Races for learners: a PettingZoo environment of all machines, and a Gymnasium one of a learner among fixed riders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from bike_policy.contract.observation import Rows
from bike_policy.riders.wheel_to_wheel import RaceField
from bike_sim.sim import look as lk
from bike_sim.sim.race import TOUCHED, Race, RaceSettings
from bike_sim.sim.request import ResetRequest
from bike_training.envs.env import task_spaces
from bike_training.tasks.base import sum_of
from bike_training.tasks.race import RACE_WEIGHTS, RaceState, RaceTask, places

Observation = NDArray[np.float32]

RACE_TASK: Final = RaceTask(
    observation="wheel_to_wheel", guided=True, repeat=10, offset=3.0, offset_rate=3.0, pace=0.08, max_steps=100_000,
    weights={**RACE_WEIGHTS, "place": 10.0, "contact": 5.0},
)  # fmt: skip
"""Task of each machine by default: line and pace of a guide, from what is seen of others; it lasts as long as the race.
"""


class RaceRides:
    """A race in which some machines are ridden by actions and the others by fixed riders.

    Attributes:
        race: the race.
        task: of the machines that are ridden by actions.
        rows: their rows by name.
    """

    def __init__(self, settings: RaceSettings, learners: Sequence[str], task: RaceTask = RACE_TASK) -> None:
        """Prepare machines, riders and plans.

        Args:
            settings: of the race; entries of learners need no rider.
            learners: names of the machines that are ridden by actions.
            task: their task.

        Raises:
            ValueError: a name that no machine has, a task that cannot see others, or what is no race.
        """
        names = [entry.name for entry in settings.entries]
        unknown = [name for name in learners if name not in names]
        if unknown or not learners:
            raise ValueError(f"no machine is called {unknown}; there are {', '.join(names)}")
        if not task.layout.sees_others:
            raise ValueError(f"observation {task.observation!r} cannot see others: it has no term 'opponents'")
        self.race, self.task = Race(settings), task
        self.rows = {name: names.index(name) for name in learners}
        batch = self.race.batch
        riders = ["" if entry.name in learners else entry.rider for entry in settings.entries]
        self._field = RaceField(riders, batch.vehicles, batch.config.control_period)
        self._states: dict[str, RaceState] = {
            name: task.make_state(1, batch.vehicles[row]) for name, row in self.rows.items()
        }

    def begin(self, order: Sequence[int] | None = None) -> dict[str, Observation]:
        """Begin the race with an order of the grid, see `Race.begin`; return what each learner sees."""
        race = self.race
        race.begin(order)
        for row in range(race.count):
            self._field.begin(row, race.batch, race.batch.course(row))
        for name, row in self.rows.items():
            request = race.batch.request(row) or ResetRequest()
            self._states[name].begin(0, self._row(row), request, race.batch.course(row))
        return self.observe()

    def observe(self) -> dict[str, Observation]:
        """Return what each learner sees."""
        return {name: self._states[name].observe(self._row(row))[0] for name, row in self.rows.items()}

    def step(self, actions: Mapping[str, NDArray[np.floating]]) -> tuple[dict[str, float], dict[str, bool]]:
        """Hold actions for a decision; return the rewards, and whose race has ended with a failure.

        Args:
            actions: of the learners that are still in the race; the others coast.
        """
        race = self.race
        before = self._standing()
        for name, action in actions.items():
            self._states[name].act(self._row(self.rows[name]), np.asarray(action, dtype=np.float64)[None])
        contacts = dict.fromkeys(self.rows, 0)
        for _ in range(self.task.repeat):
            commands = self._field.commands(race.batch, race.step_number)
            for name in actions:
                row = self.rows[name]
                commands[row] = np.nan_to_num(self._states[name].commands(self._row(row))[0])
            for event in race.step(commands):
                for name in event.names if event.kind == TOUCHED else ():
                    contacts[name] = contacts.get(name, 0) + 1
            for name in actions:
                self._states[name].advance(self._row(self.rows[name]))
            if race.over:
                break
        gained = self._standing() - before
        rewards, failed = {}, {}
        for name in actions:
            row = self.rows[name]
            self._states[name].note(place=gained[[row]], contact=np.array([contacts[name]]))
            terms, over = self._states[name].evaluate(self._row(row))
            rewards[name] = float(sum_of(terms)[0])
            failed[name] = bool(over[0]) or bool(race.batch.fallen[row])
        return rewards, failed

    def _standing(self) -> NDArray[np.float64]:
        """Return the places of all rows, see `places`."""
        along = self.race.batch.place[:, lk.CENTRE_PROGRESS]
        ahead = along[:, None] - along
        np.fill_diagonal(ahead, np.nan)
        return places(ahead)

    def riding(self, name: str) -> bool:
        """Return whether a learner's race goes on."""
        return bool(self.race.riding[self.rows[name]]) and not self.race.over

    def close(self) -> None:
        """Release the engines."""
        self.race.close()

    def _row(self, row: int) -> Rows:
        return Rows(*(getattr(self.race.batch, name)[row : row + 1] for name in Rows._fields))


class RaceParallelEnv(ParallelEnv[str, Observation, NDArray[np.float32]]):
    """A race in which every machine is an agent; the seed of a reset draws the order of the grid."""

    metadata = {"name": "two_wheeler_race_v0", "render_modes": [], "is_parallelizable": True}  # noqa: RUF012

    def __init__(self, settings: RaceSettings, task: RaceTask = RACE_TASK, max_steps: int = 10_000) -> None:
        """Make the environment.

        Args:
            settings: of the race.
            task: of each machine.
            max_steps: decisions after which a race is truncated.

        Raises:
            ValueError: see `RaceRides`.
        """
        self.possible_agents = [entry.name for entry in settings.entries]
        self.agents: list[str] = []
        self.rides, self._max_steps = RaceRides(settings, self.possible_agents, task), max_steps
        self._spaces = task_spaces(task)
        self._rng = np.random.default_rng()
        self._steps = 0

    def observation_space(self, agent: str) -> gym.spaces.Box:
        """Return the observation space of an agent; it is the same for all."""
        return self._spaces[0]

    def action_space(self, agent: str) -> gym.spaces.Box:
        """Return the action space of an agent."""
        return self._spaces[1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begin a race.

        Args:
            seed: of this and all later draws.
            options: ``{"grid": [...]}`` gives the order of the grid, rows from the first place on.
        """
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self.agents, self._steps = list(self.possible_agents), 0
        drawn = self._rng.permutation(len(self.agents))
        order = (options or {}).get("grid", drawn)
        return self.rides.begin(order), {name: {} for name in self.agents}

    def step(
        self, actions: dict[str, NDArray[np.float32]]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Hold the actions of all agents for one decision."""
        rewards, failed = self.rides.step(actions)
        self._steps += 1
        seen = self.rides.observe()
        out_of_time = self._steps >= self._max_steps
        terminated = {name: failed[name] or not self.rides.riding(name) for name in actions}
        truncated = {name: out_of_time and not terminated[name] for name in actions}
        places = {row: place for place, row in enumerate(self.rides.race.positions(), start=1)}
        infos: dict[str, dict[str, Any]] = {name: {"position": places[self.rides.rows[name]]} for name in actions}
        self.agents = [name for name in self.agents if not (terminated[name] or truncated[name])]
        return {name: seen[name] for name in actions}, rewards, terminated, truncated, infos

    def render(self) -> None:
        """There are no pictures."""

    def close(self) -> None:
        """Release the engines."""
        self.rides.close()


class RaceEnv(gym.Env[Observation, NDArray[np.float32]]):
    """One learner among riders of fixed kind; the seed of a reset draws the order of the grid."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, settings: RaceSettings, learner: str, task: RaceTask = RACE_TASK, last: bool = False) -> None:
        """Make the environment.

        Args:
            settings: of the race; the entry of the learner needs no rider.
            learner: name of its machine.
            task: of the learner.
            last: whether it begins on the last place of the grid, the others in a drawn order.

        Raises:
            ValueError: see `RaceRides`.
        """
        self.rides, self._name, self._last = RaceRides(settings, [learner], task), learner, last
        self.observation_space, self.action_space = task_spaces(task)  # type: ignore[assignment]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a race; ``options={"grid": [...]}`` gives the order of the grid."""
        super().reset(seed=seed)
        order = self.np_random.permutation(self.rides.race.count).tolist()
        if self._last:
            row = self.rides.rows[self._name]
            order = [*(other for other in order if other != row), row]
        seen = self.rides.begin((options or {}).get("grid", order))
        return seen[self._name], {}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold an action for one decision."""
        rewards, failed = self.rides.step({self._name: action})
        row = self.rides.rows[self._name]
        info = {"position": self.rides.race.positions().index(row) + 1}
        terminated = failed[self._name] or not self.rides.riding(self._name)
        return self.rides.observe()[self._name], rewards[self._name], terminated, False, info

    def close(self) -> None:
        """Release the engines."""
        self.rides.close()
