"""Episodes of races: starts along circuits, more often where rides fail.

`RaceCurriculum` asks the same of every episode; the self-paced one is in `spdl.py`. Both are the distribution of their
episodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.planning.reference import KEPT
from bike_sim.course.files import load_track, shipped_tracks
from bike_sim.planning.envelope import Envelope, envelope
from bike_sim.planning.line_cache import track_with_line
from bike_sim.sim.followed_line import FollowedLine
from bike_sim.sim.request import IDEAL, Preview, ResetRequest
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.curricula.base import Curriculum, CurriculumSettings, EndedEpisode
from bike_training.settings import AT_LEAST_1, POSITIVE, check_number
from bike_training.tasks.race import RaceContext

FloatArray = NDArray[np.float64]

SLOWEST_START: Final = 0.35
"""Least part of the theoretical speed at its place that a start has."""
START_OFFSET: Final = 0.7
"""Largest distance of a start from the followed line, m."""
BIN: Final = 50.0
"""Length of the sections by which failures are counted, m."""
RUN_UP: Final = (2.0, 7.0)
"""Starts that lead up to a failure lie so long before it, s."""
FORGET: Final = 0.98
"""Part of the count of failures that an episode leaves."""
LINE_STEPS: Final = 20
"""Lines between median and ideal line are rounded to this many, for each must be planned."""
VALIDATION_STARTS: Final = 4
"""Starts of a validation on each of its circuits."""
SELECTION_STARTS: Final = 32
LEAST_STARTS: Final = 8
"""Starts of a comparison of actors on one circuit, and on each of many."""
SELECTION_SEED: Final = 2**32


class CircuitSet:
    """Circuits of machines: their lines with the theoretical speeds on them. Rows take the machines in turn.

    Attributes:
        names: of the circuits.
    """

    def __init__(self, vehicles: Vehicle | Sequence[Vehicle], circuits: Sequence[str]) -> None:
        """Load circuits.

        Raises:
            ValueError: a vehicle that is no superbike, or no circuits. FileNotFoundError: an unknown circuit.
        """
        vehicles = [vehicles] if isinstance(vehicles, Vehicle) else vehicles
        for vehicle in vehicles:
            if not isinstance(vehicle, Superbike):
                raise ValueError(f"races are for superbikes, and {vehicle.name!r} is none")
        if not circuits:
            raise ValueError(f"a race needs a circuit; there are {', '.join(shipped_tracks())}")
        self.names = tuple(circuits)
        self._limits: list[Envelope] = [envelope(vehicle) for vehicle in vehicles if isinstance(vehicle, Superbike)]
        # The fastest line of a machine takes seconds, so it is computed for those that ride a circuit.
        self._track = cache(lambda name, machine: track_with_line(name, self._limits[machine]))
        self._lines = lru_cache(KEPT)(lambda name, lam, machine: FollowedLine(self._track(name, machine), lam))
        self._lengths = {name: load_track(name).length for name in circuits}

    def length(self, name: str) -> float:
        """Return the length of a circuit's centre line, m."""
        return self._lengths[name]

    def dealt(self, row: int) -> tuple[str, ...]:
        """Return the circuits of a row's machine, where machines share them out among themselves."""
        return self.names[row % self.machines :: self.machines] or self.names

    @property
    def machines(self) -> int:
        """Number of the machines."""
        return len(self._limits)

    def line(self, name: str, lam: float, row: int = 0) -> FollowedLine:
        """Return a line of a circuit, 0 the median, 1 the ideal line of a row's machine."""
        return self._lines(name, lam, row % len(self._limits))

    def start(self, name: str, lam: float, progress: float, share: float, row: int = 0) -> float:
        """Return a share of the theoretical speed of a row's machine at a progress along the centre line (m), m/s."""
        followed = self.line(name, lam, row)
        limits = self._limits[row % len(self._limits)]
        return share * float(followed.limit(limits).speed_at(followed.place(progress)))


@dataclass(frozen=True, kw_only=True)
class RaceCurriculumSettings(CurriculumSettings):
    """Settings of the curriculum that asks the same of every episode.

    Attributes:
        curriculum: ``none``.
        circuits: names or files of circuits.
        dealt: whether several machines share the circuits out among themselves, so that there are fewer lines to plan.
        share: part of the planned speed that is asked in the end.
        spread: half width of the interval that the share of an episode is drawn from.
        failure_share: part of the starts that lead up to where rides failed lately.
        start_line: whether the other starts are at the start line, instead of anywhere.
        fastest_start: largest part of the theoretical speed at its place that a start has.
        whole_share: part of a validation's rides that must be whole to finish.
        sampled: most circuits that a validation rides, drawn anew for each; comparisons ride the first ones.
        validate_every: least learning steps between two validations.
        select_every: learning steps between two comparisons of actors, once a validation was whole.
    """

    limits: ClassVar = {
        "share": POSITIVE,
        "failure_share": (0.0, 1.0),
        "fastest_start": (SLOWEST_START, 1.0),
        "whole_share": (0.0, 1.0),
        **dict.fromkeys(("sampled", "validate_every", "select_every"), AT_LEAST_1),
    }

    curriculum: str = "none"
    circuits: tuple[str, ...] = ("barcelona",)
    dealt: bool = False
    share: float = 1.0
    spread: float = 0.0
    failure_share: float = 0.0
    start_line: bool = False
    fastest_start: float = 0.95
    whole_share: float = 1.0
    sampled: int = 12
    validate_every: int = 10_000
    select_every: int = 30_000

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        check_number("curriculum.spread", self.spread, 0.0, 0.9 * self.share)
        if not self.circuits or not all(name.strip() for name in self.circuits):
            raise ValueError(f"setting curriculum.circuits={list(self.circuits)} must name circuits")

    def make(self, vehicles: Sequence[Vehicle]) -> RaceCurriculum:
        """Return the curriculum at its beginning."""
        return RaceCurriculum(CircuitSet(vehicles, self.circuits), self)


class RaceCurriculum(Curriculum):
    """The same asked of every episode.

    It is finished when all rides of a validation (or `whole_share` of them) were whole: laps from several places, with
    never both contact points outside. Learning goes on, and actors are compared from then on.

    Attributes:
        circuits: that are ridden.
        failures: how often rides failed lately in each section of each circuit.
    """

    def __init__(self, circuits: CircuitSet, settings: RaceCurriculumSettings | None = None) -> None:
        """Begin without failures."""
        self.circuits, self.settings = circuits, settings or RaceCurriculumSettings()
        self.failures = {name: np.zeros(math.ceil(circuits.length(name) / BIN)) for name in circuits.names}

    def episodes(self, step: int) -> RaceCurriculum:
        """Return itself."""
        return self

    def context(self, rng: np.random.Generator) -> RaceContext:
        """Draw what an episode asks."""
        return RaceContext(share=self.settings.share + self.settings.spread * float(rng.uniform(-1.0, 1.0)))

    def line(self, context: RaceContext) -> float:
        """Return which line is followed."""
        return IDEAL

    def draw(self, rng: np.random.Generator, preview: Preview, row: int = 0) -> ResetRequest:
        """Draw how an episode begins; see `Episodes`."""
        circuits, settings = self.circuits, self.settings
        names = circuits.dealt(row) if settings.dealt else circuits.names
        name = names[int(rng.integers(len(names)))]
        context = self.context(rng)
        lam = self.line(context)
        length = circuits.length(name)
        progress = float(rng.uniform(0.0, length)) * (not settings.start_line)
        failed = self._failure(name, rng) if rng.random() < settings.failure_share else None
        if failed is not None:
            before = float(rng.uniform(*RUN_UP)) * circuits.start(name, lam, failed % length, 1.0, row)
            progress = (failed - before) % length
        share = float(rng.uniform(SLOWEST_START, settings.fastest_start)) * min(1.0, context.share)
        speed = min(max(circuits.start(name, lam, progress, share, row), 5.0), context.v_max)
        return ResetRequest(
            seed=int(rng.integers(2**31)),
            course=name,
            speed_range=(speed, speed),
            perturb=True,
            line=lam,
            progress=progress,
            start_offset=float(rng.uniform(-START_OFFSET, START_OFFSET)),
            preview=preview,
            context=tuple(context),
        )

    def _failure(self, name: str, rng: np.random.Generator) -> float | None:
        """Return a place where rides have failed lately, m, or None where none has."""
        count = self.failures[name]
        total = float(count.sum())
        if total < 0.5:
            return None
        place = rng.choice(len(count), p=count / total)
        return (int(place) + float(rng.random())) * BIN

    def validation_requests(self, preview: Preview, rng: np.random.Generator) -> list[ResetRequest]:
        """Draw circuits, and rides from places around each of them."""
        shift, seed = float(rng.random()), int(rng.integers(2**31))
        names = self.circuits.names
        if len(names) > self.settings.sampled:
            names = tuple(names[i] for i in sorted(rng.choice(len(names), self.settings.sampled, replace=False)))
        return self._around(names, VALIDATION_STARTS, shift, 0.8, preview, seed)

    def selection_requests(self, preview: Preview) -> list[ResetRequest]:
        """Return rides from the same places around each circuit, at speeds from 0.5 to 0.9 of the theoretical."""
        names = self.circuits.names[: self.settings.sampled]
        count = max(LEAST_STARTS, SELECTION_STARTS // len(names))
        return self._around(names, count, 0.0, None, preview, SELECTION_SEED)

    def _around(
        self, names: Sequence[str], count: int, shift: float, share: float | None, preview: Preview, seed: int
    ) -> list[ResetRequest]:
        found: list[ResetRequest] = []
        for row in range(len(names) * count):
            name, k = names[row // count], row % count
            if self.settings.dealt:
                own = self.circuits.dealt(row)
                name = own[row // self.circuits.machines % len(own)]
            length = self.circuits.length(name)
            progress = (k + shift) / count * length % length
            part = share if share is not None else 0.5 + 0.4 * ((k * 0.6180339887) % 1.0)
            speed = max(self.circuits.start(name, IDEAL, progress, part, row), 5.0)
            found.append(
                ResetRequest(
                    seed=seed + k,
                    course=name,
                    speed_range=(speed, speed),
                    perturb=True,
                    progress=progress,
                    preview=preview,
                    context=tuple(RaceContext(share=self.settings.share)),
                )
            )
        return found

    def passes(self, errors: Sequence[float]) -> bool:
        """Return whether as many rides were whole as asked."""
        return float(np.mean(np.asarray(errors) < 1.0)) >= self.settings.whole_share

    def ended(self, episode: EndedEpisode) -> None:
        """Note where an episode failed; what was noted before counts less."""
        name = episode.request.course
        count = self.failures[name]
        count *= FORGET
        if episode.failed:
            count[int(episode.progress % self.circuits.length(name) / BIN) % len(count)] += 1.0

    def state_dict(self) -> dict[str, Any]:
        """Return where it stands."""
        return {**super().state_dict(), "failures": {name: count.copy() for name, count in self.failures.items()}}

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue."""
        super().restore(stored)
        for name, count in self.failures.items():
            count[:] = stored["failures"][name]
