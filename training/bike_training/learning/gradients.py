"""Learning through the model: an actor descends the gradient of its own rides.

Soft actor-critic learns from rewards what a command is worth. Here the compiled engine says it: rides of the present
actor come with their derivatives (`bike_training.learning.linear_rides`), a changed actor is ridden on them to first
order, and the cost of that ride (`bike_training.learning.gradients`) is differentiated by the actor's weights.
One segment serves several updates, because a slightly changed actor stays close to the ride that the derivatives were
taken on. In the last periods of a segment the actor is held as it rode, so that what a command does later counts as
well. Related: the stochastic value gradients of Heess et al. (2015), without noise and with a model that need not be
learned.

Actors are compared on many rides, by their closed loop, and on rides under pushes and from steep starts.

The cost of a control period is ``sqrt(e^2 + d^2) - d + a e^2 / (1 + |e|) + b w^2 + c (u - u')^2`` with the lateral
error e, the steer rate w, the command u and the one before u', and more for leans close to a fall. What is descended is
the mean logarithm of the costs of rides: else a few violent rides would say all, and a swing on a straight next to
nothing. A network is ridden as the odd part of itself: a mirrored observation gives the mirrored command, so it rides a
straight without an offset.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from bike_policy.contract.bundle import Actor, Bundle, load_bundle
from bike_policy.contract.observation import ObservationLayout
from bike_policy.riders.base import LearnedRider
from bike_sim.course.random_courses import PathRanges
from bike_sim.sim.batch import Batch
from bike_sim.sim.request import ResetRequest
from bike_training.curricula.parts import REFINEMENT, SPEED_RANGES, PartsCurriculum, RideRanges
from bike_training.learning.linear_rides import DEVIATIONS, LinearRides, Segment, push_sideways
from bike_training.learning.networks import Weights, forward, weights_of
from bike_training.learning.presets import GradientSettings
from bike_training.learning.run_settings import GRADIENT_POLICY, GRADIENT_TABLE, RunSettings, source_commit
from bike_training.learning.validation import ride_side_by_side
from bike_training.rollout.stability import stability
from bike_training.tasks.path import VALIDATION_DURATION, PathTask


class MirrorSymmetricActor:
    """A network ridden as the odd part of itself about the mirror of its observations."""

    def __init__(self, layout: ObservationLayout, reach: float = 1.0) -> None:
        """Take the layout that says how observations are mirrored, and the command of the largest answer."""
        self._signs = layout.mirror_signs
        self._inputs = layout.size
        self._reach = reach

    def draw(self, layers: tuple[int, ...], seed: int) -> Weights:
        """Return weights of a new network, whose commands are small."""
        key, weights = jax.random.PRNGKey(seed), []
        sizes = (self._inputs, *layers, 1)
        for place, (inputs, outputs) in enumerate(pairwise(sizes)):
            key, drawn = jax.random.split(key)
            gain = 0.01 if place == len(layers) else 1.0
            kernel = jax.random.normal(drawn, (inputs, outputs)) * (gain * math.sqrt(2.0 / inputs))
            weights.append((kernel, jnp.zeros(outputs)))
        return weights

    def take(self, actor: Actor, reach: float = 1.0) -> Weights:
        """Return the weights of an actor, whose small commands stay the same.

        Args:
            actor: taken.
            reach: command of its largest answer.

        Raises:
            ValueError: it sees something else, or answers more than a set point.
        """
        if (actor.inputs, actor.outputs) != (self._inputs, 1):
            raise ValueError(
                f"an actor of {actor.inputs} inputs and {actor.outputs} outputs cannot begin a refinement that sees "
                f"{self._inputs} numbers and steers"
            )
        whole = weights_of(actor)
        half = self._unfolded(whole)
        again = self.folded(half).tensors()
        # One that was learned like this is taken as what it was folded from, lest it grow twice as wide.
        taken = half if all(np.array_equal(again[name], old) for name, old in actor.tensors().items()) else whole
        kernel, bias = taken[-1]
        return [*taken[:-1], (kernel * (reach / self._reach), bias * (reach / self._reach))]

    @staticmethod
    def _unfolded(weights: Weights) -> Weights:
        """Return what :meth:`folded` made weights of, if it did."""
        last = len(weights) - 1
        found = []
        for place, (kernel, bias) in enumerate(weights):
            rows = kernel.shape[0] // (1 if place == 0 else 2)
            columns = kernel.shape[1] // (1 if place == last else 2)
            scale = 2.0 if place == last else 1.0
            found.append((scale * kernel[:rows, :columns], bias[:columns]))
        return found

    def act(self, weights: Weights, seen: jax.Array) -> jax.Array:
        """Return commands, at most the reach, for observations of shape (..., inputs)."""
        turned = forward(weights, seen) - forward(weights, seen * self._signs)
        return self._reach * jnp.tanh(0.5 * turned[..., 0])

    def folded(self, weights: Weights) -> Actor:
        """Return the same as one network, of layers twice as wide."""
        kernels, biases = [], []
        for place, (kernel, bias) in enumerate((np.asarray(k), np.asarray(b)) for k, b in weights):
            none = np.zeros_like(kernel)
            if place == 0:
                kernel = np.hstack([kernel, self._signs[:, None] * kernel])
            elif place < len(weights) - 1:
                kernel = np.block([[kernel, none], [none, kernel]])
            if place < len(weights) - 1:
                kernels.append(kernel.T)
                biases.append(np.concatenate([bias, bias]))
            else:
                kernels.append(0.5 * np.vstack([kernel, -kernel]).T)
                biases.append(np.zeros_like(bias))
        return Actor([k.astype(np.float32) for k in kernels], [b.astype(np.float32) for b in biases])


_STEEP: Final = math.radians(38.0)
"""Roll from which on it costs something, rad; the steepest steady turn that is learned on leans 36 deg."""
_FAR: Final = math.radians(40.0)
"""Steering angle from which on it costs something, rad."""
_LARGEST_COST: Final = 50.0
_LEAST_COST: Final = 3e-4
"""Cost of a ride below which it hardly matters how small it is."""


def cost(
    settings: GradientSettings,
    actor: MirrorSymmetricActor,
    weights: Weights,
    held: Weights,
    segment: Segment,
    away: jax.Array,
) -> jax.Array:
    """Return the mean logarithm of the costs of linearised rides, ridden by an actor.

    Args:
        settings: of the cost.
        actor: what weights mean.
        weights: of the actor.
        held: of the one that rides the last periods of the segment.
        segment: rides of an actor close to it.
        away: deviations that the rides are given before each period, shape (periods, bicycles, 6).
    """
    ridden = _ride_on(settings, actor, weights, held, segment, away)
    error, roll = ridden["error"], ridden["roll"]
    total = jnp.sqrt(error**2 + settings.knee**2) - settings.knee
    total += settings.square * error**2 / (1.0 + jnp.abs(error))
    total += settings.steer_rate * ridden["steer_rate"] ** 2 + settings.change * ridden["change"] ** 2
    total += settings.lean * jax.nn.relu(jnp.abs(roll) - _STEEP) ** 2
    total += settings.steer * jax.nn.relu(jnp.abs(ridden["steer"]) - _FAR) ** 2
    each = (jnp.minimum(total, _LARGEST_COST) * segment.whole).mean(axis=0)
    risky = (jnp.abs(segment.roll).max(axis=0) > _STEEP) | (segment.whole[-1] == 0.0)
    counts = 1.0 + settings.risky * risky
    return (jnp.log(each + _LEAST_COST) * counts).sum() / counts.sum()


def _ride_on(
    settings: GradientSettings,
    actor: MirrorSymmetricActor,
    weights: Weights,
    held: Weights,
    segment: Segment,
    away: jax.Array,
) -> dict[str, jax.Array]:
    """Ride linearised rides with an actor; see :func:`cost`.

    Returns:
        Quantities that a ride costs by, shape (periods, bicycles) each: lateral error (m), steer rate (rad/s), roll,
        steer (rad), and the change of the answer since the one before.
    """

    def period(weights: Weights, carry: Any, part: Any) -> tuple[Any, dict[str, jax.Array]]:
        deviation, sent = carry
        step, given = part
        deviation = deviation + given
        seen = step.seen + jnp.einsum("nij,nj->ni", step.sight, deviation)
        acting = actor.act(weights, seen)
        moved = jnp.concatenate([deviation, (acting - step.commands)[:, None]], axis=1)
        deviation = jnp.einsum("nij,nj->ni", step.motion, moved)
        found = {
            "error": step.error + step.across * deviation[:, 0],
            "steer_rate": step.steer_rate + deviation[:, 5],
            "roll": step.roll + deviation[:, 2],
            "steer": step.steer + deviation[:, 3],
            "change": acting - sent,
        }
        return (deviation, acting), found

    # What is carried is not of a period.
    parts = (segment._replace(sent=segment.commands), away)
    live = segment.commands.shape[0] - settings.tail
    carry = (jnp.zeros_like(away[0]), segment.sent)
    carry, found = jax.lax.scan(
        lambda c, p: period(weights, c, p), carry, jax.tree.map(lambda part: part[:live], parts)
    )
    if not settings.tail:
        return found
    rest = jax.tree.map(lambda part: part[live:], parts)
    _, later = jax.lax.scan(lambda c, p: period(held, c, p), carry, rest)
    return {name: jnp.concatenate([part, later[name]]) for name, part in found.items()}


Float32Array = NDArray[np.float32]

_DEVIATION: Final = np.array([0.03, 0.01, 0.01, 0.01, 0.1, 0.1], dtype=np.float32)
"""Largest standard deviations of the deviations that rides are given in passing: m, rad, rad/s."""
_SMALLEST: Final = 0.03
"""Part of them that the smallest are drawn with: the loop is to be calm about a steady ride as well."""
_OFTEN: Final = 1.0 / 40.0
"""Probability of one in a control period."""
STRAIGHT: Final = RideRanges((1.8, 7.3), PathRanges(200.0, 1000.0, 20.0, 22.0, 0.01, 0.5))
RIDES: Final = replace(REFINEMENT, also=(*REFINEMENT.also, STRAIGHT))
"""Paths of learning: a third of the rides hardly bend, for on bent ones a bicycle is seldom upright for long."""
SLOW: Final = RideRanges((1.8, 2.6), REFINEMENT.paths)
"""Ridden as often as each of the others where rides are pushed: a push is worst where a bicycle is slow."""
STABLE: Final = 0.99
"""Largest spectral radius of an actor that is kept as the best."""
STEEP: Final = RideRanges((4.0, 7.3), PathRanges(8.0, 14.0, 13.5, 16.0, 5.5, 8.2), perturb=False)
"""Upright starts, two thirds of them before a transfer that bends with down to 1/4 m before anything can lean."""
PUSHED: Final = 60.0
"""Sideways impulse of the rides that actors are compared on under pushes, N s."""
_PUSH_EVERY: Final = 100
"""Control periods between two of them."""


class Comparison(NamedTuple):
    """Figures of an actor on the rides that runs of training compare actors on, and of its closed loop.

    Attributes:
        ridden: of 105 rides.
        mean_m: of their mean distances, m.
        worst_mean_m: largest of them.
        worst_max_m: largest distance.
        spectral_radius: largest of 2 to 7 m/s, upright and in a turn; infinite where one is missing.
        swing_deg: set point left swinging on a straight.
        pushed: of 105 rides with a push of PUSHED N s every five seconds, where actors are compared under pushes.
        pushed_mean_m: of their mean distances, m.
        steep: of 105 rides from STEEP, where actors are compared on them.
        steep_mean_m: of their mean distances, m.
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
    if step and step % _PUSH_EVERY == 0:
        for row in np.flatnonzero(riding):
            push_sideways(batch, int(row), PUSHED * (-1.0) ** (row + step // _PUSH_EVERY // 2))


class GradientLearning:
    """Learning from its settings to its bundle.

    Attributes:
        settings: of the run.
        task: that is learned.
        segments: that were ridden.
        ridden: the last of them.
        last_cost: of its last update.
        best: figures of the best actor so far, or None.
        seconds: time spent learning, s.
    """

    ridden: Segment

    def __init__(self, run: RunSettings) -> None:
        """Prepare it.

        Args:
            run: settings of the run.

        Raises:
            FileNotFoundError: no policy to begin with.
            ValueError: a policy to begin with that observes something else than the task shows, or a task or vehicle
                whose rides have no derivatives.
        """
        settings, task = run.preset.learner, run.preset.task
        start = load_bundle(run.start) if run.start else None
        if not isinstance(settings, GradientSettings) or not isinstance(task, PathTask) or run.superbike:
            raise ValueError(f"preset {run.preset.name!r} learns by gradients of rides of bicycles on paths only")
        if not run.compiled or len(run.machines) > 1:
            raise ValueError("learning by gradients needs one vehicle on the compiled engine in this process")
        if start is not None and start.layout != task.layout:
            raise ValueError(f"policy {start.name!r} sees {start.layout.name!r}, the task {task.layout.name!r}")
        self._run_settings, self.settings, self.task, self._start = run, settings, task, start
        self._config = run.compiled_simulator()
        rides = replace(RIDES, also=(*RIDES.also, SLOW)) if settings.impulse else RIDES
        self._rides = LinearRides(settings, task, rides, self._config, run.seed, STEEP)
        largest = self._rides.batch.vehicle.max_steer
        self._actor = MirrorSymmetricActor(task.layout, task.action.columns[0].factor(largest))
        self._weights = (
            self._actor.draw(settings.layers, run.seed)
            if start is None
            else self._actor.take(start.actor, start.action.columns[0].factor(largest))
        )
        self._mean = self._weights
        self._draws = np.random.default_rng([run.seed, 1])
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
                self._weights, self._mean, self._moments, held, (segment, self._draws_of(segment)), self.rate
            )
        self.segments += 1
        self.last_cost = float(value)
        self.seconds += time.monotonic() - began

    def _draws_of(self, segment: Segment) -> Float32Array:
        """Return deviations that the rides are given, seldom and of all sizes."""
        shape = (*segment.commands.shape, len(DEVIATIONS))
        often = self._draws.random((*shape[:2], 1)) < _OFTEN
        size = _SMALLEST ** self._draws.random((*shape[:2], 1)) * often
        away = self._draws.standard_normal(shape) * size * _DEVIATION
        self._draws.standard_normal(shape)  # passed over: the shipped policy was learned with as many draws
        return away.astype(np.float32)

    def compare(self) -> Comparison:
        """Evaluate the averaged actor, and remember it if it is the best so far."""
        actor, task, config = self._folded(), self.task, self._config
        requests = PartsCurriculum().selection_requests(task.preview)
        track, whole = ride_side_by_side(actor, task, config, requests)
        means = np.abs(track).mean(axis=0)[whole]
        loop = stability(LearnedRider(self.bundle(actor, {}))) if whole.all() else {}
        radii = [loop.get(f"worst_spectral_radius_{place}") for place in ("upright", "turn")]
        swing = loop.get("worst_swing_deg")
        found = Comparison(
            int(whole.sum()),
            float(means.mean()) if whole.any() else math.inf,
            float(means.max()) if whole.any() else math.inf,
            float(np.abs(track[:, whole]).max()) if whole.any() else math.inf,
            max((math.inf if radius is None else radius) for radius in radii),
            math.inf if swing is None else swing,
        )
        if self.settings.impulse:
            track, whole = ride_side_by_side(actor, task, config, requests, _push_now_and_then)
            found = found._replace(pushed=int(whole.sum()), pushed_mean_m=_mean_of(track, whole))
        if self.settings.steep:
            track, whole = ride_side_by_side(actor, task, config, _steep(requests))
            found = found._replace(steep=int(whole.sum()), steep_mean_m=_mean_of(track, whole))
        if found.better_than(self.best):
            self.best, self._best_actor, self._best_at = found, actor, self.segments
        return found

    def bundle(self, actor: Actor | None = None, training: dict[str, Any] | None = None) -> Bundle:
        """Return the best actor, or another one, as a policy."""
        name = self._rides.batch.vehicle.name
        return Bundle(
            name,
            self._best_actor if actor is None else actor,
            self.task.layout,
            self.task.action,
            name,
            self._config.control_period,
            self.summary() if training is None else training,
        )

    def summary(self) -> dict[str, Any]:
        """Return what it did so far as plain values, for the card."""
        return {
            "speed_range_m_s": list(SPEED_RANGES[-1]),
            "method": "gradient of its rides through the compiled engine",
            "begins_with": "nothing" if self._start is None else dict(self._start.training) or self._start.name,
            "vehicle": self._run_settings.vehicle,
            "preset": self._run_settings.preset.to_plain(),
            "seed": self._run_settings.seed,
            "commit": self._commit,
            "segments": self.segments,
            "updates": self.segments * self.settings.updates,
            "steps": self.segments * self.settings.periods * self.settings.bicycles,
            "seconds": round(self.seconds, 1),
            "best_segment": self._best_at,
            "best_selection": {} if self.best is None else self.best._asdict(),
        }

    def run(
        self, out: Path, report: Callable[[GradientLearning, Comparison | None], None] = lambda *_: None
    ) -> dict[str, Any]:
        """Learn to the end, write the best actor and a table of all comparisons, and return the summary.

        Args:
            out: folder for GRADIENT_TABLE and GRADIENT_POLICY.
            report: called after each segment, with the comparison that was made then.

        Raises:
            ValueError: the folder holds another run.
        """
        settings = self.settings
        if (out / GRADIENT_TABLE).exists():
            raise ValueError(f"{out} already holds a run; choose another folder")
        out.mkdir(parents=True, exist_ok=True)
        with closing(self), (out / GRADIENT_TABLE).open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(["segment", "updates", "seconds", "cost", *Comparison._fields])
            while self.segments < settings.segments:
                self.learn()
                found = None
                if self.segments % settings.select_every == 0 or self.segments == settings.segments:
                    found = self.compare()
                    done = (self.segments, self.segments * settings.updates, round(self.seconds, 1))
                    table.writerow([*done, self.last_cost, *found])
                    file.flush()
                    self.bundle().save(out / GRADIENT_POLICY)
                report(self, found)
        return self.summary()

    def close(self) -> None:
        """Release the engine."""
        self._rides.close()
