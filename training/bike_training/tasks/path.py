"""Path following with balance: reward, termination and validation error.

Source: Weyrer et al. (2026), Sects. 3.2 to 4.2 and Table 5. Every choice of Table 5 is a setting here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.observation import FINE_LAYOUT, LEAN_LAYOUT, PROP_LAYOUT, Blocks, ObservationLayout
from bike_policy.contract.rows import RowBlocks
from bike_sim.course.course import Course
from bike_sim.physics.state import ROLL
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.tasks.base import FloatArray, StepResult, check_positive_settings, check_weights

DISTANCE_THRESHOLD: Final = 3.5
"""eta_y, m."""
ROLL_THRESHOLD: Final = math.radians(45.0)
"""eta_phi, rad."""
VALIDATION_THRESHOLD: Final = 0.2
"""Mean distance of a successful validation ride, m (eta_e times eta_y, Eq. 13)."""
VALIDATION_DURATION: Final = 30.0
"""Duration of a validation ride, s (Sect. 4.2)."""


class RideBlocks(Blocks, Protocol):
    """Blocks that this task evaluates: one snapshot, or a batch with leading dimensions.

    Attributes:
        fallen: whether the vehicle has fallen.
    """

    @property
    def fallen(self) -> bool | NDArray[np.bool_]: ...  # noqa: D102


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


@dataclass(frozen=True)
class PathTask:
    """Settings of the task; implements `bike_training.tasks.base.Task`.

    Attributes:
        layout: of the observation.
        max_steer: steering set point of action 1, rad.
        weights: terms of the reward by name, with their weights; they sum to 1 in the paper (chi_1 of Eq. 7 is the
            weight of the distance).
        sharpness: width of the term ``path_peak``, m.
        contact: which contact point is held to the path, ``rear`` d(P, P_P0) or ``front`` d(Q, P_Q0).
        max_steps: n_max, steps of an episode.
    """

    layout: ObservationLayout = LEAN_LAYOUT
    max_steer: float = math.radians(70.0)
    weights: Mapping[str, float] = field(default_factory=lambda: LINEAR)
    sharpness: float = 0.2
    contact: Literal["rear", "front"] = "rear"
    max_steps: int = 1200

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the value.
        """
        check_weights(self.weights, REWARD_TERMS, negative=True)
        if self.contact not in ("rear", "front"):
            raise ValueError(f"contact must be rear or front, got {self.contact!r}")
        check_positive_settings(self, ("max_steps", "sharpness", "max_steer"))

    @property
    def preview(self) -> Preview:
        """The preview that shows exactly what the layout needs."""
        return Preview(self.layout.preview_by_time, self.layout.preview_interval, self.layout.preview_count)

    @property
    def action(self) -> ActionLayout:
        """What an action means."""
        return ActionLayout.steering(self.max_steer)

    @property
    def repeat(self) -> int:
        """Control periods that a decision is held."""
        return 1

    def rides(self, count: int, vehicle: Vehicle) -> PathRides:
        """Return what it shows and judges of a number of bicycles."""
        return PathRides(self, vehicle.max_steer)

    def strict(self) -> PathTask:
        """Return itself: a validation fails where learning does."""
        return self

    @property
    def error_name(self) -> str:
        """What the error of a ride is, with its unit."""
        return "error_m"

    def selection_error(self, track: FloatArray, whole: NDArray[np.bool_]) -> float:
        """Return the RMS error over all rides, m; a failed ride counts as the largest error throughout.

        The root mean square weighs the places where a ride is worst, which the mean hides.
        """
        return float(np.sqrt(np.mean(np.where(whole, track, self.largest_error) ** 2)))

    def error(self, blocks: RideBlocks) -> FloatArray:
        """Return t_0 of the contact point that is held to the path, m."""
        place = lk.LATERAL_ERROR if self.contact == "rear" else lk.FRONT_LATERAL_ERROR
        return np.abs(blocks.look[..., place])

    def reward_terms(self, blocks: RideBlocks) -> dict[str, FloatArray]:
        """Return the weighted terms of the reward of one or many instants, Eqs. (7) to (10), by name.

        Their sum, the reward, lies in [0, 1] for the paper's weights, also on the step that leaves the thresholds.
        """
        distance, roll = self.error(blocks), blocks.state[..., ROLL]
        return {name: weight * REWARD_TERMS[name](self, distance, roll) for name, weight in self.weights.items()}

    def failed(self, blocks: RideBlocks) -> NDArray[np.bool_]:
        """Return where a ride has failed: too far from the path or fallen (Sect. 4). NaN has failed."""
        rear, roll = np.abs(blocks.look[..., lk.LATERAL_ERROR]), np.abs(blocks.state[..., ROLL])
        return ~(np.less_equal(rear, DISTANCE_THRESHOLD) & np.less_equal(roll, ROLL_THRESHOLD)) | blocks.fallen

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
        return {**asdict(self), "weights": dict(self.weights), "layout": self.layout.to_card()}

    @classmethod
    def from_card(cls, card: Mapping[str, Any]) -> PathTask:
        """Read what :meth:`to_card` wrote.

        Raises:
            ValueError: an entry is missing, unknown or wrong.
        """
        values = dict(_named_weights(card))
        unknown = sorted(set(values) - {spec.name for spec in fields(cls)})
        if unknown or "layout" not in values:
            raise ValueError(f"the task has unknown entries {unknown}, or no layout; another version wrote it")
        return cls(**{**values, "layout": ObservationLayout.from_card(values["layout"])})


class PathRides:
    """What a path task shows and judges: each instant by itself; implements `bike_training.tasks.base.TaskState`."""

    def __init__(self, task: PathTask, max_steer: float) -> None:
        """Show and judge for a task, of bicycles whose command 1 is a steering set point of `max_steer` (rad)."""
        self._task, self._max_steer = task, max_steer
        self._actions: NDArray[np.floating] = np.zeros((0, 1))

    def begin(self, row: int, blocks: RowBlocks, request: ResetRequest, course: Course) -> None:
        """Need nothing of how a ride begins."""

    def observe(self, blocks: RowBlocks) -> NDArray[np.float32]:
        """Return the observations; see `TaskState`."""
        return self._task.layout.observe(blocks)

    def act(self, blocks: RowBlocks, actions: NDArray[np.floating]) -> None:
        """Hold actions; see `TaskState`."""
        self._actions = actions

    def commands(self, blocks: RowBlocks) -> FloatArray:
        """Return the same commands in each control period; see `TaskState`."""
        return self._task.action.to_commands(self._actions, self._max_steer, blocks.look[:, lk.SPEED])

    def advance(self, blocks: RowBlocks) -> None:
        """Need nothing between decisions."""

    def evaluate(self, blocks: RowBlocks) -> StepResult:
        """Return what has come of the decision; see `TaskState`."""
        return StepResult(self._task.reward_terms(blocks), self._task.failed(blocks))

    def error(self, blocks: RowBlocks) -> FloatArray:
        """Return the distances to the path, m."""
        return self._task.error(blocks)

    def state_dict(self) -> dict[str, Any]:
        """Return an empty memory."""
        return {}

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Take up nothing."""


def has_failed(task: PathTask, blocks: RideBlocks) -> bool:
    """Return whether one ride has failed."""
    return bool(task.failed(blocks))


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


PROP: Final = PathTask(layout=PROP_LAYOUT)
"""The proposed settings of Table 5."""

_MINIMAL_LAYOUT = ObservationLayout(
    "alt1",
    ("x", "y", "yaw_wrapped", *PROP_LAYOUT.features[4:]),
    (1.0,) * (len(PROP_LAYOUT.features) - 1),
)

TASKS: Final[dict[str, PathTask]] = {
    "prop": PROP,
    "alt1": replace(PROP, layout=_MINIMAL_LAYOUT),
    "alt2": replace(PROP, layout=replace(PROP_LAYOUT, name="alt2", preview_by_time=False, preview_interval=2.0)),
    "alt3": replace(PROP, contact="front"),
    "alt4": replace(PROP, weights={"path_exponential": 1.0}),
    "alt5": replace(PROP, weights={"path_linear": 0.5, "upright": 0.5}),
    "lean": PathTask(),
    "fine": PathTask(layout=FINE_LAYOUT),
}
"""Table 5 by name, and this project's own."""
