"""The four-part curriculum: which rides are drawn when, and what ends a part.

Source: Weyrer et al. (2026), Sects. 4.2 and 4.3, Table 4, Fig. 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from bike_sim.course.random_courses import CURRICULUM_PATHS, PathRanges
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.curricula.base import Curriculum, CurriculumSettings
from bike_training.settings import AT_LEAST_1
from bike_training.tasks.path import DISTANCE_THRESHOLD, VALIDATION_DURATION, VALIDATION_THRESHOLD

SPEED_RANGES: Final = ((4.0, 4.0), (2.0, 7.0), (2.0, 7.0), (2.0, 7.0))
"""Forward speed of the four parts, m/s (Table 4)."""

TRANSITION_STEPS: Final = 10_000
"""n_dec: learning steps over which the intervals grow into those of the next part."""

VALIDATION_RIDES: Final = 10
"""Rides of a validation (Sect. 4.2), as published."""

PARTS: Final = 4

SELECTION_RIDES_PER_SPEED: Final = 5
SELECTION_SEED: Final = 2**32
"""Rides at each of 21 speeds that actors are compared on, and the seed of the first; training draws below 2**31."""


@dataclass(frozen=True)
class RideRanges:
    """Intervals that new rides are drawn from.

    Attributes:
        speed: forward speed, m/s.
        paths: elements of the random path.
        also: other intervals that a ride is drawn from just as often.
        perturb: whether a ride begins perturbed (Table 3), else upright on its path.
    """

    speed: tuple[float, float]
    paths: PathRanges
    also: tuple[RideRanges, ...] = ()
    perturb: bool = True

    def draw(self, rng: np.random.Generator, preview: Preview, row: int = 0) -> ResetRequest:
        """Draw a ride, on a path that is long enough for two episodes; all bicycles are alike. See `Episodes`."""
        chosen = (self, *self.also)[rng.integers(1 + len(self.also))] if self.also else self
        return ResetRequest(
            seed=int(rng.integers(2**31)),
            speed_range=chosen.speed,
            path_ranges=chosen.paths,
            perturb=chosen.perturb,
            preview=preview,
        )


FAST_AND_SHARP: Final = RideRanges((5.5, 7.3), PathRanges(7.5, 14.0, 11.0, 14.0, 3.0, 7.0))
SLOW_AND_SHARP: Final = RideRanges((1.8, 3.0), FAST_AND_SHARP.paths)
WIDE: Final = RideRanges((1.8, 7.3), PathRanges(8.0, 50.0, 20.0, 60.0, 1.0, 8.0))
"""Gentle bends as well, as those of circuits scaled down. Not from the paper."""
TIGHT: Final = (
    RideRanges((1.8, 3.2), PathRanges(1.8, 8.0, 6.0, 14.0, 1.0, 3.0)),
    RideRanges((3.0, 4.4), PathRanges(2.5, 8.0, 8.0, 14.0, 1.0, 3.0)),
    RideRanges((4.2, 5.6), PathRanges(3.8, 9.0, 10.0, 16.0, 1.0, 3.0)),
    RideRanges((5.4, 7.1), PathRanges(6.8, 12.0, 11.0, 18.0, 1.5, 5.0)),
)
"""Hairpins as those of such circuits. Not from the paper."""
REFINEMENT: Final = RideRanges((1.8, 7.3), PathRanges(7.5, 14.0, 11.0, 22.0, 2.0, 8.0), (FAST_AND_SHARP,))
"""Optional rides after the curriculum. Not from the paper.

Half of them lie in a margin around part 4, so that its edges lie inside. The other half are what part 4 seldom has,
sharp transfers at high speed. The hard lane change of the benchmark path (10 m long) stays outside of both.
"""


@dataclass(frozen=True, kw_only=True)
class PartsSettings(CurriculumSettings):
    """Settings of the curriculum in four parts.

    Attributes:
        curriculum: ``parts``.
        refine: whether the intervals grow into REFINEMENT once the last part is finished; else they stay its own.
        sharp: whether a third of the rides of the last part each are FAST_AND_SHARP and SLOW_AND_SHARP.
        last_speeds: rides of a validation of the last part, at so many even speeds with both ends, so that none is left
            out by luck; 0 for VALIDATION_RIDES at random speeds, as published.
        stable: whether the last part is passed only with a closed loop that is stable about steady rides as well: an
            actor may ride all paths and swing about a straight.
        validate_every: least learning steps between two validations.
        select_every: learning steps between two comparisons of actors once the curriculum is finished.
    """

    limits: ClassVar = {
        "validate_every": AT_LEAST_1,
        "select_every": AT_LEAST_1,
        "last_speeds": (0.0, 1000.0),
    }

    curriculum: str = "parts"
    refine: bool = False
    sharp: bool = False
    last_speeds: int = 0
    stable: bool = False
    validate_every: int = 4000
    select_every: int = 10_000

    def make(self, vehicles: Sequence[Vehicle]) -> PartsCurriculum:
        """Return the curriculum at its beginning."""
        return PartsCurriculum(self)


class PartsCurriculum(Curriculum):
    """The four parts of the paper.

    Attributes:
        part: 1 to 4; 5 once the curriculum is finished.
        entered_at: learning step at which the part began.
        finished_at: learning step at which the last part was passed, or None.
    """

    def __init__(self, settings: PartsSettings | None = None) -> None:
        """Begin with the first part."""
        self._settings = settings or PartsSettings()
        self.entered_at = 0

    @property
    def asks_for_stability(self) -> bool:
        """Whether it does in this part."""
        return self._settings.stable and self.part >= PARTS

    @property
    def compares_stability(self) -> bool:
        """Bicycles have steady rides."""
        return True

    def may_validate(self, step: int) -> bool:
        """Return whether the intervals no longer grow; while they do no validation is made."""
        return not 1 < self.part <= PARTS or step - self.entered_at >= TRANSITION_STEPS

    def episodes(self, step: int) -> RideRanges:
        """Return the intervals at a learning step, growing linearly after a new part began."""
        stages = self._stages()
        if self.part == 1:
            return stages[0]
        share = (step - self.entered_at) / TRANSITION_STEPS
        if share >= 1.0:
            return stages[self.part - 1]
        growing = _ranges_between(stages[self.part - 2], stages[self.part - 1], share)
        return replace(growing, also=stages[self.part - 1].also if self._settings.sharp else ())

    def imitated(self) -> RideRanges:
        """Return the intervals that all parts lead to, and WIDE and TIGHT as often as each."""
        last = self._stages()[-1]
        return replace(last, also=(*last.also, WIDE, *TIGHT))

    def _stages(self) -> list[RideRanges]:
        """Return the intervals of each part, and those once the curriculum is finished."""
        stages = [RideRanges(*stage) for stage in zip(SPEED_RANGES, CURRICULUM_PATHS, strict=True)]
        if self._settings.sharp:
            stages[-1] = replace(stages[-1], also=(FAST_AND_SHARP, SLOW_AND_SHARP))
        return [*stages, REFINEMENT if self._settings.refine else stages[-1]]

    def validation_requests(self, preview: Preview, rng: np.random.Generator) -> list[ResetRequest]:
        """Draw the rides of a validation in the present part or the last, on paths long enough for all of a ride."""
        part = min(self.part, PARTS)
        episodes = RideRanges(SPEED_RANGES[part - 1], CURRICULUM_PATHS[part - 1])
        chosen = [episodes] * VALIDATION_RIDES
        if self.part >= PARTS and self._settings.last_speeds:
            speeds = np.linspace(*episodes.speed, self._settings.last_speeds).tolist()
            chosen = [replace(episodes, speed=(speed, speed)) for speed in speeds]
        drawn = [episode.draw(rng, preview) for episode in chosen]
        return [replace(request, path_length=1.2 * VALIDATION_DURATION * request.speed_range[1]) for request in drawn]

    def selection_requests(self, preview: Preview) -> list[ResetRequest]:
        """Return the rides that actors are compared on: always the same, on random paths of the last part.

        They are drawn from seeds that no training run reaches by counting, and the benchmark path is not among them.
        """
        speeds = np.tile(np.linspace(*SPEED_RANGES[-1], 21), SELECTION_RIDES_PER_SPEED).tolist()
        return [
            ResetRequest(
                seed=SELECTION_SEED + number,
                speed_range=(speed, speed),
                path_ranges=CURRICULUM_PATHS[-1],
                path_length=1.2 * VALIDATION_DURATION * speed + 20.0,
                preview=preview,
            )
            for number, speed in enumerate(speeds)
        ]

    def passes(self, errors: Sequence[float]) -> bool:
        """Return whether a validation was fully successful: every ride's error e_i is at most eta_e (Eq. 13)."""
        return max(errors) <= VALIDATION_THRESHOLD / DISTANCE_THRESHOLD

    def state_dict(self) -> dict[str, Any]:
        """Return where it stands as plain values."""
        return {**super().state_dict(), "entered_at": self.entered_at}

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue from where :meth:`state_dict` was taken."""
        super().restore(stored)
        self.entered_at = stored["entered_at"]

    def validated(self, step: int, errors: Sequence[float]) -> bool:
        """Take the errors e_i of a validation and return whether a part was passed."""
        if self.finished or not self.passes(errors):
            return False
        self.part += 1
        self.entered_at = step
        if self.part > PARTS:
            self.finished_at = step
        return True


def _ranges_between(before: RideRanges, after: RideRanges, share: float) -> RideRanges:
    def between(a: float, b: float) -> float:
        return a + (b - a) * share

    paths = PathRanges(*map(between, astuple(before.paths), astuple(after.paths)))
    low, high = map(between, before.speed, after.speed)
    return RideRanges((low, high), paths)
