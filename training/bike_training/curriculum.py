"""The four-part curriculum: which rides are drawn when, and what ends a part.

Source: Weyrer et al. (2026), Sects. 4.2 and 4.3, Table 4, Fig. 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

from bike_sim.course.random_paths import CURRICULUM_PATHS, PathRanges
from bike_training.task import DISTANCE_THRESHOLD, VALIDATION_THRESHOLD

SPEED_RANGES: Final = ((4.0, 4.0), (2.0, 7.0), (2.0, 7.0), (2.0, 7.0))
"""Forward speed of the four parts, m/s (Table 4)."""

TRANSITION_STEPS: Final = 10_000
"""n_dec: learning steps over which the intervals grow into those of the next part."""

VALIDATION_RIDES: Final = 10
VALIDATION_DURATION: Final = 30.0
"""Rides of a validation and their duration, s (Sect. 4.2)."""

PARTS: Final = 4


@dataclass(frozen=True)
class RideRanges:
    """Intervals that new rides are drawn from.

    Attributes:
        speed: forward speed, m/s.
        paths: elements of the random path.
    """

    speed: tuple[float, float]
    paths: PathRanges


@dataclass
class Curriculum:
    """Where a learning process stands.

    Attributes:
        part: 1 to 4; 5 once the curriculum is finished.
        entered_at: learning step at which the part began.
        finished_at: learning step at which the last part was passed, or None.
    """

    part: int = 1
    entered_at: int = 0
    finished_at: int | None = None

    @property
    def finished(self) -> bool:
        """Whether a validation of the last part was fully successful."""
        return self.finished_at is not None

    def in_transition(self, step: int) -> bool:
        """Tell whether the intervals still grow; no validation is made then."""
        return 1 < self.part <= PARTS and step - self.entered_at < TRANSITION_STEPS

    def ranges(self, step: int) -> RideRanges:
        """Return the intervals at a learning step, growing linearly after a new part began."""
        part = min(self.part, PARTS)
        speed, paths = SPEED_RANGES[part - 1], CURRICULUM_PATHS[part - 1]
        if part == 1 or self.finished:
            return RideRanges(speed, paths)
        share = min((step - self.entered_at) / TRANSITION_STEPS, 1.0)
        before_speed, before_paths = SPEED_RANGES[part - 2], CURRICULUM_PATHS[part - 2]
        grown = PathRanges(
            **{
                spec.name: _between(getattr(before_paths, spec.name), getattr(paths, spec.name), share)
                for spec in fields(PathRanges)
            }
        )
        low, high = (_between(a, b, share) for a, b in zip(before_speed, speed, strict=True))
        return RideRanges((low, high), grown)

    def report(self, step: int, errors: Sequence[float]) -> bool:
        """Take the errors e_i of a validation and return whether a part was passed.

        A validation is fully successful when every ride's error is at most eta_e (Eq. 13).
        """
        if self.finished or max(errors) > VALIDATION_THRESHOLD / DISTANCE_THRESHOLD:
            return False
        self.part += 1
        self.entered_at = step
        if self.part > PARTS:
            self.finished_at = step
        return True


def _between(a: float, b: float, share: float) -> float:
    return a + (b - a) * share
