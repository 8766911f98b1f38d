"""Episodes among others: machines close behind each other somewhere on a circuit, or on its grid, rivals ever stronger.

The rivals are classical riders that ride a part of their speed, at the end all of it, as fast as the learner's guide;
or policies that race, which may be the learner's earlier selves. Their strength grows in stages, or self-paced by the
returns (`spdl.py`): then all rivals of a race ride the same part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from bike_sim.sim.race import GRID_SHARE, GRID_SPACING, GRID_SPEED, grid_offset
from bike_sim.sim.request import IDEAL, Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_training.curricula.base import EndedEpisode
from bike_training.curricula.race import CircuitSet, RaceCurriculum, RaceCurriculumSettings
from bike_training.curricula.spdl import Gaussian, PacedContexts, PacedCurriculum
from bike_training.settings import AT_LEAST_1, POSITIVE, check_number
from bike_training.tasks.race import RaceContext

START_SHARE: Final = 0.88
"""Part of the theoretical speed at its place that a start on the way has: about that of the riders there."""
GAPS: Final = (0.3, 0.7)
"""Times between machines at such a start, s."""
FIRST: Final = Gaussian.with_std([0.15], [0.15])
TARGET: Final = Gaussian.with_std([1.0], [0.04])
LEAST_STD: Final = (0.04,)
"""Distribution of the scaled strength at the beginning and at the end, where SPDL paces it."""
BESIDE: Final = 1.0
"""Largest distance of such a start from the followed line, m."""


@dataclass(frozen=True, kw_only=True)
class RivalsSettings(RaceCurriculumSettings):
    """Settings of the curriculum of races; validations and comparisons, which are ridden alone, are left out.

    Attributes:
        curriculum: ``rivals``.
        rivals: in each race.
        learners: in each race; rivals and learners make 2 to 12 machines.
        strengths: least part of their speed that rivals ride, stage by stage; each draws between it and all.
        stage: learning steps of each stage but the last.
        grid: part of the races that begin on the grid, at the start line; the others begin anywhere.
        front: part of the races in which learners begin on any place; in the others each begins behind a rival.
        riders: of the rivals, which take them in turn: `classical`, or policies that race, which ride all they can.
    """

    limits: ClassVar = {
        **RaceCurriculumSettings.limits,
        **dict.fromkeys(("rivals", "learners"), (1.0, 11.0)),
        "stage": AT_LEAST_1,
        **dict.fromkeys(("grid", "front"), (0.0, 1.0)),
    }

    curriculum: str = "rivals"
    rivals: int = 4
    learners: int = 2
    strengths: tuple[float, ...] = (0.9, 0.95, 1.0)
    stage: int = 30_000
    grid: float = 0.3
    front: float = 0.3
    riders: tuple[str, ...] = ("classical",)

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        check_number("curriculum.rivals+learners", self.machines, 2, 12)
        for strength in self.strengths or (0.0,):
            check_number("curriculum.strengths", strength, 0.5, 1.2)
        if not self.riders or not all(name.strip() for name in self.riders):
            raise ValueError(f"setting curriculum.riders={list(self.riders)} must name riders, as classical")

    @property
    def machines(self) -> int:
        """Number of machines in a race."""
        return self.rivals + self.learners

    def make(self, vehicles: Sequence[Vehicle]) -> RivalsCurriculum:
        """Return the curriculum at its beginning."""
        return RivalsCurriculum(CircuitSet(vehicles, self.circuits), self)


class RivalsCurriculum(RaceCurriculum):
    """Races of learners among classical riders, in stages of their strength.

    It knows no validation: how well races are ridden is seen in races.
    """

    settings: RivalsSettings

    def __init__(self, circuits: CircuitSet, settings: RivalsSettings | None = None) -> None:
        """Begin with the weakest rivals."""
        super().__init__(circuits, settings or RivalsSettings())

    def imitated(self) -> RivalsCurriculum:
        """Return itself, in its last stage."""
        return self.episodes(self.settings.stage * len(self.settings.strengths))

    def may_validate(self, step: int) -> bool:
        """Return that no validation is ridden."""
        return False

    def episodes(self, step: int) -> RivalsCurriculum:
        """Return itself, in the stage of a learning step."""
        self.part = min(1 + step // self.settings.stage, len(self.settings.strengths))
        return self

    def strength(self, rng: np.random.Generator) -> float:
        """Draw which part of its speed a rival rides."""
        least = self.settings.strengths[self.part - 1]
        return float(rng.uniform(min(least, 1.0), max(least, 1.0)))

    def race_context(self, rng: np.random.Generator) -> tuple[RaceContext, list[float]]:
        """Draw what a race asks, and which part of its speed each rival rides."""
        return RaceContext(), [self.strength(rng) for _ in range(self.settings.rivals)]

    def draw_race(self, rng: np.random.Generator, preview: Preview, race: int) -> list[ResetRequest]:
        """Draw how the machines of a race begin: learners first, then the rivals.

        Args:
            rng: draws.
            preview: what the task needs to see of the course.
            race: number of the race, which decides which machine is ridden and, where they are dealt, the circuits.
        """
        settings, circuits = self.settings, self.circuits
        names = circuits.dealt(race) if settings.dealt else circuits.names
        name = names[int(rng.integers(len(names)))]
        context, strengths = self.race_context(rng)
        shares = [*[1.0] * settings.learners, *strengths]
        order = sorted(range(settings.machines), key=lambda row: (row % settings.learners, row < settings.learners))
        if rng.random() < settings.front:
            order = rng.permutation(settings.machines).tolist()
        starts = self._grid(name, race) if rng.random() < settings.grid else self._on_the_way(name, race, rng)
        requests: dict[int, ResetRequest] = {}
        for row, start in zip(order, starts, strict=True):
            asked = tuple(context._replace(share=shares[row]))
            requests[row] = replace(start, seed=int(rng.integers(2**31)), preview=preview, context=asked)
        return [requests[row] for row in range(settings.machines)]

    def _grid(self, name: str, race: int) -> list[ResetRequest]:
        """Return the places of a grid, the first one first."""
        circuits, length = self.circuits, self.circuits.length(name)
        track = circuits.line(name, IDEAL, race).track
        places = [length - GRID_SPACING * number for number in range(1, self.settings.machines + 1)]
        speed = min(GRID_SPEED, *(circuits.start(name, IDEAL, place, GRID_SHARE, race) for place in places))
        return [
            _start(name, place, speed, grid_offset(track, place, number, IDEAL))
            for number, place in enumerate(places, start=1)
        ]

    def _on_the_way(self, name: str, race: int, rng: np.random.Generator) -> list[ResetRequest]:
        """Draw a place for each machine, the first one first, each close behind the one before."""
        circuits, length = self.circuits, self.circuits.length(name)
        place, starts = float(rng.uniform(min(300.0, 0.5 * length), length)), []
        for _ in range(self.settings.machines):
            speed = max(circuits.start(name, IDEAL, place, START_SHARE, race), 5.0)
            starts.append(_start(name, place, speed, float(rng.uniform(-BESIDE, BESIDE))))
            place = max(place - float(rng.uniform(*GAPS)) * speed, 0.0)
        return starts


@dataclass(frozen=True, kw_only=True)
class SpdlRivalsSettings(RivalsSettings):
    """Settings of rivals whose strength SPDL paces, from the first of `strengths` to all of their speed.

    Attributes:
        curriculum: ``spdl_rivals``.
        iteration: learning steps between two updates.
        threshold: expected return of an episode that must be kept (delta).
        kl: largest divergence of an update, nat (epsilon).
    """

    limits: ClassVar = {
        **RivalsSettings.limits,
        "iteration": AT_LEAST_1,
        "threshold": (-math.inf, math.inf),
        "kl": POSITIVE,
    }

    curriculum: str = "spdl_rivals"
    iteration: int = 3000
    threshold: float = 0.0
    kl: float = 0.05

    def __post_init__(self) -> None:
        """Refuse a range of strengths that is none."""
        super().__post_init__()
        check_number("curriculum.strengths", self.strengths[0] if self.strengths else 1.0, 0.5, 0.99)

    def make(self, vehicles: Sequence[Vehicle]) -> SpdlRivalsCurriculum:
        """Return the curriculum at its beginning."""
        return SpdlRivalsCurriculum(CircuitSet(vehicles, self.circuits), self)


class SpdlRivalsCurriculum(PacedCurriculum, RivalsCurriculum):
    """Races whose rivals all ride the same part of their speed; the context is 0 at the first of `strengths`."""

    settings: SpdlRivalsSettings

    def __init__(self, circuits: CircuitSet, settings: SpdlRivalsSettings | None = None) -> None:
        """Begin with the weakest rivals."""
        super().__init__(circuits, settings or SpdlRivalsSettings())
        self.contexts = PacedContexts(("strength",), FIRST, TARGET, LEAST_STD)

    def episodes(self, step: int) -> SpdlRivalsCurriculum:
        """Return itself, after the update of an iteration that has ended."""
        if self.contexts.due(step, self.settings.iteration):
            self.contexts.pace(step, self.settings.threshold, self.settings.kl)
        return self

    def race_context(self, rng: np.random.Generator) -> tuple[RaceContext, list[float]]:
        """Draw one strength for all rivals."""
        (scaled,), number = self.contexts.draw(rng)
        strength = 1.0 + (float(scaled) - 1.0) * (1.0 - self.settings.strengths[0])
        return RaceContext(number=number, rivals=strength), [strength] * self.settings.rivals

    def ended(self, episode: EndedEpisode) -> None:
        """Keep the return of a learner's episode."""
        super().ended(episode)
        context = RaceContext.of(episode.request)
        if context is not None:
            scaled = 1.0 - (1.0 - context.rivals) / (1.0 - self.settings.strengths[0])
            self.contexts.ended(np.array([scaled]), context.number, episode.total)


def _start(name: str, progress: float, speed: float, offset: float) -> ResetRequest:
    return ResetRequest(course=name, line=IDEAL, speed_range=(speed, speed), progress=progress, start_offset=offset)
