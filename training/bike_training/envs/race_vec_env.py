"""Races side by side as a vector environment: learners among rivals, all machines in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import Rows
from bike_policy.riders.wheel_to_wheel import RaceField, unverified_plan
from bike_sim.sim import look as lk
from bike_sim.sim import traffic as tr
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.stewards import Stewards
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.curricula.rivals import RivalsCurriculum
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.tasks.base import StepResult
from bike_training.tasks.race import RaceContext, RaceState, RaceTask, places

FloatArray = NDArray[np.float64]


class Part(NamedTuple):
    """Learners on machines of one kind.

    Attributes:
        state: of their task.
        envs: their numbers, shape (k,).
        rows: of the batch, shape (k,).
    """

    state: RaceState
    envs: NDArray[np.intp]
    rows: NDArray[np.intp]

    def of(self, batch: Batch) -> Rows:
        """Return the rows of these learners."""
        return Rows(*(getattr(batch, name)[self.rows] for name in Rows._fields))


class LearnersState:
    """State of the task for the learners of all races; what happens between machines is noted by the stewards.

    Attributes:
        rows: row of each learner in the batch, shape (n,).
    """

    def __init__(self, task: RaceTask, batch: Batch, learners: int, machines: int) -> None:
        """Prepare the first rows of each race for learners.

        Args:
            task: of the learners.
            batch: of all races, one behind the other.
            learners: in a race.
            machines: in a race.
        """
        self._machines, self._learners = machines, learners
        races = batch.count // machines
        self.rows = np.array([race * machines + k for race in range(races) for k in range(learners)])
        names = [batch.vehicles[row].name for row in self.rows]
        self._parts: list[Part] = []
        for name in dict.fromkeys(names):
            envs = np.flatnonzero([other == name for other in names])
            vehicle = batch.vehicles[self.rows[envs[0]]]
            assert isinstance(vehicle, Superbike), "the task has refused others"
            state = task.make_state(len(envs), vehicle, lambda line, vehicle=vehicle: unverified_plan(vehicle, line))  # type: ignore[misc]
            self._parts.append(Part(state, envs, self.rows[envs]))
        self._period = batch.config.control_period
        self._stewards = [Stewards() for _ in range(races)]
        self._times = np.zeros(races)
        self._places = np.zeros(len(self.rows))
        self._met = np.zeros((2, len(self.rows)))

    def begin(self, env: int, batch: Batch, request: ResetRequest) -> None:
        """Begin the ride of a learner, after all machines of its race were reset."""
        row = self.rows[env]
        for part in self._parts:
            if env in part.envs:
                place = int(np.flatnonzero(part.envs == env)[0])
                part.state.begin(place, part.of(batch), request, batch.course(int(row)))
        race = env // self._learners
        self._stewards[race], self._times[race] = Stewards(), 0.0
        self._places[env] = self._standing(batch)[env]

    def _standing(self, batch: Batch) -> FloatArray:
        """Return the places of all learners, see `places`."""
        along = batch.place[:, lk.CENTRE_PROGRESS].reshape(-1, self._machines)
        ahead = along[:, : self._learners, None] - along[:, None, :]
        own = np.arange(self._learners)
        ahead[:, own, own] = np.nan
        return places(ahead.reshape(-1, self._machines))

    def each(self, batch: Batch) -> list[tuple[Part, Rows]]:
        """Return the learners on each kind of machine, and their rows."""
        return [(part, part.of(batch)) for part in self._parts]

    def observe(self, batch: Batch) -> NDArray[np.float32]:
        """Return the observations of all learners."""
        found: NDArray[np.float32] | None = None
        for part, rows in self.each(batch):
            seen = part.state.observe(rows)
            found = np.empty((len(self.rows), seen.shape[1]), dtype=np.float32) if found is None else found
            found[part.envs] = seen
        assert found is not None
        return found

    def act(self, batch: Batch, actions: NDArray[np.floating]) -> None:
        """Begin a decision."""
        self._met[:] = 0.0
        for part, rows in self.each(batch):
            part.state.act(rows, actions[part.envs])

    def commands(self, batch: Batch, commands: FloatArray) -> None:
        """Write the commands of the learners in a control period between those of the others."""
        for part, rows in self.each(batch):
            commands[part.rows] = np.nan_to_num(part.state.commands(rows))

    def advance(self, batch: Batch) -> None:
        """Add a control period."""
        for part, rows in self.each(batch):
            part.state.advance(rows)
        self._times += self._period
        for values in batch.incidents[batch.incidents[:, 0] == tr.CONTACT].tolist():
            incident = dict(zip(tr.INCIDENT.names, values, strict=True))
            race = int(incident["row"]) // self._machines
            stewards = self._stewards[race]
            known = len(stewards.penalties)
            if stewards.contact(float(self._times[race]), incident) or incident["thrown"] or incident["other_thrown"]:
                self._met[0] += np.isin(self.rows, (incident["row"], incident["other"]))
            for penalty in stewards.penalties[known:]:
                self._met[1] += self.rows == penalty.row

    def evaluate(self, batch: Batch) -> StepResult:
        """Return the outcome of the decision."""
        standing = self._standing(batch)
        gained, self._places = standing - self._places, standing
        terms: dict[str, FloatArray] = {}
        failed = np.zeros(len(self.rows), dtype=np.bool_)
        for part, rows in self.each(batch):
            contact, avoidable = self._met[:, part.envs]
            part.state.note(place=gained[part.envs], contact=contact, avoidable=avoidable)
            result = part.state.evaluate(rows)
            failed[part.envs] = result.failed
            for name, values in result.terms.items():
                terms.setdefault(name, np.zeros(len(self.rows)))[part.envs] = values
        return StepResult(terms, failed)


class RaceVecEnv(BatchVecEnv):
    """Episodes of learners in races with rivals; see `bike_training.curricula.rivals`.

    All learners of a race begin and end together: where one fails, the others' episodes are truncated.
    """

    rides: LearnersState  # type: ignore[assignment]

    def _open(self, config: SimulatorConfig, machines: Sequence[str]) -> None:
        """Make the batch of all races; machines are taken by the races in turn.

        Raises:
            ValueError: learners that do not fill their races.
        """
        assert isinstance(self.episodes, RivalsCurriculum)
        assert isinstance(self.task, RaceTask)
        settings, count, period = self.episodes.settings, self.num_envs, config.control_period
        if count % settings.learners:
            raise ValueError(
                f"setting learner.environments={count} must be a multiple of curriculum.learners={settings.learners}"
            )
        self._learners, self._size, self.starts = settings.learners, settings.machines, count // settings.learners
        names = list(machines) or [config.vehicle]
        groups = [race for race in range(self.starts) for _ in range(self._size)]
        vehicles = [load_vehicle(names[race % len(names)]) for race in groups]
        self.batch = Batch(len(groups), config, self.task.preview, vehicles=vehicles, together=groups)
        self.rides = LearnersState(self.task, self.batch, self._learners, self._size)
        self.rows = self.rides.rows
        riders: list[str] = []
        for race in range(self.starts):
            rivals = [settings.riders[(race + k) % len(settings.riders)] for k in range(settings.rivals)]
            riders += ["" for _ in range(self._learners)] + rivals
        self._field = RaceField(riders, vehicles, period, unverified_plan)
        self._step = 0

    def state_dict(self) -> dict[str, Any] | None:
        """Return that races are not taken up in their middle: a run that is resumed begins new ones."""
        return None

    def begin(self, index: int) -> None:
        """Begin a race."""
        assert isinstance(self.episodes, RivalsCurriculum)
        requests = self.episodes.draw_race(self.rng, self.task.preview, index)
        first = index * self._size
        for row, request in enumerate(requests, start=first):
            self.batch.reset(row, request)
        self.batch.meet(index)
        for row, request in enumerate(requests, start=first):
            self._field.begin(row, self.batch, self.batch.course(row))
            context = RaceContext.of(request)
            self._field.set_share(row, 1.0 if context is None else context.share)
        for k in range(self._learners):
            env = index * self._learners + k
            self.rides.begin(env, self.batch, requests[k])
            self._requests[env], self.steps[env], self.returns[env] = requests[k], 0, 0.0

    def commands(self) -> FloatArray:
        """Return those of rivals, and between them those of learners."""
        commands = self._field.commands(self.batch, self._step)
        self.rides.commands(self.batch, commands)
        self._step += 1
        return commands

    def _ended(self, over: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return all learners of the races in which one is over."""
        return np.repeat(over.reshape(-1, self._learners).any(axis=1), self._learners)

    def _go_on(self, ended: NDArray[np.bool_], failed: NDArray[np.bool_]) -> None:
        """Begin the races that have ended."""
        for race in np.flatnonzero(ended[:: self._learners]).tolist():
            self.begin(race)
