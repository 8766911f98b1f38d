"""Learning through the model: an actor descends the gradient of its own rides.

Soft actor-critic learns from rewards what a command is worth. Here the compiled engine says it: rides of the present
actor come with their derivatives (`bike_training.learning.linear_rides`), a changed actor is ridden on them to first
order, and the cost of that ride (`bike_training.learning.refinement_cost`) is differentiated by the actor's weights.
One segment serves several updates, because a slightly changed actor stays close to the ride that the derivatives were
taken on. In the last periods of a segment the actor is held as it rode, so that what a command does later counts as
well. Related: the stochastic value gradients of Heess et al. (2015), without noise and with a model that need not be
learned.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from bike_policy.contract.actor import Actor
from bike_policy.contract.bundle import Bundle
from bike_sim.course.random_paths import PathRanges
from bike_sim.sim.bicycle_batch import COMPILED_ENGINE
from bike_sim.sim.config import SimulatorConfig
from bike_training.curricula.parts import REFINEMENT, SPEED_RANGES, RideRanges
from bike_training.learning.linear_rides import DEVIATIONS, SENSORS, LinearRides, Segment
from bike_training.learning.mirror_symmetric_actor import MirrorSymmetricActor
from bike_training.learning.refinement_comparison import STEEP, Comparison, compare
from bike_training.learning.refinement_cost import cost
from bike_training.learning.refinement_files import POLICY, TABLE
from bike_training.learning.refinement_settings import RefinementSettings
from bike_training.learning.run_settings import COMPILED_TIME_STEP
from bike_training.learning.summary import source_commit
from bike_training.tasks.path import TASKS

Float32Array = NDArray[np.float32]

VEHICLE: Final = "whipple"
"""The shipped bicycle; a refinement knows no other."""
_DEVIATION: Final = np.array([0.03, 0.01, 0.01, 0.01, 0.1, 0.1], dtype=np.float32)
"""Largest standard deviations of the deviations that rides are given in passing: m, rad, rad/s."""
_SMALLEST: Final = 0.03
"""Part of them that the smallest are drawn with: the loop is to be calm about a steady ride as well."""
_OFTEN: Final = 1.0 / 40.0
"""How often they are, a control period."""
STRAIGHT: Final = RideRanges((1.8, 7.3), PathRanges(200.0, 1000.0, 20.0, 22.0, 0.01, 0.5))
RIDES: Final = replace(REFINEMENT, also=(*REFINEMENT.also, STRAIGHT))
"""What is ridden: a third of the rides hardly bend, for on bent ones a bicycle is seldom upright for long."""
SLOW: Final = RideRanges((1.8, 2.6), REFINEMENT.paths)
"""Ridden as often as each of the others where rides are pushed: a push is worst where a bicycle is slow."""


class Refinement:
    """A refinement from its settings to its bundle.

    Attributes:
        settings: what it is. task: what is learned. segments: that were ridden.
        ridden: the last of them. last_cost: of its last update.
        best: what the best actor so far was judged by, or None. seconds: time spent learning, s.
    """

    ridden: Segment

    def __init__(self, settings: RefinementSettings, start: Bundle | None = None) -> None:
        """Prepare it.

        Args:
            settings: what it is.
            start: policy that it begins with; None begins from nothing.

        Raises:
            ValueError: a policy that sees something else than the task shows.
        """
        task = replace(TASKS[settings.task], max_steer=settings.max_steer)
        if start is not None and start.layout != task.layout:
            raise ValueError(f"policy {start.name!r} sees {start.layout.name!r}, the refinement {task.layout.name!r}")
        self.settings, self.task, self._start = settings, task, start
        self._config = SimulatorConfig(VEHICLE, COMPILED_ENGINE, COMPILED_TIME_STEP)
        self._rides = LinearRides(
            settings.bicycles,
            task,
            replace(RIDES, also=(*RIDES.also, SLOW)) if settings.impulse else RIDES,
            self._config,
            settings.seed,
            settings.delay,
            settings.noise,
            settings.impulse,
            STEEP,
            round(settings.steep * settings.bicycles),
        )
        largest = self._rides.batch.vehicle.max_steer
        self._actor = MirrorSymmetricActor(task.layout, task.action.columns[0].factor(largest))
        self._weights = (
            self._actor.draw(settings.layers, settings.seed)
            if start is None
            else self._actor.take(start.actor, start.action.columns[0].factor(largest))
        )
        self._mean = self._weights
        self._draws = np.random.default_rng([settings.seed, 1])
        rule = optax.chain(optax.clip_by_global_norm(1.0), optax.scale_by_adam())
        self._moments = rule.init(self._weights)
        self.segments = 0
        self.best: Comparison | None = None
        self._best_actor, self._best_at = self._folded(), 0
        self.seconds, self.last_cost = 0.0, math.nan
        self._commit = source_commit()  # now: sources may change while it learns

        @jax.jit
        def update(weights: Any, mean: Any, moments: Any, held: Any, given: Any, rate: Any) -> Any:
            value, slope = jax.value_and_grad(lambda w: cost(settings, self._actor, w, held, *given))(weights)
            move, moments = rule.update(slope, moments)
            weights = jax.tree.map(lambda w, m: w - rate * m, weights, move)
            keep = settings.averaging
            mean = jax.tree.map(lambda old, new: keep * old + (1.0 - keep) * new, mean, weights)
            return weights, mean, moments, value

        self._update = update

    def _folded(self) -> Actor:
        return self._actor.folded(self._mean)

    @property
    def rate(self) -> float:
        """The present learning rate."""
        done = self.segments / self.settings.segments
        first, last = self.settings.learning_rate, self.settings.final_learning_rate
        return last + (first - last) * 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0)))

    def learn(self) -> None:
        """Ride a segment and update the actor with it."""
        settings, began = self.settings, time.monotonic()
        held = self._weights
        self.ridden = self._rides.ride(self._actor.folded(held), settings.periods, settings.push)
        segment = Segment(*(jnp.asarray(part) for part in self.ridden))
        for _ in range(settings.updates):
            self._weights, self._mean, self._moments, value = self._update(
                self._weights, self._mean, self._moments, held, (segment, *self._draws_of(segment)), self.rate
            )
        self.segments += 1
        self.last_cost = float(value)
        self.seconds += time.monotonic() - began

    def _draws_of(self, segment: Segment) -> tuple[Float32Array, Float32Array]:
        """Return deviations that the rides are given, seldom and of all sizes, and errors of their sensors."""
        shape = (*segment.noise.shape, len(DEVIATIONS))
        often = self._draws.random((*shape[:2], 1)) < _OFTEN
        size = _SMALLEST ** self._draws.random((*shape[:2], 1)) * often
        away = self._draws.standard_normal(shape) * size * _DEVIATION
        errors = np.asarray(segment.noise)[..., None] * SENSORS * self._draws.standard_normal(shape)
        return away.astype(np.float32), errors.astype(np.float32)

    def compare(self) -> Comparison:
        """Judge the averaged actor, and remember it if it is the best so far."""
        actor = self._folded()
        found = compare(self.bundle(actor, {}), self.task, self._config, self.settings)
        if found.better_than(self.best):
            self.best, self._best_actor, self._best_at = found, actor, self.segments
        return found

    def bundle(self, actor: Actor | None = None, training: dict[str, Any] | None = None) -> Bundle:
        """Return the best actor, or another one, as a policy."""
        return Bundle(
            VEHICLE,
            self._best_actor if actor is None else actor,
            self.task.layout,
            self.task.action,
            VEHICLE,
            self._config.control_period,
            self.summary() if training is None else training,
        )

    def summary(self) -> dict[str, Any]:
        """Return what it did so far as plain values, for the card."""
        settings = asdict(self.settings)
        settings["layers"] = list(self.settings.layers)
        return {
            "speed_range_m_s": list(SPEED_RANGES[-1]),
            "method": "gradient of its rides through the compiled engine",
            "begins_with": "nothing" if self._start is None else dict(self._start.training) or self._start.name,
            "refinement": settings,
            "seed": self.settings.seed,
            "commit": self._commit,
            "segments": self.segments,
            "updates": self.segments * self.settings.updates,
            "steps": self.segments * self.settings.periods * self.settings.bicycles,
            "seconds": round(self.seconds, 1),
            "best_segment": self._best_at,
            "best_selection": {} if self.best is None else self.best._asdict(),
        }

    def close(self) -> None:
        """Release the engine."""
        self._rides.close()


def refine(
    settings: RefinementSettings,
    out: Path,
    start: Bundle | None = None,
    report: Callable[[Refinement, Comparison | None], None] = lambda *_: None,
) -> dict[str, Any]:
    """Refine an actor and write the best one, and a table of all comparisons.

    Args:
        settings: what it is; its result depends on them and on the start alone.
        out: folder for TABLE and POLICY.
        start: policy that it begins with; None begins from nothing.
        report: called after each segment, with the comparison that was made then.

    Returns:
        The summary.

    Raises:
        ValueError: settings that do not fit together.
    """
    process = Refinement(settings, start)
    try:
        with (out / TABLE).open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["segment", "updates", "seconds", "cost", *Comparison._fields])
            while process.segments < settings.segments:
                process.learn()
                found = None
                if process.segments % settings.select_every == 0 or process.segments == settings.segments:
                    found = process.compare()
                    done = (process.segments, process.segments * settings.updates, round(process.seconds, 1))
                    table.writerow([*done, process.last_cost, *found])
                    file.flush()
                    process.bundle().save(out / POLICY)
                report(process, found)
    finally:
        process.close()
    return process.summary()
