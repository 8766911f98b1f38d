"""How a refinement compares actors: many rides, their closed loop, and rides under pushes and from steep starts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.riders.learned import LearnedRider
from bike_sim.course.random_paths import PathRanges
from bike_sim.sim.batch import Batch
from bike_sim.sim.bicycle_batch import CompiledBatch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.curricula.parts import PartsCurriculum, RideRanges
from bike_training.learning.linear_rides import push_sideways
from bike_training.learning.refinement_settings import RefinementSettings
from bike_training.learning.validation_rides import ride_side_by_side
from bike_training.rollout.stability import stability
from bike_training.tasks.path import VALIDATION_DURATION, PathTask

STABLE: Final = 0.99
"""Largest spectral radius of an actor that is kept as the best."""
STEEP: Final = RideRanges((4.0, 7.3), PathRanges(8.0, 14.0, 13.5, 16.0, 5.5, 8.2), perturb=False)
"""Upright starts, two thirds of them before a transfer that bends with down to 1/4 m before anything can lean."""
PUSHED: Final = 60.0
"""Sideways impulse of the rides that actors are compared on under pushes, N s."""
_PUSH_EVERY: Final = 100
"""Control periods between two of them."""


class Comparison(NamedTuple):
    """What an actor is judged by: the rides that runs of training compare actors on, and its closed loop.

    Attributes:
        ridden: of 105 rides. mean_m: of their mean distances, m. worst_mean_m: largest of them. worst_max_m: largest
            distance. spectral_radius: largest of 2 to 7 m/s, upright and in a turn; infinite where one is missing.
        swing_deg: set point left swinging on a straight.
        pushed: of 105 rides with a push of PUSHED N s every five seconds, where actors are compared under pushes.
        pushed_mean_m: of their mean distances, m.
        steep: of 105 rides from STEEP, where actors are compared on them. steep_mean_m: of their mean distances, m.
    """

    ridden: int
    mean_m: float
    worst_mean_m: float
    worst_max_m: float
    spectral_radius: float
    swing_deg: float
    pushed: int = 0
    pushed_mean_m: float = math.nan
    steep: int = 0
    steep_mean_m: float = math.nan

    def better_than(self, other: Comparison | None) -> bool:
        """Return whether it is: more rides of all kinds ridden, then a stable loop, then the smaller mean."""
        return other is None or self._rank() < other._rank()

    def _rank(self) -> tuple[float, ...]:
        return (-self.ridden - self.pushed - self.steep, max(self.spectral_radius, STABLE), self.mean_m)


def compare(policy: Bundle, task: PathTask, config: SimulatorConfig, settings: RefinementSettings) -> Comparison:
    """Judge a policy.

    Args:
        policy: judged.
        task: that it rides.
        config: of the simulator that it rides in.
        settings: say whether it rides under pushes and from steep starts as well.
    """
    actor = policy.actor
    requests = PartsCurriculum().selection_requests(task.preview)
    track, whole = ride_side_by_side(actor, task, config, requests)
    means = np.abs(track).mean(axis=0)
    loop = stability(LearnedRider(policy)) if whole.all() else {}
    radii = [loop.get(f"worst_spectral_radius_{place}") for place in ("upright", "turn")]
    found = Comparison(
        int(whole.sum()),
        float(means[whole].mean()) if whole.any() else math.inf,
        float(means[whole].max()) if whole.any() else math.inf,
        float(np.abs(track[:, whole]).max()) if whole.any() else math.inf,
        max((math.inf if radius is None else radius) for radius in radii),
        math.inf if loop.get("worst_swing_deg") is None else loop["worst_swing_deg"],
    )
    if settings.impulse:
        track, whole = ride_side_by_side(actor, task, config, requests, _push_now_and_then)
        found = found._replace(pushed=int(whole.sum()), pushed_mean_m=_mean_of(track, whole))
    if settings.steep:
        track, whole = ride_side_by_side(actor, task, config, _steep(requests))
        found = found._replace(steep=int(whole.sum()), steep_mean_m=_mean_of(track, whole))
    return found


def _mean_of(track: NDArray[np.float64], whole: NDArray[np.bool_]) -> float:
    return float(np.abs(track[:, whole]).mean()) if whole.any() else math.inf


def _steep(requests: list[ResetRequest]) -> list[ResetRequest]:
    """Return as many rides from STEEP, over its speeds."""
    speeds = np.linspace(*STEEP.speed, len(requests)).tolist()
    ranges = replace(requests[0], path_ranges=STEEP.paths, path_length=1.2 * VALIDATION_DURATION * max(speeds))
    return [
        replace(ranges, seed=request.seed, speed_range=(speed, speed))
        for request, speed in zip(requests, speeds, strict=True)
    ]


def _push_now_and_then(batch: Batch, step: int, riding: NDArray[np.bool_]) -> None:
    """Push bicycles that ride by PUSHED every five seconds, one to the left and the next one to the right."""
    assert isinstance(batch, CompiledBatch)
    if step and step % _PUSH_EVERY == 0:
        for row in np.flatnonzero(riding):
            push_sideways(batch, int(row), PUSHED * (-1.0) ** (row + step // _PUSH_EVERY // 2))
