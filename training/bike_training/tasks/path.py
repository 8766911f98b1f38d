"""Path following with balance: reward, termination and validation error.

Source: Weyrer et al. (2026), Sects. 3.2 to 4.2 and Table 5. Every choice of Table 5 is a setting here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import FINE_LAYOUT, LEAN_LAYOUT, PROP_LAYOUT, ObservationLayout, VehicleRows
from bike_sim.course.course import Course
from bike_sim.physics.state import ROLL
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.settings import check_choice
from bike_training.tasks.base import FloatArray, StepResult, check_positive_settings, check_weights

DISTANCE_THRESHOLD: Final = 3.5
"""eta_y, m."""
ROLL_THRESHOLD: Final = math.radians(45.0)
"""eta_phi, rad."""
VALIDATION_THRESHOLD: Final = 0.2
"""Mean distance of a successful validation ride, m (eta_e times eta_y, Eq. 13)."""
VALIDATION_DURATION: Final = 30.0
"""Duration of a validation ride, s (Sect. 4.2)."""


def _path_linear(task: PathTask, distance: FloatArray, roll: FloatArray) -> FloatArray:
    """Eq. (8)."""
    return np.clip((DISTANCE_THRESHOLD - distance) / DISTANCE_THRESHOLD, 0.0, 1.0)


def _path_exponential(task: PathTask, distance: FloatArray, roll: FloatArray) -> FloatArray:
    """Eq. (9)."""
    return np.exp(-0.5 * distance**2)


def _path_peak(task: PathTask, distance: FloatArray, roll: FloatArray) -> FloatArray:
    """Laplace peak of width `sharpness`, so that the last centimetres count as well. Not from the paper."""
    return np.exp(-distance / task.sharpness)


def _upright(task: PathTask, distance: FloatArray, roll: FloatArray) -> FloatArray:
    """Eq. (10)."""
    return np.clip((ROLL_THRESHOLD - np.abs(roll)) / ROLL_THRESHOLD, 0.0, 1.0)


REWARD_TERMS: Final[Mapping[str, Callable[[PathTask, FloatArray, FloatArray], FloatArray]]] = {
    "path_linear": _path_linear,
    "path_exponential": _path_exponential,
    "path_peak": _path_peak,
    "upright": _upright,
}
"""Terms of the reward by name: functions in [0, 1] of distance to the path (m) and roll (rad)."""

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
}
"""Table 5 by name, and this project's own."""


@dataclass(frozen=True, kw_only=True)
class PathTask:
    """Settings of the task; implements `bike_training.tasks.base.Task`.

    Attributes:
        task: name in VARIANTS.
        max_steer: steering set point of action 1, rad.
        weights: terms of the reward by name, with their weights; empty for those of the variant. They sum to 1 in the
            paper (chi_1 of Eq. 7 is the weight of the distance).
        sharpness: width of the term ``path_peak``, m.
        max_steps: n_max, steps of an episode.
    """

    task: str = "prop"
    max_steer: float = math.radians(70.0)
    weights: Mapping[str, float] = field(default_factory=dict)
    sharpness: float = 0.2
    max_steps: int = 1200

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the value.
        """
        check_choice("task", self.task, VARIANTS)
        if not isinstance(self.weights, Mapping):
            raise ValueError(f"setting weights={self.weights!r} must name reward terms and their weights")
        object.__setattr__(self, "weights", dict(self.weights or VARIANTS[self.task].weights))
        check_weights(self.weights, REWARD_TERMS, negative=True)
        check_positive_settings(self, ("max_steps", "sharpness", "max_steer"))

    @property
    def disturbances(self) -> tuple[str, ...]:
        """Nothing: bicycles learn undisturbed."""
        return ()

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

    @property
    def repeat(self) -> int:
        """Control periods that a decision is held."""
        return 1

    def make_state(self, count: int, vehicle: Vehicle) -> PathState:
        """Return the state of the task for a number of bicycles; see `Task`."""
        return PathState(self, vehicle.max_steer)

    def strict(self) -> PathTask:
        """Return itself: a validation fails where learning does."""
        return self

    @property
    def error_name(self) -> str:
        """Definition of a ride's error, with its unit."""
        return "error_m"

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
        distance, roll = self.error(rows), rows.state[:, ROLL]
        return {name: weight * REWARD_TERMS[name](self, distance, roll) for name, weight in self.weights.items()}

    def failed(self, rows: VehicleRows) -> NDArray[np.bool_]:
        """Return where a ride has failed: too far from the path or fallen (Sect. 4). NaN has failed."""
        rear, roll = np.abs(rows.look[:, lk.LATERAL_ERROR]), np.abs(rows.state[:, ROLL])
        return ~(np.less_equal(rear, DISTANCE_THRESHOLD) & np.less_equal(roll, ROLL_THRESHOLD)) | rows.fallen

    @property
    def validation_duration(self) -> float:
        """Duration of a validation ride, s."""
        return VALIDATION_DURATION

    @property
    def largest_error(self) -> float:
        """The distance that a failed ride counts as, m."""
        return DISTANCE_THRESHOLD

    def validation_error(self, errors: FloatArray, succeeded: bool) -> float:
        """Return e_i; see :func:`validation_error`."""
        return validation_error(errors, succeeded)

    def to_card(self) -> dict[str, Any]:
        """Return plain values for recordings."""
        return {**asdict(self), "layout": self.layout.to_card()}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> PathTask:
        """Read what :meth:`to_card` wrote, also that of recordings of older versions.

        Raises:
            ValueError: an entry is missing, unknown or wrong.
        """
        values = dict(_named_weights(card))
        layout, contact = values.pop("layout", None), values.pop("contact", "rear")
        if "task" not in values and isinstance(layout, Mapping):
            values["task"] = "alt3" if contact == "front" else layout.get("name")
        unknown = sorted(set(values) - {spec.name for spec in fields(cls)})
        if unknown or "task" not in values:
            raise ValueError(f"the task has unknown entries {unknown}, or no name; another version wrote it")
        return cls(**values)


class PathState:
    """State of a path task, which evaluates each instant by itself; implements `bike_training.tasks.base.TaskState`."""

    def __init__(self, task: PathTask, max_steer: float) -> None:
        """Take a task, and the steering set point of a bicycle's command 1 (rad)."""
        self._task, self._max_steer = task, max_steer
        self._actions: NDArray[np.floating] = np.zeros((0, 1))

    def begin(self, row: int, rows: VehicleRows, request: ResetRequest, course: Course) -> None:
        """Need nothing of how a ride begins."""

    def observe(self, rows: VehicleRows) -> NDArray[np.float32]:
        """Return the observations; see `TaskState`."""
        return self._task.layout.observe(rows)

    def act(self, rows: VehicleRows, actions: NDArray[np.floating]) -> None:
        """Hold actions; see `TaskState`."""
        self._actions = actions

    def commands(self, rows: VehicleRows) -> FloatArray:
        """Return the same commands in each control period; see `TaskState`."""
        return self._task.action.to_commands(self._actions, self._max_steer, rows.look[:, lk.SPEED])

    def advance(self, rows: VehicleRows) -> None:
        """Need nothing between decisions."""

    def evaluate(self, rows: VehicleRows) -> StepResult:
        """Return the outcome of the decision; see `TaskState`."""
        return StepResult(self._task.reward_terms(rows), self._task.failed(rows))

    def error(self, rows: VehicleRows) -> FloatArray:
        """Return the distances to the path, m."""
        return self._task.error(rows)

    def state_dict(self) -> dict[str, Any]:
        """Return an empty memory."""
        return {}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Take up nothing."""


def _named_weights(card: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a card with weights; recordings from before the terms had names have a kind of reward instead."""
    if "reward" not in card:
        return card
    path = {"linear": LINEAR, "exponential": {"path_exponential": 1.0}, "sharp": SHARP}[card["reward"]]
    share = card["path_weight"]
    weights = {name: share * weight for name, weight in path.items()}
    if share < 1.0:
        weights["upright"] = 1.0 - share
    return {name: value for name, value in card.items() if name not in ("reward", "path_weight")} | {"weights": weights}


def validation_error(distances: FloatArray, succeeded: bool) -> float:
    """Return the normalised error e_i of one validation ride, Eq. (12).

    Args:
        distances: t_0 at each step of the ride, m. The first 20 % are left out.
        succeeded: whether the ride came to its end.
    """
    if not succeeded:
        return 1.0
    return float(np.mean(distances[len(distances) // 5 :]) / DISTANCE_THRESHOLD)


TASKS: Final[Mapping[str, PathTask]] = {name: PathTask(task=name) for name in VARIANTS}
"""Tasks by name."""
PROP: Final = TASKS["prop"]
"""The proposed settings of Table 5."""
