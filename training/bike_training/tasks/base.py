"""What a task is, for environments and learners that do not depend on a vehicle, and tasks of several machines.

Rows take several machines in turn: a row rides the machine whose number is its own modulo the number of machines, in
training, in validations and in comparisons alike.
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import ObservationLayout, Rows, VehicleRows
from bike_policy.riders.instruments import Instruments
from bike_sim.course.course import Course
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.worlds import load_worlds
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.settings import Settings, check_choice, check_number, from_plain, to_plain

FloatArray = NDArray[np.float64]
ItemT = TypeVar("ItemT")


class StepResult(NamedTuple):
    """Outcome of a decision for each vehicle.

    Attributes:
        terms: weighted terms of the reward by name, shape (n,) each; their sum is the reward.
        failed: whose episode is terminated, shape (n,).
    """

    terms: dict[str, FloatArray]
    failed: NDArray[np.bool_]


class TaskState(ABC):
    """Observations, commands and rewards of a task for vehicles side by side, with the memory of their rides.

    A decision is: :meth:`observe`, :meth:`act`, control periods between :meth:`commands` and :meth:`advance`, then
    :meth:`evaluate`.
    """

    def begin(  # noqa: B027
        self, row: int, rows: VehicleRows, request: ResetRequest, course: Course, shown: VehicleRows | None = None
    ) -> None:
        """Begin the ride of one vehicle.

        Args:
            row: of the vehicle.
            rows: of all vehicles, after its reset.
            request: of the episode.
            course: the followed line.
            shown: what its rider is shown in place of them; None for these.
        """

    @abstractmethod
    def observe(self, rows: VehicleRows) -> NDArray[np.float32]:
        """Return the observations, shape (n, layout.size)."""

    @abstractmethod
    def act(self, rows: VehicleRows, actions: NDArray[np.floating]) -> None:
        """Take actions that are held from now on, shape (n, action.size)."""

    @abstractmethod
    def commands(self, rows: VehicleRows) -> FloatArray:
        """Return the commands of a control period: steering and throttle in [-1, 1], shape (n, 2)."""

    def advance(self, rows: VehicleRows) -> None:  # noqa: B027
        """Add the signals at the end of a control period."""

    @abstractmethod
    def evaluate(self, rows: VehicleRows) -> StepResult:
        """Return the outcome of the decision."""

    @abstractmethod
    def error(self, rows: VehicleRows) -> FloatArray:
        """Return the error of each vehicle at this instant, shape (n,); the task says what it is."""

    def state_dict(self) -> dict[str, Any]:
        """Return the memory, as plain values and arrays."""
        return {}

    def restore(self, stored: Mapping[str, Any]) -> None:  # noqa: B027
        """Go on from where :meth:`state_dict` was taken, after each row has begun again."""


class Task(Settings, ABC):
    """A learning problem: observation, action, reward, and failure of an episode; a frozen record of settings.

    Attributes:
        task: its name.
        weights: terms of the reward by name, with their weights.
        max_steps: steps after which an episode is truncated.
        repeat: control periods that a decision is held.
        disturbances: names or files of what disturbs the vehicles, of which rows take one in turn.
        continues: whether a ride continues once into the next episode where one was truncated (Weyrer et al. 2026).
        validation_duration: of a validation ride, s.
        error_name: definition of a ride's error, with its unit.
        largest_error: the error that a failed ride counts as; errors of validation rides are parts of it.
        layout: of the observation.
        action: layout of the action.
        preview: the preview that shows exactly what the layout needs.
    """

    place = "task"
    task: str
    weights: Mapping[str, float]
    max_steps: int
    repeat: int = 1
    disturbances: tuple[str, ...] = ()
    continues: ClassVar[bool] = True
    validation_duration: float
    error_name: str
    largest_error: float

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        load_worlds(self.disturbances)

    @property
    @abstractmethod
    def layout(self) -> ObservationLayout: ...  # noqa: D102
    @property
    def observation_high(self) -> NDArray[np.float32]:
        """Upper bounds of the observation; lower bounds are their negatives."""
        return self.layout.high

    @property
    @abstractmethod
    def action(self) -> ActionLayout: ...  # noqa: D102
    @property
    @abstractmethod
    def preview(self) -> Preview: ...  # noqa: D102

    def set_weights(self, default: Mapping[str, float], known: Collection[str], negative: bool = False) -> None:
        """Take the default weights where there are none, and check them.

        Args:
            default: weights of the terms by name.
            known: names of all terms.
            negative: whether weights may be less than 0.

        Raises:
            ValueError: naming the term and its weight.
        """
        if not isinstance(self.weights, Mapping):
            raise ValueError(f"setting weights={self.weights!r} must name reward terms and their weights")
        object.__setattr__(self, "weights", dict(self.weights or default))
        for name, weight in self.weights.items():
            check_choice("task.weights", name, known)
            check_number(f"task.weights.{name}", weight, -math.inf if negative else 0.0)

    @abstractmethod
    def make_state(self, count: int, vehicle: Vehicle) -> TaskState:
        """Return the state of the task for a number of vehicles.

        Raises:
            ValueError: the task is not for this vehicle.
        """

    @abstractmethod
    def check_vehicle(self, vehicle: Vehicle) -> None:
        """Refuse a vehicle that the task is not for.

        Raises:
            ValueError: naming vehicle and task.
        """

    def strict(self) -> Task:
        """Return the task as validations ride it."""
        return self

    @abstractmethod
    def validation_error(self, errors: FloatArray, succeeded: bool) -> float:
        """Return the error of one validation ride, as a part of :attr:`largest_error`.

        Args:
            errors: at each control period of the ride.
            succeeded: whether it did not fail.
        """

    @abstractmethod
    def selection_error(self, track: FloatArray, whole: NDArray[np.bool_]) -> float:
        """Return the figure by which actors are compared, less is better.

        Args:
            track: errors at each control period, shape (periods, rides).
            whole: which rides did not fail, shape (rides,).
        """

    def to_card(self) -> dict[str, Any]:
        """Return plain values for recordings, with the layout of the observation."""
        return {**to_plain(self), "layout": self.layout.to_card()}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> Self:
        """Read what :meth:`to_card` wrote.

        Raises:
            ValueError: an unknown or wrong entry.
        """
        return from_plain(cls, {name: value for name, value in card.items() if name != "layout"}, "task")


def sum_of(terms: Mapping[str, FloatArray]) -> FloatArray:
    """Return the reward that its terms make."""
    return functools.reduce(np.add, terms.values())


# ---------------------------------------------------------------------------------------------------- several machines


def round_robin(machines: Sequence[ItemT], count: int) -> list[ItemT]:
    """Return the machine of each of a number of rows."""
    return [machines[row % len(machines)] for row in range(count)]


def batch_of(task: Task, count: int, config: SimulatorConfig, machines: Sequence[str] = ()) -> tuple[Batch, TaskState]:
    """Return vehicles side by side, and the state of a task for them.

    Args:
        task: that they ride.
        count: number of rows.
        config: vehicle, engine and steps.
        machines: names or files that the rows take in turn, where there are several; none for the config's.

    Raises:
        ValueError: the task or the engine is not for them.
        FileNotFoundError: an unknown vehicle.
    """
    names = round_robin(machines, count) if len(machines) > 1 else None
    worlds = load_worlds(task.disturbances)
    # All machines ride in the first world, then all in the second; or each row in its own, where there are that many.
    each = max(len(machines), 1) if worlds and len(worlds) * len(machines) <= count else 1
    rows = [worlds[row // each % len(worlds)] for row in range(count)] if worlds else None
    batch = Batch(count, config, task.preview, rows, names)
    vehicles = [batch.vehicle] if names is None else [load_vehicle(name) for name in machines]
    return batch, state_of(task, count, vehicles[:count], rows or ())


def state_of(task: Task, count: int, vehicles: Sequence[Vehicle], worlds: Sequence[Disturbances]) -> TaskState:
    """Return the state of a task for a number of rows.

    Args:
        task: that they ride.
        count: number of rows.
        vehicles: that the rows take in turn.
        worlds: of each row, which may disturb what is seen and when commands act; none where nothing disturbs.

    Raises:
        ValueError: the task is not for a vehicle, or a delay that is not a whole number of periods.
    """
    if len(vehicles) == 1 and not any(world.acts_between for world in worlds):
        return task.make_state(count, vehicles[0])
    return BatchTaskState(task, vehicles, worlds or [Disturbances()] * count)


class BatchTaskState(TaskState):
    """State of a task for several machines in turn, with what lies between them and their riders; see `TaskState`.

    Riders see what their instruments show; rewards and failures are of what is.

    Attributes:
        parts: state of each machine's rows.
    """

    def __init__(self, task: Task, vehicles: Sequence[Vehicle], disturbances: Sequence[Disturbances]) -> None:
        """Prepare the rows of each machine, as many as there are disturbances.

        Raises:
            ValueError: the task is not for one of the machines, or instruments that it does not have.
        """
        count = self._count = len(disturbances)
        self._kinds = len(vehicles)
        self.parts = [
            task.make_state(len(range(first, count, len(vehicles))), vehicle) for first, vehicle in enumerate(vehicles)
        ]
        self._between = any(known.acts_between for known in disturbances)
        self._instruments = Instruments(disturbances, round_robin(vehicles, count), vehicles[0].control_period)

    def _each(self, rows: VehicleRows) -> Iterator[tuple[TaskState, Rows]]:
        """Return the state of each machine with its rows: views, so that what a batch does is seen."""
        for part, state in enumerate(self.parts):
            yield state, Rows(*(getattr(rows, name)[part :: self._kinds] for name in Rows._fields))

    def _together(self, parts: Iterable[NDArray[Any]]) -> NDArray[Any]:
        """Return the results of the parts, row by row."""
        found = list(parts)
        whole = np.empty((self._count, *found[0].shape[1:]), dtype=found[0].dtype)
        for part, result in enumerate(found):
            whole[part :: self._kinds] = result
        return whole

    def begin(
        self, row: int, rows: VehicleRows, request: ResetRequest, course: Course, shown: VehicleRows | None = None
    ) -> None:
        """Begin the ride of one machine, straight ahead until the first command acts."""
        place, part = divmod(row, self._kinds)
        seen = self._instruments.begin(row, rows)
        (state, own), (_, own_shown) = list(self._each(rows))[part], list(self._each(seen))[part]
        state.begin(place, own, request, course, own_shown)

    def observe(self, rows: VehicleRows) -> NDArray[np.float32]:
        """Return the observations."""
        return self._together(state.observe(own) for state, own in self._each(self._instruments.shown(rows)))

    def act(self, rows: VehicleRows, actions: NDArray[np.floating]) -> None:
        """Begin a decision."""
        for part, (state, own) in enumerate(self._each(self._instruments.shown(rows))):
            state.act(own, actions[part :: self._kinds])

    def commands(self, rows: VehicleRows) -> FloatArray:
        """Return the commands that act in a control period."""
        shown = self._instruments.shown(rows)
        return self._instruments.acting(self._together(state.commands(own) for state, own in self._each(shown)))

    def advance(self, rows: VehicleRows) -> None:
        """Add a control period."""
        for state, own in self._each(rows):
            state.advance(own)

    def evaluate(self, rows: VehicleRows) -> StepResult:
        """Return the outcome of the decision."""
        results = [state.evaluate(own) for state, own in self._each(rows)]
        terms = {name: self._together(result.terms[name] for result in results) for name in results[0].terms}
        return StepResult(terms, self._together(result.failed for result in results))

    def error(self, rows: VehicleRows) -> FloatArray:
        """Return the error of each machine at this instant."""
        return self._together(state.error(own) for state, own in self._each(rows))

    def state_dict(self) -> dict[str, Any]:
        """Return the memory."""
        each = {str(part): state.state_dict() for part, state in enumerate(self.parts)}
        state = each if self._kinds > 1 else each["0"]
        return {"instruments": self._instruments.state_dict(), "state": state} if self._between else state

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Continue from a stored memory."""
        if self._between:
            self._instruments.restore(stored["instruments"])
            stored = stored["state"]
        for part, state in enumerate(self.parts):
            state.restore(stored[str(part)] if self._kinds > 1 else stored)
