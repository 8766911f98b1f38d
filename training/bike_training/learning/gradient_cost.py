"""Cost that learning through derivatives descends: that of linearised rides, ridden by a changed actor.

The cost of a control period is ``sqrt(e^2 + d^2) - d + a e^2 / (1 + |e|) + b w^2 + c (u - u')^2`` with the lateral
error e, the steer rate w, the command u and the one before u', and more for leans close to a fall. What is descended is
the mean logarithm of the costs of rides: else a few violent rides would say all, and a swing on a straight next to
nothing.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp

from bike_training.learning.linear_rides import Segment
from bike_training.learning.mirror_symmetric_actor import MirrorSymmetricActor, Weights
from bike_training.learning.presets import GradientSettings

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
    errors: jax.Array,
) -> jax.Array:
    """Return the mean logarithm of the costs of linearised rides, ridden by an actor.

    Args:
        settings: of the cost.
        actor: what weights mean.
        weights: of the actor.
        held: of the one that rides the last periods of the segment.
        segment: rides of an actor close to it.
        away: deviations that the rides are given before each period, shape (periods, bicycles, 6).
        errors: of the sensors, as deviations, the same shape.
    """
    ridden = ride_on(settings, actor, weights, held, segment, away, errors)
    total = jnp.sqrt(ridden.error**2 + settings.knee**2) - settings.knee
    total += settings.square * ridden.error**2 / (1.0 + jnp.abs(ridden.error))
    total += settings.steer_rate * ridden.steer_rate**2 + settings.change * ridden.change**2
    total += settings.lean * jax.nn.relu(jnp.abs(ridden.roll) - _STEEP) ** 2
    total += settings.steer * jax.nn.relu(jnp.abs(ridden.steer) - _FAR) ** 2
    each = (jnp.minimum(total, _LARGEST_COST) * segment.whole).mean(axis=0)
    risky = (jnp.abs(segment.roll).max(axis=0) > _STEEP) | (segment.whole[-1] == 0.0)
    counts = 1.0 + settings.risky * risky
    return (jnp.log(each + _LEAST_COST) * counts).sum() / counts.sum()


class Ridden(NamedTuple):
    """Quantities that a ride costs by, shape (periods, bicycles) each.

    Attributes:
        error: lateral error, m. steer_rate: rad/s. roll, steer: rad. change: of the answer since the one before.
    """

    error: jax.Array
    steer_rate: jax.Array
    roll: jax.Array
    steer: jax.Array
    change: jax.Array


def ride_on(
    settings: GradientSettings,
    actor: MirrorSymmetricActor,
    weights: Weights,
    held: Weights,
    segment: Segment,
    away: jax.Array,
    errors: jax.Array,
) -> Ridden:
    """Ride linearised rides with an actor; see :func:`cost`."""

    def period(weights: Weights, carry: Any, part: Any) -> tuple[Any, Ridden]:
        deviation, sent = carry
        step, given, error = part
        deviation = deviation + given
        seen = step.seen + jnp.einsum("nij,nj->ni", step.sight, deviation + error)
        sent = jnp.concatenate([actor.act(weights, seen)[None], sent])
        acting = jnp.take_along_axis(sent, step.late[None], axis=0)[0]
        moved = jnp.concatenate([deviation, (acting - step.commands)[:, None]], axis=1)
        deviation = jnp.einsum("nij,nj->ni", step.motion, moved)
        found = Ridden(
            error=step.error + step.across * deviation[:, 0],
            steer_rate=step.steer_rate + deviation[:, 5],
            roll=step.roll + deviation[:, 2],
            steer=step.steer + deviation[:, 3],
            change=sent[0] - sent[1],
        )
        return (deviation, sent[:-1]), found

    # What is carried is not of a period.
    parts = (segment._replace(sent=segment.commands), away, errors)
    live = segment.commands.shape[0] - settings.tail
    carry = (jnp.zeros_like(away[0]), segment.sent)
    carry, found = jax.lax.scan(
        lambda c, p: period(weights, c, p), carry, jax.tree.map(lambda part: part[:live], parts)
    )
    if not settings.tail:
        return found
    rest = jax.tree.map(lambda part: part[live:], parts)
    _, later = jax.lax.scan(lambda c, p: period(held, c, p), carry, rest)
    return Ridden(*(jnp.concatenate(pair) for pair in zip(found, later, strict=True)))
