"""The self-paced curriculum of the superbike paper (V): from the median at low speed to the ideal line at full speed.

The context (d_median, d_ideal, v_max) of an episode decides which line is followed (Eq. 3) and which speed is allowed.
Its distribution moves towards the target as the returns allow; see `self_paced`. Two baselines draw from the same
distributions and differ in nothing else: one has the target from the beginning, one moves to it by a fixed schedule.

Self-paced distribution of contexts: as near to the target as the performance allows.

Source: Klink, Abdulsamad, Belousov, D'Eramo, Peters, Pajarinen (2021), A probabilistic interpretation of self-paced
learning with applications to reinforcement learning, JMLR 22(182), Sect. 6 (the version with one threshold, "v2" of
their code). Written from the description; values of contexts are the measured returns of their episodes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from bike_sim.vehicles.bicycle import Vehicle
from bike_training.curricula.base import EndedEpisode
from bike_training.curricula.race import LINE_STEPS, CircuitSet, RaceCurriculum, RaceCurriculumSettings
from bike_training.settings import AT_LEAST_0, AT_LEAST_1, POSITIVE
from bike_training.tasks.race import RaceContext

FloatArray = NDArray[np.float64]


class Gaussian(NamedTuple):
    """A normal distribution.

    Attributes:
        mean: shape (d,).
        factor: lower triangular L of the covariance L L^T, shape (d, d).
    """

    mean: FloatArray
    factor: FloatArray

    @classmethod
    def with_std(cls, mean: Any, std: Any) -> Gaussian:
        """Return one with independent numbers."""
        return cls(np.array(mean, dtype=np.float64), np.diag(np.array(std, dtype=np.float64)))

    @property
    def std(self) -> FloatArray:
        """Standard deviation of each number."""
        return np.asarray(np.sqrt(np.sum(self.factor**2, axis=1)))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Return the logarithm of the density at points, shape (n, d)."""
        scaled = np.linalg.solve(self.factor, (points - self.mean).T)
        log_volume = float(np.sum(np.log(np.diag(self.factor))))
        return -0.5 * np.sum(scaled**2, axis=0) - log_volume - 0.5 * len(self.mean) * math.log(2.0 * math.pi)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Draw a point, shape (d,)."""
        return np.asarray(self.mean + self.factor @ rng.standard_normal(len(self.mean)))

    def to_flat(self) -> FloatArray:
        """Return mean, logarithms of the diagonal of L, and what lies below it (Klink et al. 2021)."""
        below = self.factor[np.tril_indices(len(self.mean), -1)]
        return np.concatenate((self.mean, np.log(np.diag(self.factor)), below))

    @classmethod
    def from_flat(cls, flat: FloatArray) -> Gaussian:
        """Return the distribution of :meth:`to_flat`."""
        size = next(d for d in range(1, 100) if d + d * (d + 1) // 2 >= len(flat))
        factor = np.diag(np.exp(flat[size : 2 * size]))
        factor[np.tril_indices(size, -1)] = flat[2 * size :]
        return cls(flat[:size].copy(), factor)


def divergence(p: Gaussian, q: Gaussian) -> float:
    """Return the Kullback-Leibler divergence KL(p || q), nat, in closed form."""
    ratio = np.linalg.solve(q.factor, p.factor)
    apart = np.linalg.solve(q.factor, q.mean - p.mean)
    log_ratio = np.sum(np.log(np.diag(q.factor))) - np.sum(np.log(np.diag(p.factor)))
    return float(log_ratio + 0.5 * (np.sum(ratio**2) + np.sum(apart**2) - len(p.mean)))


TOLERANCE: Final = 1e-3
"""By which a solution may violate a constraint, as a part of its bound: solvers report success with more."""
ITERATIONS: Final = 60
FARTHEST: Final = 5.0
"""Largest change of a parameter in an update."""


HARDER, EASIER, WAITS = "towards the target", "towards contexts of higher value", "waits for the agent"
"""What an update did."""


class Update(NamedTuple):
    """Outcome of an update.

    Attributes:
        distribution: from now on.
        stage: what was done.
        value: expected value under it, estimated from the contexts.
        before: the same under the one before.
    """

    distribution: Gaussian
    stage: str
    value: float
    before: float


def self_paced(
    old: Gaussian,
    target: Gaussian,
    episodes: tuple[FloatArray, FloatArray, FloatArray],
    threshold: float,
    reached: bool,
    step: float = 0.05,
    least_std: FloatArray | None = None,
    far: float = 50.0,
) -> Update:
    """Return the next distribution.

    Args:
        old: the present one.
        target: distribution that all ends with.
        episodes: their contexts, shape (n, d), the logarithm of the density that each was drawn with, and their values,
            shape (n,).
        threshold: expected value that must be kept (delta).
        reached: whether the threshold was ever met.
        step: largest KL(old || new), nat (epsilon).
        least_std: least standard deviation of each number while the target is far, or None.
        far: KL(old || target) up to which it is not far, nat.
    """
    contexts, sampled, values = episodes

    def value(distribution: Gaussian) -> float:
        ratio = distribution.log_density(contexts) - sampled
        weights = np.exp(ratio - np.max(ratio))  # normalised below, so that values may be shifted
        return float(np.sum(weights * values) / np.sum(weights))

    size, flat = len(old.mean), old.to_flat()
    # Far beyond any step that the divergence allows; keeps the solver's trials finite.
    bounds: list[tuple[float, float]] = [(number - FARTHEST, number + FARTHEST) for number in flat]
    if least_std is not None and divergence(old, target) > far:
        for k, low in enumerate(map(math.log, least_std), start=size):
            bounds[k] = (low, max(low, flat[k]) + FARTHEST)
    begin = Gaussian.from_flat(np.maximum(flat, [low for low, _ in bounds]))
    before = value(begin)
    keeps = before >= threshold
    if not keeps and reached:
        return Update(old, WAITS, before, before)

    def cost(flat: FloatArray) -> float:
        new = Gaussian.from_flat(flat)
        return divergence(new, target) if keeps else -value(new)

    def room(flat: FloatArray) -> FloatArray:
        new = Gaussian.from_flat(flat)
        left = [(step - divergence(old, new)) / step]
        if keeps:
            left.append((value(new) - threshold) / max(abs(threshold), 1.0))
        return np.array(left)

    found = _minimum(cost, room, begin, bounds)
    return Update(found, HARDER if keeps else EASIER, value(found), before)


def _minimum(
    cost: Callable[[FloatArray], float],
    room: Callable[[FloatArray], FloatArray],
    begin: Gaussian,
    bounds: list[tuple[float, float]],
) -> Gaussian:
    """Minimise a cost within the constraints; where nothing better keeps them, return the beginning."""
    first = begin.to_flat()
    found = minimize(
        cost,
        first,
        method="SLSQP",
        bounds=bounds,
        constraints={"type": "ineq", "fun": room},
        options={"maxiter": ITERATIONS, "ftol": 1e-6},
    ).x
    # Where the solver ends outside, the way back to the beginning leads inside again.
    for _ in range(20 if np.all(np.isfinite(found)) else 0):
        if np.all(room(found) >= -TOLERANCE) and cost(found) <= cost(first):
            return Gaussian.from_flat(found)
        found = 0.5 * (found + first)
    return begin


SLOWEST: Final = 25.0
FASTEST: Final = 90.0
"""Speed limits that the scaled context 0 and 1 mean, m/s; the second is more than any machine reaches (ours)."""
FIRST_MEAN: Final = (0.15, 0.85, 0.25)
FIRST_STD: Final = (0.15, 0.15, 0.15)
TARGET_MEAN: Final = (1.0, 0.0, 1.0)
TARGET_STD: Final = (0.04, 0.04, 0.04)
LEAST_STD: Final = (0.04, 0.04, 0.04)
"""Distribution of the scaled context at the beginning and at the end; neither is published."""
FIRST: Final = Gaussian.with_std(FIRST_MEAN, FIRST_STD)
MAX_EPISODES: Final = 1000
LEAST_EPISODES: Final = 10
"""Episodes of an update: all that have ended since the one before, as in the reference implementation."""
NAMES: Final = ("d_median", "d_ideal", "v_max")
_NORMAL_DRAWS: Final = np.random.default_rng(0).standard_normal((8192, len(NAMES)))


def line_of(d_median: float, d_ideal: float, v_max: float) -> float:
    """Return which line is followed, 0 the median, 1 the ideal line (Eq. 3, as its text describes it).

    The formula itself could not be read: "the first term combines the distances to indicate which spline is closest,
    while [the second] normalises the speed; both are weighted equally". So it is the mean of both.

    Args:
        d_median: distance from the median line, as a part of that of the ideal line.
        d_ideal: distance from the ideal line, the same.
        v_max: speed limit, m/s.
    """
    apart = max(d_median + d_ideal, 1e-9)
    lam = 0.5 * (d_median / apart + min(v_max / FASTEST, 1.0))
    return round(min(max(lam, 0.0), 1.0) * LINE_STEPS) / LINE_STEPS


def log_mass_inside(distribution: Gaussian) -> float:
    """Return the logarithm of the probability of a scaled context within [0, 1], from fixed draws.

    Contexts are drawn within, so their density is the Gaussian's divided by this.
    """
    drawn = distribution.mean + _NORMAL_DRAWS[:, : len(distribution.mean)] @ distribution.factor.T
    inside = int(np.count_nonzero(np.all((drawn >= 0.0) & (drawn <= 1.0), axis=1)))
    return math.log(max(inside, 1) / len(drawn))


def scheduled(target: Gaussian, part: float) -> Gaussian:
    """Return the distribution at a part of a fixed schedule from the first one (0) to the target (1 and beyond).

    The mean and the logarithm of the standard deviation grow evenly.
    """
    part = min(max(part, 0.0), 1.0)
    flat = (1.0 - part) * FIRST.to_flat() + part * target.to_flat()
    return Gaussian.from_flat(flat)


@dataclass(frozen=True, kw_only=True)
class TargetSettings(RaceCurriculumSettings):
    """Settings of the baseline that draws from the target from the beginning.

    Attributes:
        curriculum: ``target``.
        iteration: learning steps between two rows of the log.
    """

    limits: ClassVar = {**RaceCurriculumSettings.limits, "iteration": AT_LEAST_1}

    curriculum: str = "target"
    iteration: int = 5000

    def make(self, vehicles: Sequence[Vehicle]) -> SpdlCurriculum:
        """Return the curriculum at its beginning."""
        return SpdlCurriculum(CircuitSet(vehicles, self.circuits), self)


@dataclass(frozen=True, kw_only=True)
class ScheduleSettings(TargetSettings):
    """Settings of the baseline that moves to the target by a fixed schedule.

    Attributes:
        curriculum: ``schedule``.
        schedule: learning steps after which it is at the target.
        stages: jumps in which it goes there, as a curriculum made by hand; 0 for an even move.
    """

    limits: ClassVar = {**TargetSettings.limits, "schedule": AT_LEAST_1, "stages": AT_LEAST_0}

    curriculum: str = "schedule"
    schedule: int = 150_000
    stages: int = 0


@dataclass(frozen=True, kw_only=True)
class SpdlSettings(TargetSettings):
    """Settings of SPDL.

    Attributes:
        curriculum: ``spdl``.
        threshold: expected return of an episode that must be kept (delta).
        kl: largest divergence of an update, nat (epsilon).
    """

    limits: ClassVar = {**TargetSettings.limits, "threshold": (-math.inf, math.inf), "kl": POSITIVE}

    curriculum: str = "spdl"
    threshold: float = 500.0
    kl: float = 0.05


class PacedContexts:
    """Distribution of scaled contexts that moves to its target, and the episodes since its last update.

    Attributes:
        distribution: of the scaled context.
        target: distribution that all ends with.
        steps: updates so far, a row each: its number, learning step, what it did, mean and standard deviation of each
            number of the scaled context, divergence to the target (nat), and expected return before.
    """

    def __init__(self, names: Sequence[str], first: Gaussian, target: Gaussian, least_std: Sequence[float]) -> None:
        """Begin with a distribution of named numbers; `least_std` is that of each while the target is far."""
        self.distribution, self.target = first, target
        self._names, self._least_std = tuple(names), np.array(least_std)
        self.steps: list[list[Any]] = []
        self._seen: deque[tuple[FloatArray, float, float]] = deque(maxlen=MAX_EPISODES)
        self._reached = False
        self._updated = 0
        self._history = [first]

    def draw(self, rng: np.random.Generator) -> tuple[FloatArray, float]:
        """Return a scaled context and the number of the distribution that it was drawn from.

        What lies outside of [0, 1] is drawn anew, so that the density stays that of the Gaussian.
        """
        for _ in range(100):
            drawn = self.distribution.draw(rng)
            if np.all((drawn >= -1e-9) & (drawn <= 1.0)):
                break
        return np.clip(drawn, 0.0, 1.0), float(len(self._history) - 1)

    def ended(self, scaled: FloatArray, number: float, total: float) -> None:
        """Keep the return of an episode with the density that its context was drawn with."""
        drawn_from = self._history[int(number)]
        density = float(drawn_from.log_density(scaled[None])[0]) - log_mass_inside(drawn_from)
        self._seen.append((scaled, density, total))

    def due(self, step: int, iteration: int) -> bool:
        """Return whether an iteration has ended, and begin the next one."""
        if step - self._updated < iteration:
            return False
        self._updated = step
        return True

    def pace(self, step: int, threshold: float, kl: float) -> None:
        """Move as the returns allow; see `self_paced`."""
        if len(self._seen) < LEAST_EPISODES:
            self.move(step, None)
            return
        contexts, sampled, values = (np.array(part) for part in zip(*self._seen, strict=True))
        limits = threshold, self._reached, kl, self._least_std
        found, stage, _, value = self_paced(self.distribution, self.target, (contexts, sampled, values), *limits)
        self._reached |= stage == HARDER
        self.move(step, found, stage, value)

    def move(self, step: int, found: Gaussian | None, stage: str = WAITS, value: float | None = None) -> None:
        """Go on with another distribution, or none, and note a row of the log."""
        if value is None:
            value = float(np.mean([seen[2] for seen in self._seen])) if self._seen else float("nan")
        if found is not None:
            self.distribution = found
            self._history.append(found)
            self._seen.clear()
        now = self.distribution
        apart = divergence(now, self.target)
        self.steps.append([len(self.steps) + 1, step, stage, now.mean.tolist(), now.std.tolist(), apart, value])

    def figures(self) -> dict[str, float]:
        """Return mean and standard deviation of the scaled context, its divergence to the target, and the value."""
        if not self.steps:
            return {}
        *_, mean, std, kl, value = self.steps[-1]
        means = {f"mean_{name}": number for name, number in zip(self._names, mean, strict=True)}
        stds = {f"std_{name}": number for name, number in zip(self._names, std, strict=True)}
        return {**means, **stds, "kl_to_target": kl, "value": value}

    def state_dict(self) -> dict[str, Any]:
        """Return where it stands."""
        size = len(self.target.mean)
        return {
            "distributions": np.array([each.to_flat() for each in self._history]),
            "seen": np.array([[*each, sampled, value] for each, sampled, value in self._seen]).reshape(-1, size + 2),
            "reached": self._reached,
            "updated": self._updated,
            "steps": list(self.steps),
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue."""
        self._history = [Gaussian.from_flat(flat) for flat in stored["distributions"]]
        self.distribution = self._history[-1]
        self._seen.clear()
        self._seen.extend((row[:-2].copy(), float(row[-2]), float(row[-1])) for row in stored["seen"])
        self._reached, self._updated, self.steps = stored["reached"], stored["updated"], list(stored["steps"])


class PacedCurriculum(RaceCurriculum):
    """Episodes whose contexts are paced.

    Attributes:
        contexts: their distribution.
    """

    contexts: PacedContexts

    def figures(self) -> dict[str, float]:
        """Return where the distribution is."""
        return {**super().figures(), **self.contexts.figures()}

    def state_dict(self) -> dict[str, Any]:
        """Return where it stands."""
        return {**super().state_dict(), **self.contexts.state_dict()}

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue."""
        super().restore(stored)
        self.contexts.restore(stored)


class SpdlCurriculum(PacedCurriculum):
    """SPDL with one threshold, or a baseline of it; the contexts are d_median, d_ideal and v_max, scaled."""

    settings: TargetSettings

    def __init__(self, circuits: CircuitSet, settings: TargetSettings | None = None) -> None:
        """Begin near the median at low speed, or with the target."""
        settings = settings or SpdlSettings()
        super().__init__(circuits, settings)
        target = Gaussian.with_std(TARGET_MEAN, TARGET_STD)
        begins_easy = isinstance(settings, SpdlSettings | ScheduleSettings)
        self.contexts = PacedContexts(NAMES, FIRST if begins_easy else target, target, LEAST_STD)

    def context(self, rng: np.random.Generator) -> RaceContext:
        """Draw a context."""
        (d_median, d_ideal, fast), number = self.contexts.draw(rng)
        share = super().context(rng).share
        v_max = SLOWEST + float(fast) * (FASTEST - SLOWEST)
        return RaceContext(float(d_median), float(d_ideal), v_max, share, number)

    def line(self, context: RaceContext) -> float:
        """Return the line of Eq. (3)."""
        return line_of(context.d_median, context.d_ideal, context.v_max)

    def episodes(self, step: int) -> RaceCurriculum:
        """Return itself, after the update of an iteration that has ended."""
        settings, contexts = self.settings, self.contexts
        if not contexts.due(step, settings.iteration):
            return self
        if isinstance(settings, ScheduleSettings):
            part = step / settings.schedule
            part = math.floor(part * settings.stages) / settings.stages if settings.stages else part
            contexts.move(step, scheduled(contexts.target, part), HARDER)
        elif isinstance(settings, SpdlSettings):
            contexts.pace(step, settings.threshold, settings.kl)
        else:
            contexts.move(step, None)
        return self

    def ended(self, episode: EndedEpisode) -> None:
        """Keep the return of an episode."""
        super().ended(episode)
        context = RaceContext.of(episode.request)
        if context is not None:
            fast = (context.v_max - SLOWEST) / (FASTEST - SLOWEST)
            scaled = np.array([context.d_median, context.d_ideal, fast])
            self.contexts.ended(scaled, context.number, episode.total)
