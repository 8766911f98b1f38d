"""Several machines side by side: rows take them in turn, and each machine's rows are shown and judged together.

A row rides the machine whose number is its own by the number of machines, in training, in validations and in
comparisons alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.rows import Row, RowBlocks
from bike_sim.course.course import Course
from bike_sim.sim.batch import Batch, make_batch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.tasks.base import FloatArray, StepResult, Task, TaskState

ItemT = TypeVar("ItemT")


def round_robin(machines: Sequence[ItemT], count: int) -> list[ItemT]:
    """Return the machine of each of a number of rows."""
    return [machines[row % len(machines)] for row in range(count)]


def batch_of(task: Task, count: int, config: SimulatorConfig, machines: Sequence[str] = ()) -> tuple[Batch, TaskState]:
    """Return vehicles side by side, and what a task shows and judges of them.

    Args:
        task: that they ride.
        count: number of rows.
        config: vehicle, engine and steps.
        machines: names or files that the rows take in turn, where there are several; none for the config's.

    Raises:
        ValueError: the task or the engine is not for them. FileNotFoundError: an unknown vehicle.
    """
    names = round_robin(machines, count) if len(machines) > 1 else None
    batch = make_batch(count, config, task.preview, vehicles=names)
    vehicles = [batch.vehicle] if names is None else [load_vehicle(name) for name in machines]
    return batch, rides_of(task, vehicles, count)


def rides_of(task: Task, vehicles: Sequence[Vehicle], count: int) -> TaskState:
    """Return what a task shows and judges of rows that take machines in turn.

    Raises:
        ValueError: the task is not for one of the machines.
    """
    if len(vehicles) == 1:
        return task.rides(count, vehicles[0])
    return MultiVehicleTaskState(task, vehicles[:count], count)


class MultiVehicleTaskState:
    """TaskState of several machines in turn; implements `bike_training.tasks.base.TaskState`."""

    def __init__(self, task: Task, vehicles: Sequence[Vehicle], count: int) -> None:
        """Prepare the rows of each machine.

        Raises:
            ValueError: the task is not for one of the machines.
        """
        self._count, self._kinds = count, len(vehicles)
        self._parts = [
            task.rides(len(range(first, count, len(vehicles))), vehicle) for first, vehicle in enumerate(vehicles)
        ]

    def _of(self, blocks: RowBlocks, part: int) -> Row:
        """Return the rows of a machine; views, so that what a batch does is seen."""
        return Row(*(getattr(blocks, name)[part :: self._kinds] for name in Row._fields))

    def _together(self, parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """Return what the parts found, row by row."""
        whole = np.empty((self._count, *parts[0].shape[1:]), dtype=parts[0].dtype)
        for part, found in enumerate(parts):
            whole[part :: self._kinds] = found
        return whole

    def begin(self, row: int, blocks: RowBlocks, request: ResetRequest, course: Course) -> None:
        """Begin the ride of one machine; see `TaskState`."""
        place, part = divmod(row, self._kinds)
        self._parts[part].begin(place, self._of(blocks, part), request, course)

    def observe(self, blocks: RowBlocks) -> NDArray[np.float32]:
        """Return the observations; see `TaskState`."""
        return self._together([rides.observe(self._of(blocks, part)) for part, rides in enumerate(self._parts)])

    def act(self, blocks: RowBlocks, actions: NDArray[np.floating]) -> None:
        """Begin a decision; see `TaskState`."""
        for part, rides in enumerate(self._parts):
            rides.act(self._of(blocks, part), actions[part :: self._kinds])

    def commands(self, blocks: RowBlocks) -> FloatArray:
        """Return the commands of a control period; see `TaskState`."""
        return self._together([rides.commands(self._of(blocks, part)) for part, rides in enumerate(self._parts)])

    def advance(self, blocks: RowBlocks) -> None:
        """Add a control period; see `TaskState`."""
        for part, rides in enumerate(self._parts):
            rides.advance(self._of(blocks, part))

    def evaluate(self, blocks: RowBlocks) -> StepResult:
        """Return what has come of the decision; see `TaskState`."""
        verdicts = [rides.evaluate(self._of(blocks, part)) for part, rides in enumerate(self._parts)]
        terms = {name: self._together([verdict.terms[name] for verdict in verdicts]) for name in verdicts[0].terms}
        return StepResult(terms, self._together([verdict.failed for verdict in verdicts]))

    def error(self, blocks: RowBlocks) -> FloatArray:
        """Return the error of each machine at this instant; see `TaskState`."""
        return self._together([rides.error(self._of(blocks, part)) for part, rides in enumerate(self._parts)])

    def state_dict(self) -> dict[str, Any]:
        """Return the memory; see `TaskState`."""
        return {str(part): rides.state_dict() for part, rides in enumerate(self._parts)}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Take up the memory; see `TaskState`."""
        for part, rides in enumerate(self._parts):
            rides.restore(stored[str(part)])
