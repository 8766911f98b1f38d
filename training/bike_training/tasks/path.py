"""The task: reward, termination and validation error of path following with balance.

Source: Weyrer et al. (2026), Sects. 3.2 to 4.2 and Table 5. Every choice of Table 5 is a setting here.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import ActionScale
from bike_policy.contract.observation import LEAN_LAYOUT, PROP_LAYOUT, ObservationLayout
from bike_sim.physics.state import ROLL
from bike_sim.sim import look as ride
from bike_sim.sim.request import Preview
from bike_sim.sim.simulator import Snapshot

FloatArray = NDArray[np.float64]
Numbers = FloatArray | float

DISTANCE_THRESHOLD: Final = 3.5
"""eta_y, m."""
ROLL_THRESHOLD: Final = math.radians(45.0)
"""eta_phi, rad."""
VALIDATION_THRESHOLD: Final = 0.2
"""Mean distance of a successful validation ride, m (eta_e times eta_y, Eq. 13)."""


@dataclass(frozen=True)
class Task:
    """Settings of the learning task.

    Attributes:
        layout: what the policy sees.
        max_steer: steering set value of action 1, rad.
        reward: how the distance is rewarded. ``linear`` is Eq. (8), ``exponential`` Eq. (9); ``sharp`` is half of each
            of Eq. (8) and a Laplace peak of ``sharpness``, so that the last centimetres count as well.
        sharpness: width of the peak of ``sharp``, m.
        path_weight: chi_1 of Eq. (7); the roll part has weight 1 - chi_1.
        contact: which contact point is held to the path, ``rear`` d(P, P_P0) or ``front`` d(Q, P_Q0).
        max_steps: n_max, steps of an episode.
    """

    layout: ObservationLayout = LEAN_LAYOUT
    max_steer: float = math.radians(70.0)
    reward: Literal["linear", "exponential", "sharp"] = "linear"
    sharpness: float = 0.2
    path_weight: float = 1.0
    contact: Literal["rear", "front"] = "rear"
    max_steps: int = 1200

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        if self.reward not in ("linear", "exponential", "sharp"):
            raise ValueError(f"reward must be linear, exponential or sharp, got {self.reward!r}")
        if self.contact not in ("rear", "front"):
            raise ValueError(f"contact must be rear or front, got {self.contact!r}")
        if not 0.0 <= self.path_weight <= 1.0:
            raise ValueError(f"path weight must lie in [0, 1], got {self.path_weight!r}")
        if self.max_steps < 1 or not self.sharpness > 0.0 or not self.max_steer > 0.0:
            raise ValueError("max_steps, sharpness and max_steer must be positive")

    @property
    def preview(self) -> Preview:
        """Preview that shows exactly what the layout needs."""
        return Preview(self.layout.preview_by_time, self.layout.preview_interval, self.layout.preview_count)

    @property
    def action_scale(self) -> ActionScale:
        """What an action means."""
        return ActionScale(self.max_steer)

    def reward_terms(self, distance: FloatArray, roll: FloatArray) -> dict[str, FloatArray]:
        """Return the parts of the reward of one or many instants with their weights, Eqs. (7) to (10), by name.

        Args:
            distance: t_0 of the chosen contact point, m.
            roll: rad.

        Returns:
            ``path_linear``, ``path_exponential`` or ``path_peak`` for the distance to the path as far as the reward
            has them, and ``upright`` where roll is rewarded. Their sum is the reward.
        """
        linear = np.clip((DISTANCE_THRESHOLD - distance) / DISTANCE_THRESHOLD, 0.0, 1.0)
        if self.reward == "linear":
            terms = {"path_linear": linear}
        elif self.reward == "exponential":
            terms = {"path_exponential": np.exp(-0.5 * distance**2)}
        else:
            terms = {"path_linear": 0.5 * linear, "path_peak": 0.5 * np.exp(-distance / self.sharpness)}
        terms = {name: self.path_weight * term for name, term in terms.items()}
        if self.path_weight < 1.0:
            upright = np.clip((ROLL_THRESHOLD - np.abs(roll)) / ROLL_THRESHOLD, 0.0, 1.0)
            terms["upright"] = (1.0 - self.path_weight) * upright
        return terms

    def rewards(self, distance: FloatArray, roll: FloatArray) -> FloatArray:
        """Return the reward of one or many instants: the sum of :meth:`reward_terms`.

        Args:
            distance: t_0 of the chosen contact point, m.
            roll: rad.

        Returns:
            Rewards in [0, 1], also on the step that leaves the thresholds.
        """
        return sum_of(self.reward_terms(distance, roll))


def sum_of(terms: Mapping[str, FloatArray]) -> FloatArray:
    """Return the reward that its terms make."""
    return functools.reduce(np.add, terms.values())


def distances(task: Task, seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return t_0 of the contact point that the task holds to the path, m, for one vehicle or a batch."""
    place = ride.LATERAL_ERROR if task.contact == "rear" else ride.FRONT_LATERAL_ERROR
    return np.abs(seen[..., place])


def failed(rear_distance: Numbers, roll: Numbers, fallen: bool | NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a ride has failed: too far from the path or fallen (Sect. 4). What is no number has failed.

    Args:
        rear_distance: d(P, P_P0), m.
        roll: roll angle, rad.
        fallen: where the simulator says so: the bicycle lies on the ground, or its physics diverged.
    """
    rides = np.less_equal(rear_distance, DISTANCE_THRESHOLD) & np.less_equal(np.abs(roll), ROLL_THRESHOLD)
    return ~rides | fallen


def has_failed(snapshot: Snapshot) -> bool:
    """Tell whether a ride has failed, as :func:`failed` does of many."""
    return bool(failed(snapshot.distance, snapshot.state[ROLL], snapshot.fallen))


def validation_error(distances: FloatArray, succeeded: bool) -> float:
    """Return the normalised error e_i of one validation ride, Eq. (12).

    Args:
        distances: t_0 at each step of the ride, m. The first 20 % are left out.
        succeeded: whether the ride came to its end.
    """
    if not succeeded:
        return 1.0
    return float(np.mean(distances[len(distances) // 5 :]) / DISTANCE_THRESHOLD)


PROP: Final = Task(layout=PROP_LAYOUT)
"""The proposed settings of Table 5."""

_MINIMAL_LAYOUT = ObservationLayout(
    "alt1",
    ("x", "y", "yaw", *PROP_LAYOUT.features[4:]),
    (1.0,) * (len(PROP_LAYOUT.features) - 1),
)

TASKS: Final[dict[str, Task]] = {
    "prop": PROP,
    "alt1": replace(PROP, layout=_MINIMAL_LAYOUT),
    "alt2": replace(PROP, layout=replace(PROP_LAYOUT, name="alt2", preview_by_time=False, preview_interval=2.0)),
    "alt3": replace(PROP, contact="front"),
    "alt4": replace(PROP, reward="exponential"),
    "alt5": replace(PROP, path_weight=0.5),
    "lean": Task(),
}
"""Table 5 by name, and this project's own."""
