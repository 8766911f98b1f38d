"""Imitation: the actor rides, and a teacher that is told the world says what it would command there.

Soft actor-critic alone needs millions of decisions for one circuit, and its bicycles swing about a straight. The
classical law, on a plan for the true grip and with a preview for the true delay, rides any circuit; the
linear-quadratic rider any path. An actor that is told neither imitates it where it comes to itself (DAgger: Ross,
Gordon and Bagnell 2011), so what it cannot know it has to read from how the machine answers (a privileged teacher: Chen
et al. 2020, Learning by Cheating). It commands alone. Soft actor-critic goes on from there
(`bike_training.learning.anchored`).
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from bike_policy.contract.bundle import Actor
from bike_policy.contract.observation import TERMS, ObservationLayout
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.learning.networks import Weights, actor_of, forward, weights_of
from bike_training.learning.presets import SacSettings
from bike_training.learning.run_settings import IMITATED
from bike_training.learning.teachers import teacher_of

FloatArray = NDArray[np.float64]

MISLED: Final = 0.6
"""Part of the rows whose actor sees at times another speed asked than is, and another distance from the line: where it
rides then the teacher shows how to come back. A rider that never was much slower than asked takes its own braking for a
reason to brake."""
MISLED_TIME: Final = 3.0
"""Mean time for which it sees the same, s; half of the time all is as it is."""
ASKED: Final = (0.7, 1.03)
"""Bounds of the speed that it then sees asked, as a part of what is."""
BESIDE: Final = 0.5
"""Standard deviation of what is added to the distance that it sees, m."""
TEACHER_RIDES: Final = (1.0, 0.5, 0.15)
"""Part of the rides of the first rounds that the teacher rides itself; none later."""
DURATION: Final = 60.0
"""Of a round, s."""
UPDATES: Final = 4000
"""Updates after each round; after the last one `LAST` times as many."""
LAST: Final = 8
BATCH: Final = 512
RATE: Final = 2e-3
SAMPLED: Final = 50_000
"""Observations of the first round that say how inputs vary."""
LEAST_DEVIATION: Final = 0.02
"""Standard deviation below which an input is not enlarged further."""
LEAST_VARIANCE: Final = 1e-2
"""What is added to the variances of the inputs' combinations: those that hardly vary are enlarged by ten at most."""
FOLDER: Final = "imitation"
"""Folder of a run with the rounds so far."""


class Imitation:
    """Rounds of rides and supervised learning, each of which can be taken up from the one before.

    Attributes:
        done: rounds so far.
        loss: mean of the last updates.
        lost: rides that ended early in the last round.
    """

    def __init__(self, env: BatchVecEnv, settings: SacSettings, seed: int) -> None:
        """Prepare.

        Args:
            env: of the run; its rides begin anew with each round.
            settings: of the learner that goes on from here.
            seed: of all draws.

        Raises:
            ValueError: a race with a guide, alone.
        """
        self._env, self._settings, self._seed = env, settings, seed
        self._teacher = teacher_of(env)
        self._inputs = env.task.layout.size
        # They take inputs that vary alike and independently, once the first round has shown how they do: a lean request
        # depends on small differences of inputs that vary together, which a network of the inputs themselves learns
        # late.
        self._weights = _drawn((self._inputs, *settings.layers, env.task.action.size), seed)
        self._centre, self._equal = np.zeros(self._inputs, np.float32), np.eye(self._inputs, dtype=np.float32)
        rule = optax.chain(optax.clip_by_global_norm(1.0), optax.scale_by_adam())
        self._rule, self.done, self.loss, self.lost = rule, 0, math.nan, 0
        self._seen: list[NDArray[np.float32]] = []
        self._shown: list[NDArray[np.float32]] = []

        def cost(weights: Weights, seen: jax.Array, shown: jax.Array) -> jax.Array:
            error, small = jnp.tanh(forward(weights, seen)) - shown, self._teacher.small
            lost = jnp.sqrt(error**2 + small**2) if math.isfinite(small) else error**2
            return jnp.mean(jnp.array(self._teacher.weights) * lost)

        @jax.jit
        def update(weights: Any, moments: Any, seen: Any, shown: Any, rate: Any) -> Any:
            value, slope = jax.value_and_grad(cost)(weights, seen, shown)
            move, moments = rule.update(slope, moments)
            return jax.tree.map(lambda w, m: w - rate * m, weights, move), moments, value

        self._update = update

    def actor(self) -> Actor:
        """Return the present actor, which takes observations as they are."""
        (kernel, bias), *others = self._weights
        kernel = jnp.asarray(self._equal) @ kernel
        return actor_of([(kernel, bias - jnp.asarray(self._centre) @ kernel), *others])

    def run(self, out: Path, report: Callable[[Imitation], None] = lambda _: None) -> Actor:
        """Make the rounds that are missing and return the actor; a run that was interrupted goes on.

        Args:
            out: folder of the run.
            report: called after each round.
        """
        folder, final = out / FOLDER, out / IMITATED
        if final.is_file():
            return Actor.from_tensors(load_file(final))
        folder.mkdir(parents=True, exist_ok=True)
        for file in sorted(folder.glob("round_*.safetensors")):
            stored = load_file(file)
            self._take(stored)
        while self.done < self._settings.rounds:
            stored = self._ride()
            self._learn(stored["seen"], stored["shown"])
            save_file({**stored, **actor_of(self._weights).tensors()}, folder / f"round_{self.done:03d}.safetensors")
            self.done += 1
            report(self)
        save_file(self.actor().tensors(), final)
        shutil.rmtree(folder)
        return self.actor()

    def _take(self, stored: dict[str, NDArray[Any]]) -> None:
        """Take in a round that was made."""
        self._keep(stored.pop("seen"), stored.pop("shown"))
        self._weights = weights_of(Actor.from_tensors(stored))
        self.done += 1

    def _keep(self, seen: NDArray[np.float32], shown: NDArray[np.float32]) -> None:
        """Keep what a round has shown; the first one says how the inputs vary."""
        if not self._seen:
            layout, every = self._env.task.layout, max(1, len(seen) // SAMPLED)
            some = seen[::every].astype(np.float64)
            self._centre, self._equal = _equalised(
                np.concatenate((some, some[:, layout.mirror_places] * layout.mirror_signs))
            )
        self._seen.append(seen)
        self._shown.append(shown)

    def _ride(self) -> dict[str, NDArray[np.float32]]:
        """Ride a round; return what was seen and what the teacher showed, a row for each decision of each machine."""
        env, teacher, actor = self._env, self._teacher, self.actor()
        task, batch, rides, count = env.task, env.batch, env.rides, env.num_envs
        rng = np.random.default_rng([self._seed, self.done, 7])
        env.rng = np.random.default_rng([self._seed, self.done, 8])
        share = TEACHER_RIDES[self.done] if self.done < len(TEACHER_RIDES) else 0.0
        taught = np.less(rng.random(count), share)
        size = rng.random((count, 1)) * (rng.random((count, 1)) < 0.5)
        noise = np.zeros((count, len(teacher.noise)))
        misled = Misled(task.layout, np.less(rng.random(count), MISLED)) if teacher.misleads else None
        env.reset()
        for row in range(count):
            teacher.begin(row, rng)
        steps = round(DURATION / (batch.config.control_period * task.repeat))
        seen = np.empty((steps, count, self._inputs), dtype=np.float32)
        shown = np.empty((steps, *noise.shape), dtype=np.float32)
        self.lost, shown_now = 0, teacher.actions()
        for step in range(steps):
            seen[step], shown[step] = rides.observe(batch), shown_now
            acted_on = seen[step]
            if misled is not None:
                misled.draw(rng, batch.config.control_period * task.repeat / MISLED_TIME)
                acted_on = misled.shown(acted_on)
            actions = np.where(taught[:, None], shown_now, actor.act_batch(acted_on))
            noise = teacher.noise_memory * noise + rng.standard_normal(noise.shape) * teacher.noise
            rides.act(batch, np.clip(actions + size * noise, -1.0, 1.0).astype(np.float32))
            for _ in range(task.repeat):
                batch.step(env.commands())
                rides.advance(batch)
                shown_now = teacher.actions()
            failed = rides.evaluate(batch).failed
            self.lost += int(failed.sum())
            env.steps += 1
            begun = env.begin_again(failed | (env.steps >= teacher.longest))
            for row in begun.tolist():
                teacher.begin(row, rng)
                taught[row] = rng.random() < share
            if len(begun):
                shown_now = teacher.actions()
        return {"seen": seen.reshape(-1, self._inputs), "shown": shown.reshape(-1, shown.shape[-1])}

    def _learn(self, seen: NDArray[np.float32], shown: NDArray[np.float32]) -> None:
        """Learn from all rounds so far; the last one ends with a falling rate."""
        layout, action = self._env.task.layout, self._env.task.action
        self._keep(seen, shown)
        every, answers = np.concatenate(self._seen), np.concatenate(self._shown)
        rng = np.random.default_rng([self._seed, self.done, 9])
        last = self.done == self._settings.rounds - 1
        updates = UPDATES * (LAST if last else 1)
        values, moments = [], self._rule.init(self._weights)
        for update in range(updates):
            done = update / updates
            fall = 0.5 * (1.0 + math.cos(math.pi * done)) if last else 1.0 - 0.7 * done
            picked = rng.integers(len(every), size=BATCH)
            picked_seen, wanted = every[picked], answers[picked]
            flipped = rng.random((BATCH, 1)) < 0.5
            mirrored = np.where(flipped, picked_seen[:, layout.mirror_places] * layout.mirror_signs, picked_seen)
            inputs = (mirrored - self._centre).astype(np.float32) @ self._equal
            wanted = np.where(flipped, wanted * action.mirror_signs, wanted)
            rate = RATE * max(fall, 0.02)
            self._weights, moments, value = self._update(self._weights, moments, inputs, wanted, rate)
            values.append(value)
        self.loss = float(np.mean([float(value) for value in values[-200:]]))


_SPEED_SCALE, _MARGIN_SCALE, _ERROR_SCALE = (
    float(np.max(TERMS[name].scale)) for name in ("speed", "speed_margin", "line")
)
"""Scales of what `Misled` changes, m/s, m/s and m; of the terms of a line the lateral error alone has a large one."""


class Misled:
    """What actors of some rows see in place of how fast and where they are asked to ride.

    Attributes:
        asked: speed that each sees asked, as a part of what is, shape (n,).
        beside: what is added to the distance that it sees, m, shape (n,).
    """

    def __init__(self, layout: ObservationLayout, rows: NDArray[np.bool_]) -> None:
        """Prepare for the observations of a layout, and for which rows."""
        names = layout.names
        self._margins = [place for place, name in enumerate(names) if name.startswith("speed_margin")]
        self._speed, self._place = names.index("speed"), names.index("lateral_error")
        self._rows, self.asked, self.beside = rows, np.ones(len(rows)), np.zeros(len(rows))

    def draw(self, rng: np.random.Generator, chance: float) -> None:
        """Draw anew in some rows.

        Args:
            rng: of the draws.
            chance: of each row.
        """
        count = len(self._rows)
        drawn, some = np.less(rng.random(count), chance), self._rows & np.less(rng.random(count), 0.5)
        self.asked[drawn] = np.where(some, rng.uniform(*ASKED, count), 1.0)[drawn]
        self.beside[drawn] = np.where(some, BESIDE * rng.standard_normal(count), 0.0)[drawn]

    def shown(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what the actors see, shape (n, inputs), of the observations as they are."""
        own = _SPEED_SCALE / _MARGIN_SCALE * seen[:, self._speed, None]
        shown = seen.copy()
        shown[:, self._margins] = self.asked[:, None] * (seen[:, self._margins] + own) - own
        shown[:, self._place] += self.beside / _ERROR_SCALE
        return shown


def _drawn(sizes: tuple[int, ...], seed: int) -> Weights:
    """Return the weights of a new network."""
    rng = np.random.default_rng([seed, 6])
    return [
        (jnp.asarray(rng.normal(0.0, math.sqrt(2.0 / i), (i, o)), dtype=jnp.float32), jnp.zeros(o, dtype=jnp.float32))
        for i, o in pairwise(sizes)
    ]


def _equalised(inputs: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the mean of inputs and the matrix that gives them about the same variance in every direction.

    Args:
        inputs: shape (samples, inputs).
    """
    centre, scale = inputs.mean(axis=0), 1.0 / np.maximum(inputs.std(axis=0), LEAST_DEVIATION)
    variances, directions = np.linalg.eigh(np.cov((inputs - centre).T * scale[:, None]))
    matrix = (directions / np.sqrt(variances + LEAST_VARIANCE)) @ directions.T
    return centre.astype(np.float32), (scale[:, None] * matrix).astype(np.float32)
