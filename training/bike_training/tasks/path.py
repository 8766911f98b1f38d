"""Path following with balance: reward, termination and validation error.

Source: Weyrer et al. (2026), Sects. 3.2 to 4.2 and Table 5. Every choice of Table 5 is a setting here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import (
    FINE_LAYOUT,
    LEAN_LAYOUT,
    PROP_LAYOUT,
    TURN_LAYOUT,
    ObservationLayout,
    VehicleRows,
)
from bike_sim.physics.state import ROLL, ROLL_RATE
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.settings import AT_LEAST_1, POSITIVE, check_choice
from bike_training.tasks.base import FloatArray, StepResult, Task, TaskState

DISTANCE_THRESHOLD: Final = 3.5
"""eta_y, m."""
ROLL_THRESHOLD: Final = math.radians(45.0)
"""eta_phi, rad."""
ROLL_RATE_THRESHOLD: Final = math.radians(45.0)
"""Of the roll's rate, rad/s; the paper's is not published."""
VALIDATION_THRESHOLD: Final = 0.2
"""Mean distance of a successful validation ride, m (eta_e times eta_y, Eq. 13)."""
VALIDATION_DURATION: Final = 30.0
"""Duration of a validation ride, s (Sect. 4.2)."""


def _path_linear(task: PathTask, distance: FloatArray, state: FloatArray) -> FloatArray:
    """Eq. (8)."""
    return np.clip((DISTANCE_THRESHOLD - distance) / DISTANCE_THRESHOLD, 0.0, 1.0)


def _path_exponential(task: PathTask, distance: FloatArray, state: FloatArray) -> FloatArray:
    """Eq. (9)."""
    return np.exp(-0.5 * distance**2)


def _path_peak(task: PathTask, distance: FloatArray, state: FloatArray) -> FloatArray:
    """Laplace peak of width `sharpness`, so that the last centimetres count as well. Not from the paper."""
    return np.exp(-distance / task.sharpness)


def _path_close(task: PathTask, distance: FloatArray, state: FloatArray) -> FloatArray:
    """Peak of width `sharpness` with a long tail: millimetres count, and so does a way back of metres. Ours."""
    return 1.0 / (1.0 + distance / task.sharpness)


def _upright(task: PathTask, distance: FloatArray, state: FloatArray) -> FloatArray:
    """Eq. (10)."""
    return np.clip((ROLL_THRESHOLD - np.abs(state[:, ROLL])) / ROLL_THRESHOLD, 0.0, 1.0)


def _steady(task: PathTask, distance: FloatArray, state: FloatArray) -> FloatArray:
    """Eq. (10) with the roll's rate in place of the roll, as Sect. 6 proposes."""
    return np.clip((ROLL_RATE_THRESHOLD - np.abs(state[:, ROLL_RATE])) / ROLL_RATE_THRESHOLD, 0.0, 1.0)


REWARD_TERMS: Final[Mapping[str, Callable[[PathTask, FloatArray, FloatArray], FloatArray]]] = {
    "path_linear": _path_linear,
    "path_exponential": _path_exponential,
    "path_peak": _path_peak,
    "path_close": _path_close,
    "upright": _upright,
    "steady": _steady,
}
"""Terms of the reward by name: functions in [0, 1] of distance to the path (m) and the bicycle's state."""

LINEAR: Final[Mapping[str, float]] = {"path_linear": 1.0}
SHARP: Final[Mapping[str, float]] = {"path_linear": 0.5, "path_peak": 0.5}


class PathVariant(NamedTuple):
    """Settings of Table 5 that belong together.

    Attributes:
        layout: of the observation.
        contact: contact point that is held to the path, ``rear`` d(P, P_P0) or ``front`` d(Q, P_Q0).
        weights: terms of the reward by name, with their weights.
    """

    layout: ObservationLayout = PROP_LAYOUT
    contact: Literal["rear", "front"] = "rear"
    weights: Mapping[str, float] = LINEAR


VARIANTS: Final[Mapping[str, PathVariant]] = {
    "prop": PathVariant(),
    "alt1": PathVariant(
        replace(PROP_LAYOUT, name="alt1", terms=("x", "y", "yaw_wrapped", *PROP_LAYOUT.terms[4:])),
    ),
    "alt2": PathVariant(replace(PROP_LAYOUT, name="alt2", preview_by_time=False, preview_interval=2.0)),
    "alt3": PathVariant(contact="front"),
    "alt4": PathVariant(weights={"path_exponential": 1.0}),
    "alt5": PathVariant(weights={"path_linear": 0.5, "upright": 0.5}),
    "lean": PathVariant(LEAN_LAYOUT),
    "fine": PathVariant(FINE_LAYOUT),
    "turn": PathVariant(TURN_LAYOUT),
}
"""Table 5 by name, and this project's own."""


@dataclass(frozen=True, kw_only=True)
class PathTask(Task):
    """Settings of the task.

    Attributes:
        task: name in VARIANTS.
        max_steer: steering set point of action 1, rad.
        weights: terms of the reward by name, with their weights; empty for those of the variant. They sum to 1 in the
            paper (chi_1 of Eq. 7 is the weight of the distance).
        sharpness: width of the terms ``path_peak`` and ``path_close``, m.
        max_steps: n_max, steps of an episode.
        disturbances: names or files of what disturbs the bicycles; rows take them in turn.
    """

    limits: ClassVar = {"max_steps": AT_LEAST_1, "sharpness": POSITIVE, "max_steer": POSITIVE}
    error_name = "error_m"
    validation_duration = VALIDATION_DURATION
    largest_error = DISTANCE_THRESHOLD

    task: str = "prop"
    max_steer: float = math.radians(70.0)
    weights: Mapping[str, float] = field(default_factory=dict)
    sharpness: float = 0.2
    max_steps: int = 1200
    disturbances: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        check_choice("task", self.task, VARIANTS)
        self.set_weights(VARIANTS[self.task].weights, REWARD_TERMS, negative=True)

    @property
    def layout(self) -> ObservationLayout:
        """Layout of the observation."""
        return VARIANTS[self.task].layout

    @property
    def contact(self) -> Literal["rear", "front"]:
        """Contact point that is held to the path."""
        return VARIANTS[self.task].contact

    def check_vehicle(self, vehicle: Vehicle) -> None:
        """Refuse superbikes: they ride circuits, and this task has none."""
        if isinstance(vehicle, Superbike):
            raise ValueError(f"task {self.task!r} is for bicycles on paths, and {vehicle.name!r} is a superbike")

    @property
    def preview(self) -> Preview:
        """The preview that shows exactly what the layout needs."""
        return Preview(self.layout.preview_by_time, self.layout.preview_interval, self.layout.preview_count)

    @property
    def action(self) -> ActionLayout:
        """Meaning of an action."""
        return ActionLayout.steering(self.max_steer)

    def make_state(self, count: int, vehicle: Vehicle) -> PathState:
        """Return the state of the task for a number of bicycles."""
        return PathState(self, vehicle.max_steer)

    def validation_error(self, errors: FloatArray, succeeded: bool) -> float:
        """Return e_i of Eq. (12), without the first 20 % of a ride."""
        return float(np.mean(errors[len(errors) // 5 :]) / DISTANCE_THRESHOLD) if succeeded else 1.0

    def selection_error(self, track: FloatArray, whole: NDArray[np.bool_]) -> float:
        """Return the RMS error over all rides, m; a failed ride counts as the largest error throughout.

        The root mean square weighs the places where a ride is worst, which the mean hides.
        """
        return float(np.sqrt(np.mean(np.where(whole, track, self.largest_error) ** 2)))

    def error(self, rows: VehicleRows) -> FloatArray:
        """Return t_0 of the contact point that is held to the path, m."""
        place = lk.LATERAL_ERROR if self.contact == "rear" else lk.FRONT_LATERAL_ERROR
        return np.abs(rows.look[:, place])

    def reward_terms(self, rows: VehicleRows) -> dict[str, FloatArray]:
        """Return the weighted terms of the reward of one or many instants, Eqs. (7) to (10), by name.

        Their sum, the reward, lies in [0, 1] for the paper's weights, also on the step that leaves the thresholds.
        """
        distance, state = self.error(rows), rows.state
        return {name: weight * REWARD_TERMS[name](self, distance, state) for name, weight in self.weights.items()}

    def failed(self, rows: VehicleRows) -> NDArray[np.bool_]:
        """Return where a ride has failed: too far from the path or fallen (Sect. 4). NaN has failed."""
        rear, roll = np.abs(rows.look[:, lk.LATERAL_ERROR]), np.abs(rows.state[:, ROLL])
        return ~(np.less_equal(rear, DISTANCE_THRESHOLD) & np.less_equal(roll, ROLL_THRESHOLD)) | rows.fallen


class PathState(TaskState):
    """State of a path task, which evaluates each instant by itself."""

    def __init__(self, task: PathTask, max_steer: float) -> None:
        """Take a task, and the steering set point of a bicycle's command 1 (rad)."""
        self._task, self._max_steer = task, max_steer
        self._actions: NDArray[np.floating] = np.zeros((0, 1))

    def observe(self, rows: VehicleRows) -> NDArray[np.float32]:
        """Return the observations."""
        return self._task.layout.observe(rows)

    def act(self, rows: VehicleRows, actions: NDArray[np.floating]) -> None:
        """Hold actions."""
        self._actions = actions

    def commands(self, rows: VehicleRows) -> FloatArray:
        """Return the same commands in each control period."""
        return self._task.action.to_commands(self._actions, self._max_steer, rows.look[:, lk.SPEED])

    def evaluate(self, rows: VehicleRows) -> StepResult:
        """Return the outcome of the decision."""
        return StepResult(self._task.reward_terms(rows), self._task.failed(rows))

    def error(self, rows: VehicleRows) -> FloatArray:
        """Return the distances to the path, m."""
        return self._task.error(rows)


TASKS: Final[Mapping[str, PathTask]] = {name: PathTask(task=name) for name in VARIANTS}
"""Tasks by name."""
PROP: Final = TASKS["prop"]
"""The proposed settings of Table 5."""
